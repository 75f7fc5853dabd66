"""Autoregressive models that never blow up: Burg's method over several stretches of one signal."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]


def burg(stretches: Sequence[Array], order: int) -> Array:
    """Coefficients of x_t = a_1 x_{t-1} + ... + a_k x_{t-k} + e_t; all poles inside the circle.

    Args:
        stretches: Uninterrupted pieces, each shape (n_i,), about their common mean.
        order: k; less where the pieces hold fewer samples or no power is left.

    Returns:
        Shape (order,).

    Source: Burg, Maximum Entropy Spectral Analysis (1975), sums taken over all pieces.
    """
    forward, backward = ([s.astype(np.float64) for s in stretches] for _ in range(2))
    power = sum(float(s @ s) for s in stretches)
    found: Array = np.zeros(0)
    for _ in range(order):
        forward = [f[1:] for f in forward]
        backward = [b[:-1] for b in backward]
        both = sum(float(f @ f + b @ b) for f, b in zip(forward, backward, strict=True))
        if both <= 1e-12 * power:
            break
        cross = sum(float(f @ b) for f, b in zip(forward, backward, strict=True))
        reflection = 2 * cross / both
        found = np.append(found - reflection * found[::-1], reflection)
        forward, backward = (
            [f - reflection * b for f, b in zip(forward, backward, strict=True)],
            [b - reflection * f for f, b in zip(forward, backward, strict=True)],
        )
    return np.concatenate([found, np.zeros(order - len(found))])


def innovations(values: Array, coefficients: Array) -> Array:
    """e_t of each sample that has enough before it, shape (n - k,)."""
    whitened = lfilter(np.append(1.0, -coefficients), [1.0], values)
    return np.asarray(whitened[len(coefficients) :], dtype=np.float64)


def synthesis(drive: Array, coefficients: Array) -> Array:
    """Signal that innovations give, starting from zero, shape as `drive`."""
    return np.asarray(lfilter([1.0], np.append(1.0, -coefficients), drive), dtype=np.float64)
