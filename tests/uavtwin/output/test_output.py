"""Output folders hold all results or none, and whatever else they held."""

import errno
import json
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import IMPORT_PATH

from twin.errors import TwinError
from twin.scratch import scratch_folder
from uavtwin import output
from uavtwin.output import (
    OptionalSteps,
    check_folder,
    output_file,
    recorded_file,
    results_folder,
)


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
after, replace = int(sys.argv[2]), Path.replace
def moved(made, place):
    global after
    if after == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    after -= 1
    replace(made, place)
Path.replace = moved
journal = sys.argv[3] if len(sys.argv) > 3 else ""
with output.results_folder(Path(sys.argv[1]), False, journal, ["runs"]) as folder:
    (folder / "fmi2").mkdir()
    for name in ("a.json", "fmi2/a.fmu", "run.json"):
        (folder / name).write_text("killed")
"""
MOVES = 4
"""Of the list, and of three results."""


def killed_while_moving(out: Path, after: int, journal: str = "") -> None:
    """A run that dies before this move."""
    environment = {**os.environ, "PYTHONPATH": IMPORT_PATH}
    command = [sys.executable, "-c", KILLED, str(out), str(after), *filter(None, [journal])]
    assert subprocess.run(command, env=environment, check=False).returncode == -9


@pytest.mark.parametrize("after", range(MOVES))
def test_a_run_killed_while_it_moves_into_an_empty_folder(tmp_path: Path, after: int) -> None:
    killed_while_moving(tmp_path, after)
    check_folder(tmp_path, force=False)
    assert list(tmp_path.iterdir()) == []
    write_into(tmp_path)
    assert tree(tmp_path) == RESULTS


@pytest.mark.parametrize("after", range(MOVES))
def test_an_unfinished_run_is_resumed_and_its_own_files_stay(tmp_path: Path, after: int) -> None:
    (tmp_path / "runs").mkdir()
    for name in ("log.jsonl", "runs/1"):
        (tmp_path / name).write_text("done")
    killed_while_moving(tmp_path, after, "log.jsonl")
    with pytest.raises(TwinError, match="is not"):
        check_folder(tmp_path, force=False)
    check_folder(tmp_path, False, "log.jsonl", ["runs"])
    assert tree(tmp_path) == {"log.jsonl": "done", "runs/1": "done"}
    with results_folder(tmp_path, False, "log.jsonl", ["runs"]) as folder:
        (folder / "run.json").write_text("new")
    assert tree(tmp_path) == {"runs/1": "done", "run.json": "new"}
    (tmp_path / "log.jsonl").touch()
    with pytest.raises(TwinError, match=r"not empty, run\.json beside the unfinished run"):
        check_folder(tmp_path, False, "log.jsonl", ["runs"])


def test_results_that_were_all_in_place_are_not_taken_back(tmp_path: Path) -> None:
    """A run that was killed before it could remove its list had finished."""
    killed_while_moving(tmp_path, MOVES - 1)
    (left,) = tmp_path.glob(".uavtwin-*")
    (left / "results" / "run.json").rename(tmp_path / "run.json")
    with pytest.raises(TwinError, match="is not empty"):
        check_folder(tmp_path, force=False)
    assert set(tree(tmp_path)) >= {"a.json", "fmi2/a.fmu", "run.json"}


ALTERED: dict[str, Callable[[Path], object]] = {
    "written": lambda out: (out / "a.json").write_text("mine"),
    "same size": lambda out: (out / "a.json").write_text("KILLED"),
    "copied": lambda out: Path(shutil.copy(out / "a.json", out / "b")).replace(out / "a.json"),
    "added": lambda out: (out / "thesis.tex").write_text("mine"),
    "added inside": lambda out: (out / "fmi2" / "thesis.tex").write_text("mine"),
    "linked": lambda out: os.symlink((out / "fmi2").rename(out.parent / "x"), out / "fmi2"),
    "link beside": lambda out: (out / "fmi2").symlink_to(out.parent),
}


@pytest.mark.parametrize("how", ALTERED)
def test_what_was_changed_after_a_kill_is_the_users(tmp_path: Path, how: str) -> None:
    """Nothing at all goes then, and the error names it."""
    out = tmp_path / "out"
    out.mkdir()
    killed_while_moving(out, MOVES - (2 if how == "link beside" else 1))
    ALTERED[how](out)
    before = state(tmp_path)
    with pytest.raises(TwinError, match=r"(a\.json|thesis\.tex|fmi2).* is not what the run"):
        check_folder(out, force=False)
    assert state(tmp_path) == before


def state(folder: Path) -> dict[str, tuple[int, int, bytes]]:
    """Inode, mode and content of everything in it."""
    found = {}
    for path in folder.rglob("*"):
        about = path.lstat()
        content = os.readlink(path).encode() if path.is_symlink() else b""
        if stat.S_ISREG(about.st_mode):
            content = path.read_bytes()
        found[str(path.relative_to(folder))] = (about.st_ino, about.st_mode, content)
    return found


USERS = ("thesis.tex", "photos/a.jpg", "photos/b/c.jpg", "link")
"""Files of the user in the output folder; the last one is a link to the next."""
ELSEWHERE = "elsewhere/mine.txt"
json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-2, 2**70) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=8,
)


@st.composite
def names(draw: st.DrawFn) -> str:
    """Of the user's files and folders, with ways around, and of nothing."""
    ways = ["", "./", "../out/", "photos/../", "/", "photos//", "link/", "results/", "x\0/"]
    some = [*USERS, "photos", "photos/b", ELSEWHERE, "../" + ELSEWHERE, "link/mine.txt", ".", ""]
    return draw(st.sampled_from(ways)) + draw(st.sampled_from(some) | st.text(max_size=8))


@pytest.mark.slow
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_forged_leftovers_take_nothing(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Whatever a leftover says, however it was made: with links, hard links, of this very boot,
    with the right inode and hash of some of the user's files. One is always missing from it."""
    home = tmp_path_factory.mktemp("forged")
    out = home / "out"
    for name in (*USERS[:-1], "../" + ELSEWHERE):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("mine")
    (out / USERS[-1]).symlink_to(home / "elsewhere")
    (out / "never_listed").write_text("mine")
    with scratch_folder(home) as folder:
        host, boot, namespace, *_ = folder.name.removeprefix(".uavtwin-").split("-")
    boot = data.draw(st.sampled_from([boot, "0123456789ab", "0" * 12]))
    left = out / f".uavtwin-{host}-{boot}-{namespace}-4194304-1-x"
    left.mkdir()
    if data.draw(st.booleans()):
        (left / "lock").touch()
    if data.draw(st.booleans()):
        (left / "results").symlink_to(data.draw(st.sampled_from([out, home / "elsewhere"])))
    else:
        (left / "results").mkdir()
        for k, name in enumerate(USERS[:-1]):
            if data.draw(st.booleans()):
                os.link(out / name, left / "results" / str(k))

    def identity(name: str) -> object:
        if data.draw(st.booleans()):
            return output._identity(out / name.replace("\0", ""))
        return data.draw(json_values)

    listed: object = {n: identity(n) for n in data.draw(st.lists(names(), max_size=6))}
    if data.draw(st.integers(0, 4)) == 0:
        listed = data.draw(json_values | st.lists(names()))
    text = json.dumps(listed) if data.draw(st.integers(0, 9)) else "[" * 100_000
    (left / "moving").write_text(text, "utf-8", "surrogatepass")
    before = state(home)
    for journal in ("", "never_listed"):
        with pytest.raises(TwinError):
            check_folder(out, False, journal)
        assert state(home) == before
        with pytest.raises(TwinError):
            write_into(out)
        assert state(home) == before
    write_into(out, force=True)
    after = state(home)
    assert {k: v for k, v in before.items() if left.name not in k}.items() <= after.items()


def test_a_list_without_end_is_not_read(tmp_path: Path) -> None:
    killed_while_moving(tmp_path, MOVES - 1)
    (left,) = tmp_path.glob(".uavtwin-*")
    with (left / "moving").open("r+b") as file:
        file.truncate(2**40)
    with pytest.raises(TwinError, match="is not empty"):
        check_folder(tmp_path, force=False)
    assert (tmp_path / "a.json").read_text() == "killed"


def test_results_do_not_pass_through_links(tmp_path: Path) -> None:
    """`--force` replaces files of a result's name in the folder, not in another one."""
    elsewhere, out = tmp_path / "elsewhere", tmp_path / "out"
    for folder in (elsewhere, out):
        folder.mkdir()
    (elsewhere / "a.fmu").write_text("mine")
    (out / "fmi2").symlink_to(elsewhere)
    with pytest.raises(TwinError, match="fmi2: cannot be written"):
        write_into(out, force=True)
    assert tree(elsewhere) == {"a.fmu": "mine"}
    (out / "fmi2").unlink()
    (tmp_path / "link").symlink_to(out)
    write_into(tmp_path / "link", force=True)  # the folder itself may be one
    assert tree(out) == RESULTS


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("force", [False, True])
def test_a_folder_replaced_while_the_run_lasts(tmp_path: Path, existing: bool, force: bool) -> None:
    """By one with files of the user, and by a link to such a one."""
    mine, out = tmp_path / "mine", tmp_path / "out"
    for link in (False, True):
        if existing:
            out.mkdir()
        mine.mkdir()
        (mine / "run.json").write_text("mine")
        (mine / "thesis.tex").write_text("mine")
        with (
            pytest.raises((TwinError, OSError)),
            results_folder(out, force) as folder,
        ):
            (folder / "run.json").write_text("new")
            shutil.rmtree(out, ignore_errors=True)
            if link:
                out.symlink_to(mine)
            else:
                mine.rename(out)
        assert tree(out) == {"run.json": "mine", "thesis.tex": "mine"}
        if link:
            out.unlink()
        else:
            shutil.rmtree(out)
        shutil.rmtree(mine, ignore_errors=True)


def test_a_file_and_its_record_come_together(tmp_path: Path) -> None:
    path, record = tmp_path / "a.toml", tmp_path / "a.run.json"
    record.write_text('{"verb": "mine"}')
    with pytest.raises(TwinError, match=r"a\.run\.json: exists"), recorded_file(path, False):
        pass
    assert record.read_text() == '{"verb": "mine"}'
    for force in (True, False):
        with recorded_file(path, force) as (file, note):
            file.write_text("new")
            note("calibrate", {}, [])
        assert set(tree(tmp_path)) == {"a.toml", "a.run.json"}
        path.unlink()  # as after a kill between the two
    with (
        pytest.raises(TwinError, match=r"a\.toml: exists"),
        recorded_file(path, False) as (file, note),
    ):
        file.write_text("new")
        note("calibrate", {}, [])
        path.write_text("of another")
    assert path.read_text() == "of another"


def test_an_optional_step_that_fails_leaves_the_rest(tmp_path: Path) -> None:
    steps = OptionalSteps()

    def fails(folder: Path) -> None:
        (folder / "half").write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    def broken(folder: Path) -> None:
        raise ZeroDivisionError

    def series(folder: Path) -> str:
        (folder / "series").mkdir()
        (folder / "series" / "a.csv").write_text("a")
        return "series/"

    with results_folder(tmp_path / "out", force=False) as folder:
        assert steps.run("FMUs", folder, fails) is None
        assert steps.run("series", folder, series) == "series/"
        assert steps.run("page", folder, broken) is None
        assert steps.run("more", folder, series) is None
        (folder / "run.json").write_text(steps.incomplete)
    told = "FMUs: No space left on device; page: ZeroDivisionError(); more: not done"
    assert tree(tmp_path) == {"out/series/a.csv": "a", "out/run.json": told}
    with pytest.raises(ZeroDivisionError):
        steps.finish()
