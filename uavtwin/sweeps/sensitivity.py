"""Which factor matters: Sobol' indices of a Saltelli design, ranks of any other.

Sources: Saltelli et al., Computer Physics Communications 181 (2010) 259-270, by
`scipy.stats.sobol_indices`; Spearman, Am. J. Psychology 15 (1904).
"""

import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import sobol_indices, spearmanr

from .design import Design

FEWEST = 8
"""Runs from which a correlation is told."""


@dataclass(frozen=True, slots=True)
class Influence:
    """Of one factor on one figure.

    Attributes:
        factor: Its name.
        figure: Name of the figure.
        rank: Spearman's correlation of their ranks, -1..1; NaN for words.
        first: Share of the variance by the factor alone; NaN without a Saltelli design.
        total: Share of the variance that is left when all others are known.
    """

    factor: str
    figure: str
    rank: float
    first: float = float("nan")
    total: float = float("nan")

    @property
    def size(self) -> float:
        """By which factors are ordered."""
        known = self.total if np.isfinite(self.total) else abs(self.rank)
        return known if np.isfinite(known) else -1.0


def influences(table: pd.DataFrame, design: Design, figure: str) -> list[Influence]:
    """Influence of every factor that varies, the largest first.

    Args:
        table: A row per run, in order.
        design: Of the sweep.
        figure: Column.
    """
    factors = [name for name in design.vary if table[name].nunique() > 1]
    y = table[figure].to_numpy(dtype=np.float64)
    first, total = _sobol(y, design)
    told = []
    for name in factors:
        i = list(design.vary).index(name)
        told.append(Influence(name, figure, _rank(table[name], y), first[i], total[i]))
    return sorted(told, key=lambda t: -t.size)


def _rank(values: pd.Series, y: "np.ndarray") -> float:
    """Spearman's correlation over the runs that have the figure; NaN for words."""
    if not pd.api.types.is_numeric_dtype(values):
        return float("nan")
    x, there = values.to_numpy(dtype=np.float64), np.isfinite(y)
    if there.sum() < FEWEST or np.ptp(x[there]) == 0 or np.ptp(y[there]) == 0:
        return float("nan")
    return float(spearmanr(x[there], y[there]).statistic)


def _sobol(y: "np.ndarray", design: Design) -> tuple["np.ndarray", "np.ndarray"]:
    """Indices of first and total order, shapes (factors,); NaN where they cannot be told."""
    d = len(design.vary)
    unknown = np.full(d, np.nan)
    if design.method != "saltelli" or not np.isfinite(y).all() or np.ptp(y) == 0:
        return unknown, unknown
    n = len(y) // (d + 2)
    parts = {
        "f_A": y[:n].reshape(1, n),
        "f_B": y[n : 2 * n].reshape(1, n),
        "f_AB": y[2 * n :].reshape(d, 1, n),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of constant outputs, looked for above
        found = sobol_indices(func=parts, n=n)
    return np.ravel(found.first_order), np.ravel(found.total_order)
