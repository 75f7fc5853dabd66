"""A worker whose jobs are done in a process of their own, restarted when a job ends it."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from multiprocessing.connection import Connection
from typing import Any, Generic, Protocol

from twin.errors import TwinError

from .engine import D, J, J_contra

FRESH = 100
"""Jobs after which a process is replaced: what libraries keep for good does not pile up."""
_START_S = 120.0
"""For Python to start, on a machine that is busy."""


class Doer(Protocol[J_contra]):
    """What is sent to the process."""

    def do(self, job: J_contra, /) -> Any:
        """What comes of a job, as JSON has it: that alone comes back."""


@dataclass(frozen=True, slots=True)
class Allowed:
    """What a job may use.

    Attributes:
        time_s: Of the clock, for one job.
        memory_gib: That its process may ask for.
    """

    time_s: float = 3600.0
    memory_gib: float = 4.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise TwinError(f"limit {name} = {value:g}: needs a positive number.")


class ProcessWorker(Generic[J, D]):
    """Does jobs in a process; whatever a job does to it, the next one is done."""

    def __init__(
        self,
        doer: Doer[J],
        read: Callable[[Any], D],
        lost: Callable[[J, str], D],
        allowed: Allowed | None = None,
    ) -> None:
        """Start nothing yet.

        Args:
            doer: Does the jobs, in the process.
            read: Makes of its answer what comes of a job.
            lost: What comes of a job that ended its process, and why it did.
            allowed: What a job may use.
        """
        self._doer, self._read, self._lost = doer, read, lost
        self._allowed = allowed or Allowed()
        self._child: _Child | None = None
        self._done = 0

    def do(self, job: J) -> D:
        """What comes of a job."""
        if self._done >= FRESH:
            self.close()
        if self._child is None:
            self._child, self._done = _Child(self._doer, self._allowed), 0
        self._done += 1
        try:
            return self._read(self._child.ask(job, self._allowed.time_s))
        except _EndedError as error:
            self.close()
            return self._lost(job, str(error))

    def close(self) -> None:
        """End the process."""
        child, self._child = self._child, None
        if child is not None:
            child.end()


class _EndedError(Exception):
    """The process can answer nothing any more; the text says why."""


class _Child:
    """One process, and the pipes to it."""

    def __init__(self, doer: Doer[Any], allowed: Allowed) -> None:
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
        self._receive(_START_S)

    def ask(self, job: Any, time_s: float) -> Any:
        """What comes of a job.

        Raises:
            _EndedError: The process is no more, took too long, or what it answers is no JSON.
        """
        self._send(job)
        answer = self._receive(time_s)
        try:
            return json.loads(answer)
        except ValueError as error:
            raise _EndedError(f"its process answered what is no JSON: {error}") from error

    def _send(self, content: Any) -> None:
        try:
            self._ask.send(content)
        except OSError as error:
            raise _EndedError(self._how()) from error

    def _receive(self, time_s: float) -> bytes:
        try:
            if not self._answers.poll(time_s):
                raise _EndedError(f"took longer than {time_s:g} s, the limit (--time-limit)")
            return self._answers.recv_bytes()
        except (EOFError, OSError) as error:
            raise _EndedError(self._how()) from error

    def _how(self) -> str:
        """How the process ended."""
        try:
            code = self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            return "its process answers no more"
        how = f"exit code {code}"
        if code < 0:
            with contextlib.suppress(ValueError):  # a signal without a name
                how = f"signal {signal.Signals(-code).name}"
        return (
            f"its process ended with {how}; it may use {self._memory_gib:g} GiB of memory "
            f"(--memory-limit)"
        )

    def end(self) -> None:
        """Kill it."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._ask.close()
        self._answers.close()
