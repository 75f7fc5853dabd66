"""`python -m cosim.worker REQUESTS ANSWERS TRACE BYTES`: the worker, started only by `Process`.

A master that receives requests, one JSON text per line, and answers them. No request comes from an
FMU, and answers are only text and numbers, of which the reader executes nothing.
"""

import json
import os
import queue
import resource
import signal
import socket
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from twin.errors import TwinError

from ..calls import SharedTrace
from ..master import Master, RunError
from ..system import Connection, System

Answer = Callable[[Mapping[str, Any]], None]


def serve(requests: int, answers: int, trace: int, memory_bytes: int) -> None:
    """Answer until the request to close; ends this process.

    Args:
        requests: Socket to read from; its end means that the parent process has ended.
        answers: File to write to.
        trace: File of the trace.
        memory_bytes: Limit of writable memory.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # from an FMU, which may end the process
    lines: queue.SimpleQueue[tuple[bytes, list[int]]] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(requests, lines), daemon=True).start()

    shared = SharedTrace(trace)

    def answer(content: Mapping[str, Any]) -> None:
        shared.check_process()
        os.write(answers, json.dumps(content).encode() + b"\n")

    server = _Server(shared, answer)
    while True:
        line, files = lines.get()
        request = json.loads(line)
        for file in files:
            shared.take_table(file)
        try:
            done = getattr(server, request.pop("do"))(**request)
        except RunError as error:
            r = error.recording
            answer({"failed": str(error), "run": [r.steps, r.rejected, r.lateness_s]})
        except TwinError as error:
            answer({"refused": str(error)})
        except Exception as error:  # out of memory, or an internal error
            answer({"refused": f"the process of the FMUs: {type(error).__name__}: {error}"})
        else:
            answer({"done": done})


def _read(file: int, lines: "queue.SimpleQueue[tuple[bytes, list[int]]]") -> None:
    """Forward lines with their files; when the parent process has ended, end this process and all
    processes started by FMUs."""
    pending, files = b"", list[int]()
    with suppress(OSError), socket.socket(fileno=file) as stream:
        while True:
            data, more, _, _ = socket.recv_fds(stream, 2**16, 4)
            if not data:
                break
            files += more
            *whole, pending = (pending + data).split(b"\n")
            for line in whole:
                lines.put((line, files))
                files = []
    os.killpg(0, signal.SIGKILL)


class _Server:
    """Requests of the worker, by name."""

    def __init__(self, trace: SharedTrace, answer: Answer) -> None:
        self._trace, self._answer = trace, answer

    def load(
        self, fmus: Mapping[str, str], connections: list[list[str]], record: Any, **more: Any
    ) -> list[str]:
        """Load a system; names of the recorded columns."""
        system = System(
            {name: Path(path) for name, path in fmus.items()},
            tuple(Connection(*ends) for ends in connections),
            **more,
        )
        self._master = Master(system, record, self._trace)
        return list(self._master.record_names)

    def initialize(self, **arguments: Any) -> None:
        """Initialise the master."""
        self._master.initialize(**arguments)

    def run(self, **arguments: Any) -> list[float]:
        """Run the master; returns steps, rejected steps, lateness. The rows are in the trace."""
        r = self._master.run(progress=self._progress, **arguments)
        return [r.steps, r.rejected, r.lateness_s]

    def run_adaptive(self, **arguments: Any) -> list[float]:
        """Run the master with step-size control."""
        r = self._master.run_adaptive(progress=self._progress, **arguments)
        return [r.steps, r.rejected, r.lateness_s]

    def close(self) -> None:
        """Free everything."""
        self._master.close()

    def _progress(self, time_s: float) -> None:
        self._answer({"progress": time_s})


if __name__ == "__main__":
    serve(*map(int, sys.argv[1:]))
