"""Binary DataFlash logs: messages found by their marks and the lengths that FMT gives.

A message counts where the next one begins right behind it. Where that is not so, or its type is
not defined, the bytes up to the next such message are lost and counted, nothing more.
"""

import struct
from array import array
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .definitions import FMT, FMT_NUMBER, HEADER, Definition, define, text
from .messages import UNIT_MESSAGES, Content, Damage, Messages, with_units

MARK = b"\xa3\x95"
_SHOWN = 8
_Places = tuple["array[int]", "array[int]"]


@dataclass(slots=True)
class _Walk:
    """A way through a file.

    Attributes:
        defined: Definition by type, as far as the file has been read.
        starts: Begin of the content of each message, and its place among all, by definition.
        damage: What made no sense on the way.
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
    """All messages of the file."""
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
            _define(blob, at + HEADER, walk, sizes, lists)
        at += size
        if at >= solid:
            break  # the rest is padding
    return walk


def _whole(blob: bytes, at: int, sizes: dict[int, int], solid: int) -> int:
    """Bytes of the message that begins there, 0 where none does or it is not whole.

    Behind it there is the next one, or the end of what is not padding, or half a mark.
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
    """Skip what makes no sense; where the next message begins, or the end of the file."""
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


def _define(
    blob: bytes,
    at: int,
    walk: _Walk,
    sizes: dict[int, int],
    lists: dict[int, _Places],
) -> None:
    """Take a FMT message in."""
    number, length, *texts = struct.unpack_from("<BB4s16s64s", blob, at)
    if number == FMT_NUMBER:
        return  # it never changes
    name, letters, columns = map(text, texts)
    shown = "".join(c for c in name if c.isprintable())[:_SHOWN] or f"of type {number}"
    try:
        made = define(number, length, name, letters, columns)
    except ValueError as why:
        walk.damage.undefined.append(f"{shown}: {why}")
        made = Definition(number, shown, "", ())  # its messages are stepped over
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
    """Columns of the messages that begin there."""
    dtype = definition.dtype
    windows = np.lib.stride_tricks.sliding_window_view(raw, dtype.itemsize)
    rows = windows[np.array(starts, dtype=np.int64)].view(dtype)[:, 0]
    data = {}
    for column in definition.columns:
        values = rows[column]
        divisor = definition.divisor(column)
        data[column] = values if divisor == 1.0 else values.astype(np.float64) / divisor
    return Messages(definition, np.array(places, dtype=np.int64), data)
