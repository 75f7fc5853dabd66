"""Names of factors: what each shapes in a scenario."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from twin.component import unknown_name
from twin.effects import EFFECTS
from twin.errors import TwinError

from ..simulation import Scenario
from .distributions import Value

WORDS = ("mission", "vehicle", "controller")
"""Factors that are words, and choose other FMUs."""
WIND = ("wind.speed", "wind.from", "wind.north", "wind.east", "wind.down")
"""Speed in m/s and where the wind comes from, in degrees from north over east; or the velocity of
the air NED in m/s."""
EFFECT = "effect."
"""`effect.NAME`, true or false, or `effect.NAME.NUMBER`, which switches it on."""


def scenario_of(base: Scenario, factors: Mapping[str, Value], seed: int) -> Scenario:
    """The scenario of one run; its vehicle is that of the base, whatever `vehicle` says.

    Args:
        base: What all runs share.
        factors: Values by name.
        seed: Of its noise, where no factor says another.

    Raises:
        TwinError: A factor has no such name, or a value of another kind.
    """
    changes: dict[str, Any] = {} if base.is_system else {"seed": seed}
    starts, wind = dict(base.starts), {}
    effects = {name: {**numbers} for name, numbers in _effects(base).items()}
    for name, value in factors.items():
        if name in WORDS:
            if name != "vehicle":
                changes["target" if name == "mission" else name] = _word(name, value)
        elif name == "gusts":
            changes["gusts"] = _switch(name, value)
        elif name == "seed":
            changes["seed"] = _whole(name, value)
        elif name in WIND:
            wind[name] = _number(name, value)
        elif name.startswith(EFFECT):
            _add_effect(effects, name, value)
        elif "." in name:
            starts[name] = _number(name, value)
        else:
            known = (*WORDS, "gusts", "seed", *WIND)
            text = unknown_name("sweep", "factor", name, known)
            raise TwinError(f"{text} Or PART.VARIABLE, or effect.NAME.NUMBER.")
    if wind:
        changes["wind_m_s"] = _air(base, wind)
    if effects or base.effects:
        changes["effects"] = effects
    return replace(base, starts=starts, **changes)


def period_of(name: str, units: Mapping[str, str]) -> float | None:
    """What a whole turn is of a factor that is an angle; None of any other.

    Args:
        name: Of the factor.
        units: Of start values, "part.variable" -> unit.
    """
    if name == "wind.from":
        return 360.0
    unit = units.get(name, "")
    if name.startswith(EFFECT):
        effect, _, number = name.removeprefix(EFFECT).partition(".")
        unit = next((p.unit for p in EFFECTS[effect].parameters if p.name == number), "")
    return {"rad": 2 * math.pi, "deg": 360.0}.get(unit)


def _effects(base: Scenario) -> Mapping[str, Mapping[str, float]]:
    """Numbers of the effects of the base; none where its start values hold."""
    if isinstance(base.effects, Mapping):
        return base.effects
    return {name: {} for name in base.effects}


def _add_effect(effects: dict[str, dict[str, float]], name: str, value: Value) -> None:
    """Switch an effect on or off, or set one of its numbers."""
    effect, _, number = name.removeprefix(EFFECT).partition(".")
    if effect not in EFFECTS:
        raise TwinError(unknown_name("sweep", "effect", effect, EFFECTS))
    if number:
        known = [p.name for p in EFFECTS[effect].parameters]
        if number not in known:
            raise TwinError(unknown_name(f"effect {effect}", "number", number, known))
        effects.setdefault(effect, {})[number] = _number(name, value)
    elif _switch(name, value):
        effects.setdefault(effect, {})
    else:
        effects.pop(effect, None)


def _air(base: Scenario, wind: Mapping[str, float]) -> tuple[float, float, float]:
    """Velocity of the air, NED."""
    polar, plain = {"wind.speed", "wind.from"} & wind.keys(), {"wind.north", "wind.east"}
    north, east, down = base.wind_m_s
    if polar and plain & wind.keys():
        raise TwinError(
            f"sweep: {', '.join(wind)}: give the wind by speed and from, or by north and east."
        )
    if polar:
        speed = wind.get("wind.speed", math.hypot(north, east))
        bearing = math.degrees(math.atan2(-east, -north)) if north or east else 0.0
        came = math.radians(wind.get("wind.from", bearing))
        north, east = -speed * math.cos(came), -speed * math.sin(came)
    return (
        wind.get("wind.north", north),
        wind.get("wind.east", east),
        wind.get("wind.down", down),
    )


def _word(name: str, value: Value) -> str:
    if not isinstance(value, str):
        raise TwinError(f"{name} = {value!r}: needs names.")
    return value


def _switch(name: str, value: Value) -> bool:
    if not isinstance(value, bool):
        raise TwinError(f"{name} = {value!r}: needs true or false.")
    return value


def _number(name: str, value: Value) -> float:
    if isinstance(value, bool | str):
        raise TwinError(f"{name} = {value!r}: needs a number.")
    return value


def _whole(name: str, value: Value) -> int:
    number = _number(name, value)
    if number != int(number) or number < 0:
        raise TwinError(f"{name} = {number:g}: needs a whole number from 0 on.")
    return int(number)
