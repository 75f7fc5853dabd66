"""Tolerant reader of DataFlash files: unreadable parts are counted, the others are read."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError
from ..flight import Array, Finding, FindingCollector
from ..stamps import (
    Timed,
    monotonic,
    monotonic_samples,
    note_cut,
    pauses,
    stamp_offsets,
    stray_samples,
    with_fields,
)
from .file import MARK, Content, Damage, Messages, in_si, instance_column, read_binary, read_plain

# -- units and clocks of old releases -----------------------------------------------------------
#
# Units and clocks of DataFlash messages where the log has none (before FMTU, ArduPilot 3.6).
#
# One table for all releases: message and field, and where the releases differ the letter of the
# field's format. Source: ArduPilot, LogStructure.h of DataFlash and AP_Logger and Log.cpp of
# ArduCopter, 3.1 to 4.6, and the factors in the functions that write the messages.


@dataclass(frozen=True, slots=True)
class Quantity:
    """Unit of several fields of several messages.

    Attributes:
        messages: Names of the messages, for instance 0.
        fields: Names of the fields.
        unit: ArduPilot's name of the unit, a key of `definitions.SI`.
        multiplier: Factor from a number to that unit, after the divisor of its format.
        by_letter: Factor for single letters of the format.
    """

    messages: str
    fields: str
    unit: str
    multiplier: float = 1.0
    by_letter: Mapping[str, float] = field(default_factory=dict)


_HUNDREDTHS = {"h": 1e-2}  # int16 fields in hundredths
QUANTITIES = (
    Quantity("IMU", "GyrX GyrY GyrZ", "rad/s"),
    Quantity("IMU", "AccX AccY AccZ", "m/s/s"),
    Quantity("RATE", "R P Y RDes PDes YDes", "deg/s"),
    Quantity("MAG", "MagX MagY MagZ", "Gauss", 1e-3),
    Quantity("BARO", "Press", "Pa"),
    Quantity("ATT EKF1 NKF1 XKF1", "Roll Pitch Yaw DesRoll DesPitch DesYaw", "deg"),
    Quantity("NKQ XKQ", "Q1 Q2 Q3 Q4", "1"),
    Quantity("EKF1 NKF1 XKF1", "VN VE VD", "m/s"),
    Quantity("EKF1 NKF1 XKF1", "PN PE PD", "m"),
    Quantity("PSCN PSCE PSCD", "PN PE PD TPN TPE TPD", "m"),
    Quantity("PSCN PSCE PSCD", "VN VE VD TVN TVE TVD DVN DVE DVD", "m/s"),
    Quantity("PSC", "PX PY", "m"),
    Quantity("PSC", "VX VY", "m/s"),
    Quantity("NTUN", "PosX PosY", "m", 1e-2),
    Quantity("NTUN", "VelX VelY", "m/s", 1e-2),
    Quantity("CTUN", "Alt", "m"),
    Quantity("CTUN", "CRt", "m/s", 1e-2),
    Quantity("BAT", "Volt", "V"),
    Quantity("BAT", "Curr", "A"),
    Quantity("CURR", "Volt", "V", by_letter=_HUNDREDTHS),
    Quantity("CURR", "Curr", "A", by_letter=_HUNDREDTHS),
    # `e` is rpm (4.0); `c`, up to 3.6, is a tenth of the rpm, divided by the 100 of its letter
    Quantity("ESC", "RPM", "rpm", by_letter={"c": 1e3}),
    Quantity("ESC", "Volt", "V"),
)
"""Documented units. Frames are those of the flight table in every release, FRD and NED; fields that
are positive upward (Alt and CRt) change their sign in the reader."""
_BY_FIELD = {(m, f): q for q in QUANTITIES for m in q.messages.split() for f in q.fields.split()}
"""Quantity by message and field."""


def documented_unit(message: str, column: str, letter: str) -> tuple[str, float]:
    """Documented unit of a field in ArduPilot, and the factor from its number to that unit.

    Args:
        message: Name of the message, for instance 0.
        column: Name of the field.
        letter: Letter of the field's format.
    """
    found = _BY_FIELD[message, column]
    return found.unit, found.by_letter.get(letter, found.multiplier)


def clock_of(columns: Mapping[str, object]) -> tuple[str, int] | None:
    """The column with the time since boot, and its unit in us; None where a message has none.

    GPS of Copter up to 3.2 has the time of week in TimeMS, and the time since boot in T. PARM, MSG,
    EV, ERR and MODE have no time up to 3.2.
    """
    if "TimeUS" in columns:
        return "TimeUS", 1
    if "TimeMS" in columns:
        return ("T" if "T" in columns else "TimeMS"), 1000
    return None


NAMES = {
    "MOT_SPIN_MAX": "MOT_THST_MAX",
    "MOT_BAT_VOLT_MAX": "MOT_THST_BAT_MAX",
    "MOT_BAT_VOLT_MIN": "MOT_THST_BAT_MIN",
}
"""Parameter names of Copter up to 3.4, by present name."""
FRAMES = {
    **{"QUAD": 1, "HEXA": 2, "OCTA": 3, "OCTA_QUAD": 4, "Y6": 5},
    **{"HELI": 6, "TRI": 7, "SINGLE": 8, "COAX": 9},
}
"""FRAME_CLASS by the message `Frame: QUAD`: up to Copter 3.4 each frame had its own firmware."""


# -- the log ------------------------------------------------------------------------------------

STEADY = (
    *("ATT", "EKF1", "NKF1", "NKF6", "NKQ", "NKQ1", "NKQ2", "XKF1", "XKQ"),
    *("BARO", "BAR2", "BAT", *(f"BAT{k}" for k in range(2, 10)), "CURR", "CUR2"),
    *("CTUN", "ESC", *(f"ESC{k}" for k in range(1, 13))),
    *("GPS", "GPS2", "IMU", "IMU2", "IMU3", "MAG", "MAG2", "MAG3", "MOTB"),
    *("NTUN", "POS", "PSC", "PSCD", "PSCE", "PSCN", "RATE", "RCO2", "RCO3", "RCOU", "VIBE"),
)
"""Messages at a constant rate."""
SELDOM = ("DSF", "NKF4", "NKF9", "ORGN", "XKF4", "XKFS")
"""Messages at a low rate, or of which few are used."""
EVENTS = ("ARM", "ERR", "EV", "MODE", "MSG", "PARM", "VER")
"""Messages on events; several may have the same time."""
NEEDED = ("IMU", "RCOU", "XKF1", "XKQ", "ATT")
"""The most important messages, for an error text."""
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
"""Names of instance 0, 1, ... of a message before ArduPilot 4.1."""

_LONGEST_US = 365 * 86_400 * 1_000_000  # a year: times beyond are damage
_NEVER_US = 2**62  # replaces a time beyond int64
_BLOCK = 512  # bytes that ArduPilot writes at once
_PAUSE_OF_TELEMETRY = ("ESC", *OLDER["ESC"])
"""Messages at irregular times: their pauses are reported with the rotor speeds."""
_NAMED = 3  # definitions that a finding lists


@dataclass(frozen=True, slots=True, eq=False)
class Topic(Timed):
    """Messages of one name and instance, in order of time.

    Attributes:
        name: Name of the messages.
        t_us: Time of each since the start of the flight, us, shape (n,).
        source: The messages with their units, of which this topic is a selection.
        rows: Indices into these messages, shape (n,).
    """

    name: str
    t_us: NDArray[np.int64]
    source: Messages
    rows: NDArray[np.int64]

    def has(self, *fields: str) -> bool:
        """Whether the topic has every field as numbers."""
        return all(f in self.source.data and not self.source.definition.is_text(f) for f in fields)

    def raw(self, name: str) -> Array:
        """Numbers of a field as they are in the file, after the divisor of its format."""
        values = self.source.data[name][self.rows]
        with np.errstate(invalid="ignore"):  # damaged logs contain signalling NaN
            return np.asarray(values.astype(np.float64))

    def documented(self, column: str) -> tuple[str, float]:
        """Documented unit of a field in ArduPilot, and the factor from its number to that unit."""
        layout = self.source.definition
        return documented_unit(self.name, column, layout.letters[layout.columns.index(column)])

    def si(self, fields: Sequence[str]) -> Array:
        """Fields side by side in SI, shape (n, len(fields)).

        From the unit in the log, else (before ArduPilot 3.6) from the documented one.
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
        """Fields whose unit in the log is one of another quantity."""
        labels = self.source.units.labels
        return [f for f in fields if in_si(labels.get(f, ""), self.documented(f)[0])[1]]


@dataclass(slots=True)
class ArduPilotLog(FindingCollector):
    """One DataFlash log in time of a flight.

    Attributes:
        path: Path of the file.
        content: Content of the file.
        start_us: Time since boot that is time 0, us.
        length_us: Length of the flight from time 0; later data are not used; None: all of the log
            is used.
        params: Parameters at the end of the log.
        changed: Parameters that change during the log.
        findings: Findings so far.
    """

    path: Path
    content: Content
    start_us: int
    length_us: int | None = None
    params: dict[str, float] = field(default_factory=dict)
    changed: frozenset[str] = frozenset()
    findings: list[Finding] = field(default_factory=list)
    _dropped: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    """Masks of messages with a time of another clock, by name."""
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
        """Messages in order of time, None where the log has none with these fields.

        Args:
            name: Name of the message as in ArduPilot 4.1.
            instance: Number of the instance; None: all messages, for messages without instances.
            needs: Names of required fields, separated by spaces.
        """
        key = (name, instance)
        if key not in self._topics:
            self._topics[key] = self._ordered(name, instance, with_findings=True)
        return with_fields(self, name, self._topics[key], needs)

    def cut_to(self, begin_us: int, end_us: int) -> None:
        """Restrict a log to a part of it, and count time from the start of that part.

        Args:
            begin_us: Start, us, in time of the log so far.
            end_us: End, us, in the same time.
        """
        self.start_us += begin_us
        self.length_us = end_us - begin_us
        self._topics.clear()

    def whole(self, name: str, instance: int | None = None) -> Topic | None:
        """Messages as from `topic`, but also outside the flight, and without findings."""
        return self._ordered(name, instance, with_findings=False)

    def _messages(self, name: str, instance: int | None) -> tuple[Messages, NDArray[np.int64]]:
        """All messages with the name of an instance, and the row numbers of the instance."""
        messages = self.content.messages.get(name)
        column = _instance(messages) if messages is not None else ""
        if messages is not None and (instance is None or column):
            every = np.ones(len(messages.places), dtype=np.bool_)
            here = every if instance is None else messages.data[column] == instance
            return messages, np.flatnonzero(here)
        names = OLDER.get(name, (name,))
        messages = self.content.messages[names[instance or 0]]
        return messages, np.arange(len(messages.places))

    def _ordered(self, name: str, instance: int | None, with_findings: bool) -> Topic | None:
        try:
            messages, rows = self._messages(name, instance)
        except (KeyError, IndexError):
            return None
        dropped = self._dropped.get(messages.definition.name)
        rows = rows if dropped is None else rows[~dropped[rows]]
        t_us = stamps_us(messages)[rows] - self.start_us
        if with_findings and self.length_us is not None:
            inside = (t_us >= 0) & (t_us <= self.length_us)
            rows, t_us = rows[inside], t_us[inside]
        if len(rows) == 0:
            return None
        if name in EVENTS:
            order = np.argsort(t_us, kind="stable")
            return Topic(name, t_us[order], messages, rows[order])
        if with_findings:
            keep = monotonic_samples(self, name, t_us, "messages")
        else:
            keep, *_ = monotonic(t_us)
        if not keep.any():
            return None
        steady = name in STEADY and name not in _PAUSE_OF_TELEMETRY
        if with_findings and steady and (found := pauses(t_us[keep])):
            self.note("warning", name, found.message, found.count)
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
        LogError: Nothing in the file can be used.
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
    _drop_misplaced(log, timed)
    first = min(int(t[0]) for n in timed if (t := _used_stamps(log, n, timed[n])).size)
    log.start_us = first
    _parameters(log)
    return log


def _stamped(found: Mapping[str, Messages]) -> dict[str, Messages]:
    """Messages with times; events without any (up to Copter 3.2) get the time of the last message
    with one before them in the file, or of the first."""
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


def _used_stamps(log: ArduPilotLog, name: str, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Time stamps of the messages in use, in order."""
    dropped = log._dropped.get(name)
    return np.sort(stamps if dropped is None else stamps[~dropped])


def _note_damage(log: ArduPilotLog, damage: Damage, size: int) -> None:
    """Findings on a truncated or damaged log; `size` is that of a binary one."""
    places = f"{damage.stretches} {'place' if damage.stretches == 1 else 'places'}"
    message = f"damaged: {damage.lost} bytes in {places} make no sense and are not used"
    log.note("error", "log", message, damage.lost)
    if damage.tail and size and size % _BLOCK == 0:
        log.note(
            "info",
            "log",
            f"it ends inside a message: the last {damage.tail} bytes are not used. That is normal, "
            "ArduPilot writes whole blocks",
        )
    else:
        note_cut(log, damage.tail)
    for found, what in (
        (damage.undefined, "definitions that make no sense; their messages are not read"),
        (damage.redefined, "messages that are defined twice, and differently"),
    ):
        named = ", ".join(list(dict.fromkeys(found))[:_NAMED])
        log.note("error", "FMT", f"{what}: {named}", len(found))


def _drop_misplaced(log: ArduPilotLog, timed: Mapping[str, NDArray[np.int64]]) -> None:
    """Drop messages stamped far from their neighbours in the file; findings on topics with many."""
    names = [n for n in timed if n not in EVENTS]
    places = [log.content.messages[n].places for n in names]
    stamps = [np.clip(timed[n] - log.start_us, -_LONGEST_US, _LONGEST_US) for n in names]
    off_us = stamp_offsets(places, stamps)
    for name, far in zip(names, stray_samples(log, names, off_us, "messages"), strict=True):
        if far.any():
            log._dropped[name] = far


def _parameters(log: ArduPilotLog) -> None:
    """Parameters, and the names of those that change; invalid values are dropped."""
    messages = log.content.messages.get("PARM")
    if messages is None or not {"Name", "Value"} <= set(messages.data):
        return
    changed = set()
    for name, value in zip(
        messages.texts("Name"), messages.data["Value"].astype(np.float64).tolist(), strict=True
    ):
        if not np.isfinite(value):
            continue
        value = float(f"{value:.7g}")  # logged as float32
        if log.params.get(name, value) != value:
            changed.add(name)
        log.params[name] = value
    log.changed = frozenset(changed)


# -- firmware, board, frame ---------------------------------------------------------------------
#
# Firmware, board and frame of a log.

OTHERS = re.compile(r"(?:Ardu|APM:)(Plane|Rover|Sub)|AntennaTracker|Blimp")
"""Firmware of vehicles that are no multirotors, except for quadplanes."""
_FIRMWARE = re.compile(r"Ardu|APM:|AntennaTracker|Blimp")  # start of its message
_FRAME = re.compile(r"Frame: (\w+)")  # message of Copter up to 3.4


@dataclass(frozen=True, slots=True)
class Frame:
    """Frame named in a log.

    Attributes:
        kind: FRAME_CLASS, 0 where the log has none.
        form: FRAME_TYPE.
        source: Message or parameter that names the frame.
    """

    kind: int
    form: int
    source: str


def frame_of(log: ArduPilotLog) -> Frame:
    """FRAME_CLASS and FRAME_TYPE, for quadplanes with `Q_`; up to Copter 3.4 the frame of the
    firmware (message `Frame: QUAD`) and FRAME."""
    for stem in ("", "Q_"):
        if f"{stem}FRAME_CLASS" in log.params:
            kind, form = (log.params.get(f"{stem}FRAME_{k}", 1.0) for k in ("CLASS", "TYPE"))
            return Frame(int(kind), int(form), f"{stem}FRAME_CLASS and {stem}FRAME_TYPE of the log")
    form = int(log.params.get("FRAME_TYPE", log.params.get("FRAME", 1.0)))
    for text in log.texts("MSG", "Message"):
        if (found := _FRAME.match(text)) and found[1] in FRAMES:
            return Frame(
                FRAMES[found[1]], form, f"FRAME {form} and the message '{text}' of the log"
            )
    return Frame(0, form, "")


def firmware(log: ArduPilotLog) -> str:
    """Firmware named in the log, "" without any."""
    texts = log.texts("VER", "FWS") + log.texts("MSG", "Message")
    return next((t for t in texts if _FIRMWARE.match(t) and re.search(r"[Vv]\d|solo-", t)), "")


def board(log: ArduPilotLog) -> str:
    """The message with a board's name and serial number: a name, three words of eight hex
    digits."""
    for text in log.texts("MSG", "Message"):
        words = text.split()
        if len(words) == 4 and all(len(w) == 8 and _is_hex(w) for w in words[1:]):
            return text
    return ""


def _is_hex(word: str) -> bool:
    return all(c in "0123456789ABCDEFabcdef" for c in word)


# -- parameters ---------------------------------------------------------------------------------
#
# Parameters of ArduPilot on motors, filters and limits, by the names in Copter or, with prefix
# `Q_`, in Plane's quadplanes.

MOTOR_FUNCTIONS = {**{33 + k: k + 1 for k in range(8)}, **{82 + k: k + 9 for k in range(4)}}
"""Motor number by SERVOn_FUNCTION of an output that drives a motor."""
_OUTPUTS = 32  # SERVO1 to SERVO32
TRICOPTER = (1, 2, 4)
"""Motor numbers of a tricopter."""
_DIGITAL = range(4, 9)
"""MOT_PWM_TYPE of DShot, whose outputs are logged as 1000 to 2000."""
_DIGITAL_US = (1000.0, 2000.0)  # range of outputs without pulses of their own


def motor_value(params: Mapping[str, float], name: str, default: float) -> float:
    """A parameter of the motors, such as `MOT_SPIN_MIN`, or its default."""
    quadplane = f"Q_{name.replace('MOT_', 'M_', 1)}"
    there = [n for n in (name, quadplane, NAMES.get(name, "")) if n in params]
    return params[there[0]] if there else default


def motor_channels(params: Mapping[str, float]) -> list[int]:
    """Output number, from 1, of motor 1, 2, ... by SERVOn_FUNCTION; [] where a motor has none.

    A tricopter has motors 1, 2 and 4.
    """
    outputs = {}
    for n in range(_OUTPUTS, 0, -1):  # of two outputs for one motor the first is used
        function = int(params.get(f"SERVO{n}_FUNCTION", 0.0))
        if function in MOTOR_FUNCTIONS:
            outputs[MOTOR_FUNCTIONS[function]] = n
    motors = sorted(outputs)
    if motors[:3] == list(TRICOPTER) and 3 not in motors:
        motors = list(TRICOPTER)  # motor 7 is the servo that tilts the tail
    elif motors != list(range(1, len(motors) + 1)):
        return []
    return [outputs[m] for m in motors]


def pulse_range_us(params: Mapping[str, float]) -> tuple[float, float]:
    """Pulse widths of command 0 and 1, us: from MOT_PWM_MIN and _MAX, else from the throttle
    stick."""
    if int(motor_value(params, "MOT_PWM_TYPE", 0.0)) in _DIGITAL:
        return _DIGITAL_US
    low, high = (motor_value(params, f"MOT_PWM_{k}", 0.0) for k in ("MIN", "MAX"))
    if 0.0 < low < high:
        return low, high
    stick = int(params.get("RCMAP_THROTTLE", 3.0))
    low, high = (params.get(f"RC{stick}_{k}", 0.0) for k in ("MIN", "MAX"))
    return (low, high) if 0.0 < low < high else _DIGITAL_US
