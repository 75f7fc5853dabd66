"""Execution of jobs by processes of this machine or a Dask cluster, with equal results.

On this machine each thread waits for a worker with a separate process: a crash affects one job, and
no computation is repeated or passed on by copying code. A cluster must be running; its workers have
this package, and tasks are sent as bytes.
"""

import contextlib
import os
import queue
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

from twin.errors import TwinError, install_command

J = TypeVar("J")
D = TypeVar("D")
J_contra = TypeVar("J_contra", contravariant=True)
D_co = TypeVar("D_co", covariant=True)


class Worker(Protocol[J_contra, D_co]):
    """Worker that does one job after another, in one thread."""

    def do(self, job: J_contra, /) -> D_co:
        """Result of a job; every failure has a result too."""

    def close(self) -> None:
        """End all that the worker has started."""


class Task(Protocol[J, D]):
    """Definition that is common to all jobs."""

    @property
    def key(self) -> str:
        """Hash of all inputs of the results."""

    def name(self, job: J, /) -> str:
        """Name that identifies a job."""

    def worker(self) -> Worker[J, D]:
        """A new worker."""

    def packed(self) -> "Packed[J, D]":
        """The task in a form for another machine."""

    def lost(self, job: J, why: str, /) -> D:
        """Result of a job whose workers were lost."""


class Packed(Protocol[J, D]):
    """A task that can be pickled."""

    @property
    def key(self) -> str:
        """Hash of the task."""

    def unpacked(self, folder: Path, /) -> Task[J, D]:
        """The task, with its files written into a folder."""


class LocalEngine:
    """Engine with a fixed number of local workers."""

    def __init__(self, workers: int) -> None:
        """Set up without starting.

        Args:
            workers: Number of threads, each with a worker.
        """
        self._workers = workers

    def run(self, task: Task[J, D], jobs: Iterable[J]) -> Iterator[D]:
        """Results of the jobs, in any order; jobs are taken on demand."""
        waiting: queue.Queue[J | None] = queue.Queue(2 * self._workers)
        done: queue.Queue[D | _Raised] = queue.Queue()
        ended = threading.Event()

        def work() -> None:
            """Run jobs until there are none, or the results are no longer wanted."""
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
                thread.join(timeout=1.0)  # do not wait for a long step; its process ends with ours

    def close(self) -> None:
        """Nothing remains to be closed."""


class _Raised:
    """An error of a worker's thread."""

    def __init__(self, error: BaseException) -> None:
        self.error = error


def _found(found: D | _Raised) -> D:
    if isinstance(found, _Raised):
        raise found.error
    return found


def _offer(waiting: "queue.Queue[J | None]") -> None:
    """Mark the end of the jobs; where no thread takes jobs, they are dropped."""
    while True:
        try:
            return waiting.put_nowait(None)
        except queue.Full:
            with contextlib.suppress(queue.Empty):
                waiting.get_nowait()


AHEAD = 4
"""Jobs sent to the cluster in advance, for each of its threads."""


CONNECT_S = 10.0
"""Time limit for the answer of a scheduler; those of a batch system start within seconds."""


class DaskEngine:
    """Engine with the workers of a cluster; jobs of a killed worker are repeated by another."""

    def __init__(self, scheduler: str) -> None:
        """Connect to a scheduler.

        Args:
            scheduler: Address of the scheduler, tcp://HOST:8786.

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
            self._client: Any = Client(scheduler, set_as_default=False, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            raise TwinError(f"--scheduler {scheduler}: no scheduler answers: {error}.") from error
        self._keys: list[str] = []

    def run(self, task: Task[J, D], jobs: Iterable[J]) -> Iterator[D]:
        """Results of the jobs, in any order; jobs are taken on demand."""
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
        """Disconnect, and remove all data from the cluster."""
        try:
            for key in self._keys:
                self._client.run(release, key)
        finally:
            self._client.close()


@dataclass(slots=True)
class _Held:
    """Objects that a process of the cluster caches between jobs.

    Attributes:
        folder: Folder of the task's files.
        task: Task with its files in that folder.
        workers: Workers by thread.
    """

    folder: "tempfile.TemporaryDirectory[str]"
    task: Task[Any, Any]
    workers: dict[int, Worker[Any, Any]] = field(default_factory=dict)


_HELD: dict[str, _Held] = {}
"""Cached objects in a process of the cluster, by key of the task."""
_LOCK = threading.Lock()
"""Lock of `_HELD`."""


def do_packed(packed: Packed[J, D], job: J) -> D:
    """On the cluster: do a job with a cached worker."""
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


EngineName = Literal["local", "dask"]
MOST_WORKERS = 1024
"""Largest number of workers of the local engine."""


class Engine(Protocol):
    """Engine that does jobs in any order."""

    def run(self, task: Task[J, D], jobs: Iterable[J]) -> Iterator[D]:
        """Results as they arrive; jobs are taken on demand."""

    def close(self) -> None:
        """Remove all resources."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Choice of the engine.

    Attributes:
        engine: `local`, or `dask` with a scheduler.
        workers: Number of processes of the local engine; None: one per core.
        scheduler: Address of a Dask scheduler.
    """

    engine: EngineName = "local"
    workers: int | None = None
    scheduler: str | None = None

    @contextmanager
    def opened(self) -> Iterator[Engine]:
        """The engine, closed at the end of the context.

        Raises:
            TwinError: An option does not apply to the engine, or is missing.
        """
        if self.engine == "dask":
            if self.scheduler is None:
                raise TwinError("--engine dask: give --scheduler tcp://HOST:8786.")
            with closing(DaskEngine(self.scheduler)) as remote:
                yield remote
            return
        if self.scheduler is not None:
            raise TwinError("--scheduler: goes with --engine dask.")
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        count = (cores or 1) if self.workers is None else self.workers
        if not (isinstance(count, int) and 1 <= count <= MOST_WORKERS):
            raise TwinError(f"--workers {count}: needs a whole number, 1 to {MOST_WORKERS}.")
        yield LocalEngine(count)
