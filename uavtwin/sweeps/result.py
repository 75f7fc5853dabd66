"""Result of a sweep: how its runs ended, and the sensitivity of each figure to each factor.

For words, angles and numbers the figure is regressed on different functions: one indicator per
word, sines and cosines of an angle, Legendre polynomials of the rank of a number. The share of
variance is the adjusted R² (Ezekiel's, the epsilon² of an analysis of variance), its interval a
percentile bootstrap over runs. A Saltelli design gives Sobol' indices instead.

Sources: Kelley, Proc. Nat. Acad. Sci. 21 (1935) 554-559 for epsilon²; Saltelli et al., Computer
Physics Communications 181 (2010) 259-270, by `scipy.stats.sobol_indices`; Spearman, Am. J.
Psychology 15 (1904). Coverage and false positives were measured on simulated factors,
docs/method/sweep.md.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.stats import rankdata, sobol_indices, spearmanr

from twin.effects import EFFECTS
from twin.errors import TwinError
from twin.formatting import counted

from ..display import PageMixin, TextTable
from ..output import output_file
from ..record import Record
from ..simulation import Scenario
from ..vehicles import content_of, load_vehicle
from .design import Design, Value
from .outcome import FIGURES, Outcome

Array = NDArray[np.float64]
FEWEST = 8
"""Least number of runs for which an influence is computed."""
RESAMPLES = 1000
"""Number of bootstrap resamples."""
CONFIDENCE = 0.95
"""Joint confidence of the intervals of all factors (Bonferroni)."""
_DEGREE, _RUNS_PER_DEGREE = 6, 15
"""Largest degree of the polynomial of a numeric factor, and runs required per degree."""
_HARMONICS = 2
"""Number of harmonics of an angle in the regression."""
_CHUNK = 2**22
"""Number of bootstrap weights held in memory at once."""


@dataclass(frozen=True, slots=True)
class Influence:
    """Influence of one factor on one figure (sensitivity).

    Attributes:
        factor: Name of the factor.
        figure: Name of the figure.
        share: Share of the variance that the factor explains alone, at most 1; an estimate near 0
            may be negative; NaN: too few runs. For a Saltelli design, the first-order Sobol' index.
        low, high: Confidence interval of the share; the intervals of all factors hold jointly with
            `CONFIDENCE`.
        rank: Spearman's rank correlation, -1..1: whether the figure increases or decreases with the
            factor; NaN for words and angles.
        total: Total-order Sobol' index: share of the variance that remains when all other factors
            are fixed; NaN without a Saltelli design.
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
        """Whether the confidence interval of the share lies above 0."""
        return self.low > 0

    @property
    def words(self) -> tuple[str, str]:
        """Texts of the share, "" where its interval contains 0, and of the interval."""
        if np.isnan(self.share):
            return "too few runs", ""
        share = f"{self.share:.2f}" if self.determined else "not distinguishable from 0"
        return share, f"{self.low:.2f} to {self.high:.2f}"

    @property
    def size(self) -> float:
        """Sort key of the factors: total-order index, else share; -1 where neither is known."""
        known = self.total if np.isfinite(self.total) else self.share
        return known if np.isfinite(known) else -1.0


def influences(
    table: pd.DataFrame, design: Design, figure: str, periods: Mapping[str, float] | None = None
) -> list[Influence]:
    """Influence of every varied factor on a figure, the largest first.

    Args:
        table: Table with one row per run, in order.
        design: Design of the sweep.
        figure: Column of the figure.
        periods: Period of each factor that is an angle, by name: 360 or 2 pi.
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
    """Adjusted R² of a figure regressed on one factor, and its interval; NaN for too few runs."""
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
    """Basis functions of a factor for the regression, shape (runs, functions)."""
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
        functions: Basis functions, shape (n, p).
        y: Figure, shape (n,).
        weights: Count of each run in each resample, shape (b, n); each row has the sum n.
    """
    n, p = functions.shape
    x = np.column_stack([np.ones(n), functions])
    products = (x[:, :, None] * x[:, None, :]).reshape(n, -1)
    gram = (weights @ products).reshape(-1, p + 1, p + 1)
    moments = weights @ (x * y[:, None])
    jitter = 1e-10 * np.trace(gram, axis1=1, axis2=2) / (p + 1)  # a resample may lack a level
    gram += jitter[:, None, None] * np.eye(p + 1)
    slopes = np.linalg.solve(gram, moments[..., None])[..., 0]
    around_mean = weights @ y**2 - n * (weights @ y / n) ** 2
    left = weights @ y**2 - np.sum(slopes * moments, axis=1)
    varies = around_mean > 1e-12 * n  # the figure varies in this resample
    ratio = (left / (n - p - 1)) / (np.where(varies, around_mean, 1.0) / (n - 1))
    return np.asarray(np.where(varies, 1 - ratio, 0.0))


def _rank(values: pd.Series, y: Array) -> float:
    """Spearman's correlation over the runs with a value of the figure; NaN for words."""
    if not pd.api.types.is_numeric_dtype(values):
        return float("nan")
    x, there = values.to_numpy(dtype=np.float64), np.isfinite(y)
    if there.sum() < FEWEST or np.ptp(x[there]) == 0 or np.ptp(y[there]) == 0:
        return float("nan")
    return float(spearmanr(x[there], y[there]).statistic)


def _sobol(y: Array, design: Design, level: float) -> tuple[Array, Array] | None:
    """Sobol' indices of first and total order, each shape (factors, 3): value and interval; None
    where the design is no Saltelli design or the figure is missing or constant."""
    d = len(design.vary)
    if design.method != "saltelli" or not np.isfinite(y).all() or np.ptp(y) == 0:
        return None
    n = len(y) // (d + 2)
    mixed = y[2 * n :].reshape(d, n)

    def indices(rows: NDArray[np.intp]) -> Array:
        """Sobol' indices of first and total order from these rows of the base sample, shape (2,
        factors)."""
        parts = {
            "f_A": y[None, :n][:, rows],
            "f_B": y[None, n : 2 * n][:, rows],
            "f_AB": mixed[:, None, rows],
        }
        found = sobol_indices(func=parts, n=len(rows))
        return np.array([np.ravel(found.first_order), np.ravel(found.total_order)])

    rng = np.random.default_rng(design.seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # constant outputs, excluded above
        value = indices(np.arange(n))
        drawn = np.array([indices(rng.integers(n, size=n)) for _ in range(RESAMPLES)])
    ends = np.nanquantile(drawn, [level / 2, 1 - level / 2], axis=0)
    first, total = np.moveaxis(np.array([value, *ends]), 0, -1)
    return first, total


LED_BY = "tracking_worst_m"
"""Main figure: ranks the runs and is the one whose sensitivities are computed by default."""
WORST = 10
"""Number of worst runs that are listed."""


class Quantiles(Record, frozen=True, kw_only=True):
    """Quantiles of a figure over the runs that have it.

    Attributes:
        p5: 5 % quantile.
        p50: Median.
        p95: 95 % quantile.
    """

    p5: float
    p50: float
    p95: float


class SweepRecord(Record, frozen=True, kw_only=True):
    """Statistics of many runs of one scenario.

    Attributes:
        scenario: Name of the scenario.
        method: Sampling method of the points.
        runs: Number of runs.
        outcomes: Number of runs that ended `flown`, `lost`, `run`, `failed`.
        figures: Quantiles of each figure, by column of `runs.parquet`.
        influences: Influence of each varied factor, the largest first; empty where there are too
            few runs.
        worst: Numbers of the worst runs.
        warnings: Requests without effect, such as wind on an aircraft without drag.
    """

    scenario: str
    method: str
    runs: int
    outcomes: dict[str, int]
    figures: dict[str, Quantiles]
    influences: tuple[Influence, ...]
    worst: tuple[int, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, repr=False, eq=False)
class SweepResult(PageMixin):
    """Result of a sweep.

    Attributes:
        name: Name of the scenario.
        table: Table with one row per run, in order: `run`, the factors, `outcome`, `why`, `time_s`,
            figures.
        design: Design of the sweep.
        scenarios: Scenario of each run.
        vehicle: Name or file of the vehicle where it is no factor, "" for the default one.
        periods: Period of each factor that is an angle, by name: 360 or 2 pi.
        warnings: Requests without effect, such as wind on an aircraft without drag.
    """

    name: str
    table: pd.DataFrame
    design: Design
    scenarios: Sequence[Scenario]
    vehicle: str = ""
    periods: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    _influences: dict[str, list[Influence]] = field(default_factory=dict, init=False)

    page = "uavtwin.report.sweep"

    @property
    def figures(self) -> list[str]:
        """Columns that are figures of the outcome."""
        return [c for c in self.table.columns if c in FIGURES or c.startswith("end.")]

    @property
    def counts(self) -> dict[str, int]:
        """Number of runs by outcome."""
        return {str(k): int(v) for k, v in self.table["outcome"].value_counts().items()}

    @property
    def claim(self) -> str:
        """Summary of the outcomes in one sentence."""
        counts = self.counts
        kinds = [k for k in ("flown", "run", "lost", "failed") if k in counts]
        if len(kinds) == 1:
            endings = f"all {kinds[0]}"
        else:
            endings = ", ".join(f"{counts[k]} {k}" for k in kinds)
        text = f"{self.name}: {counted(self.table, 'run')}, {endings}"
        if LED_BY in self.table and self.table[LED_BY].notna().any():
            half, most = np.nanpercentile(self.table[LED_BY], [50, 95])
            text += (
                f"; farthest from the setpoint {half:.2f} m in the median run, {most:.2f} m in the "
                f"worst 5 %"
            )
        return text

    @property
    def units(self) -> dict[str, str]:
        """Unit of each figure, "" where it is unknown."""
        return {name: FIGURES.get(name, "") for name in self.figures}

    @property
    def led_by(self) -> str:
        """Figure by which runs are compared: the distance from the setpoint where something flies,
        else the first figure that has values; "" if there is none."""
        known = [n for n in (LED_BY, *self.figures) if n in self.table]
        return next((n for n in known if self.table[n].notna().sum() > 1), "")

    def influences(self, figure: str = "") -> list[Influence]:
        """Influence of every factor on a figure, the largest first.

        Args:
            figure: Column of the figure; default: `led_by`.
        """
        figure = figure or self.led_by
        if figure not in self.table:
            return []
        if figure not in self._influences:
            self._influences[figure] = influences(self.table, self.design, figure, self.periods)
        return self._influences[figure]

    def worst(self, count: int = WORST) -> pd.DataFrame:
        """Rows of the worst runs: failed ones, lost ones, then those farthest from the setpoint."""
        order = self.table["outcome"].map({"failed": 0, "lost": 1}).fillna(2)
        by = [order]
        if LED_BY in self.table:
            by.append(-self.table[LED_BY].fillna(np.inf))
        places = np.lexsort([self.table["run"], *reversed(by)])
        return self.table.iloc[places[:count]]

    def again(self, run: int) -> str:
        """Command that repeats a run and records all outputs; "" where no name or file gives its
        vehicle."""
        named = str(self.table["vehicle"][run]) if "vehicle" in self.table else self.vehicle
        flown = self.scenarios[run].vehicle
        if flown is not None:
            named = named or flown.name
            try:
                if content_of(load_vehicle(named)) != content_of(flown):
                    return ""
            except TwinError:
                return ""
        return command_of(self.scenarios[run], named)

    @cached_property
    def record(self) -> SweepRecord:
        """All numbers that are printed, as a record."""
        quantiles = {}
        for name in self.figures:
            known = self.table[name].dropna()
            if len(known):
                five, half, most = np.percentile(known, [5, 50, 95])
                quantiles[name] = Quantiles(p5=float(five), p50=float(half), p95=float(most))
        return SweepRecord(
            scenario=self.name,
            method=self.design.method,
            runs=len(self.table),
            outcomes=self.counts,
            figures=quantiles,
            influences=tuple(self.influences()),
            worst=tuple(int(run) for run in self.worst()["run"]),
            warnings=self.warnings,
        )

    def save(self, path: str | Path) -> Path:
        """Write the table as Parquet; returns its path."""
        with output_file(Path(path)) as file:
            pq.write_table(pa.Table.from_pandas(self.table, preserve_index=False), file)
        return Path(path)

    def findings(self) -> Iterable[str | TextTable]:
        """Summary sentence, table of figures and table of sensitivities."""
        yield self.claim
        quantiles = self.json()["figures"]
        rows = [
            (name, *(f"{q[k]:.3g}" for k in ("p5", "p50", "p95")), self.units[name])
            for name, q in quantiles.items()
        ]
        if rows:
            yield TextTable(("figure", "5 %", "median", "95 %", "unit"), tuple(rows))
        found = self.influences()
        if found:
            total = any(np.isfinite(i.total) for i in found)
            head = (f"what matters for {self.led_by}", "share of variance", "95 % interval", "rank")
            rows = [
                (i.factor, *i.words, _short(i.rank), *([_short(i.total)] if total else []))
                for i in found
            ]
            yield TextTable((*head, "with the others") if total else head, tuple(rows))

    def brief(self) -> str:
        """Number of runs and name of the scenario."""
        return f"{type(self).__name__}: {self.name}, {counted(self.table, 'run')}"


def _short(value: float) -> str:
    """The value with two decimals, "" where it is unknown."""
    return f"{value:.2f}" if np.isfinite(value) else ""


def table_of(points: Sequence[Mapping[str, Value]], outcomes: Iterable[Outcome]) -> pd.DataFrame:
    """Table with one row per run, in order of runs, whatever the order of the outcomes.

    Args:
        points: Values of the factors in each run.
        outcomes: Outcome of each run, in any order.
    """
    count = len(points)
    texts: dict[str, list[str]] = {"outcome": [""] * count, "why": [""] * count}
    numbers: dict[str, np.ndarray] = {"time_s": np.full(count, np.nan)}
    for o in outcomes:
        texts["outcome"][o.run], texts["why"][o.run] = o.outcome, o.why
        for name, value in {"time_s": o.time_s, **o.figures}.items():
            if name not in numbers:
                numbers[name] = np.full(count, np.nan)
            numbers[name][o.run] = value
    first = points[0] if points else {}
    known = [*FIGURES, *sorted(n for n in numbers if n.startswith("end."))]
    return pd.DataFrame(
        {
            "run": np.arange(count),
            **{name: [p[name] for p in points] for name in first},
            **texts,
            "time_s": numbers["time_s"],
            **{name: numbers[name] for name in known if name in numbers},
        }
    )


def command_of(scenario: Scenario, vehicle: str = "") -> str:
    """Command `uavtwin simulate` that flies a scenario.

    Args:
        scenario: Scenario of a run.
        vehicle: Name or file of its vehicle, "" for the default one.
    """
    parts = ["uavtwin", "simulate", str(scenario.target)]
    if not scenario.is_system:
        if vehicle:
            parts += ["--vehicle", vehicle]
        if any(scenario.wind_m_s):
            parts.append("--wind=" + ",".join(repr(v) for v in scenario.wind_m_s))
        parts += ["--gusts"] if scenario.gusts else []
        parts += ["--seed", str(scenario.seed), "--controller", scenario.controller]
        for name in scenario.effects:
            parts += ["--effect", name]
        if scenario.fused:
            parts.append("--fused")
    starts = dict(scenario.starts)
    if isinstance(scenario.effects, Mapping):
        for name, numbers in scenario.effects.items():
            starts |= {f"{EFFECTS[name].component}.{name}.{k}": v for k, v in numbers.items()}
    for name, value in starts.items():
        parts += ["--start", f"{name}={value!r}"]
    return " ".join(map(quote, parts))
