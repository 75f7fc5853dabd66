"""Force law of flights: its envelope, its bounds, and the removal of parts that would feed energy
in.

Its weights are fitted through the rollout (`learning.force.rollout`), with a ridge selected on
flights left out (`uavtwin.force`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.physics.residual_force import FEATURES, OUTPUTS, ForceLaw
from twin.representation import ShortRepr

from ..data.envelope import BEYOND, Envelope
from .equations import Equations
from .rollout import fitted
from .windows import FlightWindows, accelerometer_confirms, sizes

Array = NDArray[np.float64]
RIDGES = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Ridge parameters that are tried, the strongest first: penalty of a weight whose output has the
size of the residual acceleration, relative to the error with which a fit begins."""
PARTS = {"moment": slice(3, 6), "force": slice(0, 3), "both": slice(0, 6)}
"""Parts of a law that may be used alone, and their outputs."""
Choice = tuple[str, float]
"""A part and a ridge."""
RESERVE = (*(0.5,) * 3, *(0.5,) * 3, 0.1, *(0.05,) * 3, 0.05, 0.3)
"""Difference of each input within one flight condition, in its unit: a flight with a half-full
battery is valid where training had only full ones."""


@dataclass(frozen=True, slots=True)
class Taught(ShortRepr):
    """Training data and envelope from some flights.

    Attributes:
        flights: One or more flights.
        equations: Equations of their airframe.
        empty: Law without output, with the envelope of the flights.
    """

    flights: tuple[FlightWindows, ...]
    equations: Equations
    empty: ForceLaw

    @classmethod
    def by(cls, flights: Sequence[FlightWindows], equations: Equations) -> "Taught":
        """Training data of these flights."""
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
        """Weights with each of `RIDGES`, each fit starting from the one before, shape (ridges, 6,
        k); a lateral force only where the accelerometer confirms it."""
        size = sizes(self.flights)
        outputs = range(0 if accelerometer_confirms(self.flights) else 2, len(OUTPUTS))
        found: list[Array] = []
        for ridge in RIDGES:
            start = found[-1] if found else None
            found.append(fitted(self.equations, self.flights, size, ridge, start, outputs))
        return np.stack(found)

    def law(self, path: Array, choice: Choice | None) -> ForceLaw:
        """The law of a choice; None: no law.

        Args:
            path: Weights, as of `path`.
            choice: Part and ridge.
        """
        weights = np.zeros(path.shape[1:])
        if choice is not None:
            part, ridge = choice
            weights[PARTS[part]] = path[RIDGES.index(ridge), PARTS[part]]
        return self.of(weights)

    def of(self, weights: Array) -> ForceLaw:
        """The law of these weights: each output is limited to `BEYOND` times its maximum in the
        flights."""
        said = [np.abs(f.features @ weights.T).max(axis=0) for f in self.flights]
        return replace(self.empty, linear=weights, most=BEYOND * np.max(said, axis=0))
