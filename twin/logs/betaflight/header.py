"""The head of a Blackbox log: lines `H name:value`, among them what each kind of frame holds.

Each flight in a file has a head of its own. Source: Betaflight's documentation, "Blackbox logging
internals", and blackbox.c.
"""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

MAGIC = b"H Product:Blackbox"
"""What a log begins with, and each further flight in it."""

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
"""Predictors: what the number in a frame is added to."""
SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NULL = 0, 1, 3, 6, 7, 8, 9
"""Encodings that Betaflight uses."""
ENCODINGS = frozenset((SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NULL))
PREDICTORS = frozenset(range(12))

_NEXT_LINE = re.compile(rb"\nH [ -~]{1,80}:")
_LONGEST_LINE = 4096
_MOST_FIELDS = 200
_MOST_INTERVAL = 65_536
_ITERATION, _TIME = "loopIteration", "time"


@dataclass(frozen=True, slots=True)
class Fields:
    """What a kind of frame holds, in order.

    Attributes:
        names: Of the fields.
        predictors: Of each.
        encodings: Of each.
    """

    names: tuple[str, ...]
    predictors: tuple[int, ...]
    encodings: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Header:
    """The head of one flight.

    Attributes:
        settings: By name, as text.
        frames: What frames hold, by the letter that they begin with.
        unusable: Kinds of frames whose definition makes no sense, with the reason.
        damaged: Lines of which nothing can be made.
        size: Bytes.
    """

    settings: Mapping[str, str]
    frames: Mapping[str, Fields]
    unusable: Mapping[str, str]
    damaged: int
    size: int

    def numbers(self, name: str) -> tuple[float, ...]:
        """The numbers of a setting, () where it is not there or is none."""
        try:
            return tuple(float(part) for part in self.settings[name].split(","))
        except (KeyError, ValueError):
            return ()

    def number(self, name: str, default: float) -> float:
        """The first number of a setting."""
        return next(iter(self.numbers(name)), default)

    def whole(self, name: str, default: int) -> int:
        """The same as an integer of 32 bits, the default where it is none."""
        value = self.number(name, default)
        return int(value) if abs(value) < 2**31 else default

    def bits(self, name: str) -> float | None:
        """A number that is written as the bytes of a float: `0x3f800000` is 1."""
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
        """Loops between I frames, then how many frames are logged (numerator) of how many loops
        (denominator); `P interval` is 4, or 1/4 in older logs.

        Raises:
            ValueError: They make no sense.
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
    """The head that a flight begins with; what cannot be read of it is counted.

    Args:
        blob: From the begin of the flight.
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
    """Fields of one kind of frame; those of P are those of I, written otherwise."""
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
    """Begin and end of each flight in a file, bytes."""
    starts = [m.start() for m in re.finditer(re.escape(MAGIC), blob)]
    return list(pairwise([*starts, len(blob)]))
