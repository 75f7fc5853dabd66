"""The `[effects.NAME]` sections of a vehicle file: effects that are switched on, with numbers."""

import re
from dataclasses import dataclass, field
from typing import Any

from ...component import unknown_name
from ...effects import EFFECTS
from ...errors import ModelError
from .. import Deviation, Vehicle
from .entries import read_number


@dataclass(slots=True)
class SwitchedOn:
    """Effects of a vehicle file.

    Attributes:
        values: Every number of each effect in SI units; those the file leaves out at their start.
        sources: Pedigree by "effects.NAME.PARAMETER".
        deviations: Standard deviations by the same, where given.
        mistakes: What is wrong, a line each.
    """

    values: dict[str, dict[str, float]] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    deviations: dict[str, Deviation] = field(default_factory=dict)
    mistakes: list[str] = field(default_factory=list)


def read_effects(sections: Any, vehicle: Vehicle) -> SwitchedOn:
    """Read the sections, given as parsed TOML; the vehicle is what they belong to."""
    on = SwitchedOn()
    if not isinstance(sections, dict):
        on.mistakes.append("[effects] must hold one table per effect, [effects.NAME].")
        return on
    for name, table in sections.items():
        if name not in EFFECTS:
            on.mistakes.append(unknown_name("[effects]", "effect", name, EFFECTS))
        elif not EFFECTS[name].of_vehicle:
            on.mistakes.append(
                f"[effects.{name}] is of a record, not of the aircraft: {EFFECTS[name].meaning}. "
                f"Take the section out; `explain` and `calibrate` find it in each flight."
            )
        elif not isinstance(table, dict):
            on.mistakes.append(f"[effects.{name}] must be a table of its numbers.")
        else:
            _read_effect(name, table, vehicle, on)
    return on


def _read_effect(name: str, table: dict[str, Any], vehicle: Vehicle, on: SwitchedOn) -> None:
    values = EFFECTS[name].starts(vehicle)
    units = {n: p.unit for p in EFFECTS[name].parameters for n in p.names(vehicle)}
    for key, entry in table.items():
        full = f"effects.{name}.{key}"
        if key not in values:
            on.mistakes.append(unknown_name(f"[effects.{name}]", "number", key, values))
            continue
        try:
            values[key], deviation = read_number(full, entry, spelled(units[key]))
            if deviation is not None:
                on.deviations[full] = deviation
            on.sources[full] = entry["source"]
        except ModelError as mistake:
            on.mistakes.append(str(mistake))
    for key in values.keys() - table.keys():
        on.sources[f"effects.{name}.{key}"] = "default: of the effect library"
    on.values[name] = values


def spelled(fmi_unit: str) -> str:
    """An FMI unit (`kg.m2`) as people write it in vehicle files (`kg*m^2`)."""
    return re.sub(r"(?<=[A-Za-z])(\d)", r"^\1", fmi_unit).replace(".", "*")
