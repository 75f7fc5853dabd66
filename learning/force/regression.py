"""Least squares under noise that is not white.

What the equations leave of a flight is mostly slow: gusts, a battery, a rope. A controller answers
it, so commands go with it; plain least squares reads the answer as the cause and learns a model
that is deaf to commands (on the hovers of a real quadrotor it takes half of the rolling residual
away and is 1.4 times as wrong about what happens from one sample to the next). Here the noise is an
autoregression, found together with the weights, and both sides are whitened by it.

Everything is told from sums over the rows, which add up over flights: one pass over each flight,
whatever is fitted afterwards.

Source: generalised least squares with autoregressive noise, Cochrane & Orcutt, JASA 1949; why the
noise has to be modelled where commands answer it, Ljung, System Identification, ch. 13.4.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

Array = NDArray[np.float64]
ORDER = 12
"""Of the autoregression: a quarter of a second at 50 samples per second."""
ROUNDS = 100
"""Of weights and noise in turn, at most."""
SETTLED = 1e-3
"""Change of the weights, in their own deviations, below which nothing is to be gained."""
MOST, TRIED = 8, 3
"""Features of a sparse fit, at most; and how many are tried under each noise."""
CHUNK = 4096
"""Rows that are taken at once, which bounds the memory."""
_TINY = 1e-9
"""Ridge per row against features that are alike to rounding."""


@dataclass(frozen=True, slots=True)
class Moments:
    """Sums over the rows of a flight, or of several: products of columns now and up to `ORDER` ago.

    Attributes:
        products: Of column a i rows ago with column b j rows ago, shape
            (ORDER + 1, ORDER + 1, m, m): i, j, a, b.
        rows: How many.
    """

    products: Array
    rows: int

    def of(self, columns: Sequence[int]) -> "Moments":
        """Of some of the columns."""
        chosen = list(columns)
        products = np.ascontiguousarray(self.products[:, :, chosen][:, :, :, chosen])
        return Moments(products, self.rows)

    def between(self, weights: Array) -> Array:
        """Products of a weighted sum of the columns with itself, shape (ORDER + 1, ORDER + 1)."""
        return np.asarray(np.tensordot(self.products, np.outer(weights, weights), 2))

    def whitened(self, noise: Array) -> Array:
        """Products of the columns as a filter shows them, shape (m, m).

        Args:
            noise: The filter, newest row first, shape (ORDER + 1,).
        """
        return np.asarray(np.tensordot(np.outer(noise, noise), self.products, 2))


def moments_of(columns: Array, pieces: Iterable[slice]) -> Moments:
    """Of a flight.

    Args:
        columns: Shape (n, m), of the order of one each.
        pieces: Rows of uninterrupted flight, each longer than `ORDER`.
    """
    m = columns.shape[1]
    width = (ORDER + 1) * m
    products, rows = np.zeros((width, width)), 0
    for piece in pieces:
        part = columns[piece]
        n = len(part) - ORDER
        for first in range(0, n, CHUNK):
            some = min(CHUNK, n - first)
            starts = (ORDER - i + first for i in range(ORDER + 1))
            ago = np.hstack([part[a : a + some] for a in starts])
            products += ago.T @ ago
        rows += n
    ordered = products.reshape(ORDER + 1, m, ORDER + 1, m).transpose(0, 2, 1, 3)
    return Moments(np.ascontiguousarray(ordered), rows)


def summed(moments: Sequence[Moments]) -> Moments:
    """Of all flights together."""
    return Moments(
        np.asarray(np.sum([m.products for m in moments], axis=0)), sum(m.rows for m in moments)
    )


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
        weights: Shape (m - 1,).
        noise: Filter that takes what they leave to what is new in it, 1 first, shape
            (ORDER + 1,).
        new: Mean square of that.
    """

    weights: Array
    noise: Array
    new: float


def least_squares(moments: Moments, most: Array) -> Fit:
    """Weights by least squares on what is whitened by the noise that they leave.

    Noise that is slow can stand for a slow cause, and weights for slow noise: from weights of zero
    one ends in the former, from plain least squares in the latter. Both are tried, and the more
    probable one is taken.

    Args:
        moments: Of the features and, last, of what they explain.
        most: Largest weight allowed, infinite without a limit, shape (m - 1,).
    """
    nothing = np.zeros(len(most))
    if not len(most):
        return Fit(nothing, *noise_of(moments, nothing))
    fits = [_settled(moments, most, begin) for begin in (nothing, _plain(moments, most))]
    return min(fits, key=lambda fit: fit.new)


def _settled(moments: Moments, most: Array, weights: Array) -> Fit:
    """Weights and noise in turn, until neither changes."""
    noise, new = noise_of(moments, weights)
    for _ in range(ROUNDS):
        white = moments.whitened(noise) / new
        normal = white[:-1, :-1] + _TINY * moments.rows * np.eye(len(most))
        before, weights = weights, _bounded(normal, white[:-1, -1], most)
        noise, new = noise_of(moments, weights)
        step = weights - before
        if step @ normal @ step < SETTLED**2 * len(step):
            break
    return Fit(weights, noise, new)


def sparse(moments: Moments, most: Array) -> tuple[list[int], Fit]:
    """Weights of few features: one after the other is taken as long as it is worth its price.

    Which features to try is told by plain least squares under two noises, that of what the features
    so far leave and that of what all of them would leave; what is taken, by all of it fitted again.
    The price is that of the extended Bayesian information criterion.

    Args:
        moments: Of the features and, last, of what they explain.
        most: Largest weight of each allowed, shape (m - 1,).

    Returns:
        Columns of the features, and weights of these.

    Source: Chen & Chen, Biometrika 95, 2008, gamma 1.
    """
    n = len(most)
    price = np.log(max(moments.rows, 2)) / 2 + np.log(max(n, 1))
    chosen: list[int] = []
    fit = least_squares(moments.of([n]), np.zeros(0))
    flat = _settled(moments, most, _plain(moments, most)).noise
    while len(chosen) < min(MOST, n):
        tried = {}
        for noise in (fit.noise, flat):
            for column in _promising(moments.whitened(noise), chosen):
                if column not in tried:
                    own = [*chosen, column]
                    tried[column] = least_squares(moments.of([*own, n]), most[own])
        best = min(tried, key=lambda c: tried[c].new)
        if moments.rows / 2 * np.log(fit.new / tried[best].new) < price:
            break
        chosen, fit = [*chosen, best], tried[best]
    return chosen, fit


def _promising(white: Array, chosen: Sequence[int]) -> list[int]:
    """Features that would save most alongside those that are there, by plain least squares."""
    n = len(white) - 1
    others = [c for c in range(n) if c not in chosen]
    held = white
    if chosen:
        own = list(chosen)
        projection = np.linalg.solve(
            white[np.ix_(own, own)] + _TINY * np.trace(white) * np.eye(len(own)), white[own]
        )
        held = white - white[:, own] @ projection
    saves = [held[c, n] ** 2 / max(held[c, c], _TINY * white[c, c] + 1e-300) for c in others]
    return [others[i] for i in np.argsort(saves)[::-1][:TRIED]]


def _plain(moments: Moments, most: Array) -> Array:
    """Weights by least squares, nothing whitened."""
    now = moments.products[0, 0]
    return _bounded(now[:-1, :-1] + _TINY * moments.rows * np.eye(len(most)), now[:-1, -1], most)


def noise_of(moments: Moments, weights: Array) -> tuple[Array, float]:
    """Filter to what is new in what weights leave, and the mean square of that.

    By least squares on the rows before; the filter has no poles, so that it may not be unstable.
    """
    left = moments.between(np.append(-weights, 1.0))
    past = left[1:, 1:] + (_TINY * left[0, 0] + 1e-30) * np.eye(ORDER)
    follows = np.linalg.solve(past, left[1:, 0])
    noise = np.append(1.0, -follows)
    return noise, missed(moments, weights, noise)


def missed(moments: Moments, weights: Array, noise: Array) -> float:
    """Mean square of what weights and a filter, of other flights perhaps, leave."""
    left = moments.between(np.append(-weights, 1.0))
    return float(noise @ left @ noise) / moments.rows + 1e-30


def _bounded(normal: Array, right: Array, most: Array) -> Array:
    """Minimum of w @ normal @ w / 2 - right @ w over w <= most."""
    free = np.linalg.solve(normal, right)
    if (free <= most).all():
        return np.asarray(free, dtype=np.float64)
    root = np.linalg.cholesky(normal).T
    there = solve_triangular(root.T, right, lower=True)
    return np.asarray(lsq_linear(root, there, (-np.inf, most), method="bvls").x)
