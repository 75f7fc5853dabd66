"""Statistics of a fleet: comparison of aircraft, trends over time, multiple tests.

Sources: Rosner, Technometrics 25 (1983) 165-172, the generalised extreme Studentised deviate: the
value farthest from the others is removed, repeatedly; an aircraft differs where its deviate, or
that of one removed after it, exceeds the critical value for the most extreme one. His critical
values are for 25 and more values; for fewer, one of several steps exceeds them more often than
stated, so here probabilities are multiplied by the number of steps.

Benjamini, Hochberg, J. R. Stat. Soc. B 57 (1995) 289-300, by `scipy.stats.false_discovery_control`:
valid for independent and for positively dependent tests; numbers of one flight are of the latter
kind.

Each estimate of an aircraft is a draw around its value, of known standard deviation; the values are
draws around that of the type, with a standard deviation to be estimated: Paule, Mandel, J. Res.
Natl. Bur. Stand. 87 (1982) 377-385, for the spread between aircraft, as DerSimonian, Kacker,
Contemp. Clin. Trials 28 (2007) 105-114 recommend; Hartung, Knapp, Stat. Med. 20 (2001) 3875-3889,
for the uncertainty of the mean; Morris, J. Am. Stat. Assoc. 78 (1983) 47-55, for the values of the
aircraft.

Theil, Proc. Kon. Ned. Akad. Wetensch. A 53 (1950) 386-392; Sen, J. Am. Stat. Assoc. 63 (1968)
1379-1389; Kendall, Biometrika 30 (1938) 81-93, for slopes over the date.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import false_discovery_control, kendalltau, theilslopes
from scipy.stats import t as student

Array = NDArray[np.float64]
FEWEST_AIRCRAFT = 4
"""Fewest aircraft among which one can differ."""
MOST_SHARE = 1 / 3
"""Largest share of aircraft that may differ; with more, the normal ones are not defined."""


def differing(value: Sequence[float] | Array, variance: Sequence[float] | Array) -> Array:
    """Probability of a value as far from the others among equal aircraft.

    Args:
        value: Value of each aircraft, shape (n,).
        variance: Variance of each value by its own uncertainty; those above the mean of the others
            widen the limits. Shape (n,).

    Returns:
        Probabilities, shape (n,); 1 for those that are not among the farthest third.
    """
    y, own = np.asarray(value, dtype=np.float64), np.asarray(variance, dtype=np.float64)
    p = np.ones(len(y))
    left = np.arange(len(y))
    taken: list[int] = []
    steps = int(MOST_SHARE * len(y)) if len(y) >= FEWEST_AIRCRAFT else 0
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
    """Distance of each value from the others' mean, over its deviation for equal aircraft.

    Args:
        y: Values, shape (n,).
        own: Variances, shape (n,).

    Returns:
        Deviates, shape (n,); infinite for a value that differs from others that are all equal.
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


FALSE_SHARE = 0.05
"""Accepted share of false discoveries among the reported differences and drifts."""


def adjusted(p: Sequence[float]) -> Array:
    """Smallest share of false discoveries at which each test is significant, shape (n,).

    Args:
        p: Probability of each result under its null hypothesis.
    """
    return np.asarray(false_discovery_control(p)) if len(p) else np.zeros(0)


@dataclass(frozen=True, slots=True)
class Common:
    """Joint result of several estimates.

    Attributes:
        mean: Mean of the true values.
        sd: Standard deviation of the mean.
        between: Standard deviation of the true values about the mean.
        low: Lower end of the mean's 95 % interval.
        high: Upper end of the mean's 95 % interval; infinite for a single estimate with unknown
            spread.
        own: Value of each, shrunk towards the mean by its uncertainty, shape (n,).
        own_sd: Standard deviation of each `own` value, shape (n,).
    """

    mean: float
    sd: float
    between: float
    low: float
    high: float
    own: Array
    own_sd: Array


def common_of(value: Sequence[float] | Array, sd: Sequence[float] | Array) -> Common:
    """Random-effects estimate.

    Args:
        value: Estimates, shape (n,), n at least 1.
        sd: Standard deviation of each estimate, positive, shape (n,).
    """
    y, s = np.asarray(value, dtype=np.float64), np.asarray(sd, dtype=np.float64)
    if len(y) == 1:
        return Common(float(y[0]), float(s[0]), 0.0, -np.inf, np.inf, y, s)
    tau2 = _between(y, s)
    w = 1 / (s**2 + tau2)
    mean = float(w @ y / w.sum())
    q = float(w @ (y - mean) ** 2) / (len(y) - 1)
    sd_mean = float(np.sqrt(max(q, 1.0) / w.sum()))
    half = float(student.ppf(0.975, len(y) - 1)) * sd_mean
    weight = tau2 / (tau2 + s**2)
    own = mean + weight * (y - mean)
    own_sd = np.sqrt(weight * s**2 + (1 - weight) ** 2 * sd_mean**2)
    return Common(mean, sd_mean, float(np.sqrt(tau2)), mean - half, mean + half, own, own_sd)


def _between(y: Array, s: Array) -> float:
    """Variance between the values for which the weighted squares equal their expectation."""

    def excess(tau2: float) -> float:
        w = 1 / (s**2 + tau2)
        return float(w @ (y - w @ y / w.sum()) ** 2) - (len(y) - 1)

    if excess(0.0) <= 0:
        return 0.0
    top = float(np.ptp(y)) ** 2 + float(s.max()) ** 2
    while excess(top) > 0:
        top *= 4
    return float(brentq(excess, 0.0, top, xtol=1e-15 * top, rtol=1e-12))


FEWEST_FLIGHTS = 6
"""Fewest dated flights for a trend: with five, no order has a probability below 1 %."""
MOST_POINTS = 1000
"""Largest number of points of a trend: more flights are grouped by date and replaced by medians,
since slopes are between all pairs."""
DAYS = 30.0
"""Time unit of a slope, days."""
YEAR_D = 365.25
"""Julian year, days."""


@dataclass(frozen=True, slots=True)
class Trend:
    """A slope over time.

    Attributes:
        slope: Median of the slopes between all pairs of flights, per 30 days.
        low: Lower end of the slope's 95 % interval.
        high: Upper end of the slope's 95 % interval.
        p: Probability of an order at least as strict, for flights that differ only by chance.
        flights: Number of flights.
        days: Time from the first to the last flight.
    """

    slope: float
    low: float
    high: float
    p: float
    flights: int
    days: float


def trend_of(date_year: Sequence[float] | Array, value: Sequence[float] | Array) -> Trend | None:
    """Robust slope of a number over the date: up to 29 % of the flights may be outliers.

    Args:
        date_year: Decimal years, shape (n,).
        value: Values, shape (n,).

    Returns:
        None: too few flights, or all on one day.
    """
    t, y = np.asarray(date_year, dtype=np.float64), np.asarray(value, dtype=np.float64)
    known = np.isfinite(t) & np.isfinite(y)
    t, y = t[known] * YEAR_D / DAYS, y[known]
    if len(t) < FEWEST_FLIGHTS or np.ptp(t) == 0:
        return None
    flights, days = len(t), float(np.ptp(t)) * DAYS
    if np.ptp(y) == 0:
        return Trend(0.0, 0.0, 0.0, 1.0, flights, days)
    t, y = _grouped(t, y)
    found = theilslopes(y, t, alpha=0.95)
    p = float(kendalltau(t, y).pvalue)
    slope, low, high = (float(v) for v in (found.slope, found.low_slope, found.high_slope))
    return Trend(slope, low, high, p, flights, days)


def _grouped(t: Array, y: Array) -> tuple[Array, Array]:
    """Medians of groups where there are many flights."""
    if len(t) <= MOST_POINTS:
        return t, y
    order = np.argsort(t, kind="stable")
    parts = np.array_split(order, MOST_POINTS)
    middle = [(np.median(t[p]), np.median(y[p])) for p in parts]
    return np.array([m[0] for m in middle]), np.array([m[1] for m in middle])
