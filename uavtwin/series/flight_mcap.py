"""A flight as MCAP: pose with Foxglove's schemas, every column of the flight table to plot.

Frames, right-handed all: `ned` of navigation and `frd` of the body are those of the flight table.
Foxglove takes any, and draws z upwards; `/tf_static` therefore hangs `ned` into `map`, x east,
y north, z up, and gives the body a `base_link`, x forward, y left, z up, as ROS has them (REP 103).
In the 3D panel, `map` is the frame to display.

Times are those of the table, from the start of the record: flights keep no clock of GNSS.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.logs import Finding, Flight
from twin.logs.columns import ACC, ACC_NED, COLUMNS, GYRO, MAG, POS, QUAT, VEL, motor_number

from .mcap_file import (
    McapFile,
    PlotTopics,
    Schema,
    check_times,
    mcap_file,
    timestamp,
)
from .table import nanoseconds

Array = NDArray[np.float64]
TOPICS: Mapping[str, tuple[str, ...]] = {
    "/imu": (*ACC, *GYRO),
    "/magnetometer": MAG,
    "/barometer": ("baro_pa",),
    "/position": POS,
    "/velocity": VEL,
    "/attitude": QUAT,
    "/acceleration": ACC_NED,
    "/motors": ("cmd_{i}", "rotor_{i}"),
    "/battery": ("vbat_v", "ibat_a"),
}
"""Columns of the flight table by topic; fields of the messages are called as the columns."""
TF, TF_STATIC, POSE, LOG = "/tf", "/tf_static", "/pose", "/log"
LONGEST_STEP_S = 1.0
"""Between two positions; the pose between those farther apart is not told."""
MEANINGS: Mapping[str, str] = {
    TF: "`ned` to `frd`, where the attitude has a sample and the position samples around it that "
    f"are at most {LONGEST_STEP_S:g} s apart; the position is on a straight line between them",
    TF_STATIC: "`map` to `ned`, `frd` to `base_link`, at the first instant",
    POSE: "the same in `ned`",
    LOG: "phases where they begin; what the reader counted or doubts, at the first instant",
}
"""Of the topics that are no plain numbers."""
MAP, NED, FRD, BASE_LINK = "map", "ned", "frd", "base_link"
_HALF = float(np.sqrt(0.5))
_STATIC = (
    (MAP, NED, {"x": _HALF, "y": _HALF, "z": 0.0, "w": 0.0}),  # x <-> y, z turned over
    (FRD, BASE_LINK, {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}),  # half a turn about x
)
_ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}
_LEVELS = {"info": 2, "warning": 3, "error": 4}
_BLOCK_ROWS = 1 << 12


def _object(title: str, **fields: Schema) -> Schema:
    """Schema of an object that has all of these fields."""
    return {"title": title, "type": "object", "properties": fields, "required": list(fields)}


_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_TIME = _object(
    "time",
    sec={"type": "integer", "minimum": 0},
    nsec={"type": "integer", "minimum": 0, "maximum": 999_999_999},
)
_VECTOR = _object("foxglove.Vector3", **dict.fromkeys("xyz", _NUMBER))
_QUATERNION = _object("foxglove.Quaternion", **dict.fromkeys("xyzw", _NUMBER))
_TRANSFORM = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
FOXGLOVE: Mapping[str, Schema] = {
    TF: _TRANSFORM,
    TF_STATIC: _object(
        "foxglove.FrameTransforms", transforms={"type": "array", "items": _TRANSFORM}
    ),
    POSE: _object("foxglove.PoseInFrame", timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
    LOG: _object(
        "foxglove.Log",
        timestamp=_TIME,
        level={"type": "integer", "minimum": 0, "maximum": 5},
        message=_TEXT,
        name=_TEXT,
        file=_TEXT,
        line={"type": "integer", "minimum": 0},
    ),
}
"""Schemas by topic, with the names and fields by which Foxglove knows them:
https://docs.foxglove.dev/docs/sdk/schemas."""


def write_flight_mcap(flight: Flight, path: Path) -> None:
    """Write a flight; the same flight gives the same bytes.

    Facts of the log go into a record of metadata, phases and findings into `/log`.

    Args:
        flight: Its table.
        path: An existing one is replaced.

    Raises:
        TwinError: The package `mcap` is not installed, or a time is negative.
    """
    t_ns = nanoseconds(flight.time_s)
    check_times(flight.name, int(t_ns[0]))
    topics = plot_topics([c for c in flight.columns if flight.has(c)])
    columns = {c: flight.columns[c] for fields in topics.values() for c in fields}
    position = flight.signal(POS) if flight.has(*POS, *QUAT) else None
    codes, phases = flight.phase_codes
    told = ""
    with mcap_file(path) as file:
        plots = PlotTopics(file, topics)
        for topic in (LOG, *(() if position is None else (TF_STATIC, TF, POSE))):
            file.topic(topic, FOXGLOVE[topic])
        file.note("flight", {"name": flight.name, **flight.facts})
        file.note("units", {c: unit for f in topics.values() for c, (_, unit) in f.items()})
        _write_findings(file, int(t_ns[0]), flight.name, flight.findings)
        if position is not None:
            file.write(TF_STATIC, int(t_ns[0]), _static_frames(int(t_ns[0])))
        for start in range(0, len(t_ns), _BLOCK_ROWS):
            rows = slice(start, start + _BLOCK_ROWS)
            block = {c: v[rows] for c, v in columns.items()}
            poses = {} if position is None else _poses(flight.time_s[rows], block, *position)
            each = zip(t_ns[rows].tolist(), phases[codes[rows]], plots.rows(block), strict=True)
            for row, (t, phase, messages) in enumerate(each):
                if phase != told:
                    text = f"phase: {phase or 'unknown'}"
                    file.write(LOG, t, _log(t, _LEVELS["info"], text, flight.name))
                    told = phase
                if row in poses:
                    _write_pose(file, t, *poses[row])
                for topic, message in messages:
                    file.write(topic, t, message)


def plot_topics(columns: list[str]) -> dict[str, dict[str, tuple[str, str]]]:
    """Topics of those columns that a flight has: by column, its field and its unit."""
    units = {c.name: c.unit for c in COLUMNS}
    found: dict[str, dict[str, tuple[str, str]]] = {}
    for topic, names in TOPICS.items():
        for name in names:
            for column in columns:
                stem = column if motor_number(column) is None else column.split("_")[0] + "_{i}"
                if stem == name:
                    found.setdefault(topic, {})[column] = column, units[name]
    return found


def _poses(
    t_s: Array, block: Mapping[str, Array], pos_t_s: Array, positions: Array
) -> dict[int, tuple[dict[str, float], dict[str, float]]]:
    """Position and attitude by row, where there is a sample of the attitude; the position there is
    on a straight line between its samples."""
    q = np.column_stack([block[c] for c in QUAT])  # (n, 4)
    after = np.searchsorted(pos_t_s, t_s, side="left").clip(0, len(pos_t_s) - 1)
    before = np.where(pos_t_s[after] == t_s, after, np.maximum(after - 1, 0))
    near = (pos_t_s[after] >= t_s) & (pos_t_s[before] <= t_s)
    near &= pos_t_s[after] - pos_t_s[before] <= LONGEST_STEP_S
    there = np.column_stack([np.interp(t_s, pos_t_s, p) for p in positions.T])  # (n, 3)
    rows = np.flatnonzero(near & np.isfinite(q).all(axis=1))
    return {
        int(k): (
            dict(zip("xyz", there[k].tolist(), strict=True)),
            dict(zip("wxyz", q[k].tolist(), strict=True)),
        )
        for k in rows
    }


def _write_pose(file: McapFile, t_ns: int, pos: dict[str, float], q: dict[str, float]) -> None:
    """The same as a frame and as a pose."""
    file.write(TF, t_ns, _frame(t_ns, NED, FRD, pos, q))
    pose = {"position": pos, "orientation": q}
    file.write(POSE, t_ns, {"timestamp": timestamp(t_ns), "frame_id": NED, "pose": pose})


def _frame(
    t_ns: int, parent: str, child: str, translation: dict[str, float], rotation: dict[str, float]
) -> dict[str, Any]:
    """A message of the schema FrameTransform."""
    return {
        "timestamp": timestamp(t_ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": translation,
        "rotation": rotation,
    }


def _static_frames(t_ns: int) -> dict[str, Any]:
    """Frames that hold still, in one message: a tool that jumps keeps the last one of a topic."""
    return {"transforms": [_frame(t_ns, a, b, _ORIGIN, q) for a, b, q in _STATIC]}


def _log(t_ns: int, level: int, message: str, name: str) -> dict[str, Any]:
    """A message of the schema Log."""
    told = {"level": level, "message": message, "name": name, "file": "", "line": 0}
    return {"timestamp": timestamp(t_ns), **told}


def _write_findings(file: McapFile, t_ns: int, name: str, findings: tuple[Finding, ...]) -> None:
    """What the reader counted or doubts, at the first instant."""
    for f in findings:
        count = f" ({f.count})" if f.count > 1 else ""
        text = f"{f.where}: {f.message}{count}"
        file.write(LOG, t_ns, _log(t_ns, _LEVELS[f.severity], text, name))
