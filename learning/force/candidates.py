"""Laws that each of the six outputs may follow, fitted to flights.

| law | is |
|---|---|
| `none` | nothing: the equations are right, or no law was found that holds on another flight |
| `constant` | the mean |
| `linear` | a sum over `FEATURES` |
| `waves` | the same and random Fourier features of the motion: any smooth function |

How strongly weights are held at zero is decided by flights that take no part in the fit: each in
turn is left out, and its innovations, what is new from one sample to the next, are to be as
probable as can be. With a single flight its quarters take the place of flights. Which law is used
is decided by the twin that flies it (`uavtwin.force`).

No law may push along the velocity or turn along the rate that it depends on: such weights end at
zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.physics.residual_force import FEATURES
from twin.representation import short_repr

from .forecast import Observer, observer_of
from .regression import Moments, missed, moments_of, pieces_of, ridge, summed

Array = NDArray[np.float64]
LAWS = ("none", "constant", "linear", "waves")
PENALTIES = (1.0, 10.0, 100.0, 1000.0)
"""Prior precisions tried, of a weight over a feature of size one, in units of innovations."""
QUARTERS = 4
HALVES = (slice(0, 3), slice(3, 6))
"""Outputs that are force, and those that are moment."""
_AGAINST = tuple(
    tuple(FEATURES.index(stem + a) for stem in stems)
    for stems in (("air_", "speed air_"), ("omega_",))
    for a in "xyz"
)
"""By output, the features that are motion along it."""


@dataclass(frozen=True, slots=True)
class Design:
    """What explains one flight, and its six outputs.

    Attributes:
        features: `FEATURES` and then random ones, constant first, each of the order of one: as
            force and as moment show them, shape (n, k) each.
        left: Shape (n, 6).
        piece: Number of the uninterrupted piece of flight of each row, shape (n,).
        moments: Of the features and three outputs, of force and of moment.
    """

    features: tuple[Array, Array]
    left: Array
    piece: NDArray[np.intp]
    moments: tuple[Moments, Moments]

    __repr__ = short_repr

    @classmethod
    def of(cls, features: tuple[Array, Array], left: Array, piece: NDArray[np.intp]) -> "Design":
        """The design of these rows."""
        pieces = pieces_of(piece)
        force, moment = (
            moments_of(np.hstack([x, left[:, three]]), pieces)
            for x, three in zip(features, HALVES, strict=True)
        )
        return cls(features, left, piece, (force, moment))

    def leaves(self, weights: Array) -> Array:
        """What weights leave of the outputs, shape (n, 6).

        Args:
            weights: Per output and feature, shape (6, k).
        """
        said = [x @ weights[three].T for x, three in zip(self.features, HALVES, strict=True)]
        return self.left - np.hstack(said)


@dataclass(frozen=True, slots=True)
class Candidate:
    """One law of one output.

    Attributes:
        law: Of `LAWS`.
        penalty: Of its weights; 0 of a law without.
        weights: Per feature, 0 where the law has none, shape (k,).
        gain: Log-likelihood of the flights left out over that of `none`, nats.
        observer: Of what the law leaves.
    """

    law: str
    penalty: float
    weights: Array
    gain: float
    observer: Observer


def candidates(flights: Sequence[Design], output: int) -> dict[str, Candidate]:
    """Every law of one output, by its name.

    Args:
        flights: One or more.
        output: 0 to 5.
    """
    several = flights if len(flights) > 1 else quarters(flights[0])
    half = output // 3
    every = [f.moments[half] for f in several if f.moments[half].rows]
    whole, found = summed([f.moments[half] for f in flights]), {}
    folds = [(whole, whole)]  # where it is too short to leave any of it out
    if len(every) > 1:
        folds = [(summed([m for m in every if m is not one]), one) for one in every]
    for law in LAWS:
        columns = _columns(law, flights[0], output)
        tried = PENALTIES if law in ("linear", "waves") else (0.0,)
        strengths = [_strength(p, len(columns) - 1) for p in tried]
        limits = _limits(len(columns) - 1, output)
        parts = [(train.of(columns), test.of(columns)) for train, test in folds]
        said = [sum(_likelihood(*part, s, limits) for part in parts) for s in strengths]
        best = int(np.argmax(said))
        fit = ridge(whole.of(columns), strengths[best], limits).weights
        weights = np.zeros(flights[0].features[half].shape[1])
        weights[: len(fit)] = fit
        observer = observer_of(
            [(f.left[:, output] - f.features[half] @ weights, pieces_of(f.piece)) for f in flights]
        )
        found[law] = Candidate(law, tried[best], weights, said[best], observer)
    nothing = found[LAWS[0]].gain
    return {law: replace(c, gain=c.gain - nothing) for law, c in found.items()}


def quarters(flight: Design) -> list[Design]:
    """A flight as several."""
    bounds = np.linspace(0, len(flight.left), QUARTERS + 1).astype(int).tolist()
    force, moment = flight.features
    return [
        Design.of((force[a:b], moment[a:b]), flight.left[a:b], flight.piece[a:b])
        for a, b in pairwise(bounds)
    ]


def _likelihood(train: Moments, test: Moments, strength: Array, most: Array) -> float:
    """Log-likelihood of what was left out, its noise of any size, nats."""
    fit = ridge(train, strength, most)
    return -test.rows / 2 * float(np.log(missed(test, fit.weights, fit.noise)))


def _columns(law: str, flight: Design, output: int) -> list[int]:
    """Features of a law, and the output."""
    every = flight.features[0].shape[1]
    n = {"none": 0, "constant": 1, "linear": len(FEATURES), "waves": every}[law]
    return [*range(n), every + output % 3]


def _strength(penalty: float, n: int) -> Array:
    """Prior precision of each weight; the constant has none."""
    strength = np.full(n, penalty)
    strength[:1] = 0.0
    return strength


def _limits(n: int, output: int) -> Array:
    """Largest weight of each feature."""
    most = np.full(n, np.inf)
    if n > 1:
        most[list(_AGAINST[output])] = 0.0
    return most
