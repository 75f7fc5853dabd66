"""A small valid file of every log format: two seconds at rest, made from nothing; ULogs of any
content, so that tests need no recorded flight."""

import io
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from log_rigs.blackbox_rig import BOOT_US, Part, blackbox
from log_rigs.crazyflie_rig import usd_log
from log_rigs.dataflash_rig import dataflash
from log_rigs.ros_rig import Messages, bag
from numpy.typing import ArrayLike, NDArray

from twin.frames import from_euler, multiply, to_body
from twin.logs.mavlink.encode import messages_of
from twin.logs.mavlink.frames import AUTOPILOT, parser, stamped

# -- ULog -----------------------------------------------------------------------------------

_TYPES = {"u1": "uint8_t", "u2": "uint16_t", "u4": "uint32_t", "i4": "int32_t", "u8": "uint64_t"}
_TYPES |= {"f4": "float", "f8": "double", "b1": "bool"}


def ulog_message(kind: bytes, payload: bytes) -> bytes:
    """One message of a ULog."""
    return struct.pack("<HB", len(payload), kind[0]) + payload


def _field(name: str, values: NDArray[np.generic]) -> tuple[str, int]:
    kind = _TYPES[values.dtype.str[1:]]
    width = values.shape[1] if values.ndim == 2 else 0
    return (f"{kind}[{width}] {name}" if width else f"{kind} {name}"), width


def ulog(
    topics: Mapping[str, Mapping[str, ArrayLike]],
    params: Mapping[str, float] | None = None,
    start_us: int = 1_000_000,
    release: tuple[int, int, int] = (1, 14, 0),
    defaults: Mapping[str, tuple[int, float]] | None = None,
    said: Sequence[tuple[float, str, str]] = (),
) -> bytes:
    """Bytes of a ULog.

    Args:
        topics: Per topic its fields; `t` is the time stamp in s after the start; two-dimensional
            fields become arrays. `name:1` is instance 1 of `name`.
        params: Parameters; int or float decides the type.
        start_us: Time of the start of the log, us.
        release: Firmware version.
        defaults: Of parameters: bit 0 for the firmware's, bit 1 for the airframe's, and the value.
        said: Logged messages: time in s after the start, level as a digit, text.
    """
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", start_us)]
    out.append(ulog_message(b"B", bytes(40)))
    key = b"uint32_t ver_sw_release"
    number = release[0] << 24 | release[1] << 16 | release[2] << 8 | 255
    out.append(ulog_message(b"I", bytes([len(key)]) + key + struct.pack("<I", number)))
    out += [ulog_message(b"P", _parameter(*item)) for item in (params or {}).items()]
    for name, (bits, value) in (defaults or {}).items():
        out.append(ulog_message(b"Q", bytes([bits]) + _parameter(name, value)))
    rows: list[tuple[int, bytes]] = []
    added = []
    for index, (name, fields) in enumerate(topics.items()):
        base, _, instance = name.partition(":")
        arrays = {k: np.asarray(v) for k, v in fields.items()}
        stamps = np.round(arrays.pop("t") * 1e6).astype(np.int64) + start_us
        arrays = {"timestamp": stamps.astype(np.uint64), **arrays}
        text = ";".join(_field(k, v)[0] for k, v in arrays.items())
        if not instance:
            out.append(ulog_message(b"F", f"{base}:{text};".encode()))
        head = struct.pack("<BH", int(instance or 0), index)
        added.append(ulog_message(b"A", head + base.encode()))
        columns = [v.astype(v.dtype.newbyteorder("<")) for v in arrays.values()]
        for k, stamp in enumerate(stamps):
            data = b"".join(c[k].tobytes() for c in columns)
            rows.append((int(stamp), ulog_message(b"D", struct.pack("<H", index) + data)))
    for t_s, level, text in said:
        stamp = round(t_s * 1e6) + start_us
        rows.append(
            (stamp, ulog_message(b"L", struct.pack("<BQ", ord(level), stamp) + text.encode()))
        )
    rows.sort(key=lambda r: r[0])
    return b"".join([*out, *added, *(r[1] for r in rows)])


def _parameter(name: str, value: float) -> bytes:
    """Type, name and value of a parameter."""
    kind, code = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
    key = f"{kind} {name}".encode()
    return bytes([len(key)]) + key + struct.pack(code, value)


MOVING_S = 0.004 + 0.004 * np.arange(2000)


def moving_topics() -> dict[str, dict[str, ArrayLike]]:
    """Topics of a PX4 1.14 log: eight seconds of a hover that turns a little."""
    f4 = np.float32
    rates = np.stack([0.3 * np.sin(k * MOVING_S) for k in (3.0, 4.0, 5.0)], axis=1)
    control = np.full((len(MOVING_S), 12), np.nan, dtype=f4)
    control[:, :4] = 0.4 + 0.01 * np.sin(20 * MOVING_S)[:, None]
    slow = MOVING_S[::12]
    return {
        "sensor_combined": {
            "t": MOVING_S,
            "gyro_rad": rates.astype(f4),
            "gyro_integral_dt": np.full(len(MOVING_S), 4000, dtype=np.uint32),
            "accelerometer_timestamp_relative": np.zeros(len(MOVING_S), dtype=np.int32),
            "accelerometer_m_s2": np.tile(np.array((0, 0, -9.8), dtype=f4), (len(MOVING_S), 1)),
            "accelerometer_integral_dt": np.full(len(MOVING_S), 4000, dtype=np.uint32),
        },
        "actuator_motors": {"t": MOVING_S, "control": control},
        "vehicle_local_position": {
            "t": slow,
            "timestamp_sample": np.round(slow * 1e6).astype(np.uint64) + np.uint64(999_000),
            **{k: 0.01 * np.sin(slow + i).astype(f4) for i, k in enumerate(("x", "y", "z"))},
            **{k: 0.01 * np.cos(slow + i).astype(f4) for i, k in enumerate(("vx", "vy", "vz"))},
        },
    }


# -- every format ---------------------------------------------------------------------------

T_S = 0.004 + 0.004 * np.arange(500)


def flight_table() -> pd.DataFrame:
    """At rest: gravity on the accelerometer, nothing on the gyroscope."""
    still = {name: np.zeros(len(T_S)) for name in ("gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y")}
    return pd.DataFrame({"time": T_S, **still, "acc_z": np.full(len(T_S), -9.80665)})


def flown_table() -> pd.DataFrame:
    """Half a minute to and fro at 3 m height: exact kinematics, noise where sensors have it."""
    n = 3000
    t = 0.01 * np.arange(n)
    rng = np.random.default_rng(1)
    roll, pitch, yaw = 0.1 * np.sin(1.3 * t), 0.12 * np.sin(0.9 * t), 0.4 * np.sin(0.4 * t)
    q = np.asarray(from_euler(roll, pitch, yaw))
    amplitude, speed = np.array((2.0, 1.5, 1.5)), np.array((0.8, 1.1, 0.7))
    pos = amplitude * np.sin(speed * t[:, None]) - (0.0, 0.0, 3.0)
    vel = amplitude * speed * np.cos(speed * t[:, None])
    force = -amplitude * speed**2 * np.sin(speed * t[:, None]) - (0.0, 0.0, 9.80665)
    conjugate = q * np.array([[1.0], [-1.0], [-1.0], [-1.0]])
    rates = 2.0 * np.stack(multiply(list(conjugate), list(np.gradient(q, t, axis=1)))[1:], axis=1)
    acc = np.stack(to_body(list(q), list(force.T)), axis=1)
    table = pd.DataFrame({"time": t})
    for i in range(1, 5):
        table[f"cmd_{i}"] = 0.5 + 0.05 * np.sin(t + i)
    table[["acc_x", "acc_y", "acc_z"]] = acc + 0.1 * rng.standard_normal((n, 3))
    table[["gyro_x", "gyro_y", "gyro_z"]] = rates + 0.01 * rng.standard_normal((n, 3))
    table[["pos_x", "pos_y", "pos_z"]] = pos
    table[["vel_x", "vel_y", "vel_z"]] = vel
    table[["q_w", "q_x", "q_y", "q_z"]] = q.T
    table["baro_pa"] = 101325.0 + 12.0 * pos[:, 2] + rng.standard_normal(n)
    table["phase"] = "tour"
    return table


def _ulog() -> bytes:
    still = np.zeros((len(T_S), 3), dtype=np.float32)
    gravity = still - np.array((0, 0, 9.80665), dtype=np.float32)
    imu = {"t": T_S, "gyro_rad": still, "accelerometer_m_s2": gravity}
    return ulog({"sensor_combined": imu})


def _parquet() -> bytes:
    file = io.BytesIO()
    flight_table().to_parquet(file, index=False)
    return file.getvalue()


def _csv() -> bytes:
    text: str = flight_table().to_csv(index=False, lineterminator="\n")
    return text.encode()


@cache
def _dataflash(text: bool = False) -> bytes:
    return dataflash({"IMU": {"t": T_S, "AccZ": -9.80665 + 0.0 * T_S}}, text=text)


def flown_messages() -> dict[str, dict[str, ArrayLike]]:
    """Messages of a DataFlash log of the flight of `flown_table`, as they are meant."""
    table = flown_table()
    t, slow = table["time"].to_numpy(), slice(None, None, 4)
    part = {c: table[c].to_numpy() for c in table if c != "phase"}
    imu = {f"Gyr{a.upper()}": part[f"gyro_{a}"] for a in "xyz"}
    imu |= {f"Acc{a.upper()}": part[f"acc_{a}"] for a in "xyz"}
    course = {f"V{a}": part[f"vel_{b}"][slow] for a, b in zip("NED", "xyz", strict=True)}
    course |= {f"P{a}": part[f"pos_{b}"][slow] for a, b in zip("NED", "xyz", strict=True)}
    q = {f"Q{k}": part[f"q_{a}"][slow] for k, a in zip("1234", "wxyz", strict=True)}
    pulses = {f"C{k}": 1000.0 + 1000.0 * part[f"cmd_{k}"][slow] for k in range(1, 5)}
    return {
        "IMU": {"t": t, **imu},
        "XKQ": {"t": t[slow], **q},
        "XKF1": {"t": t[slow], **course},
        "RCOU": {"t": t[slow], **pulses},
        "BARO": {"t": t[slow], "Press": part["baro_pa"][slow]},
    }


FLOWN_PARAMS = {
    **{"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0},
    **{f"SERVO{k}_FUNCTION": 32.0 + k for k in range(1, 5)},
}
"""Parameters of a quadrotor in X on the first four outputs."""


@cache
def _crazyflie(version: int) -> bytes:
    still = np.zeros(len(T_S))
    fixed: dict[str, tuple[str, ArrayLike]] = {"t": ("d", T_S), "acc.z": ("f", still + 1.0)}
    fixed |= {name: ("f", still) for name in ("acc.x", "acc.y", "gyro.x", "gyro.y", "gyro.z")}
    return usd_log({"fixedFrequency": fixed}, version)


@cache
def _stream() -> bytes:
    file, table = io.BytesIO(), flight_table()
    arrow = pa.Table.from_pandas(table, preserve_index=False)
    with pa.ipc.new_stream(file, arrow.schema) as writer:
        writer.write_table(arrow, max_chunksize=50)
    return file.getvalue()


@cache
def _tlog() -> bytes:
    still = dict.fromkeys(("gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y"), 0.0)
    packer, blob = parser(1, AUTOPILOT), b""
    for t in T_S:
        for message in messages_of(round(1e6 * t), {**still, "acc_z": -9.80665}, 4):
            frame = message.pack(packer)
            packer.seq = (packer.seq + 1) % 256
            blob += stamped(1_700_000_000_000_000 + round(1e6 * t), frame)
    return blob


@cache
def _blackbox() -> bytes:
    still = np.zeros(len(T_S))
    main: dict[str, ArrayLike] = {"time": BOOT_US + 1e6 * T_S}
    main |= {f"gyroADC[{k}]": still for k in range(3)}
    main |= {"accSmooth[0]": still, "accSmooth[1]": still, "accSmooth[2]": still + 2048}
    return blackbox(Part(main))


@cache
def _ros(suffix: str) -> bytes:
    imu = [{"linear_acceleration": {"x": 0.0, "y": 0.0, "z": 9.80665}}] * len(T_S)
    return bag([Messages("/imu", "sensor_msgs/msg/Imu", np.asarray(T_S, np.float64), imu)], suffix)


SAMPLES: dict[str, Callable[[], bytes]] = {
    "ROS 2 bag, MCAP": lambda: _ros(".mcap"),
    "ROS 2 bag, SQLite": lambda: _ros(".db3"),
    "Betaflight Blackbox log": _blackbox,
    "MAVLink telemetry log": _tlog,
    "flight table, Arrow stream": _stream,
    "Crazyflie uSD log, version 1": lambda: _crazyflie(1),
    "Crazyflie uSD log, version 2": lambda: _crazyflie(2),
    "PX4 ULog": _ulog,
    "ArduPilot DataFlash": _dataflash,
    "ArduPilot DataFlash, text": lambda: _dataflash(text=True),
    "flight table, Parquet": _parquet,
    "flight table, CSV": _csv,
}
"""By name of the format."""


def foreign(log: Path, folder: Path) -> Path:
    """A copy of a PX4 log whose rate controller does not have the gain that flew it."""
    blob, name = log.read_bytes(), b"float MC_PITCHRATE_P"
    at = blob.index(name) + len(name)
    (gain,) = struct.unpack_from("<f", blob, at)
    path = folder / "foreign.ulg"
    path.write_bytes(blob[:at] + struct.pack("<f", 4 * gain) + blob[at + 4 :])
    return path
