"""Processes of this machine.

A thread each waits for a worker process of `cosim.worker`, in which the steps are taken. So what an
FMU does to its process harms one run, and nothing is computed twice or passed on by copying code.
"""

import contextlib
import queue
import threading
from collections.abc import Iterable, Iterator, Sequence

from cosim.limits import Limits

from ..flying import Flown, Flyer
from ..plan import Job, Stand


class LocalEngine:
    """As many worker processes as asked for."""

    def __init__(self, workers: int, limits: Limits, keep: bool = False) -> None:
        """Start nothing yet.

        Args:
            workers: Processes.
            limits: Of each.
            keep: Whether recordings are wanted.
        """
        self._workers, self._limits, self._keep = workers, limits, keep

    def fly(self, jobs: Iterable[Job], stands: Sequence[Stand]) -> Iterator[Flown]:
        """Outcomes as they come."""
        waiting: queue.Queue[Job | None] = queue.Queue(2 * self._workers)
        done: queue.Queue[Flown | BaseException] = queue.Queue()
        ended = threading.Event()

        def work() -> None:
            """Until there is nothing more to do, or nobody who wants it."""
            try:
                with contextlib.closing(Flyer(self._limits, self._keep)) as flyer:
                    while (job := waiting.get()) is not None and not ended.is_set():
                        done.put(flyer.fly(job, stands[job.stand]))
            except BaseException as error:
                done.put(error)

        threads = [threading.Thread(target=work, daemon=True) for _ in range(self._workers)]
        for thread in threads:
            thread.start()
        try:
            flying = 0
            for job in jobs:
                if flying == 2 * self._workers:
                    yield _outcome(done.get())
                    flying -= 1
                waiting.put(job)
                flying += 1
            for _ in range(flying):
                yield _outcome(done.get())
        finally:
            ended.set()
            for _ in threads:
                _offer(waiting)
            for thread in threads:
                thread.join(timeout=1.0)  # a long step is not waited for; its process ends with us


def _outcome(found: Flown | BaseException) -> Flown:
    if isinstance(found, BaseException):
        raise found
    return found


def _offer(waiting: "queue.Queue[Job | None]") -> None:
    """Say that there is nothing more; where nobody takes jobs, they are dropped."""
    while True:
        try:
            return waiting.put_nowait(None)
        except queue.Full:
            with contextlib.suppress(queue.Empty):
                waiting.get_nowait()
