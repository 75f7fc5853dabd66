"""The effect library: every named physical cause that a model may lack, each defined once."""

from ..vehicle import Vehicle
from . import air, mass, propulsion, sensors, timing
from .definition import (
    Average,
    Block,
    Blocks,
    ComponentName,
    Displacement,
    Effect,
    Equation,
    Family,
    Limit,
    Lines,
    NoiseFloor,
    Observer,
    Period,
    RandomForce,
    Repeats,
    Shift,
    prior_of,
)
from .parameters import EffectParameter
from .wording import Advice

_MODULES = (air, propulsion, mass, sensors, timing)
"""Modules that define effects, by subject."""
EFFECTS: dict[str, Effect] = {e.name: e for module in _MODULES for e in module.EFFECTS}
"""All effects by identifier."""
FAMILIES = air.FAMILIES
"""Laws shared by several effects."""


def advice_of(number: str) -> Advice | None:
    """Manoeuvre to fly where a number, "effect.number", is undetermined."""
    effect, _, name = number.partition(".")
    advice = EFFECTS[effect].advice or {}
    begins = [k for k in advice if name.startswith(k)]
    return advice[max(begins, key=len)] if begins else None


def effects_of(component: ComponentName) -> tuple[Effect, ...]:
    """Effects with a term in a component, in the order of the library."""
    return tuple(e for e in EFFECTS.values() if e.component == component)


def effects_for(vehicle: Vehicle) -> tuple[str, ...]:
    """Effects in the components of an aircraft, switched on or off: all except those that need a
    battery's voltage or current where its file has no battery."""
    known = {"vbat": vehicle.states_voltage, "ibat": vehicle.battery is not None}
    return tuple(
        name
        for name, effect in EFFECTS.items()
        if name in vehicle.effects or all(known.get(signal, True) for signal in effect.needs)
    )


def acting_late() -> tuple[Effect, ...]:
    """Effects by which signals act later than recorded."""
    return tuple(
        e for e in EFFECTS.values() if isinstance(e.observable_as, Shift) and e.observable_as.acts
    )


def late_actions(vehicle: Vehicle) -> dict[str, float]:
    """Delay between record and action of each signal in a vehicle, s."""
    return _shifts(vehicle, acts=True)


def ages(vehicle: Vehicle) -> dict[str, float]:
    """Age of each signal's reading relative to its recorded time in a vehicle, s."""
    return _shifts(vehicle, acts=False)


def _shifts(vehicle: Vehicle, acts: bool) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, numbers in vehicle.effects.items():
        observable_as = EFFECTS[name].observable_as
        if isinstance(observable_as, Shift) and observable_as.acts == acts:
            for number, signals in observable_as.moves.items():
                found |= {s: found.get(s, 0.0) + numbers.get(number, 0.0) for s in signals}
    return found


__all__ = [
    "EFFECTS",
    "FAMILIES",
    "Average",
    "Block",
    "Blocks",
    "ComponentName",
    "Displacement",
    "Effect",
    "EffectParameter",
    "Equation",
    "Family",
    "Limit",
    "Lines",
    "NoiseFloor",
    "Observer",
    "Period",
    "RandomForce",
    "Repeats",
    "Shift",
    "acting_late",
    "advice_of",
    "ages",
    "effects_for",
    "effects_of",
    "late_actions",
    "prior_of",
]
