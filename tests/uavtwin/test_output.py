"""Output folders hold all results or none, and whatever else they held."""

import os
from pathlib import Path

import pytest

from twin.errors import TwinError
from uavtwin.output import check_folder, results_folder


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
