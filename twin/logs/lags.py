"""Lag at which inputs explain channels best: one search for the numbering of motors
(`motor_checks.py`) and for late stamps of rotor speeds (`rotor_lag.py`).

Computed from second moments, of each lag and, for standard deviations, of each block of time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .flight import Array

Blocks = slice | NDArray[np.bool_]
"""Blocks of time in use."""
TINY = 1e-12  # avoids division by zero
_RIDGE = 1e-9
"""Ridge as a share of the trace of the input moments: motors with equal signals share a weight."""


@dataclass(frozen=True, slots=True, eq=False)
class LaggedMoments:
    """Second moments of inputs at several lags and of the channels that they explain.

    Attributes:
        inputs: Second moments of the inputs, shape (lags, n, n); by block, (lags, blocks, n, n).
        cross: Cross moments of inputs and channels, shape (lags, n, k) or (lags, blocks, n, k).
        channels: Second moments of the channels, shape (k,) or (blocks, k).
    """

    inputs: Array
    cross: Array
    channels: Array

    @classmethod
    def of(
        cls, inputs: Sequence[Array], channels: Array, rows: Sequence[NDArray[np.intp]]
    ) -> "LaggedMoments":
        """Moments of samples, block by block.

        Args:
            inputs: Inputs at each lag, shape (m, n).
            channels: Channels, shape (m, k).
            rows: Row indices of each block.
        """
        gram = [[u[r].T @ u[r] for r in rows] for u in inputs]
        cross = [[u[r].T @ channels[r] for r in rows] for u in inputs]
        size = np.array([np.sum(channels[r] ** 2, axis=0) for r in rows])
        return cls(np.array(gram), np.array(cross), size)

    def over(self, blocks: Blocks) -> "LaggedMoments":
        """Moments summed over some of the blocks."""
        inputs, cross = (m[:, blocks].sum(axis=1) for m in (self.inputs, self.cross))
        return LaggedMoments(inputs, cross, self.channels[blocks].sum(axis=0))

    def at(self, lag: int) -> "LaggedMoments":
        """Moments at one of the lags."""
        return LaggedMoments(self.inputs[[lag]], self.cross[[lag]], self.channels)

    def r2(self, weights: Array, channel: int) -> Array:
        """R^2 of weighted sums of the inputs, negative for a negative correlation.

        Args:
            weights: Weights of the inputs, shape (..., n).
            channel: Index of the channel.

        Returns:
            R^2, shape (lags, ...).
        """
        along = np.moveaxis(weights @ self.cross[:, :, channel].T, -1, 0)
        size = np.einsum("...i,lij,...j->l...", weights, self.inputs, weights)
        size = np.maximum(size * self.channels[channel], TINY)
        return np.asarray(np.sign(along) * along**2 / size)

    def regressed(self) -> tuple[Array, Array]:
        """Regression weights at each lag, shape (lags, n, k), and explained second moments of the
        channels, shape (lags, k)."""
        size = np.trace(self.inputs, axis1=1, axis2=2)[:, None, None]
        ridge = _RIDGE * np.maximum(size, TINY) * np.eye(self.inputs.shape[1])
        weights = np.linalg.solve(self.inputs + ridge, self.cross)
        return weights, np.sum(self.cross * weights, axis=1)


def best_lag(
    lags_s: Array, r2: Callable[[Blocks], Array], blocks: int
) -> tuple[float, float, float]:
    """The lag of the largest R^2, s, its standard deviation by a jackknife, s, and that R^2.

    Args:
        lags_s: Evenly spaced, shape (lags,).
        r2: R^2 as a function of the blocks in use, shape (lags,).
        blocks: Number of blocks.
    """
    every = r2(slice(None))
    without = np.array([_top(lags_s, r2(np.arange(blocks) != b)) for b in range(blocks)])
    sd_s = np.sqrt((blocks - 1) / blocks * np.sum(np.square(without - without.mean())))
    return _top(lags_s, every), float(sd_s), float(every.max())


def _top(at: Array, values: Array) -> float:
    """Position of the vertex of a parabola through the largest value and its neighbours."""
    k = int(values.argmax())
    if not 0 < k < len(at) - 1:
        return float(at[k])
    left, top, right = (float(v) for v in values[k - 1 : k + 2])
    bend = left - 2.0 * top + right
    offset = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(at[k] + offset * (at[1] - at[0]))
