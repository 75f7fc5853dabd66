"""ROS 2 bags (MCAP or SQLite) -> Flight; the topics are those of `sources`."""

import operator
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinitionFormat, Nodetype
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ...errors import LogError
from ..assemble import FlightBuilder, phases_of_table
from ..autopilot import Autopilot, ground_spans, modes_of, stretches_of
from ..columns import MAX_MOTORS, MIN_MOTORS
from ..flight import Array, Finding, FindingCollector, Flight
from ..formats import ReadOptions
from ..motors import MotorCommands
from ..stamps import monotonic_samples
from .sources import SOURCES, Source, mapped_sources

_DEFINITION_END = "=" * 80 + "\n"
"""Separator of the definitions of several messages, as written by rosbag2."""
_APART_S = 0.5
"""Largest offset between the clocks of two topics that are one clock. Made up: a stamp is older
than the record by the latency of a network."""
_LAST_US = 2**53
"""Time stamp beyond which a message is damaged: the year 2255 since 1970."""
_FIELD = re.compile(r"([A-Za-z0-9_.]+)(?:\[([0-9]{1,4})\])?")
"""Path of a field, and of an element of an array."""
_ARMED, _ON_GROUND = 2, 1
"""Value when armed in px4_msgs/VehicleStatus.arming_state; value on the ground in
mavros_msgs/ExtendedState.landed_state."""
_STATES = {
    "px4_msgs/msg/VehicleStatus": ("arming_state", "nav_state"),
    "px4_msgs/msg/VehicleLandDetected": ("landed",),
    "mavros_msgs/msg/State": ("armed", "mode"),
    "mavros_msgs/msg/ExtendedState": ("landed_state",),
}
"""Messages with the state of the autopilot, and their fields."""
_TEXTS = ("mode",)
"""State fields that are text."""
_TEXT_TYPES = ("string", "wstring", "wchar")
"""Base types that are not numeric."""


@dataclass(slots=True)
class Topic:
    """Samples of one topic.

    Attributes:
        name: Name of the topic.
        fields: Fields in use.
        t_us: Stamp of each message, us since 1970 or since boot.
        recorded_us: Time of recording of each message, us since 1970.
        rows: Values of the fields, flattened.
        shift_us: Offset from the clock of this topic to that of the others.
    """

    name: str
    fields: tuple[str, ...]
    t_us: list[int] = field(default_factory=list)
    recorded_us: list[int] = field(default_factory=list)
    rows: list[list[Any]] = field(default_factory=list)
    shift_us: int = 0

    def stamps(self) -> tuple[NDArray[np.int64], bool]:
        """Times, us, shape (n,), and whether they are the messages' own: constant stamps are not
        used."""
        own, recorded = np.array(self.t_us, np.int64), np.array(self.recorded_us, np.int64)
        moves = len(own) > 1 and own[0] > 0 and bool(np.median(np.diff(own)) > 0)
        return (own + self.shift_us, True) if moves else (recorded, False)


@dataclass(slots=True)
class _Bag(FindingCollector):
    """A bag while it is read; `findings` and `stores` grow."""

    path: Path
    topics: dict[tuple[str, tuple[str, ...]], Topic] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    stores: dict[int, Typestore] = field(default_factory=dict)

    def store(self, connection: Connection) -> Typestore:
        """Decoder of the messages of a topic; errors as in `_typestore`."""
        if connection.id not in self.stores:
            self.stores[connection.id] = _typestore(connection)
        return self.stores[connection.id]


def read_mcap(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a ROS 2 bag in MCAP; arguments and errors as in `formats.Reader`."""
    return _read(path, blob, ".mcap")


def read_sqlite(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a ROS 2 bag in SQLite; arguments and errors as in `formats.Reader`."""
    return _read(path, blob, ".db3")


def _read(path: Path, blob: bytes, suffix: str) -> Flight:
    bag = _Bag(path)
    try:
        with _on_disk(path, blob, suffix) as file, Reader(file) as reader:
            types = {c.topic: c.msgtype for c in reader.connections}
            chosen = _chosen(bag, reader.connections, mapped_sources(path, types))
            _collect(bag, reader, chosen)
    except LogError:
        raise
    except Exception as error:  # rosbags, apsw and zstd raise many kinds on damaged files
        raise LogError(
            f"{path.name}: no ROS 2 bag that can be read ({_said(error)}). One that was cut short: "
            f"mcap recover, or ros2 bag reindex; a bag of ROS 1 or of other messages: convert it."
        ) from error
    return _flight(bag, chosen, types)


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:160]}"


@contextmanager
def _on_disk(path: Path, blob: bytes, suffix: str) -> Iterator[Path]:
    """The file of a bag, with the extension by which rosbags recognises its kind."""
    if path.suffix == suffix and path.is_file() and path.stat().st_size == len(blob):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"bag{suffix}"
        file.write_bytes(blob)
        yield file


# -- from messages to samples -------------------------------------------------------------------


def _chosen(
    bag: _Bag, connections: Sequence[Connection], mapped: Sequence[Source]
) -> dict[str, tuple[Source, Connection]]:
    """Source of each signal: from a mapping file, else the first available source; of several
    suitable topics the one with most messages.

    Raises:
        LogError: A topic of a mapping file is missing, or the bag has no signal.
    """
    found: dict[str, tuple[Source, Connection]] = {}
    unfit: dict[tuple[str, str], None] = {}
    for source in (*mapped, *SOURCES):
        fitting = [c for c in connections if c.msgcount and source.fits(c.topic, c.msgtype)]
        if source.signal in found or not fitting:
            continue
        most = max(fitting, key=lambda c: (c.msgcount, c.topic))
        try:
            _check(bag, source, most)
        except LogError as error:
            if source.entry:
                raise LogError(f"{source.entry} {error}") from None
            unfit[most.topic, str(error)] = None
        else:
            found[source.signal] = source, most
    for topic, text in unfit:
        bag.note("warning", topic, text)
    return found


def _check(bag: _Bag, source: Source, connection: Connection) -> None:
    """Check the fields of a source against the definition of the message.

    Raises:
        LogError: A field is missing or not numeric, or their number differs from the columns of the
            signal.
    """
    only = len(source.only)
    given = _width(bag, connection, (*source.fields, *source.only))
    if source.width and given is not None and given != source.width + only:
        raise LogError(source.miscounted(given - only))


def _width(
    bag: _Bag, connection: Connection, paths: Sequence[str], texts: Sequence[str] = ()
) -> int | None:
    """Number of values of fields; None: it varies by message.

    Raises:
        LogError: A field is missing, or neither a number nor one of those that are text.
    """
    counts: list[int | None] = []
    for path in paths:
        base, count = _field(bag.store(connection), connection.msgtype, path)
        if base in _TEXT_TYPES and path not in texts:
            raise LogError(f"field {path}: it is text, no number.")
        counts.append(count)
    known = [c for c in counts if c is not None]
    return sum(known) if len(known) == len(counts) else None


def _field(store: Typestore, kind: str, path: str) -> tuple[str, int | None]:
    """Base type of a field, and its number of values; None: it varies by message.

    Raises:
        LogError: There is no such field, or it consists of messages.
    """
    match = _FIELD.fullmatch(path)
    if match is None:
        raise LogError(f"field {path!r}: write a path such as linear_acceleration.x or control[0].")
    node, of = _walk(store, kind, path, match.group(1).split("."))
    element = None if match.group(2) is None else int(match.group(2))
    if node == Nodetype.BASE and element is None:
        return str(of[0]), 1
    if node not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        raise LogError(f"field {path}: it is no array.")
    (inner, base), count = of
    if inner != Nodetype.BASE:
        raise LogError(f"field {path}: its elements are messages, no numbers.")
    size = int(count) if node == Nodetype.ARRAY else None
    if element is not None and size is not None and element >= size:
        raise LogError(f"field {path}: it has {size} elements, the first is [0].")
    return str(base[0]), size if element is None else 1


def _walk(store: Typestore, kind: str, path: str, names: Sequence[str]) -> tuple[Nodetype, Any]:
    """Description of a field in the type store of rosbags.

    Raises:
        LogError: There is no such field, or it is a message.
    """
    node, before = Nodetype.NAME, ""
    of: Any = kind
    for name in names:
        fields = dict(store.fielddefs[of][1]) if node == Nodetype.NAME else {}
        if name not in fields:
            shown = ", ".join(f"{before}{f}" for f in list(fields)[:12])
            raise LogError(f"field {path}: the message {kind} has {shown or before[:-1]}.")
        (node, of), before = fields[name], f"{before}{name}."
    if node == Nodetype.NAME:
        shown = ", ".join(f"{before}{f}" for f, _ in store.fielddefs[of][1][:12])
        raise LogError(f"field {path}: it is a message, no number. It has {shown}.")
    return node, of


def _collect(bag: _Bag, reader: Reader, chosen: Mapping[str, tuple[Source, Connection]]) -> None:
    """Read every message with a signal or the state of the autopilot."""
    wanted: dict[int, dict[tuple[str, ...], Topic]] = {}
    connections: dict[int, Connection] = {}
    pairs = [(c, (*s.fields, *s.only)) for s, c in chosen.values()]
    pairs += [(c, _STATES[c.msgtype]) for c in reader.connections if _tells_state(bag, c)]
    for connection, fields in pairs:
        topic = bag.topics.setdefault((connection.topic, fields), Topic(connection.topic, fields))
        wanted.setdefault(connection.id, {})[fields] = topic
        connections[connection.id] = connection
    if not connections:
        return
    getters = {
        key: [(t, [_getter(f) for f in fields]) for fields, t in topics.items()]
        for key, topics in wanted.items()
    }
    failed: Counter[str] = Counter()
    for connection, recorded_ns, content in reader.messages(list(connections.values())):
        try:
            message = bag.store(connection).deserialize_cdr(content, connection.msgtype)
            stamp = _stamp_us(message)
            rows = [[v for g in gets for v in g(message)] for _, gets in getters[connection.id]]
        except Exception:  # a damaged message is counted, the others are read
            failed[connection.topic] += 1
            continue
        for (topic, _), row in zip(getters[connection.id], rows, strict=True):
            topic.t_us.append(stamp)
            topic.recorded_us.append(recorded_ns // 1000)
            topic.rows.append(row)
    for name, count in failed.items():
        text = "messages that do not fit their definition, or have no possible time, left out"
        bag.note("error", name, text, count)


def _tells_state(bag: _Bag, connection: Connection) -> bool:
    """Whether a topic has the state of the autopilot; a finding where its message type differs."""
    fields = _STATES.get(connection.msgtype, ())
    if not fields or not connection.msgcount:
        return False
    try:
        return _width(bag, connection, fields, _TEXTS) == len(fields)
    except LogError as error:
        bag.note("warning", connection.topic, str(error))
        return False


def _typestore(connection: Connection) -> Typestore:
    """Decoder of the messages of a topic.

    Raises:
        LogError: The bag has no definition.
    """
    definition, kind = connection.msgdef, connection.msgtype
    if definition.format == MessageDefinitionFormat.NONE:
        store = get_typestore(Stores.LATEST)
        if kind in store.fielddefs:
            return store
        raise LogError(
            f"the bag does not define {kind}, so that it cannot be read: ROS 2 before Iron writes "
            f"no definitions to SQLite. Record with -s mcap, or: ros2 bag convert."
        )
    store = get_typestore(Stores.EMPTY)
    if definition.format == MessageDefinitionFormat.MSG:
        store.register(get_types_from_msg(definition.data, kind))
        return store
    parts = definition.data.split(_DEFINITION_END) or [definition.data]
    for part in filter(None, parts):
        store.register(get_types_from_idl(part.split("\n", 1)[1] if part[:4] == "IDL:" else part))
    return store


def _getter(path: str) -> Callable[[Any], list[Any]]:
    """Function that reads a field of a message: one value, or all of an array; empty where the
    array is too short."""
    name, _, element = path.rstrip("]").partition("[")
    attribute = operator.attrgetter(name)

    def get(message: Any) -> list[Any]:
        """The values of the field."""
        value = attribute(message)
        if element:
            return list(value[int(element) :][:1])
        return value.tolist() if isinstance(value, np.ndarray) else [value]

    return get


def _stamp_us(message: Any) -> int:
    """Time of sampling, else of publication, us; 0: the message has none.

    Raises:
        LogError: The field is no time.
    """
    header = getattr(message, "header", None)
    if header is not None:
        stamp = int(header.stamp.sec) * 1_000_000 + int(header.stamp.nanosec) // 1000
    else:
        stamp = int(getattr(message, "timestamp_sample", 0) or getattr(message, "timestamp", 0))
    if stamp > _LAST_US:
        raise LogError(f"stamped {stamp} us")
    return stamp


# -- from samples to the flight -----------------------------------------------------------------


def _flight(
    bag: _Bag, chosen: Mapping[str, tuple[Source, Connection]], types: Mapping[str, str]
) -> Flight:
    start_us, offset_us = _clocks(bag, chosen)
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


def _clocks(bag: _Bag, chosen: Mapping[str, tuple[Source, Connection]]) -> tuple[int, int]:
    """Time 0, on the clock of most signals, of several that of the IMU, and the lead of the
    recording clock, us; other clocks are shifted to it."""
    signals = Counter(connection.topic for _, connection in chosen.values())
    imu = {chosen[s][1].topic for s in ("acc", "gyro") if s in chosen}
    ahead = {
        t.name: float(np.median(np.array(t.recorded_us) - np.array(t.t_us)))
        for t in bag.topics.values()
        if t.rows and t.stamps()[1]
    }

    def weight(name: str) -> tuple[int, bool]:
        """Number of signals on the clock of a topic, and whether it is that of the IMU."""
        alike = [n for n, a in ahead.items() if abs(a - ahead[name]) <= 1e6 * _APART_S]
        return sum(signals[n] for n in alike), name in imu

    first = max(ahead, key=weight, default="")
    offset_us = round(ahead.get(first, 0.0))
    for name, off_us in ahead.items():
        apart_us = round(off_us) - offset_us
        if abs(apart_us) > 1e6 * _APART_S:
            text = f"stamped {-1e-6 * apart_us:+.6g} s from {first}: another clock, shifted by that"
            bag.note("warning", name, text)
            for topic in (t for t in bag.topics.values() if t.name == name):
                topic.shift_us = apart_us
    starts = [_times(t, offset_us)[0] for t in bag.topics.values() if t.rows]
    return min(starts, default=0), offset_us


def _times(topic: Topic, offset_us: int) -> NDArray[np.int64]:
    """Stamps of a topic; without any, its times of recording, on the clock of the others."""
    t_us, own = topic.stamps()
    return t_us if own else t_us - offset_us


def _add(
    bag: _Bag, builder: FlightBuilder, source: Source, topic: Topic, start_us: int, offset_us: int
) -> None:
    """Add a signal, with findings on its properties.

    Raises:
        LogError: The number of fields in a mapping file differs from the columns of the signal.
    """
    where, first = source.signal, len(topic.rows[0]) if topic.rows else 0
    width = source.width + len(source.only) if source.width else first
    same = np.array([len(r) == width for r in topic.rows], dtype=np.bool_)
    if source.entry and topic.rows and not same.any():
        raise LogError(f"{source.entry} {source.miscounted(first)}")
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
    """Add commands of as many motors as ever have a value; NaN is a stopped motor."""
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
    """Modes, arming, and spans on the ground."""
    from ..px4.ulog import mode_name  # imports pyulog, which a bag of MAVROS does not need

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
            landed = [r[0] == _ON_GROUND for r in rows]  # for PX4 a Boolean
            ground = ground_spans(t_s, np.array(landed))
    return (Autopilot(modes=modes, armed=armed) if modes or armed else None), ground
