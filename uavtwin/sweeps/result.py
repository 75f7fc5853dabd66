"""A sweep that was run: a row per run."""

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

from twin.effects import EFFECTS
from twin.formatting import counted

from ..display import PageMixin, TextTable
from ..output import output_file
from ..record import Record
from ..simulation import Scenario
from .design import Design, Value
from .outcome import FIGURES, Outcome
from .sensitivity import Influence, influences

LED_BY = "tracking_worst_m"
"""Figure by which runs are the worst, and which factors are held against."""
WORST = 10


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

    def json(self) -> dict[str, Any]:
        """The content of `sweep.json`."""
        return self.record.json()

    def save(self, path: str | Path) -> Path:
        """Write the table as Parquet; returns its path."""
        with output_file(Path(path)) as file:
            pq.write_table(pa.Table.from_pandas(self.table, preserve_index=False), file)
        return Path(path)

    def sections(self) -> Iterable[str | TextTable]:
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

        if self.warnings:
            yield "\n".join(self.warnings)

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
