"""A disk that is full at the end of a verb: the answer is printed, what has room is written."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from places import IMPORT_PATH

from benchmarks.repeatability import PROGRAM, tree, write_flights

PAGE = 4096
MOUNTED = """
mount -t tmpfs -o size="$1" none "$2" && cd "$4" || exit 9
out="$2" kept="$3"; shift 4
"$@"; code=$?
cp -a "$out/." "$kept"; exit $code
"""
"""Runs a command while a folder is a small disk, and copies what it holds then."""


def gap(work: Path, out: str, disk_bytes: int = 0) -> subprocess.CompletedProcess[str]:
    """`uavtwin gap` into a folder; of a small disk, which is copied to it at the end."""
    words = (*PROGRAM, "gap", "one.parquet", "--vehicle", "copter_default", "--csv", "--out")
    command = [*words, out]
    if disk_bytes:
        for place in ("disk", out):
            (work / place).mkdir(exist_ok=True)
        disk, kept = str(work / "disk"), str(work / out)
        before = ("unshare", "-m", "sh", "-c", MOUNTED, "sh", str(disk_bytes), disk, kept)
        command = [*before, str(work), *words, disk]
    environment = {**os.environ, "PYTHONPATH": IMPORT_PATH}
    return subprocess.run(
        command, cwd=work, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("unshare"), reason="needs root, unshare")
def test_what_has_room_is_written_and_the_rest_is_told(tmp_path: Path) -> None:
    write_flights(tmp_path)
    fine = gap(tmp_path, "fine")
    assert fine.returncode == 0, fine.stderr
    whole = tree(tmp_path / "fine")
    first = [name for name in whole if not name.startswith("series/")]
    size = sum(-(-len(whole[name]) // PAGE) * PAGE for name in first)
    part = gap(tmp_path, "part", size + 12 * PAGE)
    assert part.returncode == 1, part.stderr
    assert "warning: series: No space left on device" in part.stderr
    found = tree(tmp_path / "part")
    assert found.keys() == set(first) == {"gap.json", "report.html", "run.json"}
    record = json.loads(found.pop("run.json"))
    assert record.pop("incomplete") == "series: No space left on device"
    assert record == json.loads(whole["run.json"])
    assert all(whole[name] == content for name, content in found.items())
    nothing = gap(tmp_path, "nothing", 4 * PAGE)
    assert nothing.returncode == 2
    assert "disk: cannot be written: No space left on device" in nothing.stderr
    assert tree(tmp_path / "nothing") == {}
    told = fine.stdout.partition("written: ")[0]
    assert told and nothing.stdout == told and part.stdout.startswith(told)
