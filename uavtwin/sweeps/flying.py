"""One run after another in a worker process, which is started anew after a fault."""

import contextlib
from dataclasses import dataclass

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


class Flyer:
    """Runs jobs; a crash of an FMU costs the run in which it happens."""

    def __init__(self, limits: Limits, keep: bool = False) -> None:
        """Start nothing yet.

        Args:
            limits: Of the process that the FMUs run in; the time as a whole is that of one run.
            keep: Whether recordings are wanted.
        """
        self._limits, self._keep = limits, keep
        self._master: WorkerMaster | None = None
        self._stand: Stand | None = None

    def fly(self, job: Job, stand: Stand) -> Flown:
        """Run a job; whatever an FMU does, there is an outcome."""
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
        return Flown(outcome, recording if self._keep else None)

    def _ready(self, stand: Stand) -> WorkerMaster:
        """A master with the system of a stand loaded."""
        if self._master is None or self._stand is not stand:
            self.close()
            self._master = WorkerMaster(stand.system, stand.record, self._limits)
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
