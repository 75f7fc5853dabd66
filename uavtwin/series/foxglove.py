"""What Foxglove knows by name: schemas, frames, poses, log messages.

Frames, right-handed all: `ned` of navigation and `frd` of the body are those of the flight table.
Foxglove takes any, and draws z upwards; `/tf_static` therefore hangs `ned` into `map`, x east,
y north, z up, and gives the body a `base_link`, x forward, y left, z up, as ROS has them (REP 103).
In the 3D panel, `map` is the frame to display.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.logs.airframe import Place
from twin.logs.flight import Severity
from twin.vehicle.geodesy import geodetic_of_ned

from .mcap_file import McapFile, Schema, timestamp

TF, TF_STATIC, POSE, LOG = "/tf", "/tf_static", "/pose", "/log"
LOCATION = "/location"
LONGEST_STEP_S = 1.0
"""Between two positions; the pose between those farther apart is not told."""
MEANINGS: Mapping[str, str] = {
    TF: "`ned` to `frd`, where the attitude has a sample and the position samples around it that "
    f"are at most {LONGEST_STEP_S:g} s apart; the position is on a straight line between them",
    TF_STATIC: "`map` to `ned`, `frd` to `base_link`, at the first instant",
    POSE: "the same in `ned`",
    LOCATION: "latitude and longitude, degrees, and height, m, where the position has a sample, of "
    "flights whose log tells the origin of its positions",
    LOG: "phases where they begin; what the reader counted or doubts, at the first instant",
}
"""Of the topics that are no plain numbers."""
Array = NDArray[np.float64]
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
    LOCATION: _object(
        "foxglove.LocationFix",
        timestamp=_TIME,
        frame_id=_TEXT,
        latitude=_NUMBER,
        longitude=_NUMBER,
        altitude=_NUMBER,
        position_covariance={"type": "array", "items": _NUMBER, "minItems": 9, "maxItems": 9},
        position_covariance_type={"type": "integer", "minimum": 0, "maximum": 3},
    ),
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


class LocationTopics:
    """Positions on the Earth, a topic for each side that has some; Foxglove's map shows them."""

    def __init__(
        self, file: McapFile, origin: Place | None, topics: Mapping[str, Sequence[str]]
    ) -> None:
        """Declare the topics.

        Args:
            file: To write into.
            origin: From where positions are counted; None: there are no topics.
            topics: Columns north, east and down, m, by topic.
        """
        self._file, self._origin = file, origin
        self._topics = {} if origin is None else dict(topics)
        for topic in self._topics:
            file.topic(topic, FOXGLOVE[LOCATION])

    def rows(self, columns: Mapping[str, Array], count: int) -> list[list[tuple[str, Array]]]:
        """Topics and places, degrees and m, by row; none where a position has no sample."""
        found: list[list[tuple[str, Array]]] = [[] for _ in range(count)]
        for topic, names in self._topics.items():
            assert self._origin is not None
            position = np.column_stack([columns[c] for c in names])
            known = np.flatnonzero(np.isfinite(position).all(axis=1))
            o = self._origin
            told = geodetic_of_ned(position[known], o.latitude_rad, o.longitude_rad, o.height_m)
            told[:, :2] = np.degrees(told[:, :2])
            for row, place in zip(known.tolist(), told, strict=True):
                found[row].append((topic, place))
        return found

    def write(self, t_ns: int, places: Sequence[tuple[str, Array]]) -> None:
        """Write what `rows` found at an instant."""
        for topic, place in places:
            told = dict(zip(("latitude", "longitude", "altitude"), place.tolist(), strict=True))
            unknown = {"position_covariance": [0.0] * 9, "position_covariance_type": 0}
            fix = {"timestamp": timestamp(t_ns), "frame_id": NED, **told, **unknown}
            self._file.write(topic, t_ns, fix)


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
