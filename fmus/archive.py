"""FMU archives of any origin: looked at before they are unpacked, refused when unsafe.

Nothing is written outside the folder given, nothing is written before every member has been
judged, and never more than `MAX_UNPACKED_BYTES`.
"""

import re
import stat
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from lxml import etree

from twin.errors import FmuError
from twin.representation import short_repr

MAX_UNPACKED_BYTES = 512 * 2**20
MAX_MEMBERS = 20_000
MAX_DESCRIPTION_BYTES = 32 * 2**20
DESCRIPTION = "modelDescription.xml"
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_CHUNK = 2**20


@dataclass(frozen=True, slots=True)
class Archive:
    """An FMU archive whose members have been judged.

    Attributes:
        members: Members as listed in the archive.
        problems: Why it must not be unpacked; empty when it may be.
        description: Content of `modelDescription.xml`, safe to parse.
        root: The parsed description.
    """

    path: Path
    members: tuple[zipfile.ZipInfo, ...]
    problems: tuple[str, ...]
    description: bytes
    root: etree._Element

    __repr__ = short_repr

    @property
    def names(self) -> frozenset[str]:
        """Names of all members."""
        return frozenset(m.filename for m in self.members)


def open_archive(path: Path) -> Archive:
    """Judge an archive without unpacking it.

    Raises:
        FmuError: Not an FMU at all, or its description is unsafe to parse.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = tuple(archive.infolist())
            description = _read_description(path, archive)
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError, EOFError) as error:
        raise FmuError(f"{path.name}: not a readable FMU archive: {error}.") from error
    except ValueError as error:  # zipfile on damaged headers
        raise FmuError(f"{path.name}: not a readable FMU archive: {error}.") from error
    root = _parse(path, description)
    problems = [*member_problems(members), *_identifier_problems(root)]
    return Archive(path, members, tuple(problems), description, root)


def unpack(path: Path, folder: Path) -> None:
    """Unpack an FMU into an empty folder.

    Raises:
        FmuError: The archive is unsafe or damaged; the text lists why.
    """
    archive = open_archive(path)
    if archive.problems:
        shown = "; ".join(archive.problems[:5])
        raise FmuError(f"{path.name}: refused: {shown}.")
    try:
        with zipfile.ZipFile(path) as source:
            copy_members(source, archive.members, folder)
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError, EOFError) as error:
        raise FmuError(f"{path.name}: cannot be unpacked: {error}.") from error
    except Exception as error:  # zlib.error, lzma.LZMAError: damaged streams
        raise FmuError(f"{path.name}: cannot be unpacked: {error}.") from error


def copy_members(source: zipfile.ZipFile, members: Iterable[zipfile.ZipInfo], folder: Path) -> None:
    """Write members that have been judged, never more than `MAX_UNPACKED_BYTES` in all."""
    left = MAX_UNPACKED_BYTES
    for member in members:
        target = folder / member.filename
        if member.is_dir():
            target.mkdir(parents=True, exist_ok=True)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        left -= _copy_member(source, member, target, left)


def _copy_member(source: zipfile.ZipFile, member: zipfile.ZipInfo, target: Path, limit: int) -> int:
    """Write one member, counting what really comes out of the stream."""
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
    if len(xml) > MAX_DESCRIPTION_BYTES:
        raise FmuError(
            f"{path.name}: {DESCRIPTION} is larger than {MAX_DESCRIPTION_BYTES} bytes: refused."
        )
    return xml


def _parse(path: Path, xml: bytes) -> etree._Element:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    try:
        root = etree.fromstring(xml, parser)
    except etree.XMLSyntaxError as error:
        raise FmuError(f"{path.name}: {DESCRIPTION} is not valid XML: {error}.") from error
    if root.getroottree().docinfo.doctype:
        raise FmuError(
            f"{path.name}: {DESCRIPTION} has a DOCTYPE, which FMI does not allow: refused."
        )
    return root


def member_problems(members: tuple[zipfile.ZipInfo, ...]) -> list[str]:
    """Why members of an archive must not be unpacked, one sentence each; none: all may be."""
    if len(members) > MAX_MEMBERS:
        return [f"the archive has {len(members)} members, more than {MAX_MEMBERS}"]
    problems = []
    seen: set[str] = set()
    for member in members:
        name = member.orig_filename
        if is_unsafe(name):
            problems.append(f"unsafe path in the archive: {name!r}")
        key = name.rstrip("/").casefold()
        if key in seen:
            problems.append(f"the archive holds {name!r} twice")
        seen.add(key)
        kind = stat.S_IFMT(member.external_attr >> 16)
        if kind == stat.S_IFLNK:
            problems.append(f"{name!r} is a link")
        elif kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            problems.append(f"{name!r} is no plain file")
        if member.flag_bits & 0x1:
            problems.append(f"{name!r} is encrypted")
    files = {m.filename.casefold() for m in members if not m.is_dir()}
    for name in files:
        for parent in PurePosixPath(name).parents:
            if str(parent) in files:
                problems.append(f"{str(parent)!r} is both a file and a folder")
    unpacked = sum(m.file_size for m in members)
    if unpacked > MAX_UNPACKED_BYTES:
        problems.append(f"unpacks to {unpacked} bytes, more than {MAX_UNPACKED_BYTES}")
    return problems


def is_unsafe(name: str) -> bool:
    """Whether a member of this name could land outside the folder, or not land everywhere."""
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
            if not _IDENTIFIER.fullmatch(identifier) or len(identifier) > 200:
                problems.append(f"modelIdentifier {identifier[:80]!r} is no C identifier")
    return problems
