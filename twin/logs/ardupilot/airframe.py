"""What an ArduPilot log says of the aircraft that flew it, without its motion."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import LogError
from ..flight import Array
from .arming import use_the_flight
from .geometry import Geometry, frame_name, geometry
from .identity import board, firmware
from .log import ArduPilotLog, open_ardupilot
from .outputs import channels_of
from .parameters import frame_numbers, motor_value, pulse_range_us
from .site import Place, place


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
