"""The effect library: every named physical cause that a model may lack, each defined once."""

from . import air, gust, inertial, mass, propulsion, sensors, timing
from .definition import Block, Blocks, ComponentName, Effect, EffectParameter, Limit

_MODULES = (air, gust, propulsion, mass, inertial, sensors, timing)
EFFECTS: dict[str, Effect] = {e.name: e for module in _MODULES for e in module.EFFECTS}
"""All effects by identifier."""


def effects_of(component: ComponentName) -> tuple[Effect, ...]:
    """Effects whose term stands in a component, in the order of the library."""
    return tuple(e for e in EFFECTS.values() if e.component == component)


__all__ = [
    "EFFECTS",
    "Block",
    "Blocks",
    "ComponentName",
    "Effect",
    "EffectParameter",
    "Limit",
    "effects_of",
]
