"""Safe unpacking of `.ssp` archives, by the rules for FMU archives."""

import zipfile
from pathlib import Path

from lxml import etree

from fmus.archive import MAX_DESCRIPTION_BYTES, archive_members, copy_members, member_problems
from twin.errors import FmuError


def unpack_ssp(path: Path, folder: Path) -> None:
    """Unpack into an empty folder; nothing is written before every member has been judged.

    Raises:
        FmuError: Unsafe or damaged.
    """
    members = archive_members(path, "SSP")
    if problems := member_problems(members):
        raise FmuError(f"{path.name}: refused: {'; '.join(problems[:5])}.")
    try:
        with zipfile.ZipFile(path) as archive:
            copy_members(archive, members, folder)
    except Exception as error:  # zipfile, zlib and lzma raise many kinds on damaged files
        raise FmuError(f"{path.name}: not a readable SSP archive: {error}.") from error


def parse_xml(path: Path, member: str, content: bytes) -> etree._Element:
    """Parse one XML member, without entities and network.

    Raises:
        FmuError: Not XML, with a DOCTYPE, or too large.
    """
    if len(content) > MAX_DESCRIPTION_BYTES:
        raise FmuError(
            f"{path.name}: {member} has {len(content)} bytes, more than {MAX_DESCRIPTION_BYTES}: "
            f"refused."
        )
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    try:
        root = etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        raise FmuError(f"{path.name}: {member} is not valid XML: {error}.") from error
    if root.getroottree().docinfo.doctype:
        raise FmuError(f"{path.name}: {member} has a DOCTYPE, which SSP does not need: refused.")
    return root
