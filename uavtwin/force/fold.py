"""A flight that is left out, and what the others teach."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from learning.data.envelope import INSIDE
from learning.force.forecast import AHEAD_S, NO_OBSERVER
from learning.force.instants import Instants
from learning.force.laws import LAWS, Candidate, Prepared, prepare
from learning.force.model import observer_starts
from twin.flight.assembly import driven_twin
from twin.physics.residual_force import OUTPUTS, ForceLaw, parameter_values
from twin.physics.rotors import Drive
from twin.representation import short_repr
from twin.vehicle import Vehicle

from .memory import Memory
from .open_loop import DISTANCE, Replay

Array = NDArray[np.float64]
ALONE_S = 0.5
"""So long a twin that is let go has to stay inside the envelope."""
WIDER = 2.0
"""Most by which the envelope grows for that: where a law has faded before, it has not been."""
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
    def of(cls, seen: Sequence[Instants], vehicle: Vehicle, drive: Drive, place: Path) -> "Lesson":
        """The lesson of these flights.

        Args:
            seen: One or more.
            vehicle: Whose equations leave something.
            drive: Of the twin.
            place: File of the twin.
        """
        prepared = prepare(seen, vehicle)
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

    def running(self, replays: Sequence[Replay], memory: Memory) -> "Lesson":
        """The same, its envelope as wide as the twin goes in half a second by itself.

        A twin that is let go does not stay where the aircraft was, and laws are chosen by where it
        goes: what is judged there is said there.

        Args:
            replays: Of its flights, at `AHEAD_S`.
            memory: Of the steps that were taken before.
        """
        starts = self.starts([LAWS[0]] * len(OUTPUTS))
        near = [i for i, s in enumerate(AHEAD_S) if s <= ALONE_S]

        def quantile() -> Array:
            """Of the distance at the end of the horizons, shape ()."""
            away = [r.through(self.fmu, starts, (DISTANCE,)).watched[:, near, 0] for r in replays]
            return np.asarray(np.quantile(np.concatenate(away), INSIDE))

        reach = memory.array(f"reach {self.place.stem}", quantile)
        wider = float(np.clip(reach, 1.0, WIDER))
        empty = replace(self.prepared.empty, reach=wider * self.prepared.empty.reach)
        place = self.place.with_stem(f"{self.place.stem}_running")
        return replace(self, prepared=replace(self.prepared, empty=empty), place=place)

    def unobserved(self, output: int) -> "Lesson":
        """The same without the observer of one output."""
        fitted = list(self.fitted)
        fitted[output] = {
            law: replace(c, observer=NO_OBSERVER) for law, c in fitted[output].items()
        }
        return replace(self, fitted=fitted)

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
        memory: Of the steps that were taken before.
    """

    replay: Replay
    seen: Instants
    lesson: Lesson
    memory: Memory

    __repr__ = short_repr

    def unobserved(self, output: int) -> "Fold":
        """The same without the observer of one output."""
        return replace(self, lesson=self.lesson.unobserved(output))

    def squares(self, fmu: Path, starts: Mapping[str, float]) -> Array:
        """Mean squares of what a twin is off in the flight left out, shape (horizons, 4, 3)."""
        return np.asarray(np.mean(self.replay.through(fmu, starts).off ** 2, axis=0))

    def squares_of(self, laws: Sequence[str]) -> Array:
        """Those of the twin that flies these laws."""
        return self.memory.array(
            f"{self.lesson.place.stem} {' '.join(laws)}",
            lambda: self.squares(self.lesson.fmu, self.lesson.starts(laws)),
        )


def running(folds: Sequence[Fold], lesson: Lesson, memory: Memory) -> tuple[list[Fold], Lesson]:
    """Envelopes as wide as each twin goes in half a second by itself, in the flights it knows.

    Args:
        folds: One per flight.
        lesson: Of all flights.
        memory: Of the steps that were taken before.
    """
    wider = []
    for fold in folds:
        others = [f.replay for f in folds if f is not fold]
        wider.append(replace(fold, lesson=fold.lesson.running(others, memory)))
    return wider, lesson.running([f.replay for f in folds], memory)


def law_starts(prepared: Prepared, chosen: Sequence[Candidate]) -> dict[str, float]:
    """Weights and observers as start values of the fused FMU.

    Args:
        prepared: Flights that the laws were fitted to.
        chosen: One law per output.
    """
    of_law = in_force(prepared.law(chosen)[0])
    return of_law | observer_starts([c.observer for c in chosen])


def in_force(law: ForceLaw) -> dict[str, float]:
    """Start values by which a fused FMU of the same envelope flies a law."""
    return {_PART + n: v for n, v in parameter_values(law).items()}
