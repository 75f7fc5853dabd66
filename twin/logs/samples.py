"""Samples of signals: stretches in which a condition is true, and interpolation."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def stretches_where(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index of each stretch in which a condition is true, and the index behind its last.

    Args:
        on: Whether the condition is true, shape (n,).
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return [(a, b) for a, b in edges.reshape(-1, 2).tolist()]


def runs(values: NDArray[Any]) -> list[tuple[int, int]]:
    """First index of each run of equal values, shape (n,), and the index behind its last."""
    begins = np.flatnonzero(values[1:] != values[:-1]) + 1
    return list(pairwise([0, *begins.tolist(), len(values)])) if len(values) else []


def interpolated(at_s: NDArray[Any], t_s: NDArray[Any], values: Array) -> Array:
    """Interpolated signal: linear between its samples, the first and last value outside.

    Args:
        at_s: Wanted times, shape (m,).
        t_s: Times of the samples in the same unit, increasing, shape (n,).
        values: Samples, shape (n, k).

    Returns:
        Interpolated values, shape (m, k).
    """
    return np.stack([np.interp(at_s, t_s, column) for column in values.T], axis=-1)
