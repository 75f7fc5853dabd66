"""Phases, flight modes and failures that a DataFlash log tells."""

import numpy as np

from ..autopilot import as_text
from ..phases import Span, ground_spans, motion_spans
from .estimator import Primary
from .identity import OTHERS, firmware
from .log import ArduPilotLog, Topic

MODES = {
    **dict(
        enumerate(("Stabilize", "Acro", "AltHold", "Auto", "Guided", "Loiter", "RTL", "Circle"))
    ),
    **{9: "Land", 11: "Drift", 13: "Sport", 14: "Flip", 15: "AutoTune", 16: "PosHold"},
    **{17: "Brake", 18: "Throw", 19: "Avoid_ADSB", 20: "Guided_NoGPS", 21: "Smart_RTL"},
    **{22: "FlowHold", 23: "Follow", 24: "ZigZag", 25: "SystemID", 26: "Heli_Autorotate"},
    **{27: "Auto_RTL", 28: "Turtle"},
}
"""Flight modes of ArduCopter by number."""
SUBSYSTEMS = {
    **{2: "radio", 3: "compass", 5: "radio failsafe", 6: "battery failsafe", 8: "GCS failsafe"},
    **{9: "fence", 10: "flight mode", 11: "GPS", 12: "crash check", 15: "parachute"},
    **{16: "EKF check", 17: "EKF failsafe", 18: "barometer", 19: "CPU", 21: "terrain"},
    **{22: "navigation", 23: "terrain failsafe", 24: "EKF primary", 25: "thrust loss"},
    **{26: "sensor failsafe", 27: "leak failsafe", 29: "vibration failsafe"},
}
"""Subsystems of ERR by number."""
_NOT_LANDED, _LANDED = 28, 18
_SHOWN = 8
_MOST = 2.0**53


def from_ardupilot_phases(log: ArduPilotLog, used: Primary) -> list[Span]:
    """Phases from EV of the land detector, speed and climb rate."""
    ground = _ground(log)
    topic = log.topic(f"{used.family}F1", used.core) if used.family else None
    if topic is None or not topic.has("VN", "VE", "VD"):
        return ground
    spans = motion_spans(topic.t_s, topic.si(("VN", "VE", "VD")), ground)
    if spans:
        log.note("info", "phase", "from landed state, speed and climb rate")
    return spans


def _ground(log: ArduPilotLog) -> list[Span]:
    """Spans on the ground; before it is first left, too."""
    events = log.topic("EV", None, "Id")
    if events is None:
        return []
    kinds = events.raw("Id")
    told = np.isin(kinds, (_NOT_LANDED, _LANDED))
    if not told.any():
        return []
    t_s, landed = events.t_s[told], kinds[told] == _LANDED
    if not landed[0]:  # it stood until it left the ground
        t_s, landed = np.append(-np.inf, t_s), np.append(True, landed)
    return ground_spans(t_s, landed)


def modes(log: ArduPilotLog) -> str:
    """Flight modes with the times of their begin, "" where there are none."""
    topic = log.whole("MODE")
    if topic is None or not (names := mode_names(log, topic)):
        return ""
    told: list[str] = []
    in_time = np.flatnonzero(topic.t_s <= (log.length_us or np.inf) * 1e-6)
    before = np.flatnonzero(topic.t_s[in_time] <= 0.0)
    for k in in_time[max(len(before) - 1, 0) :]:
        told.append(f"{names[k]} from {max(topic.t_s[k], 0.0):.1f} s")
    more = f" and {len(told) - _SHOWN} more" if len(told) > _SHOWN else ""
    return ", ".join(told[:_SHOWN]) + more


def mode_names(log: ArduPilotLog, topic: Topic) -> list[str]:
    """Mode of each MODE by name: from ModeNum, up to Copter 3.1 from Mode (text logs: a name);
    [] where they have neither."""
    for column in ("ModeNum", "Mode"):
        if column in topic.source.data:
            values = topic.source.data[column][topic.rows].tolist()
            return [_named(log, value) for value in values]
    return []


def _named(log: ArduPilotLog, value: object) -> str:
    """Name of a mode that is a number, or already a name."""
    if isinstance(value, int | float):
        return mode_name(log, value)
    text = as_text(value.decode("utf-8", "replace") if isinstance(value, bytes) else value)
    return mode_name(log, float(text)) if text.isdecimal() and len(text) < 4 else text


def mode_name(log: ArduPilotLog, number: float) -> str:
    """Name of a flight mode; its number alone where the firmware is none of a copter."""
    known = {} if OTHERS.match(firmware(log)) else MODES
    whole = int(number) if np.isfinite(number) else -1
    return known.get(whole, f"mode {whole}")


def subsystem(number: float) -> str:
    """Name of a subsystem of ERR."""
    return SUBSYSTEMS.get(int(number), f"subsystem {number:.0f}")


def note_failures(log: ArduPilotLog) -> None:
    """Failsafes and errors, clipping, messages that were not logged, failed motors."""
    errors = log.topic("ERR", None, "Subsys", "ECode")
    if errors is not None:
        codes = errors.raw("ECode")
        for t, system, code in zip(errors.t_s, errors.raw("Subsys"), codes, strict=True):
            if np.isfinite((system, code)).all() and code:
                message = f"{subsystem(system)} error, code {code:.0f}, at {t:.2f} s"
                log.note("warning", "log", message)
    if lost := _grown(log, "DSF", None, "Dp"):
        message = "messages that could not be logged; use a faster card or log less"
        log.note("warning", "log", message, lost)
    for instance in log.instances("VIBE"):
        if clipped := _grown(log, "VIBE", instance, "Clip"):
            message = f"samples in which the accelerometer of IMU {instance} was at its limit"
            log.note("warning", "acc", message, clipped)
    motors = log.topic("MOTB", None)
    if motors is not None and motors.has("FailFlags"):
        flags = motors.raw("FailFlags")
        failed = np.isfinite(flags) & (flags % 2 == 1)
        if failed.any():
            at = motors.t_s[failed][0]
            message = f"ArduPilot takes a motor for failed (thrust boost) from {at:.2f} s"
            log.note("warning", "cmd", message, int(failed.sum()))


def _grown(log: ArduPilotLog, name: str, instance: int | None, field: str) -> int:
    """By how much a counter grows in the flight, 0 where the log has not got it."""
    topic = log.topic(name, instance)
    if topic is None or not topic.has(field):
        return 0
    counts = topic.raw(field)
    counts = counts[np.isfinite(counts) & (np.abs(counts) < _MOST)]
    return int(np.ptp(counts)) if len(counts) else 0
