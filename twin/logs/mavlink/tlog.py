"""Telemetry logs (.tlog) of ground stations: before each MAVLink frame, when it came.

The time is in us since 1970, 8 bytes, the most significant first.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from .dialect import MARKERS, dialect

_STAMP = struct.Struct(">Q")
_HEAD = _STAMP.size
_YEAR_2000_US, _YEAR_2100_US = 946_684_800_000_000, 4_102_444_800_000_000
_DAY_US = 86_400_000_000
_V1, _V2 = MARKERS
_SIGNATURE = 13
_BEGIN = re.compile(rb"(?s)(?=\x00[\x03-\x0e].{6}[\xfd\xfe])")
"""A stamp of the years 2000 to 2100 by its first two bytes, and the first byte of a frame."""


def checksum_of(frame: bytes) -> int:
    """The last bytes of a frame: of its checksum, or of its signature."""
    return int.from_bytes(frame[-2:], "little")


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame.

    Attributes:
        arrival_us: When it came, us since 1970.
        content: Its bytes.
        system: Who sent it.
        component: Which part of it.
        number: In its sequence.
        kind: Number of its kind of message.
    """

    arrival_us: int
    content: bytes
    system: int
    component: int
    number: int
    kind: int

    @property
    def checksum(self) -> int:
        """As of `checksum_of`."""
        return checksum_of(self.content)


def stamped(arrival_us: int, frame: bytes) -> bytes:
    """A frame as it stands in a telemetry log."""
    return _STAMP.pack(arrival_us) + frame


def frames(blob: bytes) -> Iterator[Frame | int]:
    """Frames of a telemetry log, and numbers of bytes between them that are none."""
    at, before, lost = 0, None, 0
    while at < len(blob):
        length = _length(blob, at + _HEAD) if _begins(blob, at, before) else 0
        end = at + _HEAD + length
        if not length or end > len(blob) or not (end == len(blob) or _follows(blob, end)):
            found = _BEGIN.search(blob, at + 1)
            begin = len(blob) if found is None else found.start()
            at, lost = begin, lost + begin - at
            continue
        if lost:
            yield lost
            lost = 0
        (before,) = _STAMP.unpack_from(blob, at)
        yield _frame(before, blob[at + _HEAD : end])
        at = end
    if lost:
        yield lost


def _frame(arrival_us: int, content: bytes) -> Frame:
    if content[0] == _V1:
        number, system, component, kind = content[2:6]
    else:
        number, system, component = content[4:7]
        kind = int.from_bytes(content[7:10], "little")
    return Frame(arrival_us, content, system, component, number, kind)


def _begins(blob: bytes, at: int, before: int | None) -> bool:
    """Whether a time and the first byte of a frame stand there, a time near the one before."""
    if len(blob) < at + _HEAD + 1 or blob[at + _HEAD] not in MARKERS:
        return False
    (stamp,) = _STAMP.unpack_from(blob, at)
    if not _YEAR_2000_US < stamp < _YEAR_2100_US:
        return False
    return before is None or abs(stamp - before) < _DAY_US


def _follows(blob: bytes, at: int) -> bool:
    """Whether another frame begins there, as far as the file goes."""
    if len(blob) < at + _HEAD + 1:
        return True
    (stamp,) = _STAMP.unpack_from(blob, at)
    return blob[at + _HEAD] in MARKERS and _YEAR_2000_US < stamp < _YEAR_2100_US


def _length(blob: bytes, at: int) -> int:
    """Bytes of the frame that begins there; 0 where its head is cut off."""
    if len(blob) < at + 3:
        return 0
    payload = blob[at + 1]
    if blob[at] == _V1:
        return int(payload + dialect.HEADER_LEN_V1 + 2)
    signed = blob[at + 2] & dialect.MAVLINK_IFLAG_SIGNED
    return int(payload + dialect.HEADER_LEN_V2 + 2 + (_SIGNATURE if signed else 0))
