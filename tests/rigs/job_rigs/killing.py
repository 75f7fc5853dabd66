"""Verbs that are killed in the middle of their jobs."""

import os
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path


def killed_beyond(command: Sequence[str | Path], journal: Path, jobs: int) -> bool:
    """Run a command and kill it as soon as its journal has more lines than these; whether it was
    still running then."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and lines_of(journal) <= jobs:
        time.sleep(0.01)
    alive = process.poll() is None
    if alive:
        os.kill(process.pid, signal.SIGKILL)
    process.wait()
    return alive


def lines_of(path: Path) -> int:
    """Whole lines of a file; none of one that is not there."""
    return path.read_bytes().count(b"\n") if path.exists() else 0
