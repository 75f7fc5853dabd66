"""Jobs that harm their process, for the engines."""

import os
import signal
import time
from dataclasses import dataclass, field
from pathlib import Path

from uavtwin.jobs.process import JobLimits, ProcessWorker, Progress


@dataclass(frozen=True)
class Harm:
    """Does what its job says."""

    key: str = "harm"
    allowed: JobLimits = field(default_factory=JobLimits)

    def name(self, job: str) -> str:
        return job

    def worker(self) -> ProcessWorker[str, str]:
        return ProcessWorker(self, str, self.lost, self.allowed)

    def packed(self) -> "Harm":
        return self

    def unpacked(self, folder: Path) -> "Harm":
        return self

    def lost(self, job: str, why: str) -> str:
        return f"{job}: lost, {why}"

    def do(self, job: str, progress: Progress) -> str | float:
        what = job.partition(" ")[0]
        if what == "count":
            for k in range(5):
                time.sleep(0.3)
                progress(k / 5)
        if what == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        if what == "hang":
            time.sleep(600)
        if what == "hoard":
            held = bytearray(3 * 2**30)
            return f"{job}: {len(held)} bytes"
        if what == "exit":
            os._exit(3)
        if what == "number":
            return float("nan")  # no JSON
        return f"{job}: {os.getpid()}"
