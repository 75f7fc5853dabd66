"""Rows of a flight table -> MAVLink messages of the best precision, as read by the decoder.

Readings become float32: 24 bits, relative precision 6e-8. Times of HIGHRES_IMU, ODOMETRY,
ACTUATOR_OUTPUT_STATUS and DEBUG_FLOAT_ARRAY are in us; ATTITUDE_QUATERNION and LOCAL_POSITION_NED,
which ground stations display, in ms. Voltage is sent in mV and current in cA, without a time.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...errors import ModelError
from ...physics.sensors.table import SENSORS
from ...vehicle import GRAVITY_M_S2
from ...vehicle.earth import GAS_CONSTANT_J_KG_K, LAPSE_K_M
from ...vehicle.vehicle import SEA_LEVEL_PRESSURE_PA, SEA_LEVEL_TEMPERATURE_K
from ..columns import ACC, GYRO, MAG, POS, QUAT, VEL
from .decoder import PA_PER_HPA, ROTOR_ARRAY, T_PER_GAUSS
from .frames import PHASES, TYPES, Message, dialect

_FIELDS_OF = ((ACC, 0x7), (GYRO, 0x38), (MAG, 0x1C0))  # bits of HIGHRES_IMU.fields_updated
_PRESSURE = 0x200  # bit of abs_pressure
_ARRAY = 58  # numbers of DEBUG_FLOAT_ARRAY
_ACTUATORS = 32  # of ACTUATOR_OUTPUT_STATUS
_CELLS = 10  # of BATTERY_STATUS
_NONE_16 = 65535  # value of a missing cell
_LANDED = {phase: state for state, phase in PHASES.items()}  # MAV_LANDED_STATE by phase

Row = Mapping[str, float]
"""Columns of a flight table that have a sample."""


def heartbeat(motors: int | None, armed: bool = True) -> Message:
    """Heartbeat with the type and state of the aircraft."""
    mode = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return dialect.MAVLink_heartbeat_message(
        TYPES.get(motors or 4, dialect.MAV_TYPE_QUADROTOR),
        dialect.MAV_AUTOPILOT_GENERIC,
        mode,
        0,
        dialect.MAV_STATE_ACTIVE if armed else dialect.MAV_STATE_STANDBY,
        3,
    )


def landed(phase: str) -> Message:
    """Message of a land detector in a phase of flight."""
    state = _LANDED.get(phase, dialect.MAV_LANDED_STATE_IN_AIR)
    return dialect.MAVLink_extended_sys_state_message(dialect.MAV_VTOL_STATE_UNDEFINED, state)


def messages_of(t_us: int, row: Row, motors: int) -> list[Message]:
    """Messages with the samples of one time.

    Args:
        t_us: Time on the aircraft's clock, us, not negative.
        row: Samples of the row.
        motors: Number of motors, for commands and rotor speeds.
    """
    found = [imu(t_us, row), odometry(t_us, row)]
    cmd = _vector(row, [f"cmd_{i}" for i in range(1, motors + 1)])
    if cmd is not None and motors:
        values = [*cmd, *[0.0] * (_ACTUATORS - motors)]
        active = (1 << motors) - 1
        found.append(dialect.MAVLink_actuator_output_status_message(t_us, active, values))
    rotor = _vector(row, [f"rotor_{i}" for i in range(1, motors + 1)])
    if rotor is not None and motors:
        values = [*rotor, *[0.0] * (_ARRAY - motors)]
        name = ROTOR_ARRAY.encode()
        found.append(dialect.MAVLink_debug_float_array_message(t_us, name, 0, values))
    if "vbat_v" in row or "ibat_a" in row:
        found.append(battery(row))
    return [m for m in found if m is not None]


def imu(t_us: int, row: Row) -> Message | None:
    """HIGHRES_IMU with the samples of accelerometer, gyroscope, magnetometer and barometer."""
    there, values = 0, []
    for columns, bits in _FIELDS_OF:
        reading = _vector(row, columns)
        there |= bits if reading is not None else 0
        scale = 1 / T_PER_GAUSS if columns is MAG else 1.0
        values += [v * scale for v in reading or (0.0, 0.0, 0.0)]
    pressure = row.get("baro_pa")
    there |= _PRESSURE if pressure is not None else 0
    if not there:
        return None
    values += [(pressure or 0.0) / PA_PER_HPA, 0.0, 0.0, 0.0]
    return dialect.MAVLink_highres_imu_message(t_us, *values, there, 0)


def odometry(t_us: int, row: Row) -> Message | None:
    """ODOMETRY with the samples of position, velocity in NED and attitude; NaN for the rest."""
    position, velocity, q = (_vector(row, c) for c in (POS, VEL, QUAT))
    if position is None and velocity is None and q is None:
        return None
    nothing = (math.nan,) * 3
    unknown = [math.nan, *[0.0] * 20]
    return dialect.MAVLink_odometry_message(
        t_us,
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_LOCAL_NED,
        *(position or nothing),
        list(q or (math.nan,) * 4),
        *(velocity or nothing),
        *nothing,
        unknown,
        unknown,
        0,
        dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT,
    )


def attitude(t_us: int, q: Sequence[float], omega: Sequence[float]) -> Message:
    """ATTITUDE_QUATERNION, body to NED, with body rates, rad/s."""
    return dialect.MAVLink_attitude_quaternion_message(_ms(t_us), *q, *omega)


def local_position(t_us: int, position: Sequence[float], velocity: Sequence[float]) -> Message:
    """LOCAL_POSITION_NED, m and m/s."""
    return dialect.MAVLink_local_position_ned_message(_ms(t_us), *position, *velocity)


def battery(row: Row) -> Message:
    """BATTERY_STATUS with the samples of voltage and current."""
    cells, left = [_NONE_16] * _CELLS, 0
    if "vbat_v" in row:
        left = min(max(round(1e3 * row["vbat_v"]), 0), _CELLS * (_NONE_16 - 1))
    for k in range(-(-left // (_NONE_16 - 1))):  # a cell is limited to 65 V
        cells[k] = min(left - k * (_NONE_16 - 1), _NONE_16 - 1)
    current = min(max(round(1e2 * row["ibat_a"]), -32768), 32767) if "ibat_a" in row else -1
    return dialect.MAVLink_battery_status_message(
        0,
        dialect.MAV_BATTERY_FUNCTION_ALL,
        dialect.MAV_BATTERY_TYPE_LIPO,
        32767,
        cells,
        -2 if current == -1 and "ibat_a" in row else current,
        -1,
        -1,
        -1,
    )


def _vector(row: Row, columns: Sequence[str]) -> tuple[float, ...] | None:
    """Columns of a row; None where one of them has no sample."""
    values = tuple(row.get(c, math.nan) for c in columns)
    return None if any(v != v for v in values) else values


def _ms(t_us: int) -> int:
    return (t_us // 1000) & 0xFFFFFFFF


# -- messages of a simulator --------------------------------------------------------------------
#
# Messages between PX4 and a simulator, in both directions; the only place with their units and
# frames.
#
# | message | in it |
# |---|---|
# | HIL_SENSOR | m/s^2, rad/s, gauss, hPa, m, deg C as float32, body FRD; what is new by bits |
# | HIL_GPS | 1e-7 degrees, mm, cm/s, 1e-2 degrees as integers, NED |
# | HIL_STATE_QUATERNION | the true motion: float32, integers as of HIL_GPS; specific force in mg |
# | HIL_ACTUATOR_CONTROLS | 0..1 per motor as float32; armed by the mode, in lockstep by the flags |
#
# Times are us of simulated time. Source: message definitions of MAVLink `common`, and PX4's
# simulator_mavlink: it takes a barometer as new by pressure, pressure altitude and temperature
# together.

IMU_BITS, MAG_BITS, BARO_BITS = 0x3F, 0x1C0, 0x1A00
"""Bits of `fields_updated`: accelerometer and gyroscope, magnetometer, barometer."""
KELVIN = 273.15  # at 0 degrees Celsius
CONTROLS = 16  # of HIL_ACTUATOR_CONTROLS
_LOCKSTEP = 1  # bit of HIL_ACTUATOR_CONTROLS.flags
_FIX_3D, _SATELLITES = 3, 10  # fix type of HIL_GPS, and number of satellites
_INT16, _UINT16 = 32767, 65534  # largest int16, and largest known uint16
_POWER = GAS_CONSTANT_J_KG_K * LAPSE_K_M / GRAVITY_M_S2
"""Exponent of the pressure ratio, ICAO standard atmosphere."""
Three = Sequence[float]
SENT = ("acc", "gyro", "mag", "baro")
"""Signals that HIL_SENSOR carries."""
if other := {s.signal for s in SENSORS if s.hil} ^ {*SENT}:
    raise ModelError(
        f"HIL_SENSOR is made of {', '.join(SENT)}; {', '.join(sorted(other))}: say in the row of "
        f"the sensor whether it is sent, and fill it in here."
    )


@dataclass(frozen=True, slots=True)
class SensorReadings:
    """Readings at one instant, SI.

    Attributes:
        acc_b: Specific force, m/s^2, body FRD.
        gyro_b: Body rates, rad/s, body FRD.
        mag_b: Magnetic field, T, body FRD.
        pressure_pa: Static pressure of the air.
        temperature_k: Temperature of the air.
    """

    acc_b: Three
    gyro_b: Three
    mag_b: Three
    pressure_pa: float
    temperature_k: float


@dataclass(frozen=True, slots=True)
class Controls:
    """Motor commands of an autopilot.

    Attributes:
        t_us: Time of the commands, us.
        values: Command of each motor as sent, shape (16,); 0 or NaN for unused outputs.
        armed: Whether motors may turn.
        lockstep: Whether the time is that of the last HIL_SENSOR, and the autopilot waits for the
            next.
    """

    t_us: int
    values: tuple[float, ...]
    armed: bool
    lockstep: bool


def hil_sensor(t_us: int, sensed: SensorReadings, updated: int) -> Message:
    """HIL_SENSOR message.

    Args:
        t_us: Simulated time, us.
        sensed: Readings; those that are not new repeat the last ones.
        updated: Bits of the new readings: `IMU_BITS`, `MAG_BITS`, `BARO_BITS`.
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
    """HIL_GPS message.

    Args:
        t_us: Simulated time, us.
        place: Latitude, longitude, rad; height above the ellipsoid, m. PX4 interprets it as height
            above sea level.
        velocity_n: Velocity, m/s, NED.
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
    """HIL_STATE_QUATERNION, the true motion, which PX4 logs.

    Args:
        t_us: Simulated time, us.
        q_nb: Attitude, body to NED.
        omega_b: Body rates, rad/s, body FRD.
        place: Latitude, longitude, rad; height above the ellipsoid, m.
        velocity_n: Velocity, m/s, NED.
        specific_force_b: Specific force, m/s^2, body FRD.
        airspeed_m_s: Airspeed.
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
    """HIL_ACTUATOR_CONTROLS, as sent by an autopilot."""
    mode = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED if controls.armed else 0
    values = [*controls.values, *[0.0] * (CONTROLS - len(controls.values))]
    flags = _LOCKSTEP if controls.lockstep else 0
    return dialect.MAVLink_hil_actuator_controls_message(controls.t_us, values, mode, flags)


def controls_of(message: Message) -> Controls:
    """Motor commands in HIL_ACTUATOR_CONTROLS."""
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
    """Place in units of 1e-7 degrees and mm."""
    latitude, longitude, height_m = place
    degrees = (round(1e7 * math.degrees(a)) for a in (latitude, longitude))
    return (*degrees, round(1e3 * height_m))  # type: ignore[return-value]


def _clipped(value: float, least: int, most: int) -> int:
    return min(max(round(value), least), most)
