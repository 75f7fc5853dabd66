"""The head of a Blackbox log: lines `H name:value`, with the fields of each kind of frame.

Each flight in a file has a head of its own. Source: Betaflight's documentation, "Blackbox logging
internals", and blackbox.c.
"""

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

MAGIC = b"H Product:Blackbox"
"""First bytes of a log, and of each further flight in it."""

(
    ZERO,
    PREVIOUS,
    STRAIGHT_LINE,
    AVERAGE_2,
    MINTHROTTLE,
    MOTOR_0,
    INCREMENT,
    HOME_COORD,
    MID_1500,
    VBATREF,
    LAST_TIME,
    MINMOTOR,
) = range(12)
"""Predictors: the value to which the number in a frame is added."""
SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NULL = 0, 1, 3, 6, 7, 8, 9
"""Encodings that Betaflight uses."""
ENCODINGS = frozenset((SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NULL))
"""Supported encodings."""
PREDICTORS = frozenset(range(12))  # known predictors

_NEXT_LINE = re.compile(rb"\nH [ -~]{1,80}:")  # start of the line after a damaged one
_LONGEST_LINE = 4096  # bytes; longer ones are damage
_MOST_FIELDS = 200  # of a frame; more are damage
_MOST_INTERVAL = 65_536  # loops between frames; more are damage
_ITERATION, _TIME = "loopIteration", "time"  # first fields of each main frame


@dataclass(frozen=True, slots=True)
class Fields:
    """Fields of a kind of frame, in order.

    Attributes:
        names: Names of the fields.
        predictors: Predictor of each field.
        encodings: Encoding of each field.
    """

    names: tuple[str, ...]
    predictors: tuple[int, ...]
    encodings: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Header:
    """The head of one flight.

    Attributes:
        settings: Settings by name, as text.
        frames: Fields of frames by their first letter.
        unusable: Kinds of frames with an invalid definition, and the reason.
        damaged: Number of unreadable lines.
        size: Size of the head, bytes.
    """

    settings: Mapping[str, str]
    frames: Mapping[str, Fields]
    unusable: Mapping[str, str]
    damaged: int
    size: int

    def numbers(self, name: str) -> tuple[float, ...]:
        """The numbers of a setting, () where it is missing or not numeric."""
        try:
            return tuple(float(part) for part in self.settings[name].split(","))
        except (KeyError, ValueError):
            return ()

    def number(self, name: str, default: float) -> float:
        """The first number of a setting."""
        return next(iter(self.numbers(name)), default)

    def whole(self, name: str, default: int) -> int:
        """The first number of a setting as an integer of 32 bits, the default where it is
        invalid."""
        value = self.number(name, default)
        return int(value) if abs(value) < 2**31 else default

    def bits(self, name: str) -> float | None:
        """A number written as the bytes of a float: `0x3f800000` is 1."""
        text = self.settings.get(name, "")
        try:
            if text.lower().startswith("0x"):
                (value,) = struct.unpack("<f", struct.pack("<I", int(text, 16)))
                return float(value)
            return float(text)
        except (ValueError, struct.error):
            return None

    @property
    def interval(self) -> tuple[int, int, int]:
        """Loops between I frames, then number of logged frames (numerator) per number of loops
        (denominator); `P interval` is 4, or 1/4 in older logs.

        Raises:
            ValueError: The values are invalid.
        """
        every = self.whole("I interval", 1)
        numerator, _, denominator = self.settings.get("P interval", "1").partition("/")
        if not denominator:
            numerator, denominator = "1", numerator
        try:
            several, of = int(numerator), int(denominator)
        except ValueError:
            raise ValueError(f"P interval {self.settings['P interval'][:40]!r}") from None
        if not 0 < every <= _MOST_INTERVAL or several < 1 or not 0 <= of <= _MOST_INTERVAL:
            raise ValueError(f"I interval {every}, P interval {several}/{of}")
        return every, several, max(of, 1)


def read_header(blob: bytes) -> Header:
    """Head at the start of a flight; unreadable lines are counted.

    Args:
        blob: Bytes from the start of the flight.
    """
    settings: dict[str, str] = {}
    at, damaged = 0, 0
    while True:
        if not blob.startswith(b"H ", at):
            following = _NEXT_LINE.search(blob, at, at + _LONGEST_LINE)
            if following is None or not at:
                break
            damaged, at = damaged + 1, following.start() + 1
            continue
        end = blob.find(b"\n", at, at + _LONGEST_LINE)
        if end < 0:
            break
        line = blob[at + 2 : end]
        name, colon, value = line.partition(b":")
        if colon and line.isascii() and line.decode("ascii").isprintable():
            settings[name.decode("ascii").strip()] = value.decode("ascii").strip()
        else:
            damaged += 1
        at = end + 1
    frames, unusable = _frames(settings)
    return Header(settings, frames, unusable, damaged, at)


def _frames(settings: Mapping[str, str]) -> tuple[dict[str, Fields], dict[str, str]]:
    found: dict[str, Fields] = {}
    unusable: dict[str, str] = {}
    for letter in "IPSGH":
        if not any(name.startswith(f"Field {letter} ") for name in settings):
            continue
        try:
            found[letter] = _fields(settings, letter)
        except ValueError as error:
            unusable[letter] = str(error)
    return found, unusable


def _fields(settings: Mapping[str, str], letter: str) -> Fields:
    """Fields of one kind of frame; those of P are those of I, in other encodings."""
    of = "I" if letter == "P" else letter
    names = settings.get(f"Field {of} name", "").split(",")
    predictors = _integers(settings, f"Field {letter} predictor")
    encodings = _integers(settings, f"Field {letter} encoding")
    if not len(names) == len(predictors) == len(encodings) <= _MOST_FIELDS:
        raise ValueError(
            f"{len(names)} names, {len(predictors)} predictors, {len(encodings)} encodings"
        )
    if unknown := sorted({*predictors} - PREDICTORS):
        raise ValueError(f"predictor {unknown[0]} is not known")
    if unknown := sorted({*encodings} - ENCODINGS):
        raise ValueError(f"encoding {unknown[0]} is not known")
    if len(set(names)) < len(names) or "" in names:
        raise ValueError("a name twice, or none")
    if letter in "IP" and names[:2] != [_ITERATION, _TIME]:
        raise ValueError(f"it does not begin with {_ITERATION}, {_TIME}")
    if MOTOR_0 in predictors and "motor[0]" not in names:
        raise ValueError("other motors count from motor[0], which is not there")
    return Fields(tuple(names), predictors, encodings)


def _integers(settings: Mapping[str, str], name: str) -> tuple[int, ...]:
    text = settings.get(name, "")
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} is {text[:40]!r}") from None


def flights(blob: bytes) -> list[tuple[int, int]]:
    """Start and end of each flight in a file, bytes."""
    starts = [m.start() for m in re.finditer(re.escape(MAGIC), blob)]
    return list(pairwise([*starts, len(blob)]))


# -- encodings ----------------------------------------------------------------------------------
#
# Encodings of integers in Blackbox: bytes of 7 bits, or several integers in a group behind a tag.
#
# Each function takes bytes and an offset and returns the value there and the offset behind it; it
# raises IndexError at the end of the bytes and ValueError for an invalid code. Source: Betaflight's
# documentation, "Blackbox logging internals", and encoding.c.

_LONGEST_SHIFT = 28  # bits: five bytes of seven


def unsigned_vb(data: bytes, at: int) -> tuple[int, int]:
    """An integer of up to 32 bits, the lowest 7 first; the top bit marks all bytes but the last."""
    byte = data[at]
    if byte < 128:
        return byte, at + 1
    value, shift = byte & 127, 7
    while True:
        at += 1
        byte = data[at]
        value |= (byte & 127) << shift
        if byte < 128:
            return value & 0xFFFFFFFF, at + 1
        shift += 7
        if shift > _LONGEST_SHIFT:
            raise ValueError("an integer of more than 5 bytes")


def signed_vb(data: bytes, at: int) -> tuple[int, int]:
    """A signed integer: 0, -1, 1, -2, 2 are stored as 0, 1, 2, 3, 4."""
    byte = data[at]
    if byte < 128:
        return (byte >> 1) ^ -(byte & 1), at + 1
    value, at = unsigned_vb(data, at)
    return (value >> 1) ^ -(value & 1), at


def neg_14bit(data: bytes, at: int) -> tuple[int, int]:
    """A negated integer of 14 bits."""
    value, at = unsigned_vb(data, at)
    return -sign_extended(value, 14), at


def sign_extended(value: int, bits: int) -> int:
    """Signed value of the lowest bits of a number."""
    half = 1 << (bits - 1)
    return ((value & (2 * half - 1)) ^ half) - half


def tag8_8svb(data: bytes, at: int, count: int) -> tuple[list[int], int]:
    """One to eight numbers; bit i of the tag is set where number i is stored, else it is 0."""
    if count == 1:
        value, at = signed_vb(data, at)
        return [value], at
    tag = data[at]
    at += 1
    values = [0] * count
    for i in range(count):
        if tag >> i & 1:
            values[i], at = signed_vb(data, at)
    return values, at


def tag2_3s32(data: bytes, at: int) -> tuple[list[int], int]:
    """Three numbers, all of 2, 4 or 6 bits, or each of 1 to 4 bytes."""
    tag = data[at]
    size = tag >> 6
    if size == 0:
        return [sign_extended(tag >> shift, 2) for shift in (4, 2, 0)], at + 1
    if size == 1:
        rest = data[at + 1]
        return [sign_extended(tag, 4), sign_extended(rest >> 4, 4), sign_extended(rest, 4)], at + 2
    if size == 2:
        return [
            sign_extended(tag, 6),
            sign_extended(data[at + 1], 6),
            sign_extended(data[at + 2], 6),
        ], at + 3
    values, at = [], at + 1
    for _ in range(3):
        width = (tag & 3) + 1
        values.append(_bytes(data, at, width))
        at, tag = at + width, tag >> 2
    return values, at


def _bytes(data: bytes, at: int, width: int) -> int:
    """A signed number of some bytes, little-endian."""
    if at + width > len(data):
        raise IndexError("the end")
    return int.from_bytes(data[at : at + width], "little", signed=True)


def tag8_4s16(data: bytes, at: int) -> tuple[list[int], int]:
    """Four numbers of 0, 4, 8 or 16 bits by two bits each of the tag, the highest half-byte first;
    a remaining half-byte is not used. Data version 2."""
    tag = data[at]
    at += 1
    if not tag:
        return [0, 0, 0, 0], at
    widths = [(0, 1, 2, 4)[tag >> shift & 3] for shift in (0, 2, 4, 6)]
    size = (sum(widths) + 1) // 2
    if at + size > len(data):
        raise IndexError("the end")
    bits, left = int.from_bytes(data[at : at + size], "big"), 8 * size
    values = []
    for width in widths:
        left -= 4 * width
        values.append(sign_extended(bits >> left, 4 * width) if width else 0)
    return values, at + size


def tag8_4s16_v1(data: bytes, at: int) -> tuple[list[int], int]:
    """Four numbers in data version 1: two of 4 bits share a byte, the first in the lower half, and
    replace two numbers; one of 16 bits is little-endian."""
    tag = data[at]
    at += 1
    values: list[int] = []
    while len(values) < 4:
        kind, tag = tag & 3, tag >> 2
        if kind == 0:
            values.append(0)
        elif kind == 1:
            byte, at, tag = data[at], at + 1, tag >> 2
            values += [sign_extended(byte, 4), sign_extended(byte >> 4, 4)]
        else:
            width = kind - 1
            values.append(_bytes(data, at, width))
            at += width
    return values[:4], at


# -- fields of a frame --------------------------------------------------------------------------
#
# Reader of the fields of a frame in the order of its definition.

_GROUPS = {TAG2_3S32: 3, TAG8_4S16: 4}  # fields that are encoded together

Read = Callable[[bytes, int], tuple[list[int], int]]
"""Values of a frame whose fields begin at an offset, and the offset of their end. IndexError or
ValueError: the data end, or are invalid."""


def reader(fields: Fields, version: int) -> Read:
    """Function that reads the fields of a frame, without predictions.

    Args:
        fields: Definition of the frame.
        version: Version of the data, 1 or 2.

    Raises:
        ValueError: A group of fields is incomplete.
    """
    four = tag8_4s16 if version > 1 else tag8_4s16_v1
    single = {SIGNED_VB: signed_vb, UNSIGNED_VB: unsigned_vb, NEG_14BIT: neg_14bit}
    steps: list[tuple[int, int]] = []
    at = 0
    while at < len(fields.names):
        kind = NULL if fields.predictors[at] == INCREMENT else fields.encodings[at]
        count = _GROUPS.get(kind, 1)
        if kind == TAG8_8SVB:
            while count < 8 and fields.encodings[at + count : at + count + 1] == (kind,):
                count += 1
        if fields.encodings[at : at + count] != (kind,) * count and kind != NULL:
            raise ValueError(f"fewer than {count} fields in a group from {fields.names[at]}")
        steps.append((kind, count))
        at += count

    def read(data: bytes, at: int) -> tuple[list[int], int]:
        """Read a frame, as described in `Read`."""
        values: list[int] = []
        for kind, count in steps:
            if kind in single:
                value, at = single[kind](data, at)
                values.append(value)
            elif kind == TAG8_8SVB:
                several, at = tag8_8svb(data, at, count)
                values += several
            elif kind == TAG2_3S32:
                several, at = tag2_3s32(data, at)
                values += several
            elif kind == TAG8_4S16:
                several, at = four(data, at)
                values += several
            else:
                values.append(0)
        return values, at

    return read
