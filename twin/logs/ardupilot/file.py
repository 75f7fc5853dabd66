"""DataFlash files, binary or text: definitions of messages, and the messages."""

import struct
from array import array
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

# -- definitions --------------------------------------------------------------------------------
#
# Layout of the messages of a DataFlash log: FMT, and FMTU, UNIT and MULT for the units.
#
# Source of the meanings: ArduPilot, libraries/AP_Logger/README.md and LogStructure.h.

HEADER = 3
"""Bytes before the content of a message: two markers and its type."""
FMT_NUMBER = 0x80  # type number of FMT, LogStructure.h

_TYPES: dict[str, tuple[str, float]] = {
    **{k: (v, 1.0) for k, v in {"b": "i1", "B": "u1", "M": "u1", "h": "<i2", "H": "<u2"}.items()},
    **{k: (v, 1.0) for k, v in {"i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8"}.items()},
    **{k: (v, 1.0) for k, v in {"g": "<f2", "f": "<f4", "d": "<f8"}.items()},
    **{k: (v, 1.0) for k, v in {"n": "S4", "N": "S16", "Z": "S64", "a": "S64"}.items()},
    **{"c": ("<i2", 1e2), "C": ("<u2", 1e2), "e": ("<i4", 1e2), "E": ("<u4", 1e2)},
    "L": ("<i4", 1e7),
}
"""Type in the file and divisor of a number, by format letter."""
_MOST_COLUMNS = 64  # a message has 16 letters of format; beyond is damage


@dataclass(frozen=True, slots=True)
class Definition:
    """One kind of message.

    Attributes:
        number: Type number in the header of its messages.
        name: Name of up to four letters.
        letters: Format: one letter per column.
        columns: Names of the columns.
    """

    number: int
    name: str
    letters: str
    columns: tuple[str, ...]

    @property
    def dtype(self) -> "np.dtype[np.void]":
        """Type of a message without its header, column by column."""
        return np.dtype(
            [(c, _TYPES[k][0]) for c, k in zip(self.columns, self.letters, strict=True)]
        )

    @property
    def size(self) -> int:
        """Bytes of a message with its header."""
        return HEADER + self.dtype.itemsize

    def divisor(self, column: str) -> float:
        """Divisor of the number in the file; 1 for most formats."""
        return _TYPES[self.letters[self.columns.index(column)]][1]

    def is_text(self, column: str) -> bool:
        """Whether a column holds text."""
        return _TYPES[self.letters[self.columns.index(column)]][0].startswith("S")


FMT = Definition(FMT_NUMBER, "FMT", "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))
"""Definition of the messages that define the others."""


def define(number: int, length: int | None, name: str, letters: str, columns: str) -> Definition:
    """A definition from the fields of FMT.

    Args:
        number: Type number, 0 to 255.
        length: Bytes of a message with its header; None: not checked, as in a text log.
        name: Name of the message.
        letters: Format letters.
        columns: Names, separated by commas.

    Raises:
        ValueError: The definition is invalid; the text says why.
    """
    names = tuple(c.strip() for c in columns.split(",")) if columns else ()
    if not name.isalnum():
        raise ValueError("its name is none")
    if unknown := set(letters) - set(_TYPES):
        raise ValueError(f"it has a format letter {min(unknown)!r}")
    if not names or len(names) != len(letters) or len(names) > _MOST_COLUMNS:
        raise ValueError(f"it has {len(names)} names for {len(letters)} columns")
    if len(set(names)) < len(names) or not all(names):
        raise ValueError("two of its columns have one name, or one has none")
    made = Definition(number, name, letters, names)
    if length is not None and made.size != length:
        raise ValueError(f"its columns take {made.size} bytes, not {length}")
    return made


@dataclass(frozen=True, slots=True)
class Units:
    """Units of the columns of one kind of message, from FMTU, UNIT and MULT.

    Attributes:
        labels: ArduPilot's name of the unit, such as `deg/s`, by column.
        multipliers: Factor from a number in the file to that unit, by column.
        instance: The column with instance numbers, "" without any.
    """

    labels: Mapping[str, str] = field(default_factory=dict)
    multipliers: Mapping[str, float] = field(default_factory=dict)
    instance: str = ""


def units_of(
    definition: Definition,
    unit_ids: str,
    multiplier_ids: str,
    units: Mapping[str, str],
    multipliers: Mapping[str, float],
) -> Units:
    """Units of one kind of message.

    Args:
        definition: Definition of the message.
        unit_ids: UnitIds of its FMTU, a letter per column.
        multiplier_ids: MultIds of its FMTU, a letter per column.
        units: Labels by letter, from UNIT.
        multipliers: Numbers by letter, from MULT.
    """
    labels = {
        c: units[k]
        for c, k in zip(definition.columns, unit_ids, strict=False)
        if k not in "#?-" and k in units
    }
    factors = {
        c: multipliers[k]
        for c, k in zip(definition.columns, multiplier_ids, strict=False)
        if k in multipliers and multipliers[k] > 0.0 and definition.divisor(c) == 1.0
    }
    marked = unit_ids.find("#")
    instance = definition.columns[marked] if 0 <= marked < len(definition.columns) else ""
    return Units(labels, factors, instance)


_INSTANCE = ("I", "C", "Instance", "Inst")  # columns with instance numbers before FMTU


def instance_column(definition: Definition, units: Units) -> str:
    """The column with instance numbers, also in logs older than FMTU; "" without any."""
    usual = [c for c in _INSTANCE if c in definition.columns and not definition.is_text(c)]
    found = units.instance or (usual[0] if usual else "")
    return found if found and not definition.is_text(found) else ""


def text(raw: bytes | str) -> str:
    """Text up to its end mark, decoded whatever bytes it contains."""
    decoded = raw.decode("utf-8", "replace") if isinstance(raw, bytes) else raw
    return decoded.partition("\0")[0]


_RAD = np.pi / 180.0  # one degree
SI: dict[str, tuple[str, float]] = {
    **{k: ("angle", _RAD) for k in ("deg", "degheading", "deglatitude", "deglongitude")},
    "rad": ("angle", 1.0),
    "deg/s": ("rate", _RAD),
    "rad/s": ("rate", 1.0),
    "rpm": ("rate", 2.0 * np.pi / 60.0),
    "m": ("length", 1.0),
    "m/s": ("velocity", 1.0),
    "m/s/s": ("acceleration", 1.0),
    "Gauss": ("flux density", 1e-4),
    "Pa": ("pressure", 1.0),
    "V": ("voltage", 1.0),
    "A": ("current", 1.0),
    "s": ("time", 1.0),
    "us": ("pulse width", 1.0),
    "PWM": ("pulse width", 1.0),
    "1": ("number", 1.0),
}
"""ArduPilot's units: quantity and factor to SI (pulse widths: us)."""


def in_si(label: str, assumed: str) -> tuple[float, bool]:
    """Factor of a column to SI, and whether its unit contradicts the documented one.

    Args:
        label: Unit in the log, "" or an unknown one where the log has none.
        assumed: Unit in ArduPilot's documentation.
    """
    kind, factor = SI[assumed]
    if label not in SI:
        return factor, False
    given, given_factor = SI[label]
    return (given_factor, False) if given == kind else (factor, True)


# -- messages -----------------------------------------------------------------------------------
#
# Messages of a DataFlash log, binary or text, by name; invalid parts of the file are counted.


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """All messages of one name, in the order of the file.

    Attributes:
        definition: Definition of the messages.
        places: Position of each among all messages of the file, shape (n,).
        data: Data by column, shape (n,): numbers after the divisor of their format, or text.
        units: Units of the columns.
    """

    definition: Definition
    places: NDArray[np.int64]
    data: Mapping[str, NDArray[Any]]
    units: Units = field(default_factory=Units)

    def texts(self, column: str) -> list[str]:
        """A column of texts."""
        return [text(v) for v in self.data[column].tolist()]


@dataclass(slots=True)
class Damage:
    """Parts of a file that could not be read.

    Attributes:
        lost: Number of invalid bytes between messages (lines of a text log).
        stretches: Number of stretches of invalid bytes.
        tail: Bytes of an incomplete message at the end.
        redefined: Kinds of message with two different definitions.
        undefined: Invalid definitions, with the reason.
    """

    lost: int = 0
    stretches: int = 0
    tail: int = 0
    redefined: list[str] = field(default_factory=list)
    undefined: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Content:
    """Content of a file.

    Attributes:
        messages: Requested messages by name.
        counts: Number of messages by name, of all kinds.
        damage: Parts that could not be read.
    """

    messages: dict[str, Messages]
    counts: dict[str, int]
    damage: Damage


UNIT_MESSAGES = ("FMTU", "UNIT", "MULT")  # messages that define units of the others


def with_units(found: Mapping[str, Messages], wanted: Collection[str]) -> dict[str, Messages]:
    """Messages with their units from FMTU, UNIT and MULT.

    Args:
        found: Messages by name, with those three where the log has them.
        wanted: Names to keep.
    """
    labels = _by_letter(found.get("UNIT"), "Label")
    factors = _by_letter(found.get("MULT"), "Mult")
    by_number: dict[int, tuple[str, str]] = {}
    if (given := found.get("FMTU")) and {"FmtType", "UnitIds", "MultIds"} <= set(given.data):
        numbers = given.data["FmtType"].tolist()
        pairs = zip(given.texts("UnitIds"), given.texts("MultIds"), strict=True)
        by_number = dict(zip(map(int, numbers), pairs, strict=True))
    multipliers = {k: float(f"{v:.7g}") for k, v in factors.items()}  # logged as float32
    names = {k: str(v) for k, v in labels.items()}
    labelled = {}
    for name, each in found.items():
        if name in wanted:
            ids = by_number.get(each.definition.number, ("", ""))
            units = units_of(each.definition, *ids, names, multipliers)
            labelled[name] = Messages(each.definition, each.places, each.data, units)
    return labelled


def _by_letter(given: Messages | None, column: str) -> dict[str, str | float]:
    """Content of UNIT or MULT by letter."""
    if given is None or not {"Id", column} <= set(given.data):
        return {}
    values: list[Any] = (
        given.texts(column) if given.definition.is_text(column) else given.data[column].tolist()
    )
    letters = given.data["Id"].tolist()
    return {
        chr(int(k)): v
        for k, v in zip(letters, values, strict=True)
        if isinstance(k, int | float) and 0 < k < 128
    }


# -- binary files -------------------------------------------------------------------------------
#
# Binary DataFlash logs: messages are found by their marks and the lengths in FMT.
#
# A message is accepted where the next one begins directly behind it. Otherwise, or if its type is
# not defined, only the bytes up to the next such message are lost and counted.

MARK = b"\xa3\x95"  # first bytes of a message, HEAD_BYTE1 and 2
_SHOWN = 8  # characters of a name in a finding
_Places = tuple["array[int]", "array[int]"]


@dataclass(slots=True)
class _Walk:
    """State of a pass through a file.

    Attributes:
        defined: Definition by type number, as far as the file has been read.
        starts: Offset of the content of each message, and its position among all, by definition.
        damage: Invalid parts so far.
    """

    defined: dict[int, Definition] = field(default_factory=lambda: {FMT_NUMBER: FMT})
    starts: dict[Definition, _Places] = field(default_factory=dict)
    damage: Damage = field(default_factory=Damage)


def read_binary(blob: bytes, wanted: Collection[str]) -> Content:
    """Messages of a binary log.

    Args:
        blob: Content of the file.
        wanted: Names of the messages to read; the others are counted.
    """
    walk = _walked(blob)
    counts: dict[str, int] = {}
    most: dict[str, Definition] = {}
    for definition, (starts, _) in walk.starts.items():
        name = definition.name
        counts[name] = counts.get(name, 0) + len(starts)
        if name not in most or len(starts) > len(walk.starts[most[name]][0]):
            most[name] = definition
    raw = np.frombuffer(blob, np.uint8)
    needed = {*wanted, *UNIT_MESSAGES}
    found = {
        name: _decoded(raw, definition, *walk.starts[definition])
        for name, definition in most.items()
        if name in needed and definition.columns
    }
    return Content(with_units(found, wanted), counts, walk.damage)


def _walked(blob: bytes) -> _Walk:
    """Positions of all messages of the file."""
    walk = _Walk()
    sizes = {FMT_NUMBER: FMT.size}
    solid = min(len(blob.rstrip(b"\0")), len(blob.rstrip(b"\xff")))
    at, end, place = 0, len(blob), 0
    lists: dict[int, _Places] = {}
    while at < end:
        if not (size := _whole(blob, at, sizes, solid)):
            at = _lost(blob, at, sizes, solid, walk.damage)
            continue
        number = blob[at + 2]
        if number not in lists:
            new = (array("q"), array("q"))
            lists[number] = walk.starts.setdefault(walk.defined[number], new)
        starts, places = lists[number]
        starts.append(at + HEADER)
        places.append(place)
        place += 1
        if number == FMT_NUMBER:
            _define_message(blob, at + HEADER, walk, sizes, lists)
        at += size
        if at >= solid:
            break  # the rest is padding
    return walk


def _whole(blob: bytes, at: int, sizes: dict[int, int], solid: int) -> int:
    """Size of the message at this offset, 0 where there is none or it is incomplete.

    It must be followed by the next message, the end of the content before padding, or half a
    marker.
    """
    if not blob.startswith(MARK, at) or at + HEADER > len(blob):
        return 0
    size = sizes.get(blob[at + 2], 0)
    after = at + size
    if not size or after > len(blob):
        return 0
    half = after + 1 == len(blob) and blob.endswith(MARK[:1])
    return size if blob.startswith(MARK, after) or after >= solid or half else 0


def _lost(blob: bytes, first: int, sizes: dict[int, int], solid: int, damage: Damage) -> int:
    """Skip invalid bytes; returns the offset of the next message, or the end of the file."""
    at = blob.find(MARK, first + 1)
    while at >= 0:
        if _whole(blob, at, sizes, solid):
            damage.lost += at - first
            damage.stretches += 1
            return at
        at = blob.find(MARK, at + 1)
    left = len(blob) - first
    known = sizes.get(blob[first + 2], 0) if left > 2 and blob.startswith(MARK, first) else 0
    if left < known or MARK.startswith(blob[first:]):
        damage.tail = left
    else:
        damage.lost += left
        damage.stretches += 1
    return len(blob)


def _define_message(
    blob: bytes, at: int, walk: _Walk, sizes: dict[int, int], lists: dict[int, _Places]
) -> None:
    """Add the definition in an FMT message."""
    number, length, *texts = struct.unpack_from("<BB4s16s64s", blob, at)
    if number == FMT_NUMBER:
        return  # a definition never changes
    name, letters, columns = map(text, texts)
    shown = "".join(c for c in name if c.isprintable())[:_SHOWN] or f"of type {number}"
    try:
        made = define(number, length, name, letters, columns)
    except ValueError as why:
        walk.damage.undefined.append(f"{shown}: {why}")
        made = Definition(number, shown, "", ())  # its messages are skipped
    before = walk.defined.get(number)
    if before == made:
        return
    if before is not None and made.columns:
        walk.damage.redefined.append(shown)
    walk.defined[number] = made
    sizes[number] = length
    lists.pop(number, None)


def _decoded(
    raw: NDArray[np.uint8], definition: Definition, starts: "array[int]", places: "array[int]"
) -> Messages:
    """Columns of the messages at these offsets."""
    dtype = definition.dtype
    windows = np.lib.stride_tricks.sliding_window_view(raw, dtype.itemsize)
    rows = windows[np.array(starts, dtype=np.int64)].view(dtype)[:, 0]
    data = {}
    for column in definition.columns:
        values = rows[column]
        divisor = definition.divisor(column)
        data[column] = values if divisor == 1.0 else values.astype(np.float64) / divisor
    return Messages(definition, np.array(places, dtype=np.int64), data)


# -- text files ---------------------------------------------------------------------------------
#
# DataFlash logs as text, a message per line: `ATT, 1234, 0.1, ...`, numbers already scaled.

_LONGEST_LINE = 10_000  # of a text log; longer ones are damage


def read_plain(blob: bytes, wanted: Collection[str]) -> Content:
    """Messages of a text log; arguments as in `read_binary`.

    FILE contains parts of files with their line ends, so lines behind it may be arbitrary.
    """
    lines = blob.decode("utf-8", "replace").split("\n")
    damage = Damage()
    if lines[-1].strip():  # the last line is incomplete
        damage.tail = len(lines[-1].encode())
    needed = {*wanted, *UNIT_MESSAGES}
    defined: dict[str, Definition] = {"FMT": FMT}
    rows: dict[str, list[list[str]]] = {}
    places: dict[str, list[int]] = {}
    counts: dict[str, int] = {}
    lost = within_file = False
    for place, line in enumerate(lines[:-1]):
        if not line.strip():
            continue
        name, _, rest = line.partition(",")
        definition = defined.get(name)
        fields = _fields(definition, rest) if definition and len(line) < _LONGEST_LINE else []
        if not definition and within_file:
            continue
        within_file = name == "FILE"
        if not definition or not fields:
            damage.lost += len(line) + 1
            damage.stretches += not lost
            lost = True
            continue
        lost = False
        counts[name] = counts.get(name, 0) + 1
        if name == "FMT":
            _define_line(fields, defined, damage)
        elif name in needed:
            rows.setdefault(name, []).append(fields)
            places.setdefault(name, []).append(place)
    found = {
        name: _columns(defined[name], each, np.array(places[name], dtype=np.int64), damage)
        for name, each in rows.items()
    }
    return Content(with_units(found, wanted), counts, damage)


def _fields(definition: Definition, rest: str) -> list[str]:
    """Fields of a line, one per column, the last with its commas; [] if the line has fewer."""
    n = len(definition.columns)
    fields = [f.strip() for f in rest.split(",", n - 1)]
    whole = len(fields) == n and (
        definition.is_text(definition.columns[-1]) or "," not in fields[-1]
    )
    return fields if whole else []


def _define_line(fields: list[str], defined: dict[str, Definition], damage: Damage) -> None:
    """Add the definition in a line of FMT."""
    number, _, name, letters, columns = fields
    if name == "FMT":
        return  # a definition never changes, and old logs omit a name
    shown = "".join(c for c in name if c.isprintable())[:_SHOWN]
    try:
        made = define(int(number), None, name, letters, columns)
    except ValueError as why:
        damage.undefined.append(f"{shown}: {why}")
        return
    before = defined.get(name)
    if before is None:
        defined[name] = made
    elif before != made:
        damage.redefined.append(shown)


def _columns(
    definition: Definition, rows: list[list[str]], places: NDArray[np.int64], damage: Damage
) -> Messages:
    """Columns of the lines of one name; lines with invalid numbers are dropped."""
    texts = dict(zip(definition.columns, zip(*rows, strict=True), strict=True))
    data: dict[str, NDArray[Any]] = {}
    good = np.ones(len(rows), dtype=np.bool_)
    for column, letter in zip(definition.columns, definition.letters, strict=True):
        if definition.is_text(column) or letter == "M":  # a mode may be logged by name
            data[column] = np.array(texts[column], dtype=object)
            continue
        numbers, readable = _numbers(texts[column])
        data[column] = numbers
        good &= readable
    if not good.all():
        damage.lost += sum(len(", ".join(rows[k])) for k in np.flatnonzero(~good))
        damage.stretches += int(np.count_nonzero(~good))
    return Messages(definition, places[good], {c: v[good] for c, v in data.items()})


def _numbers(texts: tuple[str, ...]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Numbers, and a mask of the texts that are numbers."""
    try:
        return np.array(texts, dtype=np.float64), np.ones(len(texts), dtype=np.bool_)
    except ValueError:
        values = [_number(t) for t in texts]
        readable = np.array([v is not None for v in values])
        return np.array([np.nan if v is None else v for v in values]), readable


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None
