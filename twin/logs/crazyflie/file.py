"""The file that the uSD-card deck of a Crazyflie writes.

`BC`, the version and the number of kinds of events (uint16 each); of each kind its number
(uint16), its name, the number of its variables (uint16) and each as `group.name(c)` with the
letter of its type in Python's `struct`, texts ended by a zero. Then the events: number of the kind
(uint16), time since boot (version 1: ms, uint32; version 2: us, uint64), values without gaps. At
the end the CRC-32 of all of it. Little-endian. Source: Bitcraze, crazyflie-firmware, usddeck.c.
"""

import struct
import zlib
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError
from ..flight import Array

_TYPES = frozenset("bBhHiIqQefd?")
_STAMPS = {1: ("<u4", 1000), 2: ("<u8", 1)}
"""By version: type of a time, and how many us its unit has."""
_HEAD = struct.Struct("<BHH")
_CRC_BYTES = 4
_LONGEST_NAME = 256
_MOST_VARIABLES = 10_000
_NEVER_US = 2**62
TIME, KIND = "#time", "#kind"
"""Fields of an event that are no variables; no C name begins so."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of events.

    Attributes:
        name: `fixedFrequency`, or that of what triggers it.
        layout: Of one event, number and time included.
    """

    name: str
    layout: np.dtype[np.void]

    @property
    def variables(self) -> tuple[str, ...]:
        """Names, as `group.name`."""
        return tuple(n for n in self.layout.names or () if n not in (KIND, TIME))


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """All events of one kind, in the order of the file.

    Attributes:
        kind: What they are.
        t_us: Time since boot, us, shape (n,).
        rows: Structured, shape (n,).
    """

    kind: Kind
    t_us: NDArray[np.int64]
    rows: NDArray[np.void]

    def values(self, names: tuple[str, ...]) -> Array:
        """Variables side by side, shape (n, len(names))."""
        with np.errstate(invalid="ignore"):  # damaged logs hold signalling NaN
            return np.column_stack([self.rows[n].astype(np.float64) for n in names])


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What a file holds.

    Attributes:
        version: Of the format.
        events: By kind, those without events left out.
        lost: Bytes at the end of which nothing can be made.
        whole: Whether the checksum at the end is that of the file.
    """

    version: int
    events: tuple[Events, ...]
    lost: int
    whole: bool


def read_content(path: Path, blob: bytes) -> Content:
    """Decode a file; what follows an event of no known kind is lost.

    Args:
        path: File name, for messages.
        blob: Content of the file.

    Raises:
        LogError: Its head is cut or makes no sense.
    """
    try:
        version, kinds, begin = _head(blob)
    except (struct.error, ValueError, KeyError) as error:
        raise LogError(
            f"{path.name}: the head of the Crazyflie log cannot be read ({error}): it was cut or "
            "damaged. Copy the file from the card again."
        ) from error
    whole = zlib.crc32(blob[:-_CRC_BYTES]) == int.from_bytes(blob[-_CRC_BYTES:], "little")
    end = len(blob) - _CRC_BYTES * whole
    starts, reached = _starts(blob, begin, end, kinds)
    content = np.frombuffer(blob, np.uint8)
    _, unit_us = _STAMPS[version]
    found = []
    for number, kind in kinds.items():
        here = np.frombuffer(starts[number], dtype=np.int64)
        if len(here) == 0:
            continue
        size = kind.layout.itemsize
        rows = content[here[:, None] + np.arange(size)].reshape(-1).view(kind.layout)
        stamps = np.minimum(rows[TIME], np.uint64(_NEVER_US // unit_us)).astype(np.int64)
        found.append(Events(kind, stamps * unit_us, rows))
    return Content(version, tuple(found), end - reached, whole)


def _head(blob: bytes) -> tuple[int, dict[int, Kind], int]:
    """Version, kinds by number, and where the events begin."""
    _, version, count = _HEAD.unpack_from(blob)
    stamp, _ = _STAMPS[version]
    kinds: dict[int, Kind] = {}
    at, total = _HEAD.size, 0
    for _ in range(count):
        (number,) = struct.unpack_from("<H", blob, at)
        name, at = _text(blob, at + 2)
        (several,) = struct.unpack_from("<H", blob, at)
        at, total = at + 2, total + several
        if total > _MOST_VARIABLES:
            raise ValueError(f"more than {_MOST_VARIABLES} variables")
        fields = [(KIND, "<u2"), (TIME, stamp)]
        for _ in range(several):
            variable, at = _text(blob, at)
            title, letter = variable[:-3], variable[-2:-1]
            if variable != f"{title}({letter})" or letter not in _TYPES:
                raise ValueError(f"variable {variable!r} of no known type")
            fields.append((title, "<" + letter))
        if number in kinds:
            raise ValueError(f"two kinds of number {number}")
        kinds[number] = Kind(name, np.dtype(fields))
    return version, kinds, at


def _text(blob: bytes, at: int) -> tuple[str, int]:
    """A text that a zero ends, and where it goes on behind it."""
    end = blob.find(b"\0", at, at + _LONGEST_NAME)
    if end < 0:
        raise ValueError(f"a name without an end at byte {at}")
    return blob[at:end].decode("ascii"), end + 1


def _starts(
    blob: bytes, begin: int, end: int, kinds: Mapping[int, Kind]
) -> tuple[dict[int, "array[int]"], int]:
    """Where the events of each kind begin, and where nothing can be made of it any more."""
    starts = {number: array("q") for number in kinds}
    sizes = {number: kind.layout.itemsize for number, kind in kinds.items()}
    at = begin
    while at + 2 <= end:
        number = blob[at] | blob[at + 1] << 8
        size = sizes.get(number, 0)
        if not size or at + size > end:
            break
        starts[number].append(at)
        at += size
    return starts, at
