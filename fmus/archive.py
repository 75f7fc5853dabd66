"""FMU archives of any origin: checked before they are unpacked, refused when unsafe.

Nothing is written outside the given folder, nothing is written before every member has been
checked, and never more than `MAX_UNPACKED_BYTES`.
"""

import re
import stat
import struct
import zipfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from lxml import etree

from twin.errors import FmuError
from twin.representation import ShortRepr

from .names import IDENTIFIER

MAX_UNPACKED_BYTES = 512 * 2**20
"""Largest archive after unpacking. Made up."""
MAX_MEMBERS = 20_000
"""Largest number of members of an archive. Made up."""
MAX_DESCRIPTION_BYTES = 32 * 2**20
"""Largest modelDescription.xml. Made up."""
MAX_DIRECTORY_BYTES = 8 * 2**20
"""Largest central directory: 400 bytes for each of `MAX_MEMBERS`."""
DESCRIPTION = "modelDescription.xml"  # member of every FMU, FMI 2.2 and 2.4
_CHUNK = 2**20  # bytes read at once
_END_BYTES = 2**16 + 22 + 20 + 56
"""Bytes at the end of an archive with a comment, the end record of its directory, and the zip64
records."""
_UNREADABLE = (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError, EOFError)
"""Exceptions of `zipfile` for a damaged archive or another file."""


@dataclass(frozen=True, slots=True)
class Archive(ShortRepr):
    """An FMU archive whose members have been checked.

    Attributes:
        members: Members as listed in the archive.
        problems: Reasons why it must not be unpacked; empty when it may be.
        description: Content of `modelDescription.xml`, safe to parse.
        root: The parsed description.
    """

    path: Path
    members: tuple[zipfile.ZipInfo, ...]
    problems: tuple[str, ...]
    description: bytes
    root: etree._Element

    @property
    def names(self) -> frozenset[str]:
        """Names of all members."""
        return frozenset(m.filename for m in self.members)


def open_archive(path: Path) -> Archive:
    """Check an archive without unpacking it.

    Raises:
        FmuError: Not an FMU at all, or its description is unsafe to parse.
    """
    members = archive_members(path)
    try:
        with zipfile.ZipFile(path) as archive:
            description = _read_description(path, archive)
    except (*_UNREADABLE, ValueError) as error:
        raise FmuError(f"{path.name}: not a readable FMU archive: {error}.") from error
    root = parse_xml(path, DESCRIPTION, description)
    problems = [*member_problems(members), *_identifier_problems(root)]
    return Archive(path, members, tuple(problems), description, root)


def archive_members(path: Path, kind: str = "FMU") -> tuple[zipfile.ZipInfo, ...]:
    """Unchecked members in the directory of a zip archive; `kind` is for messages.

    Raises:
        FmuError: The file is no zip archive, or its directory is too long to be read.
    """
    try:
        if (size := _directory_bytes(path)) > MAX_DIRECTORY_BYTES:
            raise FmuError(
                f"{path.name}: its list of members has {size} bytes, more than "
                f"{MAX_DIRECTORY_BYTES}: refused."
            )
        with zipfile.ZipFile(path) as archive:
            return tuple(archive.infolist())
    except (*_UNREADABLE, ValueError) as error:  # ValueError: from zipfile, on damaged headers
        raise FmuError(f"{path.name}: not a readable {kind} archive: {error}.") from error


def _directory_bytes(path: Path) -> int:
    """Size of the central directory according to the end record of an archive; 0 without one.

    Source: PKWARE APPNOTE 6.3.10, 4.3.14 to 4.3.16. `zipfile` creates an object for each entry
    before their number can be queried.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(size - _END_BYTES, 0))
        tail = file.read()
    found = 0
    for mark, at, code in ((b"PK\5\6", 12, "<I"), (b"PK\6\6", 40, "<Q")):
        for place in re.finditer(re.escape(mark), tail):
            field = tail[place.start() + at :][: struct.calcsize(code)]
            if len(field) == struct.calcsize(code):
                found = max(found, min(struct.unpack(code, field)[0], size))
    return found


def unpack(path: Path, folder: Path) -> None:
    """Unpack an FMU into an empty folder.

    Raises:
        FmuError: The archive is unsafe or damaged; the text lists the reasons.
    """
    archive = open_archive(path)
    if archive.problems:
        shown = "; ".join(archive.problems[:5])
        raise FmuError(f"{path.name}: refused: {shown}.")
    try:
        with zipfile.ZipFile(path) as source:
            copy_members(source, archive.members, folder)
    except Exception as error:  # also zlib.error, lzma.LZMAError: damaged streams
        raise FmuError(f"{path.name}: cannot be unpacked: {error}.") from error


def copy_members(source: zipfile.ZipFile, members: Iterable[zipfile.ZipInfo], folder: Path) -> None:
    """Write checked members, never more than `MAX_UNPACKED_BYTES` in total."""
    left = MAX_UNPACKED_BYTES
    for member in members:
        target = folder / member.filename
        if member.is_dir():
            target.mkdir(parents=True, exist_ok=True)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        left -= _copy_member(source, member, target, left)


def _copy_member(source: zipfile.ZipFile, member: zipfile.ZipInfo, target: Path, limit: int) -> int:
    """Write one member, counting the actual bytes of the stream."""
    written = 0
    with source.open(member) as stream, target.open("wb") as file:
        while chunk := stream.read(_CHUNK):
            written += len(chunk)
            if written > limit or written > member.file_size:
                raise zipfile.BadZipFile(f"{member.filename!r} is larger than it says")
            file.write(chunk)
    return written


def _read_description(path: Path, archive: zipfile.ZipFile) -> bytes:
    try:
        with archive.open(DESCRIPTION) as file:
            xml = file.read(MAX_DESCRIPTION_BYTES + 1)
    except KeyError:
        raise FmuError(f"{path.name}: a zip archive without {DESCRIPTION}: not an FMU.") from None
    except FmuError:
        raise
    except Exception as error:  # zlib.error and kin: damaged streams
        raise FmuError(f"{path.name}: {DESCRIPTION} cannot be read: {error}.") from error
    return xml


def parse_xml(path: Path, member: str, content: bytes) -> etree._Element:
    """Parse one XML member of an archive, without entities and network.

    Raises:
        FmuError: Not XML, with a DOCTYPE, or too large.
    """
    if len(content) > MAX_DESCRIPTION_BYTES:
        raise FmuError(
            f"{path.name}: {member} is larger than {MAX_DESCRIPTION_BYTES} bytes: refused."
        )
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    try:
        root = etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        raise FmuError(f"{path.name}: {member} is not valid XML: {error}.") from error
    if root.getroottree().docinfo.doctype:
        raise FmuError(
            f"{path.name}: {member} has a DOCTYPE, which FMI and SSP do not need: refused."
        )
    return root


def member_problems(members: tuple[zipfile.ZipInfo, ...]) -> list[str]:
    """Reasons why members of an archive must not be unpacked, one sentence each; none: all may
    be."""
    if len(members) > MAX_MEMBERS:
        return [f"the archive has {len(members)} members, more than {MAX_MEMBERS}"]
    problems = []
    seen: dict[str, tuple[str, int, int]] = {}
    for member in members:
        name = member.orig_filename
        if is_unsafe(name):
            problems.append(f"unsafe path in the archive: {name!r}")
        if seen.setdefault(name.rstrip("/").casefold(), _content(member)) != _content(member):
            problems.append(f"the archive holds {name!r} twice, with different content")
        kind = stat.S_IFMT(member.external_attr >> 16)
        if kind == stat.S_IFLNK:
            problems.append(f"{name!r} is a link")
        elif kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            problems.append(f"{name!r} is no plain file")
        if member.flag_bits & 0x1:
            problems.append(f"{name!r} is encrypted")
    files = {m.filename.casefold() for m in members if not m.filename.endswith("/")}
    for name in files:
        for parent in PurePosixPath(name).parents:
            if str(parent) in files:
                problems.append(f"{str(parent)!r} is both a file and a folder")
    unpacked = sum(m.file_size for m in members)
    if unpacked > MAX_UNPACKED_BYTES:
        problems.append(f"unpacks to {unpacked} bytes, more than {MAX_UNPACKED_BYTES}")
    return problems


def repeated_entries(members: Iterable[zipfile.ZipInfo]) -> list[str]:
    """Duplicate entries of an archive with equal content; one sentence each.

    They are harmless, but unintended. Entries of one name with different content are among the
    `member_problems`.
    """
    counts = Counter(map(_content, members))
    return [
        f"the archive holds {name!r} {count} times, the same each time"
        for (name, _, _), count in counts.items()
        if count > 1
    ]


def _content(member: zipfile.ZipInfo) -> tuple[str, int, int]:
    """Name, size and checksum of a member."""
    return member.orig_filename, member.file_size, member.CRC


def is_unsafe(name: str) -> bool:
    """Whether a member of this name could be written outside the folder, or is invalid on some
    platform."""
    parts = name.replace("\\", "/").split("/")
    return (
        "\\" in name
        or ":" in name
        or name.startswith("/")
        or not name
        or len(name) > 512
        or any(p in ("..", ".") for p in parts)
        or "" in parts[:-1]
        or any(ord(c) < 32 for c in name)
    )


def _identifier_problems(root: etree._Element) -> list[str]:
    problems = []
    for tag in ("CoSimulation", "ModelExchange", "ScheduledExecution"):
        for element in root.findall(tag):
            identifier = element.get("modelIdentifier", "")
            if not IDENTIFIER.fullmatch(identifier) or len(identifier) > 200:
                problems.append(f"modelIdentifier {identifier[:80]!r} is no C identifier")
    return problems
