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
    left = list(range(len(y)))
    taken: list[int] = []
    steps = int(MOST_SHARE * len(y)) if len(y) >= FEWEST else 0
    for _ in range(steps):
        each = [_deviate(y, own, i, [k for k in left if k != i]) for i in left]
        far = int(np.argmax(np.abs(each)))
        beyond = 2 * float(student.sf(abs(each[far]), len(left) - 2))
        p[left[far]] = min(1.0, steps * len(left) * beyond)
        taken.append(left.pop(far))
    for first, later in zip(reversed(taken[:-1]), reversed(taken[1:]), strict=True):
        p[first] = min(p[first], p[later])
    return p


def _deviate(y: Array, own: Array, i: int, others: list[int]) -> float:
    """Distance of one from the mean of others, over what it would be if it were one of them."""
    rest = y[others]
    spread = float(rest.var(ddof=1)) * (1 + 1 / len(rest))
    wider = max(0.0, float(own[i] - own[others].mean()))
    size = np.sqrt(spread + wider)
    away = float(y[i] - rest.mean())
    return away / size if size > 0 else (0.0 if away == 0 else np.copysign(np.inf, away))
