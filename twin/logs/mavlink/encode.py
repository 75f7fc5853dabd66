"""Rows of a flight table -> MAVLink messages, those that lose least. What the decoder reads.

Readings become float32: 24 bits, 6e-8 of their size. Times of HIGHRES_IMU, ODOMETRY,
ACTUATOR_OUTPUT_STATUS and DEBUG_FLOAT_ARRAY are us; ATTITUDE_QUATERNION and LOCAL_POSITION_NED,
which ground stations show, have ms. Voltage is sent in mV and current in cA, without a time.
"""

import math
from collections.abc import Mapping, Sequence

from ..columns import ACC, GYRO, MAG, POS, QUAT, VEL
from .decoder import PA_PER_HPA, ROTOR_ARRAY, T_PER_GAUSS
from .dialect import TYPES, Message, dialect

_FIELDS_OF = ((ACC, 0x7), (GYRO, 0x38), (MAG, 0x1C0))
_PRESSURE = 0x200
_ARRAY = 58
_ACTUATORS = 32
_CELLS = 10
_NONE_16 = 65535
_LANDED = {
    "ground": dialect.MAV_LANDED_STATE_ON_GROUND,
    "takeoff": dialect.MAV_LANDED_STATE_TAKEOFF,
    "land": dialect.MAV_LANDED_STATE_LANDING,
}

Row = Mapping[str, float]
"""Columns of a flight table that have a sample."""


def heartbeat(motors: int | None, armed: bool = True) -> Message:
    """The aircraft says that it is there, and what."""
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
    """What a land detector would say in a phase of flight."""
    state = _LANDED.get(phase, dialect.MAV_LANDED_STATE_IN_AIR)
    return dialect.MAVLink_extended_sys_state_message(dialect.MAV_VTOL_STATE_UNDEFINED, state)


def messages_of(t_us: int, row: Row, motors: int) -> list[Message]:
    """Messages of what was sampled at one time.

    Args:
        t_us: Time on the aircraft's clock, us, not negative.
        row: What there is.
        motors: How many, of commands and rotor speeds.
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
    """HIGHRES_IMU of what there is of accelerometer, gyroscope, magnetometer and barometer."""
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
    """ODOMETRY of what there is of position, velocity in NED and attitude; NaN for the rest."""
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
    """BATTERY_STATUS of what there is of voltage and current."""
    cells, left = [_NONE_16] * _CELLS, 0
    if "vbat_v" in row:
        left = min(max(round(1e3 * row["vbat_v"]), 0), _CELLS * (_NONE_16 - 1))
    for k in range(-(-left // (_NONE_16 - 1))):  # a cell holds 65 V: more is told as several
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
