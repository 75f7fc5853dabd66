"""Open a flight, whatever its format."""

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from ..errors import LogError
from .doubts import doubts
from .flight import Flight
from .formats import (
    HEAD,
    LogFormat,
    Magic,
    ReadOptions,
    Signature,
    known_formats,
    nearly,
    recognise,
)
from .table import open_parquet
from .table.stored import AnyFlight

_F = TypeVar("_F", bound=AnyFlight)

NOT_READ: tuple[tuple[Signature, str], ...] = (
    (Magic(b"PK\x03\x04"), "a ZIP archive (or FMU). Unpack it first."),
    (Magic(b"\x1f\x8b"), "gzip-compressed. Unpack it first."),
    (
        Magic(b"\xfd"),
        "perhaps MAVLink as it was sent, without times. A telemetry log (.tlog) has them.",
    ),
)
"""What people try as well, and what to do then."""


def read_flight(path: str | Path, *, rebuild_commands: bool | None = None) -> Flight:
    """Read a flight log or flight table; the format is told by the first bytes.

    Args:
        path: File, of one of `formats.FORMATS`.
        rebuild_commands: As in `formats.ReadOptions`.

    Raises:
        LogError: The file cannot be used; the text says why and what to do.
    """
    path = Path(path)
    blob = _content(path)
    try:
        found = recognise(blob)
    except LogError as error:
        raise LogError(f"{path.name}: {error}") from None
    if found is None:
        raise LogError(f"{path.name}: {_looks_like(blob)} Known formats: {known_formats()}.")
    return _doubted(found.load()(path, blob, ReadOptions(rebuild_commands)), found)


def open_flight(path: str | Path, *, rebuild_commands: bool | None = None) -> AnyFlight:
    """The same, a long flight table in Parquet left in its file: memory does not grow with it.

    Args:
        path: As of `read_flight`.
        rebuild_commands: As of `read_flight`.

    Raises:
        LogError: As of `read_flight`.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
    except (OSError, ValueError):
        return read_flight(path, rebuild_commands=rebuild_commands)  # which says why
    if Magic(b"PAR1").matches(head) and (found := recognise(head)) is not None:
        stored = open_parquet(path)
        if stored is not None:
            return _doubted(stored, found)
    return read_flight(path, rebuild_commands=rebuild_commands)


def _doubted(flight: _F, read_as: LogFormat) -> _F:
    """The flight with its format, and with what its values contradict."""
    said = set(flight.findings)
    more = [f for f in doubts(flight.columns) if f not in said]  # a writer may have noted them
    facts = {"format": read_as.name, **flight.facts}
    return replace(flight, facts=facts, findings=(*flight.findings, *more))


def _content(path: Path) -> bytes:
    """Bytes of the file."""
    try:
        blob = path.read_bytes()
    except FileNotFoundError:
        raise LogError(f"{path}: there is no such file.") from None
    except IsADirectoryError:
        raise LogError(
            f"{path}: this is a folder. Give a file; known formats: {known_formats()}."
        ) from None
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read: {error}.") from None
    if not blob:
        raise LogError(f"{path.name}: the file is empty (0 bytes). Copy the log again.")
    return blob


def _looks_like(blob: bytes) -> str:
    """One sentence on what the file seems to be."""
    if damaged := nearly(blob):
        return f"{damaged}. Copy the log again."
    for signature, text in NOT_READ:
        if signature.matches(blob[:HEAD]):
            return text
    head = blob[:64]
    if all(32 <= b < 127 or b in b"\t\r\n" for b in head):
        line = head.splitlines()[0].decode("ascii")[:40] if head.strip() else ""
        return f"text that begins with '{line}', not with a column 'time'."
    return f"no known flight log (it begins with {blob[:4].hex(' ')})."
