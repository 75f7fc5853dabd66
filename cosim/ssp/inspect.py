"""Content and problems of an `.ssp` of any origin; no library in it is loaded."""

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import fmpy
from lxml import etree

from fmus.archive import (
    DESCRIPTION,
    MAX_DESCRIPTION_BYTES,
    MAX_MEMBERS,
    MAX_UNPACKED_BYTES,
    archive_members,
    repeated_entries,
)
from fmus.inspect import FmuReport, brief, inspect_fmu
from fmus.names import shown
from fmus.platforms import PLATFORMS
from twin.errors import FmuError
from twin.representation import ShortRepr

from ..system import System
from .read import read_structure, read_unpacked, tag, unpack_ssp

MAX_LISTED = 100
"""Largest number of listed components, pairs of components, and problems; beyond it, their
number."""
_PLATFORM_OF = {folder: p.name for p in PLATFORMS.values() for folder in p.folders.values()}
"""Platform by folder: both FMI versions may be in one system, with different folder names."""


@dataclass(frozen=True, slots=True)
class SspReport(ShortRepr):
    """Result of `inspect_ssp`.

    Attributes:
        facts: Printable facts by name.
        problems: All problems found.
        notes: Facts that may be intended.
        platforms: Platforms on which every FMU inside runs.
        runs_here: Whether the platform of this machine is among them.
    """

    facts: dict[str, str]
    problems: tuple[str, ...]
    notes: tuple[str, ...]
    platforms: tuple[str, ...]
    runs_here: bool


def inspect_ssp(path: Path) -> SspReport:
    """Inspect an SSP: its structure, and the description and libraries of every FMU.

    Its files are unpacked to a temporary folder, never more than `MAX_UNPACKED_BYTES`; the FMUs are
    read there, never more than that of all of them together.

    Raises:
        FmuError: Unsafe, damaged, or no SSP.
    """
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as name:
        folder = Path(name)
        unpack_ssp(path, folder)
        root = read_structure(path, folder)
        files = sorted(p for p in folder.rglob("*.fmu") if p.is_file())
        if too_much := _too_much(files):
            return _report(path, root, {}, (too_much,), None)
        fmus = {str(p.relative_to(folder)): _looked_at(p) for p in files}
        problems = repeated_entries(archive_members(path, "SSP"))
        problems += [
            f"{shown(member)}: {problem}"
            for member, found in fmus.items()
            for problem in ([found] if isinstance(found, str) else found.problems)
        ]
        system = None
        try:
            system = read_unpacked(path, folder, root)
        except FmuError as error:
            problems.append(str(error).removeprefix(f"{path.name}: "))
        sound = {m: found for m, found in fmus.items() if not isinstance(found, str)}
        return _report(path, root, sound, problems, system)


def _too_much(files: Iterable[Path]) -> str | None:
    """Reason why archives within an archive are not inspected; None: they are."""
    members = unpacked = described = 0
    for file in files:
        try:
            listed = archive_members(file)
        except FmuError:
            continue  # reported where the FMU is inspected
        members += len(listed)
        unpacked += sum(m.file_size for m in listed)
        described += sum(m.file_size for m in listed if m.filename == DESCRIPTION)
        for found, most, unit in (
            (members, MAX_MEMBERS, "members"),
            (unpacked, MAX_UNPACKED_BYTES, "bytes unpacked"),
            (described, MAX_DESCRIPTION_BYTES, f"bytes of {DESCRIPTION}"),
        ):
            if found > most:
                return f"its FMUs have more than {most} {unit} in all: they are not looked at"
    return None


def _looked_at(file: Path) -> FmuReport | str:
    """Report on an FMU, or the reason why it is none."""
    try:
        return inspect_fmu(file)
    except FmuError as error:
        return str(error).removeprefix(f"{file.name}: ")


def _report(
    path: Path,
    root: etree._Element,
    fmus: Mapping[str, FmuReport],
    problems: Iterable[str],
    system: System | None,
) -> SspReport:
    top = root.find(tag("ssd:System"))
    components = [] if top is None else top.findall(f"{tag('ssd:Elements')}/{{*}}*")
    links = [] if top is None else top.findall(f"{tag('ssd:Connections')}/{tag('ssd:Connection')}")
    ends = [_ends(link) for link in links]
    by_platform = [{_PLATFORM_OF.get(p, p) for p in found.platforms} for found in fmus.values()]
    common = set.intersection(*by_platform) if by_platform else set()
    name = root.get("name") or (top.get("name") if top is not None else None) or "without a name"
    facts = {
        "format": f"SSP {root.get('version', '')}, a system of FMUs",
        "system": name,
        "made by": root.get("generationTool", "unknown tool"),
        "components": str(len(components)),
        **_listed({f"component {c.get('name')}": _component(c, fmus) for c in components}),
        "connections": str(len(ends)),
        **_listed(_by_pair(ends)),
        **({} if system is None else _times(system)),
        "platforms": ", ".join(sorted(common)) or "none in common",
        "size": f"{path.stat().st_size} bytes",
    }
    used = {c.get("source", "") for c in components}
    spare = [m for m in fmus if m not in used] if system is not None else []
    wrong = [brief(p) for p in problems]
    if len(wrong) > MAX_LISTED:
        wrong[MAX_LISTED:] = [f"and {len(wrong) - MAX_LISTED} more problems"]
    return SspReport(
        {brief(k): brief(v) for k, v in facts.items()},
        tuple(wrong),
        tuple(
            brief(f"{shown(member)}: no component is made of it") for member in spare[:MAX_LISTED]
        ),
        tuple(sorted(common)),
        bool(common & {_PLATFORM_OF.get(p, p) for p in (fmpy.platform, fmpy.platform_tuple)}),
    )


def _component(element: etree._Element, fmus: Mapping[str, FmuReport]) -> str:
    """Text on a component: its FMU, and the description of that."""
    source = str(element.get("source", "no source"))
    if (found := fmus.get(source)) is None:
        return source
    facts = found.facts
    return f"{source}: {facts['format']}; {facts['platforms']}; {facts['variables']}"


def _ends(link: etree._Element) -> tuple[str, str, str]:
    """Source component, target component, and the connected variables."""
    source, target = link.get("startConnector", ""), link.get("endConnector", "")
    what = source if source == target else f"{source} as {target}"
    return link.get("startElement", "(system)"), link.get("endElement", "(system)"), what


def _by_pair(ends: Iterable[tuple[str, str, str]]) -> dict[str, str]:
    """Names of the connected variables by pair of components."""
    pairs: dict[str, list[str]] = {}
    for start, end, what in ends:
        pairs.setdefault(f"{start} -> {end}", []).append(what)
    return {pair: f"{len(names)}: {', '.join(names)}" for pair, names in pairs.items()}


def _listed(facts: dict[str, str]) -> dict[str, str]:
    """The first of many facts."""
    if len(facts) <= MAX_LISTED:
        return facts
    return dict(list(facts.items())[:MAX_LISTED]) | {"and more": str(len(facts) - MAX_LISTED)}


def _times(system: System) -> dict[str, str]:
    """Simulation times and steps in the file."""
    stop = "without end" if system.stop_time_s is None else f"to {system.stop_time_s:g} s"
    step = "no base step" if system.step_s is None else f"base step {system.step_s:g} s"
    slow = "".join(f", {name} every {n} steps" for name, n in list(system.periods.items())[:9])
    return {
        "start values": str(len(system.starts)),
        "times": f"from {system.start_time_s:g} s {stop}, {step}{slow}",
    }
