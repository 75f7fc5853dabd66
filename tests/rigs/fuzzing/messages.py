"""MAVLink: telemetry logs and datagrams as they come; stamps, fields, whole messages and senders
changed."""

import hashlib
import math
import random
import struct
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sample_logs import flown_table

from twin.logs import Flight, read_flight
from twin.logs.mavlink.frames import AUTOPILOT, Frame, Message, dialect, frames, parser, stamped
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.live.datagrams import Datagram
from uavtwin.live.replay import played
from uavtwin.live.session import LiveOptions, LiveSession
from uavtwin.sockets import Address

from .engine import Seen, Step
from .flights import ABSURD, apply_bytes, draw_bytes, read
from .layout import AXIS_FAULTS, draw_axis_fault

EPOCH_US = 1_700_000_000_000_000
_BYTES = ("flip", "cut", "repeat", "remove")
_HEAD, _CHECKSUM = 10, 2
_TIMES = ("time_usec", "time_boot_ms")
SENSED = {
    "HIGHRES_IMU": ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro"),
    "ODOMETRY": ("x", "y", "z", "vx", "vy", "vz"),
}
"""Fields of signals that always move a little."""
AXES = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "vx", "vy", "vz")
STEADY = (*SENSED, "ACTUATOR_OUTPUT_STATUS")
_RECORD = struct.Struct(">QHH")
"""Of a datagram: when it came, us, the port of its sender, its length."""


@dataclass(frozen=True, slots=True)
class Sent:
    """A frame, or any bytes, and when it came."""

    at_us: int
    content: bytes
    port: int = 1


@cache
def _base(seconds: float, motion: str) -> tuple[Sent, ...]:
    """Messages of a flight as `uavtwin replay` sends them."""
    table = flown_table()
    table = table[table["time"] < seconds]
    if motion == "rest":
        for column in table:
            if column not in ("time", "phase"):
                table = table.assign(**{column: table[column].iloc[0]})
    packer, found = parser(1, AUTOPILOT), []
    for t_us, messages in played(Flight("flown", table)):
        for message in messages:
            found.append(Sent(EPOCH_US + t_us, bytes(message.pack(packer))))
            packer.seq = (packer.seq + 1) % 256
    return tuple(found)


# -- frames -----------------------------------------------------------------------------------


def _kind(frame: bytes) -> Any:
    """Class of the message of a frame of MAVLink 2; None: it is none, or of no known kind."""
    if len(frame) < _HEAD + _CHECKSUM or frame[0] != 0xFD:
        return None
    return dialect.mavlink_map.get(int.from_bytes(frame[7:10], "little"))


def _values(kind: Any, frame: bytes) -> dict[str, Any]:
    """Fields of a message, arrays as lists."""
    unpacker = kind.unpacker
    payload = frame[_HEAD:-_CHECKSUM].ljust(unpacker.size, b"\0")[: unpacker.size]
    flat, found = list(unpacker.unpack(payload)), {}
    for name, length in zip(kind.ordered_fieldnames, kind.lengths, strict=True):
        count = 1 if length == 0 else length
        found[name] = flat[:count] if count > 1 else flat[0]
        del flat[:count]
    return found


def _with(kind: Any, frame: bytes, changes: dict[str, Any]) -> bytes:
    """The frame with other values of some fields, its checksum made to fit."""
    values = _values(kind, frame) | changes
    flat: list[Any] = []
    for name in kind.ordered_fieldnames:
        value = values[name]
        flat += value if isinstance(value, list) else [value]
    try:
        payload = kind.unpacker.pack(*flat).rstrip(b"\0") or b"\0"
    except struct.error:  # a negative number in a field that has no sign
        return frame
    head = bytes([0xFD, len(payload), *frame[2:_HEAD]])
    checksum = dialect.x25crc(head[1:] + payload + bytes([kind.crc_extra])).crc
    return head + payload + struct.pack("<H", checksum)


def _from(frame: bytes, system: int) -> bytes:
    """The frame of another system."""
    kind = _kind(frame)
    if kind is None:
        return frame
    return _with(kind, frame[:5] + bytes([system]) + frame[6:], {})


def _fitting(value: float, old: Any) -> Any:
    """A value as the field can hold it."""
    if isinstance(old, float):
        return float(np.float32(value)) if abs(value) < 3e38 or value != value else value
    return int(value) if math.isfinite(value) and abs(value) < 2**15 else 0


# -- changes ----------------------------------------------------------------------------------


def _strange(name: str, k: int) -> Message:
    """Messages that no aircraft sends."""
    m = dialect
    match name:
        case "parameter":
            value = (math.nan, math.inf, 3e38, -1.0)[k % 4]
            return m.MAVLink_param_value_message(b"SERVO1_FUNCTION", value, 1 + k % 9, 1, 0)
        case "timesync":
            return m.MAVLink_timesync_message((2**63 - 1, -(2**63), 0)[k % 3], 2**62)
        case "text":
            return m.MAVLink_statustext_message(k % 256, b"\x1b[2J<b>\xff\xed\xa0\x80")
        case "heartbeat":
            return m.MAVLink_heartbeat_message(k % 60, k % 256, 255, 0, 255, 255)
        case "imu":
            return m.MAVLink_highres_imu_message(2**64 - 1 - k, *[3e38] * 13, 0xFFFF)
        case "battery":
            return m.MAVLink_battery_status_message(0, 0, 0, -1, [65534] * 10, -2, -1, -1, -1)
        case "landed":
            return m.MAVLink_extended_sys_state_message(255, k % 256)
        case "servo":
            return m.MAVLink_servo_output_raw_message(2**32 - 1, k % 3, *[65535] * 8)
        case "rotors":
            return m.MAVLink_debug_float_array_message(k, b"rotor_rads", 0, [math.nan] * 58)
        case "esc":
            return m.MAVLink_esc_telemetry_1_to_4_message(
                [0] * 4, [0] * 4, [0] * 4, [0] * 4, [65535] * 4, [0] * 4
            )
        case _:
            return m.MAVLink_attitude_message(2**32 - 1, math.nan, math.inf, 1e38, 0, 0, 0)


_STRANGE = (
    *("parameter", "timesync", "text", "heartbeat", "imu", "battery", "landed", "servo"),
    *("rotors", "esc", "attitude"),
)


def _changed(sent: list[Sent], name: str, given: dict[str, Any]) -> list[Sent]:
    """The messages with one change."""
    match name:
        case "insert":
            packer, at = parser(given["system"], AUTOPILOT), int(given["at"] * len(sent))
            packer.seq = given["number"]
            new = [_strange(given["what"], k).pack(packer) for k in range(given["times"])]
            when = sent[min(at, len(sent) - 1)].at_us if sent else EPOCH_US
            return [*sent[:at], *(Sent(when, bytes(n)) for n in new), *sent[at:]]
        case "systems":
            copies = [
                replace(s, content=_from(s.content, 2 + k % given["count"]), port=k % 65536)
                for k, s in enumerate(sent)
            ]
            return [s for both in zip(sent, copies, strict=True) for s in both]
        case "ports":
            rng = random.Random(given["seed"])
            when = sent[0].at_us if sent else EPOCH_US
            strangers = [Sent(when, rng.randbytes(1), k) for k in range(given["count"])]
            return [*strangers, *sent]
        case "lose":
            rng = random.Random(given["seed"])
            return [s for s in sent if rng.random() >= given["share"]]
        case "swap":
            rng = random.Random(given["seed"])
            return sorted(sent, key=lambda s: s.at_us + rng.random() * given["by_us"])
        case "arrivals":
            first = int(given["from"] * len(sent))
            later = [replace(s, at_us=(s.at_us + given["by_us"]) % 2**64) for s in sent[first:]]
            return [*sent[:first], *later]
    of_kind = [k for k, s in enumerate(sent) if _name(s.content) == given["kind"]]
    if not of_kind:
        return sent
    first = int(given.get("from", 0.0) * len(of_kind))
    kind = _kind(sent[of_kind[0]].content)
    match name:
        case "gap":
            begin_us = sent[of_kind[first]].at_us
            end_us = begin_us + int(1e6 * given["lasting_s"])
            there = set(of_kind)
            return [
                s for k, s in enumerate(sent) if k not in there or not begin_us <= s.at_us < end_us
            ]
        case "ends":
            gone = set(of_kind[first:])
            return [s for k, s in enumerate(sent) if k not in gone]
    out = list(sent)
    held: dict[str, Any] = {}
    chosen = of_kind[first : first + 1] if name == "stray" else of_kind[first:]
    if name == "freeze":
        chosen = of_kind[first : first + len(of_kind) * 2 // 3]
    for k in chosen:
        old = _values(kind, out[k].content)
        out[k] = replace(
            out[k], content=_with(kind, out[k].content, _fields(name, given, old, held))
        )
    return out


def _fields(name: str, given: dict[str, Any], old: dict[str, Any], held: dict[str, Any]) -> Any:
    """New values of some fields of one message."""
    stamp = next((t for t in _TIMES if t in old), "")
    top = 2**64 if stamp == "time_usec" else 2**32
    match name:
        case "stray" | "stamp_add":
            by = given["by_us"] if stamp == "time_usec" else given["by_us"] // 1000
            return {stamp: (old[stamp] + by) % top} if stamp else {}
        case "stamp_times":
            return {stamp: old[stamp] * given["by"] % top} if stamp else {}
        case "freeze":
            held = held.setdefault("all", {f: v for f, v in old.items() if f not in _TIMES})
            return held
    field = given["field"]
    if field not in old:
        return {}
    match name:
        case "axis_sign":
            return {field: -old[field]}
        case "axis_scale":
            return {field: given["by"] * old[field]}
        case "axis_freeze":
            return {field: held.setdefault(field, old[field])}
        case _:
            new = _fitting(
                float(given["to"]), old[field][0] if isinstance(old[field], list) else old[field]
            )
            return {field: [new] * len(old[field]) if isinstance(old[field], list) else new}


def _name(frame: bytes) -> str:
    kind = _kind(frame)
    return "" if kind is None else str(kind.msgname)


def _draw(rng: random.Random, sent: list[Sent]) -> Step:
    """A change that knows the messages."""
    there = {n for n in map(_name, (s.content for s in sent)) if n}
    steady = [n for n in STEADY if n in there]
    common = ("insert", "systems", "ports", "lose", "swap", "arrivals")
    if not steady:
        name = rng.choice(common)
    else:
        names = (
            "stray",
            "stamp_add",
            "stamp_times",
            "gap",
            "ends",
            "freeze",
            "absurd",
            "any_field",
        )
        name = rng.choice((*common, *names, *AXIS_FAULTS))
    given: dict[str, Any] = {}
    match name:
        case "insert":
            given = {
                "what": rng.choice(_STRANGE),
                "at": rng.random(),
                "times": rng.choice((1, 1, 30)),
                "system": rng.choice((1, 1, 2, 0)),
                "number": rng.randrange(256),
            }
        case "systems":
            given = {"count": rng.choice((1, 253))}
        case "ports":
            given = {"count": rng.choice((1, 64, 2000)), "seed": rng.getrandbits(32)}
        case "lose":
            given = {"share": rng.choice((0.01, 0.3)), "seed": rng.getrandbits(32)}
        case "swap":
            given = {"by_us": rng.choice((20_000, 300_000)), "seed": rng.getrandbits(32)}
        case "arrivals":
            given = {"from": rng.random(), "by_us": rng.choice((2**62, 86_400_000_000, -(10**7)))}
        case "axis_sign" | "axis_scale" | "axis_freeze":
            field = rng.choice(AXES)
            kind = next(k for k, fields in SENSED.items() if field in fields)
            given = {"kind": kind, "field": field}
            given |= draw_axis_fault(
                rng, name, "vel" if field[0] == "v" else field[1:], *_samples(sent, kind, field)
            )
        case _:
            given = {"kind": rng.choice(steady), "from": rng.choice((0.0, 0.3, 0.5))}
            if name in ("gap", "ends"):
                given["from"] = rng.uniform(0.2, 0.7)
                given["lasting_s"] = rng.choice((0.5, 1.0, 3.0))
            elif name in ("stray", "stamp_add"):
                given["by_us"] = rng.choice((2**40, 2**62, 2**63, 3_600_000_000))
                given["from"] = rng.choice((0.0, rng.random()))
            elif name == "stamp_times":
                given["by"] = rng.choice((1000, 10, 3))
            elif name in ("freeze", "absurd"):
                given["kind"] = rng.choice([k for k in SENSED if k in there] or steady)
            if name == "absurd":
                given["field"] = rng.choice(SENSED.get(given["kind"], ("actuator",)))
                given["to"] = repr(rng.choice([v for v in ABSURD if not abs(v) < 1e9]))
            elif name == "any_field":
                example = next(s for s in sent if _name(s.content) == given["kind"])
                given["field"] = rng.choice(
                    sorted(_values(_kind(example.content), example.content))
                )
                given["to"] = repr(rng.choice(ABSURD))
    return name, given


def _samples(sent: list[Sent], kind: str, field: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Times, s, and values of a field of one kind of message, shape (n,)."""
    found = [_values(_kind(s.content), s.content) for s in sent if _name(s.content) == kind]
    t_s = [1e-6 * v["time_usec"] for v in found]
    return np.array(t_s, np.float64), np.array([v[field] for v in found], np.float64)


def _moves(sent: list[Sent]) -> bool:
    """Whether the gyroscope reads more than one value."""
    kind, read = "HIGHRES_IMU", set()
    for one in sent:
        if _name(one.content) == kind:
            read.add(_values(_kind(one.content), one.content)["xgyro"])
            if len(read) > 9:
                return True
    return False


# -- the kinds --------------------------------------------------------------------------------


def _write_tlog(sent: list[Sent]) -> bytes:
    return b"".join(stamped(s.at_us, s.content) for s in sent)


def _read_tlog(blob: bytes) -> Iterator[Sent]:
    for frame in frames(blob):
        if isinstance(frame, Frame):
            yield Sent(frame.arrival_us, frame.content)


def _write_datagrams(sent: list[Sent]) -> bytes:
    return b"".join(_RECORD.pack(s.at_us, s.port, len(s.content)) + s.content for s in sent)


def _read_datagrams(blob: bytes) -> Iterator[Sent]:
    at = 0
    while at + _RECORD.size <= len(blob):
        at_us, port, length = _RECORD.unpack_from(blob, at)
        at += _RECORD.size
        yield Sent(at_us, blob[at : at + length], port)
        at += length


@cache
def _vehicle() -> Vehicle:
    return load_vehicle("copter_default")


def _hear(path: Path) -> Seen:
    """As `uavtwin live --record` without alarms: what is recorded, and what is said of the link."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "recording"
        session = LiveSession(_vehicle(), LiveOptions(Address("127.0.0.1", 0), record=folder))
        first_us = None
        for k, sent in enumerate(_read_datagrams(path.read_bytes())):
            first_us = sent.at_us if first_us is None else first_us
            at_s = min(1e-6 * abs(sent.at_us - first_us), 1e6)
            sender = ("127.0.0.1", sent.port)
            session.take(Datagram(sent.content, sender, at_s, sent.at_us))
            if k % 20 == 0:
                session.hand_over()
        told = session.end()
        if told.errors:
            raise AssertionError(f"a part failed: {told.errors}\n{_traceback(folder)}")
        said, content = set(), hashlib.sha256()
        for table in sorted(folder.glob("flight*.parquet")):
            flight = read_flight(table)
            said |= {f"{f.where}: {f.message}" for f in flight.findings if f.severity != "info"}
            content.update(flight.fingerprint.encode())
        link = told.link
        counted = ("lost", "reordered", "jumps", "late", "strays", "garbage", "wrong", "duplicates")
        said |= {f"{n}: {getattr(link, n)}" for n in counted if getattr(link, n)}
        said |= {f"{who}: {n}" for who, n in link.others.items()}
        said |= {f"section {k}" for k in range(1, told.sections)}
        if told.waits_for:
            said.add(told.waits_for)
        return Seen(content.hexdigest(), frozenset({*said, *told.missing.values()}))


def _traceback(folder: Path) -> str:
    errors = folder / "errors.txt"
    return errors.read_text("utf-8")[-1500:] if errors.exists() else ""


@dataclass(frozen=True)
class Messages:
    """The kind, in one of its forms."""

    file: str
    seconds: float
    write: Callable[[list[Sent]], bytes]
    load: Callable[[bytes], Iterator[Sent]]
    read: Callable[[Path], Seen]
    visible: frozenset[str] = frozenset(
        {"stray", "stamp_add", "stamp_times", "gap", "ends", "freeze", "absurd", "lose"}
        | {*AXIS_FAULTS}
    )

    def bases(self) -> dict[str, bytes]:
        """Of code alone."""
        return {m: self.write(list(_base(self.seconds, m))) for m in ("flown", "rest")}

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Three in four know the messages."""
        sent = list(_parsed(self, blob))
        if rng.random() < 0.25 or not sent:
            return draw_bytes(rng, blob)
        name, given = _draw(rng, sent)
        if name in self.visible - {"stray", "stamp_add", "lose"} and not _moves(sent):
            return draw_bytes(rng, blob)  # what rests contradicts nothing
        return name, given

    def apply(self, blob: bytes, step: Step) -> bytes:
        """As drawn; bytes that are no message are left out first."""
        name, given = step
        if name in _BYTES:
            return apply_bytes(blob, step)
        return self.write(_changed(list(_parsed(self, blob)), name, given))


@lru_cache(8)
def _parsed(kind: Messages, blob: bytes) -> tuple[Sent, ...]:
    return tuple(kind.load(blob))


TLOG = Messages("input.tlog", 20.0, _write_tlog, _read_tlog, read)
DATAGRAMS = Messages("input.datagrams", 5.0, _write_datagrams, _read_datagrams, _hear)
