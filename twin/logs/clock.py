"""Time stamps put in order: which samples of a series can stay."""

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_JUMP_US = 60_000_000
_FEW = 0.02
_PAUSE_S = 0.2
_PAUSE_INTERVALS = 2.2
_LATEST = 0.5


def filter_delay_us(cutoff_hz: float) -> int:
    """Delay of a second-order Butterworth low-pass for what is slow, sqrt(2) / (2 pi f), us."""
    return round(1e6 * math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz))


class Timed:
    """Samples with times.

    Attributes:
        t_us: Time of each, us, shape (n,).
    """

    __slots__ = ()
    t_us: NDArray[np.int64]

    @property
    def t_s(self) -> NDArray[np.float64]:
        """Times, s, shape (n,)."""
        return np.asarray(self.t_us * 1e-6, dtype=np.float64)

    @property
    def rate_hz(self) -> float:
        """Mean rate between the first and the last, 0 for fewer than two."""
        if len(self.t_us) < 2:
            return 0.0
        return float((len(self.t_us) - 1) / ((self.t_us[-1] - self.t_us[0]) * 1e-6))


@dataclass(frozen=True, slots=True)
class Pauses:
    """Intervals in which samples are missing.

    Attributes:
        count: How many.
        longest_s: The longest of them.
        at_s: When that begins.
    """

    count: int
    longest_s: float
    at_s: float

    @property
    def told(self) -> str:
        """The text of a finding."""
        return f"gaps, the longest of {self.longest_s:.3g} s after {self.at_s:.2f} s"


def pauses(t_us: NDArray[np.int64]) -> Pauses | None:
    """Where a signal of a steady rate pauses: 0.2 s and 2.2 of its median intervals; None: nowhere.

    Args:
        t_us: Increasing times, us, shape (n,).
    """
    steps_s = np.diff(t_us) * 1e-6
    if len(steps_s) == 0:
        return None
    long = steps_s > _longest_s(steps_s)
    if not long.any():
        return None
    worst = int(np.argmax(steps_s))
    return Pauses(int(long.sum()), float(steps_s[worst]), float(t_us[worst]) * 1e-6)


def missing_ends(t_us: NDArray[np.int64], begin_us: int, end_us: int) -> list[str]:
    """Texts of findings where a signal of a steady rate is not there at the ends of a record.

    It may stop before the end for as long as in `pauses`: of six recorded PX4 logs all topics end
    within 1.5 intervals. It may begin in the first half: their estimates take up to 22 % of it.

    Args:
        t_us: Increasing times, us, shape (n,).
        begin_us: When the record begins, us.
        end_us: When it ends.

    Returns:
        None of one sample or none.
    """
    if len(t_us) < 2:
        return []
    late_s, left_s = (int(t_us[0]) - begin_us) * 1e-6, (end_us - int(t_us[-1])) * 1e-6
    found = []
    if late_s > _LATEST * (end_us - begin_us) * 1e-6:
        found.append(f"begins at {t_us[0] * 1e-6:.2f} s, {late_s:.3g} s after the record does")
    if left_s > _longest_s(np.diff(t_us) * 1e-6):
        found.append(f"ends at {t_us[-1] * 1e-6:.2f} s, {left_s:.3g} s before the record does")
    return found


def _longest_s(steps_s: NDArray[np.float64]) -> float:
    """Beyond which an interval of a steady signal is a pause, s."""
    return max(_PAUSE_S, _PAUSE_INTERVALS * float(np.median(steps_s)))


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


def longest_stretch(t: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Times of the largest group that has no pause of over a minute.

    Args:
        t: Increasing times, us, shape (n,).
    """
    group = np.concatenate([[0], np.cumsum(np.diff(t) > _JUMP_US)])
    return np.asarray(group == np.argmax(np.bincount(group)))


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


def told_dropped(what: str, backward: int, repeated: int, jumped: int) -> Iterator[tuple[str, int]]:
    """Messages and counts of what `advancing` leaves out, of samples that are called so."""
    for count, why in (
        (backward, "whose time runs backward"),
        (repeated, "whose time repeats"),
        (jumped, "that lie more than a minute from the rest"),
    ):
        if count:
            yield f"{what} dropped {why}", count
