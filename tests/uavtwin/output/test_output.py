"""Output folders hold all results or none, and whatever else they held."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import IMPORT_PATH

from twin.errors import TwinError
from uavtwin.output import check_folder, output_file, results_folder


def tree(folder: Path) -> dict[str, str]:
    """Text of every file by its path."""
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


def write_into(out: Path, force: bool = False) -> None:
    with results_folder(out, force) as folder:
        (folder / "fmi2").mkdir()
        (folder / "fmi2" / "a.fmu").write_text("new")
        (folder / "run.json").write_text("new")


RESULTS = {"fmi2/a.fmu": "new", "run.json": "new"}


@pytest.mark.parametrize("out", ["out", "deep/er/out", "empty"])
def test_results_arrive_in_a_new_or_empty_folder(tmp_path: Path, out: str) -> None:
    (tmp_path / "empty").mkdir()
    write_into(tmp_path / out)
    assert tree(tmp_path) == {f"{out}/{name}": text for name, text in RESULTS.items()}
    assert not list(tmp_path.rglob(".uavtwin-*"))


@pytest.mark.parametrize(("umask", "rights"), [(0o022, 0o644), (0o007, 0o660)])
def test_results_have_the_rights_that_the_umask_gives(
    tmp_path: Path, umask: int, rights: int
) -> None:
    """Some libraries write theirs for the owner alone."""
    before = os.umask(umask)
    try:
        with results_folder(tmp_path / "out", force=False) as folder:
            (folder / "deep").mkdir()
            (folder / "deep" / "a").touch(0o600)
        with output_file(tmp_path / "b") as file:
            file.touch(0o600)
    finally:
        os.umask(before)
    for path in (tmp_path / "out" / "deep" / "a", tmp_path / "b"):
        assert path.stat().st_mode & 0o777 == rights


def test_forced_results_replace_those_of_the_same_name_only(tmp_path: Path) -> None:
    (tmp_path / "fmi2").mkdir()
    for name in ("run.json", "mine.txt", "fmi2/a.fmu", "fmi2/mine.fmu"):
        (tmp_path / name).write_text("old")
    write_into(tmp_path, force=True)
    assert tree(tmp_path) == {"mine.txt": "old", "fmi2/mine.fmu": "old", **RESULTS}


@pytest.mark.parametrize("stop", [KeyboardInterrupt, TwinError("no")])
@pytest.mark.parametrize("held", [{}, {"run.json": "old"}])
def test_an_interrupt_leaves_everything_as_it_was(
    tmp_path: Path, stop: BaseException, held: dict[str, str]
) -> None:
    out = tmp_path / "out"
    for name, text in held.items():
        out.mkdir()
        (out / name).write_text(text)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises((KeyboardInterrupt, TwinError)), results_folder(out, force=True) as folder:
        (folder / "run.json").write_text("half")
        raise stop
    assert sorted(tmp_path.rglob("*")) == before
    assert tree(tmp_path) == {f"out/{name}": text for name, text in held.items()}


def test_a_folder_in_the_place_of_a_result_is_kept(tmp_path: Path) -> None:
    (tmp_path / "run.json").mkdir()
    (tmp_path / "run.json" / "mine.txt").write_text("old")
    with pytest.raises(TwinError, match=r"run\.json: cannot be written"):
        write_into(tmp_path, force=True)
    assert tree(tmp_path)["run.json/mine.txt"] == "old"


def test_a_place_that_cannot_be_written_is_refused_early(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(TwinError, match=r"note\.txt: is a file"):
        check_folder(tmp_path / "note.txt", force=True)
    with pytest.raises(TwinError, match=r"note\.txt is a file\. Choose another --out"):
        check_folder(tmp_path / "note.txt" / "out", force=True)
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)
    with pytest.raises(TwinError, match=f"cannot be written, {tmp_path} is write-protected"):
        check_folder(tmp_path / "deep" / "out", force=False)


def test_of_two_runs_into_one_new_folder_the_second_is_refused(tmp_path: Path) -> None:
    """Both began while there was nothing; neither is mixed with, nor replaced by, the other."""
    out = tmp_path / "out"
    with results_folder(out, force=False) as first:
        (first / "run.json").write_text("first")
        with (
            pytest.raises(TwinError, match=r"out: another run has written into it meanwhile"),
            results_folder(out, force=False) as second,
        ):
            (second / "run.json").write_text("second")
            out.mkdir()
            (out / "run.json").write_text("of a third")
        (out / "run.json").unlink()
    assert tree(out) == {"run.json": "first"}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_of_two_runs_into_one_empty_folder_the_second_is_refused(tmp_path: Path) -> None:
    with results_folder(tmp_path, force=False) as first:
        (first / "run.json").write_text("first")
        with pytest.raises(TwinError, match="another run is writing into it"):
            check_folder(tmp_path, force=False)
    assert tree(tmp_path) == {"run.json": "first"}


KILLED = """
import os, signal, sys
from pathlib import Path
from uavtwin import output
after = int(sys.argv[2])
move = output._move
def moved(made, place):
    global after
    if after == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    after -= 1
    move(made, place)
output._move = moved
with output.results_folder(Path(sys.argv[1]), False) as folder:
    (folder / "fmi2").mkdir()
    for name in ("a.json", "fmi2/a.fmu", "run.json"):
        (folder / name).write_text("killed")
"""


@pytest.mark.parametrize("after", range(4))
def test_a_run_killed_while_it_moves_into_an_empty_folder(tmp_path: Path, after: int) -> None:
    environment = {**os.environ, "PYTHONPATH": IMPORT_PATH}
    command = [sys.executable, "-c", KILLED, str(tmp_path), str(after)]
    assert subprocess.run(command, env=environment, check=False).returncode == -9
    check_folder(tmp_path, force=False)
    assert list(tmp_path.iterdir()) == []
    write_into(tmp_path)
    assert tree(tmp_path) == RESULTS


def test_a_list_from_elsewhere_takes_nothing_away(tmp_path: Path) -> None:
    """What lies in an output folder may come from anybody; names in it are no paths."""
    (tmp_path / "mine.txt").write_text("mine")
    out = tmp_path / "out"
    with results_folder(out, force=False) as folder:
        (folder / "run.json").write_text("new")
        owner = folder.parent.name
    mine = f"-{os.getpid()}-"
    place = out / owner.replace(mine, "-4194304-")  # beyond the numbers of processes
    for text in ('["../mine.txt", "..", "", ".", 3, null]', "[", "3"):
        place.mkdir()
        (place / "moving").write_text(text)
        with pytest.raises(TwinError, match="is not empty"):
            check_folder(out, force=False)
        assert not place.exists()
    assert tree(tmp_path) == {"mine.txt": "mine", "out/run.json": "new"}
