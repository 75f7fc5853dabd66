"""Noise of the body's channels: white noise, slow drift, and the response of both to a step.

    e_t = l_t + v_t,    l_t+1 = phi l_t + g_t v_t,    v_t ~ N(0, s^2 / weight_t)

the innovations form of an ARMA(1,1): g = phi - theta. With theta zero it is an AR(1); a slow level
with white noise has theta near phi, and a step then persists relative to it. Theta above phi, which
differentiated noisy rates would require, is not a candidate: it integrates the residual of a gain
error of a tenth. In a lively interval the level follows less, by the weight, so that an outlier is
not carried on.

A column that begins at an onset is the whole column less its part before. The filter is linear, so
its innovations are those of the whole column and a transient, the level at the onset times the
products of theta since: sums over time and one sum from the end give all onsets at once.

Source: Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, ch. 3 and 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.signal import lfilter

Array = NDArray[np.float64]
Places = NDArray[np.int64]
"""Numbers of intervals."""

TEMPER = 0.5
"""Tempering of the log evidence: intervals are neither Gaussian nor free of error."""
PHI = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99)
"""Candidate values of phi, of the level."""
THETA = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.97)
"""Candidate values of theta, of the moving average."""
OUTLIER = 3.0
"""Robust standard deviations at which an innovation is clipped when scales are compared."""


@dataclass(frozen=True, slots=True)
class Law:
    """Noise of one channel.

    Attributes:
        phi: Autoregressive coefficient of the level.
        theta: Moving-average coefficient.
        sd: Standard deviation of an innovation.
    """

    phi: float
    theta: float
    sd: float

    @classmethod
    def of(cls, left: Array, floor: float, phis: Sequence[float] = PHI) -> "Law":
        """The law with the smallest innovations.

        Args:
            left: Residuals of a channel's regression, shape (n,).
            floor: Addition to the standard deviation.
            phis: Candidate values of phi.
        """
        laws = [(p, t) for p in phis for t in THETA if t <= p]
        slow = {t: lfilter([1.0], [1.0, -t], left) for t in THETA}
        scale = _scales(
            np.stack([slow[t] - p * np.concatenate([[0.0], slow[t][:-1]]) for p, t in laws])
        )
        best = int(np.argmin(scale))
        return cls(*laws[best], float(scale[best]) + floor)

    def filtered(self, values: Array) -> Array:
        """Innovations with no interval lively, along the first axis."""
        whole = lfilter([1.0, -self.phi], [1.0, -self.theta], values, axis=0)
        return np.asarray(whole)


def _scales(innovations: Array) -> Array:
    """Root mean square of clipped innovations, shape (laws, n), for each law."""
    most = OUTLIER * 1.4826 * np.median(np.abs(innovations), axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.mean(np.clip(innovations, -most, most) ** 2, axis=1)))


def _carried(keep: Array, given: Array) -> Array:
    """Levels l_t+1 = keep_t l_t + given_t from zero, shape (n + 1, ...): a bidiagonal system.

    Args:
        keep: Factors, shape (n,).
        given: Inputs, shape (n, ...).
    """
    band = np.stack([np.ones(len(keep)), -np.append(keep[1:], 0.0)])
    level = solve_banded((1, 0), band, given.reshape(len(given), -1), check_finite=False)
    return np.concatenate([np.zeros((1, *given.shape[1:])), level.reshape(given.shape)])


@dataclass(frozen=True, eq=False)
class Whitened:
    """Columns of one channel as innovations in units of their standard deviation, with sums that
    truncate them.

    Attributes:
        rows: Innovations, shape (n, k).
        level: Level of each column before each interval, shape (n + 1, k).
        by_rows: Sum from each interval on of the transient that begins there times the rows, shape
            (n + 1, k).
        by_itself: Sum from each interval on of the squared transient, shape (n + 1,).
        survives: Log of the product of the decays until each interval, shape (n + 1,).
        decay: Remaining share of the level, shape (n,).
        scale: Scale of an innovation over its standard deviation, shape (n,).
        phi: Coefficient phi of the law.
    """

    rows: Array
    level: Array
    by_rows: Array
    by_itself: Array
    survives: Array
    decay: Array
    scale: Array
    phi: float

    @classmethod
    def each(cls, law: Law, weight: Array, columns: Array) -> list["Whitened"]:
        """Filter sets of columns.

        Args:
            law: Law of the noise.
            weight: Weight of each interval, 0..1, shape (n,).
            columns: Columns, shape (n, sets, k).
        """
        follow = (law.phi - law.theta) * weight
        decay, scale = law.phi - follow, np.sqrt(weight) / law.sd
        level = _carried(decay, follow[:, None, None] * columns)
        rows = (columns - level[:-1]) * scale[:, None, None]
        by_rows = _carried(decay[::-1], (rows * scale[:, None, None])[::-1])[::-1]
        by_itself = _carried(decay[::-1] ** 2, scale[::-1] ** 2)[::-1]
        lost = np.log(np.maximum(np.abs(decay), 1e-9))
        survives = np.concatenate([[0.0], np.cumsum(lost)])
        return [
            cls(rows[:, i], level[:, i], by_rows[:, i], by_itself, survives, decay, scale, law.phi)
            for i in range(columns.shape[1])
        ]

    @cached_property
    def gram(self) -> Array:
        """Products of the rows, cumulated, shape (n + 1, k, k)."""
        total = np.cumsum(self.rows[:, :, None] * self.rows[:, None], axis=0)
        return np.concatenate([np.zeros((1, *total.shape[1:])), total])

    def joined(self, start: Places, onset: Places, end: Places) -> Array:
        """Gram matrices of [whole columns, columns from the onset on] between start and end, shape
        (onsets, 2 k, 2 k)."""
        whole, after = self.gram[end] - self.gram[start], self.gram[end] - self.gram[onset]
        level, (by_rows, by_itself) = self.level[onset], self._transient(onset, end)
        mixed = after + by_rows[:, :, None] * level[:, None]
        own = by_rows + by_itself[:, None] * level
        ending = mixed + level[:, :, None] * own[:, None]
        return np.block([[whole, mixed], [mixed.transpose(0, 2, 1), ending]])

    def passing(
        self, joined: Array, column: int, onset: Places, over: Places, end: Places
    ) -> Array:
        """Gram matrices with one more column: one that is active from the onset until an end, shape
        (onsets, 2 k + 1, 2 k + 1)."""
        k, level = self.rows.shape[1], self.level[over, column]
        by_rows, by_itself = self._transient(over, end)
        whole = (self.gram[end] - self.gram[over])[:, :, column] + by_rows * level[:, None]
        own = by_rows[:, column] + by_itself * level
        left = np.exp(self.survives[over] - self.survives[onset])
        after = whole + (left * own)[:, None] * self.level[onset]
        pulse = joined[:, :, k + column] - np.concatenate([whole, after], axis=1)
        itself = pulse[:, k + column] - after[:, column] + whole[:, column] + level * own
        return _joined(joined, pulse, itself)

    def pulsed(self, joined: Array, envelope: Array, onset: Places, end: Places) -> Array:
        """Gram matrices with one more column: one that has a given shape after the onset, and then
        ends.

        Args:
            joined: Gram matrices as from `joined`, shape (onsets, 2 k, 2 k).
            envelope: The shape, shape (steps,).
            onset: Places of the onsets, shape (onsets,).
            end: Ends of the data, shape (onsets,).

        Returns:
            Gram matrices, shape (onsets, 2 k + 1, 2 k + 1).
        """
        steps = np.arange(len(envelope))[:, None]
        at = np.minimum(onset + steps, len(self.rows) - 1)
        inside = onset + steps < end
        keep, scale = self.decay[at], self.scale[at] * inside
        rows, level = np.empty(at.shape), np.zeros(len(onset))
        for t, now in enumerate(envelope.tolist()):
            rows[t] = (now - level) * scale[t]
            level = np.where(inside[t], keep[t] * level + (self.phi - keep[t]) * now, level)
        over = np.minimum(onset + len(envelope), end)
        by_rows, by_itself = self._transient(over, end)
        started = scale * np.exp(self.survives[at] - self.survives[onset])
        left = np.exp(self.survives[over] - self.survives[onset])
        whole = np.einsum("to,tok->ok", rows, self.rows[at]) - level[:, None] * by_rows
        own = (rows * started).sum(axis=0) - level * left * by_itself
        pulse = np.concatenate([whole, whole + own[:, None] * self.level[onset]], axis=1)
        return _joined(joined, pulse, (rows**2).sum(axis=0) + level**2 * by_itself)

    def growing(
        self, joined: Array, columns: Array, over: float, onset: Places, end: Places
    ) -> Array:
        """Gram matrices with more columns: those that grow from zero at the onset.

        Args:
            joined: Gram matrices as from `joined`, shape (onsets, 2 k, 2 k).
            columns: Fully grown columns, shape (n, m).
            over: Number of intervals in which they grow.
            onset: Places of the onsets, shape (onsets,).
            end: Ends of the data, shape (onsets,).

        Returns:
            Gram matrices, shape (onsets, 2 k + m, 2 k + m).
        """
        steps = np.arange(int((end - onset).max()))[:, None]
        at = np.minimum(onset + steps, len(self.rows) - 1)
        inside = onset + steps < end
        grown = np.minimum((steps + 0.5) / over, 1.0)[:, :, None] * columns[at]
        rows, level = np.empty_like(grown), np.zeros_like(grown[0])
        keep, scale = self.decay[at][:, :, None], (self.scale[at] * inside)[:, :, None]
        for t, now in enumerate(grown):
            rows[t] = (now - level) * scale[t]
            level = keep[t] * level + (self.phi - keep[t]) * now
        transient = scale[:, :, 0] * np.exp(self.survives[at] - self.survives[onset])
        before = self.rows[at] * inside[:, :, None]
        after = before + transient[:, :, None] * self.level[onset]
        whole = np.concatenate([before, after], axis=2).transpose(1, 2, 0)
        own = rows.transpose(1, 0, 2)
        mixed = whole @ own
        return np.block([[joined, mixed], [mixed.transpose(0, 2, 1), own.transpose(0, 2, 1) @ own]])

    def _transient(self, onset: Places, end: Places) -> tuple[Array, Array]:
        """Sums over the transients that begin at onsets, until the end."""
        left = np.exp(self.survives[end] - self.survives[onset])
        by_rows = self.by_rows[onset] - left[:, None] * self.by_rows[end]
        return by_rows, self.by_itself[onset] - left**2 * self.by_itself[end]


def _joined(gram: Array, column: Array, itself: Array) -> Array:
    """Gram matrices, shape (n, m, m), with one more column: its products with the others, shape (n,
    m), and with itself, shape (n,)."""
    top = np.concatenate([gram, column[:, :, None]], axis=2)
    return np.concatenate([top, np.append(column, itself[:, None], axis=1)[:, None]], axis=1)
