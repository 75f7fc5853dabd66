"""`python -m cosim.worker REQUESTS ANSWERS TRACE BYTES`: the worker, which `Process` alone starts.

A master that takes requests, one JSON text a line, and answers them. No request comes from an FMU,
and no answer is more than text and numbers: its reader runs nothing of it.
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
    """Answer until asked to close; ends this process.

    Args:
        requests: Socket to read from; at its end the asking process is no more.
        answers: File to write to.
        trace: File of the trace.
        memory_bytes: Limit of writable memory.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # from an FMU: it is not ours to handle
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
        except Exception as error:  # memory used up, or a mistake of ours
            answer({"refused": f"the process of the FMUs: {type(error).__name__}: {error}"})
        else:
            answer({"done": done})


def _read(file: int, lines: "queue.SimpleQueue[tuple[bytes, list[int]]]") -> None:
    """Pass lines on with the files that came with them; when who asks is gone, end this process and
    all that FMUs started."""
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
    """What can be asked, by name."""

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
        """As the master's."""
        self._master.initialize(**arguments)

    def run(self, **arguments: Any) -> list[float]:
        """As the master's; steps, rejected steps, lateness. The rows are in the trace."""
        r = self._master.run(progress=self._progress, **arguments)
        return [r.steps, r.rejected, r.lateness_s]

    def run_adaptive(self, **arguments: Any) -> list[float]:
        """As the master's."""
        r = self._master.run_adaptive(progress=self._progress, **arguments)
        return [r.steps, r.rejected, r.lateness_s]

    def close(self) -> None:
        """Free everything."""
        self._master.close()

    def _progress(self, time_s: float) -> None:
        self._answer({"progress": time_s})


if __name__ == "__main__":
    serve(*map(int, sys.argv[1:]))
