"""How a number of an aircraft changes with the date.

Sources: Theil, Proc. Kon. Ned. Akad. Wetensch. A 53 (1950) 386-392; Sen, J. Am. Stat. Assoc. 63
(1968) 1379-1389; Kendall, Biometrika 30 (1938) 81-93.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kendalltau, theilslopes

Array = NDArray[np.float64]
FEWEST = 6
"""Dated flights from which on a trend is looked for: of five, no order has a probability below
1 %."""
MOST = 1000
"""Points of a trend: of more flights, medians of so many groups of them in order of date, since the
slopes are between all pairs."""
DAYS = 30.0
"""Over which a slope is told."""
YEAR_D = 365.25


@dataclass(frozen=True, slots=True)
class Trend:
    """A slope over time.

    Attributes:
        slope: Median of the slopes between all pairs of flights, per 30 days.
        low: Lower end of its 95 % interval.
        high: Upper end.
        p: Probability of an order as strict, of flights that only differ by chance.
        flights: How many.
        days: From the first to the last.
    """

    slope: float
    low: float
    high: float
    p: float
    flights: int
    days: float


def trend_of(date_year: Sequence[float] | Array, value: Sequence[float] | Array) -> Trend | None:
    """Robust slope of a number against the date: 29 % of the flights may be anything.

    Args:
        date_year: Decimal years, shape (n,).
        value: Shape (n,).

    Returns:
        None: too few flights, or all on one day.
    """
    t, y = np.asarray(date_year, dtype=np.float64), np.asarray(value, dtype=np.float64)
    known = np.isfinite(t) & np.isfinite(y)
    t, y = t[known] * YEAR_D / DAYS, y[known]
    if len(t) < FEWEST or np.ptp(t) == 0:
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
    """Medians of groups where there are many."""
    if len(t) <= MOST:
        return t, y
    order = np.argsort(t, kind="stable")
    parts = np.array_split(order, MOST)
    middle = [(np.median(t[p]), np.median(y[p])) for p in parts]
    return np.array([m[0] for m in middle]), np.array([m[1] for m in middle])
