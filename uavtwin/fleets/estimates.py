"""Numbers of effects: of each aircraft from its flights, and of the type from its aircraft."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from twin.effects import EFFECTS

from .dataset import read_table
from .statistics.hierarchy import Common, common_of

SURE = 0.5
"""Probability from which on an effect of one explanation is taken for there."""
NAMED_SHARE = 0.5
"""Of the explanations of an aircraft, and of the aircraft of a type, that name an effect: of fewer,
it is of some flights, or of some aircraft, alone."""
FEWEST_AIRCRAFT = 3
"""From which on an effect is of the type."""


@dataclass(frozen=True, slots=True)
class OfAircraft:
    """A number of an aircraft.

    Attributes:
        aircraft: Which.
        value: Estimate.
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
        enough = len(self.aircraft) >= max(FEWEST_AIRCRAFT, NAMED_SHARE * self.explained)
        return enough and self.of_vehicle

    @property
    def of_vehicle(self) -> bool:
        """Whether a vehicle file may hold the effect, and no day has brought it."""
        effect = EFFECTS[self.effect]
        return effect.of_vehicle and not effect.of_weather


def explained_aircraft(folder: Path) -> dict[str, int]:
    """Explanations of each aircraft that could be explained, by name."""
    told = read_table(folder, "effects", ["log", "aircraft", "verdict"]).drop_duplicates()
    done = told[(told["verdict"] != "unusable") & (told["aircraft"] != "")]
    return {str(a): int(n) for a, n in done.groupby("aircraft", sort=True).size().items()}


def spreads(folder: Path, explained: dict[str, int] | None = None) -> list[Spread]:
    """Every number of an effect that aircraft have, over the aircraft, by name.

    Estimates of several flights of an aircraft are put together as those of aircraft are.

    Args:
        folder: Of the dataset.
        explained: Explanations by aircraft; None: as the dataset has them.
    """
    told = read_table(folder, "effects")
    count = explained_aircraft(folder) if explained is None else explained
    sure = told[(told["probability"] >= SURE) & (told["sd"] > 0) & (told["aircraft"] != "")]
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
