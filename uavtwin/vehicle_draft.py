"""Draft of a vehicle file from flights of an aircraft, as a result to print and to save."""

import dataclasses
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from msgspec import UNSET, UnsetType, field, structs

from twin import vehicle as numbers
from twin.draft import Drafted, OwnerFacts, draft, kind_of
from twin.errors import TwinError
from twin.logs import Flight
from twin.vehicle.vehicle import hover_level, polynomial
from twin.vehicle_file import parse_vehicle

from .display import DisplayMixin, TextTable
from .flights import check_names, checked_flights
from .record import Record
from .vehicles import Vehicle

INCH_M = 0.0254
"""International inch, exactly."""
_FROM = {"given": "you", "log": "log", "usual": "usual"}
"""Words for the source of a number, in the table."""
_PROPELLER = re.compile(r"(\d+(?:\.\d+)?)[xX](\d+(?:\.\d+)?)(?:[xX]\d)?")
"""Pattern of diameter x pitch, and an optional number of blades."""
_LARGEST_M = 20.0
"""Longest plausible wheelbase, m."""


class DraftHover(Record, frozen=True, kw_only=True):
    """The hover of a flight.

    Attributes:
        flight: Name of the flight.
        level: Median of the mean of the motors.
        each: Median of each motor.
        seconds: Length of the hover, s.
        hovers: False: the flight hovers nowhere, this is all of it.
        where: Part of the flight, in words.
    """

    flight: str
    level: float
    each: tuple[float, ...]
    seconds: float
    hovers: bool
    where: str


class DraftLevel(Record, frozen=True, kw_only=True):
    """Hover of the draft and of the flights.

    Attributes:
        drive: `command`, or `rotor_speed` in rad/s.
        draft: Level at which the draft carries its weight.
        flights: Hover of each flight.
    """

    drive: str
    draft: float
    flights: tuple[DraftHover, ...]


class EntryRecord(Record, frozen=True, kw_only=True):
    """An entry of the vehicle file.

    Attributes:
        key: Key in the vehicle file.
        value: Number, text, or list of numbers.
        unit: Unit in the vehicle file.
        sd: Standard deviation, in the unit or as "5 %"; null: none.
        source: Source in the vehicle file.
        from: `given`, `log` or `usual`.
    """

    key: str
    value: Any
    unit: str
    sd: Any
    source: str
    from_: str = field(name="from")


class DraftRecord(Record, frozen=True, kw_only=True):
    """A vehicle in draft.

    Attributes:
        vehicle: Name of the vehicle.
        hover: Hover of the draft and of the flights.
        numbers: Entries of the file.
        warnings: Contradictions between the numbers.
        file: The written file; missing without one.
        next: The command to run next.
    """

    vehicle: str
    hover: DraftLevel
    numbers: tuple[EntryRecord, ...]
    warnings: tuple[str, ...]
    file: str | UnsetType = UNSET
    next: str | UnsetType = UNSET


@dataclass(frozen=True, repr=False)
class DraftResult(DisplayMixin):
    """A vehicle in draft.

    Attributes:
        vehicle: The vehicle, with the text of its file.
        details: Results from the flights, and the source of each number.
        files: The flights, as they were read.
    """

    vehicle: Vehicle
    details: Drafted = dataclasses.field(repr=False)
    files: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Contradictions between the numbers."""
        return self.details.warnings

    @property
    def hover_command(self) -> float:
        """Command at which the draft carries its weight; rotor speed, rad/s, without commands."""
        return hover_drive(self.vehicle)

    @property
    def sentence(self) -> str:
        """Summary of the draft, and whether its hover agrees with the flights."""
        v, flown = self.vehicle, self.details
        what = "command" if v.drive == "command" else "rotor speed, rad/s,"
        several = "flights hover" if len(flown.hovers) > 1 else "flight hovers"
        if not all(h.hovers for h in flown.hovers):
            several = "flights fly" if len(flown.hovers) > 1 else "flight flies"
        return (
            f"{v.name}: {v.rotors.count} rotors, {v.mass_kg:.4g} kg, hovers at {what} "
            f"{self.hover_command:.3g}; the {several} at {flown.level:.3g}."
        )

    def table(self) -> TextTable:
        """The numbers, with their sources."""
        rows = [(_FROM[f.kind], f.what, f.value, f.source) for f in self.details.facts]
        return TextTable(("from", "number", "value", "source"), tuple(rows))

    def next(self, out: str) -> str:
        """The command to run next, with a file of this name."""
        name = Path(out)
        better = name.with_name(f"{name.stem}_calibrated.toml")
        return f"uavtwin calibrate {' '.join(self.files)} --vehicle {out} --out {better}"

    @cached_property
    def record(self) -> DraftRecord:
        """Record of every number that is printed."""
        return DraftRecord(
            vehicle=self.vehicle.name,
            hover=DraftLevel(
                drive=self.vehicle.drive,
                draft=self.hover_command,
                flights=tuple(
                    DraftHover(
                        flight=h.flight,
                        level=h.level,
                        each=tuple(h.each),
                        seconds=h.seconds,
                        hovers=h.hovers,
                        where=h.where,
                    )
                    for h in self.details.hovers
                ),
            ),
            numbers=tuple(_entries(self.vehicle.text)),
            warnings=self.warnings,
        )

    def written(self, out: Path) -> DraftRecord:
        """Record after saving, with the file and the command to run next."""
        return structs.replace(self.record, file=str(out), next=self.next(str(out)))

    def findings(self) -> Iterable[str | TextTable]:
        """Headline, and numbers."""
        yield self.sentence
        yield self.table()

    def brief(self) -> str:
        """Name, rotors and mass."""
        v = self.vehicle
        return f"{type(self).__name__}: {v.name}, {v.rotors.count} rotors, {v.mass_kg:.4g} kg"


def draft_vehicle(
    flights: Flight | Sequence[Flight],
    mass_kg: float,
    *,
    frame: str | None = None,
    wheelbase_m: float | None = None,
    arm_m: float | None = None,
    propeller: str | None = None,
    name: str = "draft",
) -> DraftResult:
    """Draft a vehicle from flights and the owner's knowledge of the aircraft.

    Args:
        flights: Flights of one aircraft, PX4 logs or flight tables.
        mass_kg: Mass in flight, battery included: no log contains it.
        frame: "x", "+", "h", "wide", "betaflight x"; for six and eight rotors "x" and "+". Default:
            by the log, else by how it turned.
        wheelbase_m: Distance of two opposite motors.
        arm_m: Distance from the centre to a motor; this or `wheelbase_m` is necessary where the log
            has no coordinates in m.
        propeller: "10x4.5", diameter and pitch in inches. Default: usual for such an aircraft.
        name: Name of the vehicle.

    Raises:
        TwinError: Something is missing or wrong; the text says what to give.
    """
    several = checked_flights(flights, "draft_vehicle")
    if not several:
        raise TwinError("draft_vehicle: no flight to draft from.")
    check_names(several)
    if not 0 < mass_kg < 1e4:
        raise TwinError(f"mass {mass_kg:g} kg: give the mass as it flew, battery included.")
    if wheelbase_m is not None and arm_m is not None:
        raise TwinError("wheelbase and arm say the same; give one of them.")
    diameter_m, pitch_m = (None, None) if propeller is None else parse_propeller(propeller)
    known = OwnerFacts(
        name,
        mass_kg,
        frame,
        _size("wheelbase", wheelbase_m, 0.5) if arm_m is None else _size("arm", arm_m, 1.0),
        diameter_m,
        pitch_m,
    )
    found = draft(several, known)
    files = tuple(str(f.source or f.name) for f in several)
    return DraftResult(
        Vehicle.of(parse_vehicle(found.text, f"{name}.toml"), found.text), found, files
    )


def parse_propeller(text: str) -> tuple[float, float]:
    """Diameter and pitch, m, of a propeller by its trade name: inches, "10x4.5" or "5x4.3x3".

    Raises:
        TwinError: The text has another form.
    """
    found = _PROPELLER.fullmatch(text.strip())
    if not found or not float(found[1]) > 0:
        raise TwinError(
            f"propeller {text!r}: write diameter and pitch in inches, as in 10x4.5 or 5x4.3x3."
        )
    return float(found[1]) * INCH_M, float(found[2]) * INCH_M


def _size(what: str, given: float | None, share: float) -> float | None:
    """Arm from a given length."""
    if given is None:
        return None
    if not 0 < given < _LARGEST_M:
        raise TwinError(f"{what} {given:g} m: give it in m, between 0 and {_LARGEST_M:g}.")
    return share * given


def hover_drive(vehicle: numbers.Vehicle) -> float:
    """Input of the rotors when equal ones carry the weight: command, else speed, rad/s."""
    level, speed = hover_level(vehicle), vehicle.rotors.speed_rad_s
    if not vehicle.rotors.from_speed or speed is None:
        return level
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if polynomial(speed, middle) < level else (low, middle)
    return high


def _entries(text: str) -> Iterator[EntryRecord]:
    """Every entry of a vehicle file."""
    pending = list(tomllib.loads(text).items())
    while pending:
        key, entry = pending.pop(0)
        if not isinstance(entry, dict):
            continue
        if "source" not in entry:
            pending = [(f"{key}.{k}", v) for k, v in entry.items()] + pending
            continue
        yield EntryRecord(
            key=key,
            value=entry.get("value", entry.get("coefficients")),
            unit=entry.get("unit", "1"),
            sd=entry.get("sd"),
            source=entry["source"],
            from_=kind_of(entry["source"]),
        )
