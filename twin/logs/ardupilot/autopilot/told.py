"""Modes, arming, failsafes, messages, parameters and filters of a DataFlash log."""

import numpy as np

from ...autopilot import (
    MOST_EVENTS,
    MOST_MESSAGES,
    Autopilot,
    Filter,
    FilterKind,
    Message,
    Mode,
    Parameter,
    Sensor,
    Stretch,
    as_text,
    differing,
    modes_of,
    stretches_of,
)
from ..arming import ARMED, DISARMED, armed_spans
from ..log import ArduPilotLog
from ..phases import SUBSYSTEMS, mode_names, subsystem
from .setpoints import setpoints

_LASTING = (2, 3, 5, 6, 8, 9, 11, 16, 17, 18, 23, 26, 27, 29)
"""Subsystems of ERR whose code 0 says that it is over; those of the others are instants."""
_LONGEST_S = 365 * 86_400.0
_LEAST_HZ = 1.0
_LOW_PASSES: tuple[tuple[str, Sensor], ...] = (
    ("INS_GYRO_FILTER", "gyro"),
    ("INS_ACCEL_FILTER", "acc"),
)
_HARMONIC_NOTCHES = ("INS_HNTCH", "INS_HNTC2")
_NOTCH = "INS_NOTCH"
"""Before ArduPilot 4.2."""
_MOST_HARMONICS = 16


def from_ardupilot_autopilot(log: ArduPilotLog, end_s: float) -> Autopilot:
    """What an ArduPilot log says of its flight; nothing of it is a finding.

    Args:
        log: The log, cut to the flight.
        end_s: End of the record, s.
    """
    failsafes, failures = _errors(log, end_s)
    said = sorted([*_messages(log), *failures], key=lambda m: m.t_s)
    told, parameters = _parameters(log)
    return Autopilot(
        _modes(log, end_s),
        _armed(log, end_s),
        failsafes,
        tuple(said[:MOST_MESSAGES]),
        setpoints(log, end_s),
        parameters,
        told,
        _filters(log.params),
    )


def _modes(log: ArduPilotLog, end_s: float) -> tuple[Mode, ...]:
    topic = log.whole("MODE")
    names = [] if topic is None else mode_names(log, topic)
    return modes_of(topic.t_s, names, end_s) if topic is not None and names else ()


def _armed(log: ArduPilotLog, end_s: float) -> tuple[Stretch, ...]:
    """By the events of arming; a log that begins with one that disarms began armed. Without any, by
    the outputs of the motors."""
    events = log.whole("EV")
    if events is not None and events.has("Id"):
        kinds = events.raw("Id")
        told = np.isin(kinds, (ARMED, DISARMED))
        if told.any():
            t_s, on = events.t_s[told], kinds[told] == ARMED
            t_s, on = np.append(min(0.0, t_s[0] - 1.0), t_s), np.append(not on[0], on)
            return stretches_of(t_s, on, "armed", end_s)
    spans = [(max(a * 1e-6, 0.0), min(b * 1e-6, end_s)) for a, b in armed_spans(log)]
    return tuple(Stretch("armed", a, b) for a, b in spans if b > a)[:MOST_EVENTS]


def _errors(log: ArduPilotLog, end_s: float) -> tuple[tuple[Stretch, ...], list[Message]]:
    """Failures that last, of the flight, and those that are instants, as messages."""
    topic = log.whole("ERR")
    if topic is None or not topic.has("Subsys", "ECode"):
        return (), []
    systems, codes = topic.raw("Subsys"), topic.raw("ECode")
    lasting: list[Stretch] = []
    for number in _LASTING:
        of = systems == number
        if of.any():
            lasting += stretches_of(topic.t_s[of], codes[of] > 0, SUBSYSTEMS[number], end_s)
    instants = [
        Message(t, "error", f"{subsystem(number)}, code {code:.0f}")
        for t, number, code in zip(
            topic.t_s.tolist(), systems.tolist(), codes.tolist(), strict=True
        )
        if np.isfinite((number, code)).all() and number not in _LASTING and abs(t) < _LONGEST_S
    ]
    lasting.sort(key=lambda s: s.start_s)
    return tuple(lasting[:MOST_EVENTS]), instants


def _messages(log: ArduPilotLog) -> list[Message]:
    """Texts of MSG, which has no levels."""
    topic = log.whole("MSG")
    if topic is None or "Message" not in topic.source.data or topic.has("Message"):
        return []
    texts = topic.source.texts("Message")
    return [
        Message(t, "", text)
        for t, row in zip(topic.t_s.tolist(), topic.rows.tolist(), strict=True)
        if abs(t) < _LONGEST_S and (text := as_text(texts[row]))
    ]


def _parameters(log: ArduPilotLog) -> tuple[bool, tuple[Parameter, ...]]:
    """Whether PARM has defaults, as since ArduPilot 4.3, and the parameters that differ."""
    messages = log.content.messages.get("PARM")
    if messages is None or not {"Name", "Default"} <= set(messages.data):
        return False, ()
    values = messages.data["Default"].astype(np.float64).tolist()
    defaults = {
        name: float(f"{value:.7g}")  # written as float
        for name, value in zip(messages.texts("Name"), values, strict=True)
        if np.isfinite(value)
    }
    return bool(defaults), differing(log.params, defaults)


def _filters(params: dict[str, float]) -> tuple[Filter, ...]:
    """Low-passes and notches that are switched on.

    Source: ArduPilot, AP_InertialSensor and HarmonicNotchFilter; bit k of HMNCS is harmonic k + 1.
    """
    found = [
        Filter(sensor, "low-pass", params[name], name)
        for name, sensor in _LOW_PASSES
        if params.get(name, 0.0) >= _LEAST_HZ
    ]
    for stem in (*_HARMONIC_NOTCHES, _NOTCH):
        name = f"{stem}_FREQ"
        base_hz = params.get(name, 0.0)
        if params.get(f"{stem}_ENABLE", 0.0) < 1.0 or base_hz < _LEAST_HZ:
            continue
        bits = int(params.get(f"{stem}_HMNCS", 1.0)) or 1
        tracks = params.get(f"{stem}_MODE", 0.0) >= 1.0
        kind: FilterKind = "tracking notch" if tracks else "notch"
        found += [
            Filter("gyro", kind, base_hz * (k + 1), name)
            for k in range(_MOST_HARMONICS)
            if bits >> k & 1
        ]
    return tuple(sorted(found, key=lambda f: f.frequency_hz))
