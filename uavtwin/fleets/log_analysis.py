"""The analysis of one log, or of all logs of one aircraft, as a job of a worker process."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from twin.draft import Hover, hover_of
from twin.errors import NoLogError, TwinError
from twin.explain import explanation as inner
from twin.explain.estimates import estimates_of, listed_effects, nothing_probability, probability_of
from twin.explain.explanation import Explanation
from twin.explain.inference.fit import INTERVAL
from twin.logs import AnyFlight, Flight
from twin.logs.airframe import SourcedValue
from twin.logs.columns import GYRO, QUAT
from twin.logs.samples import interpolated
from twin.residuals.flight_gap import HoverDiagnosis
from twin.vehicle_file import parse_vehicle

from ..diagnosis import cause_in_words, why
from ..file_check import check_flight
from ..flights import open_alike, reported_aircraft
from ..gaps import gap
from ..jobs.process import JobLimits, ProcessWorker, Progress
from ..vehicles import Vehicle
from ..wording import misfit
from .dataset import MOTORS, NO_LOG, JobRows, Row

Verb = Literal["check", "why", "gap", "explain"]
VERBS: tuple[Verb, ...] = ("check", "why", "gap", "explain")
"""Verbs for each log, in this order."""
OF_VEHICLE = frozenset({"gap", "explain"})
"""Verbs that need a vehicle file."""


@dataclass(frozen=True, slots=True)
class LogJob:
    """A job: one log, or all logs of one aircraft.

    Attributes:
        job: Number of the job.
        paths: Paths of the logs.
        names: Names of the logs.
        bytes: Total size of the logs.
        aircraft: Aircraft of the logs; "": the job is one log, of any aircraft.
    """

    job: int
    paths: tuple[str, ...]
    names: tuple[str, ...]
    bytes: int
    aircraft: str = ""


@dataclass(frozen=True, slots=True)
class LogAnalysis:
    """Job definition of each log and its cache key: the task of `uavtwin.jobs`.

    Attributes:
        key: Hash of all inputs of the rows.
        vehicle: Text of the vehicle file of all; "": each aircraft has its own.
        own: Texts of vehicle files by the stem of their aircraft's file name.
        file: Name of the file or folder, for messages.
        verbs: Verbs to run.
        alone: Whether each flight is explained separately.
        indoors: Whether all flights were indoors; None: by each log.
        allowed: Limits of a job.
        trust_vehicle: Whether contradictions between log and vehicle file are ignored, as in
            `uavtwin.flights.read_flights`.
    """

    key: str
    vehicle: str
    own: Mapping[str, str]
    file: str
    verbs: tuple[Verb, ...] = VERBS
    alone: bool = True
    indoors: bool | None = None
    allowed: JobLimits = field(default_factory=JobLimits)
    trust_vehicle: bool = False

    def name(self, job: LogJob) -> str:
        """Number of the job as text."""
        return str(job.job)

    def worker(self) -> ProcessWorker[LogJob, JobRows]:
        """Another worker process."""
        return ProcessWorker(self, JobRows.read, self.lost, self.allowed)

    def packed(self) -> "LogAnalysis":
        """The task unchanged: logs remain in place."""
        return self

    def unpacked(self, folder: Path) -> "LogAnalysis":
        """The task unchanged; it has no files of its own."""
        return self

    def lost(self, job: LogJob, why: str) -> JobRows:
        """Rows of a job that ended its process."""
        found = JobRows(job.job)
        if job.aircraft:
            _say(found, "", job.aircraft, "explain", "problem", why)
        else:
            found.add("flights", log=job.names[0], bytes=job.bytes, status="failed", error=why)
        return found

    def do(self, job: LogJob, progress: Progress = lambda _: None) -> dict[str, Any]:
        """Results as a line of the journal."""
        return self.analyse(job).json()

    def analyse(self, job: LogJob) -> JobRows:
        """Rows of the job; an error is one of them."""
        if job.aircraft:
            return self._aircraft(job)
        found = JobRows(job.job)
        about = found.add("flights", log=job.names[0], bytes=job.bytes, status="fine")
        try:
            (flight,) = open_alike([Path(job.paths[0])], trust_vehicle=self.trust_vehicle)
        except TwinError as error:
            status = NO_LOG if isinstance(error, NoLogError) else "unreadable"
            about |= {"status": status, "error": str(error)}
            return found
        except Exception as error:  # an unreadable log does not affect others
            about |= {"status": "failed", "error": _mistake(error)}
            return found
        try:
            self._flight(flight, about, found)
        except Exception as error:
            about |= {"status": "failed", "error": _mistake(error)}
        return found

    def _flight(self, flight: AnyFlight, about: Row, found: JobRows) -> None:
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
        vehicle: Vehicle | None = None
        if OF_VEHICLE & set(self.verbs):
            try:
                vehicle = self._vehicle(aircraft)
                about["vehicle"] = vehicle.name
            except TwinError as error:
                refused.append(str(error))
        hover = None
        for verb in self.verbs:
            try:
                if verb == "check":
                    _check(flight, about, found)
                elif verb == "why":
                    _why(flight, about, found)
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
        elif about.get("problems"):
            about["status"] = "findings"

    def _aircraft(self, job: LogJob) -> JobRows:
        """Rows of an aircraft with all of its flights."""
        found = JobRows(job.job)
        try:
            flights = open_alike([Path(p) for p in job.paths], trust_vehicle=self.trust_vehicle)
            _explain(flights, self._vehicle(job.aircraft), self.indoors, "", found, job.aircraft)
        except TwinError as error:
            _say(found, "", job.aircraft, "explain", "problem", str(error))
        except Exception as error:  # an error with one aircraft does not affect others
            _say(found, "", job.aircraft, "explain", "problem", _mistake(error))
        return found

    def _vehicle(self, aircraft: str) -> Vehicle:
        """The vehicle for the comparison with an aircraft.

        Raises:
            TwinError: The aircraft has none.
        """
        if self.vehicle:
            return Vehicle.of(parse_vehicle(self.vehicle, self.file), self.vehicle)
        if not aircraft:
            raise TwinError("the log does not name its aircraft: which vehicle file is not known")
        stem = file_stem(aircraft)
        if stem not in self.own:
            raise TwinError(f"{self.file} has no {stem}.toml for aircraft {aircraft}")
        return Vehicle.of(parse_vehicle(self.own[stem], f"{stem}.toml"), self.own[stem])


def _check(flight: AnyFlight, about: Row, found: JobRows) -> None:
    report = check_flight(flight, about["log"])
    for severity, texts in (
        ("problem", report.problems),
        ("warning", report.warnings),
        ("note", report.notes),
    ):
        for text in texts:
            _say(found, about["log"], about["aircraft"], "check", severity, text)
    about |= {"problems": len(report.problems), "warnings": len(report.warnings)}


def _why(flight: AnyFlight, about: Row, found: JobRows) -> None:
    """Add the diagnosis from the log alone."""
    record = why(flight if isinstance(flight, Flight) else str(flight.source)).record
    causes = [cause_in_words(e) for e in record.events if not e.consequence]
    about |= {"why": record.verdict, "causes": "; ".join(dict.fromkeys(causes))}
    _say(found, about["log"], about["aircraft"], "why", "note", record.text)


def _gap(flight: AnyFlight, vehicle: Vehicle, about: Row, found: JobRows) -> Any:
    """Add rows of channels; returns the hover diagnosis of the twin."""
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
    found: JobRows,
    aircraft: str | None = None,
) -> Row:
    """Add rows of effects; returns the verdict. Without closed-loop flights and search for
    manoeuvres."""
    explained = inner.explain(flights, [], vehicle, missions=(), indoors=indoors, suggest=False)
    aircraft = aircraft_name(flights[0]) if aircraft is None else aircraft
    for text in explained.reasons:
        _say(found, log, aircraft, "explain", "problem", text)
    for text in explained.warnings:
        _say(found, log, aircraft, "explain", "warning", text)
    listed = listed_effects(explained)
    for effect in listed:
        _effect(explained, effect, log, aircraft, found)
    if not any(estimates_of(explained, e) for e in listed):
        found.add("effects", log=log, aircraft=aircraft, verdict=explained.verdict)
    nothing = nothing_probability(explained)
    return {
        "verdict": explained.verdict,
        "nothing_probability": nothing,
        "named": ", ".join(listed),
    }


def _effect(explained: Explanation, effect: str, log: str, aircraft: str, found: JobRows) -> None:
    for e in estimates_of(explained, effect):
        low, high = e.ci95 or (None, None)
        found.add(
            "effects",
            log=log,
            aircraft=aircraft,
            verdict=explained.verdict,
            effect=effect,
            probability=probability_of(explained, effect),
            number=e.number.name,
            value=e.value,
            sd=None if low is None or high is None else (high - low) / 2 / INTERVAL,
            low=low,
            high=high,
            unit=e.number.about.unit,
            prior_share=e.prior_share,
        )


def _say(found: JobRows, log: str, aircraft: str, verb: str, severity: str, text: str) -> None:
    found.add("findings", log=log, aircraft=aircraft, verb=verb, severity=severity, text=text)


def _mistake(error: Exception) -> str:
    """Text on an internal error, or on an exceeded limit."""
    if isinstance(error, MemoryError):
        return "needs more memory than its process may use (--memory-limit)"
    said = " ".join(str(error).split())[:300]
    return f"{type(error).__name__}: {said} This is a mistake of uavtwin; please report it."


def aircraft_name(flight: AnyFlight) -> str:
    """Name of the aircraft: the identifier of its autopilot and its airframe, by which several
    flights of one call are checked to be of one aircraft; "" where the log has no identifier.
    """
    aircraft, airframe, hardware = reported_aircraft(flight)
    own = aircraft or hardware
    return ", ".join(t for t in (own.removeprefix("autopilot "), airframe) if t) if own else ""


def file_stem(aircraft: str) -> str:
    """Stem of an aircraft's file name: only letters, digits, `_`, `-` and `.`, no leading `.`."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", aircraft).strip("._") or "aircraft"


def date_of(flight: AnyFlight) -> float | None:
    """Decimal year of a flight; None: its log has no date."""
    place = None if flight.airframe is None else flight.airframe.place
    return place.value.year if isinstance(place, SourcedValue) else None


Array = NDArray[np.float64]
LEAST_S = 5.0
"""Shortest flight from which a battery resistance or a gyroscope bias is estimated, s; made up."""
LEAST_A = 0.02
"""Least relative variation of a current."""
LEAST_V = 1.0
"""Voltage below which no battery is connected."""
WINDOW_S = 0.5
"""Windows over which the attitude rotates, for the bias of the gyroscope: attitude noise of 1 mrad
is 3 mrad/s in one window, and small in the median of all."""


def vitals_of(
    flight: AnyFlight, hover: Hover | None, diagnosis: HoverDiagnosis | None
) -> dict[str, float | None]:
    """Vital numbers that can be estimated, by the names of their columns.

    Args:
        flight: Flight as read.
        hover: Hover of the flight; None: it has none.
        diagnosis: Diagnosis of the twin in hover; None: none.
    """
    vitals: dict[str, float | None] = {"battery_resistance_ohm": battery_resistance(flight)}
    bias = gyro_bias(flight)
    if bias is not None:
        vitals |= {f"gyro_bias_{a}_rad_s": float(b) for a, b in zip("xyz", bias, strict=True)}
    if diagnosis is not None:
        back, right = diagnosis.back_m, diagnosis.right_m
        vitals |= {
            "carried": diagnosis.carried.value,
            "back_m": None if back is None else back.value,
            "right_m": None if right is None else right.value,
        }
    return vitals | ({} if hover is None else _of_hover(hover))


def _of_hover(hover: Hover) -> dict[str, float | None]:
    vitals: dict[str, float | None] = {}
    if hover.cmd is not None:
        vitals["hover_command"] = hover.level
    if hover.rotor_rad_s is not None:
        vitals["hover_speed_rad_s"] = float(np.median(hover.rotor_rad_s.mean(axis=1)))
    if hover.voltage_v is not None:
        vitals["hover_voltage_v"] = float(np.median(hover.voltage_v))
    return vitals | {f"motor_{i}": s for i, s in enumerate(hover.split[:MOTORS], start=1)}


def battery_resistance(flight: AnyFlight) -> float | None:
    """Resistance of a battery, ohm: least squares of V = a + b t - R I over a flight.

    It includes the drop of the voltage within seconds of a change of the current, in addition to
    the instantaneous resistance; the slow effect of the charge is in b.

    Returns:
        None: voltage or current are not logged, or the current does not vary.

    Valid for: one flight on one battery.
    """
    if not flight.has("vbat_v", "ibat_a"):
        return None
    t_v, volts = (x.ravel() for x in flight.signal(("vbat_v",)))
    t_i, amps = (x.ravel() for x in flight.signal(("ibat_a",)))
    inside = (t_v >= t_i[0]) & (t_v <= t_i[-1]) & (volts > LEAST_V)
    t, v = t_v[inside], volts[inside]
    if len(t) < 20 or t[-1] - t[0] < LEAST_S:
        return None
    i = np.interp(t, t_i, amps)
    flying = i > 0.3 * np.percentile(i, 90)
    t, v, i = t[flying], v[flying], i[flying]
    if len(t) < 20 or np.std(i) < LEAST_A * abs(np.mean(i)):
        return None
    a = np.column_stack([np.ones_like(t), t - t.mean(), -i])
    return float(np.linalg.lstsq(a, v, rcond=None)[0][2])


def gyro_bias(flight: AnyFlight) -> Array | None:
    """Bias of a gyroscope, rad/s, body FRD, shape (3,): median over windows of half a second of its
    mean minus the rotation rate of the attitude.

    Rotation about a moving axis is included to second order: the angle of a window is a + 1/2 int
    (a(t) x da), with a the integral of the rates from its start.

    Source: Bortz, IEEE Trans. Aerosp. Electron. Syst. 7 (1971) 61-66.

    Returns:
        None: no attitude, no gyroscope, or too short.
    """
    if not flight.has(*GYRO, *QUAT):
        return None
    t_w, omega = flight.signal(GYRO)
    t_q, q = flight.signal(QUAT)
    edges = np.arange(max(t_q[0], t_w[0]), min(t_q[-1], t_w[-1]), WINDOW_S)
    if len(edges) * WINDOW_S < LEAST_S:
        return None
    at = np.unique(np.clip(np.searchsorted(t_q, edges), 0, len(t_q) - 1))
    t = t_q[at]
    turned = Rotation.from_quat(q[at], scalar_first=True)
    rate = (turned[:-1].inv() * turned[1:]).as_rotvec() / np.diff(t)[:, None]
    angle = cumulative_trapezoid(omega, t_w, axis=0, initial=0)
    twist = np.cross(0.5 * (angle[1:] + angle[:-1]), np.diff(angle, axis=0))
    twist = np.vstack([np.zeros(3), np.cumsum(twist, axis=0)])
    a, c = (interpolated(t, t_w, x) for x in (angle, twist))
    da = np.diff(a, axis=0)
    mean = (da + 0.5 * (np.diff(c, axis=0) - np.cross(a[:-1], da))) / np.diff(t)[:, None]
    whole = np.diff(t) < 2 * WINDOW_S
    return np.asarray(np.median((mean - rate)[whole], axis=0)) if whole.sum() >= 10 else None
