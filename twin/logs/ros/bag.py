"""ROS 2 bags (MCAP or SQLite) -> Flight; the topics are those of `sources`."""

import operator
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ...errors import LogError
from ..assemble import FlightBuilder, MotorCommands, monotonic_samples, phases_of_table
from ..autopilot import Autopilot, ground_spans, modes_of, stretches_of
from ..columns import MAX_MOTORS, MIN_MOTORS
from ..flight import Array, Finding, FindingCollector, Flight
from ..formats import ReadOptions
from .sources import SOURCES, Source, mapped_sources

_DEFINITION_END = "=" * 80 + "\n"
"""Between the definitions of several messages, as rosbag2 writes them."""
_APART_S = 0.5
"""Between the clocks of two topics: beyond, their stamps are not of one clock. Made up: a stamp is
older than the record by the latency of a network."""
_FIELD = re.compile(r"([A-Za-z0-9_.]+)(?:\[([0-9]{1,4})\])?")
"""Path of a field, and of an element of an array."""
_ARMED, _ON_GROUND = 2, 1
"""px4_msgs/VehicleStatus.arming_state; mavros_msgs/ExtendedState.landed_state."""
_STATES = {
    "px4_msgs/msg/VehicleStatus": ("arming_state", "nav_state"),
    "px4_msgs/msg/VehicleLandDetected": ("landed",),
    "mavros_msgs/msg/State": ("armed", "mode"),
    "mavros_msgs/msg/ExtendedState": ("landed_state",),
}
"""Messages of what the autopilot does, and their fields."""


@dataclass(slots=True)
class Topic:
    """Samples of one topic.

    Attributes:
        name: Of the topic.
        fields: Read of each message.
        t_us: Stamp of each, us; NaN-free; since 1970 or since boot.
        recorded_us: When each was recorded, us since 1970.
        rows: Values of the fields, flat.
    """

    name: str
    fields: tuple[str, ...]
    t_us: list[int] = field(default_factory=list)
    recorded_us: list[int] = field(default_factory=list)
    rows: list[list[Any]] = field(default_factory=list)

    def stamps(self) -> tuple[NDArray[np.int64], bool]:
        """Times, us, shape (n,), and whether they are the messages' own: stamps that stand still
        are none."""
        own, recorded = np.array(self.t_us, np.int64), np.array(self.recorded_us, np.int64)
        moves = len(own) > 1 and own[0] > 0 and bool(np.median(np.diff(own)) > 0)
        return (own, True) if moves else (recorded, False)


@dataclass(slots=True)
class _Bag(FindingCollector):
    """A bag while it is read; `findings` grow."""

    path: Path
    topics: dict[tuple[str, tuple[str, ...]], Topic] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)


def read_mcap(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a ROS 2 bag in MCAP; arguments and errors as of `formats.Reader`."""
    return _read(path, blob, ".mcap")


def read_sqlite(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a ROS 2 bag in SQLite; arguments and errors as of `formats.Reader`."""
    return _read(path, blob, ".db3")


def _read(path: Path, blob: bytes, suffix: str) -> Flight:
    bag = _Bag(path)
    try:
        with _on_disk(path, blob, suffix) as file, Reader(file) as reader:
            types = {c.topic: c.msgtype for c in reader.connections}
            chosen = _chosen(reader.connections, mapped_sources(path, types))
            _collect(bag, reader, chosen)
    except LogError:
        raise
    except Exception as error:  # rosbags, apsw and zstd raise what they like of damaged files
        raise LogError(
            f"{path.name}: no ROS 2 bag that can be read ({_said(error)}). One that was cut short: "
            f"mcap recover, or ros2 bag reindex; a bag of ROS 1 or of other messages: convert it."
        ) from error
    return _flight(bag, chosen, types)


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:160]}"


@contextmanager
def _on_disk(path: Path, blob: bytes, suffix: str) -> Iterator[Path]:
    """The file of a bag, with the ending by which rosbags knows its kind."""
    if path.suffix == suffix and path.is_file() and path.stat().st_size == len(blob):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"bag{suffix}"
        file.write_bytes(blob)
        yield file


# -- from messages to samples -------------------------------------------------------------------


def _chosen(
    connections: Sequence[Connection], mapped: Sequence[Source]
) -> dict[str, tuple[Source, Connection]]:
    """By signal, where it comes from: of a mapping file, else the first source that is there; of
    several topics that fit the one with most messages."""
    found: dict[str, tuple[Source, Connection]] = {}
    for source in (*mapped, *SOURCES):
        fitting = [c for c in connections if c.msgcount and source.fits(c.topic, c.msgtype)]
        if fitting and source.signal not in found:
            most = max(fitting, key=lambda c: (c.msgcount, c.topic))
            found[source.signal] = source, most
    return found


def _collect(bag: _Bag, reader: Reader, chosen: Mapping[str, tuple[Source, Connection]]) -> None:
    """Read every message that a signal or the state of the autopilot is made of."""
    wanted: dict[int, list[Topic]] = {}
    connections: dict[int, Connection] = {}
    pairs = [(c, (*s.fields, *s.only)) for s, c in chosen.values()]
    pairs += [(c, _STATES[c.msgtype]) for c in reader.connections if c.msgtype in _STATES]
    for connection, fields in pairs:
        topic = bag.topics.setdefault((connection.topic, fields), Topic(connection.topic, fields))
        wanted.setdefault(connection.id, []).append(topic)
        connections[connection.id] = connection
    if not connections:
        return
    stores = {k: _typestore(bag, c) for k, c in connections.items()}
    getters = {
        key: [(t, [_getter(f) for f in dict.fromkeys(t.fields)]) for t in topics]
        for key, topics in wanted.items()
    }
    failed: dict[str, int] = {}
    for connection, recorded_ns, content in reader.messages(list(connections.values())):
        store = stores[connection.id]
        if store is None:
            continue
        try:
            message = store.deserialize_cdr(content, connection.msgtype)
            stamp = _stamp_us(message)
            rows = [[v for g in gets for v in g(message)] for _, gets in getters[connection.id]]
        except Exception:  # a damaged message is counted, the others are read
            failed[connection.topic] = failed.get(connection.topic, 0) + 1
            continue
        for (topic, _), row in zip(getters[connection.id], rows, strict=True):
            topic.t_us.append(stamp)
            topic.recorded_us.append(recorded_ns // 1000)
            topic.rows.append(row)
    for name, count in failed.items():
        bag.note("error", name, "messages that do not fit their definition, left out", count)


def _typestore(bag: _Bag, connection: Connection) -> Typestore | None:
    """What decodes the messages of a topic; None, and a finding, where nothing says how."""
    definition, kind = connection.msgdef, connection.msgtype
    if definition.format == MessageDefinitionFormat.NONE:
        store = get_typestore(Stores.LATEST)
        if kind in store.fielddefs:
            return store
        text = (
            f"the bag does not define {kind}, so that it cannot be read: ROS 2 before Iron writes "
            f"no definitions to SQLite. Record with -s mcap, or: ros2 bag convert"
        )
        bag.note("warning", connection.topic, text)
        return None
    store = get_typestore(Stores.EMPTY)
    if definition.format == MessageDefinitionFormat.MSG:
        store.register(get_types_from_msg(definition.data, kind))
        return store
    parts = definition.data.split(_DEFINITION_END) or [definition.data]
    for part in filter(None, parts):
        store.register(get_types_from_idl(part.split("\n", 1)[1] if part[:4] == "IDL:" else part))
    return store


def _getter(path: str) -> Callable[[Any], list[Any]]:
    """What takes a field out of a message: one value, or all of an array.

    Raises:
        LogError: It is no path of a field.
    """
    match = _FIELD.fullmatch(path)
    if match is None:
        raise LogError(f"field {path!r}: write a path such as linear_acceleration.x or control[0].")
    attribute, element = operator.attrgetter(match.group(1)), match.group(2)

    def get(message: Any) -> list[Any]:
        """The value or values."""
        value = attribute(message)
        if element is not None:
            return [value[int(element)]]
        return value.tolist() if isinstance(value, np.ndarray) else [value]

    return get


def _stamp_us(message: Any) -> int:
    """When the sample was taken, else published, us; 0: the message does not say."""
    header = getattr(message, "header", None)
    if header is not None:
        return int(header.stamp.sec) * 1_000_000 + int(header.stamp.nanosec) // 1000
    return int(getattr(message, "timestamp_sample", 0) or getattr(message, "timestamp", 0))


# -- from samples to the flight -----------------------------------------------------------------


def _flight(
    bag: _Bag, chosen: Mapping[str, tuple[Source, Connection]], types: Mapping[str, str]
) -> Flight:
    start_us, offset_us = _clocks(bag)
    builder = FlightBuilder(bag, bag.path, {})
    for signal, (source, connection) in chosen.items():
        topic = bag.topics[connection.topic, (*source.fields, *source.only)]
        _add(bag, builder, source, topic, start_us, offset_us)
        builder.facts[f"{signal} from"] = connection.topic
    if "cmd" not in chosen:
        text = (
            "no motor commands: of PX4 record actuator_motors (add it to dds_topics.yaml); other "
            "topics are named by a mapping file"
        )
        bag.note("warning", "cmd", text)
    shown = ", ".join(f"{t} ({types[t].rpartition('/')[2]})" for t in sorted(types)[:12])
    advice = f"It has {shown or 'no topic'}. Other topics are named by a mapping file next to it."
    table = builder.lay_out(advice)
    end_s = float(table["time"].iloc[-1])
    autopilot, ground = _autopilot(bag, start_us, offset_us, end_s)
    return builder.flight(table, phases_of_table(table, ground), autopilot=autopilot)


def _clocks(bag: _Bag) -> tuple[int, int]:
    """The time that counts as 0, on the clock of the stamps, and by how much the clock of the
    record is ahead of it, us; topics whose own clock is another one lose their stamps."""
    ahead = {
        key: float(np.median(np.array(t.recorded_us) - np.array(t.t_us)))
        for key, t in bag.topics.items()
        if t.rows and t.stamps()[1]
    }
    usual_us = float(np.median(list(ahead.values()))) if ahead else 0.0
    for key, off_us in ahead.items():
        topic = bag.topics[key]
        if abs(off_us - usual_us) > 1e6 * _APART_S:
            text = (
                f"stamped {1e-6 * (off_us - usual_us):+.3g} s from the other topics: another "
                "clock. Its time is when it was recorded"
            )
            bag.note("warning", topic.name, text)
            topic.t_us = [0] * len(topic.t_us)
    offset_us = round(usual_us)
    starts = [_times(t, offset_us)[0] for t in bag.topics.values() if t.rows]
    return min(starts, default=0), offset_us


def _times(topic: Topic, offset_us: int) -> NDArray[np.int64]:
    """Stamps of a topic; where it has none, when it was recorded, on the clock of the others."""
    t_us, own = topic.stamps()
    return t_us if own else t_us - offset_us


def _add(
    bag: _Bag, builder: FlightBuilder, source: Source, topic: Topic, start_us: int, offset_us: int
) -> None:
    """Add a signal; findings say what is to be known of it."""
    where, width = source.signal, len(topic.rows[0]) if topic.rows else 0
    same = np.array([len(r) == width for r in topic.rows], dtype=np.bool_)
    bag.note("error", where, "samples left out, of another number of values", ~same)
    if not same.any():
        bag.note("warning", where, f"{topic.name} has no sample that can be used")
        return
    values = np.array([r for r in topic.rows if len(r) == width], dtype=np.float64)
    t_us = _times(topic, offset_us)[same] - start_us
    only = list(source.only.values())
    valid = (values[:, width - len(only) :] == only).all(axis=1)
    bag.note("info", where, "samples left out, the message says they are invalid", ~valid)
    keep = monotonic_samples(bag, where, t_us[valid], "messages")
    t_us, values = t_us[valid][keep], values[valid][keep][:, : width - len(only)]
    if not topic.stamps()[1]:
        bag.note("warning", where, "its messages have no times; they are when it was recorded")
    if source.note:
        bag.note("warning", where, f"{topic.name}: {source.note}")
    if not len(t_us):
        return
    if where == "cmd":
        _add_commands(bag, builder, source, topic, t_us, values)
    elif where == "q":
        builder.add_attitude(t_us, source.convert(values))
    else:
        builder.add(where, source.columns, t_us, source.convert(values))


def _add_commands(
    bag: _Bag,
    builder: FlightBuilder,
    source: Source,
    topic: Topic,
    t_us: NDArray[np.int64],
    values: Array,
) -> None:
    """Add commands of as many motors as ever have a value; NaN is a motor that is stopped."""
    cmd = source.convert(values[:, :MAX_MOTORS])
    used = np.flatnonzero(np.nan_to_num(np.abs(cmd)).max(axis=0) > 0.0)
    count = len(source.columns) or (int(used[-1]) + 1 if len(used) else 0)
    if count < MIN_MOTORS:
        bag.note("warning", "cmd", f"{topic.name} has values for {count} motors: not used")
        return
    commands = MotorCommands(t_us, np.nan_to_num(cmd[:, :count]), {"motors": topic.name})
    builder.add_commands(commands.clipped(bag, topic.name))


def _autopilot(
    bag: _Bag, start_us: int, offset_us: int, end_s: float
) -> tuple[Autopilot | None, list[tuple[str, float, float]]]:
    """Modes, arming, and when the aircraft stood on the ground."""
    from ..px4.ulog import mode_name  # with pyulog, which a bag of MAVROS does not need

    modes: tuple[Any, ...] = ()
    armed: tuple[Any, ...] = ()
    ground: list[tuple[str, float, float]] = []
    for (_, fields), topic in bag.topics.items():
        if fields not in _STATES.values() or not topic.rows:
            continue
        t_s = np.asarray(1e-6 * (_times(topic, offset_us) - start_us), dtype=np.float64)
        order = np.argsort(t_s, kind="stable")
        t_s, rows = t_s[order], [topic.rows[k] for k in order]
        if fields == ("arming_state", "nav_state"):
            armed = stretches_of(t_s, np.array([r[0] == _ARMED for r in rows]), "armed", end_s)
            modes = modes_of(t_s, [mode_name(int(r[1])) for r in rows], end_s)
        elif fields == ("armed", "mode"):
            armed = stretches_of(t_s, np.array([bool(r[0]) for r in rows]), "armed", end_s)
            modes = modes_of(t_s, [str(r[1])[:40] for r in rows], end_s)
        else:
            landed = [r[0] == _ON_GROUND for r in rows]  # of PX4 a truth value
            ground = ground_spans(t_s, np.array(landed))
    return (Autopilot(modes=modes, armed=armed) if modes or armed else None), ground
