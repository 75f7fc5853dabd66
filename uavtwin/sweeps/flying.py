"""One run after another in a worker process, which is started anew after a fault."""

import contextlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cosim.limits import Limits
from cosim.recording import Recording, RunError
from cosim.worker import WorkerMaster
from twin.errors import FmuError

from .outcome import Outcome, outcome_of
from .plan import Job, Stand


@dataclass(frozen=True, slots=True)
class Flown:
    """A run and what it left.

    Attributes:
        outcome: In figures.
        recording: Where recordings are kept.
    """

    outcome: Outcome
    recording: Recording | None = None


@dataclass(frozen=True, slots=True)
class Flying:
    """What is done with each run, for `uavtwin.jobs`.

    Attributes:
        key: Hash of the sweep.
        stands: Systems.
        limits: Of the process that the FMUs run in; the time as a whole is that of one run.
        keep: Whether recordings are wanted.
    """

    key: str
    stands: tuple[Stand, ...]
    limits: Limits
    keep: bool = False

    def name(self, job: Job) -> str:
        """Number of the run."""
        return str(job.run)

    def worker(self) -> "Flyer":
        """One more that flies runs."""
        return Flyer(self)

    def packed(self) -> "Shipment":
        """With the content of the FMUs, which lie elsewhere."""
        bare = tuple(replace(s, system=replace(s.system, folder=None)) for s in self.stands)
        fmus = tuple(
            {name: path.read_bytes() for name, path in s.system.fmus.items()} for s in self.stands
        )
        return Shipment(replace(self, stands=bare), fmus)

    def lost(self, job: Job, why: str) -> Flown:
        """A run that nobody could fly."""
        return Flown(Outcome(job.run, "failed", why, 0.0, {}))


@dataclass(frozen=True, slots=True)
class Shipment:
    """Systems with the content of their files.

    Attributes:
        flying: Whose FMUs lie elsewhere.
        fmus: Content of each, by stand and name.
    """

    flying: Flying
    fmus: tuple[dict[str, bytes], ...]

    @property
    def key(self) -> str:
        """Hash of the sweep."""
        return self.flying.key

    def unpacked(self, folder: Path) -> Flying:
        """The systems, their FMUs written into a folder."""
        stands = []
        for number, (stand, files) in enumerate(zip(self.flying.stands, self.fmus, strict=True)):
            paths = {name: folder / f"{number}_{name}.fmu" for name in files}
            for name, content in files.items():
                paths[name].write_bytes(content)
            stands.append(replace(stand, system=replace(stand.system, fmus=paths)))
        return replace(self.flying, stands=tuple(stands))


class Flyer:
    """Runs jobs; a crash of an FMU costs the run in which it happens."""

    def __init__(self, flying: Flying) -> None:
        """Start nothing yet."""
        self._flying = flying
        self._master: WorkerMaster | None = None
        self._stand: Stand | None = None

    def do(self, job: Job) -> Flown:
        """Run a job; whatever an FMU does, there is an outcome."""
        stand = self._flying.stands[job.stand]
        times = stand.times
        try:
            master = self._ready(stand)
            master.initialize(times.begin_s, job.starts)
            recording = master.run(times.end_s, times.step_s, every=times.every)
            why = ""
        except RunError as error:
            recording, why = error.recording, str(error)
            self.close()
        except FmuError as error:
            recording, why = _nothing(), str(error)
            self.close()
        outcome = outcome_of(job.run, recording, stand.arm_m, why)
        return Flown(outcome, recording if self._flying.keep else None)

    def _ready(self, stand: Stand) -> WorkerMaster:
        """A master with the system of a stand loaded."""
        if self._master is None or self._stand is not stand:
            self.close()
            self._master = WorkerMaster(stand.system, stand.record, self._flying.limits)
            self._stand = stand
        return self._master

    def close(self) -> None:
        """End the process."""
        master, self._master, self._stand = self._master, None, None
        if master is not None:
            with contextlib.suppress(FmuError):  # the outcome is known already
                master.close()


def _nothing() -> Recording:
    return Recording((), np.zeros(0), np.zeros((0, 0)))
