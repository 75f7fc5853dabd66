"""The families of compensators: one row each; `train`, `evaluate` and the folder go by this table.

A family is a class with its presets, and its row here. Nothing is imported before it is used.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

from twin.errors import ModelError

from ..preset import Protocol

if TYPE_CHECKING:
    from .family import Family, FamilyPreset


@dataclass(frozen=True, slots=True)
class FamilyRow:
    """One family.

    Attributes:
        name: As written in `model.json`.
        meaning: What its models are, in a line.
        presets: Names of its presets, no two families have one in common.
        onnx: Whether its models are exported as `model.onnx`, and so as FMUs.
        member: `MODULE:CLASS`, imported when used.
        otherwise: Preset where nobody says, "": the first.
    """

    name: str
    meaning: str
    presets: tuple[str, ...]
    onnx: bool
    member: str
    otherwise: str = ""

    @property
    def usual(self) -> str:
        """Preset where nobody says."""
        return self.otherwise or self.presets[0]

    def load(self) -> "Family[Any, Any]":
        """The family itself."""
        module, _, name = self.member.partition(":")
        return cast("Family[Any, Any]", getattr(import_module(module), name)())


FAMILIES: tuple[FamilyRow, ...] = (
    FamilyRow(
        name="svq",
        meaning="FC-MC-SVQ network over the linear prediction",
        presets=("paper", "published", "best"),
        onnx=True,
        member="learning.training.train:Svq",
        otherwise="best",
    ),
    FamilyRow(
        name="linear",
        meaning="the linear prediction alone: what the network has to beat",
        presets=("linear",),
        onnx=True,
        member="learning.training.train:Linear",
    ),
)  # every family of compensators


def family_row(name: str) -> FamilyRow:
    """The family of that name.

    Raises:
        ModelError: There is none.
    """
    rows = {row.name: row for row in FAMILIES}
    if name not in rows:
        raise ModelError(f"no family {name!r}; there are {', '.join(rows)}")
    return rows[name]


def preset_named(name: str) -> "tuple[FamilyRow, FamilyPreset]":
    """The family that has a preset of that name, and the preset."""
    for row in FAMILIES:
        if name in row.presets:
            return row, row.load().presets()[name]
    known = ", ".join(p for row in FAMILIES for p in row.presets)
    raise ModelError(f"no preset {name!r}; there are {known}")


def chosen(model: str | None, preset: str | None) -> "tuple[FamilyRow, FamilyPreset]":
    """The family and its preset, by the name of either or of both.

    Args:
        model: Of the family; None: that of the preset, or `svq`.
        preset: None: what the family takes where nobody says.

    Raises:
        ModelError: There is none of that name, or the preset is of another family.
    """
    if model is None and preset is not None:
        return preset_named(preset)
    row = family_row(model or "svq")
    if preset is not None and preset not in row.presets:
        raise ModelError(
            f"model {row.name} has the presets {', '.join(row.presets)}, no {preset!r}"
        )
    return row, row.load().presets()[preset or row.usual]


def check_preset(row: FamilyRow, preset: "FamilyPreset", protocol: Protocol) -> None:
    """Raise ModelError unless the preset can be trained under the protocol."""
    possible = row.load().protocols(preset)
    if protocol not in possible:
        raise ModelError(
            f"preset {preset.name}: not under protocol {protocol}, only under "
            f"{' and '.join(possible)}"
        )
