"""Samples of signals: stretches of them in which something holds, and values between them."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def stretches_where(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First place of each stretch in which something holds, and the place behind its last.

    Args:
        on: Whether it holds, shape (n,).
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return [(a, b) for a, b in edges.reshape(-1, 2).tolist()]


def runs(values: NDArray[Any]) -> list[tuple[int, int]]:
    """First place of each run of equal values, shape (n,), and the place behind its last."""
    begins = np.flatnonzero(values[1:] != values[:-1]) + 1
    return list(pairwise([0, *begins.tolist(), len(values)])) if len(values) else []


def interpolated(at_s: NDArray[Any], t_s: NDArray[Any], values: Array) -> Array:
    """A signal at other times: linear between its samples, the first and last value outside.

    Args:
        at_s: Wanted times, shape (m,).
        t_s: Times of the samples in the same unit, increasing, shape (n,).
        values: Shape (n, k).

    Returns:
        Shape (m, k).
    """
    return np.stack([np.interp(at_s, t_s, column) for column in values.T], axis=-1)
