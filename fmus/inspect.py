"""What an FMU holds and what is wrong with it, read from the archive without unpacking it.

Nothing is written to disk and no library is loaded, so hostile files can be looked at.
"""

import io
import stat
import zipfile
from dataclasses import dataclass
from pathlib import Path

import fmpy
from fmpy.validation import validate_fmu
from lxml import etree

from twin.errors import FmuError

MAX_DESCRIPTION_BYTES = 32 * 2**20
MAX_UNPACKED_BYTES = 2**30
_NAME = "modelDescription.xml"


@dataclass(frozen=True, slots=True)
class FmuReport:
    """What `inspect_fmu` found.

    Attributes:
        facts: Printable facts by name.
        problems: Everything wrong with it.
    """

    facts: dict[str, str]
    problems: tuple[str, ...]


def inspect_fmu(path: Path) -> FmuReport:
    """Look into an FMU.

    Raises:
        FmuError: Not an FMU at all, or its description is unsafe to parse.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            problems = _archive_problems(members)
            xml = _description(path, archive)
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError, EOFError) as error:
        raise FmuError(f"{path.name}: not a readable FMU archive: {error}.") from error
    alone = io.BytesIO()  # the description alone, so that nothing else of the archive is read
    with zipfile.ZipFile(alone, "w") as copy:
        copy.writestr(_NAME, xml)
    problems += [str(p) for p in validate_fmu(alone)]
    try:
        description = fmpy.read_model_description(alone, validate=False)
    except Exception as error:  # FMPy raises many kinds on a malformed description
        raise FmuError(f"{path.name}: {_NAME} cannot be understood: {error}.") from error
    names = {m.filename for m in members}
    platforms = sorted(
        {n.split("/")[1] for n in names if n.startswith("binaries/") and n.count("/") >= 2}
    )
    if not platforms and not any(n.startswith("sources/") for n in names):
        problems.append("neither binaries nor sources: no tool can run it")
    variables = description.modelVariables
    described = sum(bool(v.description) for v in variables)
    real = [v for v in variables if v.type in ("Real", "Float64", "Float32")]
    count = {c: sum(v.causality == c for v in variables) for c in ("parameter", "input", "output")}
    kinds = [
        text
        for text, part in (
            ("co-simulation", description.coSimulation),
            ("model exchange", description.modelExchange),
        )
        if part is not None
    ]
    facts = {
        "format": f"FMU, FMI {description.fmiVersion}, {' and '.join(kinds) or 'no simulation kind'}",
        "model": f"{description.modelName}: {description.description or 'no description'}",
        "made by": description.generationTool or "unknown tool",
        "platforms": ", ".join(platforms) or "none",
        "sources": "inside" if any(n.startswith("sources/") for n in names) else "not inside",
        "variables": ", ".join(f"{n} {c}s" for c, n in count.items()),
        "documented": f"{described} of {len(variables)} described, "
        f"{sum(bool(v.unit) for v in real)} of {len(real)} real numbers with unit",
        "saves its state": _saves_state(description),
        "size": f"{path.stat().st_size} bytes, {sum(m.file_size for m in members)} unpacked",
    }
    return FmuReport(facts, tuple(problems))


def _saves_state(description: object) -> str:
    part = getattr(description, "coSimulation", None)
    flag = getattr(part, "canGetAndSetFMUstate", None) or getattr(
        part, "canGetAndSetFMUState", None
    )
    return "yes" if flag in (True, "true") else "no"


def _archive_problems(members: list[zipfile.ZipInfo]) -> list[str]:
    problems = []
    seen: set[str] = set()
    for m in members:
        name = m.orig_filename
        parts = name.replace("\\", "/").split("/")
        if "\\" in name or ".." in parts or name.startswith("/") or ":" in name:
            problems.append(f"unsafe path in the archive: {name!r}")
        if name in seen:
            problems.append(f"the archive holds {name!r} twice")
        seen.add(name)
        if stat.S_ISLNK(m.external_attr >> 16):
            problems.append(f"{name!r} is a link")
    unpacked = sum(m.file_size for m in members)
    if unpacked > MAX_UNPACKED_BYTES:
        problems.append(f"unpacks to {unpacked} bytes, more than {MAX_UNPACKED_BYTES}")
    return problems


def _description(path: Path, archive: zipfile.ZipFile) -> bytes:
    try:
        with archive.open(_NAME) as file:
            xml = file.read(MAX_DESCRIPTION_BYTES + 1)
    except KeyError:
        raise FmuError(f"{path.name}: a zip archive without {_NAME}: not an FMU.") from None
    if len(xml) > MAX_DESCRIPTION_BYTES:
        raise FmuError(
            f"{path.name}: {_NAME} is larger than {MAX_DESCRIPTION_BYTES} bytes: refused."
        )
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    try:
        tree = etree.ElementTree(etree.fromstring(xml, parser))
    except etree.XMLSyntaxError as error:
        raise FmuError(f"{path.name}: {_NAME} is not valid XML: {error}.") from error
    if tree.docinfo.doctype:
        raise FmuError(f"{path.name}: {_NAME} has a DOCTYPE, which FMI does not allow: refused.")
    return xml
