"""Stretches of samples in which something holds."""

import numpy as np
from numpy.typing import NDArray


def stretches_where(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First place of each stretch in which something holds, and the place behind its last.

    Args:
        on: Whether it holds, shape (n,).
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return [(a, b) for a, b in edges.reshape(-1, 2).tolist()]
