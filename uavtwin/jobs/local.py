"""Processes of this machine.

A thread each waits for its worker, which has a process of its own. So what a job does to its
process harms one job, and nothing is computed twice or passed on by copying code.
"""

import contextlib
import queue
import threading
from collections.abc import Iterable, Iterator

from .task import D, J, Task


class LocalEngine:
    """As many workers as asked for."""

    def __init__(self, workers: int) -> None:
        """Start nothing yet.

        Args:
            workers: Threads, each with a worker.
        """
        self._workers = workers

    def run(self, task: Task[J, D], jobs: Iterable[J]) -> Iterator[D]:
        """What comes of the jobs, in any order; jobs are taken when there is room for them."""
        waiting: queue.Queue[J | None] = queue.Queue(2 * self._workers)
        done: queue.Queue[D | _Raised] = queue.Queue()
        ended = threading.Event()

        def work() -> None:
            """Until there is nothing more to do, or nobody who wants it."""
            try:
                with contextlib.closing(task.worker()) as worker:
                    while (job := waiting.get()) is not None and not ended.is_set():
                        done.put(worker.do(job))
            except BaseException as error:
                done.put(_Raised(error))

        threads = [threading.Thread(target=work, daemon=True) for _ in range(self._workers)]
        for thread in threads:
            thread.start()
        try:
            under_way = 0
            for job in jobs:
                if under_way == 2 * self._workers:
                    yield _found(done.get())
                    under_way -= 1
                waiting.put(job)
                under_way += 1
            for _ in range(under_way):
                yield _found(done.get())
        finally:
            ended.set()
            for _ in threads:
                _offer(waiting)
            for thread in threads:
                thread.join(timeout=1.0)  # a long step is not waited for; its process ends with us

    def close(self) -> None:
        """Nothing is left of it."""


class _Raised:
    """An error of a worker's thread."""

    def __init__(self, error: BaseException) -> None:
        self.error = error


def _found(found: D | _Raised) -> D:
    if isinstance(found, _Raised):
        raise found.error
    return found


def _offer(waiting: "queue.Queue[J | None]") -> None:
    """Say that there is nothing more; where nobody takes jobs, they are dropped."""
    while True:
        try:
            return waiting.put_nowait(None)
        except queue.Full:
            with contextlib.suppress(queue.Empty):
                waiting.get_nowait()
