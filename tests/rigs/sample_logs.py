"""A small valid file of every log format: two seconds at rest, made from nothing."""

import io
from collections.abc import Callable

import numpy as np
import pandas as pd
from ulog_writer import ulog

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
