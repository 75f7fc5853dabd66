"""A sweep that was flown: how its runs ended, and which factor matters how much for a figure.

A word, an angle and a number differ only in the functions that the figure is regressed on: one
indicator per word, sines and cosines of an angle, Legendre polynomials of the rank of a number. The
share is the adjusted R² (Ezekiel's, the epsilon² of an analysis of variance), its interval a
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
from twin.formatting import counted

from ..display import PageMixin, TextTable
from ..output import output_file
from ..record import Record
from ..simulation import Scenario
from .design import Design, Value
from .outcome import FIGURES, Outcome

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
"""Of an angle in the regression."""
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


LED_BY = "tracking_worst_m"
"""Figure by which runs are the worst, and which factors are held against."""
WORST = 10
"""Runs that are listed."""


class Quantiles(Record, frozen=True, kw_only=True):
    """A figure over the runs that have it.

    Attributes:
        p5: 5 % of the runs are below.
        p50: Median.
        p95: 95 % of the runs are below.
    """

    p5: float
    p50: float
    p95: float


class SweepRecord(Record, frozen=True, kw_only=True):
    """Many runs of one scenario.

    Attributes:
        scenario: Its name.
        method: How points were chosen.
        runs: How many.
        outcomes: How many ended `flown`, `lost`, `run`, `failed`.
        figures: By column of `runs.parquet`.
        influences: Of each factor that varies, the largest first; none where there are too few
            runs.
        worst: Numbers of the worst runs.
        warnings: What was asked for although it changes nothing, as wind on an aircraft without
            drag.
    """

    scenario: str
    method: str
    runs: int
    outcomes: dict[str, int]
    figures: dict[str, Quantiles]
    influences: tuple[Influence, ...]
    worst: tuple[int, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class SweepResult(PageMixin):
    """What came of a sweep.

    Attributes:
        name: Of the scenario.
        table: A row per run, in order: `run`, the factors, `outcome`, `why`, `time_s`, figures.
        design: What was varied.
        scenarios: Of each run.
        vehicle: Name or file of what flies where no factor says another, "" for the usual one.
        periods: Of factors that are angles: what a whole turn is.
        warnings: What was asked for although it changes nothing.
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
        """How many runs ended how."""
        return {str(k): int(v) for k, v in self.table["outcome"].value_counts().items()}

    @property
    def claim(self) -> str:
        """How it went, in one sentence."""
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
        """Of the figures, "" where it is not known."""
        return {name: FIGURES.get(name, "") for name in self.figures}

    @property
    def led_by(self) -> str:
        """Figure by which runs are compared: the distance from the setpoint where something flies,
        else the first that there is; "" without any."""
        known = [n for n in (LED_BY, *self.figures) if n in self.table]
        return next((n for n in known if self.table[n].notna().sum() > 1), "")

    def influences(self, figure: str = "") -> list[Influence]:
        """Influence of every factor on a figure, the largest first.

        Args:
            figure: Column; default: `led_by`.
        """
        figure = figure or self.led_by
        if figure not in self.table:
            return []
        if figure not in self._influences:
            self._influences[figure] = influences(self.table, self.design, figure, self.periods)
        return self._influences[figure]

    def worst(self, count: int = WORST) -> pd.DataFrame:
        """Rows of the runs that failed, were lost, or were farthest from the setpoint."""
        order = self.table["outcome"].map({"failed": 0, "lost": 1}).fillna(2)
        by = [order]
        if LED_BY in self.table:
            by.append(-self.table[LED_BY].fillna(np.inf))
        places = np.lexsort([self.table["run"], *reversed(by)])
        return self.table.iloc[places[:count]]

    def again(self, run: int) -> str:
        """The command that flies a run once more, with everything recorded."""
        named = str(self.table["vehicle"][run]) if "vehicle" in self.table else self.vehicle
        return command_of(self.scenarios[run], named)

    @cached_property
    def record(self) -> SweepRecord:
        """Every number that is printed."""
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
        """The claim, figures and what matters."""
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
        """How many runs of what."""
        return f"{type(self).__name__}: {self.name}, {counted(self.table, 'run')}"


def _short(value: float) -> str:
    """Two digits, nothing where it is not known."""
    return f"{value:.2f}" if np.isfinite(value) else ""


def table_of(points: Sequence[Mapping[str, Value]], outcomes: Iterable[Outcome]) -> pd.DataFrame:
    """A row per run, in order, whatever order the outcomes come in.

    Args:
        points: Factors of each run.
        outcomes: One of each run.
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
    """`uavtwin simulate` of a scenario.

    Args:
        scenario: Of a run.
        vehicle: Name or file of its vehicle, where it is not the usual one.
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
