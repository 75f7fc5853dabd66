"""Result of a fleet: overview of aircraft and logs, and their joint statistics."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..display import PageMixin, TextTable
from ..record import Record
from ..wording import misfit
from .dataset import MOTORS, NO_LOG, read_table
from .fleet_statistics import (
    FEWEST_OWN,
    Difference,
    Drift,
    OfAircraft,
    Spread,
    compared,
    explained_aircraft,
    spreads,
)
from .statistics import FEWEST_AIRCRAFT, FEWEST_FLIGHTS

UNNAMED = "(not named by its log)"
"""Name for the aircraft of logs that name none."""
_NUMBERS = ("hover_command", "hover_speed_rad_s", "carried", "back_m", "right_m")
"""Columns of `flights` whose median is shown."""
_SPLIT = tuple(f"motor_{i}" for i in range(1, MOTORS + 1))
"""Columns of the motors."""
_ABOUT = ("log", "aircraft", "status", "vehicle", "verdict", "named", "causes")
"""Text columns of an overview."""
HEADER = (
    *("went wrong", "hover", "carried", "back, mm", "right, mm"),
    *("least loaded motor", "most loaded motor", "lacks"),
)
"""Head of the printed table."""
UNKNOWN = "-"
"""Cell of an unknown value."""
CELLS = (
    f"{UNKNOWN}: nothing named, or not known (no hover in the log, no vehicle). Went wrong: causes "
    "of why. Carried: thrust of the twin over the weight. Back, right: centre of mass. Loaded: "
    "command of a motor in hover, over the mean of all. Lacks: effects of explain. Log: state of "
    "the file, not of the flight."
)
"""Legend of the printed table."""


class AircraftRecord(Record, frozen=True, kw_only=True):
    """Overview of an aircraft; null for unknown values.

    Attributes:
        aircraft: Name of the aircraft.
        flights: Number of flights.
        vehicle: Name of its vehicle file.
        hover_command, hover_speed_rad_s, carried, back_m, right_m: Medians of its flights, as in
            the columns of `flights`.
        split: Split of the motors, median.
        named: Number of flights in which `explain` names an effect, by effect.
        causes: Number of flights in which `why` names a cause, by cause.
        misfit: Reason why the vehicle file does not fit; null where it does.
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
    causes: dict[str, int]
    misfit: str | None


@dataclass(frozen=True, slots=True)
class Overview:
    """Overview of one log, or medians over the logs of one aircraft; NaN: unknown.

    Attributes:
        name: Name of the log or the aircraft.
        aircraft: Aircraft named in the log; "" without one.
        flights: Number of flights.
        status: Status of a log; "" for an aircraft.
        vehicle: Name of the vehicle file used.
        numbers: Columns of `flights` by name: hover, carried, centre of mass.
        split: Command or speed of each motor in hover over the mean of all, minus 1.
        named: Number of flights by effect that `explain` lists.
        causes: Number of flights by cause that `why` names.
    """

    name: str
    aircraft: str
    flights: int
    status: str
    vehicle: str
    numbers: dict[str, float]
    split: tuple[float, ...]
    named: dict[str, int]
    causes: dict[str, int] = field(default_factory=dict)

    @property
    def misfit(self) -> str:
        """Reason why the vehicle file does not fit; "" where it does, or where that is not
        known."""
        text = misfit(self.numbers["carried"], self.vehicle)
        return f"{self.name}: {text}" if text else ""

    def cells(self) -> tuple[str, ...]:
        """Cells of a row below `HEADER`."""
        n = self.numbers
        hover = _text(n["hover_command"], "{:.3f}") or _text(n["hover_speed_rad_s"], "{:.0f} rad/s")
        extremes: tuple[str, ...] = ("", "")
        if self.split:
            places = int(np.argmin(self.split)), int(np.argmax(self.split))
            if any(round(100 * self.split[p]) for p in places):
                extremes = tuple(f"{p + 1}: {round(100 * self.split[p]):+d} %" for p in places)
        return (
            self._counted(self.causes),
            hover,
            _text(n["carried"], "{:.2f}"),
            _text(1e3 * n["back_m"], "{:+.1f}"),
            _text(1e3 * n["right_m"], "{:+.1f}"),
            *extremes,
            self._counted(self.named),
        )

    def _counted(self, names: Mapping[str, int]) -> str:
        """Names; for several flights each with the number of flights."""
        return ", ".join(
            f"{n.replace('_', ' ')}{f' ({k} of {self.flights})' if self.flights > 1 else ''}"
            for n, k in names.items()
        )

    def line(self) -> str:
        """The overview in one line."""
        known = zip(HEADER, self.cells(), strict=True)
        cells = (f"{name} {text}" for name, text in known if text)
        about = f"log {self.status}" if self.status else f"{self.flights} flights"
        about = NO_LOG if self.status == NO_LOG else about
        return f"{self.name}: {'; '.join([about, *cells])}"

    @property
    def record(self) -> AircraftRecord:
        """Record for `fleet.json`."""
        return AircraftRecord(
            aircraft=self.name,
            flights=self.flights,
            vehicle=self.vehicle or None,
            split=self.split,
            named=dict(self.named),
            causes=dict(self.causes),
            misfit=self.misfit or None,
            **{name: self.numbers[name] for name in _NUMBERS},
        )


def of_logs(folder: Path, most: int | None = None) -> list[Overview]:
    """Overview of each log, in the order of the table; of the first `most` logs."""
    flights = _table(folder)
    rows = flights if most is None else flights.head(most)
    return [of_log({str(k): v for k, v in row.items()}) for row in rows.to_dict("records")]


def of_aircraft(folder: Path) -> list[Overview]:
    """Overview of each aircraft, by name; logs without a name count as one."""
    flights = _table(folder)
    read = flights[~flights["status"].isin(["unreadable", NO_LOG, "copy", "failed"])]
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
            dict(Counter(c for text in own["causes"] for c in _listed(text)).most_common()),
        )


def of_log(row: Mapping[str, Any]) -> Overview:
    """Overview from a row of `flights`, in which unknown values may be missing."""
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
        {c: 1 for c in _listed(text["causes"])},
    )


def _listed(text: str) -> list[str]:
    """Causes in a cell."""
    return [c for c in str(text).split("; ") if c]


def _split(numbers: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(float(numbers[n]) for n in _SPLIT if np.isfinite(numbers[n]))


def _table(folder: Path) -> pd.DataFrame:
    numbers = [*_NUMBERS, *_SPLIT]
    found = read_table(folder, "flights", [*_ABOUT, *numbers]).astype(dict.fromkeys(numbers, float))
    return found.fillna(dict.fromkeys(_ABOUT, ""))


def table_of(rows: Sequence[Overview], first: str, most: int) -> TextTable:
    """Printed table of the first `most` rows.

    Args:
        rows: Overviews of logs or aircraft.
        first: Title of the first column.
        most: Largest number of printed rows.
    """
    logs = any(r.status for r in rows)
    lines = tuple(
        (r.name, r.status if logs else str(r.flights), *(c or UNKNOWN for c in r.cells()))
        for r in rows[:most]
    )
    if len(rows) > most:
        lines += ((f"{len(rows) - most} more", *[""] * (1 + len(HEADER))),)
    return TextTable((first, "log" if logs else "flights", *HEADER), lines)


def _text(value: float, form: str) -> str:
    return form.format(value) if np.isfinite(value) else ""


MOST_ROWS = 20
"""Largest number of printed rows of a table."""
BAD = ("unreadable", "failed", "refused", "findings")
"""Statuses of logs that are listed as bad."""


@dataclass(frozen=True, slots=True)
class EstimateRecord(OfAircraft):
    """A number of an effect for one aircraft.

    Attributes:
        own: The estimate, shrunk towards the type by its uncertainty.
        own_sd: Standard deviation of `own`.
    """

    own: float
    own_sd: float


class SpreadRecord(Record, frozen=True, kw_only=True):
    """A number of an effect over all aircraft.

    Attributes:
        effect: Name of the effect.
        number: Name of the effect's number.
        unit: SI unit.
        of_type: Whether the effect belongs to the type.
        mean: Mean over aircraft.
        sd: Standard deviation of the mean.
        low: Lower end of the mean's 95 % interval; null: a single aircraft.
        high: Upper end of the mean's 95 % interval.
        between: Standard deviation between aircraft.
        explained: Number of aircraft that were explained.
        aircraft: Aircraft that have it.
    """

    effect: str
    number: str
    unit: str
    of_type: bool
    mean: float
    sd: float
    low: float
    high: float
    between: float
    explained: int
    aircraft: tuple[EstimateRecord, ...]


class ComparisonCounts(Record, frozen=True, kw_only=True):
    """Numbers of statistical tests.

    Attributes:
        differences: Number of comparisons of aircraft.
        drifts: Number of slopes over time.
    """

    differences: int
    drifts: int


class FleetRecord(Record, frozen=True, kw_only=True):
    """Joint results of a fleet's logs.

    Attributes:
        vehicle: Name of the vehicle file of all; null: each aircraft has its own.
        logs: Number of logs.
        statuses: Number of logs by status.
        diagnosed: Number of flights diagnosed by `why`.
        went_wrong: Number of these flights with a fault.
        aircraft: Number of flights by aircraft.
        unnamed: Number of flights whose log names no aircraft.
        dated: Number of flights with a date.
        cannot: Results that could not be determined, with the reason.
        misfits: Aircraft that do not fit their vehicle file, with the reason.
        overview: Overview of each aircraft.
        tests: Numbers of statistical tests.
        differences: Significant differences, the most significant first.
        drifts: Significant drifts.
        effects: Each number of an effect over the aircraft that have it.
    """

    vehicle: str | None
    logs: int
    statuses: dict[str, int]
    diagnosed: int
    went_wrong: int
    aircraft: dict[str, int]
    unnamed: int
    dated: int
    cannot: tuple[str, ...]
    misfits: tuple[str, ...]
    overview: tuple[AircraftRecord, ...]
    tests: ComparisonCounts
    differences: tuple[Difference, ...]
    drifts: tuple[Drift, ...]
    effects: tuple[SpreadRecord, ...]


@dataclass(frozen=True, repr=False)
class FleetResult(PageMixin):
    """Result of a fleet.

    Attributes:
        folder: Folder of the dataset.
        vehicle: Name of the vehicle file of all; "": each aircraft has its own.
        statuses: Number of logs by status.
        aircraft: Number of flights by aircraft.
        unnamed: Number of flights whose log names no aircraft.
        dated: Number of flights with a date.
        differences: Every aircraft compared with the others, the most significant first.
        drifts: Every number over time, the most significant first.
        spreads: Numbers of effects over aircraft.
        explained: Number of explanations by aircraft.
        rows: An overview of each aircraft, by name.
        diagnosed: Number of flights diagnosed by `why`.
        went_wrong: Number of these flights with a fault.
    """

    folder: Path
    vehicle: str
    statuses: Mapping[str, int]
    aircraft: Mapping[str, int]
    unnamed: int
    dated: int
    differences: tuple[Difference, ...]
    drifts: tuple[Drift, ...]
    spreads: tuple[Spread, ...]
    explained: Mapping[str, int] = field(default_factory=dict)
    rows: tuple[Overview, ...] = ()
    diagnosed: int = 0
    went_wrong: int = 0

    page = "uavtwin.report.fleet"

    @property
    def logs(self) -> int:
        """Number of logs."""
        return sum(n for status, n in self.statuses.items() if status != NO_LOG)

    @property
    def bad(self) -> int:
        """Number of damaged or unusable logs, without duplicates."""
        return sum(self.statuses.get(s, 0) for s in BAD)

    @property
    def differing(self) -> tuple[Difference, ...]:
        """Significant differences."""
        return tuple(d for d in self.differences if d.significant)

    @property
    def drifting(self) -> tuple[Drift, ...]:
        """Significant drifts."""
        return tuple(d for d in self.drifts if d.significant)

    @property
    def misfits(self) -> tuple[str, ...]:
        """Aircraft, and logs without one, that do not fit their vehicle file, with the reason."""
        rows = [r for r in self.rows if r.name != UNNAMED]
        if self.unnamed:
            rows += [r for r in of_logs(self.folder) if not r.aircraft]
        return tuple(r.misfit for r in rows if r.misfit)

    @property
    def claim(self) -> str:
        """The main result, in one sentence."""
        about = _many(self.logs, "log")
        if self.aircraft:
            about += f" of {_many(len(self.aircraft), 'aircraft', '')}"
        elif self.unnamed:
            about += " of aircraft that no log names"
        wrong = f"{self.went_wrong} of {_many(self.diagnosed, 'flight')} went wrong"
        parts = [*[wrong][: self.diagnosed], self._differ(), self._drift()]
        if misfit := len(self.misfits):
            parts.append(f"the vehicle file does not fit {misfit} of them")
        bad = f"{_many(self.bad, 'log')} {'is' if self.bad == 1 else 'are'} damaged or of no use"
        parts += [bad, *(f"{_many(n, 'file')} no log" for n in [self.statuses.get(NO_LOG)] if n)]
        return f"{about}: {', '.join(parts)}"

    def _differ(self) -> str:
        """Text on the number of aircraft that differ, or why it cannot be determined."""
        if not self.differences:
            return f"which aircraft differs cannot be determined ({self._no_differences()})"
        differ = len({d.aircraft for d in self.differing})
        return f"{differ or 'none'} {'differs' if differ == 1 else 'differ'} from the others"

    def _drift(self) -> str:
        """Text on the number of aircraft that drift, or why it cannot be determined."""
        if not self.drifts:
            return (
                f"what drifts cannot be determined (no aircraft has {FEWEST_FLIGHTS} flights "
                f"whose logs have a date)"
            )
        drift = len({d.aircraft for d in self.drifting})
        return f"{drift or 'none'} {'drifts' if drift == 1 else 'drift'} over time"

    def _no_differences(self) -> str:
        if len(self.aircraft) < FEWEST_AIRCRAFT:
            named = _many(len(self.aircraft), "named aircraft", "")
            return f"{named}, {FEWEST_AIRCRAFT} are needed"
        return f"no number is known of {FEWEST_AIRCRAFT} aircraft, one with {FEWEST_OWN} flights"

    @property
    def cannot(self) -> tuple[str, ...]:
        """Results that could not be determined, with the reason."""
        found = [] if self.differences else [self._differ()]
        found += [] if self.drifts else [self._drift()]
        if self.unnamed:
            found.append(
                f"{_many(self.unnamed, 'flight')} of an aircraft that the log does not name: in "
                f"the tables, in no comparison"
            )
        return tuple(found)

    def bad_logs(self, most: int) -> pd.DataFrame:
        """Damaged or unusable logs, and files that are no logs: log, status, error or its first
        problem."""
        about = read_table(self.folder, "flights", ["log", "status", "error"])
        rows = about[about["status"].isin([*BAD, "copy", NO_LOG])].head(most).copy()
        damaged = rows[rows["status"] == "findings"]["log"].tolist()
        if damaged:
            first = read_table(
                self.folder,
                "findings",
                ["log", "text"],
                [("severity", "==", "problem"), ("log", "in", damaged)],
            ).drop_duplicates("log")
            text = dict(zip(first["log"], first["text"], strict=True))
            rows["error"] = rows["error"].fillna(rows["log"].map(text))
        return rows

    @cached_property
    def record(self) -> FleetRecord:
        """Record of every number that is printed."""
        return FleetRecord(
            vehicle=self.vehicle or None,
            logs=self.logs,
            statuses=dict(self.statuses),
            diagnosed=self.diagnosed,
            went_wrong=self.went_wrong,
            aircraft=dict(self.aircraft),
            unnamed=self.unnamed,
            dated=self.dated,
            cannot=tuple(self.cannot),
            misfits=tuple(self.misfits),
            overview=tuple(r.record for r in self.rows),
            tests=ComparisonCounts(differences=len(self.differences), drifts=len(self.drifts)),
            differences=tuple(self.differing),
            drifts=tuple(self.drifting),
            effects=tuple(map(_spread, self.spreads)),
        )

    def findings(self) -> Iterable[str | TextTable]:
        """The main result, each aircraft, each log, differences, drifts, effects, bad logs."""
        yield self.claim
        if self.misfits:
            yield "\n".join(self.misfits[:MOST_ROWS])
        if self.rows:
            yield table_of(self.rows, "aircraft", MOST_ROWS)
        yield table_of(of_logs(self.folder), "flight", MOST_ROWS)
        yield CELLS
        if self.differing:
            head: tuple[str, ...] = ("differs", "number", "its median", "flights")
            head += ("others", "unit", "q")
            yield TextTable(
                head,
                tuple(
                    (
                        *(d.aircraft, d.number, _g(d.value), str(d.flights)),
                        *(f"{_g(d.others)} ± {_g(d.spread)}", d.unit, f"{d.q:.2g}"),
                    )
                    for d in self.differing[:MOST_ROWS]
                ),
            )
        if self.drifting:
            head = ("drifts", "number", "in 30 days", "95 % interval", "unit", "q")
            yield TextTable(
                head,
                tuple(
                    (
                        *(d.aircraft, d.number, f"{d.trend.slope:+.3g}"),
                        *(f"{d.trend.low:+.3g} to {d.trend.high:+.3g}", d.unit, f"{d.q:.2g}"),
                    )
                    for d in self.drifting[:MOST_ROWS]
                ),
            )
        if self.spreads:
            head = ("effect", "aircraft", "mean", "95 % interval", "between aircraft", "unit")
            yield TextTable(
                head,
                tuple(
                    (
                        *(f"{s.effect}.{s.number}", f"{len(s.aircraft)} of {s.explained}"),
                        *(_g(s.common.mean), _interval(s), _g(s.common.between), s.unit),
                    )
                    for s in self.spreads[:MOST_ROWS]
                ),
            )
        bad = self.bad_logs(MOST_ROWS)
        if len(bad):
            rows = bad.fillna("").itertuples(index=False)
            texts = tuple((str(a), str(b), str(c)[:160]) for a, b, c in rows)
            yield TextTable(("log", "status", "why"), texts)
        if self.cannot:
            yield "\n".join(f"{text[0].upper()}{text[1:]}." for text in self.cannot)

    def brief(self) -> str:
        """Text on the number of logs and aircraft."""
        return f"{type(self).__name__}: {self.logs} logs of {len(self.aircraft)} aircraft"


def result_of(folder: Path, vehicle: str) -> FleetResult:
    """Result of a dataset.

    Args:
        folder: Folder of the dataset.
        vehicle: Name of the vehicle of all aircraft; "": each has its own.
    """
    about = read_table(folder, "flights", ["status", "aircraft", "date_year", "why"])
    read = about[about["aircraft"].notna() & (about["status"] != "copy")]
    named = read[read["aircraft"] != ""]
    verdicts = read["why"].dropna()
    differences, drifts = compared(folder)
    explained = explained_aircraft(folder)
    return FleetResult(
        folder,
        vehicle,
        {str(k): int(v) for k, v in about["status"].value_counts().sort_index().items()},
        {str(k): int(v) for k, v in named.groupby("aircraft").size().items()},
        len(read) - len(named),
        int(read["date_year"].notna().sum()),
        tuple(differences),
        tuple(drifts),
        tuple(spreads(folder, explained)),
        explained,
        tuple(of_aircraft(folder)),
        int((verdicts != "").sum()),
        int((verdicts == "found").sum()),
    )


def _spread(s: Spread) -> SpreadRecord:
    c = s.common
    return SpreadRecord(
        effect=s.effect,
        number=s.number,
        unit=s.unit,
        of_type=s.of_type,
        mean=c.mean,
        sd=c.sd,
        low=c.low,
        high=c.high,
        between=c.between,
        explained=s.explained,
        aircraft=tuple(
            EstimateRecord(**asdict(a), own=float(c.own[i]), own_sd=float(c.own_sd[i]))
            for i, a in enumerate(s.aircraft)
        ),
    )


def _interval(s: Spread) -> str:
    if not np.isfinite(s.common.low):
        return "one aircraft"
    return f"{_g(s.common.low)} to {_g(s.common.high)}"


def _g(value: float) -> str:
    return f"{value:.3g}"


def _many(count: int, one: str, plural: str = "s") -> str:
    return f"{count} {one}{'' if count == 1 else plural}"
