"""The families of compensators: one row each; `train`, `evaluate` and the folder go by this table.

A family is a class with its presets, and its row here. Nothing is imported
before it is used. The systems of the paper's comparison have their rows in `benchmarks.paper`,
which is part of the source checkout and of no wheel.
"""

from collections.abc import Collection
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
        return cast("Family[Any, Any]", _member(self.member)())


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
    FamilyRow(
        name="trivial",
        meaning="the baselines of every evaluation, as models",
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
        member="learning.model.baselines:Trivial",
    ),
)  # every family of compensators
UNSAID = "svq"
"""Family of a folder from before there were others, and of whom nobody says it."""
CHECKOUT = "benchmarks.paper.families:ROWS"
"""Rows of the paper's comparison."""


def _member(path: str) -> Any:
    """The object of `MODULE:NAME`."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


def families() -> tuple[FamilyRow, ...]:
    """`FAMILIES`, and those of the paper's comparison where their checkout can be imported."""
    try:
        return (*FAMILIES, *_member(CHECKOUT))
    except ModuleNotFoundError as error:
        if error.name not in ("benchmarks", "benchmarks.paper"):
            raise
        return FAMILIES


def family_row(name: str) -> FamilyRow:
    """The family of that name.

    Raises:
        ModelError: There is none; a system of the paper's comparison needs the source checkout.
    """
    rows = {row.name: row for row in families()}
    if name not in rows:
        raise ModelError(f"no family {name!r}; there are {', '.join(rows)}{_elsewhere(rows)}")
    return rows[name]


def _elsewhere(rows: Collection[str]) -> str:
    """Where further families are, if not all of them are here."""
    if len(rows) > len(FAMILIES):
        return ""
    return "; systems of the paper's comparison come with the source checkout (benchmarks/paper)"


def preset_named(name: str) -> "tuple[FamilyRow, FamilyPreset]":
    """The family that has a preset of that name, and the preset."""
    rows = families()
    for row in rows:
        if name in row.presets:
            return row, row.load().presets()[name]
    known = ", ".join(p for row in rows for p in row.presets)
    here = [row.name for row in rows]
    raise ModelError(f"no preset {name!r}; there are {known}{_elsewhere(here)}")


def chosen(model: str | None, preset: str | None) -> "tuple[FamilyRow, FamilyPreset]":
    """The family and its preset, by the name of either or of both.

    Args:
        model: Of the family; None: that of the preset, or the first.
        preset: None: what the family takes where nobody says.

    Raises:
        ModelError: There is none of that name, or the preset is of another family.
    """
    if model is None and preset is not None:
        return preset_named(preset)
    row = family_row(UNSAID if model is None else model)
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
