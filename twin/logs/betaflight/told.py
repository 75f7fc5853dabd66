"""What Betaflight itself says of a flight and of its filters."""

import numpy as np
from numpy.typing import NDArray

from ..autopilot import (
    MOST_MESSAGES,
    Autopilot,
    Filter,
    Message,
    Mode,
    Setpoint,
    Stretch,
    modes_of,
    setpoint_of,
    stretches_of,
)
from ..columns import GYRO
from ..flight import Array
from .frames import DISARM, MODES, SYNC_BEEP
from .log import BlackboxLog
from .signals import TURNED, Times, accel_cutoff_hz, rate_scale, three

_ARMED, _ANGLE, _HORIZON = 1, 2, 4
"""Bits of the flight modes; those above mean other things in other versions."""
_REASONS = {
    0: "arming disabled",
    1: "failsafe",
    2: "throttle timeout",
    3: "sticks",
    4: "switch",
    5: "crash protection",
    6: "runaway take-off",
    7: "GPS rescue",
    8: "serial command",
    9: "landing",
    10: "crash flip",
    255: "system",
}
_ALARMING = (1, 5, 6)
_FAILSAFES = {1: "signal of the receiver lost", 2: "failsafe landing", 3: "failsafe landed"}
_LEAST_HZ = 1.0


def from_betaflight(log: BlackboxLog, end_s: float) -> Autopilot:
    """Modes, arming, failsafes, events, setpoint of the rates and filters.

    Args:
        log: The log.
        end_s: End of the record, s.
    """
    t_s, flags = _flags(log)
    setpoint = _rates(log)
    return Autopilot(
        modes=_modes(t_s, flags, end_s),
        armed=stretches_of(t_s, (flags & _ARMED) > 0, "armed", end_s) if len(t_s) else (),
        failsafes=_failsafes(log, end_s),
        messages=_messages(log, end_s),
        setpoints=(setpoint,) if setpoint is not None else (),
        filters=filters_of(log),
    )


def _seconds(log: BlackboxLog, t_us: Times) -> Array:
    return np.asarray((t_us - log.start_us) * 1e-6, dtype=np.float64)


def _flags(log: BlackboxLog) -> tuple[Array, NDArray[np.int64]]:
    """Flags of the modes and when they were told, s: by S frames and by events."""
    slow = log.recording.slow
    told: list[tuple[int, int]] = []
    if slow.has("flightModeFlags"):
        at = slow.names.index("flightModeFlags")
        told += zip(slow.t_us.tolist(), slow.values[:, at].tolist(), strict=True)
    told += [(e.t_us, e.values[0]) for e in log.recording.events if e.kind == MODES]
    told.sort(key=lambda each: each[0])
    t_us = np.array([t for t, _ in told], dtype=np.int64)
    return _seconds(log, t_us), np.array([f for _, f in told], dtype=np.int64)


def _modes(t_s: Array, flags: NDArray[np.int64], end_s: float) -> tuple[Mode, ...]:
    names = [
        "ANGLE" if bits & _ANGLE else "HORIZON" if bits & _HORIZON else "ACRO"
        for bits in flags.tolist()
    ]
    return modes_of(t_s, names, end_s)


def _failsafes(log: BlackboxLog, end_s: float) -> tuple[Stretch, ...]:
    slow = log.recording.slow
    if not slow.has("failsafePhase"):
        return ()
    phase = slow.columns(("failsafePhase",))[:, 0]
    t_s = _seconds(log, slow.t_us)
    found: list[Stretch] = []
    for number, name in _FAILSAFES.items():
        found += stretches_of(t_s, phase == number, name, end_s)
    return tuple(sorted(found, key=lambda s: s.start_s))


def _messages(log: BlackboxLog, end_s: float) -> tuple[Message, ...]:
    """Why it was disarmed, and when the beeper told that it was armed."""
    found = []
    for event in log.recording.events:
        t_s = min(max((event.t_us - log.start_us) * 1e-6, 0.0), end_s)
        if event.kind == DISARM:
            reason = event.values[0]
            text = f"disarmed: {_REASONS.get(reason, f'reason {reason}')}"
            found.append(Message(t_s, "warning" if reason in _ALARMING else "info", text))
        elif event.kind == SYNC_BEEP:
            found.append(Message(t_s, "info", "beep of arming"))
    return tuple(sorted(found, key=lambda m: m.t_s)[:MOST_MESSAGES])


def _rates(log: BlackboxLog) -> Setpoint | None:
    """Rates that the pilot or the angle controller asks for, in the same unit as the gyro."""
    main, scale = log.recording.main, rate_scale(log)
    if not main.has(*three("setpoint")) or np.isnan(scale):
        return None
    order = np.argsort(main.t_us, kind="stable")
    t_us, first = np.unique(main.t_us[order], return_index=True)
    values = main.columns(three("setpoint"))[order][first] * TURNED * scale
    return setpoint_of(GYRO, _seconds(log, t_us), values)


def filters_of(log: BlackboxLog) -> tuple[Filter, ...]:
    """Low-passes and notches that are switched on, by frequency.

    A dynamic low-pass follows the throttle from the first of two frequencies up; the notches of
    the rotors have harmonics at whole multiples.
    """
    header = log.header
    found = []
    for name in (
        "gyro_lpf1_static_hz",
        "gyro_lpf2_static_hz",
        "gyro_lowpass_hz",
        "gyro_lowpass2_hz",
        "gyro_lpf1_dyn_hz",
        "gyro_lowpass_dyn_hz",
    ):
        hz = header.number(name, 0.0)
        if _LEAST_HZ <= hz < np.inf:
            found.append(Filter("gyro", "low-pass", hz, name))
    found += [
        Filter("gyro", "notch", hz, "gyro_notch_hz")
        for hz in header.numbers("gyro_notch_hz")
        if _LEAST_HZ <= hz < np.inf
    ]
    lowest = header.number("rpm_filter_min_hz", 0.0)
    if header.number("rpm_filter_harmonics", 0.0) >= 1.0 and _LEAST_HZ <= lowest < np.inf:
        found.append(Filter("gyro", "tracking notch", lowest, "rpm_filter_min_hz"))
    if _LEAST_HZ <= accel_cutoff_hz(log) < np.inf:
        found.append(Filter("acc", "low-pass", accel_cutoff_hz(log), "acc_lpf_hz"))
    return tuple(sorted(found, key=lambda f: f.frequency_hz))
