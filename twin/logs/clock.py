"""Time stamps put in order: which samples of a series can stay."""

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

_JUMP_US = 60_000_000
_FEW = 0.02


def advancing(t: NDArray[np.int64]) -> tuple[NDArray[np.bool_], int, int, int]:
    """Choose samples so that time strictly increases, dropping as few as possible.

    Args:
        t: Time stamps, us, shape (n,), in the order of the file.

    Returns:
        Mask of the samples to keep, shape (n,), then how many are dropped because time runs
        backward, because it repeats, and because they lie over a minute from the rest.
    """
    keep = np.ones(len(t), dtype=np.bool_)
    far = far_off(t)
    keep[far] = False
    left = np.flatnonzero(keep)
    steps = np.diff(t[left])
    if np.all(steps > 0):
        return keep, 0, 0, int(far.sum())
    rising = left[_longest_rise(t[left])]
    keep[:] = False
    keep[rising] = True
    repeated = int(np.count_nonzero(np.isin(t[left], t[rising]) & ~keep[left]))
    dropped = len(left) - len(rising)
    return keep, dropped - repeated, repeated, int(far.sum())


def far_off(t: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Samples of a small group (under 2 %) that is over a minute from every other sample."""
    order = np.argsort(t, kind="stable")
    group = np.concatenate([[0], np.cumsum(np.diff(t[order]) > _JUMP_US)])
    if group[-1] == 0:
        return np.zeros(len(t), dtype=np.bool_)
    sizes = np.bincount(group)
    small = (sizes < _FEW * len(t)) & (sizes < sizes.max())
    far = np.zeros(len(t), dtype=np.bool_)
    far[order] = small[group]
    return far


def _longest_rise(t: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices of a longest strictly increasing subsequence (patience sorting, O(n log n))."""
    tails: list[int] = []
    tail_at: list[int] = []
    before = np.full(len(t), -1, dtype=np.int64)
    for i, value in enumerate(t.tolist()):
        k = bisect_left(tails, value)
        if k == len(tails):
            tails.append(value)
            tail_at.append(i)
        else:
            tails[k] = value
            tail_at[k] = i
        before[i] = tail_at[k - 1] if k else -1
    chain = []
    i = tail_at[-1] if tail_at else -1
    while i >= 0:
        chain.append(i)
        i = int(before[i])
    return np.array(chain[::-1], dtype=np.int64)
