"""A flight that is left out, and what the others teach."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from learning.force.candidates import Candidate
from learning.force.instants import Instants
from learning.force.model import observer_starts
from learning.force.train import Prepared, prepare
from twin.flight.assembly import driven_twin
from twin.physics.residual_force import ForceLaw, weight_names
from twin.physics.rotors import Drive
from twin.representation import short_repr
from twin.vehicle import Vehicle

from .open_loop import Replay

Array = NDArray[np.float64]
_PART = "residual_force."


@dataclass(frozen=True, slots=True)
class Lesson:
    """What some flights teach.

    Attributes:
        prepared: The flights.
        fitted: Laws by name of each output.
        drive: Of the twin.
        place: Where the twin is built, once it is to fly.
    """

    prepared: Prepared
    fitted: Sequence[Mapping[str, Candidate]]
    drive: Drive
    place: Path

    __repr__ = short_repr

    @classmethod
    def of(
        cls, seen: Sequence[Instants], vehicle: Vehicle, drive: Drive, seed: int, place: Path
    ) -> "Lesson":
        """The lesson of these flights.

        Args:
            seen: One or more.
            vehicle: Whose equations leave something.
            drive: Of the twin.
            seed: Of the random features.
            place: File of the twin.
        """
        prepared = prepare(seen, vehicle, seed)
        return cls(prepared, prepared.candidates(), drive, place)

    @property
    def fmu(self) -> Path:
        """Driven twin that flies any of the laws: they are a matter of start values."""
        if not self.place.exists():
            vehicle = self.prepared.vehicle
            parts = driven_twin(vehicle, self.drive, (), self.prepared.empty)
            build(fused_model(parts, vehicle.name), self.place)
        return self.place

    def chosen(self, names: Sequence[str]) -> list[Candidate]:
        """Laws by their names, one per output."""
        return [every[name] for every, name in zip(self.fitted, names, strict=True)]

    def law(self, names: Sequence[str]) -> ForceLaw:
        """The law of these names, made passive."""
        return self.prepared.law(self.chosen(names))[0]

    def starts(self, names: Sequence[str]) -> dict[str, float]:
        """Start values that make the FMU fly them, each beside its observer."""
        return law_starts(self.prepared, self.chosen(names))


@dataclass(frozen=True, slots=True)
class Fold:
    """A flight that is left out.

    Attributes:
        replay: Of the flight.
        seen: The flight.
        lesson: Of the others.
    """

    replay: Replay
    seen: Instants
    lesson: Lesson

    __repr__ = short_repr

    def squares(self, fmu: Path, starts: Mapping[str, float]) -> Array:
        """Mean squares of what a twin is off in the flight left out, shape (horizons, 4, 3)."""
        return np.asarray(np.mean(self.replay.through(fmu, starts).off ** 2, axis=0))


def law_starts(prepared: Prepared, chosen: Sequence[Candidate]) -> dict[str, float]:
    """Weights and observers as start values of the fused FMU.

    Args:
        prepared: Flights that the laws were fitted to.
        chosen: One law per output.
    """
    weights = weight_starts(prepared.law(chosen)[0])
    return weights | observer_starts([c.observer for c in chosen])


def weight_starts(law: ForceLaw) -> dict[str, float]:
    """The weights of a law as start values of the fused FMU."""
    names = [n for table in weight_names(law) for row in table for n in row]
    values = np.concatenate([law.linear.ravel(), law.waves.ravel()]).tolist()
    return {_PART + n: v for n, v in zip(names, values, strict=True)}
