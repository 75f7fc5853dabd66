"""Consistency of two instruments that measure the same motion, and the time at which it ends.

Their residual is stationary while both are intact, so it is compared with its past in the same
flight: no motor command and no number of the aircraft is needed.

One number sets the sensitivity: the expected number of false changes in ten hours. The running mean
of a residual over its own robust scale is taken as Student's t: heavy-tailed, more so with little
flight before it. Deviations that persist in later means are less probable by chance, by Fisher's
sum of the logarithms of their p-values: no single mean has to exceed all tails of the noise. The
shape of the change, a step, one in proportion to the reading or a pulse, is then a competition of
its own, with heavy-tailed priors on the sizes.

Source: Fisher, Statistical Methods for Research Workers, 1932, 21.1.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import gammaincc, logsumexp
from scipy.stats import t as student

Array = NDArray[np.float64]

FALSE_IN_10_H = 1.0
"""Expected false changes in ten hours in the air, all residuals together."""
TRUE_IN_10_H = 1.0
"""Expected true changes in ten hours: prior of the probability of a change. By judgement."""
DEGREES = 6.0
"""Largest degrees of freedom of a residual's t. In an hour of simulated flight without a fault,
whose noise is Gaussian, no change was reported even at a thousand expected ones in ten hours; six
leaves that margin for real instruments, of which ten hours without a fault were not available."""
PRIOR_DEGREES = 3.0
"""Degrees of freedom of the prior on a residual's scale, before the flight has shown it."""
REFERENCE_S = 5.0
"""Shortest flight before a change, as its reference."""
AFTER_S = 6.0
"""Time after an onset in which a change and its shape are decided."""
FIRST = 0.8
"""Share of the false changes allowed by the first mean alone; the others are shared by all numbers
of subsequent means. By judgement."""
STAYING = 0.5
"""Tempering of the evidence of the means after the first. By judgement."""
PASSES = 0.67
"""Share of the time after an onset within which a passing change has ended."""
LASTS, SCALES = 0.3, 0.1
"""Prior of a permanent change of a zero, and of a scale; else the change passes: estimates are
reset more often than instruments change. By judgement."""
PERSISTS = 0.02
"""Prior of a permanent change where it usually passes, of any size: an estimate that is wrong for
long."""
USUAL_SCALE = 0.05
"""Usual change of a scale."""
OVERLAP = 4.0
"""Tempering of the nats of a shape: running means overlap, and half is believed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Residual:
    """An instrument's reading less that predicted by another one, over time.

    Attributes:
        lasting: Cause of a permanent difference.
        passing: Cause of a difference that passes within seconds.
        scaled: Cause of a difference in proportion to the reading; "": none.
        sensor: Named instrument, or column of the flight table.
        quantity: Quantity of a change's size.
        unit: Unit of reading and difference.
        t_s: Midpoints of its bins, s, shape (n,).
        reading: Reading of the instrument, shape (n,).
        difference: Difference, NaN where unknown, shape (n,).
        error: Standard deviation of the difference due to motion, by errors of clocks and scales,
            shape (n,).
        window_s: Averaging time.
        least: Smallest relevant change, in the unit.
        usual: Usual permanent change, in the unit.
        largest: Largest change with which an aircraft flies, or that the instrument can read, in
            the unit.
    """

    lasting: str
    passing: str
    scaled: str = ""
    sensor: str
    quantity: str
    unit: str
    t_s: Array
    reading: Array
    difference: Array
    error: Array
    window_s: float
    least: float
    usual: float
    largest: float

    @property
    def step_s(self) -> float:
        """Length of a bin, s."""
        return float(self.t_s[1] - self.t_s[0]) if len(self.t_s) > 1 else self.window_s

    @property
    def width(self) -> int:
        """Number of bins of a running mean."""
        return max(round(self.window_s / self.step_s), 1)

    @property
    def means(self) -> int:
        """Number of consecutive means for the detection of a change: one for a level, which drifts;
        errors of differences between samples cancel from one mean to the next."""
        return max(int(AFTER_S / self.window_s), 1) if self.scaled else 1


@dataclass(frozen=True, slots=True)
class Change:
    """A change of a residual from its past.

    Attributes:
        residual: Residual that changed.
        cause: The most probable cause.
        onset_s: Start of the change, s.
        size: Size in the unit of the residual, or as a share of the reading.
        low: Lower end of the size's 90 % interval.
        high: Upper end of the size's 90 % interval.
        probability: Probability that it is no false alarm, times that of the cause.
        others: Other causes with their probabilities, the most probable first.
        middle: Value of the residual before the change.
    """

    residual: Residual
    cause: str
    onset_s: float
    size: float
    low: float
    high: float
    probability: float
    others: tuple[tuple[str, float], ...]
    middle: float

    @property
    def unit(self) -> str:
        """Unit of the size."""
        return "1" if self.cause == self.residual.scaled else self.residual.unit


@dataclass(frozen=True, slots=True)
class FalseAlarmBudget:
    """Allowed rate of changes by chance.

    Attributes:
        false_in_10_h: Expected false changes of all residuals together in ten hours.
        residuals: Number of residuals that share it.
    """

    false_in_10_h: float
    residuals: int

    def chance(self, every_s: float) -> float:
        """Probability that one test at intervals of `every_s` exceeds the bound by chance."""
        return self.false_in_10_h / self.residuals * every_s / 36_000.0

    def probability(self, p_value: float, every_s: float) -> float:
        """Probability that a change of this p-value is a true one, by the rates of true and false
        ones."""
        false = p_value * self.residuals * 36_000.0 / every_s
        return TRUE_IN_10_H / (TRUE_IN_10_H + false)


def changed_at(r: Residual, budget: FalseAlarmBudget) -> Change | None:
    """First change of a residual that its own past does not explain; None without one."""
    look, chance = _looked(r, budget), budget.chance(r.window_s)
    p_value = look.p_value(r)
    over = np.flatnonzero((p_value < chance) & (np.abs(look.apart) > r.least))
    if not len(over):
        return None
    k = int(over[0])
    least = float(np.nanmin(p_value[k : k + 2 * r.width]))
    true = budget.probability(least, r.window_s)
    return _change(r, k, float(look.middle[k]), float(look.scale[k]), true)


def smallest_detectable(r: Residual, budget: FalseAlarmBudget) -> float:
    """Smallest permanent change that would have been detected during half of the flight; infinity:
    none."""
    look, chance = _looked(r, budget), budget.chance(r.window_s)
    known = np.isfinite(look.scale) & np.isfinite(look.apart)
    if not known.any():
        return np.inf
    scale, freedom = np.median(look.scale[known]), np.median(look.freedom[known])

    def beyond(log_z: float) -> float:
        each = np.full(r.means, _surprise(np.exp(log_z), freedom))
        return float(np.log(_by_chance(each).min() / chance))

    return max(float(scale * np.exp(brentq(beyond, 0.0, 12.0))), r.least)


@dataclass(frozen=True, slots=True)
class _Look:
    """A residual relative to its past, at each bin, NaN until there is enough of it: running mean
    less its past median; ratio of past to expected scale, and its degrees of freedom; the median;
    the expected scale of the mean; the least scale."""

    apart: Array
    over: Array
    freedom: Array
    middle: Array
    expected: Array
    least: float

    @property
    def scale(self) -> Array:
        """Scale of the mean at each bin, shape (n,)."""
        return np.asarray(np.maximum(self.over * self.expected, self.least))

    def p_value(self, r: Residual) -> Array:
        """P-value at each bin: of its mean and the following ones, as long as they deviate to the
        same side, relative to the past; 1 where unknown. Shape (n,)."""
        mean, n = self.apart + self.middle, len(self.apart)
        each = np.full((r.means, n), np.nan)
        for m in range(r.means):
            rows, till = slice(m * r.width, None), max(n - m * r.width, 0)
            apart = mean[rows] - self.middle[:till]
            scale = np.maximum(self.over[:till] * self.expected[rows], self.least)
            stays = (apart * self.apart[:till] > 0.0) & (np.abs(apart) > r.least)
            surprise = _surprise(np.abs(apart) / scale, self.freedom[:till])
            each[m, :till] = np.where(stays, surprise, np.nan)
        return np.asarray(np.nan_to_num(_by_chance(each), nan=1.0).min(axis=0))


def _surprise(z: Array | float, freedom: Array | float) -> Array:
    """Negative logarithm of the p-value of a deviation in units of its scale."""
    surprise: Array = -np.log(2.0) - np.asarray(student.logsf(z, freedom), dtype=np.float64)
    return surprise


def _by_chance(each: Array) -> Array:
    """P-value of a chain of means by length, corrected for the number of lengths, shape as given.

    Args:
        each: Negative log p-value of each mean, shape (means, ...); NaN ends the chain.
    """
    count, axes = len(each), (-1, *(1,) * (each.ndim - 1))
    share = np.full(count, STAYING)
    trials = np.full(count, (count - 1) / (1.0 - FIRST))
    share[0], trials[0] = 1.0, 1.0 / FIRST if count > 1 else 1.0
    total = np.cumsum(each * share.reshape(axes), axis=0)
    number = np.arange(1, count + 1).reshape(axes)
    return np.asarray(trials.reshape(axes) * gammaincc(number, np.maximum(total, 0.0)))


def _looked(r: Residual, budget: FalseAlarmBudget) -> _Look:
    """Test statistics of a residual. Its scale is that of motion and the least change, times the
    ratio in the past, with a prior of `PRIOR_DEGREES` on a ratio of one."""
    width, least = r.width, round(REFERENCE_S / r.step_s)
    ahead = pd.Series(r.difference[::-1]).rolling(width, min_periods=max(width // 2, 1)).mean()
    mean = ahead.to_numpy()[::-1].copy()
    mean[len(mean) - width + 1 :] = np.nan
    before = pd.Series(mean).shift(width).expanding(least)
    middle, count = before.median().to_numpy(), before.count().to_numpy() / width
    usual = r.least / float(student.isf(budget.chance(r.window_s) / 2.0, DEGREES))
    motion = pd.Series(r.error[::-1]).rolling(width, min_periods=1).mean().to_numpy()[::-1]
    expected = np.hypot(usual, motion)
    off = pd.Series(np.abs(mean - pd.Series(mean).expanding().median()) / expected)
    spread = off.shift(width).expanding(least).median().to_numpy() / 0.6745
    seen = np.maximum(count - 1.0, 0.0)
    over = np.sqrt((PRIOR_DEGREES + seen * spread**2) / (PRIOR_DEGREES + seen))
    freedom = np.minimum(PRIOR_DEGREES + seen, DEGREES)
    return _Look(mean - middle, over, freedom, middle, expected, usual)


def trailing_median(values: Array, bins: float) -> Array:
    """Median of a number of values up to each one."""
    rolling = pd.Series(values).rolling(max(round(bins), 1), min_periods=1)
    return np.asarray(rolling.median().to_numpy(), dtype=np.float64)


def running_median(values: Array, bins: float) -> Array:
    """Median of a number of values about each one."""
    rolling = pd.Series(values).rolling(max(round(bins) | 1, 1), min_periods=1, center=True)
    return np.asarray(rolling.median().to_numpy(), dtype=np.float64)


# -- the shape of a change ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Shape:
    """A change of a residual: place of its onset, size, reduction of the sum of squares; sum of
    squares of its regressor, and number of its parameters."""

    start: int
    size: float
    gain: float
    weight: float
    numbers: int


def _change(r: Residual, k: int, middle: float, scale: float, true: float) -> Change:
    """The change that is detected at bin k: onset, size, and shape.

    Shapes compete on the neighbouring bins; each has the usual cost of its parameters (Schwarz
    1978) and the prior of its size.
    """
    after = max(round(AFTER_S / r.step_s), 3 * r.width)
    part = slice(max(k - r.width, 0), min(k + after, len(r.t_s)))
    d, begin = r.difference[part] - middle, np.arange(2 * r.width + 1)
    noise = OVERLAP * r.width * scale**2  # noise of a bin, such that bins add up to a running mean
    shapes = {r.lasting: _steps(d, np.ones(len(d)), begin)}
    if r.scaled:
        shapes[r.scaled] = _steps(d, r.reading[part], begin)
    shapes.setdefault(r.passing, _pulse(d, begin))
    cost = 0.5 * np.log(len(d))
    score = {
        c: s.gain / noise / 2.0 - s.numbers * cost + _prior(r, c, s.size) for c, s in shapes.items()
    }
    step = shapes[r.lasting]
    if r.passing != r.lasting:
        stays = step.gain / noise / 2.0 - step.numbers * cost + np.log(PERSISTS)
        if stays > score[r.passing]:
            score[r.passing], shapes[r.passing] = stays, step
    total = logsumexp(list(score.values()))
    share = {c: float(np.exp(v - total)) for c, v in score.items()}
    first = max(share, key=lambda c: share[c])
    best = shapes[first]
    if first == r.lasting and abs(middle + best.size) < 0.5 * abs(middle) and not _has_zero(r):
        share = _swapped(share, first, r.passing)  # it ends here: the reference was wrong
        first = r.passing
    spread = 1.645 * float(np.sqrt(noise / best.weight))
    others = sorted((c for c in share if c != first), key=lambda c: -share[c])
    return Change(
        r,
        first,
        float(r.t_s[part.start + best.start]) - 0.5 * r.step_s,
        best.size,
        best.size - spread,
        best.size + spread,
        true * share[first],
        tuple((c, true * share[c]) for c in others),
        middle,
    )


def _has_zero(r: Residual) -> bool:
    """Whether the residual of intact instruments has no known value: a field strength, a height."""
    return not r.scaled


def _swapped(share: Mapping[str, float], a: str, b: str) -> dict[str, float]:
    return {**share, a: share[b], b: share[a]}


def _prior(r: Residual, cause: str, size: float) -> float:
    """Log prior of a shape and its size: Cauchy tails, so that no large size is excluded."""
    if cause == r.scaled:
        return float(np.log(SCALES) - np.log1p((size / USUAL_SCALE) ** 2))
    if cause == r.lasting and r.lasting != r.passing:
        return float(np.log(LASTS) - np.log1p((size / r.usual) ** 2))
    return float(np.log(1.0 - SCALES - LASTS))


def _steps(d: Array, regressor: Array, begin: NDArray[np.intp]) -> _Shape:
    """The best onset of a permanent change in proportion to a regressor."""
    known = np.isfinite(d) & np.isfinite(regressor)
    x = np.where(known, regressor, 0.0)
    begin = begin[begin < len(d)]
    total = np.cumsum((x * np.where(known, d, 0.0))[::-1])[::-1][begin]
    weight = np.cumsum((x * x)[::-1])[::-1][begin] + 1e-12
    k = int(np.argmax(total**2 / weight))
    size = float(total[k] / weight[k])
    return _Shape(int(begin[k]), size, float(total[k]) * size, float(weight[k]), 2)


def _pulse(d: Array, begin: NDArray[np.intp]) -> _Shape:
    """The best change that passes again."""
    known = np.isfinite(d)
    total = np.append(0.0, np.cumsum(np.where(known, d, 0.0)))
    n = np.append(0, np.cumsum(known))
    end = np.arange(1, max(int(len(d) * PASSES), 1) + 1)
    i, j = np.meshgrid(begin[begin < len(d)], end, indexing="ij")
    inside = np.maximum(n[j] - n[i], 1)
    gain = np.where(j > i, (total[j] - total[i]) ** 2 / inside, 0.0)
    a, b = np.unravel_index(int(np.argmax(gain)), gain.shape)
    size = float((total[b + 1] - total[a]) / inside[a, b])
    return _Shape(int(a), size, float(gain[a, b]), float(inside[a, b]), 3)
