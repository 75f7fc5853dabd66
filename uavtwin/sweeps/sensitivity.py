"""Which factor matters: the share of a figure's variance that each factor explains.

A word, an angle and a number differ only in the functions that the figure is regressed on: one
indicator per word, sines and cosines of an angle, Legendre polynomials of the rank of a number. The
share is the adjusted R² (Ezekiel's, the epsilon² of an analysis of variance), its interval a
percentile bootstrap over runs. A Saltelli design gives Sobol' indices instead.

Sources: Kelley, Proc. Nat. Acad. Sci. 21 (1935) 554-559 for epsilon²; Saltelli et al., Computer
Physics Communications 181 (2010) 259-270, by `scipy.stats.sobol_indices`; Spearman, Am. J.
Psychology 15 (1904). Coverage and false positives were measured on simulated factors,
docs/guide/sweep.md.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.stats import rankdata, sobol_indices, spearmanr

from .design import Design

Array = NDArray[np.float64]
FEWEST = 8
"""Runs from which an influence is computed."""
RESAMPLES = 1000
"""Of a bootstrap."""
CONFIDENCE = 0.95
"""That the intervals of all factors hold together (Bonferroni)."""
_DEGREE, _RUNS_PER_DEGREE = 6, 15
"""Largest degree of the polynomial of a number, and runs for each degree."""
_HARMONICS = 2
_CHUNK = 2**22
"""Weights of a bootstrap that are held at once."""


@dataclass(frozen=True, slots=True)
class Influence:
    """Of one factor on one figure.

    Attributes:
        factor: Its name.
        figure: Name of the figure.
        share: Share of the variance that the factor explains alone, at most 1; an estimate near 0
            may be negative; NaN: too few runs. Of a Saltelli design the first-order index.
        low, high: Its interval; those of all factors hold together with `CONFIDENCE`.
        rank: Spearman's correlation of the ranks, -1..1, which says whether the figure goes up or
            down; NaN of words and angles.
        total: Share of the variance that is left when all other factors are known; NaN without a
            Saltelli design.
    """

    factor: str
    figure: str
    share: float
    low: float
    high: float
    rank: float
    total: float = float("nan")

    @property
    def determined(self) -> bool:
        """Whether the interval of the share lies above 0."""
        return self.low > 0

    @property
    def words(self) -> tuple[str, str]:
        """The share, without a number where its interval holds 0, and the interval."""
        if np.isnan(self.share):
            return "too few runs", ""
        share = f"{self.share:.2f}" if self.determined else "not distinguishable from 0"
        return share, f"{self.low:.2f} to {self.high:.2f}"

    @property
    def size(self) -> float:
        """By which factors are ordered."""
        known = self.total if np.isfinite(self.total) else self.share
        return known if np.isfinite(known) else -1.0


def influences(
    table: pd.DataFrame, design: Design, figure: str, periods: Mapping[str, float] | None = None
) -> list[Influence]:
    """Influence of every factor that varies, the largest first.

    Args:
        table: A row per run, in order.
        design: Of the sweep.
        figure: Column.
        periods: Of factors that are angles, by name: what a whole turn is.
    """
    periods = periods or {}
    factors = [name for name in design.vary if table[name].nunique() > 1]
    y = table[figure].to_numpy(dtype=np.float64)
    level = (1 - CONFIDENCE) / max(len(factors), 1)
    sobol = _sobol(y, design, level)
    found = []
    for name in factors:
        values, period = table[name], periods.get(name)
        rank = float("nan") if period else _rank(values, y)
        if sobol is None:
            share = _share(values, y, period, level, design.seed)
            found.append(Influence(name, figure, *share, rank))
        else:
            first, total = (a[list(design.vary).index(name)] for a in sobol)
            value, low, high = map(float, first)
            found.append(Influence(name, figure, value, low, high, rank, float(total[0])))
    return sorted(found, key=lambda i: -i.size)


def _share(
    values: pd.Series, y: Array, period: float | None, level: float, seed: int
) -> tuple[float, float, float]:
    """Adjusted R² of a figure on functions of one factor, and its interval; NaN of too few runs."""
    there = np.isfinite(y)
    count = int(there.sum())
    if count < FEWEST or np.ptp(y[there]) == 0 or values[there].nunique() < 2:
        return (float("nan"),) * 3
    functions = _functions(values[there], period)
    width = functions.shape[1]
    if count < width + 1 + FEWEST // 2:
        return (float("nan"),) * 3
    scaled = (y[there] - y[there].mean()) / y[there].std()
    rng = np.random.default_rng(seed)
    every = max(1, _CHUNK // count)
    drawn = [
        _adjusted_r2(
            functions, scaled, rng.multinomial(count, np.full(count, 1 / count), size=some)
        )
        for some in np.diff([*range(0, RESAMPLES, every), RESAMPLES])
    ]
    low, high = np.quantile(np.concatenate(drawn), [level / 2, 1 - level / 2])
    return float(_adjusted_r2(functions, scaled, np.ones((1, count)))[0]), float(low), float(high)


def _functions(values: pd.Series, period: float | None) -> Array:
    """Functions of a factor on which a figure is regressed, shape (runs, functions)."""
    if pd.api.types.is_bool_dtype(values) or not pd.api.types.is_numeric_dtype(values):
        indicators = pd.get_dummies(values.astype(str), drop_first=True)
        return np.asarray(indicators, dtype=np.float64)
    x = values.to_numpy(dtype=np.float64)
    levels = len(np.unique(x))
    if period is not None and levels > 2 * _HARMONICS:
        turns = 2 * np.pi * np.outer(x / period, np.arange(1, _HARMONICS + 1))
        return np.hstack([np.cos(turns), np.sin(turns)])
    degree = min(_DEGREE, levels - 1, max(1, len(x) // _RUNS_PER_DEGREE))
    place = 2 * (rankdata(x) - 1) / (len(x) - 1) - 1
    return np.asarray(legendre.legvander(place, degree)[:, 1:])


def _adjusted_r2(functions: Array, y: Array, weights: NDArray[Any]) -> Array:
    """Adjusted R² of weighted regressions, shape (b,).

    Args:
        functions: Shape (n, p).
        y: Shape (n,).
        weights: How often each run counts, shape (b, n); each row has the sum n.
    """
    n, p = functions.shape
    x = np.column_stack([np.ones(n), functions])
    products = (x[:, :, None] * x[:, None, :]).reshape(n, -1)
    gram = (weights @ products).reshape(-1, p + 1, p + 1)
    moments = weights @ (x * y[:, None])
    jitter = 1e-10 * np.trace(gram, axis1=1, axis2=2) / (p + 1)  # a level may not be drawn
    gram += jitter[:, None, None] * np.eye(p + 1)
    slopes = np.linalg.solve(gram, moments[..., None])[..., 0]
    around_mean = weights @ y**2 - n * (weights @ y / n) ** 2
    left = weights @ y**2 - np.sum(slopes * moments, axis=1)
    varies = around_mean > 1e-12 * n  # in this resample
    ratio = (left / (n - p - 1)) / (np.where(varies, around_mean, 1.0) / (n - 1))
    return np.asarray(np.where(varies, 1 - ratio, 0.0))


def _rank(values: pd.Series, y: Array) -> float:
    """Spearman's correlation over the runs that have the figure; NaN for words."""
    if not pd.api.types.is_numeric_dtype(values):
        return float("nan")
    x, there = values.to_numpy(dtype=np.float64), np.isfinite(y)
    if there.sum() < FEWEST or np.ptp(x[there]) == 0 or np.ptp(y[there]) == 0:
        return float("nan")
    return float(spearmanr(x[there], y[there]).statistic)


def _sobol(y: Array, design: Design, level: float) -> tuple[Array, Array] | None:
    """Indices of first and total order, each shape (factors, 3): value and interval; None where
    the design or the figure gives none."""
    d = len(design.vary)
    if design.method != "saltelli" or not np.isfinite(y).all() or np.ptp(y) == 0:
        return None
    n = len(y) // (d + 2)
    mixed = y[2 * n :].reshape(d, n)

    def indices(rows: NDArray[np.intp]) -> Array:
        """First and total order of these rows of the base sample, shape (2, factors)."""
        parts = {
            "f_A": y[None, :n][:, rows],
            "f_B": y[None, n : 2 * n][:, rows],
            "f_AB": mixed[:, None, rows],
        }
        found = sobol_indices(func=parts, n=len(rows))
        return np.array([np.ravel(found.first_order), np.ravel(found.total_order)])

    rng = np.random.default_rng(design.seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of constant outputs, looked for above
        value = indices(np.arange(n))
        drawn = np.array([indices(rng.integers(n, size=n)) for _ in range(RESAMPLES)])
    ends = np.nanquantile(drawn, [level / 2, 1 - level / 2], axis=0)
    first, total = np.moveaxis(np.array([value, *ends]), 0, -1)
    return first, total
