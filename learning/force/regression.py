"""Ridge regression under noise that is not white.

What the equations leave of a flight is mostly slow: gusts, a battery, a rope. A controller answers
it, so commands go with it; plain least squares reads the answer as the cause and learns a model
that is deaf to commands (on the hovers of a real quadrotor it takes half of the rolling residual
away and is 1.4 times as wrong about what happens from one sample to the next). Here the noise is an
autoregression, found together with the weights, and both sides are whitened by it.

Source: generalised least squares with autoregressive noise, Cochrane & Orcutt, JASA 1949.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz, solve_triangular
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

Array = NDArray[np.float64]
ORDER = 12
"""Of the autoregression: a quarter of a second at 50 samples per second."""
ROUNDS = 4
"""Of weights and noise in turn."""
_TINY = 1e-9


@dataclass(frozen=True, slots=True)
class Noise:
    """An autoregression.

    Attributes:
        filter: Takes a series to its innovations, shape (ORDER + 1,), 1 first.
        size: Root mean square of the innovations.
    """

    filter: Array
    size: float

    def whitened(self, values: Array, pieces: Sequence[slice]) -> Array:
        """Innovations of unit size of each piece, the first `ORDER` rows of it left out.

        Args:
            values: Shape (n,) or (n, k).
            pieces: Rows of uninterrupted flight.
        """
        kept = [lfilter(self.filter, 1.0, values[rows], axis=0)[ORDER:] for rows in pieces]
        return np.concatenate(kept) / self.size


def noise_of(left: Array, pieces: Sequence[slice]) -> Noise:
    """The autoregression of a series, by Yule and Walker; it is stable whatever the series.

    Args:
        left: Shape (n,), of mean zero or nearly.
        pieces: Rows of uninterrupted flight.
    """
    n = sum(p.stop - p.start for p in pieces)
    lags = np.zeros(ORDER + 1)
    for rows in pieces:
        part = left[rows]
        for k in range(min(ORDER + 1, len(part))):
            lags[k] += part[: len(part) - k] @ part[k:] / n
    lags[0] = 1.001 * lags[0] + 1e-18
    weights = solve_toeplitz(lags[:-1], lags[1:])
    size = float(np.sqrt(lags[0] - weights @ lags[1:]))
    return Noise(np.concatenate([[1.0], -weights]), size)


def pieces_of(number: NDArray[np.intp]) -> list[slice]:
    """Rows of each uninterrupted piece that is long enough to be whitened.

    Args:
        number: Of the piece of each row, in order, shape (n,).
    """
    ends = np.flatnonzero(np.diff(number)) + 1
    bounds = zip([0, *ends.tolist()], [*ends.tolist(), len(number)], strict=True)
    return [slice(a, b) for a, b in bounds if b - a > 2 * ORDER]


@dataclass(frozen=True, slots=True)
class Fit:
    """Weights and noise.

    Attributes:
        weights: Shape (k,).
        noise: Of what they leave.
    """

    weights: Array
    noise: Noise


def ridge(features: Array, y: Array, pieces: Sequence[slice], penalty: Array, most: Array) -> Fit:
    """Weights by penalised least squares on what is whitened by the noise that they leave.

    Args:
        features: Shape (n, k), of the order of one each.
        y: Shape (n,).
        pieces: Rows of uninterrupted flight.
        penalty: Prior precision of each weight, in units of innovations, shape (k,); 0: none.
        most: Largest weight allowed, infinite without a limit, shape (k,).
    """
    weights = np.zeros(features.shape[1])
    noise = noise_of(y - y.mean(), pieces)
    for _ in range(ROUNDS):
        a, b = noise.whitened(features, pieces), noise.whitened(y, pieces)
        weights = _bounded(a.T @ a + np.diag(penalty + _TINY), a.T @ b, most)
        noise = noise_of(y - features @ weights, pieces)
    return Fit(weights, noise)


def _bounded(normal: Array, right: Array, most: Array) -> Array:
    """Minimum of w @ normal @ w / 2 - right @ w over w <= most."""
    free = np.linalg.solve(normal, right)
    if (free <= most).all():
        return free
    root = np.linalg.cholesky(normal).T
    there = solve_triangular(root.T, right, lower=True)
    return np.asarray(lsq_linear(root, there, (-np.inf, most), method="bvls").x)
