"""Verbs killed at random moments: nothing half-written, nothing left, and the same command works,
to the same bytes, with two threads as with one.

`UAVTWIN_KILLS=100 pytest tests/uavtwin/test_killed.py` kills a hundred times.
"""

import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from places import IMPORT_PATH

KILLS = int(os.environ.get("UAVTWIN_KILLS", "8"))
COMMANDS = {
    "new": ("export", "barometer"),
    "empty": ("simulate", "hover", "--stop", "0.1", "--fused"),
}
"""By output folder."""


def tree(folder: Path) -> dict[str, bytes]:
    """Content of every file by its path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.slow
def test_killed_at_any_moment(tmp_path: Path) -> None:
    temporary, cache = tmp_path / "temporary", tmp_path / "cache"
    temporary.mkdir()
    program = [sys.executable, "-c", "from uavtwin.cli.main import main; main()"]
    environment = {**os.environ, "PYTHONPATH": IMPORT_PATH, "TMPDIR": str(temporary)}
    own = {**environment, "UAVTWIN_CACHE": str(cache)}

    def begin(out: str, threads: int = 1) -> subprocess.Popen[bytes]:
        """The command of an output folder; the export with a cache that suffers with it."""
        given = (own if out == "new" else environment) | {"OMP_NUM_THREADS": str(threads)}
        command = [*program, *COMMANDS[out], "--out", out]
        return subprocess.Popen(command, cwd=tmp_path, env=given, stderr=subprocess.PIPE)

    def fresh(out: str) -> None:
        """As before the first run."""
        shutil.rmtree(tmp_path / out, ignore_errors=True)
        if out == "empty":
            (tmp_path / out).mkdir()

    whole, lasted = {}, {}
    for out in COMMANDS:
        fresh(out)
        shutil.rmtree(cache, ignore_errors=True)
        begun = time.monotonic()
        run = begin(out)
        _, told = run.communicate()
        assert run.returncode == 0, told
        lasted[out], whole[out] = time.monotonic() - begun, tree(tmp_path / out)
        fresh(out)
    clock = random.Random(int(os.environ.get("UAVTWIN_SEED", "0")))
    for k in range(KILLS):
        out = list(COMMANDS)[k % len(COMMANDS)]
        if k % 2:
            shutil.rmtree(cache, ignore_errors=True)
        run = begin(out)
        time.sleep(lasted[out] * clock.uniform(0.2, 1.05))
        run.kill()
        run.communicate()
        if (tmp_path / out).is_dir() and out != "empty":  # a new folder appears whole
            assert tree(tmp_path / out) == whole[out]
        if tree(tmp_path / out).keys() == whole[out].keys():
            fresh(out)  # it was faster
    for out in COMMANDS:
        run = begin(out, threads=2)
        _, told = run.communicate()
        assert run.returncode == 0, told
        assert tree(tmp_path / out) == whole[out]
    left = {p.name for place in (tmp_path, temporary, cache) for p in place.iterdir()}
    assert {name for name in left if name.startswith((".", "uavtwin"))} == set()
    assert list(temporary.iterdir()) == []
    assert {p.name for p in tmp_path.iterdir()} == {*COMMANDS, "temporary", "cache"}
