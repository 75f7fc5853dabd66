"""A flight whose signals fit is left alone, each change to it is told."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import cumulative_trapezoid

from twin.frames import from_euler, multiply, to_body
from twin.logs import Finding, read_flight

HZ = 100
N = 30 * HZ


def flown() -> pd.DataFrame:
    """Half a minute to and fro at 3 m height: exact kinematics, noise where sensors have it."""
    t = np.arange(N) / HZ
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
    table[["acc_x", "acc_y", "acc_z"]] = acc + 0.1 * rng.standard_normal((N, 3))
    table[["gyro_x", "gyro_y", "gyro_z"]] = rates + 0.01 * rng.standard_normal((N, 3))
    table[["pos_x", "pos_y", "pos_z"]] = pos
    table[["vel_x", "vel_y", "vel_z"]] = vel
    table[["q_w", "q_x", "q_y", "q_z"]] = q.T
    table["baro_pa"] = 101325.0 + 12.0 * pos[:, 2] + rng.standard_normal(N)
    table["phase"] = "tour"
    return table


def found(table: pd.DataFrame, folder: Path) -> list[Finding]:
    path = folder / "flight.parquet"
    table.to_parquet(path)
    return list(read_flight(path).findings)


def random_attitude(f: pd.DataFrame) -> None:
    q = np.random.default_rng(2).standard_normal((len(f), 4))
    f[["q_w", "q_x", "q_y", "q_z"]] = q / np.linalg.norm(q, axis=1, keepdims=True)


def late(f: pd.DataFrame, columns: list[str], rows: int) -> None:
    f[columns] = f[columns].shift(rows)


def height(f: pd.DataFrame) -> None:
    f["pos_z"] *= -1.0


def height_and_climb(f: pd.DataFrame) -> None:
    height(f)
    f["vel_z"] *= -1.0


def height_alone(f: pd.DataFrame) -> None:
    height(f)
    f[["vel_x", "vel_y", "vel_z"]] = np.nan


def scaled(stem: str, factor: float) -> Callable[[pd.DataFrame], None]:
    def change(f: pd.DataFrame) -> None:
        f[[c for c in f if c.startswith(stem)]] *= factor

    return change


def set_in(column: str, value: float) -> Callable[[pd.DataFrame], None]:
    def change(f: pd.DataFrame) -> None:
        f.loc[700:703, column] = value

    return change


def no_gravity(f: pd.DataFrame) -> None:
    f["acc_z"] += 9.80665


def other_axes(f: pd.DataFrame) -> None:
    f[["acc_y", "acc_z"]] *= -1.0


def sideways(f: pd.DataFrame) -> None:
    f[["vel_x", "vel_y"]] = f[["vel_y", "vel_x"]].to_numpy()


def conjugated(f: pd.DataFrame) -> None:
    f[["q_x", "q_y", "q_z"]] *= -1.0


def gone(columns: list[str]) -> Callable[[pd.DataFrame], None]:
    def change(f: pd.DataFrame) -> None:
        f.loc[1000:1030, columns] = np.nan

    return change


def frozen(columns: list[str]) -> Callable[[pd.DataFrame], None]:
    def change(f: pd.DataFrame) -> None:
        f.loc[1000:, columns] = f.loc[1000, columns].to_numpy()

    return change


GYRO, QUAT = ["gyro_x", "gyro_y", "gyro_z"], ["q_w", "q_x", "q_y", "q_z"]
ACC, VEL = ["acc_x", "acc_y", "acc_z"], ["vel_x", "vel_y", "vel_z"]
CHANGES: dict[str, tuple[Callable[[pd.DataFrame], None], str, str]] = {
    "acc 1e308": (set_in("acc_z", 1e308), "acc", "beyond 2000"),
    "vel 1e10": (scaled("vel", 1e10), "vel", "in mm/s"),
    "pos 1e9": (scaled("pos", 1e9), "pos", "beyond 1e+06"),
    "attitude at random": (random_attitude, "q", "does not turn with the gyroscope"),
    "attitude conjugated": (conjugated, "q", "body to NED"),
    "gyro doubled": (scaled("gyro", 3.0), "q", "times as fast): is a unit wrong"),
    "position in mm": (scaled("pos", 1e3), "vel", "in mm or cm"),
    "position in cm": (scaled("pos", 1e2), "vel", "in mm or cm"),
    "velocity in other axes": (sideways, "vel", "another frame"),
    "without gravity": (no_gravity, "acc", "without gravity"),
    "axes forward-left-up": (other_axes, "acc", "FLU"),
    "height up": (height, "vel", "opposite signs"),
    "height up and climb": (height_and_climb, "pos", "is it a height"),
    "height up alone": (height_alone, "pos", "is it a height"),
    "a gap of the gyroscope": (gone(GYRO), "gyro", "gaps, the longest of 0.32 s"),
    "a gap of the attitude": (gone(QUAT), "q", "gaps, the longest of 0.32 s"),
    "a frozen gyroscope": (frozen(GYRO), "gyro", "stands still from 10.00 to 29.99"),
    "a frozen attitude": (frozen(QUAT), "q", "stands still"),
    "a frozen accelerometer": (frozen(ACC), "acc", "stands still"),
    "a frozen velocity": (frozen(VEL), "vel", "stands still"),
    "commands that overflow": (set_in("cmd_2", 1.07), "cmd", "overflows"),
}


def test_signals_that_fit_raise_no_doubt(tmp_path: Path) -> None:
    assert found(flown(), tmp_path) == []


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_told(name: str, tmp_path: Path) -> None:
    change, where, text = CHANGES[name]
    table = flown()
    change(table)
    told = [f for f in found(table, tmp_path) if f.severity != "info"]
    assert [f for f in told if f.where == where and text in f.message], told


def test_the_motors_idle_before_a_height(tmp_path: Path) -> None:
    """Without pressure, velocity or phases: on the ground at first."""
    table = flown()[["time", "cmd_1", "cmd_2", "cmd_3", "cmd_4", "pos_x", "pos_y", "pos_z"]]
    table = table.copy()
    table.loc[:300, [f"cmd_{i}" for i in range(1, 5)]] = 0.0
    table.loc[:300, "pos_z"] = 0.0
    assert [f for f in found(table, tmp_path) if "motors on" in f.message] == []
    table["pos_z"] *= -1.0
    assert [f for f in found(table, tmp_path) if "higher with the motors on" in f.message]


def test_overflowing_commands_end_at_one_and_others_are_refused(tmp_path: Path) -> None:
    table = flown()
    table.loc[700:703, "cmd_2"] = (1.02, 1.3, -0.01, 1.0)
    path = tmp_path / "f.csv"
    table.to_csv(path, index=False)
    flight = read_flight(path)
    assert [(f.where, f.count) for f in flight.findings] == [("cmd", 3)]
    np.testing.assert_array_equal(flight.table.loc[700:703, "cmd_2"], (1.0, 1.0, 0.0, 1.0))


def test_the_flight_is_exact() -> None:
    """What the tests above start from: rates turn the attitude, force moves the body."""
    f = flown()
    way = cumulative_trapezoid(f["vel_x"], f["time"], initial=0.0)
    np.testing.assert_allclose(f["pos_x"] - f["pos_x"][0], way, atol=1e-3)
