"""What an ArduPilot log says of the aircraft that flew it, without its motion."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import LogError
from ...vehicle.layouts import CCW, CW, Layout
from .. import airframe as shared
from ..airframe import Cells, Told
from ..flight import Array
from .arming import use_the_flight
from .geometry import NO_MULTIROTOR, Geometry, frame_name, geometry
from .identity import board, firmware
from .log import ArduPilotLog, open_ardupilot
from .outputs import channels_of
from .parameters import frame_numbers, motor_value, pulse_range_us
from .site import Place, place

_FRAME_SD = 0.05
"""How far a real frame is from the circle of its name, over the arm; by judgement, as of PX4."""
_FULL_CELL_V = 4.2
_IMU = tuple(f"INS_POS1_{a}" for a in "XYZ")
_PLANE = "a fixed-wing aircraft"
_OTHERS = {"ArduPlane": _PLANE, "ArduRover": "a rover", "ArduSub": "a submarine"} | {
    "AntennaTracker": "an antenna tracker",
    "Blimp": "an airship",
}


@dataclass(frozen=True, slots=True)
class ThrustCurve:
    """How ArduPilot believes that thrust follows the command of a motor.

    Attributes:
        spin_arm: Command of a motor that is armed and on the ground, 0..1 (MOT_SPIN_ARM).
        spin_min: Command of no thrust wanted (MOT_SPIN_MIN).
        spin_max: Command of all thrust wanted (MOT_SPIN_MAX).
        expo: Share of thrust that grows with the square (MOT_THST_EXPO), 0..1.
        voltage_v: Least and most voltage within which it is scaled (MOT_BAT_VOLT_MIN, _MAX); None:
            it is not.
        hover: Thrust in hover as learned, a share of all (MOT_THST_HOVER); None: not logged.
    """

    spin_arm: float
    spin_min: float
    spin_max: float
    expo: float
    voltage_v: tuple[float, float] | None
    hover: float | None

    def thrust(self, command: Array) -> Array:
        """Share of the full thrust at a command 0..1, at full voltage; any shape.

        Source: ArduPilot, Motor Thrust Scaling: of x = (command - spin_min) / (spin_max - spin_min)
        it is (1 - expo) x + expo x^2.
        """
        x = np.clip((command - self.spin_min) / (self.spin_max - self.spin_min), 0.0, 1.0)
        return np.asarray((1.0 - self.expo) * x + self.expo * x * x)


@dataclass(frozen=True, slots=True)
class Filters:
    """Cutoffs of second-order low-passes, Hz, and rates; None where the log has none.

    Attributes:
        gyro_hz: INS_GYRO_FILTER: what IMU.Gyr* went through.
        accelerometer_hz: INS_ACCEL_FILTER: what IMU.Acc* went through.
        loop_hz: Rate of the controllers (SCHED_LOOP_RATE).
    """

    gyro_hz: float | None
    accelerometer_hz: float | None
    loop_hz: float | None


@dataclass(frozen=True, slots=True)
class Airframe:
    """An aircraft as the parameters and the head of a log tell it.

    Attributes:
        autopilot: `ArduPilot`.
        firmware: Its version, "" where the log has none.
        board: Board and serial number, which tell aircraft apart; "" where the log has none.
        frame: FRAME_CLASS and FRAME_TYPE by name; "" where the log has none.
        motors: Number of motors, 0 where the log does not tell.
        rotors: Places and senses, motor 1 first as in the flight table; None: not known here.
        channels: Output of each motor, from 1.
        pulse_us: Pulse widths of command 0 and 1.
        thrust: Thrust curve.
        filters: Filters.
        place: Where and when; None without satellites.
        params: All parameters.
    """

    autopilot: str
    firmware: str
    board: str
    frame: str
    motors: int
    rotors: Geometry | None
    channels: tuple[int, ...]
    pulse_us: tuple[float, float]
    thrust: ThrustCurve
    filters: Filters
    place: Place | None
    params: Mapping[str, float]


def read_airframe(path: str | Path) -> Airframe:
    """The aircraft of a DataFlash log.

    Raises:
        LogError: The file is none, or nothing in it can be used.
    """
    path = Path(path)
    try:
        blob = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error}.") from None
    log = open_ardupilot(path, blob)
    use_the_flight(log)
    return airframe(log)


def airframe(log: ArduPilotLog) -> Airframe:
    """The aircraft of a log that is open; the place is that of the flight."""
    numbers = frame_numbers(log.params)
    channels = tuple(channels_of(log))
    rotors = geometry(*numbers)
    if rotors is not None and channels and rotors.count != len(channels):
        rotors = None
    return Airframe(
        autopilot="ArduPilot",
        firmware=firmware(log),
        board=board(log),
        frame=frame_name(*numbers) if numbers[0] else "",
        motors=len(channels),
        rotors=rotors,
        channels=channels,
        pulse_us=pulse_range_us(log.params),
        thrust=_thrust(log.params),
        filters=Filters(
            _positive(log.params, "INS_GYRO_FILTER"),
            _positive(log.params, "INS_ACCEL_FILTER"),
            _positive(log.params, "SCHED_LOOP_RATE"),
        ),
        place=place(log),
        params=dict(log.params),
    )


def _positive(params: Mapping[str, float], name: str) -> float | None:
    value = params.get(name, 0.0)
    return value if value > 0.0 else None


def _thrust(params: Mapping[str, float]) -> ThrustCurve:
    """Parameters of the thrust curve, ArduPilot's defaults where the log has none."""
    low, high = (motor_value(params, f"MOT_BAT_VOLT_{k}", 0.0) for k in ("MIN", "MAX"))
    hover = motor_value(params, "MOT_THST_HOVER", 0.0)
    spin_min = motor_value(params, "MOT_SPIN_MIN", 0.15)
    spin_max = motor_value(params, "MOT_SPIN_MAX", 0.95)
    sound = 0.0 <= spin_min < spin_max <= 1.0
    return ThrustCurve(
        spin_arm=motor_value(params, "MOT_SPIN_ARM", 0.10),
        spin_min=spin_min if sound else 0.15,
        spin_max=spin_max if sound else 0.95,
        expo=min(max(motor_value(params, "MOT_THST_EXPO", 0.65), 0.0), 1.0),
        voltage_v=(low, high) if 0.0 < low < high else None,
        hover=hover if 0.0 < hover < 1.0 else None,
    )


def told_by(found: Airframe) -> shared.Airframe:
    """The facts that every format may tell."""
    count = found.motors
    return shared.Airframe(
        no_multirotor=_no_multirotor(found),
        rotors=Told(count, "outputs by SERVOn_FUNCTION of the log") if count else None,
        layout=_layout(found),
        thrust=_told_thrust(found),
        pulse_us=Told(found.pulse_us, "pulse widths by MOT_PWM_* and MOT_PWM_TYPE of the log"),
        cells=_cells(found),
        imu_position_m=_imu_position(found),
        accel_cutoff_hz=_cutoff(found.filters.accelerometer_hz, "INS_ACCEL_FILTER"),
        gyro_cutoff_hz=_cutoff(found.filters.gyro_hz, "INS_GYRO_FILTER"),
        place=None if found.place is None else _told_place(found.place),
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


def _told_thrust(found: Airframe) -> Told[shared.ThrustCurve] | None:
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


def _told_place(place: Place) -> Told[shared.Place]:
    year = place.day.year + (place.day.timetuple().tm_yday - 1) / 365.25
    north, east = math.radians(place.latitude_deg), math.radians(place.longitude_deg)
    return Told(shared.Place(north, east, place.altitude_m, year), "GPS of the log")
