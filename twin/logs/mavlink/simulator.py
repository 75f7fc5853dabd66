"""The messages between PX4 and a simulator, in both directions. Their units and frames stand here.

| message | in it |
|---|---|
| HIL_SENSOR | m/s^2, rad/s, gauss, hPa, m, deg C as float32, body FRD; what is new by bits |
| HIL_GPS | 1e-7 degrees, mm, cm/s, 1e-2 degrees as integers, NED |
| HIL_STATE_QUATERNION | the true motion: float32, integers as of HIL_GPS; specific force in mg |
| HIL_ACTUATOR_CONTROLS | 0..1 per motor as float32; armed by the mode, in lockstep by the flags |

All have us of the simulated time. Source: message definitions of MAVLink `common`, and what PX4's
simulator_mavlink makes of them: it takes a barometer as new by pressure, pressure altitude and
temperature together.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ...physics.atmosphere import GAS_CONSTANT_J_KG_K, LAPSE_K_M
from ...vehicle import GRAVITY_M_S2
from ...vehicle.sensors import SEA_LEVEL_PRESSURE_PA, SEA_LEVEL_TEMPERATURE_K
from .decoder import PA_PER_HPA, T_PER_GAUSS
from .dialect import Message, dialect

IMU, MAG, BARO = 0x3F, 0x1C0, 0x1A00
"""Bits of `fields_updated`: accelerometer and gyroscope, magnetometer, barometer."""
KELVIN = 273.15
CONTROLS = 16
_LOCKSTEP = 1
_FIX_3D, _SATELLITES = 3, 10
_INT16, _UINT16 = 32767, 65534
_POWER = GAS_CONSTANT_J_KG_K * LAPSE_K_M / GRAVITY_M_S2
Three = Sequence[float]


@dataclass(frozen=True, slots=True)
class Sensed:
    """Readings at one instant, SI.

    Attributes:
        acc_b: m/s^2, body FRD.
        gyro_b: rad/s, body FRD.
        mag_b: T, body FRD.
        pressure_pa: Of the air.
        temperature_k: Of the air.
    """

    acc_b: Three
    gyro_b: Three
    mag_b: Three
    pressure_pa: float
    temperature_k: float


@dataclass(frozen=True, slots=True)
class Controls:
    """What an autopilot asks for.

    Attributes:
        t_us: Its time, us.
        values: Of each motor as it was sent, shape (16,); those of no motor are 0, or NaN.
        armed: Whether motors may turn.
        lockstep: Whether its time is that of the last HIL_SENSOR, and it waits for the next.
    """

    t_us: int
    values: tuple[float, ...]
    armed: bool
    lockstep: bool


def hil_sensor(t_us: int, sensed: Sensed, updated: int) -> Message:
    """HIL_SENSOR.

    Args:
        t_us: Simulated time, us.
        sensed: Readings, those that are not new as they were.
        updated: Which are new: `IMU`, `MAG`, `BARO`.
    """
    return dialect.MAVLink_hil_sensor_message(
        t_us,
        *sensed.acc_b,
        *sensed.gyro_b,
        *(b / T_PER_GAUSS for b in sensed.mag_b),
        sensed.pressure_pa / PA_PER_HPA,
        0.0,
        pressure_altitude_m(sensed.pressure_pa),
        sensed.temperature_k - KELVIN,
        updated,
        0,
    )


def hil_gps(t_us: int, place: Three, velocity_n: Three, accuracy_m: float) -> Message:
    """HIL_GPS.

    Args:
        t_us: Simulated time, us.
        place: Latitude, longitude, rad; height over the ellipsoid, m. PX4 takes it for a height
            over the sea.
        velocity_n: m/s, NED.
        accuracy_m: Standard deviation of the position; PX4 takes `eph` and `epv` for cm.
    """
    north, east, _ = velocity_n
    cm = _clipped(100.0 * accuracy_m, 1, _UINT16)
    course = round(100.0 * math.degrees(math.atan2(east, north))) % 36000
    return dialect.MAVLink_hil_gps_message(
        t_us,
        _FIX_3D,
        *_place(place),
        cm,
        cm,
        _clipped(100.0 * math.hypot(north, east), 0, _UINT16),
        *(_clipped(100.0 * v, -_INT16, _INT16) for v in velocity_n),
        course,
        _SATELLITES,
        0,
        0,
    )


def hil_state(
    t_us: int,
    q_nb: Sequence[float],
    omega_b: Three,
    place: Three,
    velocity_n: Three,
    specific_force_b: Three,
    airspeed_m_s: float,
) -> Message:
    """HIL_STATE_QUATERNION, the true motion: PX4 logs it.

    Args:
        t_us: Simulated time, us.
        q_nb: Attitude, body to NED.
        omega_b: rad/s, body FRD.
        place: Latitude, longitude, rad; height over the ellipsoid, m.
        velocity_n: m/s, NED.
        specific_force_b: m/s^2, body FRD.
        airspeed_m_s: Through the air.
    """
    speed = _clipped(100.0 * airspeed_m_s, 0, _UINT16)
    force = (1e3 / GRAVITY_M_S2 * f for f in specific_force_b)
    return dialect.MAVLink_hil_state_quaternion_message(
        t_us,
        list(q_nb),
        *omega_b,
        *_place(place),
        *(_clipped(100.0 * v, -_INT16, _INT16) for v in velocity_n),
        speed,
        speed,
        *(_clipped(f, -_INT16, _INT16) for f in force),
    )


def hil_controls(controls: Controls) -> Message:
    """HIL_ACTUATOR_CONTROLS, as an autopilot sends it."""
    mode = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED if controls.armed else 0
    values = [*controls.values, *[0.0] * (CONTROLS - len(controls.values))]
    flags = _LOCKSTEP if controls.lockstep else 0
    return dialect.MAVLink_hil_actuator_controls_message(controls.t_us, values, mode, flags)


def controls_of(message: Message) -> Controls:
    """What HIL_ACTUATOR_CONTROLS asks for."""
    return Controls(
        int(message.time_usec),
        tuple(float(v) for v in message.controls),
        bool(message.mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED),
        bool(message.flags & _LOCKSTEP),
    )


def pressure_altitude_m(pressure_pa: float) -> float:
    """Height in the standard atmosphere, m.

    Source: ICAO Doc 7488, troposphere.
    """
    share = max(pressure_pa, 1.0) / SEA_LEVEL_PRESSURE_PA
    return float(SEA_LEVEL_TEMPERATURE_K / LAPSE_K_M * (1.0 - share**_POWER))


def _place(place: Three) -> tuple[int, int, int]:
    """1e-7 degrees and mm."""
    latitude, longitude, height_m = place
    degrees = (round(1e7 * math.degrees(a)) for a in (latitude, longitude))
    return (*degrees, round(1e3 * height_m))  # type: ignore[return-value]


def _clipped(value: float, least: int, most: int) -> int:
    return min(max(round(value), least), most)
