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
        fmu: Driven twin that flies any of them, its law a matter of start values.
    """

    prepared: Prepared
    fitted: Sequence[Mapping[str, Candidate]]
    fmu: Path

    __repr__ = short_repr

    @classmethod
    def of(
        cls, seen: Sequence[Instants], vehicle: Vehicle, drive: Drive, seed: int, fmu: Path
    ) -> "Lesson":
        """The lesson of these flights.

        Args:
            seen: One or more.
            vehicle: Whose equations leave something.
            drive: Of the twin.
            seed: Of the random features.
            fmu: Where to build the twin.
        """
        prepared = prepare(seen, vehicle, seed)
        build(fused_model(driven_twin(vehicle, drive, (), prepared.empty), vehicle.name), fmu)
        return cls(prepared, prepared.candidates(), fmu)

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
    law = prepared.law(chosen)[0]
    names = [n for table in weight_names(law) for row in table for n in row]
    values = np.concatenate([law.linear.ravel(), law.waves.ravel()]).tolist()
    weights = {_PART + n: v for n, v in zip(names, values, strict=True)}
    return weights | observer_starts([c.observer for c in chosen])
