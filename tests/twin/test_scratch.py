"""Scratch folders of owners proven dead are swept; those of the living and of others are not."""

import errno
import fcntl
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from places import IMPORT_PATH

from twin import scratch
from twin.scratch import LOCK, PREFIX, leftovers, scratch_file, scratch_folder, started, sweep

ENVIRONMENT = {**os.environ, "PYTHONPATH": IMPORT_PATH}
KILLED = """
import os, signal, sys
from pathlib import Path
from twin.scratch import scratch_file, scratch_folder
place = Path(sys.argv[1])
with scratch_folder(place) as folder, scratch_file(place / "a.txt") as file:
    (folder / "half").write_text("half")
    file.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""
WORKING = """
import sys
from pathlib import Path
from twin.scratch import scratch_folder
with scratch_folder(Path(sys.argv[1])) as folder:
    (folder / "work").write_text("work")
    print(folder.name, flush=True)
    sys.stdin.read()
    assert (folder / "work").read_text() == "work"
print("fine", flush=True)
"""
"""Writes until its stdin is closed."""


def killed_in(place: Path) -> None:
    """A process that is killed while it writes there."""
    command = [sys.executable, "-c", KILLED, str(place)]
    assert subprocess.run(command, env=ENVIRONMENT, check=False).returncode == -9
    assert len(list(place.glob(f"{PREFIX}*"))) == 2


def working_in(place: Path, *before: str) -> tuple[subprocess.Popen[str], Path]:
    """A process that is writing there, and its scratch folder."""
    command = [*before, sys.executable, "-c", WORKING, str(place)]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, env=ENVIRONMENT, stdin=pipe, stdout=pipe, text=True)
    assert process.stdout is not None
    return process, place / process.stdout.readline().strip()


def named(
    place: Path, boot: str = "", namespace: int = 0, pid: int = 2**22, start: int = 1
) -> Path:
    """A leftover of this form; by default of this boot and namespace, of a process that is gone."""
    with scratch_folder(place) as folder:
        host, *parts = folder.name.removeprefix(PREFIX).split("-")
    found = [boot or parts[0], namespace or parts[1], pid, start, "abc"]
    made = place / (PREFIX + "-".join([host, *map(str, found)]))
    made.mkdir()
    return made


def test_what_the_dead_left_is_swept(tmp_path: Path) -> None:
    killed_in(tmp_path)
    with scratch_folder(tmp_path) as folder:
        assert list(tmp_path.iterdir()) == [folder]
        sweep(tmp_path)  # the living keep theirs
        assert folder.is_dir()
    assert list(tmp_path.iterdir()) == []


def test_a_living_process_keeps_its_folder(tmp_path: Path) -> None:
    """Under its own name; under that of another namespace, where the lock alone speaks."""
    process, folder = working_in(tmp_path)
    with process:
        sweep(tmp_path)
        assert (folder / "work").is_file()
        host, boot, namespace, *rest = folder.name.removeprefix(PREFIX).split("-")
        other = tmp_path / (PREFIX + "-".join([host, boot, str(int(namespace) + 1), *rest]))
        folder.rename(other)
        sweep(tmp_path)
        assert (other / "work").is_file()
        process.kill()
        process.wait()
        sweep(tmp_path)
        assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("unshare"), reason="needs root, unshare")
def test_two_pid_namespaces_share_a_folder(tmp_path: Path) -> None:
    """Each has a process 1, and neither sees the other's."""
    apart = ("unshare", "-pf", "--mount-proc", "--kill-child")
    first, folder = working_in(tmp_path, *apart)
    second, other = working_in(tmp_path, *apart)
    for process, own in ((first, folder), (second, other)):
        with process:
            sweep(tmp_path)
            assert (own / "work").is_file()
            assert process.communicate("")[0] == "fine\n"
    killed, folder = working_in(tmp_path, *apart)
    with killed:
        killed.kill()
    deadline = time.monotonic() + 60.0  # the namespace takes a moment to be gone
    while folder.exists() and time.monotonic() < deadline:
        sweep(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_process_that_has_not_locked_yet_keeps_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In whatever namespace; the next owner sweeps between the two."""
    lock = scratch._lock
    other = named(tmp_path, namespace=1)
    script = "import sys; from pathlib import Path; from twin.scratch import sweep; "
    command = [sys.executable, "-c", f"{script} sweep(Path(sys.argv[1]))", str(tmp_path)]

    def late(folder: Path) -> int | None:
        sweep(tmp_path)
        subprocess.run(command, env=ENVIRONMENT, check=True)
        assert folder.is_dir()
        assert other.is_dir()
        return lock(folder)

    monkeypatch.setattr(scratch, "_lock", late)
    with scratch_folder(tmp_path) as folder:
        (folder / "work").touch()


def test_where_nothing_can_be_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks")

    left = named(tmp_path)
    foreign = named(tmp_path, namespace=1)
    monkeypatch.setattr(fcntl, "flock", refused)
    with scratch_folder(tmp_path) as folder:
        assert not (folder / LOCK).exists()
        sweep(tmp_path)
        assert {p.name for p in tmp_path.iterdir()} == {folder.name, foreign.name}
    assert not left.exists()
    (foreign / LOCK).touch()
    sweep(tmp_path)
    assert list(tmp_path.iterdir()) == [foreign]


def test_another_process_of_the_same_number_is_not_the_owner(tmp_path: Path) -> None:
    start = started(os.getpid())
    assert start is not None
    left = named(tmp_path, pid=os.getpid(), start=start - 1)
    assert list(leftovers(tmp_path)) == [left]
    own = named(tmp_path, pid=os.getpid(), start=start)
    sweep(tmp_path)
    assert list(tmp_path.iterdir()) == [own]


def test_processes_of_another_namespace_in_proc_prove_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`unshare --pid` without `--mount-proc`: numbers in /proc are those of others."""
    left = named(tmp_path)
    read = os.readlink
    monkeypatch.setattr(os, "readlink", lambda path: "1" if path == "/proc/self" else read(path))
    sweep(tmp_path)
    assert left.is_dir()


def test_what_is_not_ours_stays(tmp_path: Path) -> None:
    """Of another boot, its lock free; of older versions and other programs; links, files."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / LOCK).touch()
    other = named(tmp_path, boot="0123456789ab")
    (other / LOCK).touch()
    ours = named(tmp_path)
    ours.rmdir()
    ours.symlink_to(tmp_path / "elsewhere")
    file = named(tmp_path, start=2)
    file.rmdir()
    file.write_text("mine")
    for name in (f"{PREFIX}host-1-1-abc", f"{PREFIX}mine", "mine"):
        (tmp_path / name).mkdir()
    before = sorted(tmp_path.rglob("*"))
    sweep(tmp_path)
    assert sorted(tmp_path.rglob("*")) == before
    assert ours.is_symlink()


SWARM = """
import os, random, signal, sys
from pathlib import Path
from twin.scratch import scratch_folder
clock = random.Random(int(sys.argv[2]))
for k in range(40):
    with scratch_folder(Path(sys.argv[1])) as folder:
        (folder / "work").write_text(str(k))
        if clock.random() < 0.1 and os.fork() == 0:
            with scratch_folder(Path(sys.argv[1])):
                os.kill(os.getpid(), signal.SIGKILL)
        assert (folder / "work").read_text() == str(k)
"""


@pytest.mark.slow
def test_many_processes_in_one_folder(tmp_path: Path) -> None:
    """They come, sweep, die and are swept at once; no living one ever loses its files."""
    swarm = [
        subprocess.Popen([sys.executable, "-c", SWARM, tmp_path, str(n)], env=ENVIRONMENT)
        for n in range(4)
    ]
    assert [process.wait() for process in swarm] == [0] * 4
    deadline = time.monotonic() + 60.0  # the last that were killed take a moment to be gone
    while any(tmp_path.iterdir()) and time.monotonic() < deadline:
        sweep(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(ValueError, match="no"), scratch_file(tmp_path / "a.txt") as file:
        file.write_text("half")
        raise ValueError("no")
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"
    with scratch_file(tmp_path / "a.txt") as file:
        assert file.name == "a.txt"
        file.write_text("new")
    (tmp_path / "b.txt").touch()
    assert (tmp_path / "a.txt").read_text() == "new"
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "b.txt").stat().st_mode
