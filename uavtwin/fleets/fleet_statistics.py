"""What the flights of a fleet say together: which aircraft differs, which number drifts."""

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
"""Phase that stands for all samples, as in `uavtwin.gaps`."""
MEAN_OF = "mean residual "
"""Before the name of a channel: the mean of measured minus simulated over a flight."""
NORMAL_MAD = 1.4826
"""Standard deviation over the median absolute deviation, of a normal distribution."""
MEDIAN_COST = np.pi / 2
"""Variance of a median over that of a mean, of a normal distribution."""
FEWEST_OWN = 2
"""Flights of an aircraft from which on it may differ: one may be unlike the next of the same."""
FEWEST_FLIGHTS = 3
"""Of which an aircraft tells by itself how much its flights differ."""


@dataclass(frozen=True, slots=True)
class Measure:
    """One number of all flights that have it.

    Attributes:
        name: Of a column of `flights`, or the mean residual of a channel.
        unit: As printed.
        table: A row per flight: `aircraft`, `date_year`, `value`.
    """

    name: str
    unit: str
    table: pd.DataFrame


@dataclass(frozen=True, slots=True)
class Difference:
    """An aircraft against the others, in one number.

    Attributes:
        number: Its name.
        unit: As printed.
        aircraft: Which.
        value: Median of its flights.
        others: Median over the other aircraft.
        spread: Standard deviation of the other aircraft.
        p: Probability of one as far out among so many that are alike.
        q: Share of false discoveries among those that are at least as clear.
        flights: Of this aircraft.
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
    """A number of an aircraft over time.

    Attributes:
        number: Its name.
        unit: Of the number; slopes are per 30 days.
        aircraft: Which.
        trend: Its slope.
        q: Share of false discoveries among those that are at least as clear.
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
    """Numbers of flights whose aircraft is known, one after another: memory holds one of them.

    Args:
        folder: Of the dataset.
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
    """Every aircraft against the others, and over time, the clearest first.

    Differences: within a number by Rosner's procedure over the aircraft, over numbers by
    Benjamini and Hochberg. Drifts: by Benjamini and Hochberg over all numbers and aircraft.
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
    """Each aircraft of several flights against the others."""
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
    """Aircraft, flights of each, median of each, and the variance of that median.

    Args:
        table: With `aircraft` and `value`.
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
    """The same with its share of false discoveries among all numbers."""
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
"""Probability from which on an effect of one explanation is taken for there."""
NAMED_SHARE = 0.5
"""Of the explanations of an aircraft, and of the aircraft of a type, that name an effect: of fewer,
it is of some flights, or of some aircraft, alone."""
FEWEST_OF_TYPE = 3
"""From which on an effect is of the type."""


@dataclass(frozen=True, slots=True)
class OfAircraft:
    """A number of an aircraft.

    Attributes:
        aircraft: Which.
        value: Estimate from its own flights.
        sd: Its standard deviation.
        named: Explanations that name the effect.
        explained: Explanations.
    """

    aircraft: str
    value: float
    sd: float
    named: int
    explained: int

    @property
    def steady(self) -> bool:
        """Whether it is of the aircraft, not of some flights of it."""
        return self.named >= NAMED_SHARE * self.explained


@dataclass(frozen=True, slots=True)
class Spread:
    """A number of an effect over the aircraft.

    Attributes:
        effect: Name.
        number: Of the effect.
        unit: As printed.
        aircraft: Those that have it, by name.
        common: What they have in common, in their order.
        explained: Aircraft that were explained.
    """

    effect: str
    number: str
    unit: str
    aircraft: tuple[OfAircraft, ...]
    common: Common
    explained: int

    @property
    def of_type(self) -> bool:
        """Whether the effect is one of the type."""
        enough = len(self.aircraft) >= max(FEWEST_OF_TYPE, NAMED_SHARE * self.explained)
        return enough and self.of_vehicle

    @property
    def of_vehicle(self) -> bool:
        """Whether a vehicle file may hold the effect, and no day has brought it."""
        effect = EFFECTS[self.effect]
        return effect.of_vehicle and not effect.of_weather


def explained_aircraft(folder: Path) -> dict[str, int]:
    """Explanations of each aircraft that could be explained, by name."""
    effects = read_table(folder, "effects", ["log", "aircraft", "verdict"]).drop_duplicates()
    done = effects[(effects["verdict"] != "unusable") & (effects["aircraft"] != "")]
    return {str(a): int(n) for a, n in done.groupby("aircraft", sort=True).size().items()}


def spreads(folder: Path, explained: dict[str, int] | None = None) -> list[Spread]:
    """Every number of an effect that aircraft have, over the aircraft, by name.

    Estimates of several flights of an aircraft are put together as those of aircraft are.

    Args:
        folder: Of the dataset.
        explained: Explanations by aircraft; None: as the dataset has them.
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
