"""What Foxglove knows by name: schemas, frames, poses, log messages.

Frames, right-handed all: `ned` of navigation and `frd` of the body are those of the flight table.
Foxglove takes any, and draws z upwards; `/tf_static` therefore hangs `ned` into `map`, x east,
y north, z up, and gives the body a `base_link`, x forward, y left, z up, as ROS has them (REP 103).
In the 3D panel, `map` is the frame to display.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twin.logs.flight import Severity

from .mcap_file import McapFile, Schema, timestamp

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


class PoseTopics:
    """The pose of a body as a frame and as a pose, and the frames that hold still."""

    def __init__(self, file: McapFile) -> None:
        """Declare the topics."""
        self._file, self._begun = file, False
        for topic in (TF_STATIC, TF, POSE):
            file.topic(topic, FOXGLOVE[topic])

    def begin(self, t_ns: int) -> None:
        """Write the frames that hold still, in one message: a tool that jumps in time keeps the
        last one of a topic."""
        still = [_frame(t_ns, a, b, _ORIGIN, q) for a, b, q in _STATIC]
        self._file.write(TF_STATIC, t_ns, {"transforms": still})

    def write(self, t_ns: int, pos: Sequence[float], q: Sequence[float]) -> None:
        """Write a pose.

        Args:
            t_ns: Time.
            pos: NED, m.
            q: Body to NED, `[w, x, y, z]`.
        """
        place, turn = dict(zip("xyz", pos, strict=True)), dict(zip("wxyz", q, strict=True))
        pose = {"position": place, "orientation": turn}
        self._file.write(TF, t_ns, _frame(t_ns, NED, FRD, place, turn))
        told = {"timestamp": timestamp(t_ns), "frame_id": NED, "pose": pose}
        self._file.write(POSE, t_ns, told)


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


def log_message(t_ns: int, severity: Severity, message: str, name: str) -> dict[str, Any]:
    """A message of the schema Log.

    Args:
        t_ns: Time.
        severity: Of a finding.
        message: Text.
        name: Of what it is about.
    """
    told = {"level": _LEVELS[severity], "message": message, "name": name, "file": "", "line": 0}
    return {"timestamp": timestamp(t_ns), **told}
