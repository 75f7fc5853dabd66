"""Events of a flight as the Diagnostic records of PX4's flight-review.

A list of objects with id, summary, severity, timestamp_us, end_timestamp_us and evidence, as
declared in `crates/converter/src/diagnostics/mod.rs` of PX4/flight-review-rs (commit f87cffba).
Evidence is tagged by `type`. A failed rotor has a type there, `MotorFailure`; other events have the
type `Event` with cause, rotors, sensor, size and probability: a reader of that project needs that
variant, as for each of its new analysers.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.why.records import Event, Severity

from .diagnosis import WhyResult
from .output import json_text, output_file

_CLOCK = re.compile(r"t = 0 is (\d+\.\d+) s after boot")
"""Fact of a flight with the offset between its time and the clock of the autopilot."""
CRITICAL, WARNING, INFO = "critical", "warning", "info"
"""Severities: followed by a loss of control; a cause; a consequence."""


def write_diagnostics(found: WhyResult, path: Path) -> None:
    """Write the events that have an instant; an existing file is replaced."""
    with output_file(path) as file:
        file.write_text(json_text(diagnostics(found)), encoding="utf-8")


def diagnostics(found: WhyResult) -> list[dict[str, Any]]:
    """Diagnostic records, causes and consequences, in order of time."""
    boot_s = _boot_s(found.recorded)
    lost = found.record.loss_of_control_s
    return [
        {
            "id": _identifier(event),
            "summary": event.text or event.cause.replace("_", " "),
            "severity": _severity(event, lost),
            "timestamp_us": round(1e6 * (boot_s + event.onset_s)),
            "end_timestamp_us": _end_us(event, boot_s),
            "evidence": _evidence(event, found.recorded),
        }
        for event in found.record.events
        if event.onset_s is not None
    ]


def _boot_s(flight: Flight | None) -> float:
    """Time of the start of the log on the autopilot's clock; 0: not in the log."""
    match = _CLOCK.search(flight.facts.get("clock", "")) if flight is not None else None
    return float(match[1]) if match else 0.0


def _identifier(event: Event) -> str:
    return "motor_failure" if event.cause == "rotor_failure" else event.cause


def _severity(event: Event, lost_s: float | None) -> str:
    if event.consequence:
        return INFO
    leads = lost_s is not None and event.onset_s is not None and event.onset_s <= lost_s
    return CRITICAL if leads else WARNING


def _end_us(event: Event, boot_s: float) -> int | None:
    """End of an event with a duration."""
    if event.severity is None or event.severity.quantity != "duration" or event.onset_s is None:
        return None
    return round(1e6 * (boot_s + event.onset_s + event.severity.value))


def _evidence(event: Event, flight: Flight | None) -> dict[str, Any]:
    """Typed evidence: `MotorFailure` where there is one rotor, else `Event`."""
    if event.cause == "rotor_failure" and event.rotor and len(event.rotor) == 1:
        command, mode = _at_onset(event, flight)
        return {
            "type": "MotorFailure",
            "motor_index": event.rotor[0] - 1,
            "pwm_value": None if command is None else 1000.0 + 1000.0 * command,
            "failure_mode": "thrust_lost",
            "flight_mode": mode,
        }
    return {
        "type": "Event",
        "cause": event.cause,
        "rotors": list(event.rotor or ()),
        "sensor": event.sensor,
        "probability": event.probability,
        "size": _size(event.severity),
    }


def _size(severity: Severity | None) -> dict[str, Any] | None:
    if severity is None:
        return None
    names = ("quantity", "value", "low", "high", "unit")
    return {name: getattr(severity, name) for name in names}


def _at_onset(event: Event, flight: Flight | None) -> tuple[float | None, str]:
    """Command of the rotor and flight mode at the onset, as far as they are logged."""
    if flight is None or event.rotor is None or event.onset_s is None:
        return None, "unknown"
    said = flight.autopilot
    modes = [m.name for m in said.modes if m.start_s <= event.onset_s] if said is not None else []
    column = motor_columns("cmd", event.rotor[0])[-1]
    command = None
    if flight.has(column):
        t, value = flight.signal((column,))
        command = float(np.interp(event.onset_s, t, value[:, 0]))
    return command, modes[-1] if modes else "unknown"
