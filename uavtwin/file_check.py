"""Check of a file: content, problems, possible uses.

For a flight the kind of aircraft, its hover and its battery come first.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from twin.draft import Hover, drives, hover_of
from twin.draft.consistency import consistency
from twin.errors import LogError, ModelError, TwinError
from twin.explain.model.numbers import observable_effects
from twin.formatting import counted
from twin.logs import AnyFlight, open_flight
from twin.logs.columns import POS, QUAT, VEL
from twin.logs.read import file_of_bag, is_archive_of
from twin.logs.table import header
from twin.logs.validate import NO_TABLE, is_recording
from twin.physics.airframe import airframe
from twin.residuals.flight_gap import HoverDiagnosis, comparable, diagnosis_of
from twin.vehicle import Vehicle
from twin.vehicle.layouts import Layout
from twin.vehicle.plausibility import Question, questions
from twin.vehicle.vehicle import DEFAULT
from twin.vehicle_file import load_vehicle
from twin.vehicle_file.fields import FIELDS

from .display import DisplayMixin, TextTable
from .gaps import HoverRecord, hover_record
from .record import Record
from .vehicle_draft import hover_drive
from .wording import hover_sentence


class FlightHover(Record, frozen=True, kw_only=True):
    """The hover of a flight.

    Attributes:
        drive: `command`, or `rotor_speed` in rad/s.
        level: Median of the mean of the motors.
        each: Median of each motor.
        split: Output of each motor over the mean of all motors, minus 1.
        seconds: Length of the hover, s.
        hovers: False: the flight hovers nowhere, this is all of it.
        voltage_v: Median battery voltage; null: not logged.
        twin: Hover of the twin; only with `--vehicle`.
    """

    drive: str
    level: float
    each: tuple[float, ...]
    split: tuple[float, ...]
    seconds: float
    hovers: bool
    voltage_v: float | None
    twin: HoverRecord | None


class UnreadFile(Record, frozen=True, kw_only=True):
    """Result of `check --json` for a file that cannot be read.

    Attributes:
        file: Name of the file.
        error: Why it cannot be read.
    """

    file: str
    error: str


_URGENT, _FACTS = 8, 8
"""Findings and facts of the short form, which with the possible uses fits a terminal of 24
lines."""
_AT_LENGTH = ("motors", "holds", "rows", "site")
"""Facts omitted from the short form: lists, and details."""


class CheckReport(Record, DisplayMixin, frozen=True, kw_only=False):
    """Result of `check` for one file.

    Attributes:
        file: Name of the file.
        facts: What it holds, by name; of a flight the kind of aircraft, hover, split of the motors
            and voltage first, with `--vehicle` the hover of both.
        problems: Errors: exit code 1.
        warnings: Likely errors, and missing data: exit code 1.
        questions: Unusual values of a vehicle file, which may be right.
        notes: What was done or assumed while reading.
        good_for: Commands that can use the file.
        observable: Effects that `explain` can look for in a flight, by component.
        not_observable: Effects that it cannot, and what is missing.
        hover: Hover of the flight; null: it does not hover.
    """

    file: str
    facts: dict[str, str]
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    questions: tuple[Question, ...] = ()
    notes: tuple[str, ...] = ()
    good_for: tuple[str, ...] = ()
    observable: tuple[str, ...] = ()
    not_observable: tuple[str, ...] = ()
    hover: FlightHover | None = None

    __repr__ = DisplayMixin.__repr__

    @property
    def verdict(self) -> str:
        """The verdict in one word: `problems`, `warnings` or `fine`."""
        return "problems" if self.problems else "warnings" if self.warnings else "fine"

    @property
    def reason(self) -> str:
        """The first line with the reason for the verdict."""
        first = (*self.problems, *self.warnings)[:1]
        uses = f"good for {', '.join(self.good_for)}" if self.good_for else "nothing wrong with it"
        return first[0] if first else uses

    def claim(self) -> str:
        """The verdict in one line."""
        counts = [
            counted(texts, word)
            for texts, word in ((self.problems, "problem"), (self.warnings, "warning"))
            if texts
        ]
        uses = dict.fromkeys(re.split(r"[:,]| at ", use)[0] for use in self.good_for)
        good = f"; good for {', '.join(uses)}" if uses else ""
        return f"{self.file}: {', '.join(counts) or 'fine'}{good}"

    def short_lines(self) -> list[tuple[str, str]]:
        """The most important lines, on one screen, in the order of `lines`."""
        every = self.lines()
        urgent = [line for line in every if line[0] in ("problem", "warning", "question")]
        facts = [
            line for line in every if line[0] == "fact" and line[1].split()[0] not in _AT_LENGTH
        ]
        first = [*urgent[:_URGENT], *facts[:_FACTS]]
        return [
            *[line for line in every if line in first],
            *[line for line in every if line[0] == "good for"],
        ]

    def lines(self) -> list[tuple[str, str]]:
        """All lines of the text form: kind and text."""
        return [("fact", f"{name:16s} {value}") for name, value in self.facts.items()] + [
            (kind, f"{kind}: {text}")
            for kind, texts in (
                ("problem", self.problems),
                ("warning", self.warnings),
                ("question", [str(q) for q in self.questions]),
                ("note", self.notes),
                ("good for", self.good_for),
                ("explain can look for", self.observable),
                ("explain cannot look for", self.not_observable),
            )
            for text in texts
        ]

    def sections(self) -> Iterable[str | TextTable]:
        """The verdict, then the lines."""
        yield self.claim()
        yield "\n".join(text for _, text in self.lines())

    def brief(self) -> str:
        """Name of the file, and number of problems."""
        return f"{type(self).__name__}: {self.file}, {counted(self.problems, 'problem')}"


def check_file(
    path: str | Path, vehicle: Vehicle | None = None, key: str | Path | None = None
) -> CheckReport:
    """Check one file of any kind.

    Args:
        path: The file, or the folder of a ROS 2 bag.
        vehicle: Vehicle whose hover is compared with that of a flight.
        key: Public key of minisign for its detached signature, `FILE.minisig`.

    Raises:
        TwinError: It is of no known kind, the flight cannot be compared with the vehicle, or the
            key is invalid.
    """
    found = _checked(path, vehicle)
    facts, problems = _signature(Path(path), None if key is None else Path(key))
    return replace(found, facts={**facts, **found.facts}, problems=(*problems, *found.problems))


SIGNATURE = ".minisig"
"""Extension of a detached signature, https://jedisct1.github.io/minisign."""
_MOST_BYTES = 10_000  # of a signature or key, which have 400


def _signature(path: Path, key: Path | None) -> tuple[dict[str, str], tuple[str, ...]]:
    """Fact and problem of the signature of a file."""
    place = path.with_name(path.name + SIGNATURE)
    if key is None:
        return (
            ({"signature": "there, not verified: give --key"}, ()) if place.is_file() else ({}, ())
        )
    try:
        import minisign
    except ImportError:
        raise TwinError("--key needs py-minisign: pip install 'uavtwin[sign]'.") from None
    try:
        public = minisign.PublicKey.from_bytes(_short(key))
    except (OSError, ValueError) as error:
        raise TwinError(f"{key}: no public key of minisign: {error}.") from None
    try:
        signature = minisign.Signature.from_bytes(_short(place))
        public.verify_file(path, signature)
    except OSError:
        return {}, (f"not signed: there is no {place.name}",)
    except ValueError as error:
        return {}, (f"{place.name} is no signature of this file by {key.name}: {error}",)
    return {"signature": f"by {key.name}, {signature.trusted_comment!r}"}, ()


def _short(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_MOST_BYTES)


def _checked(path: str | Path, vehicle: Vehicle | None) -> CheckReport:
    path = file_of_bag(Path(path))
    if path.is_dir():
        raise TwinError(f"{path}: is a folder; name the files in it.")
    if not path.is_file():
        raise TwinError(f"{path}: no such file.")
    with path.open("rb") as file:
        start = file.read(4)
    if path.suffix == ".ssp":
        return _check_system(path)
    is_zip = start[:2] == b"PK"
    if path.suffix == ".fmu" or (is_zip and is_archive_of(path, "modelDescription.xml")):
        return _check_fmu(path)
    if path.suffix == ".toml":
        return _check_vehicle(path)
    return _check_flight(path, vehicle)


def _check_fmu(path: Path) -> CheckReport:
    from fmus.inspect import inspect_fmu

    report = inspect_fmu(path)
    uses = []
    runs_here = report.facts["platforms"] != "none"
    for kind, option in (
        ("co-simulation", ""),
        ("model exchange", " --interface-type ModelExchange"),
    ):
        if runs_here and not report.problems and kind in report.facts["format"]:
            command = f"fmpy simulate {path.name}{option}"
            uses.append(f"{kind} on {report.facts['platforms']}: {command}")
    if uses and "reference results" in report.facts:
        uses.append(f"to be rerun against its reference results: uavtwin verify {path.name}")
    return CheckReport(path.name, report.facts, report.problems, good_for=tuple(uses))


def _check_system(path: Path) -> CheckReport:
    from cosim.ssp import inspect_ssp  # systems are imported only when needed

    report = inspect_ssp(path)
    uses = []
    if report.platforms and not report.problems:
        where = f"co-simulation on {', '.join(report.platforms)}"
        uses.append(f"{where}: uavtwin simulate {path.name}" if report.runs_here else where)
    return CheckReport(
        path.name, report.facts, report.problems, notes=report.notes, good_for=tuple(uses)
    )


def _check_vehicle(path: Path) -> CheckReport:
    vehicle = load_vehicle(path)
    facts = {"format": "vehicle file", "name": vehicle.name, "driven by": vehicle.drive}
    given = {k: s for k, s in vehicle.sources.items() if not s.startswith(DEFAULT)}
    facts["numbers"] = f"{len(given)} of {len(FIELDS)} keys given"
    notes, open_questions = tuple(_defaults(vehicle.sources)), questions(vehicle)
    facts["rotors"] = f"{vehicle.rotors.count}, arm {vehicle.arm_m:.4g} m"
    try:
        body = airframe(vehicle)
    except ModelError as error:
        problems = (*vehicle.doubts, str(error))
        return CheckReport(path.name, facts, problems, (), open_questions, notes)
    trim = [f"{v.start:.4g}" for v in body.inputs if v.name.startswith(("cmd_", "rotor_"))]
    facts["hovers at"] = f"{vehicle.drive} {', '.join(trim)}" + (
        " rad/s" if vehicle.drive == "rotor_speed" else ""
    )
    uses = "gap, explain, train, demo, simulate, export"
    return CheckReport(path.name, facts, vehicle.doubts, (), open_questions, notes, (uses,))


def _defaults(sources: Mapping[str, str]) -> Iterator[str]:
    """Defaults of keys that a vehicle file omits, a line for all keys with the same default."""
    keys: dict[str, list[str]] = {}
    for key, source in sources.items():
        if source.startswith(DEFAULT):
            keys.setdefault(source, []).append(key)
    for source, those in keys.items():
        yield f"{', '.join(those)}: {source}"


def _check_flight(path: Path, vehicle: Vehicle | None) -> CheckReport:
    columns = header(path)
    if is_recording(columns):
        parts = dict.fromkeys(c.partition(".")[0] for c in columns if "." in c)
        facts = {
            "format": "recording of uavtwin simulate, no flight table",
            "holds": f"{len(columns)} columns PART.VARIABLE of {', '.join(parts)}",
        }
        return CheckReport(path.name, facts, notes=(NO_TABLE,))
    return check_flight(open_flight(path), path.name, vehicle)


def check_flight(flight: AnyFlight, file: str, vehicle: Vehicle | None = None) -> CheckReport:
    """Check one flight that has been read.

    Args:
        flight: A flight from `open_flight`.
        file: Name of its file.
        vehicle: Vehicle whose hover is compared with that of the flight.

    Raises:
        LogError: The flight cannot be compared with the vehicle.
    """
    hover = hover_of(flight)
    comparison: dict[str, str] = {}
    diagnosis, contradicts = None, ""
    if vehicle is not None:
        contradicts = consistency(flight, vehicle).error
        if not contradicts:
            comparison, diagnosis = compare_hover(flight, hover, vehicle)
    facts = {
        **aircraft_facts(flight, hover),
        **comparison,
        "holds": ", ".join(c for c in flight.columns if c != "time" and flight.has(c)),
        "rows": f"{len(flight.time_s)}",
        "site": str(flight.site or "not known: taken for outdoors unless explain is given another"),
        **flight.facts,
    }

    def said(severity: str) -> tuple[str, ...]:
        """Findings of one severity, a line each."""
        return tuple(
            f"{f.where}: {f.message}" + (f" (n = {f.count})" if f.count > 1 else "")
            for f in flight.findings
            if f.severity == severity
        )

    observable = observable_effects(flight)
    uses, useless = _uses(flight, hover)
    return CheckReport(
        file,
        facts,
        (*said("error"), *([contradicts] if contradicts else ()), *useless),
        said("warning"),
        notes=(*said("info"), *_unfit(flight)),
        good_for=uses,
        observable=tuple(
            f"{component}: {', '.join(names)}" for component, names in observable.effects.items()
        ),
        not_observable=tuple(
            f"{', '.join(names)}: {why}" for why, names in observable.unknown.items()
        ),
        hover=None if hover is None else _hover_record(hover, diagnosis),
    )


def _uses(flight: AnyFlight, hover: Hover | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Commands that can use the flight, or the reason why none can."""
    if flight.airframe is not None and flight.airframe.no_multirotor:
        return (), (f"good for nothing here: no multirotor, {flight.airframe.no_multirotor}",)
    if not drives(flight):
        lacks = "neither commands cmd_1..n nor speeds rotor_1..n of all motors"
        return (), (f"good for nothing yet: {lacks}",)
    kinds, why = comparable(flight)
    uses = [f"gap, {k}" if k.startswith("teacher") else f"gap {k}" for k in kinds]
    if hover is not None:
        uses.append("vehicle draft")
    return tuple(uses), () if uses else (f"good for nothing yet: {why}",)


def _unfit(flight: AnyFlight) -> tuple[str, ...]:
    """Limitations of the flight, with the reason."""
    if not drives(flight):
        return ()
    missing, autopilot = _missing(flight), flight.autopilot
    unfit = [f"no gap at a short horizon: no {' and no '.join(missing)}"] if missing else []
    asked = [c for c in (QUAT, VEL, POS) if autopilot is not None and autopilot.setpoint(c)]
    if QUAT not in asked:
        axes = "yaw" if asked else "roll, pitch or yaw"
        unfit.append(
            f"no setpoint of {axes}: how the aircraft answers there, its lag and inertia, is told "
            f"by other flights of the same mission alone"
        )
    return tuple(unfit)


def _missing(flight: AnyFlight) -> list[str]:
    """Signals missing for the short horizon."""
    return [
        name
        for name, found in (
            ("q", flight.has(*QUAT)),
            ("vel or pos", flight.has(*VEL) or flight.has(*POS)),
        )
        if not found
    ]


_FLOWN_V = 1.0
"""Voltage above which a battery is connected, V."""
_LEAST_SPLIT = 1.5
"""Difference of two sides, in percent, from which it is reported."""


def aircraft_facts(flight: AnyFlight, hover: Hover | None) -> dict[str, str]:
    """Kind of aircraft, command in hover, split between the motors, voltage.

    Args:
        flight: The flight.
        hover: Hover of the flight; None: it does not hover.
    """
    facts = {"kind": _kind(flight)}
    if hover is not None:
        facts["hover"] = f"{_level(hover)} ({hover.where})"
        facts["motors"] = _split(hover, flight.airframe.layout if flight.airframe else None)
    elif drives(flight):
        facts["hover"] = "none: less than 2 s in the air"
    if flight.has("vbat_v"):
        facts["battery"] = _voltage(flight, hover)
    return facts


def _hover_record(hover: Hover, diagnosis: HoverDiagnosis | None) -> FlightHover:
    """A hover as numbers, and the diagnosis of a twin in it."""
    volts = hover.voltage_v
    return FlightHover(
        drive="command" if hover.cmd is not None else "rotor_speed",
        level=hover.level,
        each=tuple(hover.each),
        split=tuple(hover.split),
        seconds=hover.seconds,
        hovers=hover.hovers,
        voltage_v=None if volts is None else float(np.median(volts)),
        twin=None if diagnosis is None else hover_record(diagnosis),
    )


def compare_hover(
    flight: AnyFlight, hover: Hover | None, vehicle: Vehicle
) -> tuple[dict[str, str], HoverDiagnosis | None]:
    """The hover of a flight compared with that of a vehicle, and the diagnosis of its twin.

    Raises:
        LogError: The flight cannot be compared with the vehicle.
    """
    if hover is None:
        return {f"hover of {vehicle.name}": "nothing to compare: the flight has none"}, None
    if hover.motors != vehicle.rotors.count:
        raise LogError(
            f"{flight.name}: {hover.motors} rotors; {vehicle.name} has {vehicle.rotors.count}."
        )
    facts = {}
    driven = "command" if hover.cmd is not None else "rotor_speed"
    if vehicle.drive == driven:
        own, level = hover_drive(vehicle), hover.level
        facts[f"hover of {vehicle.name}"] = (
            f"{own:.3g} for its {vehicle.mass_kg:.4g} kg; the flight {level:.3g}"
        )
    diagnosis = diagnosis_of(flight, vehicle, hover)
    if diagnosis is not None:
        facts["side by side"] = hover_sentence(vehicle.name, diagnosis)
    return facts, diagnosis


def _kind(flight: AnyFlight) -> str:
    """Kind of aircraft, and its source."""
    reported, motors = flight.airframe, len(drives(flight))
    if reported is not None and reported.no_multirotor:
        return f"this is no multirotor: {reported.no_multirotor}"
    if reported is None:
        return f"{motors} rotors, by the columns" if motors else "not known"
    if reported.rotors is None:
        return f"{motors} rotors, by the outputs" if motors else "not known"
    kind = f"multirotor with {reported.rotors.value} rotors ({reported.rotors.source})"
    return kind if reported.layout is None else f"{kind}; {reported.layout.source}"


def _level(hover: Hover) -> str:
    """Median of the mean of the motors."""
    if hover.cmd is not None:
        return f"command {hover.level:.3f}"
    return f"rotor speed {hover.level:.4g} rad/s"


def _split(hover: Hover, layout: Layout | None) -> str:
    """Output of each motor over their mean, and of pairs over the others."""
    each = np.array(hover.split)
    shares = (f"{k} {round(100 * u):+d} %" for k, u in enumerate(each, start=1))
    text = f"motor {', '.join(shares)} from their mean"
    if layout is None or layout.count != len(each):
        return text
    x, y = layout.position[:, 0], layout.position[:, 1]
    for side, names in (
        (-x, ("rear", "front")),
        (y, ("right", "left")),
        (layout.direction, ("clockwise ones", "counter-clockwise ones")),
    ):
        more = 100 * float(each[side > 0].mean() - each[side < 0].mean())
        if abs(more) >= _LEAST_SPLIT:
            high, low = names if more > 0 else names[::-1]
            text += f"; {high} {abs(more):.0f} % above {low}"
    return text


def _voltage(flight: AnyFlight, hover: Hover | None) -> str:
    """Range of the logged voltage with a battery connected, and in hover."""
    volts = flight.signal(("vbat_v",))[1][:, 0]
    volts = volts[volts > _FLOWN_V]
    if not len(volts):
        return "none: never above 1 V"
    text = f"{volts.min():.2f} to {volts.max():.2f} V"
    if hover is not None and hover.voltage_v is not None:
        text += f", {np.median(hover.voltage_v):.2f} V in hover"
    cells = flight.airframe.cells if flight.airframe is not None else None
    return text if cells is None else f"{text}; {cells.value.count} cells ({cells.source})"
