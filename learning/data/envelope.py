"""Where training has been: a distance in physical inputs, 1 at its end, and what fades beyond.

    z = (x - centre) / scale           d = |whitening @ z| / sqrt(len(z)) / reach

Each row of `whitening` is an input beyond what those before it tell of it, over how far it went by
itself: a vehicle that turned fast and stood still has been to fast turns, and not to speed.

Up to d = 1 a model may say all that it learned. From there to `NETWORK_END` a network fades, from
`LINEAR_BEGIN` to `LINEAR_END` what is linear, neither in a step; a learned force fades as a network
does (`twin.physics.residual_force`), since what it says feeds back into the motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.representation import short_repr

Array = NDArray[np.float64]
NETWORK_END = 2.0
"""Distance at which a network has faded out. Not chosen on flights."""
LINEAR_BEGIN, LINEAR_END = 3.0, 6.0
"""Ends of the fade of what is linear. Neither was chosen on flights."""
INSIDE = 0.995
"""Share of the training that is inside, and of each flight that the others have not seen: flights
differ by more than a flight does within itself."""
BEYOND = 2.0
"""Times as far as on the training flights: so far a learned law goes from nothing, and a linear
prediction from today's offset, at most. Not chosen on flights."""
TRIFLE = 1e-6
"""An input that moves by less, in its unit, did not move."""
UNLIMITED = 1e30
"""Reach of what has no envelope, and scale of what training never knew; finite, so that any tool
reads it."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """Numbers of a distance; `k` physical inputs.

    Attributes:
        centre: Shape (k,).
        scale: Above 0, shape (k,); `UNLIMITED` of an input that training never knew, which counts
            for nothing.
        whitening: Makes z uncorrelated, each row over its own reach; lower triangle, shape (k, k).
        reach: Distance up to which training has been, above 0.
    """

    centre: Array
    scale: Array
    whitening: Array
    reach: float

    __repr__ = short_repr

    @classmethod
    def of(cls, flights: Sequence[Array], reserve: Array) -> "Envelope":
        """That of a training, with room for the next flight: beyond the farthest of n by 1/n of
        it, as is to be expected where all ways are equally likely (the German tank problem).

        Args:
            flights: Inputs of each, NaN where unknown, shape (n, k).
            reserve: By input, what is no other place, in its unit, shape (k,).
        """
        whole = _metric(flights, reserve)
        ends = [whole.ends(np.vstack(flights))]
        for i, one in enumerate(flights if len(flights) > 1 else ()):
            others = _metric([f for j, f in enumerate(flights) if j != i], reserve)
            ends.append(others.ends(one) * others.widths / whole.widths)
        farthest = np.maximum(np.max(ends, axis=0), 1.0)
        rows = replace(whole, whitening=whole.whitening / farthest[:, None])
        reach = max(float(np.quantile(_known(rows.distance(f)), INSIDE)) for f in flights)
        return replace(rows, reach=max(reach * (1 + 1 / len(flights)), TRIFLE))

    @classmethod
    def none(cls, k: int) -> "Envelope":
        """One that holds everything."""
        return cls(np.zeros(k), np.ones(k), np.eye(k), UNLIMITED)

    @property
    def widths(self) -> Array:
        """Of each row of `whitening`, in the unit of its input, shape (k,)."""
        return np.asarray(self.scale / np.diag(self.whitening))

    def white(self, x: Array) -> Array:
        """Inputs along the rows of `whitening`, NaN where one is unknown; shape (n, k)."""
        z = np.where(self.scale < UNLIMITED, (x - self.centre) / self.scale, 0.0)
        return np.asarray(z @ self.whitening.T)

    def ends(self, x: Array) -> Array:
        """How far inputs go along each row, but for the last of them, shape (k,)."""
        white = np.abs(self.white(x))
        known = white[np.isfinite(white).all(axis=1)]
        return np.quantile(known, INSIDE, axis=0) if len(known) else np.ones(white.shape[1])

    def distance(self, x: Array) -> Array:
        """Of inputs, infinite where one of them is unknown; shape (n, k) to (n,)."""
        away = np.sqrt(np.mean(self.white(x) ** 2, axis=1)) / self.reach
        return np.asarray(np.where(np.isfinite(away), away, np.inf))


def _metric(flights: Sequence[Array], reserve: Array) -> Envelope:
    """A distance whose reach is one."""
    x = np.vstack(flights)
    known = np.isfinite(x)
    n = np.maximum(known.sum(axis=0), 1)
    centre = np.where(known, x, 0.0).sum(axis=0) / n
    spread = np.sqrt(np.where(known, (x - centre) ** 2, 0.0).sum(axis=0) / n)
    scale = np.where(spread > TRIFLE, spread, 1.0)
    scale = np.where(known.any(axis=0), scale, UNLIMITED)
    z = np.where(known, (x - centre) / scale, 0.0)
    metric = z.T @ z / len(z) + np.diag((reserve / scale) ** 2 + 1e-12)
    whitening = np.asarray(np.linalg.inv(np.linalg.cholesky(metric)))
    return Envelope(centre, scale, whitening, 1.0)


def _known(distance: Array) -> Array:
    known: Array = distance[np.isfinite(distance)]
    return known if len(known) else np.ones(1)


def network_share(d: Array) -> Array:
    """How much of a network counts at a distance."""
    return _fade(d, 1.0, NETWORK_END)


def linear_share(d: Array) -> Array:
    """How much of what is linear counts at a distance."""
    return _fade(d, LINEAR_BEGIN, LINEAR_END)


def _fade(d: Array, begin: float, end: float) -> Array:
    """1 up to `begin`, 0 from `end` on, in between a cubic without a kink."""
    t = ((d - begin) / (end - begin)).clip(0.0, 1.0)
    return np.asarray(1 - t * t * (3 - 2 * t))
