"""MCAP files of JSON messages for Foxglove and PlotJuggler.

Needs the package `mcap`, imported where a file is written. Format: https://mcap.dev/spec. Equal
messages give equal bytes with the same versions of `mcap` and `zstandard`.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import TwinError, install_command
from twin.logs import Finding, Flight
from twin.logs.airframe import Place, origin_of
from twin.logs.columns import ACC_NED, COLUMNS, POS, QUAT, VEL, motor_number
from twin.logs.flight import Severity
from twin.logs.samples import interpolated
from twin.physics.sensors.table import SENSORS, components_of_sensors
from twin.vehicle.earth import geodetic_of_ned

if TYPE_CHECKING:
    from mcap.writer import Writer

Schema = dict[str, Any]
NS = 1_000_000_000  # in a second


def nanoseconds(t_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Times in integer nanoseconds."""
    return np.rint(np.asarray(t_s, dtype=np.float64) * NS).astype(np.int64)


def check_mcap() -> None:
    """Refuse to write MCAP where it is not possible, before long computations.

    Raises:
        TwinError: The package is not installed; the text says how to install it.
    """
    _writer()


def _writer() -> "type[Writer]":
    """The writer class of the package.

    Raises:
        TwinError: The package is not installed.
    """
    try:
        from mcap.writer import Writer
    except ModuleNotFoundError as error:
        raise TwinError(
            f"{error.name} is not installed; MCAP needs it: {install_command('mcap')}. Parquet and "
            f"CSV need nothing."
        ) from error
    return Writer


class McapFile:
    """Topics and messages of one file, written as they arrive."""

    def __init__(self, file: IO[bytes]) -> None:
        """Start a file; `mcap_file` ends it."""
        self._file = _writer()(file)
        self._schemas: dict[str, int] = {}
        self._topics: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._file.start(profile="", library="uavtwin")

    def topic(self, name: str, schema: Schema) -> None:
        """Declare a topic.

        Args:
            name: Name, beginning with "/".
            schema: JSON schema of its messages; its `title` is the name in other tools.
        """
        title = schema["title"]
        if title not in self._schemas:
            data = _json(schema)
            self._schemas[title] = self._file.register_schema(title, "jsonschema", data)
        self._topics[name] = self._file.register_channel(name, "json", self._schemas[title])
        self._counts[name] = 0

    def write(self, topic: str, t_ns: int, message: Mapping[str, Any]) -> None:
        """Write a message.

        Args:
            topic: Name of a declared topic.
            t_ns: Time of logging and of publishing, from the start of the record.
            message: Message of the schema; every number must be finite.
        """
        data = _json(message)
        count = self._counts[topic]
        self._file.add_message(self._topics[topic], t_ns, data, t_ns, count)
        self._counts[topic] = count + 1

    def note(self, name: str, texts: Mapping[str, str]) -> None:
        """Write a record of metadata."""
        self._file.add_metadata(name, dict(texts))

    def end(self) -> None:
        """Write the index."""
        self._file.finish()  # type: ignore[no-untyped-call]


def _json(content: Mapping[str, Any]) -> bytes:
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode("utf-8", "backslashreplace")


@contextmanager
def mcap_file(path: Path) -> Iterator[McapFile]:
    """A file that is complete at the end of the context.

    Args:
        path: Path of the file; an existing one is replaced.

    Raises:
        TwinError: The package `mcap` is not installed.
    """
    _writer()
    with path.open("wb") as file:
        written = McapFile(file)
        yield written
        written.end()


def timestamp(t_ns: int) -> dict[str, int]:
    """A time in the form of a message."""
    return {"sec": t_ns // NS, "nsec": t_ns % NS}


def check_times(name: str, first_ns: int) -> None:
    """Refuse times that MCAP cannot represent.

    Raises:
        TwinError: One is negative.
    """
    if first_ns < 0:
        raise TwinError(
            f"{name}: begins {-first_ns / NS:g} s before the start of its record; times of MCAP "
            "are not negative. Write .parquet or .csv, or let `time` begin at 0."
        )


def plot_schema(title: str, units: Mapping[str, str]) -> Schema:
    """Schema of messages of plain numbers, each omitted where it has no sample.

    Args:
        title: Title of the schema.
        units: Units by field.
    """
    fields = {name: {"type": "number", "description": unit} for name, unit in units.items()}
    return {"title": title, "type": "object", "properties": fields, "additionalProperties": False}


class PlotTopics:
    """Topics of plain numbers: columns that are combined in one message where they are sampled."""

    def __init__(self, file: McapFile, topics: Mapping[str, Mapping[str, tuple[str, str]]]) -> None:
        """Declare the topics.

        Args:
            file: File to write.
            topics: Fields by topic: name and unit of the field, by column.
        """
        self._file, self._topics = file, topics
        for topic, fields in topics.items():
            units = dict(fields.values())
            file.topic(topic, plot_schema("uavtwin" + topic.replace("/", "."), units))

    def rows(
        self, columns: Mapping[str, NDArray[np.float64]]
    ) -> Iterator[list[tuple[str, dict[str, float]]]]:
        """Messages of some rows.

        Args:
            columns: Values by column, all of equal length.

        Yields:
            Topics and messages of each row; none without samples.
        """
        parts = []
        for topic, fields in self._topics.items():
            values = np.column_stack([columns[c] for c in fields])
            known = np.isfinite(values)
            names = [name for name, _ in fields.values()]
            parts.append(
                (topic, names, values.tolist(), known.tolist(), np.any(known, axis=1).tolist())
            )
        for row in range(len(parts[0][2]) if parts else 0):
            found = []
            for topic, names, values, known, there in parts:
                if there[row]:
                    each = zip(names, values[row], known[row], strict=True)
                    found.append((topic, {n: v for n, v, ok in each if ok}))
            yield found


# -- Foxglove -----------------------------------------------------------------------------------
#
# Names defined by Foxglove: schemas, frames, poses, log messages.
#
# Frames, all right-handed: `ned` of navigation and `frd` of the body are those of the flight table.
# Foxglove accepts any, and draws z upwards; `/tf_static` therefore places `ned` in `map`, x east, y
# north, z up, and gives the body a `base_link`, x forward, y left, z up, as in ROS (REP 103). In
# the 3D panel, `map` is the frame to display.

TF, TF_STATIC, POSE, LOG = "/tf", "/tf_static", "/pose", "/log"  # topics
LOCATION = "/location"  # topic
LONGEST_STEP_S = 1.0
"""Longest time between two positions over which the pose is interpolated."""
MEANINGS: Mapping[str, str] = {
    TF: "`ned` to `frd`, where the attitude has a sample and the position samples around it that "
    f"are at most {LONGEST_STEP_S:g} s apart; the position is on a straight line between them",
    TF_STATIC: "`map` to `ned`, `frd` to `base_link`, at the first instant",
    POSE: "the same in `ned`",
    LOCATION: "latitude and longitude, degrees, and height, m, where the position has a sample, of "
    "flights whose log has the origin of its positions",
    LOG: "phases where they begin; what the reader counted or doubts, at the first instant",
}
"""Description of the topics that are no plain numbers."""
Array = NDArray[np.float64]
MAP, NED, FRD, BASE_LINK = "map", "ned", "frd", "base_link"  # frames
_HALF = float(np.sqrt(0.5))  # sine of 45 degrees
_STATIC = (
    (MAP, NED, {"x": _HALF, "y": _HALF, "z": 0.0, "w": 0.0}),  # x <-> y, z reversed
    (FRD, BASE_LINK, {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}),  # half a turn about x
)  # frames that are fixed in their parents
_ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}  # origin of a frame
_LEVELS = {"info": 2, "warning": 3, "error": 4}  # foxglove.Log


def _object(title: str, **fields: Schema) -> Schema:
    """Schema of an object with all of these fields."""
    return {"title": title, "type": "object", "properties": fields, "required": list(fields)}


# Schemas, https://docs.foxglove.dev/docs/visualization/message-schemas
_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_TIME = _object(
    "time",
    sec={"type": "integer", "minimum": 0},
    nsec={"type": "integer", "minimum": 0, "maximum": 999_999_999},
)  # schema
_VECTOR = _object("foxglove.Vector3", **dict.fromkeys("xyz", _NUMBER))  # schema
_QUATERNION = _object("foxglove.Quaternion", **dict.fromkeys("xyzw", _NUMBER))  # schema
_TRANSFORM = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)  # schema
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)  # schema
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
"""Schemas by topic, with the names and fields that Foxglove recognises:
https://docs.foxglove.dev/docs/sdk/schemas."""


class PoseTopics:
    """The pose of a body as a frame and as a pose, and the fixed frames."""

    def __init__(self, file: McapFile) -> None:
        """Declare the topics."""
        self._file, self._begun = file, False
        for topic in (TF_STATIC, TF, POSE):
            file.topic(topic, FOXGLOVE[topic])

    def begin(self, t_ns: int) -> None:
        """Write the fixed frames, in one message: after a jump in time a tool uses the last message
        of a topic."""
        still = [_frame(t_ns, a, b, _ORIGIN, q) for a, b, q in _STATIC]
        self._file.write(TF_STATIC, t_ns, {"transforms": still})

    def write(self, t_ns: int, pos: Sequence[float], q: Sequence[float]) -> None:
        """Write a pose.

        Args:
            t_ns: Time.
            pos: Position, NED, m.
            q: Attitude, body to NED, `[w, x, y, z]`.
        """
        place, turn = dict(zip("xyz", pos, strict=True)), dict(zip("wxyz", q, strict=True))
        pose = {"position": place, "orientation": turn}
        self._file.write(TF, t_ns, _frame(t_ns, NED, FRD, place, turn))
        stamped = {"timestamp": timestamp(t_ns), "frame_id": NED, "pose": pose}
        self._file.write(POSE, t_ns, stamped)


class LocationTopics:
    """Positions on the Earth, a topic for each side with a position; shown on Foxglove's map."""

    def __init__(
        self, file: McapFile, origin: Place | None, topics: Mapping[str, Sequence[str]]
    ) -> None:
        """Declare the topics.

        Args:
            file: File to write.
            origin: Origin of positions; None: there are no topics.
            topics: Columns north, east and down, m, by topic.
        """
        self._file, self._origin = file, origin
        self._topics = {} if origin is None else dict(topics)
        for topic in self._topics:
            file.topic(topic, FOXGLOVE[LOCATION])

    def rows(self, columns: Mapping[str, Array], count: int) -> list[list[tuple[str, Array]]]:
        """Topics and positions, degrees and m, by row; none where a position has no sample."""
        found: list[list[tuple[str, Array]]] = [[] for _ in range(count)]
        for topic, names in self._topics.items():
            assert self._origin is not None
            position = np.column_stack([columns[c] for c in names])
            known = np.flatnonzero(np.isfinite(position).all(axis=1))
            o = self._origin
            geodetic = geodetic_of_ned(position[known], o.latitude_rad, o.longitude_rad, o.height_m)
            geodetic[:, :2] = np.degrees(geodetic[:, :2])
            for row, place in zip(known.tolist(), geodetic, strict=True):
                found[row].append((topic, place))
        return found

    def write(self, t_ns: int, places: Sequence[tuple[str, Array]]) -> None:
        """Write the result of `rows` at one time."""
        for topic, place in places:
            where = dict(zip(("latitude", "longitude", "altitude"), place.tolist(), strict=True))
            unknown = {"position_covariance": [0.0] * 9, "position_covariance_type": 0}
            fix = {"timestamp": timestamp(t_ns), "frame_id": NED, **where, **unknown}
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
        severity: Severity of a finding.
        message: Text.
        name: Subject of the message.
    """
    entry = {"level": _LEVELS[severity], "message": message, "name": name, "file": "", "line": 0}
    return {"timestamp": timestamp(t_ns), **entry}


# -- a flight -----------------------------------------------------------------------------------
#
# A flight as MCAP: pose with Foxglove's schemas, every column of the flight table for plots.
#
# Times are those of the table, from the start of the record: flights have no GNSS time.

TOPICS: Mapping[str, tuple[str, ...]] = {
    **{
        f"/{component}": tuple(c for s in SENSORS if s.component == component for c in s.columns)
        for component in components_of_sensors()
    },
    "/position": POS,
    "/velocity": VEL,
    "/attitude": QUAT,
    "/acceleration": ACC_NED,
    "/motors": ("cmd_{i}", "rotor_{i}"),
    "/battery": ("vbat_v", "ibat_a"),
}
"""Columns of the flight table by topic; fields of the messages have the names of the columns."""
_BLOCK_ROWS = 1 << 12  # rows in memory at once


def write_flight_mcap(flight: Flight, path: Path) -> None:
    """Write a flight; equal flights give equal bytes.

    Facts of the log are written to a metadata record, phases and findings to `/log`.

    Args:
        flight: Flight with the table.
        path: Path of the file; an existing one is replaced.

    Raises:
        TwinError: The package `mcap` is not installed, or a time is negative.
    """
    t_ns = nanoseconds(flight.time_s)
    check_times(flight.name, int(t_ns[0]))
    topics = plot_topics([c for c in flight.columns if flight.has(c)])
    columns = {c: flight.columns[c] for fields in topics.values() for c in fields}
    position = flight.signal(POS) if flight.has(*POS, *QUAT) else None
    codes, phases = flight.phase_codes
    written = ""
    with mcap_file(path) as file:
        plots = PlotTopics(file, topics)
        file.topic(LOG, FOXGLOVE[LOG])
        pose = None if position is None else PoseTopics(file)
        placed = {LOCATION: POS} if flight.has(*POS) else {}
        places = LocationTopics(file, origin_of(flight.airframe), placed)
        file.note("flight", {"name": flight.name, **flight.facts})
        file.note("units", {c: unit for f in topics.values() for c, (_, unit) in f.items()})
        _write_findings(file, int(t_ns[0]), flight.name, flight.findings)
        if pose is not None:
            pose.begin(int(t_ns[0]))
        for start in range(0, len(t_ns), _BLOCK_ROWS):
            rows = slice(start, start + _BLOCK_ROWS)
            block = {c: v[rows] for c, v in columns.items()}
            poses = {} if position is None else _poses(flight.time_s[rows], block, *position)
            of_rows = places.rows(block, len(t_ns[rows]))
            each = zip(t_ns[rows].tolist(), phases[codes[rows]], plots.rows(block), strict=True)
            for row, (t, phase, messages) in enumerate(each):
                places.write(t, of_rows[row])
                if phase != written:
                    text = f"phase: {phase or 'unknown'}"
                    file.write(LOG, t, log_message(t, "info", text, flight.name))
                    written = phase
                if pose is not None and row in poses:
                    pose.write(t, *poses[row])
                for topic, message in messages:
                    file.write(topic, t, message)


def plot_topics(columns: list[str]) -> dict[str, dict[str, tuple[str, str]]]:
    """Topics of the columns of a flight: field and unit by column."""
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
) -> dict[int, tuple[list[float], list[float]]]:
    """Position and attitude by row, where the attitude has a sample; the position is interpolated
    linearly between its samples."""
    q = np.column_stack([block[c] for c in QUAT])  # (n, 4)
    after = np.searchsorted(pos_t_s, t_s, side="left").clip(0, len(pos_t_s) - 1)
    before = np.where(pos_t_s[after] == t_s, after, np.maximum(after - 1, 0))
    near = (pos_t_s[after] >= t_s) & (pos_t_s[before] <= t_s)
    near &= pos_t_s[after] - pos_t_s[before] <= LONGEST_STEP_S
    there = interpolated(t_s, pos_t_s, positions)  # (n, 3)
    rows = np.flatnonzero(near & np.isfinite(q).all(axis=1))
    return {int(k): (there[k].tolist(), q[k].tolist()) for k in rows}


def _write_findings(file: McapFile, t_ns: int, name: str, findings: tuple[Finding, ...]) -> None:
    """Write the findings of the reader, at the first time."""
    for f in findings:
        count = f" ({f.count})" if f.count > 1 else ""
        text = f"{f.where}: {f.message}{count}"
        file.write(LOG, t_ns, log_message(t_ns, f.severity, text, name))
