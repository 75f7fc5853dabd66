"""`python -m uavtwin.jobs.child REQUESTS ANSWERS BYTES`: started by `process` alone.

Numbers of two pipes, and of the bytes of memory that it may ask for. It ends with whoever has
started it, in the middle of a job too. It takes objects from who started it, and answers in JSON:
whoever reads that runs nothing of what a log or an FMU has made of this process.
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
"""Of libraries of linear algebra: of several threads the sums end in other bits."""

_EVERY_S = 0.25
"""Between two messages on how much of a job is done."""


def main(requests: int, answers: int, memory_bytes: int) -> None:
    """Do jobs until nobody asks any more.

    Args:
        requests: Pipe on which jobs come.
        answers: Pipe on which goes what comes of them.
        memory_bytes: That this process may ask for.
    """
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    coming: queue.Queue[Any] = queue.Queue()
    asked, answered = Connection(requests), Connection(answers)

    def listen() -> None:
        """Take requests; where there will be none, end at once."""
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
            """Say the share done, now and then."""
            nonlocal said_s
            if (now_s := time.monotonic()) - said_s >= _EVERY_S:
                said_s = now_s
                answered.send_bytes(json.dumps({"done": done}).encode())

        answer = {"answer": doer.do(coming.get(), progress)}
        answered.send_bytes(json.dumps(answer, allow_nan=False).encode())


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
