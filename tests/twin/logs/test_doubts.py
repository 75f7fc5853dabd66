"""A flight whose signals fit is left alone, each change to it is told."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from sample_logs import flown_table
from scipy.integrate import cumulative_trapezoid

from twin.frames import multiply, to_body
from twin.logs import Finding, read_flight
from twin.logs.agreement import turns
from twin.logs.doubts import doubts


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


def ends(columns: list[str]) -> Callable[[pd.DataFrame], None]:
    def change(f: pd.DataFrame) -> None:
        f.loc[2300:, columns] = np.nan

    return change


def begins(columns: list[str]) -> Callable[[pd.DataFrame], None]:
    def change(f: pd.DataFrame) -> None:
        f.loc[:1599, columns] = np.nan

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
    "gyro in deg/s": (scaled("gyro", 57.3), "q", "times as fast): is a unit wrong"),
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
    "a gyroscope that ends": (ends(GYRO), "gyro", "ends at 22.99 s, 7 s before the record"),
    "a velocity that ends": (ends(VEL), "vel", "ends at 22.99 s, 7 s before the record"),
    "a velocity that begins late": (begins(VEL), "vel", "begins at 16.00 s, 16 s after the record"),
    "a frozen gyroscope": (frozen(GYRO), "gyro", "stands still from 10.00 to 29.99"),
    "a frozen attitude": (frozen(QUAT), "q", "stands still"),
    "a frozen accelerometer": (frozen(ACC), "acc", "stands still"),
    "a frozen velocity": (frozen(VEL), "vel", "stands still"),
    "commands that overflow": (set_in("cmd_2", 1.07), "cmd", "overflows"),
}


@pytest.mark.parametrize("signal", ["gyro", "acc", "vel", "q", "cmd"])
def test_a_signal_that_never_changes_is_named(signal: str, tmp_path: Path) -> None:
    table = flown_table()
    for column in [c for c in table if c.startswith(f"{signal}_")]:
        table[column] = float(table[column].iloc[1500])
    first, last = table["time"].iloc[[0, -1]]
    span = f"stands still from {first:.2f} to {last:.2f} s, all of its samples"
    assert span in [f.message for f in found(table, tmp_path) if f.where == signal]


def test_a_flight_in_which_nothing_moves_is_named(tmp_path: Path) -> None:
    table = flown_table()
    for column in [c for c in table if c not in ("time", "phase")]:
        table[column] = float(table[column].iloc[1500])
    messages = [f.message for f in found(table, tmp_path) if f.where == "flight"]
    assert len(messages) == 1 and messages[0].startswith("nothing of the motion changes")


def test_signals_that_fit_raise_no_doubt(tmp_path: Path) -> None:
    assert found(flown_table(), tmp_path) == []


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_told(name: str, tmp_path: Path) -> None:
    change, where, text = CHANGES[name]
    table = flown_table()
    change(table)
    told = [f for f in found(table, tmp_path) if f.severity != "info"]
    assert [f for f in told if f.where == where and text in f.message], told


@pytest.mark.parametrize("degrees", [45, 90, -90, 180, -35])
def test_an_imu_mounted_at_an_angle_is_named_with_it(degrees: float, tmp_path: Path) -> None:
    table, angle = flown_table(), np.radians(degrees)
    for kind in ("gyro", "acc"):
        x, y = table[f"{kind}_x"].copy(), table[f"{kind}_y"].copy()
        table[f"{kind}_x"] = np.cos(angle) * x + np.sin(angle) * y
        table[f"{kind}_y"] = np.cos(angle) * y - np.sin(angle) * x
    (message,) = [f.message for f in found(table, tmp_path) if f.where == "gyro"]
    told = float(message.removeprefix("turned by ").partition(" ")[0])
    assert abs((told - degrees + 180) % 360 - 180) <= 1.0


@pytest.mark.parametrize("change", [{"gyro_y": -1.0}, {"gyro_y": -1.0, "gyro_z": -1.0}])
def test_axes_that_are_mirrored_are_no_mounting(change: dict[str, float], tmp_path: Path) -> None:
    """The second: forward, left, up."""
    table = flown_table()
    for column, sign in change.items():
        table[column] *= sign
    told = found(table, tmp_path)
    assert told and not [f for f in told if "mounted" in f.message]


def hovering(turn: float, sign: float = 1.0, bias: float = 0.0) -> pd.DataFrame:
    """A flight of half a minute that yaws and drifts by a little; `turn` in rad."""
    t = 0.01 * np.arange(3000)
    rng = np.random.default_rng(0)
    angle, rate = turn * np.sin(0.9 * t), 0.9 * turn * np.cos(0.9 * t)
    columns: dict[str, Any] = {"time": t, "gyro_x": 0.0 * t, "gyro_y": 0.0 * t}
    columns["gyro_z"] = sign * rate + bias + 0.002 * rng.standard_normal(len(t))
    columns |= {"q_w": np.cos(angle / 2), "q_x": 0.0 * t, "q_y": 0.0 * t, "q_z": np.sin(angle / 2)}
    columns |= {f"pos_{k}": angle for k in "xyz"} | {f"vel_{k}": sign * rate for k in "xyz"}
    return pd.DataFrame(columns)


def test_a_hover_that_hardly_moves_is_compared_too(tmp_path: Path) -> None:
    """0.04 rad and 4 cm to and fro."""
    assert found(hovering(0.04), tmp_path) == []
    told = {(f.where, f.message[:20]) for f in found(hovering(0.04, -1.0), tmp_path)}
    assert ("q", "does not turn with t") in told
    assert ("vel", "vel_x and the slope ") in told


def test_a_gyroscope_that_is_off_at_rest_is_no_doubt(tmp_path: Path) -> None:
    """2 deg/s of bias, and an attitude that stands."""
    assert found(hovering(1e-4, bias=0.035), tmp_path) == []


def test_the_motors_idle_before_a_height(tmp_path: Path) -> None:
    """Without pressure, velocity or phases: on the ground at first."""
    table = flown_table()[["time", "cmd_1", "cmd_2", "cmd_3", "cmd_4", "pos_x", "pos_y", "pos_z"]]
    table = table.copy()
    table.loc[:300, [f"cmd_{i}" for i in range(1, 5)]] = 0.0
    table.loc[:300, "pos_z"] = 0.0
    assert [f for f in found(table, tmp_path) if "motors on" in f.message] == []
    table["pos_z"] *= -1.0
    assert [f for f in found(table, tmp_path) if "higher with the motors on" in f.message]


@pytest.mark.slow
def test_overflowing_commands_end_at_one_and_others_are_refused(tmp_path: Path) -> None:
    table = flown_table()
    table.loc[700:703, "cmd_2"] = (1.02, 1.3, -0.01, 1.0)
    path = tmp_path / "f.csv"
    table.to_csv(path, index=False)
    flight = read_flight(path)
    assert [(f.where, f.count) for f in flight.findings] == [("cmd", 3)]
    np.testing.assert_array_equal(flight.table.loc[700:703, "cmd_2"], (1.0, 1.0, 0.0, 1.0))


def test_the_flight_is_exact() -> None:
    """What the tests above start from: rates turn the attitude, force moves the body."""
    f = flown_table()
    way = cumulative_trapezoid(f["vel_x"], f["time"], initial=0.0)
    np.testing.assert_allclose(f["pos_x"] - f["pos_x"][0], way, atol=1e-3)


def turn_heading(f: pd.DataFrame, since: int, by_rad: float) -> None:
    """The attitude from a row on, turned about the vertical."""
    q = f.loc[since:, ["q_w", "q_x", "q_y", "q_z"]].to_numpy().T
    step = (np.cos(by_rad / 2.0), 0.0, 0.0, np.sin(by_rad / 2.0))
    f.loc[since:, ["q_w", "q_x", "q_y", "q_z"]] = np.stack(multiply(step, list(q)), axis=1)


def test_an_estimator_that_resets_its_yaw_is_not_doubted(tmp_path: Path) -> None:
    """One step of 1.5 rad is more than all that the flight turns; ten of them are no resets."""
    table = flown_table()
    turn_heading(table, 1000, 1.5)
    assert not [f for f in found(table, tmp_path) if f.where == "q"]
    for k in range(10):
        turn_heading(table, 1100 + 150 * k, 1.5)
    assert [f for f in found(table, tmp_path) if f.where == "q" and f.severity == "error"]


def columns(table: pd.DataFrame) -> dict[str, NDArray[Any]]:
    """A table by column."""
    return {str(c): table[c].to_numpy() for c in table}


def test_the_kinematic_residual_of_a_gyroscope_that_is_off() -> None:
    """An offset of the gyroscope is what attitude and gyroscope differ by; a reset is not."""
    table = flown_table()
    turn_heading(table, 1000, 1.5)
    sound = turns(columns(table))
    table["gyro_y"] += 0.05
    off = turns(columns(table))
    assert sound is not None and off is not None
    assert sound.residual_rad_s.max() < 2e-3  # noise of 0.01 rad/s over 50 samples
    np.testing.assert_allclose(off.residual_rad_s[1], 0.05, rtol=0.03)


# -- one axis -------------------------------------------------------------------------------

FAULTS: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = {
    "negated": lambda v: -v,
    "scaled by 0.3": lambda v: 0.3 * v,
    "scaled by 3": lambda v: 3.0 * v,
    "frozen from the start": lambda v: np.full_like(v, v[0]),
    "frozen from the middle": lambda v: np.where(np.arange(len(v)) < 1500, v, v[1500]),
}
FIELD_T = np.array((2.1e-5, 0.3e-5, 4.2e-5))


def with_compass() -> pd.DataFrame:
    """The flight with a compass of 0.2 uT noise and a bias, its nose turning by a radian."""
    table = flown_table()
    t = table["time"].to_numpy()
    q = np.stack(
        multiply(
            [np.cos(0.5 * np.sin(0.3 * t)), 0 * t, 0 * t, np.sin(0.5 * np.sin(0.3 * t))],
            list(table[QUAT].to_numpy().T),
        )
    )
    field = to_body(list(q), [np.full(len(t), f) for f in FIELD_T])
    noise = 2e-7 * np.random.default_rng(4).standard_normal((3, len(t)))
    for k, axis in enumerate("xyz"):
        table[f"mag_{axis}"] = field[k] + noise[k] + 3e-6 * k
    table[QUAT] = q.T
    return table.drop(columns=[*GYRO, *ACC])


def doubted(table: pd.DataFrame) -> list[Finding]:
    return doubts(columns(table))


def test_a_compass_that_fits_is_not_doubted() -> None:
    assert doubted(with_compass()) == []


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("stem", ["gyro", "acc", "vel", "pos", "mag"])
def test_a_fault_of_one_axis_is_a_finding(stem: str, axis: str, fault: str) -> None:
    table = with_compass() if stem == "mag" else flown_table()
    column = f"{stem}_{axis}"
    table[column] = FAULTS[fault](table[column].to_numpy())
    assert doubted(table), column


@pytest.mark.parametrize("stem", ["gyro", "acc", "vel", "pos", "mag"])
@pytest.mark.parametrize("pair", ["xy", "xz", "yz"])
def test_two_axes_that_are_swapped_are_a_finding(stem: str, pair: str) -> None:
    table = with_compass() if stem == "mag" else flown_table()
    one, other = (f"{stem}_{a}" for a in pair)
    table[[one, other]] = table[[other, one]].to_numpy()
    assert doubted(table)


@pytest.mark.parametrize("fault", ["scaled by 0.3", "frozen from the start"])
@pytest.mark.parametrize("stem", ["cmd", "rotor"])
def test_a_fault_of_one_motor_is_a_finding(stem: str, fault: str) -> None:
    table = flown_table()
    if stem == "rotor":
        for i in range(1, 5):
            table[f"rotor_{i}"] = 800 * table[f"cmd_{i}"]
    assert doubted(table) == []
    table[f"{stem}_2"] = FAULTS[fault](table[f"{stem}_2"].to_numpy())
    assert [f for f in doubted(table) if f"{stem}_2" in f.message]


def test_a_motor_at_its_limit_is_not_frozen() -> None:
    table = flown_table()
    table.loc[1000:1600, "cmd_2"] = 1.0
    assert not [f for f in doubted(table) if "keeps" in f.message]


def test_a_single_fall_does_not_decide(tmp_path: Path) -> None:
    """A hover, and one second of which the accelerometer reads a third."""
    table = flown_table()
    hover = np.abs(table["time"] - 15) > 1.0
    scale = np.where(hover, 0.01, 1.0)
    t = table["time"].to_numpy()
    rng = np.random.default_rng(2)
    level = {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}
    pushed = scale * 6.0 * np.sin(3.0 * t)
    speed = cumulative_trapezoid(pushed, t, initial=0.0)
    table = table.assign(**level, vel_x=speed, vel_y=0.0 * t, vel_z=0.0 * t)
    table = table.drop(columns=["pos_x", "pos_y", "pos_z", *GYRO])
    table["acc_x"] = np.where(hover, 1.0, 0.3) * pushed + 0.02 * rng.standard_normal(len(t))
    table["acc_y"] = 0.02 * rng.standard_normal(len(t))
    table["acc_z"] = -9.80665 + 0.02 * rng.standard_normal(len(t))
    assert not [f for f in doubted(table) if f.where == "acc"]
