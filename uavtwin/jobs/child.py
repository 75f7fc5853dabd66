"""`python -m uavtwin.jobs.child REQUESTS ANSWERS BYTES`: started only by `process`.

Arguments are the numbers of two pipes, and the memory limit in bytes. The process ends with its
parent, even during a job. It receives objects from its parent, and answers in JSON: the parent
executes nothing that a log or an FMU may have injected into this process.
"""

import json
import os
import queue
import resource
import sys
import threading
import time
from multiprocessing.connection import Connection
from typing import Any

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Environment variables for the number of threads of linear-algebra libraries: with several threads
sums are rounded differently."""

_EVERY_S = 0.25
"""Interval between two progress messages."""


def main(requests: int, answers: int, memory_bytes: int) -> None:
    """Run jobs until the parent ends.

    Args:
        requests: Pipe for requests.
        answers: Pipe for answers.
        memory_bytes: Memory limit of this process.
    """
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    coming: queue.Queue[Any] = queue.Queue()
    asked, answered = Connection(requests), Connection(answers)

    def listen() -> None:
        """Receive requests; end the process when the pipe is closed."""
        while True:
            try:
                coming.put(asked.recv())
            except (EOFError, OSError):
                os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    doer = coming.get()
    answered.send_bytes(b"")
    while True:
        said_s = time.monotonic()

        def progress(done: float) -> None:
            """Report the completed share at intervals."""
            nonlocal said_s
            if (now_s := time.monotonic()) - said_s >= _EVERY_S:
                said_s = now_s
                answered.send_bytes(json.dumps({"done": done}).encode())

        answer = {"answer": doer.do(coming.get(), progress)}
        answered.send_bytes(json.dumps(answer, allow_nan=False).encode())


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
