"""CasADi functions along a record, some thousand rows at a time: what they need besides their
results does not grow with its length."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CHUNK = 1000
"""Rows at a time."""


def accumulated(step: ca.Function, start: Array, *rows: Array) -> tuple[Array, ...]:
    """A step's outputs at every row, each step going on from where the one before ended.

    Args:
        step: Its first argument is the state, its first output the state afterwards.
        start: State before the first row, shape (k,).
        rows: Its other arguments, shape (n, size) each.

    Returns:
        Each output, shape (n, size).
    """
    n = len(rows[0])
    size = min(n, CHUNK)
    run = step.mapaccum("accumulated", size)
    found = tuple(np.empty((n, step.numel_out(i))) for i in range(step.n_out()))
    state = start
    for first in range(0, n, size):
        index = np.minimum(np.arange(first, first + size), n - 1)
        said = run.call([state, *(r[index].T for r in rows)])
        here = slice(first, min(first + size, n))
        for whole, part in zip(found, said, strict=True):
            whole[here] = np.asarray(part, dtype=np.float64).T[: here.stop - first]
        state = found[0][here.stop - 1]
    return found


def mapped(function: ca.Function, *rows: Array) -> Array:
    """A function's first output at every row, shape (n, size).

    Args:
        function: Of dense columns.
        rows: Its arguments, shape (n, size) each.
    """
    found = np.empty((len(rows[0]), function.numel_out(0)))
    for first in range(0, len(found), CHUNK):
        here = slice(first, first + CHUNK)
        (said, *_) = function.map(len(found[here])).call([r[here].T for r in rows])
        found[here] = np.asarray(said, dtype=np.float64).T
    return found
