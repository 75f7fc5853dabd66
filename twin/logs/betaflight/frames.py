"""The frames of one flight of a Blackbox log: complete ones (I), differences to previous ones (P),
and rare ones: S (modes), G and H (satellites), E (events).

A frame is a letter and the fields of its definition, without length or checksum. Signs of damage: a
frame after which no frame begins, impossible numbers, a time that jumps. Source: Betaflight's
documentation, "Blackbox logging internals", and blackbox.c.
"""

import re
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError
from ..flight import Finding, FindingCollector
from ..stamps import pauses
from .header import (
    AVERAGE_2,
    HOME_COORD,
    INCREMENT,
    LAST_TIME,
    MID_1500,
    MINMOTOR,
    MINTHROTTLE,
    MOTOR_0,
    PREVIOUS,
    STRAIGHT_LINE,
    VBATREF,
    ZERO,
    Header,
    Read,
    flights,
    read_header,
    reader,
    signed_vb,
    unsigned_vb,
)

SYNC_BEEP, ADJUSTMENT, RESUME, DISARM, MODES, END = 0, 13, 14, 15, 30, 255
"""Numbers of the kinds of events."""
_END_TEXT = b"End of log\0"  # text of the event END
_LONGEST = 256  # bytes of a frame; longer ones are damage
_JUMP_US = 10_000_000  # largest step between two frames; more is damage
_JUMP_LOOPS = 5000  # largest step in loops
_WORD, _HALF = 0xFFFFFFFF, 0x80000000  # mask of 32 bits, and their sign bit
_MAIN, _LETTERS = "IP", "IPSGHE"  # letters of main frames, and of all


@dataclass(slots=True)
class Damage:
    """Parts of a flight that could not be used.

    Attributes:
        lost: Number of bytes that could not be decoded.
        places: Number of stretches of such bytes.
        unfounded: Number of P frames whose predecessor was lost.
        rejected: Number of single I frames whose time or loop number jumps.
        missing: Number of logged loops that are missing, by the numbers of the I frames.
        ended: Whether the firmware logged the end.
        cut: Bytes of an incomplete frame at the end.
        behind: Bytes after the end that are no padding.
    """

    lost: int = 0
    places: int = 0
    unfounded: int = 0
    rejected: int = 0
    missing: int = 0
    ended: bool = False
    cut: int = 0
    behind: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Frames of one kind.

    Attributes:
        names: Names of the columns.
        t_us: Time of each frame since the start of the firmware, us, shape (n,); S and E frames
            have that of the frame before them.
        values: Logged values, shape (n, len(names)).
    """

    names: tuple[str, ...]
    t_us: NDArray[np.int64]
    values: NDArray[np.int64]

    def has(self, *names: str) -> bool:
        """Whether the table has all these columns, with at least one frame."""
        return bool(len(self.t_us)) and set(names) <= set(self.names)

    def columns(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Columns side by side, shape (n, len(names))."""
        at = [self.names.index(n) for n in names]
        return self.values[:, at].astype(np.float64)


@dataclass(frozen=True, slots=True)
class Event:
    """An event of a flight.

    Attributes:
        kind: One of the kinds above.
        t_us: Time of the frame before it.
        values: Values of the event, by its kind.
    """

    kind: int
    t_us: int
    values: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Frames of one flight.

    Attributes:
        main: Main frames I and P.
        slow: S frames.
        gps: G frames, with absolute coordinates.
        events: E frames.
        damage: Missing parts.
    """

    main: Table
    slow: Table
    gps: Table
    events: tuple[Event, ...]
    damage: Damage


def read_frames(header: Header, data: bytes) -> Recording:
    """Decode the frames after the head of a flight.

    Args:
        header: The head.
        data: Bytes from the end of the head to the end of the flight.

    Raises:
        ValueError: The head lacks the definitions.
    """
    stream = _Stream(header, data)
    stream.run()
    frames = header.frames
    return Recording(
        stream.main.table(frames["I"].names),
        stream.slow.table(frames["S"].names if "S" in frames else ()),
        stream.gps.table(frames["G"].names if "G" in frames else ()),
        tuple(stream.events),
        stream.damage,
    )


@dataclass(slots=True)
class _Rows:
    """Frames of one kind while they are read, 8 bytes a number."""

    t_us: "array[int]" = field(default_factory=lambda: array("q"))
    values: "array[int]" = field(default_factory=lambda: array("q"))

    def add(self, t_us: int, values: list[int]) -> None:
        """Add a frame."""
        self.t_us.append(t_us)
        self.values.extend(values)

    def table(self, names: tuple[str, ...]) -> Table:
        """The table of all frames so far."""
        t_us = np.array(self.t_us, dtype=np.int64)
        values = np.array(self.values, dtype=np.int64).reshape(len(t_us), len(names))
        wrapped = ((values + _HALF) & _WORD) - _HALF  # as in the 32 bits of the firmware
        return Table(names, t_us, wrapped)


def _constants(header: Header) -> Mapping[int, int]:
    """Constants of the head by predictor."""
    return {
        MINTHROTTLE: header.whole("minthrottle", 0),
        MID_1500: 1500,
        VBATREF: header.whole("vbatref", 0),
        MINMOTOR: header.whole("motorOutput", 0),
    }


@dataclass(slots=True)
class _Stream:
    """Decoder of a flight's frames."""

    header: Header
    data: bytes
    main: _Rows = field(default_factory=_Rows)
    slow: _Rows = field(default_factory=_Rows)
    gps: _Rows = field(default_factory=_Rows)
    events: list[Event] = field(default_factory=list)
    damage: Damage = field(default_factory=Damage)
    _history: tuple[list[int], list[int]] | None = None
    """The two previous main frames; None: lost."""
    _last: tuple[int, int] | None = None
    """Loop number and unwrapped time, us, of the last accepted main frame."""
    _doubted: tuple[int, int] | None = None
    """Loop number and unwrapped time, us, of a rejected I frame."""
    _home: tuple[int, ...] = ()
    _resumed: bool = False
    _readers: dict[str, Read] = field(default_factory=dict)
    _predicted: dict[str, tuple[tuple[int, int, int], ...]] = field(default_factory=dict)
    _interval: tuple[int, int, int] = (1, 1, 1)
    _motor: int = 0
    """Index of motor[0] among the fields."""

    def run(self) -> None:
        """Read all frames."""
        self._prepare()
        data, end = self.data, len(self.data)
        at, lost_from = 0, -1
        while at < end:
            letter = chr(data[at])
            behind = self._frame(letter, at) if letter in _LETTERS else -1
            if behind < 0:
                if lost_from < 0:
                    lost_from = at
                    self.damage.places += 1
                    self._history = None
                self.damage.lost += 1
                at += 1
                continue
            lost_from, at = -1, behind
            if self.damage.ended:
                self.damage.behind = len(data[at:].strip(b"\xff\0"))
                return
        if lost_from >= 0:
            self._at_the_end(data[lost_from:])

    def _at_the_end(self, rest: bytes) -> None:
        """Count the bytes lost at the end: padding of a flash chip, or an incomplete frame."""
        self.damage.lost -= len(rest)
        self.damage.places -= 1
        self.damage.cut = len(rest.strip(b"\xff\0"))

    def _prepare(self) -> None:
        header = self.header
        version = header.whole("Data version", 1)
        if "I" not in header.frames:
            raise ValueError(header.unusable.get("I", "no definition of I frames"))
        self._interval = header.interval
        names = header.frames["I"].names
        self._motor = names.index("motor[0]") if "motor[0]" in names else 0
        constants = _constants(header)
        for letter, fields in header.frames.items():
            self._readers[letter] = reader(fields, version)
            self._predicted[letter] = tuple(
                (k, p, constants.get(p, 0)) for k, p in enumerate(fields.predictors) if p != ZERO
            )

    def _frame(self, letter: str, begin: int) -> int:
        """Read a frame; returns the offset of its end, -1 where there is no frame."""
        try:
            if letter == "E":
                return self._event(begin + 1)
            if letter not in self._readers:
                return -1
            values, end = self._readers[letter](self.data, begin + 1)
        except (IndexError, ValueError):
            return -1
        if end - begin > _LONGEST or not self._goes_on(end):
            return -1
        if letter in _MAIN:
            self._main_frame(letter, values)
        else:
            self._seldom_frame(letter, values)
        return end

    def _goes_on(self, at: int) -> bool:
        """Whether another frame begins at this offset, or the file ends."""
        if at >= len(self.data):
            return True
        letter = chr(self.data[at])
        return letter == "E" or letter in self._readers or self.data[at] in (0, 255)

    def _main_frame(self, letter: str, values: list[int]) -> None:
        if letter == "P" and self._history is None:
            self.damage.unfounded += 1
            return
        self._add_prediction(letter, values)
        known = self._accepted(letter, values[0], values[1])
        if known is None:
            self._history = None
            return
        self._last = known
        before = values if letter == "I" or self._history is None else self._history[0]
        self._history = values, before
        self.main.add(known[1], values)

    def _add_prediction(self, letter: str, values: list[int]) -> None:
        """Add the prediction to the decoded values; an I frame has no previous frame."""
        one, two = self._history or (None, None)
        for k, predictor, constant in self._predicted[letter]:
            if predictor == PREVIOUS and one is not None:
                values[k] += one[k]
            elif predictor == AVERAGE_2 and one is not None and two is not None:
                total = one[k] + two[k]
                values[k] += (total + (total < 0)) >> 1  # rounded as in C
            elif predictor == STRAIGHT_LINE and one is not None and two is not None:
                values[k] = (values[k] + 2 * one[k] - two[k]) & _WORD
            elif predictor == INCREMENT and one is not None:
                values[k] = self._next_loop(one[k])
            elif predictor == MOTOR_0:
                values[k] += values[self._motor]
            else:
                values[k] += constant

    def _next_loop(self, number: int) -> int:
        """Number of the next logged loop."""
        every, several, of = self._interval
        number += 1
        for _ in range(every):
            if (number % every + several - 1) % of < several:
                break
            number += 1
        return number

    def _accepted(self, letter: str, number: int, time: int) -> tuple[int, int] | None:
        """Number and unwrapped time of a main frame that follows the previous one; else None,
        unless two successive I frames agree."""
        if self._last is None:
            return number, time
        for reference in (self._last, self._doubted):
            if reference is None:
                continue
            step = ((time - reference[1] + _HALF) & _WORD) - _HALF
            loops = number - reference[0]
            if self._resumed or (abs(step) <= _JUMP_US and 0 <= loops <= _JUMP_LOOPS):
                if letter == "I" and not self._resumed and reference is self._last:
                    self._count_missing(reference[0], number)
                self._resumed, self._doubted = False, None
                return number, reference[1] + step
        if letter == "I":
            step = ((time - self._last[1] + _HALF) & _WORD) - _HALF
            self._doubted = number, self._last[1] + step
        self.damage.rejected += 1
        return None

    def _count_missing(self, last: int, number: int) -> None:
        """Count the loops missing between a main frame and an I frame."""
        following = self._next_loop(last)
        while following < number:
            self.damage.missing += 1
            following = self._next_loop(following)

    def _seldom_frame(self, letter: str, values: list[int]) -> None:
        now = self._last[1] if self._last else 0
        names = self.header.frames[letter].names
        homes = 0
        for k, predictor, constant in self._predicted[letter]:
            if predictor == HOME_COORD:
                values[k] += self._home[homes] if homes < len(self._home) else 0
                homes += 1
            elif predictor == LAST_TIME:
                values[k] += now
            else:
                values[k] += constant
        if letter == "H":
            self._home = tuple(values)
        elif self._last is not None and letter == "S":
            self.slow.add(now, values)
        elif self._last is not None and letter == "G" and (self._home or not homes):
            self.gps.add(values[names.index("time")] if "time" in names else now, values)

    def _event(self, at: int) -> int:
        """Read an event; returns the offset of its end.

        Raises:
            ValueError: Its kind is unknown.
            IndexError: The data end.
        """
        data, kind = self.data, self.data[at]
        at += 1
        values: list[int] = []
        if kind == END:
            if data[at : at + len(_END_TEXT)] != _END_TEXT:
                raise ValueError("not the end")
            at += len(_END_TEXT)
        elif kind == ADJUSTMENT:
            function = data[at]
            at = at + 5 if function > 127 else signed_vb(data, at + 1)[1]
        elif kind in (SYNC_BEEP, DISARM, RESUME, MODES):
            for _ in range(1 if kind in (SYNC_BEEP, DISARM) else 2):
                value, at = unsigned_vb(data, at)
                values.append(value)
        else:
            raise ValueError("an event of no known kind")
        if kind != END and (at > len(data) or not self._goes_on(at)):
            return -1
        self.damage.ended = kind == END
        self._resumed = self._resumed or kind == RESUME
        self.events.append(Event(kind, self._last[1] if self._last else 0, tuple(values)))
        return at


# -- the file -----------------------------------------------------------------------------------
#
# Tolerant reader of a Blackbox file: selection of a flight, and counts of its damage.

_BETAFLIGHT = re.compile(r"(?:Betaflight|EmuFlight)\s*/?\s*(\d+)\.(\d+)")
"""Name and release of the firmware in the head."""
_OTHERS = re.compile(r"INAV|Rotorflight|Baseflight|Cleanflight|Indiflight", re.IGNORECASE)
"""Firmware with the same format but other units."""
_LATEST = (2025, 12)  # assumed release
_FEWEST = 2  # main frames of a flight


@dataclass(slots=True)
class BlackboxLog(FindingCollector):
    """One flight of a file in time of the flight.

    Attributes:
        path: Path of the file.
        header: Head of the flight.
        recording: Frames of the flight.
        start_us: Time since the start of the firmware that is time 0, us.
        findings: Findings so far.
    """

    path: Path
    header: Header
    recording: Recording
    start_us: int
    findings: list[Finding] = field(default_factory=list)

    @property
    def firmware(self) -> str:
        """Name and version, "" where the head has none."""
        revision = self.header.settings.get("Firmware revision", "")
        return revision or self.header.settings.get("Firmware type", "")

    @property
    def version(self) -> tuple[int, int]:
        """Version of Betaflight; that of the end of 2025 where the head has none."""
        found = _BETAFLIGHT.search(self.firmware)
        return (int(found[1]), int(found[2])) if found else _LATEST


def open_blackbox(path: Path, blob: bytes) -> tuple[BlackboxLog, str]:
    """Parse a Blackbox file; of several flights the longest is read, by its bytes.

    Args:
        path: File name, for messages.
        blob: Content of the file.

    Returns:
        The flight, and text on its selection, "" where the file has no other.

    Raises:
        LogError: Nothing in the file can be used.
    """
    parts = flights(blob)
    by_size = sorted(range(len(parts)), key=lambda k: parts[k][0] - parts[k][1])
    log, why, which = None, "", 0
    for which in by_size:
        begin, end = parts[which]
        try:
            log = _flight(path, blob[begin:end])
            break
        except ValueError as error:
            why = why or str(error)
    if log is None:
        many = f"none of the {len(parts)} flights" if len(parts) > 1 else "the flight"
        raise LogError(
            f"{path.name}: {many} of this Blackbox log can be read ({why}): it was cut or damaged. "
            "Copy it again from the flash chip or the card."
        )
    _check_firmware(log)
    _note_damage(log)
    if len(parts) == 1:
        return log, ""
    log.note(
        "warning",
        "log",
        f"the file holds {len(parts)} flights; the longest is read, number {which + 1}. Cut the "
        "file before each `H Product` to read another",
        len(parts) - 1,
    )
    return log, f"{which + 1} of {len(parts)}"


def _flight(path: Path, blob: bytes) -> BlackboxLog:
    """One flight.

    Raises:
        ValueError: Nothing in the flight can be used.
    """
    header = read_header(blob)
    recording = read_frames(header, blob[header.size :])
    if len(recording.main.t_us) < _FEWEST:
        raise ValueError(f"{len(recording.main.t_us)} frames in {len(blob)} bytes")
    log = BlackboxLog(path, header, recording, int(recording.main.t_us.min()))
    for letter, reason in header.unusable.items():
        message = f"the definition of {letter} frames makes no sense ({reason}); they are not read"
        log.note("error", "log", message)
    log.note("error", "log", "damaged lines in the head, not used", header.damaged)
    return log


def _check_firmware(log: BlackboxLog) -> None:
    """Refuse firmware that writes the same format in other units and axes."""
    firmware = log.firmware
    if not _BETAFLIGHT.search(firmware) and (other := _OTHERS.search(firmware)):
        raise LogError(
            f"{log.path.name}: a Blackbox log of {other.group()} ({firmware[:60]!r}): its units "
            "and axes are not Betaflight's and not known here. Convert it to a flight table (CSV), "
            "SI, FRD and NED."
        )
    if not _BETAFLIGHT.search(firmware):
        message = f"the head does not name the firmware ({firmware[:60]!r}): taken for Betaflight"
        log.note("warning", "log", message)


def _note_damage(log: BlackboxLog) -> None:
    """Findings on missing and damaged parts."""
    damage: Damage = log.recording.damage
    places = "place" if damage.places == 1 else "places"
    message = f"damaged: bytes in {damage.places} {places} of which nothing can be made"
    log.note("error", "log", message, damage.lost)
    message = "frames not used, the whole frame that they build on was lost"
    log.note("error", "log", message, damage.unfounded)
    message = "frames not used, whose time or number jumps or runs backward"
    log.note("error", "log", message, damage.rejected)
    log.note("warning", "log", "frames missing, by their numbers", damage.missing)
    message = "cut short: bytes at the end that are no whole frame, not used"
    log.note("error", "log", message, damage.cut)
    if not damage.ended:
        message = (
            "it does not end as Betaflight ends a log: the battery was taken off before the motors "
            "were disarmed, the chip was full, or the file was cut"
        )
        log.note("warning", "log", message)
    log.note("warning", "log", "bytes behind the end of the log, not read", damage.behind)
    if found := pauses(log.recording.main.t_us - log.start_us):
        resumed = sum(e.kind == RESUME for e in log.recording.events)
        why = f"; logging was paused by a switch {resumed} times" if resumed else ""
        log.note("warning", "time", found.message + why, found.count)
