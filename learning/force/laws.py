"""A force law of flights: its envelope, its bounds, and what of it would feed energy in.

Its weights are fitted through the rollout (`learning.force.rollout`), under a ridge as strong as
flights left out want it (`uavtwin.force`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.physics.residual_force import FEATURES, OUTPUTS, ForceLaw
from twin.representation import short_repr

from ..data.envelope import BEYOND, Envelope
from .equations import Equations
from .rollout import fitted
from .windows import FlightWindows, accelerometer_confirms, sizes

Array = NDArray[np.float64]
RIDGES = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Tried strengths, the strongest first: the price of a weight that makes what the equations lack,
over the error that is left without a law."""
PARTS = {"moment": slice(3, 6), "force": slice(0, 3), "both": slice(0, 6)}
"""Of a law that may be used alone, and the outputs in them."""
Choice = tuple[str, float]
"""A part and a ridge."""
RESERVE = (*(0.5,) * 3, *(0.5,) * 3, 0.1, *(0.05,) * 3, 0.05, 0.3)
"""By input, what is no other place, in its unit: a flight with the battery half full is as good as
one with the full one, where training had only full ones."""


@dataclass(frozen=True, slots=True)
class Taught:
    """What some flights teach.

    Attributes:
        flights: One or more.
        equations: Of the airframe that they flew.
        empty: A law that says nothing: where the flights have been.
    """

    flights: tuple[FlightWindows, ...]
    equations: Equations
    empty: ForceLaw

    __repr__ = short_repr

    @classmethod
    def by(cls, flights: Sequence[FlightWindows], equations: Equations) -> "Taught":
        """By these flights."""
        envelope = Envelope.of([f.places for f in flights], np.array(RESERVE))
        empty = ForceLaw(
            linear=np.zeros((len(OUTPUTS), len(FEATURES))),
            centre=envelope.centre,
            scale=envelope.scale,
            whitening=envelope.whitening,
            reach=envelope.reach,
            most=np.zeros(len(OUTPUTS)),
            units=equations.units,
        )
        return cls(tuple(flights), equations, empty)

    def path(self) -> Array:
        """Weights under each of `RIDGES`, each begun at those before, shape (ridges, 6, k); of a
        force across the thrust only where the accelerometer confirms it."""
        size = sizes(self.flights)
        outputs = range(0 if accelerometer_confirms(self.flights) else 2, len(OUTPUTS))
        found: list[Array] = []
        for ridge in RIDGES:
            start = found[-1] if found else None
            found.append(fitted(self.equations, self.flights, size, ridge, start, outputs))
        return np.stack(found)

    def law(self, path: Array, choice: Choice | None) -> ForceLaw:
        """The law of a choice; None: without a law.

        Args:
            path: As `path` returns it.
            choice: Which.
        """
        weights = np.zeros(path.shape[1:])
        if choice is not None:
            part, ridge = choice
            weights[PARTS[part]] = path[RIDGES.index(ridge), PARTS[part]]
        return self.of(weights)

    def of(self, weights: Array) -> ForceLaw:
        """The law of weights: of each output at most `BEYOND` times as much as in the flights."""
        said = [np.abs(f.features @ weights.T).max(axis=0) for f in self.flights]
        return replace(self.empty, linear=weights, most=BEYOND * np.max(said, axis=0))
