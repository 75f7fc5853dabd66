"""What an FMU holds and what is wrong with it, read from the archive without unpacking it.

Nothing is written to disk and no library is loaded, so hostile files can be looked at.
"""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import fmpy
from fmpy.model_description import ModelDescription
from fmpy.validation import validate_fmu

from twin.errors import FmuError
from twin.representation import short_repr

from .archive import DESCRIPTION, open_archive


@dataclass(frozen=True, slots=True)
class FmuReport:
    """What `inspect_fmu` found.

    Attributes:
        facts: Printable facts by name.
        problems: Everything wrong with it.
    """

    facts: dict[str, str]
    problems: tuple[str, ...]

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
    problems = [*archive.problems, *map(str, validate_fmu(alone))]
    try:
        description = fmpy.read_model_description(alone, validate=False)
    except Exception as error:  # FMPy raises many kinds on a malformed description
        raise FmuError(f"{path.name}: {DESCRIPTION} cannot be understood: {error}.") from error
    platforms = sorted(
        {n.split("/")[1] for n in archive.names if n.startswith("binaries/") and n.count("/") >= 2}
    )
    sources = any(n.startswith("sources/") for n in archive.names)
    if not platforms and not sources:
        problems.append("neither binaries nor sources: no tool can run it")
    unpacked = sum(m.file_size for m in archive.members)
    facts = {
        "format": f"FMU, FMI {description.fmiVersion}, {_kinds(description)}",
        "model": f"{description.modelName}: {description.description or 'no description'}",
        "made by": description.generationTool or "unknown tool",
        "platforms": ", ".join(platforms) or "none",
        "sources": "inside" if sources else "not inside",
        **_variables(description),
        "saves its state": "yes" if _saves_state(description) else "no",
        "size": f"{path.stat().st_size} bytes, {unpacked} unpacked",
    }
    return FmuReport(facts, tuple(problems))


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
