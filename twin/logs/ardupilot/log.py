"""DataFlash files opened with care: what can be read is read, what cannot is counted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError
from ..clock import Timed, advancing, pauses, told_dropped
from ..flight import Array, Finding, Noted
from ..px4.order import out_of_place
from .file.binary import MARK, read_binary
from .file.definitions import in_si, instance_column
from .file.history import clock_of, documented_unit
from .file.messages import Content, Damage, Messages
from .file.plain import read_plain

STEADY = (
    *("ATT", "EKF1", "NKF1", "NKF6", "NKQ", "NKQ1", "NKQ2", "XKF1", "XKQ"),
    *("BARO", "BAR2", "BAT", *(f"BAT{k}" for k in range(2, 10)), "CURR", "CUR2"),
    *("CTUN", "ESC", *(f"ESC{k}" for k in range(1, 13))),
    *("GPS", "GPS2", "IMU", "IMU2", "IMU3", "MAG", "MAG2", "MAG3", "MOTB"),
    *("NTUN", "POS", "PSC", "PSCD", "PSCE", "PSCN", "RATE", "RCO2", "RCO3", "RCOU", "VIBE"),
)
"""Messages at a steady rate."""
SELDOM = ("DSF", "NKF4", "NKF9", "ORGN", "XKF4", "XKFS")
"""Messages at a low rate, or of which a few are used."""
EVENTS = ("ARM", "ERR", "EV", "MODE", "MSG", "PARM", "VER")
"""Messages of what happens; several may carry the same time."""
NEEDED = ("IMU", "RCOU", "XKF1", "XKQ", "ATT")
"""Some of them, for an error."""
OLDER = {
    "BARO": ("BARO", "BAR2"),
    "BAT": ("BAT", *(f"BAT{k}" for k in range(2, 10))),
    "CURR": ("CURR", "CUR2"),
    "ESC": tuple(f"ESC{k}" for k in range(1, 13)),
    "GPS": ("GPS", "GPS2"),
    "IMU": ("IMU", "IMU2", "IMU3"),
    "MAG": ("MAG", "MAG2", "MAG3"),
    "NKF1": ("NKF1", "NKF6"),
    "NKF4": ("NKF4", "NKF9"),
    "NKQ": ("NKQ1", "NKQ2"),
}
"""Before ArduPilot 4.1 an instance had a name of its own: the names of instance 0, 1, ..."""

_LONGEST_US = 365 * 86_400 * 1_000_000
_NEVER_US = 2**62
_FAR_US = 10_000_000
_APART_S = 0.15
_BLOCK = 512
_PAUSE_OF_TELEMETRY = ("ESC", *OLDER["ESC"])
"""Messages that come when the bus has them: their pauses are told with the rotor speeds."""
_NAMED = 3


@dataclass(frozen=True, slots=True, eq=False)
class Topic(Timed):
    """Messages of one name and instance, in order of time.

    Attributes:
        name: Of the messages.
        t_us: Time of each since the start of the flight, us, shape (n,).
        source: The messages that they are part of, with their units.
        rows: Which of them, shape (n,).
    """

    name: str
    t_us: NDArray[np.int64]
    source: Messages
    rows: NDArray[np.int64]

    def has(self, *fields: str) -> bool:
        """Whether every field is there and holds numbers."""
        return all(f in self.source.data and not self.source.definition.is_text(f) for f in fields)

    def raw(self, name: str) -> Array:
        """Numbers of a field as they are in the file, after the divisor of its format."""
        values = self.source.data[name][self.rows]
        with np.errstate(invalid="ignore"):  # damaged logs hold signalling NaN
            return np.asarray(values.astype(np.float64))

    def documented(self, column: str) -> tuple[str, float]:
        """Unit of a field by ArduPilot's history, and times which its number is in that unit."""
        told = self.source.definition
        return documented_unit(self.name, column, told.letters[told.columns.index(column)])

    def si(self, fields: Sequence[str]) -> Array:
        """Fields side by side in SI, shape (n, len(fields)).

        In the unit that the log gives, else (before ArduPilot 3.6) in the documented one.
        """
        units = self.source.units
        scaled = []
        for name in fields:
            unit, multiplier = self.documented(name)
            factor, _ = in_si(units.labels.get(name, ""), unit)
            given = units.multipliers.get(name, 1.0 if name in units.labels else multiplier)
            scaled.append(self.raw(name) * (given * factor))
        with np.errstate(invalid="ignore", over="ignore"):
            return np.column_stack(scaled)

    def contradicted(self, fields: Sequence[str]) -> list[str]:
        """Those of the fields that the log gives in a unit of another kind."""
        labels = self.source.units.labels
        return [f for f in fields if in_si(labels.get(f, ""), self.documented(f)[0])[1]]


@dataclass(slots=True)
class ArduPilotLog(Noted):
    """One DataFlash log on the clock of a flight.

    Attributes:
        path: File.
        content: What it holds.
        start_us: Time since boot that counts as 0, us.
        length_us: Length of the flight from there, the rest is not used; None: all of the log is.
        params: Parameters as they are at the end of the log.
        changed: Parameters that change in it.
        findings: Grows while the log is read.
    """

    path: Path
    content: Content
    start_us: int
    length_us: int | None = None
    params: dict[str, float] = field(default_factory=dict)
    changed: frozenset[str] = frozenset()
    findings: list[Finding] = field(default_factory=list)
    _dropped: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    """Of messages by name: those whose time is another clock's."""
    _topics: dict[tuple[str, int | None], Topic | None] = field(default_factory=dict)

    def texts(self, name: str, column: str) -> list[str]:
        """A column of texts of all messages of a name, [] without any."""
        messages = self.content.messages.get(name)
        if messages is None or column not in messages.data:
            return []
        return messages.texts(column) if messages.definition.is_text(column) else []

    def instances(self, name: str) -> list[int]:
        """Instances of a message, from 0."""
        messages = self.content.messages.get(name)
        if messages is not None and (column := _instance(messages)):
            return sorted(int(k) for k in np.unique(messages.data[column]) if np.isfinite(k))
        names = OLDER.get(name, (name,))
        return [k for k, n in enumerate(names) if n in self.content.messages]

    def topic(self, name: str, instance: int | None = None, *needs: str) -> Topic | None:
        """Messages in order, None where the log has none with these fields.

        Args:
            name: As of ArduPilot 4.1.
            instance: Which of several; None: all of them, for messages that have no instances.
            needs: Fields.
        """
        key = (name, instance)
        if key not in self._topics:
            self._topics[key] = self._ordered(name, instance, tell=True)
        topic = self._topics[key]
        if topic is not None and not topic.has(*needs):
            lacks = [f for f in needs if not topic.has(f)]
            self.note("warning", name, f"has no field {', '.join(lacks)}; it is not used")
            return None
        return topic

    def cut_to(self, begin_us: int, end_us: int) -> None:
        """Use a part of the log alone, and count time from its begin.

        Args:
            begin_us: Begin, us, on the clock of the log so far.
            end_us: End.
        """
        self.start_us += begin_us
        self.length_us = end_us - begin_us
        self._topics.clear()

    def whole(self, name: str, instance: int | None = None) -> Topic | None:
        """The same over all of the log, also outside the flight, and nothing told."""
        return self._ordered(name, instance, tell=False)

    def _messages(self, name: str, instance: int | None) -> tuple[Messages, NDArray[np.int64]]:
        """Messages of an instance: those they are among, and which rows."""
        messages = self.content.messages.get(name)
        column = _instance(messages) if messages is not None else ""
        if messages is not None and (instance is None or column):
            every = np.ones(len(messages.places), dtype=np.bool_)
            here = every if instance is None else messages.data[column] == instance
            return messages, np.flatnonzero(here)
        names = OLDER.get(name, (name,))
        messages = self.content.messages[names[instance or 0]]
        return messages, np.arange(len(messages.places))

    def _ordered(self, name: str, instance: int | None, tell: bool) -> Topic | None:
        try:
            messages, rows = self._messages(name, instance)
        except (KeyError, IndexError):
            return None
        dropped = self._dropped.get(messages.definition.name)
        rows = rows if dropped is None else rows[~dropped[rows]]
        t_us = stamps_us(messages)[rows] - self.start_us
        if tell and self.length_us is not None:
            inside = (t_us >= 0) & (t_us <= self.length_us)
            rows, t_us = rows[inside], t_us[inside]
        if len(rows) == 0:
            return None
        if name in EVENTS:
            order = np.argsort(t_us, kind="stable")
            return Topic(name, t_us[order], messages, rows[order])
        keep, *lost = advancing(t_us)
        for message, count in told_dropped("messages", *lost) if tell else ():
            self.note("error", name, message, count)
        if not keep.any():
            return None
        steady = name in STEADY and name not in _PAUSE_OF_TELEMETRY
        if tell and steady and (found := pauses(t_us[keep])):
            self.note("warning", name, found.told, found.count)
        return Topic(name, t_us[keep], messages, rows[keep])


def _instance(messages: Messages) -> str:
    return instance_column(messages.definition, messages.units)


def stamps_us(messages: Messages) -> NDArray[np.int64]:
    """Times since boot, us, shape (n,), of messages that have a clock."""
    clock = clock_of(messages.data)
    assert clock is not None
    stamps, factor = messages.data[clock[0]], clock[1]
    if stamps.dtype.kind == "f":
        known = np.isfinite(stamps) & (np.abs(stamps) < _NEVER_US)
        return np.where(known, stamps, _NEVER_US).astype(np.int64) * factor
    return np.minimum(stamps.astype(np.uint64), np.uint64(_NEVER_US // factor)).astype(
        np.int64
    ) * np.int64(factor)


def open_ardupilot(path: Path, blob: bytes) -> ArduPilotLog:
    """Parse a DataFlash log, binary or text.

    Args:
        path: File name, for messages.
        blob: Content of the file.

    Raises:
        LogError: Nothing in it can be used.
    """
    wanted = {*STEADY, *SELDOM, *EVENTS, "TIME"}
    binary = blob.startswith(MARK)
    content = read_binary(blob, wanted) if binary else read_plain(blob, wanted)
    clock = content.messages.get("TIME")
    first_logger = clock is not None and "StartTime" in clock.data
    content = Content(_stamped(content.messages), content.counts, content.damage)
    timed = {name: stamps_us(m) for name, m in content.messages.items()}
    steady = [t for n, t in timed.items() if n in STEADY]
    if not steady and first_logger:
        raise LogError(
            f"{path.name}: a log of PX4's first logger (sdlog2, .px4log, up to PX4 1.5), which has "
            "the container of ArduPilot and other messages: not read. Convert it to a flight table "
            "(CSV), SI, FRD and NED."
        )
    if not steady:
        total = sum(content.counts.values())
        raise LogError(
            f"{path.name}: ArduPilot DataFlash log of {len(blob)} bytes, {total} messages, none of "
            f"{', '.join(NEEDED)} or the like. It was cut behind its definitions, or nothing was "
            "logged: copy it again, or set LOG_BITMASK and fly again."
        )
    amid = int(np.median([np.median(t) for t in steady]))
    log = ArduPilotLog(path, content, amid)
    _note_damage(log, content.damage, len(blob) if binary else 0)
    _hold_against_the_file(log, timed)
    first = min(int(t[0]) for n in timed if (t := _kept(log, n, timed[n])).size)
    log.start_us = first
    _parameters(log)
    return log


def _stamped(found: Mapping[str, Messages]) -> dict[str, Messages]:
    """Messages that have a clock, and events that have none (up to Copter 3.2) with the time of the
    last message before them in the file that has one, the first one's before that."""
    timed = {n: m for n, m in found.items() if clock_of(m.data) and len(m.places)}
    steady = [m for n, m in timed.items() if n in STEADY]
    if not steady:
        return timed
    places = np.concatenate([m.places for m in steady])
    order = np.argsort(places, kind="stable")
    places, stamps = places[order], np.concatenate([stamps_us(m) for m in steady])[order]
    for name, each in found.items():
        if name in EVENTS and name not in timed and len(each.places):
            last = np.maximum(np.searchsorted(places, each.places) - 1, 0)
            data = {**each.data, "TimeUS": stamps[last]}
            timed[name] = Messages(each.definition, each.places, data, each.units)
    return timed


def _kept(log: ArduPilotLog, name: str, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Stamps of the messages that are used, in order."""
    dropped = log._dropped.get(name)
    return np.sort(stamps if dropped is None else stamps[~dropped])


def _note_damage(log: ArduPilotLog, damage: Damage, size: int) -> None:
    """Findings on a log cut short or damaged; `size` is that of a binary one."""
    if damage.lost:
        log.note(
            "error",
            "log",
            f"damaged: {damage.lost} bytes in {damage.stretches} "
            f"{'place' if damage.stretches == 1 else 'places'} make no sense and are not used",
            damage.lost,
        )
    if damage.tail and size and size % _BLOCK == 0:
        log.note(
            "info",
            "log",
            f"it ends inside a message: the last {damage.tail} bytes are not used. That is normal, "
            "ArduPilot writes whole blocks",
        )
    elif damage.tail:
        log.note(
            "error",
            "log",
            f"cut short: it ends inside a message; the last {damage.tail} bytes are not used",
            damage.tail,
        )
    for found, what in (
        (damage.undefined, "definitions that make no sense; their messages are not read"),
        (damage.redefined, "messages that are defined twice, and differently"),
    ):
        if found:
            named = ", ".join(list(dict.fromkeys(found))[:_NAMED])
            log.note("error", "FMT", f"{what}: {named}", len(found))


def _hold_against_the_file(log: ArduPilotLog, timed: Mapping[str, NDArray[np.int64]]) -> None:
    """Drop messages stamped far from what stands beside them in the file; doubt whole topics."""
    names = [n for n in timed if n not in EVENTS]
    places = [log.content.messages[n].places for n in names]
    stamps = [np.clip(timed[n] - log.start_us, -_LONGEST_US, _LONGEST_US) for n in names]
    for name, off_us in zip(names, out_of_place(places, stamps), strict=True):
        far = np.abs(off_us) > _FAR_US
        middle_s = float(np.median(off_us)) * 1e-6
        if far.any():
            log.note(
                "error",
                name,
                f"messages dropped, stamped over {_FAR_US * 1e-6:.0f} s from what stands beside "
                f"them in the file (median {middle_s:+.3g} s): another clock, or another unit?",
                int(far.sum()),
            )
            log._dropped[name] = far
        if abs(middle_s) > _APART_S and not far.all():
            log.note(
                "error",
                name,
                f"stamped {middle_s:+.2f} s from what stands beside it in the file: another clock?",
            )


def _parameters(log: ArduPilotLog) -> None:
    """Parameters, and those that change; values that are none are left out."""
    messages = log.content.messages.get("PARM")
    if messages is None or not {"Name", "Value"} <= set(messages.data):
        return
    changed = set()
    for name, value in zip(
        messages.texts("Name"), messages.data["Value"].astype(np.float64).tolist(), strict=True
    ):
        if not np.isfinite(value):
            continue
        value = float(f"{value:.7g}")  # written as float
        if log.params.get(name, value) != value:
            changed.add(name)
        log.params[name] = value
    log.changed = frozenset(changed)
