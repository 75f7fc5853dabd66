"""Datagrams of MAVLink 2 taken apart, a frame at a time in one unpacking.

pymavlink goes through a datagram byte by byte and makes an object of every field of every message,
which is most of what listening costs. What comes in flight are whole frames of known kinds made of
numbers; all else is pymavlink's: text, signatures, MAVLink 1, damage.
"""

import struct
from functools import cache
from operator import itemgetter
from typing import Any

from .dialect import MARKERS, Message, dialect
from .tlog import checksum_of

_HEAD = struct.Struct("<BBBBBBBHB")
_CHECKSUM_SIZE = 2
_KIND = struct.Struct("<HB")
_MARKER = MARKERS[1]


class Unpacked(tuple[Any, ...]):
    """A message: header and payload, in the order of the wire; its fields are attributes.

    It has what a message of pymavlink has and is asked for here.
    """

    __slots__ = ()
    kind = ""

    def get_type(self) -> str:
        """Name of its kind."""
        return self.kind

    def get_seq(self) -> int:
        """Number in the sequence of its sender."""
        return int(self[4])

    def get_srcSystem(self) -> int:  # noqa: N802
        """Who sent it."""
        return int(self[5])

    def get_srcComponent(self) -> int:  # noqa: N802
        """Which part of it."""
        return int(self[6])


def unpacked(datagram: bytes) -> list[tuple[Message, bytes]] | None:
    """Messages of a datagram with their frames; None where one of them is not for here."""
    found, at, end = [], 0, len(datagram)
    while at < end:
        if end - at < _HEAD.size or datagram[at] != _MARKER or datagram[at + 2]:
            return None
        last = at + _HEAD.size + datagram[at + 1] + _CHECKSUM_SIZE
        low, high = _KIND.unpack_from(datagram, at + 7)
        made = _made(low | high << 16)
        if last > end or made is None:
            return None
        extra, whole, message = made
        frame = datagram[at:last]
        if dialect.x25crc(frame[1:-_CHECKSUM_SIZE] + extra).crc != checksum_of(frame):
            return None
        content = frame[:-_CHECKSUM_SIZE].ljust(whole.size, b"\0")  # zeros at the end are not sent
        found.append((message(whole.unpack_from(content)), frame))
        at = last
    return found


@cache
def _made(kind: int) -> tuple[bytes, struct.Struct, type[Unpacked]] | None:
    """Of a kind of message what its checksum begins with, its layout, and its class."""
    about = dialect.mavlink_map.get(kind)
    if about is None or "s" in about.unpacker.format:
        return None
    fields, at = {}, len(_HEAD.unpack(bytes(_HEAD.size)))
    for name, length in zip(about.ordered_fieldnames, about.lengths, strict=True):
        where = at if length == 1 else slice(at, at + length)
        fields[name] = property(itemgetter(where))
        at += length
    layout = struct.Struct(_HEAD.format + about.unpacker.format.removeprefix("<"))
    own = {"__slots__": (), "kind": about.msgname, **fields}
    return bytes([about.crc_extra]), layout, type(about.msgname, (Unpacked,), own)
