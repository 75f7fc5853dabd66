"""A flight as MCAP: read back by the package `mcap`, valid, the numbers and the frames the same."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cli_rig import run
from log_rigs.dataflash_rig import dataflash
from sample_logs import FLOWN_PARAMS, flown_messages
from series_rigs.mcap_rig import Read, read_mcap

from twin.errors import TwinError
from twin.frames import to_ned
from twin.logs import Finding, Flight, read_flight
from twin.logs.columns import COLUMNS
from uavtwin.series.mcap import FOXGLOVE, LOG, POSE, TF, TF_STATIC, TOPICS, write_flight_mcap

Array = np.ndarray
FIELDS = {"/pose", "/tf", "/tf_static", "/location", "/log"}


def flight(**columns: Any) -> Flight:
    n = len(next(iter(columns.values())))
    table = {"time": np.arange(n) * 0.1, **columns}
    return Flight("made_up", pd.DataFrame(table))


def written(tmp_path: Path, made: Flight) -> Read:
    write_flight_mcap(made, tmp_path / "flight.mcap")
    return read_mcap(tmp_path / "flight.mcap")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash(flown_messages(), FLOWN_PARAMS))
    return path


@pytest.mark.slow
def test_a_log_comes_back_number_by_number(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path
) -> None:
    """Every sample of every column, at its time in ns, and nothing else; twice the same bytes."""
    outs = [tmp_path / f"{name}.mcap" for name in "ab"]
    for out in outs:
        code, said, _ = run(capsys, "convert", log, "--out", out)
        assert code in (0, 1) and f"written: {out}" in said  # 1: the log has findings
    assert outs[0].read_bytes() == outs[1].read_bytes()
    read, before = read_mcap(outs[0]), read_flight(log)
    compared = 0
    for topic in TOPICS:
        for name in read.schemas.get(topic, {"properties": ()})["properties"]:
            found = read.column(topic, name)
            wanted = before.table[["time", name]].dropna()
            assert list(found.values()) == wanted[name].to_list()
            np.testing.assert_allclose(np.array(list(found)) * 1e-9, wanted["time"], atol=1e-9)
            compared += 1
    assert compared == sum(before.has(str(c)) for c in before.table) - 2  # time and phase
    assert before.facts.items() <= read.notes["flight"].items()
    assert read.notes["units"]["acc_x"] == "m/s^2"


def test_every_column_has_one_topic() -> None:
    told = [c for columns in TOPICS.values() for c in columns]
    angles = {"roll_rad", "pitch_rad", "yaw_rad"}  # become q at reading
    assert sorted(told) == sorted({c.name for c in COLUMNS} - {"time", "phase"} - angles)
    assert not FIELDS & set(TOPICS)


def turned(rotation: dict[str, float], vector: Array) -> Array:
    return np.array(to_ned([rotation[k] for k in "wxyz"], list(vector)))


def placed(read: Read, vector: Array) -> Array:
    """A vector of `base_link` in `map`, through the chain of frames as Foxglove goes through it."""
    frames = [f for _, m in read.messages[TF_STATIC] for f in m["transforms"]]
    frames += [m for _, m in read.messages[TF]]
    by_child = {f["child_frame_id"]: f for f in frames}
    child = "base_link"
    while child != "map":
        frame = by_child[child]
        vector = turned(frame["rotation"], vector) + [frame["translation"][a] for a in "xyz"]
        child = frame["parent_frame_id"]
    return vector


def test_frames_stand_as_the_aircraft_does(tmp_path: Path) -> None:
    """2 m up, 3 m north, 1 m west, its nose to the east: in `map`, x is east and z is up."""
    half = np.sqrt(0.5)
    pose = {"pos_x": 3.0, "pos_y": -1.0, "pos_z": -2.0, "q_w": half, "q_x": 0.0, "q_y": 0.0}
    read = written(tmp_path, flight(**{k: [v] for k, v in (pose | {"q_z": half}).items()}))
    origin, nose, left, up = (placed(read, v) for v in (np.zeros(3), *np.eye(3)))
    np.testing.assert_allclose(origin, [-1, 3, 2], atol=1e-12)
    np.testing.assert_allclose(nose - origin, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(left - origin, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(up - origin, [0, 0, 1], atol=1e-12)
    (_, told), (_, frame) = read.messages[POSE][0], read.messages[TF][0]
    assert told["frame_id"] == frame["parent_frame_id"] == "ned"
    assert told["pose"]["position"] == {"x": 3.0, "y": -1.0, "z": -2.0}
    assert told["pose"]["orientation"] == frame["rotation"]


def test_a_pose_is_told_where_its_position_is_known(tmp_path: Path) -> None:
    """Between two positions on a straight line; not outside them, nor in a hole of over 1 s."""
    n, hole = 40, range(20, 34)
    known = np.array([k % 5 == 0 and k not in hole for k in range(n)])
    x = np.where(known, np.arange(n) * 0.5, np.nan)
    none = np.zeros(n)
    made = flight(
        **{"pos_x": x, "pos_y": np.where(known, 0, np.nan), "pos_z": np.where(known, 0, np.nan)},
        **{"q_w": none + 1, "q_x": none, "q_y": none, "q_z": none},
    )
    poses = {t: m["pose"]["position"]["x"] for t, m in written(tmp_path, made).messages[POSE]}
    rows = [*range(16), 35]
    assert list(poses) == [k * 100_000_000 for k in rows]
    np.testing.assert_allclose(list(poses.values()), np.array(rows) * 0.5, atol=1e-12)


def test_phases_and_findings_are_log_messages(tmp_path: Path) -> None:
    made = flight(acc_x=[0.0, 1.0, 2.0, 3.0], phase=["", "hover", "hover", ""])
    made = replace(made, findings=(Finding("warning", "acc", "doubtful", 3),))
    told = [(t, m["level"], m["message"]) for t, m in written(tmp_path, made).messages[LOG]]
    assert told == [
        (0, 3, "acc: doubtful (3)"),
        (100_000_000, 2, "phase: hover"),
        (300_000_000, 2, "phase: unknown"),
    ]


def test_names_and_fields_are_those_foxglove_knows() -> None:
    """As its pages list them, https://docs.foxglove.dev/docs/sdk/schemas."""
    fields = {s["title"]: list(s["properties"]) for s in FOXGLOVE.values()}
    transform = ["timestamp", "parent_frame_id", "child_frame_id", "translation", "rotation"]
    assert fields == {
        "foxglove.FrameTransform": transform,
        "foxglove.FrameTransforms": ["transforms"],
        "foxglove.PoseInFrame": ["timestamp", "frame_id", "pose"],
        "foxglove.LocationFix": [
            *("timestamp", "frame_id", "latitude", "longitude", "altitude"),
            *("position_covariance", "position_covariance_type"),
        ],
        "foxglove.Log": ["timestamp", "level", "message", "name", "file", "line"],
    }


def test_times_before_the_record_are_refused(tmp_path: Path) -> None:
    made = flight(acc_x=[0.0, 1.0])
    early = replace(made, table=made.table.assign(time=[-1.5, 0.0]))
    with pytest.raises(TwinError, match=r"made_up: begins 1\.5 s before .* Write \.parquet"):
        written(tmp_path, early)


def test_without_the_package_the_error_says_how_to_get_it(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    log: Path,
) -> None:
    """Before the log is read, and nothing is written."""
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    code, _, said = run(capsys, "convert", tmp_path / "none.bin", "--out", tmp_path / "x.mcap")
    assert code == 2 and "pip install 'mcap>=" in said
    assert not (tmp_path / "x.mcap").exists()
