"""Joint statistics of a fleet's flights: aircraft that differ, numbers that drift."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from twin.effects import EFFECTS

from .dataset import VITALS, distinct, read_table
from .statistics import (
    FALSE_SHARE,
    FEWEST_AIRCRAFT,
    Common,
    Trend,
    adjusted,
    common_of,
    differing,
    trend_of,
)

Array = NDArray[np.float64]
WHOLE = "whole flight"
"""Phase for all samples, as in `uavtwin.gaps`."""
MEAN_OF = "mean residual "
"""Prefix of a channel's name: the mean of measured minus simulated over a flight."""
NORMAL_MAD = 1.4826
"""Standard deviation over the median absolute deviation, for a normal distribution."""
MEDIAN_COST = np.pi / 2
"""Variance of a median over that of a mean, for a normal distribution."""
FEWEST_OWN = 2
"""Fewest flights of an aircraft that may differ: a single one may be an exception."""
FEWEST_FLIGHTS = 3
"""Fewest flights for an estimate of the variation between flights of one aircraft."""


@dataclass(frozen=True, slots=True)
class Measure:
    """One number of all flights that have it.

    Attributes:
        name: Name of a column of `flights`, or the mean residual of a channel.
        unit: Printed unit.
        table: One row per flight: `aircraft`, `date_year`, `value`.
    """

    name: str
    unit: str
    table: pd.DataFrame


@dataclass(frozen=True, slots=True)
class Difference:
    """Comparison of an aircraft with the others, in one number.

    Attributes:
        number: Name of the number.
        unit: Printed unit.
        aircraft: Name of the aircraft.
        value: Median of its flights.
        others: Median over the other aircraft.
        spread: Standard deviation of the other aircraft.
        p: Probability of a value as extreme among equal aircraft.
        q: Share of false discoveries among results at least as significant.
        flights: Number of flights of this aircraft.
    """

    number: str
    unit: str
    aircraft: str
    value: float
    others: float
    spread: float
    p: float
    q: float
    flights: int

    @property
    def significant(self) -> bool:
        """Whether its share of false discoveries is within `FALSE_SHARE`."""
        return self.q <= FALSE_SHARE


@dataclass(frozen=True, slots=True)
class Drift:
    """Trend of a number of an aircraft over time.

    Attributes:
        number: Name of the number.
        unit: Unit of the number; slopes are per 30 days.
        aircraft: Name of the aircraft.
        trend: Slope over time.
        q: Share of false discoveries among results at least as significant.
    """

    number: str
    unit: str
    aircraft: str
    trend: Trend
    q: float

    @property
    def significant(self) -> bool:
        """Whether its share of false discoveries is within `FALSE_SHARE`."""
        return self.q <= FALSE_SHARE


def measures(folder: Path) -> Iterator[Measure]:
    """Numbers of flights whose aircraft is known, one after another: one at a time is in memory.

    Args:
        folder: Folder of the dataset.
    """
    about = ["log", "aircraft", "date_year"]
    known = ~read_table(folder, "flights", ["aircraft"])["aircraft"].isin(["", None])
    if not known.any():
        return
    for column in VITALS:
        found = read_table(folder, "flights", [*about[1:], column.name])[known]
        found = found.rename(columns={column.name: "value"}).dropna(subset=["value"])
        if len(found):
            yield Measure(column.name, column.unit, found)
    dates = read_table(folder, "flights", about)[known].set_index("log")
    for channel, unit in distinct(folder, "channels", ("channel", "unit")):
        rows = [
            ("channel", "==", channel),
            ("unit", "==", unit),
            ("phase", "==", WHOLE),
            ("horizon_s", "==", 0.0),
        ]
        means = read_table(folder, "channels", ["log", "mean"], rows).dropna()
        found = means[means["log"].isin(dates.index)]
        table = dates.loc[found["log"]].assign(value=found["mean"].to_numpy())
        if len(table):
            yield Measure(f"{MEAN_OF}{channel}", unit, table)


def compared(folder: Path) -> tuple[list[Difference], list[Drift]]:
    """Every aircraft compared with the others, and over time, the most significant first.

    Differences: within a number by Rosner's procedure over the aircraft, over numbers by Benjamini
    and Hochberg. Drifts: by Benjamini and Hochberg over all numbers and aircraft.
    """
    differences: list[Difference] = []
    smallest: dict[str, float] = {}
    drifts: list[Drift] = []
    for m in measures(folder):
        own = _against_others(m)
        if own:
            smallest[m.name] = min(d.p for d in own)
        differences += own
        drifts += list(_over_time(m))
    differences = [_judged(d, smallest) for d in differences]
    q = adjusted([d.trend.p for d in drifts])
    drifts = [
        Drift(d.number, d.unit, d.aircraft, d.trend, float(share))
        for d, share in zip(drifts, q, strict=True)
    ]
    return (
        sorted(differences, key=lambda d: (d.q, d.p, d.number, d.aircraft)),
        sorted(drifts, key=lambda d: (d.q, d.trend.p, d.number, d.aircraft)),
    )


def _against_others(m: Measure) -> list[Difference]:
    """Each aircraft with several flights compared with the others."""
    names, flights, value, variance = per_aircraft(m.table)
    if len(names) < FEWEST_AIRCRAFT:
        return []
    p = differing(value, variance)
    usual = p > FALSE_SHARE
    found = []
    for i, name in enumerate(names):
        if flights[i] < FEWEST_OWN:
            continue
        rest = [k for k in range(len(names)) if k != i and usual[k]]
        others, spread = float(np.median(value[rest])), float(np.std(value[rest], ddof=1))
        sizes = (float(value[i]), others, spread, float(p[i]), 1.0, int(flights[i]))
        found.append(Difference(m.name, m.unit, name, *sizes))
    return found


def per_aircraft(table: pd.DataFrame) -> tuple[list[str], NDArray[np.int64], Array, Array]:
    """Aircraft, number of flights, median, and the variance of that median.

    Args:
        table: Table with `aircraft` and `value`.
    """
    grouped = table.groupby("aircraft", sort=True)["value"]
    names = [str(n) for n in grouped.groups]
    count = grouped.size().to_numpy()
    middle = grouped.median().to_numpy(dtype=np.float64)
    away = (table["value"] - grouped.transform("median")).abs()
    within = (NORMAL_MAD * away.groupby(table["aircraft"], sort=True).median()).to_numpy() ** 2
    enough = count >= FEWEST_FLIGHTS
    usual = float(np.median(within[enough])) if enough.any() else 0.0
    variance = MEDIAN_COST * np.where(enough, within, usual) / count
    return names, count, middle, np.asarray(variance, dtype=np.float64)


def _judged(d: Difference, smallest: dict[str, float]) -> Difference:
    """The difference with its share of false discoveries among all numbers."""
    p = [d.p if name == d.number else other for name, other in smallest.items()]
    q = float(adjusted(p)[list(smallest).index(d.number)])
    sizes = (d.value, d.others, d.spread, d.p, q, d.flights)
    return Difference(d.number, d.unit, d.aircraft, *sizes)


def _over_time(m: Measure) -> Iterator[Drift]:
    for aircraft, own in m.table.groupby("aircraft", sort=True):
        trend = trend_of(own["date_year"].to_numpy(), own["value"].to_numpy())
        if trend is not None:
            yield Drift(m.name, m.unit, str(aircraft), trend, 1.0)


SURE = 0.5
"""Probability from which an effect of one explanation counts as present."""
NAMED_SHARE = 0.5
"""Least share of an aircraft's explanations, and of a type's aircraft, that name an effect: with
fewer, it belongs to some flights, or some aircraft, only."""
FEWEST_OF_TYPE = 3
"""Fewest aircraft with an effect of the type."""


@dataclass(frozen=True, slots=True)
class OfAircraft:
    """A number of an effect for one aircraft.

    Attributes:
        aircraft: Name of the aircraft.
        value: Estimate from its own flights.
        sd: Standard deviation of the estimate.
        named: Number of explanations that name the effect.
        explained: Number of explanations.
    """

    aircraft: str
    value: float
    sd: float
    named: int
    explained: int

    @property
    def steady(self) -> bool:
        """Whether it belongs to the aircraft, not only to some of its flights."""
        return self.named >= NAMED_SHARE * self.explained


@dataclass(frozen=True, slots=True)
class Spread:
    """A number of an effect over all aircraft.

    Attributes:
        effect: Name of the effect.
        number: Name of the effect's number.
        unit: Printed unit.
        aircraft: Aircraft that have it, by name.
        common: Joint estimate, in the order of the aircraft.
        explained: Number of aircraft that were explained.
    """

    effect: str
    number: str
    unit: str
    aircraft: tuple[OfAircraft, ...]
    common: Common
    explained: int

    @property
    def of_type(self) -> bool:
        """Whether the effect belongs to the type."""
        enough = len(self.aircraft) >= max(FEWEST_OF_TYPE, NAMED_SHARE * self.explained)
        return enough and self.of_vehicle

    @property
    def of_vehicle(self) -> bool:
        """Whether the effect is allowed in a vehicle file, and does not depend on the day."""
        effect = EFFECTS[self.effect]
        return effect.of_vehicle and not effect.of_weather


def explained_aircraft(folder: Path) -> dict[str, int]:
    """Number of explanations of each aircraft that could be explained, by name."""
    effects = read_table(folder, "effects", ["log", "aircraft", "verdict"]).drop_duplicates()
    done = effects[(effects["verdict"] != "unusable") & (effects["aircraft"] != "")]
    return {str(a): int(n) for a, n in done.groupby("aircraft", sort=True).size().items()}


def spreads(folder: Path, explained: dict[str, int] | None = None) -> list[Spread]:
    """Every number of an effect over the aircraft, by name.

    Estimates from several flights of an aircraft are combined like those of several aircraft.

    Args:
        folder: Folder of the dataset.
        explained: Number of explanations by aircraft; None: from the dataset.
    """
    effects = read_table(folder, "effects")
    count = explained_aircraft(folder) if explained is None else explained
    sure = effects[
        (effects["probability"] >= SURE) & (effects["sd"] > 0) & (effects["aircraft"] != "")
    ]
    found = []
    for (effect, number, unit), own in sure.groupby(["effect", "number", "unit"], sort=True):
        each = tuple(a for a in _aircraft(own, count) if a.steady)
        if each:
            common = common_of([a.value for a in each], [a.sd for a in each])
            found.append(Spread(str(effect), str(number), str(unit), each, common, len(count)))
    return found


def _aircraft(own: pd.DataFrame, count: dict[str, int]) -> Iterator[OfAircraft]:
    for aircraft, rows in own.groupby("aircraft", sort=True):
        value, sd = (rows[c].to_numpy(dtype=np.float64) for c in ("value", "sd"))
        of = common_of(value, sd)
        yield OfAircraft(str(aircraft), of.mean, of.sd, len(rows), count.get(str(aircraft), 1))
