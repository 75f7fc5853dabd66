"""Order of time stamps: samples of increasing time, and agreement with the order in the file."""

import math
from abc import abstractmethod
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .flight import FindingCollector, Severity

_JUMP_US = 60_000_000  # gap between two groups of samples from different flights
_FEW = 0.02  # share of samples below which such a group is damage
_PAUSE_S = 0.2  # shortest pause of a steady signal
_PAUSE_INTERVALS = 2.2  # shortest pause in median intervals
_SHOWN = 8  # number of times that a finding lists
_LATEST = 0.5  # share of the record after which a signal begins late


EARLIER = "before the time stamp of the log"
"""Words of the finding on a signal whose stamps are corrected for the delay of its low-pass."""


def filter_delay_us(cutoff_hz: float) -> int:
    """Low-frequency delay of a second-order Butterworth low-pass, sqrt(2) / (2 pi f), us."""
    return round(1e6 * math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz))


def mean_rate_hz(t_us: NDArray[np.int64]) -> float:
    """Mean rate between the first and the last of increasing times, us; 0 for fewer than two."""
    if len(t_us) < 2:
        return 0.0
    return float((len(t_us) - 1) / ((t_us[-1] - t_us[0]) * 1e-6))


class Timed:
    """Samples with times.

    Attributes:
        t_us: Time of each sample, us, shape (n,).
    """

    __slots__ = ()
    t_us: NDArray[np.int64]

    @property
    def t_s(self) -> NDArray[np.float64]:
        """Times, s, shape (n,)."""
        return np.asarray(self.t_us * 1e-6, dtype=np.float64)

    @property
    def rate_hz(self) -> float:
        """Mean rate between the first and the last sample, Hz; 0 for fewer than two."""
        return mean_rate_hz(self.t_us)

    @abstractmethod
    def has(self, *fields: str) -> bool:
        """Whether the topic has every field as numbers."""


AnyTopic = TypeVar("AnyTopic", bound=Timed)


def with_fields(
    log: FindingCollector, name: str, topic: AnyTopic | None, needs: Sequence[str]
) -> AnyTopic | None:
    """A topic with all of some fields; else None, and a finding."""
    lacks = [] if topic is None else [f for f in needs if not topic.has(f)]
    if not lacks:
        return topic
    log.note("warning", name, f"has no field {', '.join(lacks)}; it is not used")
    return None


@dataclass(frozen=True, slots=True)
class Pauses:
    """Intervals in which samples are missing.

    Attributes:
        count: Number of pauses.
        longest_s: Length of the longest pause.
        at_s: Start of the longest pause.
    """

    count: int
    longest_s: float
    at_s: float

    @property
    def message(self) -> str:
        """The text of a finding."""
        return f"gaps, the longest of {self.longest_s:.3g} s after {self.at_s:.2f} s"


def pauses(t_us: NDArray[np.int64]) -> Pauses | None:
    """Pauses of a steady signal: over 0.2 s and over 2.2 median intervals; None without any.

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
    """Texts of findings where a signal of steady rate is missing at the ends of a record.

    It may stop before the end by as long as in `pauses`: in six recorded PX4 logs all topics end
    within 1.5 intervals. It may begin in the first half: estimates begin within 22 % of it.

    Args:
        t_us: Increasing times, us, shape (n,).
        begin_us: Start of the record, us.
        end_us: End of the record, us.

    Returns:
        Texts; none for fewer than two samples.
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
    """Interval of a steady signal beyond which it is a pause, s."""
    return max(_PAUSE_S, _PAUSE_INTERVALS * float(np.median(steps_s)))


def monotonic(t: NDArray[np.int64]) -> tuple[NDArray[np.bool_], int, int, int]:
    """Choose samples so that time strictly increases, dropping as few as possible.

    Args:
        t: Time stamps, us, shape (n,), in the order of the file.

    Returns:
        Mask of the samples to keep, shape (n,), then how many are dropped because time runs
        backward, because it repeats, and because they are over a minute from the rest.
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
    """Samples in a small group (under 2 %) that is over a minute from every other sample."""
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


def monotonic_samples(
    log: FindingCollector,
    where: str,
    t_us: NDArray[np.int64],
    what: str,
    severity: Severity = "error",
) -> NDArray[np.bool_]:
    """Mask of samples whose time strictly increases, as in `monotonic`; findings count the rest.

    Args:
        log: Collects the findings.
        where: Name of the signal in findings.
        t_us: Time stamps, us, shape (n,), in the order of the file.
        what: Name of a sample in the log.
        severity: Severity of the findings.

    Returns:
        Mask of the samples to keep, shape (n,).
    """
    keep, backward, repeated, jumped = monotonic(t_us)
    for count, why in (
        (backward, "whose time runs backward"),
        (repeated, "whose time repeats"),
        (jumped, "that lie more than a minute from the rest"),
    ):
        log.note(severity, where, f"{what} dropped {why}", count)
    return keep


def note_cut(log: FindingCollector, tail: int) -> None:
    """The finding on a log that ends inside a message, with the number of bytes; none for 0."""
    message = f"cut short: it ends inside a message; the last {tail} bytes are not used"
    log.note("error", "log", message, tail)


# -- stamps and the order in the file -----------------------------------------------------------
#
# Time stamps of a ULog compared with the order of its messages in the file.
#
# The logger writes messages as they arrive, so neighbours have similar stamps whatever their topic.

_NEIGHBOURS = 101
"""Number of samples of which the median stamp is computed."""
_MANY = 0.2
"""Share of all samples from which a topic would dominate the median."""
_FAR_US = 10_000_000
"""Distance of a stamp from its neighbours beyond which it comes from another clock."""
APART_S = 0.15
"""Largest median offset of a whole topic; valid PX4 logs: under 80 ms for GPS, 10 ms for fast
topics."""


def stamp_offsets(
    places: Sequence[NDArray[np.int64]], stamps_us: Iterable[NDArray[np.int64]]
) -> list[NDArray[np.int64]]:
    """Difference of each stamp from the median of its neighbours in the file, us.

    Args:
        places: Positions of the samples of each topic in the file, each of shape (n,).
        stamps_us: Time stamps of each topic, each of the same shape.

    Returns:
        Offset per topic, us, shape (n,); positive: stamped later than its neighbours in the file.
    """
    if not any(map(len, places)):
        return [np.zeros(0, dtype=np.int64) for _ in places]
    stamps = list(stamps_us)
    place, stamp = np.concatenate(places), np.concatenate(stamps)
    owner = np.repeat(np.arange(len(places)), [len(p) for p in places])
    order = np.argsort(place, kind="stable")
    place, stamp, owner = place[order], stamp[order], owner[order]
    every = _clock(stamp)
    out = []
    for k, (own_place, own_stamp) in enumerate(zip(places, stamps, strict=True)):
        others = owner != k
        if len(own_place) > _MANY * len(place) and others.any():  # it would dominate the median
            clock = np.interp(own_place, place[others], _clock(stamp[others]))
        else:
            clock = np.interp(own_place, place, every)
        out.append(own_stamp - np.round(clock).astype(np.int64))
    return out


def stray_samples(
    log: FindingCollector, names: Sequence[str], off_us: Sequence[NDArray[np.int64]], what: str
) -> Iterator[NDArray[np.bool_]]:
    """Mask of samples stamped far from their neighbours in the file; findings count them.

    Args:
        log: Takes the findings.
        names: Names of the topics.
        off_us: Offsets per topic, as from `stamp_offsets`.
        what: Name of a sample in the log.

    Returns:
        Mask of the samples to drop per topic, shape (n,).
    """
    for name, off in zip(names, off_us, strict=True):
        far = np.abs(off) > _FAR_US
        middle_s = float(np.median(off)) * 1e-6
        message = (
            f"{what} dropped, stamped over {_FAR_US * 1e-6:.0f} s from what stands next to "
            f"them in the file (median {middle_s:+.3g} s): another clock, or another unit?"
        )
        log.note("error", name, message, far)
        if abs(middle_s) > APART_S and not far.all():
            message = f"stamped {middle_s:+.2f} s from what stands next to it in the file"
            log.note("error", name, f"{message}: another clock?")
        yield far


def _clock(stamp_us: NDArray[np.int64]) -> NDArray[np.float64]:
    """Median of each stamp and its neighbours, us, with the first and the last one repeated."""
    half = _NEIGHBOURS // 2
    repeated = pd.Series(np.pad(stamp_us, half, mode="edge"))
    median = repeated.rolling(_NEIGHBOURS, center=True).median().to_numpy(dtype=np.float64)
    return np.asarray(median[half:-half])
