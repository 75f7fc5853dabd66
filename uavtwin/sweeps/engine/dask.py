"""A Dask cluster that runs already; its workers have this package, and FMUs travel as bytes."""

import tempfile
import threading
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cosim.limits import Limits
from twin.errors import TwinError

from ..flying import Flown, Flyer
from ..outcome import Outcome
from ..plan import Job, Stand

AHEAD = 4
"""Runs that are given to the cluster for each of its threads."""


@dataclass(frozen=True, slots=True)
class Shipment:
    """Systems with the content of their files.

    Attributes:
        sweep: Hash of the sweep.
        stands: Whose FMUs lie elsewhere.
        fmus: Content of each, by stand and name.
        limits: Of a worker's process.
        keep: Whether recordings are wanted.
    """

    sweep: str
    stands: tuple[Stand, ...]
    fmus: tuple[dict[str, bytes], ...]
    limits: Limits
    keep: bool


class DaskEngine:
    """The workers of a cluster; what a killed one was flying is flown by another."""

    def __init__(self, scheduler: str, sweep: str, limits: Limits, keep: bool = False) -> None:
        """Connect.

        Args:
            scheduler: Its address, tcp://HOST:8786.
            sweep: Hash of the sweep.
            limits: Of the process that FMUs run in.
            keep: Whether recordings are wanted.

        Raises:
            TwinError: The package is missing, or no scheduler answers.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise TwinError(
                "--engine dask: needs the package distributed: pip install 'uavtwin[dask]'."
            ) from error
        try:
            self._client: Any = Client(scheduler, set_as_default=False, timeout=10)
        except (OSError, ValueError) as error:
            raise TwinError(f"--scheduler {scheduler}: no scheduler answers: {error}.") from error
        self._sweep, self._limits, self._keep = sweep, limits, keep

    def fly(self, jobs: Iterable[Job], stands: Sequence[Stand]) -> Iterator[Flown]:
        """Outcomes as they come."""
        from distributed import KilledWorker, as_completed

        client = self._client
        fmus = tuple(
            {name: path.read_bytes() for name, path in s.system.fmus.items()} for s in stands
        )
        bare = tuple(replace(s, system=replace(s.system, folder=None)) for s in stands)
        shipment = client.scatter(
            Shipment(self._sweep, bare, fmus, self._limits, self._keep), broadcast=True
        )
        coming = as_completed(loop=client.loop)
        runs: dict[str, int] = {}
        threads = sum(client.nthreads().values())
        waiting = iter(jobs)
        while True:
            while len(runs) < AHEAD * max(1, threads) and (job := next(waiting, None)) is not None:
                key = f"uavtwin-{self._sweep[:16]}-{job.run}"
                coming.add(client.submit(fly_shipped, shipment, job, key=key, pure=False))
                runs[key] = job.run
            if not runs:
                return
            future = next(coming)
            run = runs.pop(future.key)
            try:
                yield future.result()
            except KilledWorker as error:
                yield Flown(Outcome(run, "failed", f"its workers were lost: {error}", 0.0, {}))

    def close(self) -> None:
        """Leave the cluster, and nothing on it."""
        try:
            self._client.run(release, self._sweep)
        finally:
            self._client.close()


@dataclass(slots=True)
class _Held:
    """What a worker keeps from one run to the next.

    Attributes:
        folder: Of the FMUs.
        stands: Systems there.
        flyers: By thread.
    """

    folder: "tempfile.TemporaryDirectory[str]"
    stands: tuple[Stand, ...]
    flyers: dict[int, Flyer] = field(default_factory=dict)


_HELD: dict[str, _Held] = {}
"""On a worker, by sweep."""
_LOCK = threading.Lock()


def fly_shipped(shipment: Shipment, job: Job) -> Flown:
    """On a worker: run a job in a process that the next job finds again."""
    with _LOCK:
        if shipment.sweep not in _HELD:
            _HELD[shipment.sweep] = _unpacked(shipment)
        held = _HELD[shipment.sweep]
        flyer = held.flyers.get(threading.get_ident())
        if flyer is None:
            flyer = Flyer(shipment.limits, shipment.keep)
            held.flyers[threading.get_ident()] = flyer
    return flyer.fly(job, held.stands[job.stand])


def release(sweep: str) -> None:
    """On a worker: end the processes of a sweep and delete its files."""
    with _LOCK:
        held = _HELD.pop(sweep, None)
    if held is not None:
        for flyer in held.flyers.values():
            flyer.close()
        held.folder.cleanup()


def _unpacked(shipment: Shipment) -> _Held:
    """The systems, their FMUs written into a folder of this process."""
    folder = tempfile.TemporaryDirectory(prefix="uavtwin-", ignore_cleanup_errors=True)
    stands = []
    for number, (stand, files) in enumerate(zip(shipment.stands, shipment.fmus, strict=True)):
        paths = {name: Path(folder.name) / f"{number}_{name}.fmu" for name in files}
        for name, content in files.items():
            paths[name].write_bytes(content)
        stands.append(replace(stand, system=replace(stand.system, fmus=paths)))
    return _Held(folder, tuple(stands))
