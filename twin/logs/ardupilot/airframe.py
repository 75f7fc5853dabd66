"""Facts of an aircraft from the parameters and the head of an ArduPilot log."""

import math
from collections.abc import Mapping

import numpy as np

from ...vehicle.layouts import CCW, CW, Layout
from ..airframe import Airframe, Cells, Place, ThrustCurve, Told
from .geometry import NO_MULTIROTOR, geometry
from .identity import OTHERS, Frame, firmware, frame_of
from .log import ArduPilotLog
from .outputs import channels_of, has_functions
from .parameters import motor_value, pulse_range_us
from .site import Fix, fix

_FRAME_SD = 0.05
"""How far a real frame is from the circle of its name, over the arm; by judgement, as of PX4."""
_FULL_CELL_V = 4.2
_IMU = tuple(f"INS_POS1_{a}" for a in "XYZ")
_SPIN_MIN, _SPIN_MAX = 0.15, 0.95  # ArduPilot's defaults
_EKF_ORIGIN = 0
_COUNTED = {"XKF1", "NKF1", "EKF1", "PSCN"}
"""Messages whose positions are counted from it."""
_OTHERS = {
    "Plane": "a fixed-wing aircraft",
    "Rover": "a rover",
    "Sub": "a submarine",
    "AntennaTracker": "an antenna tracker",
    "Blimp": "an airship",
}


def from_ardupilot_airframe(log: ArduPilotLog) -> Airframe:
    """What an ArduPilot log says of its aircraft; the place is that of the flight."""
    params, count, place = log.params, len(channels_of(log)), fix(log)
    return Airframe(
        no_multirotor=_no_multirotor(log),
        rotors=Told(count, _motors_from(log)) if count else None,
        layout=_layout(frame_of(log), count),
        thrust=_thrust(params),
        pulse_us=Told(pulse_range_us(params), "MOT_PWM_* and MOT_PWM_TYPE of the log"),
        cells=_cells(params),
        imu_position_m=_imu_position(params),
        accel_cutoff_hz=_cutoff(params, "INS_ACCEL_FILTER"),
        gyro_cutoff_hz=_cutoff(params, "INS_GYRO_FILTER"),
        place=None if place is None else _place(place),
        origin=_origin(log),
    )


def _motors_from(log: ArduPilotLog) -> str:
    """Where the number of motors comes from."""
    if has_functions(log.params):
        return "outputs by SERVOn_FUNCTION of the log"
    return frame_of(log).source


def _no_multirotor(log: ArduPilotLog) -> str:
    frame = frame_of(log)
    if name := NO_MULTIROTOR.get(frame.kind):
        return f"FRAME_CLASS is {frame.kind}, a {name}"
    other = OTHERS.match(firmware(log))
    if other and log.params.get("Q_ENABLE", 0.0) < 1.0:
        return f"its firmware is {other.group()}, of {_OTHERS[other.group(1) or other.group()]}"
    return ""


def _layout(frame: Frame, motors: int) -> Layout | None:
    """Places on a circle: ArduPilot knows no size."""
    rotors = geometry(frame.kind, frame.form)
    if rotors is None or rotors.count != (motors or rotors.count):
        return None
    return Layout(
        np.column_stack([rotors.direction, np.zeros(rotors.count)]),
        np.where(rotors.turn > 0.0, CCW, CW),
        metric=False,
        sd=_FRAME_SD,
        source=f"{frame.source}, {rotors.frame}",
    )


def _thrust(params: Mapping[str, float]) -> Told[ThrustCurve] | None:
    """Of a log that says at least the exponent; ArduPilot, Motor Thrust Scaling."""
    expo = motor_value(params, "MOT_THST_EXPO", -1.0)
    if not 0.0 <= expo <= 1.0:
        return None
    high = motor_value(params, "MOT_SPIN_MAX", _SPIN_MAX)
    if "THR_MIN" in params and "MOT_SPIN_MIN" not in params:  # up to Copter 3.3
        low = 1e-3 * params["THR_MIN"]
        high = low + (1.0 - low) * high
        least = f"THR_MIN {params['THR_MIN']:g}, MOT_THST_MAX"
    else:
        low = motor_value(params, "MOT_SPIN_MIN", _SPIN_MIN)
        least = f"MOT_SPIN_MIN {low:g}, MOT_SPIN_MAX"
    if not 0.0 <= low < high <= 1.0:
        low, high = _SPIN_MIN, _SPIN_MAX
    source = f"MOT_THST_EXPO {expo:g}, {least} {high:g} of the log"
    return Told(ThrustCurve(expo, low, high), source)


def _cells(params: Mapping[str, float]) -> Told[Cells] | None:
    """By the voltages between which thrust is scaled."""
    low, high = (motor_value(params, f"MOT_BAT_VOLT_{k}", 0.0) for k in ("MIN", "MAX"))
    if not 0.0 < low < high:
        return None
    count = max(round(high / _FULL_CELL_V), 1)
    capacity = params.get("BATT_CAPACITY", 0.0)
    cells = Cells(count, high / count, low / count, 3.6 * capacity if capacity > 0.0 else None)
    return Told(cells, f"MOT_BAT_VOLT_MIN {low:g} and _MAX {high:g} (or MOT_THST_BAT_*) of the log")


def _imu_position(params: Mapping[str, float]) -> Told[tuple[float, float, float]] | None:
    x, y, z = (params.get(name, 0.0) for name in _IMU)
    return Told((x, y, z), f"{_IMU[0]} to _Z of the log") if any((x, y, z)) else None


def _cutoff(params: Mapping[str, float], name: str) -> Told[float] | None:
    hz = params.get(name, 0.0)
    return Told(hz, f"{name} of the log") if hz > 0.0 else None


def _origin(log: ArduPilotLog) -> Told[Place] | None:
    """What the estimator counts positions from; POS alone is counted from its first sample."""
    topic = log.whole("ORGN")  # said once, mostly before the flight
    if topic is None or not topic.has("Type", "Lat", "Lng", "Alt"):
        return None
    if not _COUNTED & log.content.messages.keys():
        return None
    columns = np.column_stack([topic.raw(c) for c in ("Lat", "Lng", "Alt")])
    there = columns[topic.raw("Type") == _EKF_ORIGIN]
    if not len(there) or not np.isfinite(there).all() or np.any(np.ptp(there, axis=0) > 0.0):
        return None
    latitude, longitude, height = there[-1].tolist()
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        return None
    place = Place(math.radians(latitude), math.radians(longitude), height, None)
    return Told(place, "ORGN of the log")


def _place(found: Fix) -> Told[Place]:
    year = found.day.year + (found.day.timetuple().tm_yday - 1) / 365.25
    north, east = math.radians(found.latitude_deg), math.radians(found.longitude_deg)
    return Told(Place(north, east, found.altitude_m, year), "GPS of the log")
