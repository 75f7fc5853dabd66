"""Tolerant reader of PX4 ULog files: unreadable parts are counted, the others are read."""

import contextlib
import io
import re
import struct
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog

from ...errors import LogError
from ..autopilot import MOST_MESSAGES, MOST_PARAMETERS, Level, Message, as_text
from ..flight import Array, Finding, FindingCollector
from ..stamps import (
    APART_S,
    Timed,
    missing_ends,
    monotonic_samples,
    note_cut,
    pauses,
    stamp_offsets,
    stray_samples,
    with_fields,
)

# -- definitions of messages --------------------------------------------------------------------
#
# Message definitions of a ULog, checked before pyulog expands them.

_FIRST_DATA = b"AL"  # the first of these ends the definitions
_DEFINED = b"FA"  # formats and subscriptions
_LONGEST = 10000  # bytes of a message; longer ones are damage
_MOST_FIELDS = 65535  # the length of a message has 16 bits, a field at least 8
_MOST_UNFOLDED = 2_000_000  # fields of all subscriptions together; a PX4 log has some 5000
_BASIC = re.compile(r"u?int(8|16|32|64)_t|float|double|bool|char")
"""Basic types of a field."""
_ADDED = 3  # bytes before the name of the topic in a subscription


def messages(blob: bytes) -> NDArray[np.int64]:
    """Kind, start and end of the content of each complete message of the file; shape (n, 3)."""
    found = array("q")
    at, end = 16, len(blob)
    header = struct.Struct("<HB").unpack_from
    while at + 3 <= end:
        size, kind = header(blob, at)
        after = at + 3 + size
        if after > end:
            break
        found.extend((kind, at + 3, after))
        at = after
    return np.frombuffer(found, np.int64).reshape(-1, 3)


def data_places(blob: bytes, found: NDArray[np.int64]) -> dict[int, NDArray[np.int64]]:
    """Positions of each subscription's samples among all samples of the file, by message id.

    Args:
        blob: Content of the file.
        found: Messages of the file.
    """
    kind, start, end = found.T
    first = start[(kind == ord("D")) & (end - start >= 2)]
    content = np.frombuffer(blob, np.uint8)
    ids = content[first] + 256 * content[first + 1].astype(np.int64)
    return {int(k): np.flatnonzero(ids == k) for k in np.unique(ids)}


def check_definitions(path: Path, blob: bytes, found: NDArray[np.int64]) -> None:
    """Refuse a log whose definitions are incomplete, damaged or infinite.

    pyulog 1.3 never returns from some damaged definitions, and expands nested formats of any depth.

    Args:
        path: File name, for messages.
        blob: Content of the file.
        found: Messages of the file.

    Raises:
        LogError: The definitions are of this kind.
    """
    kind, start, end = found.T
    data = np.flatnonzero(np.isin(kind, list(_FIRST_DATA)))
    definitions = slice(data[0] if len(data) else None)
    length = (end - start)[definitions]
    senseless = (kind[definitions] == 0) | (length <= 0) | (length > _LONGEST)
    if senseless.any():
        raise LogError(
            f"{path.name}: damaged ULog: byte {start[senseless.argmax()] - 3} of {len(blob)}, "
            "within its definitions, makes no sense. Copy the log from the vehicle again."
        )
    if not len(data):
        raise LogError(
            f"{path.name}: ULog cut short within its definitions after {len(blob)} bytes, before "
            "any sample. Copy the log from the vehicle again."
        )
    _check_formats(path, blob, found[np.isin(kind, list(_DEFINED))])


def _check_formats(path: Path, blob: bytes, found: NDArray[np.int64]) -> None:
    """Refuse formats with more fields than a message can have, and too many subscriptions."""
    inner: dict[str, list[tuple[str, int]]] = {}
    unfolded = 0
    sizes: dict[str, int] = {}
    for kind, start, end in found.tolist():
        if kind == ord("F"):
            name, _, fields = blob[start:end].decode("utf-8", "ignore").partition(":")
            inner[name] = [_kind(f) for f in fields.split(";") if f]
            sizes.clear()
        else:
            name = blob[start + _ADDED : end].decode("utf-8", "ignore")
            if name not in sizes:
                sizes[name] = _unfolded(path, name, inner, sizes)
            unfolded += sizes[name]
        if unfolded > _MOST_UNFOLDED:
            raise LogError(
                f"{path.name}: damaged ULog: its subscriptions have over {_MOST_UNFOLDED} fields. "
                "Copy the log from the vehicle again."
            )
    for name in inner:  # damage may hide a subscription from this loop
        if name not in sizes:
            _unfolded(path, name, inner, sizes)


def _kind(field: str) -> tuple[str, int]:
    """Type of a field and its number of elements."""
    kind, _, rest = field.split(" ")[0].partition("[")
    count = rest.rstrip("]")
    return kind, int(count) if count.isdecimal() and len(count) < 8 else 1


def _unfolded(
    path: Path, name: str, inner: dict[str, list[tuple[str, int]]], sizes: dict[str, int]
) -> int:
    """Number of fields of a format with those of nested formats, each of which counts as one
    more."""
    pending = [name]
    while pending:
        top = pending[-1]
        within = [(k, n) for k, n in inner.get(top, []) if not _BASIC.fullmatch(k)]
        unknown = [k for k, _ in within if k not in sizes]
        if any(k in pending for k in unknown):
            raise LogError(
                f"{path.name}: damaged ULog: the format '{top[:40]}' contains itself. Copy the "
                "log from the vehicle again."
            )
        if unknown:
            pending.append(unknown[0])
            continue
        sizes[top] = 1 + sum(n * sizes.get(k, 1) for k, n in inner.get(top, []))
        if sizes[top] > _MOST_FIELDS:
            raise LogError(
                f"{path.name}: damaged ULog: the format '{top[:40]}' has over {_MOST_FIELDS} "
                "fields, more than a message can hold. Copy the log from the vehicle again."
            )
        pending.pop()
    return sizes[name]


# -- the log ------------------------------------------------------------------------------------

_MESSAGES = b"BFIMPQADLCSOR"  # kinds of message of ULog
_EVENTS = ("vehicle_command",)  # several may carry the same time
_ASIDE = ("trajectory_setpoint", "vehicle_local_position_setpoint", "vehicle_status")
"""Topics without signals: their samples are not used to check times."""
_ON_CHANGE = (  # topics without a steady rate
    *("actuator_armed", "estimator_sensor_bias", "vehicle_land_detected"),
    *(*_EVENTS, *_ASIDE),
)
_LEVELS: dict[int, Level] = {
    **{ord("0"): "emergency", ord("1"): "alert", ord("2"): "critical", ord("3"): "error"},
    **{ord("4"): "warning", ord("5"): "notice", ord("6"): "info", ord("7"): "debug"},
}
"""Levels of logged messages in the ULog format."""
_LONGEST_US = 365 * 86_400 * 1_000_000  # a year: times beyond are damage
_LATEST_US = 1_000_000  # between sampling and publication; beyond is invalid
_STRAY_US = 700_000  # valid logs: under 500 ms in the burst of their first second
_SLOW_MS = 150.0  # valid logs have at most 25
TOPICS = (  # that are parsed
    "actuator_armed",
    "actuator_controls_0",
    "actuator_motors",
    "actuator_outputs",
    "battery_status",
    "esc_status",
    "estimator_sensor_bias",
    "multirotor_motor_limits",
    "rate_ctrl_status",
    "sensor_combined",
    "sensor_gps",
    "vehicle_acceleration",
    "vehicle_air_data",
    "vehicle_angular_velocity",
    "vehicle_attitude",
    "vehicle_attitude_setpoint",
    "vehicle_command",
    "vehicle_gps_position",
    "vehicle_imu",
    "vehicle_imu_status",
    "vehicle_land_detected",
    "vehicle_local_position",
    "vehicle_magnetometer",
    "vehicle_mocap_odometry",
    "vehicle_rates_setpoint",
    "vehicle_visual_odometry",
    *_ASIDE,
)

NEEDED = ("sensor_combined", "vehicle_attitude", "vehicle_local_position", "actuator_outputs")
"""The most important topics, for an error text."""


@dataclass(frozen=True, slots=True)
class Topic(Timed):
    """Samples of one topic instance, in order of time.

    Attributes:
        name: Topic name.
        t_us: Time of each sample since the start of the log, us, shape (n,): time of sampling where
            the log has it, else time of publication.
        data: Fields by name, each of shape (n,).
        by_sample_time: Whether `t_us` is the time of sampling.
    """

    name: str
    t_us: NDArray[np.int64]
    data: Mapping[str, NDArray[Any]]
    by_sample_time: bool

    def has(self, *fields: str) -> bool:
        """Whether the topic has every field."""
        return all(f in self.data for f in fields)

    def columns(self, fields: Sequence[str]) -> Array:
        """Fields side by side, shape (n, len(fields))."""
        with np.errstate(invalid="ignore"):  # damaged logs contain signalling NaN
            return np.column_stack([self.data[f].astype(np.float64) for f in fields])

    def array(self, stem: str, n: int) -> Array:
        """Array field `stem[0..n-1]`, shape (n_samples, n)."""
        return self.columns([f"{stem}[{i}]" for i in range(n)])

    def at(self, t_us: NDArray[np.int64], name: str) -> Array:
        """Value of a field at other times, constant from its last sample, the first one before
        that."""
        index = np.searchsorted(self.t_us, t_us, side="right") - 1
        with np.errstate(invalid="ignore"):
            return self.data[name].astype(np.float64)[np.maximum(index, 0)]


@dataclass(slots=True)
class Px4Log(FindingCollector):
    """One ULog in its own time.

    Attributes:
        path: Path of the file.
        start_us: Time of the log's start on the flight controller's clock, us.
        params: Parameters with the changes made during the flight applied.
        changed: Parameters changed after the start of the log.
        info: Facts of the log about firmware and hardware.
        defaults: Logged defaults of parameters: PX4 omits those of unchanged ones.
        messages: Texts that the autopilot logged, in order of time.
        findings: Findings so far.
        span_us: First and last time at which two topics of constant rate are logged, us since the
            start.
    """

    path: Path
    start_us: int
    params: dict[str, float]
    changed: frozenset[str]
    info: dict[str, str]
    defaults: dict[str, float] = field(default_factory=dict)
    messages: tuple[Message, ...] = ()
    findings: list[Finding] = field(default_factory=list)
    span_us: tuple[int, int] = (0, 0)
    _raw: dict[tuple[str, int], Mapping[str, NDArray[Any]]] = field(default_factory=dict)
    _topics: dict[tuple[str, int], Topic | None] = field(default_factory=dict)

    @property
    def release(self) -> int:
        """Firmware version, one byte per part from the top; 0 where the log has no valid one."""
        number = self.info.get("ver_sw_release", "")
        return int(number) if number.isdecimal() and len(number) < 11 else 0

    def instances(self, name: str) -> list[int]:
        """Numbers of the instances of a topic that have samples."""
        return sorted(k for n, k in self._raw if n == name)

    def fields(self, name: str) -> Mapping[str, NDArray[Any]]:
        """Fields of the first instance of a topic, in the order of the file; {} without it."""
        return self._raw.get((name, 0), {})

    def topic(self, name: str, instance: int = 0, *needs: str) -> Topic | None:
        """A topic with its samples in order of time, None where the log has none with these
        fields."""
        key = (name, instance)
        if key not in self._topics:
            self._topics[key] = self._ordered(name, instance)
        return with_fields(self, name, self._topics[key], needs)

    def aside(self, name: str, *needs: str) -> Topic | None:
        """A topic as from `topic`, without findings, for one that has no signals."""
        before = list(self.findings)
        topic = self._topics.get((name, 0)) or self._ordered(name, 0)
        self.findings[:] = before
        return topic if topic is not None and topic.has(*needs) else None

    def _ordered(self, name: str, instance: int) -> Topic | None:
        raw = self._raw.get((name, instance))
        if raw is None:
            return None
        published = _from_px4_us(raw["timestamp"], self.start_us)
        possible = np.abs(published) < _LONGEST_US
        message = "samples dropped, stamped over a year from the start of the log"
        self.note("error", name, message, ~possible)
        if not possible.all():
            raw = {k: v[possible] for k, v in raw.items()}
            published = published[possible]
            if len(published) == 0:
                return None
        t_us, by_sample = self._sampled(name, raw, published)
        if name in _EVENTS:
            order = np.argsort(t_us, kind="stable")
            return Topic(name, t_us[order], {k: v[order] for k, v in raw.items()}, by_sample)
        if by_sample:
            message = "times of publication run backward or repeat; those of sampling are used"
            self.note("warning", name, message, np.diff(published) <= 0)
        keep = monotonic_samples(self, name, t_us, "samples")
        if not keep.any():
            return None
        data = {k: v[keep] for k, v in raw.items()}
        if name not in _ON_CHANGE:
            if found := pauses(t_us[keep]):
                self.note("warning", name, found.message, found.count)
            for text in missing_ends(t_us[keep], *self.span_us):
                self.note("warning", name, text)
        return Topic(name, t_us[keep], data, by_sample)

    def _sampled(
        self, name: str, raw: Mapping[str, NDArray[Any]], published: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], bool]:
        """Times of sampling where a topic has them, and whether it has."""
        if "timestamp_sample" not in raw:
            return published, False
        sampled = _from_px4_us(raw["timestamp_sample"], self.start_us)
        late = published - sampled
        valid = (raw["timestamp_sample"] != 0) & (np.abs(late) < _LATEST_US)
        by_sample = bool(valid.mean() > 0.5)
        message = "samples without a sampling time: published time taken"
        self.note("warning", name, message, ~valid if by_sample else len(valid))
        if not by_sample:
            return published, False
        ahead = valid & (late < 0)
        self.note("warning", name, "samples published before they were taken", ahead)
        slow_ms = float(np.median(late[valid])) / 1e3
        if slow_ms > _SLOW_MS:
            self.note(
                "warning",
                name,
                f"published {slow_ms:.0f} ms after its samples were taken: is one "
                "of its clocks off?",
            )
        return np.where(valid, sampled, published), True


def _from_px4_us(stamps: NDArray[Any], start_us: int) -> NDArray[np.int64]:
    """PX4 time stamps (us since boot, unsigned) -> us since the start of the log."""
    start = np.uint64(start_us & 0xFFFF_FFFF_FFFF_FFFF)  # a difference below zero wraps twice
    return np.asarray((stamps.astype(np.uint64) - start).view(np.int64))


def _finite(value: object) -> bool:
    """Whether a parameter has a valid value; damaged logs have text or NaN."""
    return isinstance(value, int | float) and bool(np.isfinite(value))


def _left_over(blob: bytes, found: NDArray[np.int64]) -> tuple[int, int]:
    """Bytes of an incomplete message at the end, and bytes that could not be decoded."""
    strange = np.flatnonzero(~np.isin(found[:, 0], list(_MESSAGES)))
    if len(strange):
        return 0, len(blob) - int(found[strange[0], 1]) + 3
    rest = blob[int(found[-1, 2]) if len(found) else 16 :]
    return (0, len(rest)) if len(rest) > 2 and rest[2] not in _MESSAGES else (len(rest), 0)


def open_px4(path: Path, blob: bytes) -> Px4Log:
    """Parse a ULog.

    Args:
        path: File name, for messages.
        blob: Content of the file.

    Raises:
        LogError: Nothing in the file can be used.
    """
    found = messages(blob)
    check_definitions(path, blob, found)
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            log = ULog(io.BytesIO(blob), list(TOPICS))
    except Exception as error:  # pyulog raises many kinds on damaged files
        raise LogError(
            f"{path.name}: damaged ULog, {len(blob)} bytes: its definitions cannot be read "
            f"({type(error).__name__}: {error}). Copy the log from the vehicle again."
        ) from error
    raw = {
        (d.name, int(d.multi_id)): d.data
        for d in log.data_list
        if len(d.data.get("timestamp", ())) > 0
    }
    if not {name for name, _ in raw} - {*_ASIDE}:
        raise LogError(
            f"{path.name}: ULog of {len(blob)} bytes without any sample of "
            f"{', '.join(NEEDED)} or the like. The log was cut inside its header, or "
            "logging never started: copy the log again, or set SDLOG_MODE and fly again."
        )
    start = int(log.start_timestamp)
    first = int(
        np.median([float(d["timestamp"][0]) for (name, _), d in raw.items() if name not in _ASIDE])
    )
    absurd = abs(first - start) > _LONGEST_US
    params = {k: float(v) for k, v in log.initial_parameters.items() if _finite(v)}
    changes = [c for c in log.changed_parameters if _finite(c[2])]
    params.update({c[1]: float(c[2]) for c in changes})
    opened = Px4Log(
        path,
        first if absurd else start,
        params,
        frozenset(c[1] for c in changes if c[0] > start),
        {k: str(v) for k, v in log.msg_info_dict.items()},
        _defaults(log),
        _messages(log, first if absurd else start),
        _raw=raw,
    )
    if absurd:
        opened.note(
            "error",
            "clock",
            f"the header's time stamp, {start} us, is over a year from those of the samples; t = 0 "
            "is the first of these",
        )
    _note_damage(opened, len(blob), _left_over(blob, found), log)
    places = data_places(blob, found)
    _drop_misplaced(opened, places, {(d.name, int(d.multi_id)): d.msg_id for d in log.data_list})
    opened.span_us = _span_us(opened)
    return opened


def _defaults(log: ULog) -> dict[str, float]:
    """Defaults of the configured airframe, else of the firmware."""
    defaults = {**log.get_default_parameters(0), **log.get_default_parameters(1)}
    return {k: float(v) for k, v in list(defaults.items())[:MOST_PARAMETERS] if _finite(v)}


def _messages(log: ULog, start_us: int) -> tuple[Message, ...]:
    """Texts logged within a year of the start; the first ones where there are very many."""
    tagged = [m for several in log.logged_messages_tagged.values() for m in several]
    found = []
    for each in [*log.logged_messages, *tagged]:
        t_us = int(each.timestamp) - start_us
        if abs(t_us) < _LONGEST_US and (text := as_text(each.message)):
            found.append(Message(t_us * 1e-6, _LEVELS.get(each.log_level, ""), text))
    return tuple(sorted(found, key=lambda m: m.t_s)[:MOST_MESSAGES])


def _span_us(opened: Px4Log) -> tuple[int, int]:
    """The second time at which a topic of constant rate begins and the last but one at which one
    ends: a single topic may be wrong."""
    times = [
        _from_px4_us(raw["timestamp"], opened.start_us)
        for (name, _), raw in opened._raw.items()
        if name not in _ON_CHANGE
    ]
    begins, ends = sorted(int(t.min()) for t in times), sorted(int(t.max()) for t in times)
    return (begins[:2][-1], ends[-2:][0]) if times else (0, 0)


def _drop_misplaced(
    opened: Px4Log, places: Mapping[int, NDArray[np.int64]], ids: Mapping[tuple[str, int], int]
) -> None:
    """Drop samples stamped far from their neighbours in the file; findings on topics with many.

    A damaged log, with messages that could not be decoded, is not changed.
    """
    raw = opened._raw
    steady = [k for k in raw if k[0] not in _ON_CHANGE]
    whole = [k for k in steady if len(places.get(ids[k], ())) == len(raw[k]["timestamp"])]
    stamps = [_from_px4_us(raw[k]["timestamp"], opened.start_us) for k in whole]
    stamps = [np.clip(s, -_LONGEST_US, _LONGEST_US) for s in stamps]
    off_us = stamp_offsets([places[ids[k]] for k in whole], stamps)
    dropped = stray_samples(opened, [name for name, _ in whole], off_us, "samples")
    for key, off, far in zip(whole, off_us, dropped, strict=True):
        if far.all():
            del raw[key]
        elif far.any():
            raw[key] = {k: v[~far] for k, v in raw[key].items()}
        elif abs(float(np.median(off))) <= 1e6 * APART_S:
            message = f"samples stamped over {_STRAY_US * 1e-6:.1f} s from what stands next to them"
            opened.note("warning", key[0], f"{message} in the file", np.abs(off) > _STRAY_US)


def _note_damage(opened: Px4Log, size: int, left: tuple[int, int], log: Any) -> None:
    """Findings on a truncated or damaged log, or one with drop-outs."""
    tail, lost = left
    if lost or log.file_corruption:
        opened.note(
            "error",
            "log",
            f"damaged: {lost} of {size} bytes follow the first message that makes no "
            "sense; the messages found after it are used, the rest is lost",
            max(lost, 1),
        )
    else:
        note_cut(opened, tail)
    if log.dropouts:
        lost_ms = sum(d.duration for d in log.dropouts)
        opened.note(
            "warning",
            "log",
            f"drop-outs while logging, {lost_ms} ms together, the longest "
            f"{max(d.duration for d in log.dropouts)} ms; use a faster card or log less",
            len(log.dropouts),
        )
