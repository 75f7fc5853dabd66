"""Registry of the compensator families, used by `train`, `evaluate` and the model folder.

A family is a class, registered here by name and import path. Nothing is imported before it is used.
"""

from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

from twin.errors import ModelError

from ..preset import Protocol

if TYPE_CHECKING:
    from .family import Family, FamilyPreset

FAMILIES = MappingProxyType(
    {
        "svq": "learning.training.train:Svq",
        "linear": "learning.training.train:Linear",
    }
)
"""Import path `MODULE:CLASS` of every family of compensators, by name."""


def family_named(name: str) -> "Family[Any, Any]":
    """The family of a name.

    Raises:
        ModelError: No family has this name.
    """
    if name not in FAMILIES:
        raise ModelError(f"no family {name!r}; there are {', '.join(FAMILIES)}")
    module, _, kind = FAMILIES[name].partition(":")
    return cast("Family[Any, Any]", getattr(import_module(module), kind)())


def preset_named(name: str) -> "tuple[Family[Any, Any], FamilyPreset]":
    """The family that has a preset of this name, and the preset."""
    families = [family_named(family) for family in FAMILIES]
    for family in families:
        if name in family.presets:
            return family, family.presets[name]
    known = ", ".join(p for family in families for p in family.presets)
    raise ModelError(f"no preset {name!r}; there are {known}")


def chosen(
    model: str | None, preset: str | None, protocol: Protocol
) -> "tuple[Family[Any, Any], FamilyPreset]":
    """The family and its preset, from the name of either or of both.

    Args:
        model: Name of the family; None: that of the preset, or `svq`.
        preset: Name of the preset; None: the default of the family.
        protocol: Protocol of the training.

    Raises:
        ModelError: The name does not exist, or the preset belongs to another family or protocol.
    """
    if model is None and preset is not None:
        family, found = preset_named(preset)
    else:
        family = family_named(model or "svq")
        if preset is not None and preset not in family.presets:
            raise ModelError(
                f"model {family.name} has the presets {', '.join(family.presets)}, no {preset!r}"
            )
        found = family.presets[preset or family.usual]
    check_preset(family, found, protocol)
    return family, found


def check_preset(family: "Family[Any, Any]", preset: "FamilyPreset", protocol: Protocol) -> None:
    """Raise ModelError unless the preset can be trained under the protocol."""
    possible = family.protocols(preset)
    if protocol not in possible:
        raise ModelError(
            f"preset {preset.name}: not under protocol {protocol}, only under "
            f"{' and '.join(possible)}"
        )
