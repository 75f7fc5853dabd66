"""Training envelope: a distance in physical inputs, 1 at the edge, and fade-outs outside.

    z = (x - centre) / scale           d = |whitening @ z| / sqrt(len(z)) / reach

Each row of `whitening` is an input minus its prediction from those before it, over the range that
it covered by itself: a vehicle that rotated fast while hovering has covered fast rotation, and not
speed.

Up to d = 1 a model is used fully. From there to `NETWORK_END` a network fades out, from
`LINEAR_BEGIN` to `LINEAR_END` the linear part, both smoothly; a learned force fades like a network
(`twin.physics.residual_force`), since its output feeds back into the motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.representation import ShortRepr

Array = NDArray[np.float64]
NETWORK_END = 2.0
"""Distance at which a network has faded out. Not chosen on flights."""
LINEAR_BEGIN, LINEAR_END = 3.0, 6.0
"""Distances at which the fade-out of the linear part begins and ends. Not chosen on flights."""
INSIDE = 0.995
"""Share of the training data that is inside, and of each flight in the envelope of the others:
flights differ more from each other than within themselves."""
BEYOND = 2.0
"""Largest output of a learned law, and largest deviation of a linear prediction from the current
offset, as multiples of those on the training flights. Not chosen on flights."""
TRIFLE = 1e-6
"""Range of an input, in its unit, below which it counts as constant."""
UNLIMITED = 1e30
"""Reach without an envelope, and scale of an input without training data; finite, so that any tool
reads it."""


@dataclass(frozen=True, slots=True)
class Envelope(ShortRepr):
    """Distance from the training data in `k` physical inputs.

    Attributes:
        centre: Centre of the inputs, shape (k,).
        scale: Scale of the inputs, above 0, shape (k,); `UNLIMITED` for an input without training
            data, which is ignored.
        whitening: Lower triangular matrix that decorrelates z, each row divided by its own range,
            shape (k, k).
        reach: Distance covered by the training data, above 0.
    """

    centre: Array
    scale: Array
    whitening: Array
    reach: float

    @classmethod
    def of(cls, flights: Sequence[Array], reserve: Array) -> "Envelope":
        """Envelope of training flights, with a reserve for the next flight: beyond the farthest of
        n by 1/n of its distance, the expectation for exchangeable flights (the German tank
        problem).

        Args:
            flights: Inputs of each flight, NaN where unknown, shape (n, k).
            reserve: Difference of each input within one flight condition, in its unit, shape (k,).
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
        """Envelope without limits."""
        return cls(np.zeros(k), np.ones(k), np.eye(k), UNLIMITED)

    @property
    def widths(self) -> Array:
        """Range of each row of `whitening`, in the unit of its input, shape (k,)."""
        return np.asarray(self.scale / np.diag(self.whitening))

    def white(self, x: Array) -> Array:
        """Inputs along the rows of `whitening`, NaN where one is unknown; shape (n, k)."""
        z = np.where(self.scale < UNLIMITED, (x - self.centre) / self.scale, 0.0)
        return np.asarray(z @ self.whitening.T)

    def ends(self, x: Array) -> Array:
        """Range of the inputs along each row, up to the `INSIDE` quantile, shape (k,)."""
        white = np.abs(self.white(x))
        known = white[np.isfinite(white).all(axis=1)]
        return np.quantile(known, INSIDE, axis=0) if len(known) else np.ones(white.shape[1])

    def distance(self, x: Array) -> Array:
        """Distances of inputs, infinite where one of them is unknown; shape (n, k) to (n,)."""
        away = np.sqrt(np.mean(self.white(x) ** 2, axis=1)) / self.reach
        return np.asarray(np.where(np.isfinite(away), away, np.inf))


def _metric(flights: Sequence[Array], reserve: Array) -> Envelope:
    """Envelope with a reach of one."""
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
    """Weight of a network at a distance."""
    return _fade(d, 1.0, NETWORK_END)


def linear_share(d: Array) -> Array:
    """Weight of the linear part at a distance."""
    return _fade(d, LINEAR_BEGIN, LINEAR_END)


def _fade(d: Array, begin: float, end: float) -> Array:
    """Fade-out: 1 up to `begin`, 0 from `end` on, a smooth cubic in between."""
    t = ((d - begin) / (end - begin)).clip(0.0, 1.0)
    return np.asarray(1 - t * t * (3 - 2 * t))
