"""Open a flight of any format and in any container."""

import bz2
import gzip
import io
import lzma
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from ..errors import LogError, NoLogError
from ..topic_mapping import BAG_SUFFIXES
from .doubts import doubts
from .flight import Finding, Flight
from .formats import (
    FORMATS,
    HEAD,
    OF_LOGS_ALONE,
    FirstWord,
    LogFormat,
    Magic,
    ReadOptions,
    Signature,
    damaged_signature,
    known_formats,
    recognise,
)
from .motor_checks import is_misnumbered
from .rotor_lag import align_speed_stamps
from .stored import AnyFlight
from .table import open_parquet

# -- containers ---------------------------------------------------------------------------------
#
# Containers of a log: archives, compression, bytes of another program before its head; and files
# that are no log, by name. The log inside counts, not its container.

_MOST_RATIO = 100
"""Largest ratio of unpacked size to archive size: text logs compress by up to 20."""
_ALWAYS = 16_000_000
"""Bytes that may be unpacked whatever the ratio."""
DAMAGED = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError),
    *(OSError, EOFError, ValueError, NotImplementedError),
)
"""Exceptions from opening an archive, or a file in it, that is damaged or of an unknown kind."""
_SHOWN = 6  # files of an archive that an error lists
_FEWEST = 16
"""Equal bytes from which a file counts as erased."""
_ZIP = (Magic(b"PK\x03\x04"), Magic(b"PK\x05\x06"))  # archives with and without members
_STREAMS = (  # signature, name, function that opens it
    (Magic(b"\x1f\x8b"), "gzip-compressed", gzip.open),
    (Magic(b"BZh"), "bzip2-compressed", bz2.open),
)
_NO_MEMBERS = ("__MACOSX/", ".DS_Store")  # files that macOS adds
_OF_SYSTEMS = {
    "modelDescription.xml": "an FMU, no flight. uavtwin check and simulate read it.",
    "SystemStructure.ssd": "a system of FMUs (SSP), no flight. uavtwin simulate runs it.",
    "xl/workbook.xml": "an Excel workbook. Save the sheet as CSV, with a column 'time'.",
}
"""Archives that contain no logs, by a member."""

_Named = tuple[tuple[Signature, str], ...]

CERTAIN: _Named = (
    (
        Magic(b"ULogEnc"),
        "an encrypted PX4 log (.ulge): decrypt it with your key (PX4: Tools/decrypt_ulog.py), and "
        "give the .ulg.",
    ),
    (
        Magic(b"\x00\x00\x00\x00\x07\x00\x00\x00uavtwin", at=17),  # profile, library of an MCAP
        "an MCAP that uavtwin wrote, for Foxglove and PlotJuggler: give the log that it was made "
        "of, or convert that to a flight table (.parquet).",
    ),
    (Magic(b"version https://git-lfs"), "a Git LFS pointer, not the file: run `git lfs pull`."),
    *(
        (FirstWord(word), "an HTML page, mostly the error or login page of a download.")
        for word in (b"<!doctype html", b"<html")
    ),
    (FirstWord(b"<?xml"), "XML, no flight log."),
    *(
        (Magic(magic), f"{name}. Unpack it first.")
        for magic, name in (
            (b"\xfd7zXZ\x00", "xz-compressed"),
            (b"\x28\xb5\x2f\xfd", "zstd-compressed"),
            (b"\x04\x22\x4d\x18", "LZ4-compressed"),
            (b"7z\xbc\xaf\x27\x1c", "a 7z archive"),
            (b"Rar!\x1a\x07", "a RAR archive"),
        )
    ),
    (Magic(b"ustar", at=257), "a tar archive. Unpack it first."),
    *(
        (Magic(magic), f"{name}. Convert it to a flight table (CSV or Parquet).")
        for magic, name in (
            (b"#ROSBAG V", "a ROS 1 bag"),
            (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
            (b"MATLAB 5.0 MAT-file", "a MATLAB file"),
        )
    ),
    *((Magic(magic), "a picture, no flight log.") for magic in (b"\x89PNG\r\n", b"\xff\xd8\xff")),
    (Magic(b"%PDF-"), "a PDF document, no flight log."),
)
"""Files that are no log, by their first bytes, and the remedy."""
PERHAPS: _Named = (
    (FirstWord(b"{"), "JSON, no flight log: the answer of a server, or results of a program?"),
    *(
        (Magic(mark), "text in UTF-16, as PowerShell writes it. Save it as UTF-8.")
        for mark in (b"\xff\xfe", b"\xfe\xff")
    ),
    *(
        (
            Magic(marker),
            "perhaps MAVLink as it was sent, without times. A telemetry log (.tlog) has them.",
        )
        for marker in (b"\xfd", b"\xfe")
    ),
)
"""Files that are probably no log, by few first bytes: a log may still follow."""


@dataclass(frozen=True, slots=True)
class Unpacked:
    """A log taken out of its container.

    Attributes:
        blob: Content of the log.
        findings: Findings that name its containers.
    """

    blob: bytes
    findings: tuple[Finding, ...] = ()


def is_archive_of(path: Path, member: str) -> bool:
    """Whether a file is a ZIP archive with a member of that name."""
    try:
        with zipfile.ZipFile(path) as archive:
            return member in archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return False


_DEEPEST = 3
"""Largest depth of nested archives and compressed files."""


def unpacked(blob: bytes, deepest: int = _DEEPEST) -> Unpacked:
    """The log in an archive or a compressed file; the content itself where it is neither.

    Args:
        blob: Content of a file.
        deepest: Depth of nested archives and compressed files that are opened.

    Raises:
        LogError: The archive is damaged, contains no log, or several.
    """
    if not deepest:
        return Unpacked(blob)
    if any(s.matches(blob) for s in _ZIP):
        return _from_archive(blob)
    for signature, what, opened in _STREAMS:
        if not signature.matches(blob):
            continue
        most = most_unpacked(len(blob))
        try:
            with opened(io.BytesIO(blob)) as file:
                inner = bytes(file.read(most + 1))
        except (OSError, EOFError, zlib.error) as error:
            raise LogError(f"{what}, cut short or damaged ({error}). Copy it again.") from None
        if len(inner) > most:
            raise LogError(f"{what}; it unpacks to over {most} bytes, {TOO_LARGE}")
        found = Finding("info", "file", f"{what}, {len(inner)} bytes unpacked")
        within = unpacked(inner, deepest - 1)
        return Unpacked(within.blob, (found, *within.findings))
    return Unpacked(blob)


TOO_LARGE = (
    f"over {_MOST_RATIO} times its size, as no flight log does. Unpack it first if it is one."
)
"""End of the error on content that unpacks to more than `most_unpacked`."""


def most_unpacked(size: int) -> int:
    """Largest unpacked size of an archive of some size, bytes."""
    return max(_ALWAYS, _MOST_RATIO * size)


def _from_archive(blob: bytes) -> Unpacked:
    """The one log in a ZIP archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(blob)) as archive:
            files, logs = _members(archive)
            if len(logs) != 1:
                raise LogError(_which(files, logs))
            (log,) = logs
            if log.file_size > (most := most_unpacked(len(blob))):
                raise LogError(f"a ZIP archive: {log.filename} has over {most} bytes, {TOO_LARGE}")
            content = archive.read(log)
    except NotImplementedError as error:
        raise LogError(f"a ZIP archive of an unknown kind ({error}). Unpack it first.") from None
    except DAMAGED as error:
        raise LogError(
            f"a ZIP archive, cut short or damaged ({error}). Copy or download it again."
        ) from None
    others = f"; files in it that are no logs: {len(files) - 1}" if len(files) > 1 else ""
    message = f"{log.filename[:80]}, out of a ZIP archive{others}"
    return Unpacked(content, (Finding("info", "file", message),))


def _members(
    archive: zipfile.ZipFile,
) -> tuple[list[zipfile.ZipInfo], list[zipfile.ZipInfo]]:
    """Files in an archive, and the logs among them.

    Raises:
        LogError: The archive is no container of logs, or has a password.
    """
    names = set(archive.namelist())
    for member, what in _OF_SYSTEMS.items():
        if member in names:
            raise LogError(what)
    files = [
        m
        for m in archive.infolist()
        if not m.is_dir() and not any(n in m.filename for n in _NO_MEMBERS)
    ]
    if any(m.flag_bits & 1 for m in files):
        raise LogError("a ZIP archive with a password. Unpack it first.")
    return files, [m for m in files if _is_log(archive, m)]


def logs_in_archive(path: Path) -> list[str]:
    """Names of the logs in a ZIP archive; none where the file is no archive of logs."""
    try:
        with zipfile.ZipFile(path) as archive:
            return [m.filename for m in _members(archive)[1]]
    except (LogError, *DAMAGED):
        return []


def _is_log(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bool:
    """Whether a file in an archive is of a known format, by its head or by its first bytes."""
    with archive.open(member) as file:
        head = file.read(HEAD)
    return any(f.signature.matches(head) for f in FORMATS) or find_embedded_log(head) is not None


def _which(files: Sequence[zipfile.ZipInfo], logs: Sequence[zipfile.ZipInfo]) -> str:
    """Description of the content of an archive without exactly one log."""
    shown = logs or files
    named = ", ".join(f"{m.filename[:60]} ({m.file_size} bytes)" for m in shown[:_SHOWN])
    more = f" and {len(shown) - _SHOWN} more" if len(shown) > _SHOWN else ""
    if logs:
        return f"a ZIP archive of {len(logs)} logs: {named}{more}. Extract the one that is meant."
    if not files:
        return "a ZIP archive without a file."
    return f"a ZIP archive without a flight log; it holds {named}{more}."


def find_embedded_log(blob: bytes) -> tuple[int, LogFormat] | None:
    """Offset and format of a log behind bytes of another program, of a serial logger or console;
    None where there is none."""
    starts = [
        (match.start(), k)
        for k, f in enumerate(FORMATS)
        if f.sought is not None and (match := f.sought.search(blob))
    ]
    if not starts:
        return None
    at, k = min(starts)
    return at, FORMATS[k]


def leading_bytes_finding(blob: bytes, at: int) -> Finding:
    """The finding on bytes before a log's head."""
    lead = blob[: min(at, 60)]
    text = lead.decode("ascii", "replace").strip()
    shown = f" ('{' '.join(text.split())[:40]}')" if text.isprintable() or text.isascii() else ""
    return Finding(
        "warning",
        "file",
        f"{at} bytes before the head of the log{shown}, of another program: read from there on",
        at,
    )


def erased_text(blob: bytes) -> str:
    """Text for a file in which all bytes are equal, "" for any other."""
    if len(blob) < _FEWEST or blob.strip(blob[:1]):
        return ""
    return (
        f"{len(blob)} bytes, all of them {blob[0]:02x}: the copy failed, or the memory was "
        "erased. Copy the log again."
    )


def named_kind(blob: bytes, named: _Named) -> str:
    """Kind of a file by its first bytes, "" where they are not known."""
    return next((text for signature, text in named if signature.matches(blob[:HEAD])), "")


def likely_kind(blob: bytes) -> str:
    """One sentence on the probable kind of a file of unknown format."""
    if said := named_kind(blob, (*CERTAIN, *PERHAPS)):
        return said
    head = blob[:64]
    if all(32 <= b < 127 or b in b"\t\r\n" for b in head):
        line = head.splitlines()[0].decode("ascii")[:40] if head.strip() else ""
        return f"text that begins with '{line}', not with a column 'time'."
    return f"no known flight log (it begins with {blob[:4].hex(' ')})."


# -- reading ------------------------------------------------------------------------------------

_F = TypeVar("_F", bound=AnyFlight)


def read_flight(path: str | Path, *, rebuild_commands: bool | None = None) -> Flight:
    """Read a flight log or flight table, also one in a ZIP archive or compressed by gzip or bzip2.

    The format is recognised by content, not by name; bytes of another program before the head of a
    log are dropped and counted.

    Args:
        path: File in one of `formats.FORMATS`.
        rebuild_commands: Whether commands are rebuilt, as in `formats.ReadOptions`.

    Raises:
        LogError: The file cannot be used; the text states the reason and the remedy.
    """
    path = file_of_bag(Path(path))
    blob = _content(path)
    try:
        found, blob, findings = _located(blob)
    except LogError as error:
        alien = isinstance(error, NoLogError) and path.suffix.lower() not in OF_LOGS_ALONE
        raise (NoLogError if alien else LogError)(f"{path.name}: {error}") from None
    flight = found.load()(path, blob, ReadOptions(rebuild_commands))
    return _doubted(replace(flight, findings=(*findings, *flight.findings)), found)


def _located(blob: bytes) -> tuple[LogFormat, bytes, tuple[Finding, ...]]:
    """Format and content of the log in a file, and findings on its containers.

    Raises:
        LogError: The file contains no log.
    """
    inside = unpacked(blob)
    blob, findings = inside.blob, inside.findings
    if all_alike := erased_text(blob):
        raise LogError(all_alike)
    if named := named_kind(blob, CERTAIN):
        raise NoLogError(named)
    if (found := recognise(blob)) is not None:
        return found, blob, findings
    if (behind := find_embedded_log(blob)) is not None:
        at, found = behind
        return found, blob[at:], (*findings, leading_bytes_finding(blob, at))
    if damaged := damaged_signature(blob):
        raise LogError(f"{damaged}. Copy the log again. Known formats: {known_formats()}.")
    raise NoLogError(f"{likely_kind(blob)} Known formats: {known_formats()}.")


def open_flight(path: str | Path, *, rebuild_commands: bool | None = None) -> AnyFlight:
    """Read a flight as `read_flight` does, but leave a long flight table in Parquet in its file:
    memory use stays bounded.

    Args:
        path: Path of the file, as in `read_flight`.
        rebuild_commands: Whether commands are rebuilt, as in `read_flight`.

    Raises:
        LogError: As in `read_flight`.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
    except (OSError, ValueError):
        return read_flight(path, rebuild_commands=rebuild_commands)  # raises the error
    if Magic(b"PAR1").matches(head) and (found := recognise(head)) is not None:
        stored = open_parquet(path)
        if stored is not None:
            return _doubted(stored, found)
    return read_flight(path, rebuild_commands=rebuild_commands)


def _doubted(flight: _F, read_as: LogFormat) -> _F:
    """The flight with its format, time stamps of late rotor speeds corrected, and doubts about its
    values; rotor speeds with wrong motor numbers are omitted: the commands drive the twin."""
    said = set(flight.findings)
    layout = None if flight.airframe is None else flight.airframe.layout
    more = [f for f in doubts(flight.columns, layout) if f not in said]  # some noted by a writer
    facts = {"format": read_as.name, **flight.facts}
    changed = replace(flight, facts=facts, findings=(*flight.findings, *more))
    if not any(is_misnumbered(f) for f in more):
        return align_speed_stamps(changed)
    speeds = {c for c in changed.columns if c.startswith("rotor_")}
    if isinstance(changed, Flight):
        return replace(changed, table=changed.table.drop(columns=list(speeds)))
    return replace(changed, known=changed.known - speeds)


def file_of_bag(path: Path) -> Path:
    """The one file of a ROS 2 bag for the path of its folder; any other path unchanged.

    Raises:
        LogError: The bag has several files, or compressed ones.
    """
    if not (path / "metadata.yaml").is_file():
        return path
    files = sorted(f for f in path.iterdir() if f.suffix in (*BAG_SUFFIXES, ".zstd"))
    if len(files) != 1 or files[0].suffix == ".zstd":
        raise LogError(
            f"{path}: a ROS 2 bag of {len(files)} files, or of compressed ones. Make one MCAP of "
            f"it: ros2 bag convert."
        )
    return files[0]


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
