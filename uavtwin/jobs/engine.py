"""Where jobs are done: processes of this machine, or a cluster; what comes of them is the same."""

import os
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from typing import Literal, Protocol

from twin.errors import TwinError

from .local import LocalEngine
from .task import D, J, Task

EngineName = Literal["local", "dask"]
MOST_WORKERS = 1024


class Engine(Protocol):
    """Does jobs in any order."""

    def run(self, task: Task[J, D], jobs: Iterable[J]) -> Iterator[D]:
        """What comes of them, as it comes; jobs are taken when there is room for them."""

    def close(self) -> None:
        """Leave nothing behind."""


@contextmanager
def opened_engine(
    name: EngineName, workers: int | None = None, scheduler: str | None = None
) -> Iterator[Engine]:
    """An engine, closed at the end.

    Args:
        name: `local`, or `dask` with a scheduler.
        workers: Processes of the local engine; None: one per core.
        scheduler: Address of a Dask scheduler.

    Raises:
        TwinError: One is given that the engine has no use for, or lacks.
    """
    if name == "dask":
        from .dask import DaskEngine

        if scheduler is None:
            raise TwinError("--engine dask: give --scheduler tcp://HOST:8786.")
        with closing(DaskEngine(scheduler)) as remote:
            yield remote
        return
    if scheduler is not None:
        raise TwinError("--scheduler: goes with --engine dask.")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    count = (cores or 1) if workers is None else workers
    if not 1 <= count <= MOST_WORKERS:
        raise TwinError(f"--workers {count}: needs 1 to {MOST_WORKERS}.")
    yield LocalEngine(count)
