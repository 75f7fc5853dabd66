"""Topics of a ROS 2 bag by signal, with their units and frames.

Those of PX4 (px4_msgs over uXRCE-DDS), MAVROS and the standard messages of ROS are known here; a
mapping file next to the bag names others. This is the only module with units and axes of ROS: REP
103 and 105, body forward, left, up; world east, north, up; quaternions x, y, z, w.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import LogError
from ...frames import multiply, rotation_matrix
from ...topic_mapping import MappedSignal, mapping_of, read_mapping
from ..columns import ACC, GYRO, MAG, MAX_MOTORS, MIN_MOTORS, POS, QUAT, VEL, motor_columns
from ..flight import Array

_HALF = float(np.sqrt(0.5))
_Q_NED_ENU, _Q_FLU_FRD = (0.0, _HALF, _HALF, 0.0), (0.0, 1.0, 0.0, 0.0)
"""Rotations between the frames of ROS and those of a flight, w, x, y, z."""


def as_it_is(values: Array) -> Array:
    """Values unchanged, already in SI, NED and FRD."""
    return values


def from_flu(values: Array) -> Array:
    """Forward, left, up -> forward, right, down; shape (n, 3)."""
    return values * (1.0, -1.0, -1.0)


def from_enu(values: Array) -> Array:
    """East, north, up -> north, east, down; shape (n, 3)."""
    return values[:, [1, 0, 2]] * (1.0, 1.0, -1.0)


def from_ros_quaternion(values: Array) -> Array:
    """x, y, z, w, FLU to ENU -> w, x, y, z, FRD to NED; shape (n, 4)."""
    q = values[:, [3, 0, 1, 2]].T
    turned = multiply(multiply(_Q_NED_ENU, list(q)), _Q_FLU_FRD)
    return np.column_stack([np.broadcast_to(c, len(values)) for c in turned])


def from_body_velocity(values: Array) -> Array:
    """Forward, left, up and a quaternion of ROS -> velocity, NED; shapes (n, 7) to (n, 3)."""
    rows = rotation_matrix(list(values[:, [6, 3, 4, 5]].T))
    v = values[:, :3].T
    return from_enu(np.column_stack([sum(r[k] * v[k] for k in range(3)) for r in rows]))


def _times(factor: float) -> Callable[[Array], Array]:
    def scaled(values: Array) -> Array:
        return values * factor

    return scaled


@dataclass(frozen=True, slots=True)
class Source:
    """A possible source of a signal.

    Attributes:
        signal: Name of the signal in findings and limits.
        columns: Columns of the flight table; empty: one per motor with a value, named by the
            signal.
        message: Type of the messages.
        topic: Pattern of the topic's name.
        fields: Paths of fields in a message, "linear_acceleration.x"; an array counts with all
            elements.
        convert: Conversion to SI, NED, FRD; shapes (n, fields) to (n, columns).
        only: Required values of fields for a message to be used, by path.
        note: Note on the signal, "" without any.
        entry: Mapping file and entry that name the source, "" without one.
    """

    signal: str
    columns: tuple[str, ...]
    message: str
    topic: re.Pattern[str]
    fields: tuple[str, ...]
    convert: Callable[[Array], Array] = as_it_is
    only: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    entry: str = ""

    @property
    def width(self) -> int:
        """Number of values of the fields, one for each column or the inputs of a rotation; 0: any
        number."""
        return max(len(self.columns), len(self.fields)) if self.columns else 0

    def miscounted(self, given: int) -> str:
        """Error text for a different number of values in the fields."""
        named = ", ".join(self.fields) or "none"
        return f"{self.signal} needs {self.width} values; fields {named} give {given}."

    def fits(self, topic: str, message: str) -> bool:
        """Whether a topic matches this source."""
        return message == self.message and self.topic.search(topic) is not None


_OUT = re.compile(r"/fmu/out/")
"""Topics that PX4 publishes; `/fmu/in/` are its inputs."""
_ANY, _RAW = re.compile(""), re.compile(r"raw")
_MAVROS = re.compile(r"/mavros/")
_XYZ = ("x", "y", "z")


_COLUMNS: Mapping[str, tuple[str, ...]] = {
    **{"acc": ACC, "gyro": GYRO, "mag": MAG, "pos": POS, "vel": VEL, "q": QUAT},
    **{"baro": ("baro_pa",), "vbat_v": ("vbat_v",), "ibat_a": ("ibat_a",), "cmd": (), "rotor": ()},
}
"""Signals and their columns; empty: one for each motor."""


def _px4(
    signal: str,
    message: str,
    *fields: str,
    convert: Callable[[Array], Array] = as_it_is,
    only: Mapping[str, float] | None = None,
    topic: re.Pattern[str] = _OUT,
    note: str = "",
) -> Source:
    kind, columns = f"px4_msgs/msg/{message}", _COLUMNS[signal]
    return Source(signal, columns, kind, topic, fields, convert, dict(only or {}), note)


def _ros(
    signal: str,
    message: str,
    *fields: str,
    convert: Callable[[Array], Array] = as_it_is,
    topic: re.Pattern[str] = _ANY,
    note: str = "",
) -> Source:
    return Source(signal, _COLUMNS[signal], message, topic, fields, convert, {}, note)


def _of(stem: str, names: tuple[str, ...] = _XYZ) -> tuple[str, ...]:
    return tuple(f"{stem}.{n}" for n in names)


_NED_POSE, _NED_VELOCITY = {"pose_frame": 1.0}, {"velocity_frame": 1.0}
"""POSE_FRAME_NED and VELOCITY_FRAME_NED of px4_msgs/VehicleOdometry."""
_THRUST = (
    "thrust of actuator_motors, taken for the command: a bag has no parameters, so the thrust "
    "curve (THR_MDL_FAC) is not known"
)
_EAST = "x of its frame is taken for east (REP 105): the heading is right only if it is"
_IMU, _ODOMETRY = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"
_POSE, _TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
_BATTERY = "sensor_msgs/msg/BatteryState"
_ROS_Q = ("x", "y", "z", "w")
_ODOMETRY_Q = _of("pose.pose.orientation", _ROS_Q)


def _imu(topic: re.Pattern[str]) -> Iterator[Source]:
    yield _ros("acc", _IMU, *_of("linear_acceleration"), convert=from_flu, topic=topic)
    yield _ros("gyro", _IMU, *_of("angular_velocity"), convert=from_flu, topic=topic)


def _motion(topic: re.Pattern[str], note: str) -> Iterator[Source]:
    """Attitude, position and velocity of an estimator."""

    def of(
        signal: str, message: str, fields: tuple[str, ...], convert: Callable[[Array], Array]
    ) -> Source:
        return _ros(signal, message, *fields, convert=convert, topic=topic, note=note)

    yield of("q", _ODOMETRY, _ODOMETRY_Q, from_ros_quaternion)
    yield of("q", _POSE, _of("pose.orientation", _ROS_Q), from_ros_quaternion)
    yield of("pos", _ODOMETRY, _of("pose.pose.position"), from_enu)
    yield of("pos", _POSE, _of("pose.position"), from_enu)
    in_body = (*_of("twist.twist.linear"), *_ODOMETRY_Q)
    yield of("vel", _ODOMETRY, in_body, from_body_velocity)


SOURCES: tuple[Source, ...] = (
    _px4("acc", "SensorCombined", "accelerometer_m_s2"),
    _px4("gyro", "SensorCombined", "gyro_rad"),
    _px4("mag", "VehicleMagnetometer", "magnetometer_ga", convert=_times(1e-4)),
    _px4("baro", "VehicleAirData", "baro_pressure_pa"),
    _px4("q", "VehicleAttitude", "q"),
    _px4("q", "VehicleOdometry", "q", only=_NED_POSE),
    _px4("pos", "VehicleLocalPosition", *_XYZ, only={"xy_valid": 1.0, "z_valid": 1.0}),
    _px4("pos", "VehicleOdometry", "position", only=_NED_POSE),
    _px4(
        *("vel", "VehicleLocalPosition", "vx", "vy", "vz"),
        only={"v_xy_valid": 1.0, "v_z_valid": 1.0},
    ),
    _px4("vel", "VehicleOdometry", "velocity", only=_NED_VELOCITY),
    _px4("cmd", "ActuatorMotors", "control", note=_THRUST),
    _px4("cmd", "ActuatorMotors", "control", topic=_ANY, note=_THRUST),
    _px4("vbat_v", "BatteryStatus", "voltage_v"),
    _px4("ibat_a", "BatteryStatus", "current_a"),
    *_imu(_RAW),  # unfiltered, where available
    *_imu(_ANY),
    _ros("mag", "sensor_msgs/msg/MagneticField", *_of("magnetic_field"), convert=from_flu),
    _ros("baro", "sensor_msgs/msg/FluidPressure", "fluid_pressure"),
    *_motion(_MAVROS, ""),
    *_motion(_ANY, _EAST),
    _ros(
        *("q", _IMU, *_of("orientation", _ROS_Q)),
        convert=from_ros_quaternion,
        topic=re.compile(r"/mavros/imu/data$"),
    ),
    _ros(
        *("vel", _TWIST, *_of("twist.linear")),
        convert=from_enu,
        topic=re.compile(r"/velocity_local$"),
    ),
    _ros("vbat_v", _BATTERY, "voltage"),
    _ros("ibat_a", _BATTERY, "current", convert=_times(-1.0)),
)
"""Known sources; of several for the same signal the first that a bag contains is used."""


# -- mapping files --------------------------------------------------------------------------------

_FRAMES: Mapping[str, Mapping[str, Callable[[Array], Array]]] = {
    **{s: {"FRD": as_it_is, "FLU": from_flu} for s in ("acc", "gyro", "mag")},
    **{s: {"NED": as_it_is, "ENU": from_enu} for s in ("pos", "vel")},
    "q": {"NED-FRD": as_it_is, "ENU-FLU": from_ros_quaternion},
}
"""Frames of vectors, the first where none is named."""
_UNITS: Mapping[str, Mapping[str, float]] = {
    "acc": {"m/s^2": 1.0, "g": 9.80665},
    "gyro": {"rad/s": 1.0, "deg/s": np.pi / 180.0},
    "mag": {"T": 1.0, "gauss": 1e-4},
    "baro": {"Pa": 1.0, "hPa": 100.0},
    "pos": {"m": 1.0},
    "vel": {"m/s": 1.0},
    "rotor": {"rad/s": 1.0, "rpm": 2.0 * np.pi / 60.0},
    "cmd": {"us": 1.0},
    "vbat_v": {"V": 1.0, "mV": 1e-3},
    "ibat_a": {"A": 1.0},
    "q": {},
}
"""Factor to SI of the units of a signal; `low` and `high` of commands are in that unit too."""


def mapped_sources(bag: Path, types: Mapping[str, str]) -> tuple[Source, ...]:
    """Sources in the mapping file of a bag; none where there is no such file.

    Args:
        bag: File of the bag; the mapping file is in the same folder.
        types: Message types by topic.

    Raises:
        LogError: The file is no valid mapping, or names topics that the bag does not have.
    """
    file = mapping_of(bag)
    if file is None:
        return ()
    named = read_mapping(file, file.name)
    return tuple(_mapped(file.name, s, m, types) for s, m in named.items())


def _mapped(file: str, signal: str, given: MappedSignal, types: Mapping[str, str]) -> Source:
    """The source of one entry."""

    def wrong(text: str) -> LogError:
        return LogError(f"{file}: [{signal}] {text}")

    if signal not in _COLUMNS:
        raise wrong(f"is no signal. Write one of {', '.join(_COLUMNS)}.")
    if given.topic not in types:
        raise wrong(f"topic {given.topic}: the bag has {', '.join(sorted(types)[:12])}.")
    frames = _FRAMES.get(signal, {"": as_it_is})
    turned = frames.get(given.frame or next(iter(frames)))
    if turned is None:
        raise wrong(f"frame {given.frame!r}: write one of {', '.join(filter(None, frames))}.")
    units = _UNITS[signal]
    if given.unit and given.unit not in units:
        raise wrong(f"unit {given.unit!r}: write {' or '.join(units) or 'none'}.")
    scale = units.get(given.unit, 1.0)
    if len(set(given.fields)) < len(given.fields):
        raise wrong(f"names a field twice: {', '.join(given.fields)}.")
    several = signal in ("cmd", "rotor")
    if several and not MIN_MOTORS <= len(given.fields) <= MAX_MOTORS:
        raise wrong(f"has {len(given.fields)} fields: one for each of 3 to 12 motors, in order.")
    columns = _COLUMNS[signal] or motor_columns(signal, len(given.fields))
    if len(given.fields) > len(columns):
        raise wrong(f"has {len(given.fields)} fields: {signal} needs {len(columns)} values.")
    if not math.isfinite(given.high - given.low) or given.high == given.low:
        text = f"low = {given.low:g}, high = {given.high:g}"
        raise wrong(f"{text}: give the values of command 0 and of command 1.")
    low, span = (given.low, given.high - given.low) if signal == "cmd" else (0.0, 1.0)

    def convert(values: Array) -> Array:
        """Convert to SI, NED, FRD; commands to 0..1."""
        return turned((values - low) / span * scale)

    whole = re.compile(f"^{re.escape(given.topic)}$")
    return Source(
        *(signal, columns, types[given.topic], whole, tuple(given.fields), convert),
        entry=f"{file}: [{signal}]",
    )
