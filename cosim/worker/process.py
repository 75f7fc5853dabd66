"""One worker process: started, asked, watched, ended with all that it started."""

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
from collections.abc import Callable, Mapping
from typing import Any

from ..limits import Limits
from ..slave.trace import HEADER, TraceEntry, read_trace, shared_file

_TICK_S = 0.05
_START_S = 60.0
"""For Python to start, on a machine that is busy."""
_PRINTED_BYTES = 2**16
_ANSWER_BYTES = 2**20


_SPOILT = "its process wrote into what belongs to uavtwin"
_KINDS = {"done", "failed", "refused", "progress"}
"""Of answers."""


class Ended(Exception):  # noqa: N818
    """The worker can answer nothing any more; the text says what became of it."""


class Process:
    """A worker with files of its own.

    Attributes:
        trace: File of its trace.
        table: File of its last recording.
        running: Whether it was not ended.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits, self._left_s = limits, limits.whole_s
        self._folder = tempfile.TemporaryDirectory(prefix="uavtwin-", ignore_cleanup_errors=True)
        self.trace, self.table = shared_file(HEADER), shared_file(0)
        self._printed, self._pending = bytearray(), bytearray()
        requests, self._requests = socket.socketpair()
        self._requests.shutdown(socket.SHUT_RD)  # what an FMU writes there comes to nothing
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
                    "TMPDIR": self._folder.name,  # what it leaves behind goes with the folder
                },
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                pass_fds=given,
                start_new_session=True,  # a group of its own, which is ended as one
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
        """The end of what it printed."""
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
            request: What to do, with its arguments.
            progress: Called with the time reached.
            clocked_s: Time that a run by the clock takes by itself.
            table: Bytes of the recording that it makes; None: it makes none.

        Raises:
            Ended: There is none; the worker was ended, or is no more.
            OSError: There is no room for the recording.
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
        """A run begins: the time for it as a whole starts again."""
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
        """Answers that have come; keeps what was printed."""
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
        """Whether the process is no more; its use of resources is kept."""
        if self._process.returncode is None:
            pid, status, usage = os.wait4(self._process.pid, os.WNOHANG)
            if pid:
                self._process.returncode = os.waitstatus_to_exitcode(status)
                peak = _peak_bytes(usage)  # of a new process begins at that of who starts it
                self._peak_bytes = peak if peak > self._peak_before else 0
        return self._process.returncode is not None

    def _end(self) -> str:
        """End it and say how it had ended."""
        deadline = time.monotonic() + 1.0
        while not self._ended() and time.monotonic() < deadline:
            time.sleep(0.01)
        code = self._process.returncode
        self.end()
        if code is None:
            return "its process answers no more"
        how = f"exit code {code}"
        if code < 0:
            with contextlib.suppress(ValueError):  # a signal without a name
                how = f"signal {signal.Signals(-code).name}"
        text = f"its process ended with {how}"
        if self._peak_bytes > 0.7 * self._limits.memory_bytes:
            text += (
                f" after {self._peak_bytes / 2**30:.1f} of the {self._limits.memory_gib:g} GiB of "
                f"memory that it may use (--memory-limit)"
            )
        return text

    def end(self) -> None:
        """Kill it and all of its group, and remove its files; twice does no harm."""
        if not self.running:
            return
        self.running = False
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        with contextlib.suppress(Ended):
            self._read(0.0)  # what it printed last
        self._selector.close()
        self._requests.close()
        for file in (self._answers, self._output):
            os.close(file)
        self._folder.cleanup()

    def entry(self) -> TraceEntry:
        """The call under way, or the last one."""
        return read_trace(self.trace)

    def spoilt(self) -> Ended:
        """End it, as it has answered what only others in its process can have written."""
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
        Ended: It is none.
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
