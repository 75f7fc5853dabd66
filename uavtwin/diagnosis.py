"""Diagnosis of a flight, as a result to print."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf, pi
from pathlib import Path
from typing import Any, ClassVar

from msgspec import structs

from twin.errors import TwinError
from twin.formatting import certainty, joined, pretty_unit
from twin.logs import Flight, read_flight
from twin.vehicle import Vehicle
from twin.why.causes import BLOW, ROTOR
from twin.why.diagnose import diagnose
from twin.why.disagreements import NOISE, SENSOR_CAUSES
from twin.why.records import Candidate, Diagnosis, Event, NotVisible

from .display import PageMixin, TextTable
from .flights import checked_flights
from .record import Record

LEAST_LISTED = 0.01
"""Probability from which on an alternative is listed; the record has all."""
LARGEST = {"1": 1.0, "rad": pi / 2, "m": 50.0}
"""Largest useful detection limit by unit: all of the thrust, the mass or the field, a quarter of a
turn, the largest error of a barometer."""
MOST_NOISE = 9.0
"""Largest useful detection limit of noise: ten times the usual."""


class WhyRecord(Record, Diagnosis, frozen=True, kw_only=True):
    """Diagnosis of a flight, as printed by `why --json`."""

    digits: ClassVar[int | None] = 6


class UnreadRecord(Record, frozen=True, kw_only=True):
    """An unreadable log among several, as printed by `why --json`.

    Attributes:
        flight: Name of the flight.
        error: Reason why it cannot be read, and the remedy.
    """

    flight: str
    error: str


@dataclass(frozen=True, slots=True, repr=False)
class WhyResult(PageMixin):
    """Diagnosis of a flight.

    Attributes:
        record: Every number of it.
        recorded: The flight, for the figures of the page; None: it has the record alone.
    """

    record: WhyRecord
    recorded: Flight | None = None

    page = "uavtwin.report.why"

    def brief(self) -> str:
        """Warnings, as in `DisplayMixin`."""
        return f"why {self.record.flight}: {self.record.text}"

    def findings(self) -> Iterable[str | TextTable]:
        """Findings, as in `DisplayMixin`."""
        yield self.record.text
        if self.record.events:
            yield TextTable(
                ("time", "what", "which", "how much", "probability", "or"),
                tuple(_row(e) for e in self.record.events),
            )
        checks = [e.bench_check for e in self.record.events if e.bench_check and not e.consequence]
        if checks:
            yield "To check: " + " ".join(dict.fromkeys(checks))
        if self.record.not_visible:
            yield _hidden(self.record)
        if self.record.notes:
            yield "\n".join(self.record.notes)
        if self.record.timeline:
            yield "\n".join(f"{i.t_s:8.2f} s  {i.text}" for i in self.record.timeline)


def why(flight: Any, references: Any = (), since: Vehicle | None = None) -> WhyResult:
    """Diagnose a flight, from its log alone.

    Args:
        flight: A flight, or the path of a log.
        references: Normal flights of the same aircraft, or the paths of their logs.
        since: Vehicle of an earlier time, whose calibration is the reference instead: sizes are in
            newtons and kilograms.

    Raises:
        TwinError: A log cannot be read, or is too short; or there are references and a vehicle.
    """
    if since is not None and len(references):
        raise TwinError("why: give normal flights, or since=VEHICLE, whose calibration holds them.")
    (asked,) = read_asked([flight])
    found = diagnose(asked, read_asked(references), since=since)
    return WhyResult(WhyRecord(**structs.asdict(found)), asked)


def why_table(records: Sequence[WhyRecord | UnreadRecord]) -> TextTable:
    """Table of several flights, a row each: the first cause, its time, and whether control was
    lost."""
    head = ("flight", "verdict", "first cause", "time", "probability", "control lost")
    return TextTable(head, tuple(map(_summary, records)))


def _summary(record: WhyRecord | UnreadRecord) -> tuple[str, ...]:
    """A flight in the table of several."""
    if isinstance(record, UnreadRecord):
        return record.flight, "not read", "", "", "", ""
    either = " or ".join(map(cause_in_words, record.one_of_causes))
    first = next((e for e in record.events if not e.consequence), None)
    cause, when = either, "all the time" if either else ""
    if first is not None and not either:
        cause = cause_in_words(first)
        when = "all the time" if first.onset_s is None else f"{first.onset_s:.2f} s"
    lost = record.loss_of_control_s
    decided = record.verdict != "cannot_tell"
    return (
        record.flight,
        _words(record.verdict),
        cause,
        when,
        certainty(record.probability if first is None else first.probability) if decided else "",
        "" if lost is None else f"{lost:.2f} s",
    )


def read_asked(given: Sequence[Any]) -> tuple[Flight, ...]:
    """Flights, or those of the logs at paths, checked for what `why` needs.

    Raises:
        TwinError: A log cannot be read.
    """
    flights = [read_flight(Path(f)) if isinstance(f, str | Path) else f for f in given]
    return checked_flights(flights, "why")


def _row(event: Event) -> tuple[str, ...]:
    """An event in the table."""
    when = "all the time" if event.onset_s is None else f"{event.onset_s:.2f} s"
    which = ", ".join(f"rotor {r}" for r in event.rotor or ()) or (event.sensor or "")
    others = ", ".join(
        f"{cause_in_words(c)} {certainty(c.probability)}" for c in listed_alternatives(event)
    )
    what = _words(event.cause) + (" (consequence)" if event.consequence else "")
    return when, what, which, size_in_words(event), certainty(event.probability), others


def size_in_words(event: Event) -> str:
    """Size with its interval."""
    if event.severity is None:
        return ""
    s = event.severity
    if s.unit == "1":
        low, value, high = (f"{100 * v:.0f}" for v in (s.low, s.value, s.high))
        return f"{_words(s.quantity)} {value} % ({low} to {high})"
    unit = pretty_unit(s.unit)
    return f"{_words(s.quantity)} {s.value:.3g} {unit} ({s.low:.3g} to {s.high:.3g})"


def cause_in_words(given: Event | Candidate | NotVisible) -> str:
    """A cause, with its rotors or its sensor."""
    rotors = getattr(given, "rotor", None) or ()
    which = " and ".join(map(str, rotors))
    sensor = getattr(given, "sensor", None) or ""
    named = f", rotor {which}" if rotors else f", {sensor}" if sensor else ""
    return _words(given.cause) + named


def listed_alternatives(event: Event) -> list[Candidate]:
    """Alternative causes with 1 % or more."""
    return [c for c in event.alternatives if c.probability >= LEAST_LISTED]


def least_in_words(hidden: NotVisible) -> str:
    """Smallest detectable sizes, without those beyond any aircraft."""
    least = hidden.smallest_detectable
    most = MOST_NOISE if hidden.cause == NOISE else LARGEST.get(least.unit, inf)
    if least.value is None or least.value > most:
        return "of any size"
    if least.unit == "1":
        of_what = " of a rotor's thrust" if hidden.cause == ROTOR else ""
        part = hidden.share
        where = "" if part is None else f", which shows in {100 * part:.0f} % of the flight alone"
        return f"below {100 * least.value:.0f} %{of_what}{where}"
    of_what = " of force over mass" if hidden.cause == BLOW else ""
    return f"below {least.value:.3g} {pretty_unit(least.unit)}{of_what}"


def of_the_body(hidden: NotVisible) -> bool:
    """Whether a cause is of rotors, mass and forces, and not of an instrument."""
    return hidden.cause not in SENSOR_CAUSES


def _hidden(found: Diagnosis) -> str:
    """Text on causes of the body that the log would not have shown, in one line."""
    by_size: dict[str, list[str]] = {}
    for hidden in filter(of_the_body, found.not_visible):
        by_size.setdefault(least_in_words(hidden), []).append(_words(hidden.cause))
    sizes = [f"{joined(causes, 'or')} {size}" for size, causes in by_size.items()]
    body = "Not visible: " + "; ".join(sizes) + ". " if sizes else ""
    return f"{body}What instruments would not have shown, and why: --json, --out."


def _words(name: str) -> str:
    return name.replace("_", " ")
