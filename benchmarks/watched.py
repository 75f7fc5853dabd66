"""What a verb costs that keeps a journal: its time, its memory, and kills that it goes on after."""

import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

COMMAND = (sys.executable, "-c", "from uavtwin.cli.main import main; main()")
_LOOK_S = 0.05


def watched(
    arguments: Sequence[str], out: Path, journal: Path, kills: int, between: tuple[int, int]
) -> dict[str, Any]:
    """Run `uavtwin` with arguments, again after each kill, to its end.

    Args:
        arguments: Of the command line.
        out: Folder of its results.
        journal: File that has a line more with each job that is done.
        kills: How often it is killed (SIGKILL).
        between: Jobs from one start to the kill, at least and at most; drawn with seed 1.

    Returns:
        What it cost. Memory is that of the process alone, without its children: the largest, and
        the least and the most after a tenth of the jobs of the last start, from Linux' status file.
    """
    rng, killed, peak = random.Random(1), 0, 0
    begun, before = time.monotonic(), children_s()
    while True:
        lines = _lines(journal)
        wanted = lines + rng.randint(*between) if killed < kills else None
        held: list[tuple[int, int]] = []
        process = subprocess.Popen(
            [*COMMAND, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        while process.poll() is None:
            now, most = _memory_bytes(process.pid)
            done = _lines(journal)
            peak = max(peak, most)
            if now and done:
                held.append((done, now))
            if wanted is not None and done >= wanted:
                os.kill(process.pid, signal.SIGKILL)
                killed += 1
                break
            time.sleep(_LOOK_S)
        code = process.wait()
        if code >= 0:
            break
    settled = [b for d, b in held if d > lines + 0.1 * (held[-1][0] - lines)]
    return {
        "exit_code": code,
        "killed": killed,
        "wall_s": time.monotonic() - begun,
        "cpu_s_without_what_was_killed": children_s() - before,
        "parent_peak_mib": peak / 2**20,
        "parent_mib": [f(settled) / 2**20 for f in (min, max)] if settled else None,
        "dataset_bytes": {p.name: p.stat().st_size for p in sorted(out.glob("*.*"))},
    }


def children_s() -> float:
    """Processor time of the processes that this one has started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def _memory_bytes(pid: int) -> tuple[int, int]:
    """Memory that a process has, and the most that it has had, of Linux."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0, 0
    fields = dict(line.split(":", 1) for line in text.splitlines() if ":" in line)
    now, most = (int(fields.get(k, "0").split()[0]) for k in ("VmRSS", "VmHWM"))
    return 1024 * now, 1024 * most
