"""Laws that each of the six outputs may follow, fitted to flights.

| law | is |
|---|---|
| `none` | nothing: the equations are right, or no law was found that holds on another flight |
| `constant` | the mean over flights of what each has on average |
| `linear` | a sum over few of `FEATURES` |

How much flights that take no part in the fit speak for a law: each in turn is left out, and the
likelihood of its innovations, what is new from one sample to the next, is taken. With a single
flight its quarters take the place of flights. Which law is used is decided by the twin that flies
it (`uavtwin.force`).

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
from .regression import Fit, Moments, least_squares, missed, moments_of, pieces_of, sparse, summed

Array = NDArray[np.float64]
LAWS = ("none", "constant", "linear")
QUARTERS = 4
WORTH = 3.0
"""Nats that flights left out must speak for something before it is believed: odds of twenty."""
_TINY = 1e-30
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
        features: `FEATURES`, constant first, each of the order of one: as force and as moment show
            them, shape (n, k) each.
        left: Shape (n, 6).
        piece: Number of the uninterrupted piece of flight of each row, shape (n,).
        moments: Of the features and three outputs, of force and of moment, each about its mean in
            this flight: an offset that is there today says nothing of a law.
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
        both = (np.hstack([x, left[:, three]]) for x, three in zip(features, HALVES, strict=True))
        force, moment = (moments_of(columns - columns.mean(axis=0), pieces) for columns in both)
        return cls(features, left, piece, (force, moment))

    def says(self, weights: Array) -> Array:
        """What weights make of the features, shape (n, 6).

        Args:
            weights: Per output and feature, shape (6, k).
        """
        said = [x @ weights[three].T for x, three in zip(self.features, HALVES, strict=True)]
        return np.hstack(said)

    def leaves(self, weights: Array) -> Array:
        """What weights leave of the outputs, shape (n, 6); arguments as of `says`."""
        return self.left - self.says(weights)


@dataclass(frozen=True, slots=True)
class Candidate:
    """One law of one output.

    Attributes:
        law: Of `LAWS`.
        weights: Per feature, 0 where the law has none, shape (k,).
        gain: Log-likelihood of the flights left out over that of `none`, nats.
        observer: Of what the law leaves.
    """

    law: str
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
    half, every = output // 3, flights[0].features[0].shape[1]
    columns = [*range(every), every + output % 3]
    parts = [f.moments[half].of(columns) for f in several if f.moments[half].rows]
    whole = summed([f.moments[half].of(columns) for f in flights])
    folds = [(whole, whole)]  # where it is too short to leave any of it out
    if len(parts) > 1:
        folds = [(summed([m for m in parts if m is not one]), one) for one in parts]
    linear, limits = [_linear(train, output) for train, _ in folds], _limits(every, output)
    found = {}
    for law in LAWS:
        gain = sum(
            _likelihood(_fitted(law, train, own, limits), test)
            for (train, test), own in zip(folds, linear, strict=True)
        )
        weights = _fitted(law, whole, _linear(whole, output), limits).weights
        offsets = np.array(
            [np.mean(f.left[:, output] - f.features[half] @ weights) for f in flights]
        )
        worth = _worth(offsets)
        if law == "constant" or (law != "none" and worth > WORTH):
            weights[0] = offsets.mean() / flights[0].features[half][0, 0]
            gain += worth
        observer = observer_of(
            [(f.left[:, output] - f.features[half] @ weights, pieces_of(f.piece)) for f in flights]
        )
        found[law] = Candidate(law, weights, gain, observer)
    nothing = found[LAWS[0]].gain
    return {law: replace(c, gain=c.gain - nothing) for law, c in found.items()}


def _worth(offsets: Array) -> float:
    """Nats by which the mean of the other flights foretells a flight's offset better than zero.

    Args:
        offsets: By flight, shape (f,); nothing speaks for that of a single one.
    """
    n = len(offsets)
    if n < 2:
        return 0.0
    others = (offsets.sum() - offsets) / (n - 1)
    apart, whole = np.sum((offsets - others) ** 2), np.sum(offsets**2)
    return float(n / 2 * np.log((whole + _TINY) / (apart + _TINY)))


def _linear(moments: Moments, output: int) -> list[int]:
    """Features of a linear law."""
    n = len(FEATURES)
    last = moments.products.shape[-1] - 1
    chosen, _ = sparse(moments.of([*range(1, n), last]), _limits(n, output)[1:])
    return sorted(c + 1 for c in chosen)


def _fitted(law: str, moments: Moments, linear: Sequence[int], most: Array) -> Fit:
    """A law, with a weight for every feature."""
    n, own = len(most), list(linear) if law == "linear" else []
    fit = least_squares(moments.of([*own, n]), most[own])
    weights = np.zeros(n)
    weights[own] = fit.weights
    return replace(fit, weights=weights)


def quarters(flight: Design) -> list[Design]:
    """A flight as several."""
    bounds = np.linspace(0, len(flight.left), QUARTERS + 1).astype(int).tolist()
    force, moment = flight.features
    return [
        Design.of((force[a:b], moment[a:b]), flight.left[a:b], flight.piece[a:b])
        for a, b in pairwise(bounds)
    ]


def _likelihood(fit: Fit, test: Moments) -> float:
    """Log-likelihood of what was left out, its noise of any size, nats."""
    return -test.rows / 2 * float(np.log(missed(test, fit.weights, fit.noise)))


def _limits(n: int, output: int) -> Array:
    """Largest weight of each feature."""
    most = np.full(n, np.inf)
    if n > 1:
        most[list(_AGAINST[output])] = 0.0
    return most
