"""Temporary files of dead processes are taken away, those of the living and of others are not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import IMPORT_PATH

from twin.scratch import PREFIX, leftovers, scratch_file, scratch_folder, started, sweep

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


def killed_in(place: Path) -> None:
    """A process that is killed while it writes there."""
    environment = {**os.environ, "PYTHONPATH": IMPORT_PATH}
    ended = subprocess.run([sys.executable, "-c", KILLED, str(place)], env=environment, check=False)
    assert ended.returncode == -9
    assert len(list(place.glob(f"{PREFIX}*"))) == 2


def test_what_the_dead_left_is_swept(tmp_path: Path) -> None:
    killed_in(tmp_path)
    with scratch_folder(tmp_path) as folder:
        assert list(tmp_path.iterdir()) == [folder]
        sweep(tmp_path)  # the living keep theirs
        assert folder.is_dir()
    assert list(tmp_path.iterdir()) == []


def test_another_process_of_the_same_number_is_not_the_owner(tmp_path: Path) -> None:
    with scratch_folder(tmp_path) as folder:
        mine = str(started(os.getpid()))
        other = tmp_path / folder.name.replace(f"-{mine}-", f"-{int(mine) - 1}-")
        other.mkdir()
        assert list(leftovers(tmp_path)) == [other]


def test_what_is_not_ours_stays(tmp_path: Path) -> None:
    """Of another host, with which a folder is shared; of another program; a link to elsewhere."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine.txt").write_text("mine")
    for name in (f"{PREFIX}otherhost-1-2-abc", f"{PREFIX}mine", "mine"):
        (tmp_path / name).mkdir()
    killed_in_name = next(iter(_dead_name(tmp_path)))
    (tmp_path / killed_in_name).symlink_to(tmp_path / "elsewhere")
    sweep(tmp_path)
    left = {p.name for p in tmp_path.iterdir()}
    assert left == {"elsewhere", f"{PREFIX}otherhost-1-2-abc", f"{PREFIX}mine", "mine"}
    assert (tmp_path / "elsewhere" / "mine.txt").read_text() == "mine"


def _dead_name(place: Path) -> list[str]:
    with scratch_folder(place) as folder:
        mine = str(started(os.getpid()))
        return [folder.name.replace(f"-{mine}-", "-1-")]


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(ValueError, match="no"), scratch_file(tmp_path / "a.txt") as file:
        file.write_text("half")
        raise ValueError("no")
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"
    with scratch_file(tmp_path / "a.txt") as file:
        file.write_text("new")
    (tmp_path / "b.txt").touch()
    assert (tmp_path / "a.txt").read_text() == "new"
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "b.txt").stat().st_mode
