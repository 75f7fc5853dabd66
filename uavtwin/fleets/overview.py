"""One row per log and per aircraft of a fleet: hover, balance, named effects, fit of the file."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..display import TextTable
from ..record import Record
from .dataset import MOTORS, read_table
from .log_analysis import misfit

UNNAMED = "(not named by its log)"
_NUMBERS = ("hover_command", "hover_speed_rad_s", "carried", "back_m", "right_m")
_SPLIT = tuple(f"motor_{i}" for i in range(1, MOTORS + 1))
_ABOUT = ("log", "aircraft", "status", "vehicle", "verdict", "named")
HEADER = ("hover", "carried", "back, mm", "right, mm", "strongest motor", "weakest motor", "named")


class AircraftRecord(Record, frozen=True, kw_only=True):
    """An aircraft in short; null for what is unknown.

    Attributes:
        aircraft: Its name.
        flights: How many.
        vehicle: Of its vehicle file.
        hover_command, hover_speed_rad_s, carried, back_m, right_m: Medians of its flights, as of
            the columns of `flights`.
        split: Of the motors, median.
        named: Flights that name an effect, by effect.
        misfit: Why the vehicle file does not fit; null where it does.
    """

    aircraft: str
    flights: int
    vehicle: str | None
    hover_command: float
    hover_speed_rad_s: float
    carried: float
    back_m: float
    right_m: float
    split: tuple[float, ...]
    named: dict[str, int]
    misfit: str | None


@dataclass(frozen=True, slots=True)
class Overview:
    """What is known of one log, or the medians over the logs of one aircraft; NaN: unknown.

    Attributes:
        name: Of the log or the aircraft.
        aircraft: As its log names it; "" where it does not.
        flights: How many.
        status: Of a log; "" of an aircraft.
        vehicle: Name of the vehicle file it is compared with.
        numbers: Columns of `flights` by name: hover, carried, centre of mass.
        split: Command or speed of each motor in hover over the mean of all, minus 1.
        named: Effects that `explain` lists, each with the number of flights.
    """

    name: str
    aircraft: str
    flights: int
    status: str
    vehicle: str
    numbers: dict[str, float]
    split: tuple[float, ...]
    named: dict[str, int]

    @property
    def misfit(self) -> str:
        """Why the vehicle file does not fit; "" where it does, or where that is not known."""
        text = misfit(self.numbers["carried"], self.vehicle)
        return f"{self.name}: {text}" if text else ""

    def cells(self) -> tuple[str, ...]:
        """As `HEADER` says."""
        n = self.numbers
        hover = _text(n["hover_command"], "{:.3f}") or _text(n["hover_speed_rad_s"], "{:.0f} rad/s")
        extremes: tuple[str, ...] = ("", "")
        if self.split:
            places = int(np.argmin(self.split)), int(np.argmax(self.split))
            extremes = tuple(f"{p + 1}: {round(100 * self.split[p]):+d} %" for p in places)
        effects = ", ".join(
            f"{e.replace('_', ' ')}{f' ({k} of {self.flights})' if self.flights > 1 else ''}"
            for e, k in self.named.items()
        )
        return (
            hover,
            _text(n["carried"], "{:.2f}"),
            _text(1e3 * n["back_m"], "{:+.1f}"),
            _text(1e3 * n["right_m"], "{:+.1f}"),
            *extremes,
            effects,
        )

    def line(self) -> str:
        """What is known, in one line."""
        known = zip(HEADER, self.cells(), strict=True)
        cells = (f"{name} {text}" for name, text in known if text)
        return f"{self.name}: {'; '.join([self.status or f'{self.flights} flights', *cells])}"

    @property
    def record(self) -> AircraftRecord:
        """For `fleet.json`."""
        return AircraftRecord(
            aircraft=self.name,
            flights=self.flights,
            vehicle=self.vehicle or None,
            split=self.split,
            named=dict(self.named),
            misfit=self.misfit or None,
            **{name: self.numbers[name] for name in _NUMBERS},
        )


def of_logs(folder: Path, most: int | None = None) -> list[Overview]:
    """One of each log, in the order of the table; of `most` logs."""
    flights = _table(folder)
    rows = flights if most is None else flights.head(most)
    return [of_log({str(k): v for k, v in row.items()}) for row in rows.to_dict("records")]


def of_aircraft(folder: Path) -> list[Overview]:
    """One of each aircraft, by name; those of logs that name none come together."""
    flights = _table(folder)
    read = flights[~flights["status"].isin(["unreadable", "copy", "failed"])]
    effects = read_table(folder, "effects", ["log", "aircraft", "effect"]).dropna()
    effects = effects.drop_duplicates()
    effects["aircraft"] = effects["aircraft"].replace("", UNNAMED)
    named = effects.groupby(["aircraft", "effect"]).size()
    return list(_of_aircraft(read, named))


def _of_aircraft(read: pd.DataFrame, named: "pd.Series") -> Iterator[Overview]:
    for aircraft, own in read.groupby(read["aircraft"].replace("", UNNAMED), sort=True):
        counts = named.loc[aircraft] if aircraft in named.index.get_level_values(0) else {}
        by_count = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
        numbers = own[[*_NUMBERS, *_SPLIT]].median(skipna=True).to_dict()
        yield Overview(
            str(aircraft),
            "" if aircraft == UNNAMED else str(aircraft),
            len(own),
            "",
            ", ".join(sorted(set(own["vehicle"].dropna()))),
            {n: float(numbers[n]) for n in _NUMBERS},
            _split(numbers),
            {str(e): int(n) for e, n in by_count},
        )


def of_log(row: Mapping[str, Any]) -> Overview:
    """Of a row of `flights`, in which what is unknown may be missing."""
    text = {n: row.get(n) or "" for n in _ABOUT}
    number = {n: np.nan if row.get(n) is None else float(row[n]) for n in (*_NUMBERS, *_SPLIT)}
    return Overview(
        text["log"],
        text["aircraft"],
        1,
        text["status"],
        text["vehicle"],
        {n: number[n] for n in _NUMBERS},
        _split(number),
        {e: 1 for e in text["named"].split(", ") if e},
    )


def _split(numbers: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(float(numbers[n]) for n in _SPLIT if np.isfinite(numbers[n]))


def _table(folder: Path) -> pd.DataFrame:
    numbers = [*_NUMBERS, *_SPLIT]
    found = read_table(folder, "flights", [*_ABOUT, *numbers]).astype(dict.fromkeys(numbers, float))
    return found.fillna(dict.fromkeys(_ABOUT, ""))


def table_of(rows: Sequence[Overview], first: str, most: int) -> TextTable:
    """As printed: the first `most` of them.

    Args:
        rows: Logs or aircraft.
        first: What they are.
        most: Rows that are printed.
    """
    logs = any(r.status for r in rows)
    lines = tuple((r.name, r.status if logs else str(r.flights), *r.cells()) for r in rows[:most])
    if len(rows) > most:
        lines += ((f"{len(rows) - most} more", *[""] * (1 + len(HEADER))),)
    return TextTable((first, "status" if logs else "flights", *HEADER), lines)


def _text(value: float, form: str) -> str:
    return form.format(value) if np.isfinite(value) else ""
