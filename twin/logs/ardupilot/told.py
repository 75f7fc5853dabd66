"""What an ArduPilot log says of its aircraft, in the words that all formats share."""

import math

import numpy as np

from ...vehicle.layouts import CCW, CW, Layout
from .. import airframe as shared
from ..airframe import Cells, Told
from .airframe import Airframe
from .geometry import NO_MULTIROTOR
from .parameters import frame_numbers
from .site import Place

_FRAME_SD = 0.05
"""How far a real frame is from the circle of its name, over the arm; by judgement, as of PX4."""
_FULL_CELL_V = 4.2
_IMU = tuple(f"INS_POS1_{a}" for a in "XYZ")
_PLANE = "a fixed-wing aircraft"
_OTHERS = {"ArduPlane": _PLANE, "ArduRover": "a rover", "ArduSub": "a submarine"} | {
    "AntennaTracker": "an antenna tracker",
    "Blimp": "an airship",
}


def told_by(found: Airframe) -> shared.Airframe:
    """The facts that every format may tell."""
    count = found.motors
    return shared.Airframe(
        no_multirotor=_no_multirotor(found),
        rotors=Told(count, "outputs by SERVOn_FUNCTION of the log") if count else None,
        layout=_layout(found),
        thrust=_thrust(found),
        pulse_us=Told(found.pulse_us, "pulse widths by MOT_PWM_* and MOT_PWM_TYPE of the log"),
        cells=_cells(found),
        imu_position_m=_imu_position(found),
        accel_cutoff_hz=_cutoff(found.filters.accelerometer_hz, "INS_ACCEL_FILTER"),
        gyro_cutoff_hz=_cutoff(found.filters.gyro_hz, "INS_GYRO_FILTER"),
        place=None if found.place is None else _place(found.place),
    )


def _no_multirotor(found: Airframe) -> str:
    number = frame_numbers(found.params)[0]
    if name := NO_MULTIROTOR.get(number):
        return f"FRAME_CLASS is {number}, a {name}"
    kind = next((k for k in _OTHERS if found.firmware.startswith(k)), "")
    if kind and found.params.get("Q_ENABLE", 0.0) < 1.0:
        return f"its firmware is {kind}, of {_OTHERS[kind]}"
    return ""


def _layout(found: Airframe) -> Layout | None:
    """Places on a circle: ArduPilot knows no size."""
    rotors = found.rotors
    if rotors is None:
        return None
    return Layout(
        np.column_stack([rotors.direction, np.zeros(rotors.count)]),
        np.where(rotors.turn > 0.0, CCW, CW),
        metric=False,
        sd=_FRAME_SD,
        source=f"FRAME_CLASS and FRAME_TYPE of the log, {rotors.frame}",
    )


def _thrust(found: Airframe) -> Told[shared.ThrustCurve] | None:
    """Of a log that says at least the exponent."""
    if "MOT_THST_EXPO" not in found.params:
        return None
    t = found.thrust
    source = f"MOT_THST_EXPO {t.expo:g}, MOT_SPIN_MIN {t.spin_min:g}, MOT_SPIN_MAX {t.spin_max:g}"
    return Told(shared.ThrustCurve(t.expo, t.spin_min, t.spin_max), f"{source} of the log")


def _cells(found: Airframe) -> Told[Cells] | None:
    """By the voltage up to which thrust is scaled."""
    if found.thrust.voltage_v is None:
        return None
    low, high = found.thrust.voltage_v
    count = max(round(high / _FULL_CELL_V), 1)
    capacity = found.params.get("BATT_CAPACITY", 0.0)
    cells = Cells(count, high / count, low / count, 3.6 * capacity if capacity > 0.0 else None)
    return Told(cells, f"MOT_BAT_VOLT_MIN {low:g} and _MAX {high:g} of the log")


def _imu_position(found: Airframe) -> Told[tuple[float, float, float]] | None:
    x, y, z = (found.params.get(name, 0.0) for name in _IMU)
    return Told((x, y, z), f"{_IMU[0]} to _Z of the log") if any((x, y, z)) else None


def _cutoff(hz: float | None, name: str) -> Told[float] | None:
    return None if hz is None else Told(hz, f"{name} of the log")


def _place(place: Place) -> Told[shared.Place]:
    year = place.day.year + (place.day.timetuple().tm_yday - 1) / 365.25
    north, east = math.radians(place.latitude_deg), math.radians(place.longitude_deg)
    return Told(shared.Place(north, east, place.altitude_m, year), "GPS of the log")
