"""A vehicle file with effects added: the text of the original, its comments and its order kept."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import cast

import tomlkit
from tomlkit import TOMLDocument
from tomlkit.items import InlineTable, Table

from ...effects import EFFECTS
from .. import Deviation, Vehicle
from .deviations import written_sd
from .effects import spelled


@dataclass(frozen=True, slots=True)
class Written:
    """A number for a vehicle file.

    Attributes:
        value: In the unit of the effect.
        source: Where it comes from.
        deviation: Standard deviation; None: none is written.
    """

    value: float
    source: str
    deviation: Deviation | None = None


def with_effect_sections(
    text: str, vehicle: Vehicle, effects: Mapping[str, Mapping[str, Written]]
) -> str:
    """Text of a vehicle file with `[effects.NAME]` sections added, or replaced.

    Args:
        text: Of the original file.
        vehicle: Which it describes.
        effects: Numbers by effect and name.
    """
    document = tomlkit.parse(text)
    sections = _sections(document)
    for name, numbers in effects.items():
        sections[name] = _section(name, vehicle, numbers)
    return document.as_string()


def without_effect_sections(text: str, names: Iterable[str]) -> str:
    """Text of a vehicle file without these effects; it has them."""
    document = tomlkit.parse(text)
    sections = cast(Table, document["effects"])
    for name in names:
        sections.remove(name)
    if not sections:
        document.remove("effects")
    return document.as_string()


def _sections(document: TOMLDocument) -> Table:
    """The table of all effects, as sections of their own behind everything else if it is not."""
    if re.search(r"^\s*\[\s*effects\b", document.as_string(), re.MULTILINE):
        return cast(Table, document["effects"])
    old = document.pop("effects", {})
    if not document.as_string().endswith("\n"):
        document.add(tomlkit.nl())
    sections = tomlkit.table(is_super_table=True)
    for name, numbers in old.items():
        section = tomlkit.table()
        section.update(numbers)
        sections[name] = section
    document.add("effects", sections)
    return sections


def _section(effect: str, vehicle: Vehicle, numbers: Mapping[str, Written]) -> Table:
    units = {n: p.unit for p in EFFECTS[effect].parameters for n in p.names(vehicle)}
    section = tomlkit.table()
    section.comment(EFFECTS[effect].meaning)
    for name, number in numbers.items():
        section[name] = _entry(number, spelled(units[name]))
    return section


def _entry(number: Written, unit: str) -> InlineTable:
    entry = tomlkit.inline_table()
    entry.update({"value": number.value, "unit": unit})
    if number.deviation is not None:
        entry["sd"] = written_sd(number.deviation)
    entry["source"] = number.source
    return entry
