"""What a ULog says of its own messages, looked at before pyulog unfolds it."""

import re
import struct
from collections.abc import Iterator
from pathlib import Path

from ...errors import LogError

_FIRST_DATA = b"AL"  # the first of these ends the definitions
_LONGEST = 10000  # bytes of a message; longer ones are damage
_MOST_FIELDS = 65535  # the length of a message has 16 bits, a field at least 8
_MOST_UNFOLDED = 2_000_000  # fields of all subscriptions together; a PX4 log has some 5000
_BASIC = re.compile(r"u?int(8|16|32|64)_t|float|double|bool|char")
_ADDED = 3  # bytes before the name of the topic in a subscription


def messages(blob: bytes) -> Iterator[tuple[int, int, int]]:
    """Kind, start and end of the content of each message, as far as the file has them whole."""
    at, end = 16, len(blob)
    header = struct.Struct("<HB").unpack_from
    while at + 3 <= end:
        size, kind = header(blob, at)
        if at + 3 + size > end:
            return
        yield kind, at + 3, at + 3 + size
        at += 3 + size


def check_definitions(path: Path, blob: bytes) -> None:
    """Refuse a log whose definitions are cut, damaged or endless.

    pyulog 1.3 never returns from some that are damaged, and unfolds nested formats whatever their
    depth.

    Raises:
        LogError: As said.
    """
    end = 16
    for kind, start, end in messages(blob):
        if kind in _FIRST_DATA:
            break
        if kind == 0 or not 0 < end - start <= _LONGEST:
            raise LogError(
                f"{path.name}: damaged ULog: byte {start - 3} of {len(blob)}, within its "
                "definitions, makes no sense. Copy the log from the vehicle again."
            )
    else:
        raise LogError(
            f"{path.name}: ULog cut short within its definitions after {len(blob)} bytes, before "
            "any sample. Copy the log from the vehicle again."
        )
    _check_formats(path, blob)


def _check_formats(path: Path, blob: bytes) -> None:
    """Refuse formats of more fields than a message has room for, and too many subscriptions."""
    inner: dict[str, list[tuple[str, int]]] = {}
    unfolded = 0
    sizes: dict[str, int] = {}
    for kind, start, end in messages(blob):
        if kind == ord("F"):
            name, _, fields = blob[start:end].decode("utf-8", "ignore").partition(":")
            inner[name] = [_kind(f) for f in fields.split(";") if f]
            sizes.clear()
        elif kind == ord("A"):
            name = blob[start + _ADDED : end].decode("utf-8", "ignore")
            if name not in sizes:
                sizes[name] = _unfolded(path, name, inner, sizes)
            unfolded += sizes[name]
        if unfolded > _MOST_UNFOLDED:
            raise LogError(
                f"{path.name}: damaged ULog: its subscriptions have over {_MOST_UNFOLDED} fields. "
                "Copy the log from the vehicle again."
            )
    for name in inner:  # a subscription may stand where damage hides it from this walk
        if name not in sizes:
            _unfolded(path, name, inner, sizes)


def _kind(field: str) -> tuple[str, int]:
    """Type of a field and how many of it there are."""
    kind, _, rest = field.split(" ")[0].partition("[")
    count = rest.rstrip("]")
    return kind, int(count) if count.isdecimal() and len(count) < 8 else 1


def _unfolded(
    path: Path, name: str, inner: dict[str, list[tuple[str, int]]], sizes: dict[str, int]
) -> int:
    """Fields of a format with those of the formats within it, each of which counts as one more."""
    pending = [name]
    while pending:
        top = pending[-1]
        within = [(k, n) for k, n in inner.get(top, []) if not _BASIC.fullmatch(k)]
        unknown = [k for k, _ in within if k not in sizes]
        if any(k in pending for k in unknown):
            raise LogError(
                f"{path.name}: damaged ULog: the format '{top[:40]}' contains itself. Copy the "
                "log from the vehicle again."
            )
        if unknown:
            pending.append(unknown[0])
            continue
        sizes[top] = 1 + sum(n * sizes.get(k, 1) for k, n in inner.get(top, []))
        if sizes[top] > _MOST_FIELDS:
            raise LogError(
                f"{path.name}: damaged ULog: the format '{top[:40]}' has over {_MOST_FIELDS} "
                "fields, more than a message can hold. Copy the log from the vehicle again."
            )
        pending.pop()
    return sizes[name]
