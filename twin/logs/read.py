"""Open a flight, whatever its format."""

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from ..errors import LogError
from .containers import (
    CERTAIN,
    before_the_head,
    erased,
    found_behind,
    is_named,
    looks_like,
    unpacked,
)
from .doubts import doubts
from .flight import Finding, Flight
from .formats import HEAD, LogFormat, Magic, ReadOptions, known_formats, nearly, recognise
from .motor_checks import is_misnumbered
from .rotor_lag import with_speeds_in_step
from .table import open_parquet
from .table.stored import AnyFlight

_F = TypeVar("_F", bound=AnyFlight)


def read_flight(path: str | Path, *, rebuild_commands: bool | None = None) -> Flight:
    """Read a flight log or flight table, also one in a ZIP archive or compressed by gzip or bzip2.

    The content decides on the format, not the name; bytes of another program before the head of a
    log are left out and counted.

    Args:
        path: File, of one of `formats.FORMATS`.
        rebuild_commands: As in `formats.ReadOptions`.

    Raises:
        LogError: The file cannot be used; the text says why and what to do.
    """
    path = Path(path)
    blob = _content(path)
    try:
        found, blob, findings = _located(blob)
    except LogError as error:
        raise LogError(f"{path.name}: {error}") from None
    flight = found.load()(path, blob, ReadOptions(rebuild_commands))
    return _doubted(replace(flight, findings=(*findings, *flight.findings)), found)


def _located(blob: bytes) -> tuple[LogFormat, bytes, tuple[Finding, ...]]:
    """Format and content of the log in a file, and findings on what is around it.

    Raises:
        LogError: There is none.
    """
    inside = unpacked(blob)
    blob, findings = inside.blob, inside.findings
    if all_alike := erased(blob):
        raise LogError(all_alike)
    if (found := recognise(blob)) is not None:
        return found, blob, findings
    if named := is_named(blob, CERTAIN):
        raise LogError(named)
    if (behind := found_behind(blob)) is not None:
        at, found = behind
        return found, blob[at:], (*findings, before_the_head(blob, at))
    if damaged := nearly(blob):
        raise LogError(f"{damaged}. Copy the log again. Known formats: {known_formats()}.")
    raise LogError(f"{looks_like(blob)} Known formats: {known_formats()}.")


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
    """The flight with its format, late rotor speeds in step, and what its values contradict; rotor
    speeds of other motors than their numbers say are left out: the commands drive the twin."""
    said = set(flight.findings)
    layout = None if flight.airframe is None else flight.airframe.layout
    more = [f for f in doubts(flight.columns, layout) if f not in said]  # a writer may note them
    facts = {"format": read_as.name, **flight.facts}
    changed = replace(flight, facts=facts, findings=(*flight.findings, *more))
    if not any(is_misnumbered(f) for f in more):
        return with_speeds_in_step(changed)
    speeds = {c for c in changed.columns if c.startswith("rotor_")}
    if isinstance(changed, Flight):
        return replace(changed, table=changed.table.drop(columns=list(speeds)))
    return replace(changed, known=changed.known - speeds)


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
