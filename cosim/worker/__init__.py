"""Master in a separate worker process, so that a crash of an FMU is an error.

The whole loop runs in the worker, so a step costs the same as in this process. The recording is in
shared memory, so it remains available if the worker dies. The worker is ended with all its child
processes.
"""

import contextlib
import json
import os
import resource
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import wraps
from inspect import signature
from math import isfinite
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, cast

import numpy as np

from fmus.names import shown
from twin.errors import FmuError

from ..calls import HEADER, TraceEntry, read_table, read_trace, shared_file, table_bytes
from ..compiled import library
from ..limits import Limits, exit_text
from ..master import Master
from ..recording import Interrupted, Recording, RunError
from ..system import System

_TICK_S = 0.05
"""Interval at which the worker's trace is read, s. Made up."""
_START_S = 60.0
"""Time limit for the start of Python, on a busy machine."""
_PRINTED_BYTES = 2**16
"""Size of the last part of a worker's output that is included in an error."""
_ANSWER_BYTES = 2**20
"""Longest answer that is accepted."""


_SPOILT = "its process wrote into what belongs to uavtwin"  # end of a message
_KINDS = {"done", "failed", "refused", "progress"}
"""Kinds of answers."""


class Ended(Exception):  # noqa: N818
    """The worker cannot answer any more; the text states how it ended."""


class Process:
    """A worker process with its files.

    Attributes:
        trace: File of its trace.
        table: File of its last recording.
        running: Whether the worker has not been ended.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits, self._left_s = limits, limits.whole_s
        self._folder = tempfile.TemporaryDirectory(prefix="uavtwin-", ignore_cleanup_errors=True)
        self.trace, self.table = shared_file(HEADER), shared_file(0)
        self._printed, self._pending = bytearray(), bytearray()
        requests, self._requests = socket.socketpair()
        self._requests.shutdown(socket.SHUT_RD)  # input written by an FMU is discarded
        self._answers, answers = os.pipe()
        self._output, output = os.pipe()
        given = (requests.fileno(), answers, self.trace)
        self._peak_before = _peak_bytes(resource.getrusage(resource.RUSAGE_SELF))
        try:
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-P",
                    "-m",
                    "cosim.worker",
                    *map(str, given),
                    str(limits.memory_bytes),
                ],
                cwd=self._folder.name,
                env={
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)),
                    "TMPDIR": self._folder.name,  # its temporary files are deleted with the folder
                },
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                pass_fds=given,
                start_new_session=True,  # a separate process group, which is ended as a whole
            )
        finally:
            requests.close()
            for file in (answers, output):
                os.close(file)
        self._selector = selectors.DefaultSelector()
        for file in (self._answers, self._output):
            os.set_blocking(file, False)
            self._selector.register(file, selectors.EVENT_READ)
        self.running = True

    @property
    def printed(self) -> str:
        """The last part of its output."""
        return self._printed.decode(errors="replace")

    def ask(
        self,
        request: Mapping[str, Any],
        progress: Callable[[float], None] | None = None,
        clocked_s: float | None = None,
        table: int | None = None,
    ) -> Mapping[str, Any]:
        """Answer to a request.

        Args:
            request: Name of the request, with its arguments.
            progress: Called with the time reached.
            clocked_s: Duration of a run in real time.
            table: Size of the recording, bytes; None: no recording.

        Raises:
            Ended: There is no answer; the worker was ended, or has ended.
            OSError: There is no memory for the recording.
        """
        if not self.running:
            raise Ended("its process had been ended before")
        line = json.dumps(request).encode() + b"\n"
        files = []
        if table is not None:
            os.close(self.table)
            self.table = -1
            self.table = shared_file(table)
            files.append(self.table)
        begin = time.monotonic()
        try:
            socket.send_fds(self._requests, [line[:1]], files)
            self._requests.sendall(line[1:])
            return self._wait(progress, begin, clocked_s)
        except ConnectionError:
            raise Ended(self._end()) from None
        except BaseException:
            self.end()
            raise
        finally:
            self._left_s -= max(0.0, time.monotonic() - begin - (clocked_s or 0.0))

    def begin(self) -> None:
        """Start of a run: its total time limit starts again."""
        self._left_s = self._limits.whole_s

    def _wait(
        self, progress: Callable[[float], None] | None, begin: float, clocked_s: float | None
    ) -> Mapping[str, Any]:
        seen, since = read_trace(self.trace), begin
        while True:
            for content in self._read(_TICK_S):
                if "progress" not in content:
                    return content
                if progress is not None:
                    progress(float(content["progress"]))
            if self._ended():
                for content in self._read(0.0):
                    if "progress" not in content:
                        return content
                raise Ended(self._end())
            now, entry = time.monotonic(), read_trace(self.trace)
            if entry != seen:
                seen, since = entry, now
            waits_for_clock = clocked_s is not None and not entry.busy
            limit_s = self._limits.call_s if entry.who else max(_START_S, self._limits.call_s)
            if now - since > limit_s and not waits_for_clock:
                raise Ended(f"did not return within {limit_s:g} s, the limit (--call-limit)")
            if now - begin - (clocked_s or 0.0) > self._left_s:
                raise Ended(
                    f"the {self._limits.whole_s:g} s for the whole run are used up (--time-limit)"
                )

    def _read(self, wait_s: float) -> list[Mapping[str, Any]]:
        """Answers received so far; stores printed output."""
        for key, _ in self._selector.select(wait_s):
            data = os.read(key.fd, 2**16)
            if not data:
                self._selector.unregister(key.fd)
            elif key.fd == self._output:
                self._printed += data
                del self._printed[:-_PRINTED_BYTES]
            else:
                self._pending += data
        *lines, self._pending = self._pending.split(b"\n")
        if len(self._pending) > _ANSWER_BYTES:
            raise Ended(_SPOILT)
        return [_answer(bytes(line)) for line in lines]

    def _ended(self) -> bool:
        """Whether the process has ended; its resource usage is stored."""
        if self._process.returncode is None:
            pid, status, usage = os.wait4(self._process.pid, os.WNOHANG)
            if pid:
                self._process.returncode = os.waitstatus_to_exitcode(status)
                peak = _peak_bytes(usage)  # a new process starts with the peak of its parent
                self._peak_bytes = peak if peak > self._peak_before else 0
        return self._process.returncode is not None

    def _end(self) -> str:
        """End it and describe how it had ended."""
        deadline = time.monotonic() + 1.0
        while not self._ended() and time.monotonic() < deadline:
            time.sleep(0.01)
        code = self._process.returncode
        self.end()
        if code is None:
            return "its process answers no more"
        text = f"its process ended with {exit_text(code)}"
        if self._peak_bytes > 0.7 * self._limits.memory_bytes:
            text += (
                f" after {self._peak_bytes / 2**30:.1f} of the {self._limits.memory_gib:g} GiB of "
                f"memory that it may use (--memory-limit)"
            )
        return text

    def end(self) -> None:
        """Kill it with its process group, and remove its files; a second call has no effect."""
        if not self.running:
            return
        self.running = False
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        with contextlib.suppress(Ended):
            self._read(0.0)  # the last printed output
        self._selector.close()
        self._requests.close()
        for file in (self._answers, self._output):
            os.close(file)
        self._folder.cleanup()

    def entry(self) -> TraceEntry:
        """The present call, or the last one."""
        return read_trace(self.trace)

    def spoilt(self) -> Ended:
        """End it, since its answer can only come from other code in its process."""
        self.end()
        return Ended(_SPOILT)

    def forget(self) -> None:
        """Close the trace and the recording, after `end`."""
        for file in (self.trace, self.table):
            if file >= 0:
                os.close(file)
        self.trace = self.table = -1


def _answer(line: bytes) -> Mapping[str, Any]:
    """One answer.

    Raises:
        Ended: The line is no answer.
    """
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        content = None
    if not (isinstance(content, dict) and _KINDS & content.keys()):
        raise Ended(_SPOILT)
    done = content.get("progress", 0.0)
    if not (isinstance(done, int | float) and abs(done) < float("inf")):
        raise Ended(_SPOILT)
    return content


def _peak_bytes(usage: resource.struct_rusage) -> int:
    """Largest resident size of a process."""
    return int(usage.ru_maxrss) * (1 if sys.platform == "darwin" else 1024)


Progress = Callable[[float], None]
P = ParamSpec("P")
"""Arguments of a run."""


def _in_worker(
    method: Callable[Concatenate[Master, P], Recording],
) -> Callable[Concatenate["WorkerMaster", P], Recording]:
    """A run of `Master`, with its arguments and errors, executed in the worker.

    `RunError` also reports that an FMU ended the worker.
    """
    arguments = signature(method)

    @wraps(method)
    def run(self: "WorkerMaster", *args: P.args, **kwargs: P.kwargs) -> Recording:
        bound = arguments.bind(self, *args, **kwargs)
        bound.apply_defaults()
        _, *given = bound.arguments.items()  # the first is the master
        request = dict(given)
        progress = request.pop("progress")
        return self._record({"do": method.__name__, **request}, progress)

    return cast("Callable[Concatenate[WorkerMaster, P], Recording]", run)


class WorkerMaster:
    """`Master`, method by method, in a worker; after a crash or Ctrl-C a new one is needed."""

    def __init__(
        self, system: System, record: Sequence[str] | None = None, limits: Limits | None = None
    ) -> None:
        """Start a worker and load the FMUs.

        Raises:
            FmuError: As in `Master`, or an FMU ended the worker.
        """
        self.system, self._record_only, self._limits = system, record, limits or Limits()
        self._last: Recording | None = None
        self._start()

    def _start(self) -> None:
        """A worker with all FMUs loaded."""
        system, record = self.system, self._record_only
        self._time_s, self._step_s, self._rows = system.start_time_s, 0.0, 0
        library()  # into the cache: the worker has limits of memory and time
        self._process = Process(self._limits)
        try:
            names = self._ask(
                "load",
                fmus={name: str(path.absolute()) for name, path in system.fmus.items()},
                connections=[[c.source, c.target] for c in system.connections],
                starts=dict(system.starts),
                periods=dict(system.periods),
                start_time_s=system.start_time_s,
                record=None if record is None else list(record),
            )
            if not (isinstance(names, list) and all(isinstance(n, str) for n in names)):
                raise FmuError(self._fault(str(self._process.spoilt())))
            self.record_names = tuple(names)
        except BaseException:
            self._process.end()
            self._process.forget()
            raise

    def initialize(
        self,
        start_time_s: float | None = None,
        starts: Mapping[str, float] | None = None,
        stop_time_s: float | None = None,
    ) -> None:
        """Set start values and initialise, as in `Master.initialize`; replaces a worker that ended
        during a reset."""
        self._process.begin()
        arguments = {
            "start_time_s": start_time_s,
            "starts": None if starts is None else dict(starts),
            "stop_time_s": stop_time_s,
        }
        try:
            self._ask("initialize", **arguments)
        except FmuError:
            if self._process.running or self._process.entry().function != "reset":
                raise
            self._process.forget()
            self._start()
            self._ask("initialize", **arguments)
        self._time_s = self.system.start_time_s if start_time_s is None else start_time_s

    run = _in_worker(Master.run)
    run_adaptive = _in_worker(Master.run_adaptive)

    def close(self) -> None:
        """Free all slaves and end the worker.

        Raises:
            RunError: An FMU ended the worker, or did not return; has the last recording.
        """
        if not self._process.running:
            self._process.forget()
            return
        try:
            self._ask("close")
        except FmuError as error:
            if self._last is None:
                raise
            raise RunError(str(error), replace(self._last, incomplete=str(error))) from error
        finally:
            self._process.end()
            self._process.forget()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except FmuError:
            if kind is None:
                raise

    # -- requests ---------------------------------------------------------------------------

    def _record(self, request: Mapping[str, Any], progress: Progress | None) -> Recording:
        """Recording of a run.

        Args:
            request: Method of `Master`, as "do", and its arguments.
            progress: Called with the time reached.

        Raises:
            FmuError, RunError, Interrupted: As in the method.
        """
        self._last = None
        stop_time_s, every = request["stop_time_s"], request.get("every", 1)
        realtime = request.get("realtime")
        clocked_s = (stop_time_s - self._time_s) / realtime if realtime else None
        steps = self._steps(stop_time_s, request["step_s"])
        self._rows = 0 if every < 1 else steps // every + 1
        self._step_s = request["step_s"]
        try:
            answer = self._request(request, progress, clocked_s, self._rows)
        except KeyboardInterrupt:
            why = f"interrupted at {self._process.entry().clock_s:g} s"
            raise Interrupted(self._recording(every, incomplete=why)) from None
        except FmuError as error:
            why = str(error)
            raise RunError(why, self._recording(every, incomplete=why)) from None
        if "refused" in answer:
            raise FmuError(_text(answer["refused"]))
        failed = "failed" in answer
        why = _text(answer.get("failed", ""))
        try:
            done, rejected, lateness_s = answer["run"] if failed else answer["done"]
            counts = int(done), int(rejected), float(lateness_s)
        except (KeyError, TypeError, ValueError, OverflowError):
            counts, why = (0, 0, 0.0), self._fault(str(self._process.spoilt()))
        self._last = self._recording(every, *counts, why)
        if not why and len(self._last.time_s) < self._rows:
            why = self._fault(str(self._process.spoilt()))
            self._last = replace(self._last, incomplete=why)
        if why:
            raise RunError(why, self._last)
        self._time_s += steps * request["step_s"]
        return self._last

    def _steps(self, stop_time_s: float, step_s: float) -> int:
        """Number of steps of a run, as counted by `Master`; 0 where it refuses to run."""
        steps = (stop_time_s - self._time_s) / step_s if step_s > 0 else 0.0
        return max(0, round(steps)) if isfinite(steps) else 0

    def _recording(
        self,
        every: int,
        steps: int | None = None,
        rejected: int = 0,
        lateness_s: float = 0.0,
        incomplete: str = "",
    ) -> Recording:
        """Recording so far; without a count of steps, those up to its last row."""
        expected_s = np.asarray(self._time_s + every * np.arange(self._rows) * self._step_s)
        time_s, values = read_table(self._process.table, expected_s, len(self.record_names))
        if steps is None:
            steps = every * max(0, len(time_s) - 1)
        printed = self._process.printed
        return Recording(
            self.record_names, time_s, values, steps, rejected, lateness_s, incomplete, printed
        )

    def _ask(self, do: str, **arguments: Any) -> Any:
        answer = self._request({"do": do, **arguments})
        if "done" not in answer:
            raise FmuError(_text(answer.get("refused", answer.get("failed"))))
        return answer["done"]

    def _request(
        self,
        request: Mapping[str, Any],
        progress: Progress | None = None,
        clocked_s: float | None = None,
        rows: int | None = None,
    ) -> Mapping[str, Any]:
        table = None if rows is None else table_bytes(rows * (1 + len(self.record_names)))
        try:
            return self._process.ask(request, progress, clocked_s, table)
        except Ended as ended:
            raise FmuError(self._fault(str(ended))) from None
        except (OSError, OverflowError) as error:
            raise FmuError(
                f"no room for a recording of {rows} rows and {len(self.record_names)} columns: "
                f"{error}. Record less often (--interval), or a shorter run."
            ) from error

    def _fault(self, what: str) -> str:
        """Text on the FMU, function and time of a crash, and the end of the worker."""
        entry = self._process.entry()
        if not entry.who:
            printed = shown(self._process.printed.strip()[-300:], 400)
            return f"the process for the FMUs of this system: {what}. It printed {printed}."
        place = entry.function if entry.busy else f"after {entry.function}"
        return f"{entry.who}: {place} at {entry.clock_s:g} s: {what}."


def _text(content: Any) -> str:
    """An answer as text on one line."""
    return " ".join(str(content).split())
