"""A small valid file of every log format: two seconds at rest, made from nothing; ULogs of any
content, so that tests need no recorded flight."""

import io
import struct
from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

# -- ULog -----------------------------------------------------------------------------------

_TYPES = {"u1": "uint8_t", "u2": "uint16_t", "u4": "uint32_t", "i4": "int32_t", "u8": "uint64_t"}
_TYPES |= {"f4": "float", "b1": "bool"}


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
) -> bytes:
    """Bytes of a ULog.

    Args:
        topics: Per topic its fields; `t` is the time stamp in s after the start; two-dimensional
            fields become arrays. `name:1` is instance 1 of `name`.
        params: Parameters; int or float decides the type.
        start_us: Time of the start of the log, us.
        release: Firmware version.
    """
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", start_us)]
    out.append(ulog_message(b"B", bytes(40)))
    key = b"uint32_t ver_sw_release"
    number = release[0] << 24 | release[1] << 16 | release[2] << 8 | 255
    out.append(ulog_message(b"I", bytes([len(key)]) + key + struct.pack("<I", number)))
    for name, value in (params or {}).items():
        kind = "int32_t" if isinstance(value, int) else "float"
        key = f"{kind} {name}".encode()
        code = "<i" if isinstance(value, int) else "<f"
        out.append(ulog_message(b"P", bytes([len(key)]) + key + struct.pack(code, value)))
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
    rows.sort(key=lambda r: r[0])
    return b"".join([*out, *added, *(r[1] for r in rows)])


# -- every format ---------------------------------------------------------------------------

T_S = 0.004 + 0.004 * np.arange(500)


def flight_table() -> pd.DataFrame:
    """At rest: gravity on the accelerometer, nothing on the gyroscope."""
    still = {name: np.zeros(len(T_S)) for name in ("gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y")}
    return pd.DataFrame({"time": T_S, **still, "acc_z": np.full(len(T_S), -9.80665)})


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


SAMPLES: dict[str, Callable[[], bytes]] = {
    "PX4 ULog": _ulog,
    "flight table, Parquet": _parquet,
    "flight table, CSV": _csv,
}
"""By name of the format."""
