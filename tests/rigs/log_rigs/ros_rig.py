"""ROS 2 bags of any content, written by rosbags: PX4's topics, MAVROS, topics of one's own."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

needs_rosbags = pytest.mark.skipif(find_spec("rosbags") is None, reason="rosbags is not installed")
START_NS = 1_700_000_000_000_000_000
PX4 = {
    "SensorCombined": "uint64 timestamp\nfloat32[3] gyro_rad\nuint32 gyro_integral_dt\n"
    "int32 accelerometer_timestamp_relative\nfloat32[3] accelerometer_m_s2\n",
    "VehicleAttitude": "uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\n",
    "VehicleLocalPosition": "uint64 timestamp\nuint64 timestamp_sample\nbool xy_valid\n"
    "bool z_valid\nbool v_xy_valid\nbool v_z_valid\nfloat32 x\nfloat32 y\nfloat32 z\n"
    "float32 vx\nfloat32 vy\nfloat32 vz\n",
    "ActuatorMotors": "uint64 timestamp\nuint64 timestamp_sample\nuint16 reversible_flags\n"
    "float32[12] control\n",
    "BatteryStatus": "uint64 timestamp\nfloat32 voltage_v\nfloat32 current_a\n",
    "VehicleStatus": "uint64 timestamp\nuint8 arming_state\nuint8 nav_state\n",
    "VehicleLandDetected": "uint64 timestamp\nbool landed\n",
}
"""Parts of the messages of px4_msgs, in the order of their fields."""
OUTPUTS = """
[cmd]
topic = "/mavros/rc/out"
fields = ["channels[0]", "channels[1]", "channels[2]", "channels[3]"]
unit = "us"
low = 1000
high = 2000
"""
"""Mapping file for the outputs of `mavros_bag`."""


@dataclass(frozen=True)
class Messages:
    """Messages of one topic.

    Attributes:
        topic: Name.
        message: Type.
        t_s: When each was sampled.
        fields: Values by name, one per message; those of messages within it as mappings.
        late_s: By how much each was recorded later.
    """

    topic: str
    message: str
    t_s: NDArray[np.float64]
    fields: Sequence[Mapping[str, Any]]
    late_s: float = 0.002


def bag(topics: Sequence[Messages], suffix: str = ".mcap", folder: Path | None = None) -> bytes:
    """Bytes of a bag; with a folder it is left there, with its metadata."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.LATEST)
    for name, text in PX4.items():
        store.register(get_types_from_msg(text, f"px4_msgs/msg/{name}"))
    store.register(
        get_types_from_msg("std_msgs/Header header\nuint16[] channels\n", "mavros_msgs/msg/RCOut")
    )
    plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
    with tempfile.TemporaryDirectory() as scratch:
        place = (folder or Path(scratch)) / "bag"
        with Writer(place, version=9, storage_plugin=plugin) as writer:
            for each in topics:
                connection = writer.add_connection(each.topic, each.message, typestore=store)
                for t_s, fields in zip(each.t_s, each.fields, strict=True):
                    stamp_ns = START_NS + round(1e9 * t_s)
                    message = _message(store, each.message, dict(fields), stamp_ns)
                    late = stamp_ns + round(1e9 * each.late_s)
                    content = store.serialize_cdr(message, each.message)
                    writer.write(connection, late, content)
        (file,) = place.glob(f"*{suffix}")
        return file.read_bytes()


def _message(store: Any, kind: str, fields: dict[str, Any], stamp_ns: int) -> Any:
    """A message, what is not given zero; with its stamp."""
    given: dict[str, Any] = {}
    for name, description in store.fielddefs[kind][1]:
        given[name] = _value(store, name, description, fields.get(name), stamp_ns)
    return store.types[kind](**given)


def _value(store: Any, name: str, description: Any, given: Any, stamp_ns: int) -> Any:
    node, of = description
    if node.name == "NAME":
        return _message(store, of, given or {}, stamp_ns)
    if node.name == "BASE":
        if name in ("timestamp", "timestamp_sample"):
            return stamp_ns // 1000
        if name in ("sec", "nanosec"):
            return dict(zip(("sec", "nanosec"), divmod(stamp_ns, 10**9), strict=True))[name]
        return ("" if of[0] == "string" else 0) if given is None else given
    (_, kind), count = of
    if kind[0] == "string":
        return given or []
    return np.array([0] * (count or 0) if given is None else given, np.dtype(kind[0]))


def px4_bag(table: pd.DataFrame) -> list[Messages]:
    """Topics of PX4 for a flight table; its positions are invalid in the first second."""
    t, slow = table["time"].to_numpy(), table.iloc[::4]
    t_slow = slow["time"].to_numpy()
    imu = [
        {"gyro_rad": g, "accelerometer_m_s2": a}
        for g, a in zip(_of(table, "gyro"), _of(table, "acc"), strict=True)
    ]
    local = [
        {
            **dict(zip(("x", "y", "z"), p, strict=True)),
            **dict(zip(("vx", "vy", "vz"), v, strict=True)),
            **dict.fromkeys(("xy_valid", "z_valid"), bool(s >= 1.0)),
            **dict.fromkeys(("v_xy_valid", "v_z_valid"), True),
        }
        for s, p, v in zip(t_slow, _of(slow, "pos"), _of(slow, "vel"), strict=True)
    ]
    q = [{"q": q} for q in _of(slow, "q", "wxyz")]
    control = [{"control": [*c, *[np.nan] * 8]} for c in _of(table, "cmd", "1234")]
    status = [{"arming_state": 2, "nav_state": k} for k in (17, 3)]
    return [
        Messages("/fmu/out/sensor_combined", "px4_msgs/msg/SensorCombined", t, imu),
        Messages("/fmu/out/vehicle_attitude", "px4_msgs/msg/VehicleAttitude", t_slow, q),
        Messages(
            *("/fmu/out/vehicle_local_position_v1", "px4_msgs/msg/VehicleLocalPosition"),
            *(t_slow, local),
        ),
        Messages("/fmu/out/actuator_motors", "px4_msgs/msg/ActuatorMotors", t, control),
        Messages(
            *("/fmu/out/battery_status", "px4_msgs/msg/BatteryStatus", t_slow[:5]),
            [{"voltage_v": 15.5, "current_a": 12.0}] * 5,
        ),
        Messages(
            *("/fmu/out/vehicle_status", "px4_msgs/msg/VehicleStatus", t[[0, len(t) // 2]], status)
        ),
        Messages(
            *("/fmu/out/vehicle_land_detected", "px4_msgs/msg/VehicleLandDetected", t[[0, 100]]),
            [{"landed": True}, {"landed": False}],
        ),
    ]


def _of(table: pd.DataFrame, stem: str, letters: str = "xyz") -> NDArray[np.float64]:
    return np.asarray(table[[f"{stem}_{a}" for a in letters]], dtype=np.float64)


def mavros_bag(table: pd.DataFrame) -> list[Messages]:
    """Topics of MAVROS for a flight table, turned into the frames of ROS by scipy."""
    t = table["time"].to_numpy()
    flu = Rotation.from_euler("x", np.pi)
    enu = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    attitude = Rotation.from_quat(_of(table, "q", "xyzw"))
    ros = enu * attitude * flu  # of a vector in FLU, in ENU
    imu = [
        {"linear_acceleration": _xyz(a), "angular_velocity": _xyz(g)}
        for a, g in zip(flu.apply(_of(table, "acc")), flu.apply(_of(table, "gyro")), strict=True)
    ]
    velocity = (flu * attitude.inv()).apply(_of(table, "vel"))
    odometry = [
        {
            "pose": {"pose": {"position": _xyz(p), "orientation": _xyz(q, "xyzw")}},
            "twist": {"twist": {"linear": _xyz(v)}},
        }
        for p, q, v in zip(enu.apply(_of(table, "pos")), ros.as_quat(), velocity, strict=True)
    ]
    pulses = [{"channels": np.round(1000.0 + 1000.0 * c)} for c in _of(table, "cmd", "1234")]
    return [
        Messages("/mavros/imu/data", "sensor_msgs/msg/Imu", t[::2], imu[::2]),
        Messages("/mavros/imu/data_raw", "sensor_msgs/msg/Imu", t, imu),
        Messages("/mavros/local_position/odom", "nav_msgs/msg/Odometry", t, odometry),
        Messages("/mavros/rc/out", "mavros_msgs/msg/RCOut", t, pulses),
        Messages(
            *("/mavros/battery", "sensor_msgs/msg/BatteryState", t[:5]),
            [{"voltage": 15.5, "current": -12.0}] * 5,
        ),
    ]


def _xyz(values: NDArray[np.float64], letters: str = "xyz") -> dict[str, float]:
    return dict(zip(letters, values.tolist(), strict=True))
