"""Which aircraft differs from the others in a number.

Source: Rosner, Technometrics 25 (1983) 165-172, the generalised extreme Studentised deviate: the
one farthest from the rest is taken out, and again; an aircraft differs where its deviate, or that
of one taken out after it, is more than the most extreme of so many would have. His critical values
are for 25 and more; of fewer, one of several steps is beyond them more often than he says, so that
here probabilities are multiplied by the number of steps.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

Array = NDArray[np.float64]
FEWEST = 4
"""Aircraft among which one can differ."""
MOST_SHARE = 1 / 3
"""Of the aircraft, that may differ; of more, nobody knows which are the usual ones."""


def differing(value: Sequence[float] | Array, variance: Sequence[float] | Array) -> Array:
    """Probability that one as far from the others would be among so many that are alike.

    Args:
        value: Of each aircraft, shape (n,).
        variance: Of each value, by what is known of it; those above the mean of the others widen
            what is allowed. Shape (n,).

    Returns:
        Shape (n,); 1 for those that are not among the farthest third.
    """
    y, own = np.asarray(value, dtype=np.float64), np.asarray(variance, dtype=np.float64)
    p = np.ones(len(y))
    left = np.arange(len(y))
    taken: list[int] = []
    steps = int(MOST_SHARE * len(y)) if len(y) >= FEWEST else 0
    for _ in range(steps):
        each = np.abs(_deviates(y[left], own[left]))
        far = int(np.argmax(each))
        beyond = 2 * float(student.sf(each[far], len(left) - 2))
        p[left[far]] = min(1.0, steps * len(left) * beyond)
        taken.append(int(left[far]))
        left = np.delete(left, far)
    for first, later in zip(reversed(taken[:-1]), reversed(taken[1:]), strict=True):
        p[first] = min(p[first], p[later])
    return p


def _deviates(y: Array, own: Array) -> Array:
    """Distance of each from the mean of the others, over what it would be if it were one of them.

    Args:
        y: Shape (n,).
        own: Variances, shape (n,).

    Returns:
        Shape (n,); infinite for one that is apart from others that are all the same.
    """
    n = len(y)
    centred = y - np.median(y)
    mean = (centred.sum() - centred) / (n - 1)
    squares = (centred @ centred - centred**2) - (n - 1) * mean**2
    spread = np.maximum(squares, 0.0) / (n - 2) * (1 + 1 / (n - 1))
    wider = np.maximum(0.0, own - (own.sum() - own) / (n - 1))
    away, size = centred - mean, np.sqrt(spread + wider)
    least = 1e-12 * float(np.abs(y).max(initial=0.0))
    flat = np.where(np.abs(away) <= least, 0.0, np.inf)
    return np.asarray(np.where(size > least, away / np.maximum(size, 1e-300), flat))
