"""Euler angles and world acceleration in a flight table."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from twin.errors import LogError
from twin.frames import from_euler, rotation_vector, to_ned
from twin.logs import Flight, read_flight
from twin.logs.attitude import TILT_HZ
from twin.logs.columns import ACC_NED, EULER, POS, QUAT, VEL
from twin.logs.table import write_flight
from twin.vehicle import GRAVITY_M_S2


def read(folder: Path, **columns: object) -> Flight:
    """A table of a second with these columns, as CSV."""
    frame = pd.DataFrame({"time": 0.01 * np.arange(100), **columns})
    path = folder / "flight.csv"
    frame.to_csv(path, index=False)
    return read_flight(path)


def angles(n: int = 100) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {c: rng.uniform(-1.5, 1.5, n) for c in EULER}


def turned(given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    q = from_euler(*(given[c] for c in EULER))
    return dict(zip(QUAT, q, strict=True))


def test_euler_angles_become_the_quaternion(tmp_path: Path) -> None:
    given = angles()
    flight = read(tmp_path, **given)
    assert not {*EULER} & {*flight.table}
    apart = rotation_vector(
        flight.table[[*QUAT]].to_numpy(), np.column_stack([*turned(given).values()])
    )
    assert np.abs(apart).max() < 1e-12
    nose_up = read(tmp_path, roll_rad=0.0, pitch_rad=0.3, yaw_rad=0.0).table
    assert nose_up["q_y"][0] == pytest.approx(np.sin(0.15))  # about the axis to the right


def test_where_there_are_both_they_must_agree(tmp_path: Path) -> None:
    given = angles()
    assert read(tmp_path, **given, **turned(given)).has(*QUAT)
    flipped = {**given, "pitch_rad": -given["pitch_rad"]}
    with pytest.raises(LogError, match="rad apart"):
        read(tmp_path, **flipped, **turned(given))


def test_degrees_are_refused_and_a_part_of_an_attitude_is_not_used(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="degrees"):
        read(tmp_path, **{c: np.degrees(v) for c, v in angles().items()})
    counted = angles() | {"yaw_rad": angles()["yaw_rad"] + 4 * np.pi}
    with pytest.raises(LogError, match=r"yaw_rad.* whole ones, of 2 pi"):
        read(tmp_path, **counted)
    flight = read(tmp_path, roll_rad=0.0, pitch_rad=0.0, gyro_x=0.0, gyro_y=0.0, gyro_z=0.0)
    assert not flight.has("q_w")
    assert any("lack yaw_rad" in f.message for f in flight.findings)
    assert flight.derived_angles == ()


def test_an_angle_that_is_missing_leaves_the_attitude_out(tmp_path: Path) -> None:
    given = angles()
    given["yaw_rad"][::2] = np.nan
    flight = read(tmp_path, **given)
    assert flight.table["q_w"].notna().sum() == 50
    assert any(f.where == "attitude" and f.count == 50 for f in flight.findings)


def test_world_acceleration_is_read_and_gravity_in_it_is_doubted(tmp_path: Path) -> None:
    still = dict.fromkeys(ACC_NED, 0.01)
    assert read(tmp_path, **still).has(*ACC_NED)
    assert not [f for f in read(tmp_path, **still).findings if f.severity == "error"]
    doubts = read(tmp_path, **{**still, "acc_ned_z": -9.8}).findings
    assert any(f.where == "acc_ned" and "gravity" in f.message for f in doubts)


# -- angles that are not logged ---------------------------------------------------------------

T = 0.01 * np.arange(600)
"""Six seconds, whose first and last second is left to the filters."""
INSIDE = slice(100, 500)


def swaying(heading: float = 0.0) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Angles of a slow sway, and what rotors alone do to it: acceleration, velocity, position."""
    euler = dict(zip(EULER, (0.2 * np.sin(2 * T), 0.3 * np.cos(T), heading + 0 * T), strict=True))
    push = -GRAVITY_M_S2 - 0.5 * np.sin(1.5 * T)
    force = np.array(to_ned(list(from_euler(*euler.values())), [0 * T, 0 * T, push]))
    force[2] += GRAVITY_M_S2
    moved = dict(zip(ACC_NED, force, strict=True))
    for columns, of in ((VEL, ACC_NED), (POS, VEL)):
        for c, f in zip(columns, of, strict=True):
            rate = moved[f]
            moved[c] = np.concatenate([[0.0], np.cumsum(0.005 * (rate[1:] + rate[:-1]))])
    return euler, moved


def told(folder: Path, euler: dict[str, np.ndarray], **columns: object) -> tuple[Flight, float]:
    """A flight of six seconds, and the largest angle between its attitude and the true one."""
    path = folder / "sway.csv"
    pd.DataFrame({"time": T, **columns}).to_csv(path, index=False)
    flight = read_flight(path)
    read_q = flight.table[[*QUAT]].to_numpy()
    apart = rotation_vector(read_q, from_euler(*euler.values()).T)
    return flight, float(np.abs(apart[INSIDE]).max())


@pytest.mark.parametrize("missing", [("pitch_rad",), ("roll_rad",), ("roll_rad", "pitch_rad")])
@pytest.mark.parametrize("shown", [ACC_NED, VEL, POS])
def test_a_tilt_that_is_not_logged_is_where_the_thrust_points(
    tmp_path: Path, missing: tuple[str, ...], shown: tuple[str, ...]
) -> None:
    euler, moved = swaying(0.7)
    kept = {c: v for c, v in euler.items() if c not in missing}
    flight, apart = told(tmp_path, euler, **kept, **{c: moved[c] for c in shown})
    assert apart < 2e-3
    assert flight.derived_angles == missing
    (text,) = [f.message for f in flight.findings if f.where == "attitude"]
    assert "not told without it" in text
    assert all(c in text for c in missing)


def test_without_any_angle_the_nose_points_north(tmp_path: Path) -> None:
    euler, moved = swaying()
    flight, apart = told(tmp_path, euler, **{c: moved[c] for c in VEL})
    assert flight.derived_angles == EULER
    assert apart < 2e-3


def test_without_an_acceleration_a_missing_angle_is_level(tmp_path: Path) -> None:
    euler, _ = swaying()
    kept = {c: euler[c] for c in ("roll_rad", "yaw_rad")}
    flight, apart = told(tmp_path, {**euler, "pitch_rad": 0 * T}, **kept)
    assert flight.derived_angles == ("pitch_rad",)
    assert apart < 1e-9
    assert any("any force" in f.message for f in flight.findings)


def test_an_imu_needs_no_angle_that_is_made_up(tmp_path: Path) -> None:
    euler, moved = swaying()
    pd.DataFrame(
        {"time": T, **moved, "roll_rad": euler["roll_rad"], "gyro_x": 0, "gyro_y": 0, "gyro_z": 0}
    ).to_csv(tmp_path / "imu.csv", index=False)
    flight = read_flight(tmp_path / "imu.csv")
    assert not flight.has("q_w")
    assert flight.derived_angles == ()


def test_a_tilt_faster_than_thrust_turns_is_not_made_up(tmp_path: Path) -> None:
    euler, moved = swaying()
    shaking = {c: v + 3.0 * np.sin(2 * np.pi * 6 * TILT_HZ * T) for c, v in moved.items()}
    _, apart = told(tmp_path, euler, **{c: shaking[c] for c in ACC_NED})
    assert apart < 0.01


def test_derived_angles_are_known_of_a_copy_and_other_names_are_read(tmp_path: Path) -> None:
    euler, moved = swaying()
    world = {c.replace("_ned_", "_world_"): moved[c] for c in ACC_NED}
    kept = {c: euler[c] for c in ("roll_rad", "yaw_rad")}
    flight, apart = told(tmp_path, euler, **kept, **world)
    assert apart < 2e-3
    assert any("acc_world_x" in f.message for f in flight.findings)
    write_flight(flight, tmp_path / "copy.parquet")
    assert read_flight(tmp_path / "copy.parquet").derived_angles == ("pitch_rad",)
    pd.DataFrame({"time": T, **kept, **world}).to_parquet(tmp_path / "given.parquet")
    assert read_flight(tmp_path / "given.parquet").has(*ACC_NED, *QUAT)
