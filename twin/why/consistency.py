"""Two instruments that see the same motion, held against each other: when did they part?

Their residual stays as it was while both are sound, so it is held against what it was before in the
same flight: no motor command and no number of the aircraft is needed.

One number says how readily a change is reported: the expected number of false ones in ten hours.
The running mean of a residual over its own robust scale is taken as Student's t: heavy-tailed, more
so where little flight lies before it. What stays off in the means that follow is so much the less
probable by chance, by Fisher's sum of the logarithms of their p-values: no single mean has to leave
all tails of the noise. What shape the change has, a step, one in proportion to the reading or a
pulse, is then a competition of its own, with heavy-tailed priors on the sizes.

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
"""Expected true ones: prior of the probability of a change. By judgement."""
DEGREES = 6.0
"""Largest degrees of freedom of a residual's t. In an hour of simulated flight without a fault,
whose noise is Gaussian, no change was reported even at a thousand expected ones in ten hours; six
keeps that distance for real instruments, of which ten hours without a fault were not to be had."""
PRIOR_DEGREES = 3.0
"""Degrees of freedom that a residual's usual scale is worth where a flight has not shown it yet."""
REFERENCE_S = 5.0
"""Least flight before a change, against which it is held."""
AFTER_S = 6.0
"""Time after an onset by which a change, and the shape of it, is told."""
FIRST = 0.8
"""Share of the false changes that the first mean may call by itself; the others are shared by all
numbers of means that follow it. By judgement."""
STAYING = 0.5
"""Share of the evidence of the means that follow the first that is believed. By judgement."""
PASSES = 0.67
"""Share of the time after an onset within which a passing change is over."""
LASTS, SCALES = 0.3, 0.1
"""Prior of a zero that moves for good, and of a scale that changes; else something passes:
estimates are reset more often than instruments change. By judgement."""
PERSISTS = 0.02
"""Prior of what passes as a rule and stays, of any size: an estimate that is wrong for long."""
USUAL_SCALE = 0.05
"""Change of a scale that is no surprise."""
OVERLAP = 4.0
"""By how much the nats of a shape are tempered: running means overlap, and half is believed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Residual:
    """An instrument's reading less what another one says, over time.

    Attributes:
        lasting: Cause where the difference stays.
        passing: Cause where it passes within seconds.
        scaled: Cause where it is in proportion to the reading; "": none is.
        sensor: The instrument, or the column of the flight table, that is named.
        quantity: What the size of a change is of.
        unit: Of reading and difference.
        t_s: Middles of its bins, s, shape (n,).
        reading: Of the instrument, shape (n,).
        difference: NaN where unknown, shape (n,).
        error: Standard deviation that the motion brings to it, shape (n,): of clocks and scales.
        window_s: Time over which it is averaged.
        least: Change that nobody needs to speak of, in the unit.
        usual: Lasting change that is no surprise, in the unit.
        largest: Change with which nothing flies, or that no instrument reads, in the unit.
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
        """Bins of a running mean."""
        return max(round(self.window_s / self.step_s), 1)

    @property
    def means(self) -> int:
        """Means, one behind the other, by which a change is told: one of a level, which wanders;
        errors of a difference between samples cancel from one mean to the next."""
        return max(int(AFTER_S / self.window_s), 1) if self.scaled else 1


@dataclass(frozen=True, slots=True)
class Change:
    """A residual that left what it was.

    Attributes:
        residual: Which.
        cause: The most probable one.
        onset_s: When it began, s.
        size: In the unit of the residual, or as a share of the reading.
        low: Lower end of its 90 % interval.
        high: Upper end.
        probability: That it is no false alarm, times that of the cause.
        others: Other causes with their probabilities, the most probable first.
        middle: What the residual was before.
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
        """Of the size."""
        return "1" if self.cause == self.residual.scaled else self.residual.unit


@dataclass(frozen=True, slots=True)
class FalseAlarmBudget:
    """How often a residual may be called changed by chance.

    Attributes:
        false_in_10_h: All residuals together.
        residuals: How many share it.
    """

    false_in_10_h: float
    residuals: int

    def chance(self, every_s: float) -> float:
        """Probability, by chance, that one look exceeds the bound, which is taken so often, s."""
        return self.false_in_10_h / self.residuals * every_s / 36_000.0

    def probability(self, p_value: float, every_s: float) -> float:
        """That a change of this p-value is a true one, by the rates of true and false ones."""
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
    """Lasting change that would have been reported during half of the flight; infinity: none
    would."""
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
    """A residual against its past, at each bin, NaN until there is enough of it: running mean less
    its median before; what the past was over what was expected of it, and the degrees of freedom of
    that; the median; what is expected of the mean; the least scale."""

    apart: Array
    over: Array
    freedom: Array
    middle: Array
    expected: Array
    least: float

    @property
    def scale(self) -> Array:
        """Of the mean of each bin, shape (n,)."""
        return np.asarray(np.maximum(self.over * self.expected, self.least))

    def p_value(self, r: Residual) -> Array:
        """Of each bin: that of its mean and those that follow, as long as they stay off to the same
        side, against what was before; 1 where nothing is known. Shape (n,)."""
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
    """Less the logarithm of the p-value of so many deviations."""
    surprise: Array = -np.log(2.0) - np.asarray(student.logsf(z, freedom), dtype=np.float64)
    return surprise


def _by_chance(each: Array) -> Array:
    """P-value of a chain of means for each length of it, the trials of all lengths counted, shape
    as given.

    Args:
        each: Surprise of each mean, shape (means, ...); NaN ends the chain.
    """
    count, axes = len(each), (-1, *(1,) * (each.ndim - 1))
    share = np.full(count, STAYING)
    trials = np.full(count, (count - 1) / (1.0 - FIRST))
    share[0], trials[0] = 1.0, 1.0 / FIRST if count > 1 else 1.0
    total = np.cumsum(each * share.reshape(axes), axis=0)
    number = np.arange(1, count + 1).reshape(axes)
    return np.asarray(trials.reshape(axes) * gammaincc(number, np.maximum(total, 0.0)))


def _looked(r: Residual, budget: FalseAlarmBudget) -> _Look:
    """The scale is what motion and the least change bring, by how much larger or smaller the past
    was: a prior of `PRIOR_DEGREES` says that it was neither."""
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
    """Median of so many values up to each."""
    rolling = pd.Series(values).rolling(max(round(bins), 1), min_periods=1)
    return np.asarray(rolling.median().to_numpy(), dtype=np.float64)


def running_median(values: Array, bins: float) -> Array:
    """Median of so many values about each."""
    rolling = pd.Series(values).rolling(max(round(bins) | 1, 1), min_periods=1, center=True)
    return np.asarray(rolling.median().to_numpy(), dtype=np.float64)


# -- the shape of a change ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Shape:
    """A change of a residual: place of its onset, size, and by how much it lowers the sum of
    squares; the sum of squares of its regressor, and how many numbers it has."""

    start: int
    size: float
    gain: float
    weight: float
    numbers: int


def _change(r: Residual, k: int, middle: float, scale: float, true: float) -> Change:
    """The change whose running mean from bin k on is off: onset, size, and which shape it has.

    Shapes compete on the bins about it; each carries the usual cost of its numbers (Schwarz 1978)
    and the prior of its size.
    """
    after = max(round(AFTER_S / r.step_s), 3 * r.width)
    part = slice(max(k - r.width, 0), min(k + after, len(r.t_s)))
    d, begin = r.difference[part] - middle, np.arange(2 * r.width + 1)
    noise = OVERLAP * r.width * scale**2  # of a bin, as far as bins add up in a running mean
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
        share = _swapped(share, first, r.passing)  # it ends here: the reference was off
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
    """Whether nothing says what the residual is of sound instruments: a strength, a height."""
    return not r.scaled


def _swapped(share: Mapping[str, float], a: str, b: str) -> dict[str, float]:
    return {**share, a: share[b], b: share[a]}


def _prior(r: Residual, cause: str, size: float) -> float:
    """Log prior of a shape and its size: Cauchy's tails, so that nothing large is excluded."""
    if cause == r.scaled:
        return float(np.log(SCALES) - np.log1p((size / USUAL_SCALE) ** 2))
    if cause == r.lasting and r.lasting != r.passing:
        return float(np.log(LASTS) - np.log1p((size / r.usual) ** 2))
    return float(np.log(1.0 - SCALES - LASTS))


def _steps(d: Array, regressor: Array, begin: NDArray[np.intp]) -> _Shape:
    """The best onset of a lasting change in proportion to a regressor."""
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
