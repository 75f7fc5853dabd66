"""One flight, written with the definitions of each release: the same flight table comes out.

Definitions are those of PX4's msg/*.msg at the releases, of the fields that are read.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sample_logs import flown_table, ulog

from twin.logs import Flight, read_flight
from twin.logs.px4.imu import from_px4_interval

TABLE = flown_table()
T = TABLE["time"].to_numpy() + 0.01
SLOW = slice(None, None, 4)
DT_S = 0.004
"""Over which the sensors average: their stamps are those of its end."""
Topics = dict[str, dict[str, Any]]


def part(*columns: str, rows: slice = slice(None)) -> Any:
    return TABLE[list(columns)].to_numpy(dtype=np.float32)[rows]


def combined(kind: type, unit: float, mag: bool = False, pressure: str = "") -> Topics:
    """sensor_combined since 1.5: its averaging times in this type and unit, s."""
    dt: Any = np.full(len(T), DT_S / unit).astype(kind)
    fields: dict[str, Any] = {
        "t": T + DT_S / 2,
        "gyro_rad": part("gyro_x", "gyro_y", "gyro_z"),
        "gyro_integral_dt": dt,
        "accelerometer_timestamp_relative": np.zeros(len(T), dtype=np.int32),
        "accelerometer_m_s2": part("acc_x", "acc_y", "acc_z"),
        "accelerometer_integral_dt": dt,
    }
    if mag:  # the same sample in four rows, 20 ms old in the first
        held = np.arange(len(T)) // 4 * 4
        since = np.round(1e6 * (T[held] - (T + DT_S / 2))).astype(np.int32)
        fields["magnetometer_timestamp_relative"] = since
        fields["magnetometer_ga"] = gauss()[held]
        fields["baro_timestamp_relative"] = since
        fields["baro_alt_meter"] = np.full(len(T), 400.0, dtype=np.float32)
        if pressure:
            fields[pressure] = part("baro_pa")[held, 0]
    return {"sensor_combined": fields}


def gauss() -> Any:
    turn = 0.05 * np.sin(T)
    return np.column_stack([0.22 + turn, -0.02 + turn, 0.43 + 0.0 * T]).astype(np.float32)


def of_2016() -> Topics:
    """sensor_combined before 1.5: three sensors side by side, and stamps of each."""
    stamp = np.round(1e6 * T).astype(np.uint64) + 1_000_000
    held = np.arange(len(T)) // 4 * 4
    zero = np.zeros((len(T), 6), dtype=np.float32)
    fields = {
        "t": T,
        "gyro_rad_s": np.hstack([part("gyro_x", "gyro_y", "gyro_z"), zero]),
        "accelerometer_m_s2": np.hstack([part("acc_x", "acc_y", "acc_z"), zero]),
        "accelerometer_timestamp": np.repeat(stamp[:, None], 3, axis=1),
        "magnetometer_ga": np.hstack([gauss()[held], zero]),
        "magnetometer_timestamp": np.repeat(stamp[held][:, None], 3, axis=1),
        "baro_pres_mbar": np.repeat(part("baro_pa")[held] / 100.0, 3, axis=1),
        "baro_timestamp": np.repeat(stamp[held][:, None], 3, axis=1),
    }
    return {"sensor_combined": fields}


def increments(names: tuple[str, ...], kind: type) -> Topics:
    """vehicle_imu without sensor_combined."""
    fields = {
        "t": T + DT_S / 2 + 0.001,
        "timestamp_sample": np.round(1e6 * (T + DT_S / 2)).astype(np.uint64) + 1_000_000,
        "delta_angle": part("gyro_x", "gyro_y", "gyro_z") * np.float32(DT_S),
        "delta_velocity": part("acc_x", "acc_y", "acc_z") * np.float32(DT_S),
        **{n: np.full(len(T), DT_S * 1e6).astype(kind) for n in names},
    }
    return {"vehicle_imu": fields}


def slow_sensors() -> Topics:
    return {
        "vehicle_magnetometer": {"t": T[SLOW], "magnetometer_ga": gauss()[SLOW]},
        "vehicle_air_data": {"t": T[SLOW], "baro_pressure_pa": part("baro_pa")[SLOW, 0]},
    }


def estimate() -> Topics:
    course = {
        n: part(c)[SLOW, 0]
        for n, c in zip(
            ("x", "y", "z", "vx", "vy", "vz"),
            ("pos_x", "pos_y", "pos_z", "vel_x", "vel_y", "vel_z"),
            strict=True,
        )
    }
    return {
        "vehicle_attitude": {"t": T[SLOW], "q": part("q_w", "q_x", "q_y", "q_z")[SLOW]},
        "vehicle_local_position": {"t": T[SLOW], **course},
    }


def outputs() -> tuple[Topics, Mapping[str, float]]:
    pwm = np.zeros((len(T[SLOW]), 16), dtype=np.float32)
    pwm[:, :4] = 1000.0 + 1000.0 * part("cmd_1", "cmd_2", "cmd_3", "cmd_4")[SLOW]
    return {
        "actuator_outputs": {
            "t": T[SLOW],
            "noutputs": np.full(len(T[SLOW]), 4, dtype=np.uint32),
            "output": pwm,
        }
    }, {"MAV_TYPE": 2}


def motors(count: int) -> tuple[Topics, Mapping[str, float]]:
    control = np.full((len(T[SLOW]), count), np.nan, dtype=np.float32)
    control[:, :4] = part("cmd_1", "cmd_2", "cmd_3", "cmd_4")[SLOW]
    return {"actuator_motors": {"t": T[SLOW], "control": control}}, {"CA_ROTOR_COUNT": 4}


def pwm(*names: str) -> dict[str, float]:
    return dict(zip(names, (1000, 2000), strict=True))


def battery(**others: Any) -> Topics:
    n = len(T[SLOW])
    return {
        "battery_status": {
            "t": T[SLOW],
            "voltage_v": (16.4 - 0.02 * T[SLOW]).astype(np.float32),
            "current_a": (12.0 + np.sin(T[SLOW])).astype(np.float32),
            "connected": np.ones(n, dtype=np.uint8),
            **{k: np.full(n, v) for k, v in others.items()},
        }
    }


def satellites(modern: bool) -> Topics:
    n = len(T[::40])
    where: dict[str, Any] = (
        {
            "latitude_deg": np.full(n, 47.3),
            "longitude_deg": np.full(n, 8.5),
            "altitude_ellipsoid_m": np.full(n, 450.0),
        }
        if modern
        else {
            "lat": np.full(n, 473_000_000, dtype=np.int32),
            "lon": np.full(n, 85_000_000, dtype=np.int32),
            "alt_ellipsoid": np.full(n, 450_000, dtype=np.int32),
        }
    )
    fix = {"t": T[::40], "fix_type": np.full(n, 3, dtype=np.uint8)}
    name = "sensor_gps" if modern else "vehicle_gps_position"
    return {name: {**fix, **where, "time_utc_usec": np.full(n, 1_600_000_000_000_000, np.uint64)}}


US, S = (np.uint32, 1e-6), (np.float32, 1.0)
OLD = pwm("PWM_MIN", "PWM_MAX")
MAIN = pwm("PWM_MAIN_MIN", "PWM_MAIN_MAX")
FUNCTIONS = {f"PWM_MAIN_FUNC{k}": 100 + k for k in range(1, 5)} | {
    f"PWM_MAIN_{end}{k}": value
    for end, value in (("MIN", 1000), ("MAX", 2000))
    for k in range(1, 5)
}
Made = tuple[
    tuple[int, int, int], Topics, tuple[Topics, Mapping[str, float]], Mapping[str, float], bool
]
RELEASES: dict[str, Callable[[], Made]] = {
    "1.4": lambda: ((1, 4, 4), of_2016(), outputs(), OLD, False),
    "1.5 to 1.7": lambda: (
        (1, 7, 3),
        combined(*S, mag=True, pressure="baro_pressure_pa"),
        outputs(),
        OLD,
        False,
    ),
    "1.8": lambda: ((1, 8, 2), combined(*US) | slow_sensors(), outputs(), OLD, False),
    "1.9": lambda: ((1, 9, 2), combined(*US) | slow_sensors(), outputs(), OLD, False),
    "1.10": lambda: ((1, 10, 1), combined(*US) | slow_sensors(), outputs(), OLD, False),
    "1.11": lambda: ((1, 11, 3), combined(*US) | slow_sensors(), outputs(), MAIN, False),
    "1.12": lambda: ((1, 12, 3), combined(*US) | slow_sensors(), outputs(), MAIN, False),
    "1.13": lambda: ((1, 13, 3), combined(*US) | slow_sensors(), outputs(), FUNCTIONS, False),
    "1.14": lambda: ((1, 14, 3), combined(*US) | slow_sensors(), motors(12), FUNCTIONS, True),
    "1.15": lambda: ((1, 15, 4), combined(*US) | slow_sensors(), motors(12), FUNCTIONS, True),
    "1.16": lambda: ((1, 16, 0), combined(*US) | slow_sensors(), motors(12), FUNCTIONS, True),
    "1.11, vehicle_imu": lambda: (
        (1, 11, 3),
        increments(("dt",), np.uint16) | slow_sensors(),
        outputs(),
        MAIN,
        False,
    ),
    "1.12, vehicle_imu": lambda: (
        (1, 12, 3),
        increments(("delta_angle_dt", "delta_velocity_dt"), np.uint16) | slow_sensors(),
        outputs(),
        MAIN,
        False,
    ),
    "1.14, vehicle_imu": lambda: (
        (1, 14, 3),
        increments(("delta_angle_dt", "delta_velocity_dt"), np.uint32) | slow_sensors(),
        motors(12),
        FUNCTIONS,
        True,
    ),
}


def written(name: str) -> bytes:
    release, sensors, (driven, told), params, modern = RELEASES[name]()
    topics = {
        **sensors,
        **estimate(),
        **driven,
        **battery(**({"id": np.uint8(1)} if modern else {})),
        **satellites(modern),
    }
    return ulog(topics, {**params, **told, "SYS_AUTOSTART": 4001}, release=release)


def read(folder: Path, blob: bytes) -> Flight:
    path = folder / "log.ulg"
    path.write_bytes(blob)
    return read_flight(path, rebuild_commands=False)


@pytest.mark.parametrize("name", RELEASES)
def test_the_same_flight_comes_out_of_every_release(tmp_path: Path, name: str) -> None:
    found = read(tmp_path, written(name))
    errors = [f.message for f in found.findings if f.severity == "error"]
    assert not errors
    assert not [f.message for f in found.findings if "averag" in f.message or "dt" in f.message]
    told = name.partition(",")[0].split()[-1]
    assert found.facts["firmware"].startswith(f"PX4 {told}.")
    assert found.airframe is not None and found.airframe.rotors is not None
    assert found.airframe.rotors.value == 4
    place = found.airframe.place
    assert place is not None
    assert np.degrees(place.value.latitude_rad) == pytest.approx(47.3)
    assert place.value.height_m == pytest.approx(450.0)
    sizes = {"acc": 2e-5, "gyro": 1e-6, "vel": 1e-6, "pos": 1e-5, "q": 1e-6, "cmd": 1e-6}
    for group, atol in sizes.items():
        columns = [c for c in map(str, TABLE) if c.startswith(f"{group}_")]
        t_s, values = found.signal(columns)
        row = np.round((t_s - 0.01) / 0.01).astype(int)
        np.testing.assert_allclose(t_s, 0.01 + 0.01 * row, atol=1.1e-6)
        np.testing.assert_allclose(values, TABLE[columns].to_numpy()[row], atol=atol)
        assert len(t_s) > 700, group
    for column, truth, atol in (
        ("mag_x", 1e-4 * gauss()[:, 0], 1e-10),
        ("baro_pa", part("baro_pa")[:, 0], 0.02),
        ("vbat_v", 16.4 - 0.02 * T, 1e-5),
        ("ibat_a", 12.0 + np.sin(T), 1e-5),
    ):
        t_s, values = found.signal([column])
        row = np.round((t_s - 0.01) / 0.01).astype(int)
        np.testing.assert_allclose(t_s, 0.01 + 0.01 * row, atol=1.1e-6)
        np.testing.assert_allclose(values[:, 0], truth[row], atol=atol)
        assert len(t_s) > 700, column


def test_a_height_by_pressure_is_not_made_a_pressure(tmp_path: Path) -> None:
    """1.5 to 1.7 log baro_alt_meter alone."""
    topics = combined(*S, mag=True) | estimate()
    found = read(tmp_path, ulog(topics, {"MAV_TYPE": 2}, release=(1, 7, 3)))
    assert not found.has("baro_pa")
    assert any("a height by pressure" in f.message for f in found.findings)


@pytest.mark.parametrize(
    ("values", "us"),
    [
        (np.array([0.004, 0.005], dtype=np.float32), [4000, 5000]),
        (np.array([4000, 5000], dtype=np.uint32), [4000, 5000]),
        (np.array([4000], dtype=np.uint16), [4000]),
        (np.array([np.nan, np.inf, 1e30], dtype=np.float32), [0, 0, 0]),
    ],
)
def test_the_type_of_an_interval_tells_its_unit(values: Any, us: list[int]) -> None:
    assert from_px4_interval(values).tolist() == us
