"""A Dask cluster that runs already; its workers have this package, and tasks travel as bytes."""

import tempfile
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twin.errors import TwinError, install_command

from .task import D, J, Packed, Task, Worker

AHEAD = 4
"""Jobs that are given to the cluster for each of its threads."""


class DaskEngine:
    """The workers of a cluster; what a killed one was doing is done by another."""

    def __init__(self, scheduler: str) -> None:
        """Connect.

        Args:
            scheduler: Its address, tcp://HOST:8786.

        Raises:
            TwinError: The package is missing, or no scheduler answers.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise TwinError(
                f"--engine dask: needs the package distributed: {install_command('dask')}."
            ) from error
        try:
            self._client: Any = Client(scheduler, set_as_default=False, timeout=10)
        except (OSError, ValueError) as error:
            raise TwinError(f"--scheduler {scheduler}: no scheduler answers: {error}.") from error
        self._keys: list[str] = []

    def run(self, task: Task[J, D], jobs: Iterable[J]) -> Iterator[D]:
        """What comes of the jobs, in any order; jobs are taken when there is room for them."""
        from distributed import KilledWorker, as_completed

        client = self._client
        self._keys.append(task.key)
        packed = client.scatter(task.packed(), broadcast=True)
        coming = as_completed(loop=client.loop)
        under_way: dict[str, J] = {}
        threads = sum(client.nthreads().values())
        waiting = iter(jobs)
        while True:
            ahead = AHEAD * max(1, threads)
            while len(under_way) < ahead and (job := next(waiting, None)) is not None:
                key = f"uavtwin-{task.key[:16]}-{task.name(job)}"
                coming.add(client.submit(do_packed, packed, job, key=key, pure=False))
                under_way[key] = job
            if not under_way:
                return
            future = next(coming)
            job = under_way.pop(future.key)
            try:
                yield future.result()
            except KilledWorker as error:
                yield task.lost(job, f"its workers were lost: {error}")

    def close(self) -> None:
        """Leave the cluster, and nothing on it."""
        try:
            for key in self._keys:
                self._client.run(release, key)
        finally:
            self._client.close()


@dataclass(slots=True)
class _Held:
    """What a process of the cluster keeps from one job to the next.

    Attributes:
        folder: Of the task's files.
        task: With its files there.
        workers: By thread.
    """

    folder: "tempfile.TemporaryDirectory[str]"
    task: Task[Any, Any]
    workers: dict[int, Worker[Any, Any]] = field(default_factory=dict)


_HELD: dict[str, _Held] = {}
"""In a process of the cluster, by key of the task."""
_LOCK = threading.Lock()


def do_packed(packed: Packed[J, D], job: J) -> D:
    """On the cluster: do a job with a worker that the next job finds again."""
    with _LOCK:
        if packed.key not in _HELD:
            folder = tempfile.TemporaryDirectory(prefix="uavtwin-", ignore_cleanup_errors=True)
            _HELD[packed.key] = _Held(folder, packed.unpacked(Path(folder.name)))
        held = _HELD[packed.key]
        worker = held.workers.get(threading.get_ident())
        if worker is None:
            worker = held.workers[threading.get_ident()] = held.task.worker()
    found: D = worker.do(job)
    return found


def release(key: str) -> None:
    """On the cluster: end the processes of a task and delete its files."""
    with _LOCK:
        held = _HELD.pop(key, None)
    if held is not None:
        for worker in held.workers.values():
            worker.close()
        held.folder.cleanup()
