"""Content and problems of an FMU of any origin; nothing is unpacked or loaded.

Shared libraries are checked by their headers only: processor, system, completeness. Sources: System
V ABI, ELF header; Microsoft, PE format; Apple, mach-o/loader.h and mach-o/fat.h.
"""

import io
import math
import re
import struct
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import fmpy
from fmpy.model_description import ModelDescription, ValidationError
from lxml import etree

from twin.errors import FmuError
from twin.representation import ShortRepr

from .archive import DESCRIPTION, Archive, open_archive, repeated_entries
from .experiments import VERSION, read_experiments, related_problems
from .names import shown

_ARCHITECTURES = (
    *("x86", "x86_64", "aarch32", "aarch64"),
    *("riscv32", "riscv64", "ppc32", "ppc64"),
)  # FMI 3, 2.5.1.4.2
_SYSTEMS = {"linux": ".so", "windows": ".dll", "darwin": ".dylib"}  # extension of a library
_PLATFORMS = {
    "linux32": ("linux", {"x86"}),
    "linux64": ("linux", {"x86_64"}),
    "win32": ("windows", {"x86"}),
    "win64": ("windows", {"x86_64"}),
    "darwin64": ("darwin", {"x86_64", "aarch64"}),  # FMI 2 has no other folder for a Mac
    **{f"{a}-{system}": (system, {a}) for a in _ARCHITECTURES for system in _SYSTEMS},
}
"""System and processors by folder below `binaries`; FMI 2, 2.1.1, and FMI 3, 2.5.1.4.2."""
_ELF_MACHINES = {3: "x86", 62: "x86_64", 40: "aarch32", 183: "aarch64", 20: "ppc32", 21: "ppc64"}
"""Processor by `e_machine`, elf.h."""
_ELF_RISCV = 243  # `e_machine` of both widths
_PE_MACHINES = {0x14C: "x86", 0x8664: "x86_64", 0x1C4: "aarch32", 0xAA64: "aarch64"}
"""Processor by `Machine`, PE format."""
_MACH_CPUS = {7: "x86", 0x01000007: "x86_64", 12: "aarch32", 0x0100000C: "aarch64"}
"""Processor by `cputype`, mach/machine.h."""
_MAX_SLICES, _MAX_COMMANDS = 16, 10_000  # limits of a Mac library; by judgement


@dataclass(frozen=True, slots=True)
class _Header:
    """Header of an executable file.

    Attributes:
        system: System, a key of `_SYSTEMS`.
        processors: Processors that can run it; several in a universal binary.
        shared: Whether it can be loaded as a library.
        end: Least size of the file, bytes.
    """

    system: str
    processors: frozenset[str]
    shared: bool
    end: int


def library_suffix(platform: str) -> str | None:
    """Extension of shared libraries in a folder below `binaries`; None: an unknown platform."""
    known = _PLATFORMS.get(platform)
    return None if known is None else _SYSTEMS[known[0]]


def library_problem(content: bytes, platform: str) -> str | None:
    """Reason why a file is no shared library for a known platform; None: it is one."""
    system, processors = _PLATFORMS[platform]
    try:
        header = _header(content)
    except (struct.error, OverflowError):  # an offset out of range
        return f"is cut: {len(content)} bytes end within its headers"
    if header is None:
        return "is no shared library: neither ELF, PE nor Mach-O"
    if header.system != system or not header.processors & processors:
        on = " and ".join(sorted(header.processors))
        return f"is for {on} on {header.system}, not for {platform}"
    if not header.shared:
        return "is a program or an object file, no shared library"
    if header.end > len(content):
        return f"is cut: {len(content)} bytes of {header.end}"
    return None


def _header(content: bytes) -> _Header | None:
    """Header of a file in any of the three formats; None: another format."""
    start = content[:4]
    if start == b"\x7fELF":
        return _elf(content)
    if start[:2] == b"MZ":
        return _pe(content)
    if start in (b"\xce\xfa\xed\xfe", b"\xcf\xfa\xed\xfe"):
        return _mach(content)
    if start == b"\xca\xfe\xba\xbe":
        return _universal(content)
    return None


def _elf(content: bytes) -> _Header | None:
    wide, order = content[4:5] == b"\2", ">" if content[5:6] == b"\2" else "<"
    kind, machine = struct.unpack_from(f"{order}HH", content, 16)
    programs, sections = struct.unpack_from(
        f"{order}{'QQ' if wide else 'II'}", content, 28 + 4 * wide
    )
    at = 54 if wide else 42
    program_size, n_programs, section_size, n_sections = struct.unpack_from(
        f"{order}HHHH", content, at
    )
    end = sections + section_size * n_sections
    for i in range(n_programs):
        at = programs + program_size * i
        if wide:
            _, _, offset, _, _, size = struct.unpack_from(f"{order}IIQQQQ", content, at)
        else:
            _, offset, _, _, size = struct.unpack_from(f"{order}IIIII", content, at)
        end = max(end, offset + size)
    name = _ELF_MACHINES.get(machine, f"ELF machine {machine}")
    if machine == _ELF_RISCV:
        name = "riscv64" if wide else "riscv32"
    return _Header("linux", frozenset({name}), kind == 3 and n_programs > 0, end)


def _pe(content: bytes) -> _Header | None:
    (at,) = struct.unpack_from("<I", content, 0x3C)
    magic, machine, n_sections, options, flags = struct.unpack_from("<4sHH12xHH", content, at)
    if magic != b"PE\0\0":
        return None
    end = at + 24 + options + 40 * n_sections
    for i in range(n_sections):
        size, offset = struct.unpack_from("<II", content, at + 24 + options + 40 * i + 16)
        end = max(end, offset + size)
    name = _PE_MACHINES.get(machine, f"PE machine {machine:#x}")
    return _Header("windows", frozenset({name}), bool(flags & 0x2000) and n_sections > 0, end)


def _mach(content: bytes) -> _Header | None:
    cpu, _, kind, n_commands = struct.unpack_from("<IIII", content, 4)
    if n_commands > _MAX_COMMANDS:
        return None
    at = 32 if content[0] == 0xCF else 28
    end = at
    for _ in range(n_commands):
        command, size = struct.unpack_from("<II", content, at)
        if command == 0x19:  # LC_SEGMENT_64
            offset, length = struct.unpack_from("<QQ", content, at + 40)
            end = max(end, offset + length)
        elif command == 0x1:  # LC_SEGMENT
            offset, length = struct.unpack_from("<II", content, at + 32)
            end = max(end, offset + length)
        at += max(size, 8)
    name = _MACH_CPUS.get(cpu, f"Mach-O processor {cpu:#x}")
    return _Header("darwin", frozenset({name}), kind in (6, 8), max(end, at))


def _universal(content: bytes) -> _Header | None:
    """Header of several Mach-O files in one; class files of Java begin with the same four bytes."""
    (count,) = struct.unpack_from(">I", content, 4)
    if not 0 < count <= _MAX_SLICES:
        return None
    processors: set[str] = set()
    shared, end = True, 0
    for i in range(count):
        offset, size = struct.unpack_from(">8xII", content, 8 + 20 * i)
        one = _mach(content[offset : offset + size])
        if one is None:
            return None
        processors |= one.processors
        shared &= one.shared
        end = max(end, offset + max(size, one.end))
    return _Header("darwin", frozenset(processors), shared, end)


MAX_FACT = 500
"""Largest number of characters of a fact from the FMU."""
MAX_PROBLEMS = 100
"""Largest number of problems listed for one FMU; beyond it, their number."""
_QUOTED = r"'(?:[A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]|\\['\"?\\abfnrtv])+'"
_PART = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{_QUOTED})(?:\[[0-9]+(?:,[0-9]+)*\])?"  # of a structured name
_PATH = rf"{_PART}(?:\.{_PART})*"  # parts separated by dots
_STRUCTURED = re.compile(rf"{_PATH}|der\({_PATH}(?:,[0-9]+)?\)")
"""Names of the convention "structured", FMI 2.2.9. FMPy needs a millisecond for each."""
_NUMBERS = {
    **dict.fromkeys(("Real", "Float64", "Float32"), ("start", "nominal")),
    "DefaultExperiment": ("startTime", "stopTime", "stepSize", "tolerance"),
}
"""Attributes that must be finite, by element; a bound may be infinite."""


@dataclass(frozen=True, slots=True)
class FmuReport(ShortRepr):
    """Result of `inspect_fmu`.

    Attributes:
        facts: Printable facts by name.
        problems: All problems found.
        platforms: Platforms with a folder of binaries.
    """

    facts: dict[str, str]
    problems: tuple[str, ...]
    platforms: tuple[str, ...]


def inspect_fmu(path: Path) -> FmuReport:
    """Inspect an FMU.

    Raises:
        FmuError: Not an FMU at all, or its description is unsafe to parse.
    """
    archive = open_archive(path)
    alone = io.BytesIO()  # only the description, so that no other member is read
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
        **_experiments(archive, {v.name for v in description.modelVariables}, problems),
        "saves its state": "yes" if _saves_state(description) else "no",
        "size": f"{path.stat().st_size} bytes, {unpacked} unpacked",
    }
    if len(problems) > MAX_PROBLEMS:
        problems[MAX_PROBLEMS:] = [f"and {len(problems) - MAX_PROBLEMS} more problems"]
    return FmuReport(facts, tuple(map(brief, problems)), tuple(platforms))


def brief(text: str) -> str:
    """A text as one line, truncated if long."""
    line = " ".join(text.split())
    return line if len(line) <= MAX_FACT else f"{line[:MAX_FACT]}..."


def _description(path: Path, alone: io.BytesIO) -> tuple[ModelDescription, list[str]]:
    """The description as read by FMPy, and the problems that FMPy reports."""
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
    """Names of variables that violate their naming convention."""
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
    """Start values and times that are not finite numbers."""
    for element in root.iter(*_NUMBERS):
        named = element if "name" in element.attrib else element.getparent()
        for attribute in _NUMBERS[element.tag]:
            text = element.get(attribute, "")
            if not all(map(_is_finite, text.split())):
                name = "" if named is None else named.get("name", element.tag)
                line = element.sourceline
                yield f"{shown(name)} (line {line}): {attribute} = {shown(text)} is not finite"


def _is_finite(text: str) -> bool:
    """Whether it is a finite number; the schema checks whether it is a number at all."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return True


def _member_problems(archive: Archive) -> Iterator[str]:
    """Members with damaged content, and libraries that do not fit their platform."""
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
    """Paths of the library for each kind of simulation on each platform in the FMU."""
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


def _experiments(archive: Archive, known: set[str], problems: list[str]) -> dict[str, str]:
    """Facts on the reference results of an FMU; their problems are appended.

    Args:
        archive: The FMU.
        known: Names of its variables.
        problems: Collects the problems.
    """
    try:
        problems += related_problems(archive)
        found = read_experiments(archive)
    except FmuError as error:
        problems.append(str(error))
        return {}
    for e in found:
        if unknown := sorted({*e.references, *e.stimuli} - known - {"time"}):
            problems.append(f"reference results: no variable {', '.join(map(shown, unknown))}")
    names = ", ".join(e.name for e in found)
    return {"reference results": f"{brief(names)} (FMI-LS-REF {VERSION})"} if found else {}


def _saves_state(description: ModelDescription) -> bool:
    part = description.coSimulation
    names = ("canGetAndSetFMUstate", "canGetAndSetFMUState")  # FMI 2, FMI 3
    return any(getattr(part, name, None) in (True, "true") for name in names)


__all__ = ["FmuReport", "brief", "inspect_fmu"]
