"""What is done with each log, or with all logs of an aircraft, in a process of its own."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from twin.draft import hover_of
from twin.errors import TwinError
from twin.explain import explanation as inner
from twin.explain.estimates import estimates_of, listed_effects, nothing_probability, probability_of
from twin.explain.explanation import Explanation
from twin.explain.inference.fit import INTERVAL
from twin.logs import AnyFlight
from twin.vehicle.file import parse_vehicle

from ..file_check import check_flight
from ..flights import open_alike
from ..gaps import gap
from ..jobs.process import Allowed, ProcessWorker
from ..vehicles import Vehicle
from .aircraft import aircraft_name, date_of, file_stem
from .columns import row
from .vitals import misfit, vitals_of

Verb = Literal["check", "gap", "explain"]
VERBS: tuple[Verb, ...] = ("check", "gap", "explain")
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Look:
    """A job: one log, or all logs of one aircraft.

    Attributes:
        job: Its number.
        paths: Of the logs.
        names: Of the logs.
        bytes: Of the logs together.
        aircraft: Whose logs they are; "": it is one log, whatever it is of.
    """

    job: int
    paths: tuple[str, ...]
    names: tuple[str, ...]
    bytes: int
    aircraft: str = ""


@dataclass
class Found:
    """What came of a job, as rows of the tables.

    Attributes:
        job: Its number.
        rows: Of the tables.
    """

    job: int
    rows: dict[str, list[Row]] = field(default_factory=dict)

    def add(self, table: str, **values: Any) -> Row:
        """One more row, which may still be changed."""
        made = row(table, values)
        self.rows.setdefault(table, []).append(made)
        return made

    def json(self) -> dict[str, Any]:
        """On a line of the journal; numbers that are none are left out."""
        tables = {
            table: [{k: v for k, raw in r.items() if (v := _strict(raw)) is not None} for r in rows]
            for table, rows in self.rows.items()
        }
        return {"job": self.job, **tables}

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> "Found":
        """Of `json`."""
        return cls(content["job"], {k: v for k, v in content.items() if k != "job"})


@dataclass(frozen=True, slots=True)
class Looking:
    """The same for all logs, for `uavtwin.jobs`.

    Attributes:
        key: Hash of all that decides what is found.
        vehicle: Text of the vehicle file of all; "": each aircraft has its own.
        own: Texts by the stem of the name of the file of an aircraft.
        file: Name of the file or folder, for messages.
        verbs: What is done.
        alone: Whether each flight is explained by itself.
        indoors: Whether all flew within walls; None: as each log says.
        allowed: What a job may use.
        trust_vehicle: As of `uavtwin.flights.read_flights`.
    """

    key: str
    vehicle: str
    own: Mapping[str, str]
    file: str
    verbs: tuple[Verb, ...] = VERBS
    alone: bool = True
    indoors: bool | None = None
    allowed: Allowed = field(default_factory=Allowed)
    trust_vehicle: bool = False

    def name(self, look: Look) -> str:
        """Number of the job."""
        return str(look.job)

    def worker(self) -> ProcessWorker[Look, Found]:
        """One more that looks at logs."""
        return ProcessWorker(self, Found.read, self.lost, self.allowed)

    def packed(self) -> "Looking":
        """It travels as it is: logs stay where they are."""
        return self

    def unpacked(self, folder: Path) -> "Looking":
        """The same; it has no files of its own."""
        return self

    def lost(self, look: Look, why: str) -> Found:
        """Of a job that ended its process."""
        found = Found(look.job)
        if look.aircraft:
            _say(found, "", look.aircraft, "explain", "problem", why)
        else:
            found.add("flights", log=look.names[0], bytes=look.bytes, status="failed", error=why)
        return found

    def do(self, look: Look) -> dict[str, Any]:
        """What is found, as a line of the journal."""
        return self.look(look).json()

    def look(self, look: Look) -> Found:
        """All that is asked for; an error is a part of it."""
        if look.aircraft:
            return self._aircraft(look)
        found = Found(look.job)
        about = found.add("flights", log=look.names[0], bytes=look.bytes, status="fine")
        try:
            (flight,) = open_alike([Path(look.paths[0])], trust_vehicle=self.trust_vehicle)
        except TwinError as error:
            about |= {"status": "unreadable", "error": str(error)}
            return found
        except Exception as error:  # one that cannot be read hides none of the others
            about |= {"status": "failed", "error": _mistake(error)}
            return found
        try:
            self._flight(flight, about, found)
        except Exception as error:
            about |= {"status": "failed", "error": _mistake(error)}
        return found

    def _flight(self, flight: AnyFlight, about: Row, found: Found) -> None:
        """Rows of a flight."""
        aircraft, time_s = aircraft_name(flight), flight.time_s
        about |= {
            "format": flight.facts.get("format"),
            "aircraft": aircraft,
            "airframe": flight.facts.get("airframe"),
            "hardware": flight.facts.get("hardware"),
            "date_year": date_of(flight),
            "duration_s": float(time_s[-1] - time_s[0]),
            "rows": len(time_s),
            "fingerprint": flight.fingerprint,
        }
        refused: list[str] = []
        try:
            vehicle: Vehicle | None = self._vehicle(aircraft)
            assert vehicle is not None
            about["vehicle"] = vehicle.name
        except TwinError as error:
            vehicle = None
            refused.append(str(error))
        hover = None
        for verb in self.verbs:
            try:
                if verb == "check":
                    _check(flight, about, found)
                elif vehicle is None:
                    continue
                elif verb == "gap":
                    hover = _gap(flight, vehicle, about, found)
                elif self.alone:
                    about |= _explain([flight], vehicle, self.indoors, about["log"], found)
            except TwinError as error:
                refused.append(f"{verb}: {error}")
                _say(found, about["log"], aircraft, verb, "problem", str(error))
        about |= vitals_of(flight, hover_of(flight), hover)
        if text := misfit(about.get("carried"), about.get("vehicle") or ""):
            _say(found, about["log"], aircraft, "gap", "warning", text)
        if refused:
            about |= {"status": "refused", "error": "; ".join(refused)}
        elif about["problems"]:
            about["status"] = "findings"

    def _aircraft(self, look: Look) -> Found:
        """Rows of an aircraft with all of its flights."""
        found = Found(look.job)
        try:
            flights = open_alike([Path(p) for p in look.paths], trust_vehicle=self.trust_vehicle)
            _explain(flights, self._vehicle(look.aircraft), self.indoors, "", found, look.aircraft)
        except TwinError as error:
            _say(found, "", look.aircraft, "explain", "problem", str(error))
        except Exception as error:  # a mistake with one aircraft hides none of the others
            _say(found, "", look.aircraft, "explain", "problem", _mistake(error))
        return found

    def _vehicle(self, aircraft: str) -> Vehicle:
        """The vehicle that an aircraft is compared with.

        Raises:
            TwinError: There is none for it.
        """
        if self.vehicle:
            return Vehicle.of(parse_vehicle(self.vehicle, self.file), self.vehicle)
        if not aircraft:
            raise TwinError("the log does not name its aircraft: which vehicle file is not known")
        stem = file_stem(aircraft)
        if stem not in self.own:
            raise TwinError(f"{self.file} has no {stem}.toml for aircraft {aircraft}")
        return Vehicle.of(parse_vehicle(self.own[stem], f"{stem}.toml"), self.own[stem])


def _check(flight: AnyFlight, about: Row, found: Found) -> None:
    report = check_flight(flight, about["log"])
    for severity, texts in (
        ("problem", report.problems),
        ("warning", report.warnings),
        ("note", report.notes),
    ):
        for text in texts:
            _say(found, about["log"], about["aircraft"], "check", severity, text)
    about |= {"problems": len(report.problems), "warnings": len(report.warnings)}


def _gap(flight: AnyFlight, vehicle: Vehicle, about: Row, found: Found) -> Any:
    """Rows of channels; what the hover says of the twin."""
    result = gap(flight, vehicle)
    for warning in result.flights[0].warnings:
        _say(found, about["log"], about["aircraft"], "gap", "warning", warning)
    for record in result.frame().to_dict("records"):
        values = {str(k): v for k, v in record.items()}
        found.add("channels", log=about["log"], aircraft=about["aircraft"], **values)
    return result.flights[0].hover


def _explain(
    flights: Sequence[AnyFlight],
    vehicle: Vehicle,
    indoors: bool | None,
    log: str,
    found: Found,
    aircraft: str | None = None,
) -> Row:
    """Rows of effects; the verdict. Nothing is flown in closed loop, no manoeuvre is looked for."""
    told = inner.explain(flights, [], vehicle, missions=(), indoors=indoors, suggest=False)
    aircraft = aircraft_name(flights[0]) if aircraft is None else aircraft
    for text in told.reasons:
        _say(found, log, aircraft, "explain", "problem", text)
    for text in told.warnings:
        _say(found, log, aircraft, "explain", "warning", text)
    listed = listed_effects(told)
    for effect in listed:
        _effect(told, effect, log, aircraft, found)
    if not any(estimates_of(told, e) for e in listed):
        found.add("effects", log=log, aircraft=aircraft, verdict=told.verdict)
    nothing = None if told.naming is None else nothing_probability(told.naming)
    return {
        "verdict": told.verdict,
        "nothing_probability": nothing,
        "named": ", ".join(listed),
    }


def _effect(told: Explanation, effect: str, log: str, aircraft: str, found: Found) -> None:
    for e in estimates_of(told, effect):
        low, high = e.ci95 or (None, None)
        found.add(
            "effects",
            log=log,
            aircraft=aircraft,
            verdict=told.verdict,
            effect=effect,
            probability=probability_of(told, effect),
            number=e.number.name,
            value=e.value,
            sd=None if low is None or high is None else (high - low) / 2 / INTERVAL,
            low=low,
            high=high,
            unit=e.number.about.unit,
            prior_share=e.prior_share,
        )


def _say(found: Found, log: str, aircraft: str, verb: str, severity: str, text: str) -> None:
    found.add("findings", log=log, aircraft=aircraft, verb=verb, severity=severity, text=text)


def _mistake(error: Exception) -> str:
    """What a mistake of ours says, or a limit that was met."""
    if isinstance(error, MemoryError):
        return "needs more memory than its process may use (--memory-limit)"
    said = " ".join(str(error).split())[:300]
    return f"{type(error).__name__}: {said} This is a mistake of uavtwin; please report it."


def _strict(value: Any) -> Any:
    """Null for a number that JSON cannot hold, plain types for those of numpy."""
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
