"""The families of compensators: one row each; `train`, `evaluate` and the folder go by this table.

A family is a member of `learning.families` with its preset, and its row here. Nothing is imported
before it is used.
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
        member: `MODULE:CLASS` below `learning`, imported when used.
    """

    name: str
    meaning: str
    presets: tuple[str, ...]
    onnx: bool
    member: str

    def load(self) -> "Family[Any, Any]":
        """The family itself."""
        module, _, name = self.member.partition(":")
        family = getattr(import_module(f"..{module}", __package__), name)
        return cast("Family[Any, Any]", family())


FAMILIES: tuple[FamilyRow, ...] = (
    FamilyRow(
        name="fc_mc_svq",
        meaning="FC-MC-SVQ network over the linear prediction",
        presets=("paper", "published", "best"),
        onnx=True,
        member="families.svq:Svq",
    ),
    FamilyRow(
        name="linear",
        meaning="the linear prediction alone: what the network has to beat",
        presets=("linear",),
        onnx=False,
        member="families.linear:Linear",
    ),
    FamilyRow(
        name="trivial",
        meaning="the baselines of every evaluation, kept as models",
        presets=(
            "none",
            "mean",
            "last",
            "average",
            "last-reading",
            "autoregression",
            "mean-reading",
            "linear-in-inputs",
        ),
        onnx=False,
        member="families.trivial:Trivial",
    ),
)
UNSAID = "fc_mc_svq"
"""Family of a folder from before there were others."""


def family_row(name: str) -> FamilyRow:
    """The family of that name."""
    for row in FAMILIES:
        if row.name == name:
            return row
    raise ModelError(f"no family {name!r}; there are {', '.join(r.name for r in FAMILIES)}")


def preset_named(name: str) -> "tuple[FamilyRow, FamilyPreset]":
    """The family that has a preset of that name, and the preset."""
    for row in FAMILIES:
        if name in row.presets:
            return row, row.load().presets()[name]
    known = (p for row in FAMILIES for p in row.presets)
    raise ModelError(f"no preset {name!r}; there are {', '.join(known)}")


def check_preset(row: FamilyRow, preset: "FamilyPreset", protocol: Protocol) -> None:
    """Raise ModelError unless the preset can be trained under the protocol."""
    possible = row.load().protocols(preset)
    if protocol not in possible:
        raise ModelError(
            f"preset {preset.name}: not under protocol {protocol}, only under "
            f"{' and '.join(possible)}"
        )
