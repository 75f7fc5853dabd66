"""Indoors or outdoors: what a log says, and what a flight table keeps."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import ArrayLike
from sample_logs import ulog

from twin.explain.explanation import sited
from twin.logs import Flight, Site, read_flight, write_flight

T = 0.01 + 0.01 * np.arange(100)
Topics = dict[str, dict[str, ArrayLike]]


def attitude() -> Topics:
    q = np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (100, 1))
    return {"vehicle_attitude": {"t": T, "q": q}}


def gps(fix: int, since: int = 0) -> Topics:
    kinds = np.where(np.arange(100) >= since, fix, 0).astype(np.uint8)
    return {"vehicle_gps_position": {"t": T, "fix_type": kinds}}


def odometry(name: str) -> Topics:
    return {name: {"t": T, "x": np.zeros(100, dtype=np.float32)}}


CASES: dict[str, tuple[Topics, dict[str, float], bool | None]] = {
    "nothing": ({}, {}, None),
    "fix": (gps(3), {}, False),
    "fix from the middle on": (gps(4, since=30), {}, False),
    "receiver without a fix": (gps(1), {}, None),
    "receiver without a fix, cameras": (gps(1) | odometry("vehicle_visual_odometry"), {}, True),
    "motion capture": (odometry("vehicle_mocap_odometry"), {}, True),
    "fix and cameras": (gps(3) | odometry("vehicle_visual_odometry"), {}, False),
    "estimator takes vision": ({}, {"EKF2_AID_MASK": 24}, True),
    "estimator takes satellites": ({}, {"EKF2_AID_MASK": 1}, None),
    "vision allowed from the factory on": ({}, {"EKF2_EV_CTRL": 15}, None),
}


@pytest.mark.parametrize("case", CASES)
def test_a_px4_log_says_where_it_flew(case: str, tmp_path: Path) -> None:
    topics, params, indoors = CASES[case]
    path = tmp_path / "log.ulg"
    path.write_bytes(ulog(attitude() | topics, params))
    flight = read_flight(path)
    assert flight.indoors is indoors
    assert (flight.site is None) == (indoors is None)


@pytest.mark.slow
@pytest.mark.parametrize(("log", "indoors"), [("real_3", True), ("sim_1", False)])
def test_recorded_logs_say_where_they_flew(data_dir: Path, log: str, indoors: bool) -> None:
    assert read_flight(data_dir / "rflysimdt" / f"{log}.ulg").indoors is indoors


def test_a_flight_table_keeps_it(tmp_path: Path) -> None:
    table = pd.DataFrame({"time": [0.0, 0.1], "acc_x": 0.0, "acc_y": 0.0, "acc_z": -9.8})
    for site in (Site(True, "a hall"), Site(False, "a meadow"), None):
        write_flight(Flight("f", table, site=site), tmp_path / "f.parquet")
        assert read_flight(tmp_path / "f.parquet").site == site


def test_what_somebody_says_comes_before_what_the_log_says() -> None:
    flight = Flight("f", pd.DataFrame({"time": [0.0]}), site=Site(False, "a fix"))
    assert sited(flight, True).indoors is True
    assert sited(flight, None).site == flight.site
