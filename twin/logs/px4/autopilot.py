"""What PX4 says of its flight: modes, arming, failsafes, setpoints, filters."""

import numpy as np

from ..autopilot import (
    Autopilot,
    Filter,
    FilterKind,
    Sensor,
    Setpoint,
    Stretch,
    differing,
    modes_of,
    setpoint_of,
    stretches_of,
)
from ..columns import GYRO, POS, QUAT, VEL
from ..flight import Array
from .airframe import FILTERS
from .log import Px4Log

MODES = {
    **{0: "Manual", 1: "Altitude", 2: "Position", 3: "Mission", 4: "Hold", 5: "Return"},
    **{6: "Position Slow", 10: "Acro", 12: "Descend", 13: "Termination", 14: "Offboard"},
    **{15: "Stabilized", 16: "Rattitude", 17: "Takeoff", 18: "Land", 19: "Follow Me"},
    **{20: "Precision Land", 21: "Orbit", 22: "VTOL Takeoff"},
    **{k: f"External {k - 22}" for k in range(23, 31)},
}
"""Flight modes by vehicle_status.nav_state, named as in QGroundControl.

Source: PX4, msg/vehicle_status.msg of 1.10 to 1.16.
"""
_ARMED = 2
"""vehicle_status.arming_state, in every release."""
_UNIT_NORM = 0.01
_OF: dict[str, tuple[Sensor, FilterKind]] = {
    "gyroscope": ("gyro", "low-pass"),
    "accelerometer": ("acc", "low-pass"),
    "notch": ("gyro", "notch"),
}
"""What a filter of `FILTERS` does."""


def from_px4_autopilot(log: Px4Log, end_s: float) -> Autopilot:
    """What a PX4 log says of its flight; nothing of it is a finding.

    Args:
        log: The log.
        end_s: End of the record, s.
    """
    status = log.aside("vehicle_status", "nav_state")
    names = [] if status is None else [mode_name(int(k)) for k in status.data["nav_state"]]
    return Autopilot(
        modes_of(np.zeros(0) if status is None else status.t_s, names, end_s),
        _armed(log, end_s),
        _failsafes(log, end_s),
        log.messages,
        tuple(s for s in (_position(log), _velocity(log), _attitude(log), _rates(log)) if s),
        differing(log.params, log.defaults),
        bool(log.defaults),
        _filters(log.params),
    )


def mode_name(nav_state: int) -> str:
    """Name of a flight mode."""
    return MODES.get(nav_state, f"nav_state {nav_state}")


def _armed(log: Px4Log, end_s: float) -> tuple[Stretch, ...]:
    status = log.aside("vehicle_status", "arming_state")
    if status is not None:
        return stretches_of(status.t_s, status.data["arming_state"] == _ARMED, "armed", end_s)
    told = log.aside("actuator_armed", "armed")
    if told is None:
        return ()
    return stretches_of(told.t_s, told.data["armed"].astype(np.bool_), "armed", end_s)


def _failsafes(log: Px4Log, end_s: float) -> tuple[Stretch, ...]:
    status = log.aside("vehicle_status", "failsafe")
    if status is None:
        return ()
    return stretches_of(status.t_s, status.data["failsafe"].astype(np.bool_), "failsafe", end_s)


def _position(log: Px4Log) -> Setpoint | None:
    return _kept(log, "vehicle_local_position_setpoint", POS, ("x", "y", "z"))


def _velocity(log: Px4Log) -> Setpoint | None:
    return _kept(log, "vehicle_local_position_setpoint", VEL, ("vx", "vy", "vz"))


def _rates(log: Px4Log) -> Setpoint | None:
    return _kept(log, "vehicle_rates_setpoint", GYRO, ("roll", "pitch", "yaw"))


def _kept(
    log: Px4Log, name: str, columns: tuple[str, ...], fields: tuple[str, ...]
) -> Setpoint | None:
    """A setpoint in NED or FRD, SI, as PX4 has them all."""
    topic = log.aside(name, *fields)
    return None if topic is None else setpoint_of(columns, topic.t_s, topic.columns(fields))


def _attitude(log: Px4Log) -> Setpoint | None:
    """Quaternion FRD to NED, Hamilton, scalar first; without it (before 1.6) none."""
    fields = tuple(f"q_d[{k}]" for k in range(4))
    topic = log.aside("vehicle_attitude_setpoint", *fields)
    return None if topic is None else setpoint_of(QUAT, topic.t_s, _unit(topic.columns(fields)))


def _unit(q: Array) -> Array:
    """Quaternions as they are; NaN where they are none."""
    with np.errstate(invalid="ignore", over="ignore"):
        off = ~(np.abs(np.linalg.norm(q, axis=1) - 1.0) < _UNIT_NORM)
    return np.where(off[:, None], np.nan, q)


def _filters(params: dict[str, float]) -> tuple[Filter, ...]:
    """Low-passes and notches of gyroscope and accelerometer whose frequency is set."""
    found = [
        Filter(*_OF[what], params[name], name)
        for name, what in FILTERS.items()
        if params.get(name, 0.0) > 0.0 and what in _OF
    ]
    return tuple(sorted(found, key=lambda f: f.frequency_hz))
