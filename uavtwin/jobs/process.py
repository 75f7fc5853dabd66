"""Worker with a separate process for its jobs, restarted when a job ends it."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from typing import Any, Generic, Protocol

from cosim.limits import check_limits, exit_text
from twin.errors import TwinError

from .engine import D, J, J_contra

FRESH = 100
"""Jobs after which a process is replaced, to release memory that libraries never free."""
_START_S = 120.0
"""Time limit for the start of Python, on a busy machine."""


Progress = Callable[[float], None]
"""Function for the completed share of a job, 0..1."""


class JobHandler(Protocol[J_contra]):
    """Object that is sent to the process and does its jobs."""

    def do(self, job: J_contra, progress: Progress, /) -> Any:
        """Result of a job, of JSON types: only this and the completed share are returned."""


@dataclass(frozen=True, slots=True)
class JobLimits:
    """Limits of a job.

    Attributes:
        time_s: Time limit of one job, wall clock.
        memory_gib: Memory limit of its process.
    """

    time_s: float = 3600.0
    memory_gib: float = 4.0

    def __post_init__(self) -> None:
        check_limits(TwinError, **asdict(self))


class ProcessWorker(Generic[J, D]):
    """Worker that does jobs in a process; a crash of one job does not affect the next."""

    def __init__(
        self,
        doer: JobHandler[J],
        read: Callable[[Any], D],
        lost: Callable[[J, str], D],
        allowed: JobLimits | None = None,
    ) -> None:
        """Set up without starting.

        Args:
            doer: Does the jobs, in the process.
            read: Converts its answer to the result of a job.
            lost: Result of a job that ended its process, from the reason.
            allowed: Limits of a job.
        """
        self._doer, self._read, self._lost = doer, read, lost
        self._allowed = allowed or JobLimits()
        self._child: _Child | None = None
        self._done = 0

    def do(self, job: J, progress: Progress = lambda _: None, time_s: float | None = None) -> D:
        """Result of a job.

        Args:
            job: Job to do.
            progress: Called with the completed share, 0..1.
            time_s: Time limit of this job; None: that of all jobs.
        """
        if self._done >= FRESH:
            self.close()
        self._done += 1
        try:
            child = self.start()
            return self._read(child.ask(job, time_s or self._allowed.time_s, progress))
        except _EndedError as error:
            self.close()
            return self._lost(job, str(error))

    def start(self) -> "_Child":
        """The process, started where there is none.

        Raises:
            _EndedError: It does not start.
        """
        if self._child is None:
            self._child, self._done = _Child(self._doer, self._allowed), 0
        return self._child

    def kill(self) -> None:
        """End the process during its job, which is lost; from any thread."""
        if (child := self._child) is not None:
            child.kill()

    def close(self) -> None:
        """End the process."""
        child, self._child = self._child, None
        if child is not None:
            child.end()


class _EndedError(Exception):
    """The process cannot answer any more; the text states the reason."""


class _Child:
    """One process, and its pipes."""

    def __init__(self, doer: JobHandler[Any], allowed: JobLimits) -> None:
        requests, ask = os.pipe()
        answers, answer = os.pipe()
        given = (requests, answer)
        self._memory_gib = allowed.memory_gib
        try:
            self._process = subprocess.Popen(
                [
                    *(sys.executable, "-P", "-m", "uavtwin.jobs.child", *map(str, given)),
                    str(round(allowed.memory_gib * 2**30)),
                ],
                env={
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)),
                },
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=given,
                start_new_session=True,
            )
        finally:
            for file in given:
                os.close(file)
        self._ask, self._answers = Connection(ask), Connection(answers)
        self._send(doer)
        self._receive(_START_S, _START_S)

    def ask(self, job: Any, time_s: float, progress: Progress) -> Any:
        """Result of a job.

        Raises:
            _EndedError: The process has ended, took too long, or its answer is invalid.
        """
        self._send(job)
        until = time.monotonic() + time_s
        while True:
            answer = self._receive(max(0.0, until - time.monotonic()), time_s)
            try:
                content = json.loads(answer)
                if "answer" in content:
                    return content["answer"]
                progress(float(content["done"]))
            except (ValueError, KeyError, TypeError) as error:
                raise _EndedError(f"its process answered what is no answer: {error}") from error

    def _send(self, content: Any) -> None:
        try:
            self._ask.send(content)
        except OSError as error:
            raise _EndedError(self._how()) from error

    def _receive(self, left_s: float, time_s: float) -> bytes:
        try:
            if not self._answers.poll(left_s):
                raise _EndedError(f"took longer than {time_s:g} s, the limit (--time-limit)")
            return self._answers.recv_bytes()
        except (EOFError, OSError) as error:
            raise _EndedError(self._how()) from error

    def _how(self) -> str:
        """Text on how the process ended."""
        try:
            code = self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            return "its process answers no more"
        return (
            f"its process ended with {exit_text(code)}; it may use {self._memory_gib:g} GiB of "
            f"memory (--memory-limit)"
        )

    def kill(self) -> None:
        """Kill it with all its child processes."""
        if self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)

    def end(self) -> None:
        """Kill it and close its pipes."""
        self.kill()
        self._process.wait()
        self._ask.close()
        self._answers.close()
