"""What an FMU holds and what is wrong with it, read from the archive without unpacking it.

Nothing is written to disk and no library is loaded, so hostile files can be looked at.
"""

import io
import math
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import fmpy
from fmpy.model_description import ModelDescription, ValidationError
from lxml import etree

from twin.errors import FmuError
from twin.representation import short_repr

from ..archive import DESCRIPTION, Archive, open_archive, repeated_entries
from ..names import shown
from .library_header import library_problem, library_suffix

MAX_FACT = 500
"""Characters of one that the FMU says of itself."""
MAX_PROBLEMS = 100
"""Listed of one FMU; of more, how many."""
_QUOTED = r"'(?:[A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]|\\['\"?\\abfnrtv])+'"
_PART = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{_QUOTED})(?:\[[0-9]+(?:,[0-9]+)*\])?"
_PATH = rf"{_PART}(?:\.{_PART})*"
_STRUCTURED = re.compile(rf"{_PATH}|der\({_PATH}(?:,[0-9]+)?\)")
"""Names of the convention "structured", FMI 2.2.9. FMPy takes a millisecond for each."""
_NUMBERS = {
    **dict.fromkeys(("Real", "Float64", "Float32"), ("start", "nominal")),
    "DefaultExperiment": ("startTime", "stopTime", "stepSize", "tolerance"),
}
"""Attributes that must be finite, by element; a bound may be infinite."""


@dataclass(frozen=True, slots=True)
class FmuReport:
    """What `inspect_fmu` found.

    Attributes:
        facts: Printable facts by name.
        problems: Everything wrong with it.
        platforms: It has a folder of binaries for each.
    """

    facts: dict[str, str]
    problems: tuple[str, ...]
    platforms: tuple[str, ...]

    __repr__ = short_repr


def inspect_fmu(path: Path) -> FmuReport:
    """Look into an FMU.

    Raises:
        FmuError: Not an FMU at all, or its description is unsafe to parse.
    """
    archive = open_archive(path)
    alone = io.BytesIO()  # the description alone, so that nothing else of the archive is read
    with zipfile.ZipFile(alone, "w") as copy:
        copy.writestr(DESCRIPTION, archive.description)
    description, wrong = _description(path, alone)
    problems = [*archive.problems, *wrong, *name_problems(description)]
    problems += [*_number_problems(archive.root), *repeated_entries(archive.members)]
    if not archive.problems:  # else its members are not read
        problems += _member_problems(archive)
    platforms = sorted(
        {n.split("/")[1] for n in archive.names if n.startswith("binaries/") and n.count("/") >= 2}
    )
    sources = any(n.startswith("sources/") for n in archive.names)
    if not platforms and not sources:
        problems.append("neither binaries nor sources: no tool can run it")
    unpacked = sum(m.file_size for m in archive.members)
    facts = {
        "format": f"FMU, FMI {description.fmiVersion}, {_kinds(description)}",
        "model": brief(f"{description.modelName}: {description.description or 'no description'}"),
        "made by": brief(description.generationTool or "unknown tool"),
        "platforms": brief(", ".join(platforms) or "none"),
        "sources": "inside" if sources else "not inside",
        **_variables(description),
        "saves its state": "yes" if _saves_state(description) else "no",
        "size": f"{path.stat().st_size} bytes, {unpacked} unpacked",
    }
    if len(problems) > MAX_PROBLEMS:
        problems[MAX_PROBLEMS:] = [f"and {len(problems) - MAX_PROBLEMS} more problems"]
    return FmuReport(facts, tuple(map(brief, problems)), tuple(platforms))


def brief(text: str) -> str:
    """One line, cut where it is long."""
    line = " ".join(text.split())
    return line if len(line) <= MAX_FACT else f"{line[:MAX_FACT]}..."


def _description(path: Path, alone: io.BytesIO) -> tuple[ModelDescription, list[str]]:
    """The description as FMPy reads it, and what FMPy finds wrong with it."""
    try:
        try:
            return fmpy.read_model_description(alone, validate_model_structure=True), []
        except ValidationError as error:
            problems = list(map(str, error.problems))
        except Exception as error:  # FMPy raises many kinds on a malformed description
            problems = [str(error)]
        return fmpy.read_model_description(alone, validate=False), problems
    except Exception as error:  # the same
        raise FmuError(f"{path.name}: {DESCRIPTION} cannot be understood: {error}.") from error


def name_problems(description: ModelDescription) -> Iterator[str]:
    """Names of variables that their convention does not allow."""
    structured = description.variableNamingConvention == "structured"
    for v in description.modelVariables:
        fits = _STRUCTURED.fullmatch(v.name) if structured else not re.search(r"[\r\n\t]", v.name)
        if not fits:
            convention = "structured" if structured else "flat"
            yield (
                f"{shown(v.name)} (line {v.sourceline}) is not a legal variable name for naming "
                f"convention {convention!r}"
            )


def _number_problems(root: etree._Element) -> Iterator[str]:
    """Start values and times that are no finite numbers."""
    for element in root.iter(*_NUMBERS):
        named = element if "name" in element.attrib else element.getparent()
        for attribute in _NUMBERS[element.tag]:
            text = element.get(attribute, "")
            if not all(map(_is_finite, text.split())):
                name = "" if named is None else named.get("name", element.tag)
                line = element.sourceline
                yield f"{shown(name)} (line {line}): {attribute} = {shown(text)} is not finite"


def _is_finite(text: str) -> bool:
    """Whether it is a finite number; whether it is one at all is for the schema to say."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return True


def _member_problems(archive: Archive) -> Iterator[str]:
    """Members whose content is damaged, and libraries that are none of their platform's."""
    wanted = set(_libraries(archive))
    with zipfile.ZipFile(archive.path) as opened:
        for member in archive.members:
            try:
                content = opened.read(member)
            except Exception as error:  # zipfile, zlib and lzma raise many kinds on damaged files
                yield f"{shown(member.filename)} is damaged: {error}"
                continue
            if member.filename in wanted:
                platform = member.filename.split("/")[1]
                if problem := library_problem(content, platform):
                    yield f"{member.filename} {problem}"
    for name in sorted(wanted - archive.names):
        yield f"{PurePosixPath(name).parent} holds no {PurePosixPath(name).name}"


def _libraries(archive: Archive) -> Iterator[str]:
    """Where a tool looks for the library of each kind of simulation on each platform inside."""
    kinds = ("CoSimulation", "ModelExchange", "ScheduledExecution")
    parts = {e.get("modelIdentifier", "") for kind in kinds for e in archive.root.findall(kind)}
    folders = {n.split("/")[1] for n in archive.names if n.startswith("binaries/")}
    for folder in folders:
        if (suffix := library_suffix(folder)) is not None:
            yield from (f"binaries/{folder}/{part}{suffix}" for part in parts)


def _kinds(description: ModelDescription) -> str:
    kinds = (
        ("co-simulation", description.coSimulation),
        ("model exchange", description.modelExchange),
    )
    return " and ".join(text for text, part in kinds if part is not None) or "no simulation kind"


def _variables(description: ModelDescription) -> dict[str, str]:
    variables = description.modelVariables
    described = sum(bool(v.description) for v in variables)
    real = [v for v in variables if v.type in ("Real", "Float64", "Float32")]
    count = {c: sum(v.causality == c for v in variables) for c in ("parameter", "input", "output")}
    return {
        "variables": ", ".join(f"{n} {c}s" for c, n in count.items()),
        "documented": f"{described} of {len(variables)} described, "
        f"{sum(bool(v.unit) for v in real)} of {len(real)} real numbers with unit",
    }


def _saves_state(description: ModelDescription) -> bool:
    part = description.coSimulation
    names = ("canGetAndSetFMUstate", "canGetAndSetFMUState")  # FMI 2, FMI 3
    return any(getattr(part, name, None) in (True, "true") for name in names)
