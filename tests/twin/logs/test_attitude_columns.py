"""Euler angles and world acceleration in a flight table."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from twin.errors import LogError
from twin.frames import from_euler, rotation_vector
from twin.logs import Flight, read_flight
from twin.logs.columns import ACC_NED, EULER, QUAT


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
    flight = read(tmp_path, roll_rad=0.0, pitch_rad=0.0, gyro_x=0.0, gyro_y=0.0, gyro_z=0.0)
    assert not flight.has("q_w")
    assert any("lack yaw_rad" in f.message for f in flight.findings)


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
