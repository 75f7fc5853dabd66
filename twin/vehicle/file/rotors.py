"""Rotors of a vehicle file: their maps, how they follow commands, what the air does to them."""

from collections.abc import Iterator

import numpy as np
from numpy.polynomial import Polynomial

from .. import Advance, RotorAir, Rotors, RunUp, Vehicle
from ..thrust_map import most_thrust_n
from .entries import Entries

_THRUST = ("rotors.thrust_from_speed", "rotors.thrust_from_command")
_RATES = ("rotors.rate_up", "rotors.rate_down")
_ADVANCE = ("rotors.thrust_by_advance", "rotors.torque_by_advance")
_NEED_SPEED = tuple(
    f"rotors.{name}"
    for name in (
        "spin_inertia",
        "reaction_inertia",
        "drag",
        "inflow",
        "flapping_moment",
        "rolling_moment",
        "rate_up",
        "rate_down",
        "thrust_by_advance",
        "torque_by_advance",
    )
)


def rotor_contradictions(entries: Entries) -> Iterator[str]:
    """Mistakes about rotors that no entry makes by itself."""
    given, values = entries.given, entries.values
    yield from _one_of("thrust", *_THRUST, given)
    if len(given & set(_THRUST)) == 1:
        yield from _against_thrust(entries)
    direction, position = values.get("rotors.direction"), values.get("rotors.position")
    if direction is not None and position is not None and len(direction) != len(position):
        yield (f"rotors.direction has {len(direction)} entries, rotors.position {len(position)}.")
    if len(given & set(_RATES)) == 1:
        yield "rotors.rate_up and rotors.rate_down belong together: give both of them."
    if given & set(_RATES) and "rotors.lag" in given:
        yield "rotors.lag and rotors.rate_up say the same thing in two ways: give one of them."
    if given & set(_ADVANCE) and "rotors.diameter" not in given:
        yield f"{min(given & set(_ADVANCE))} needs rotors.diameter, for the advance ratio."


def _against_thrust(entries: Entries) -> Iterator[str]:
    """What does not go with the argument of the one thrust map."""
    of_speed = "rotors.thrust_from_speed" in entries.given
    by, other = ("speed", "command") if of_speed else ("command", "speed")
    yield from _one_of(
        "reaction torque", "rotors.torque_per_thrust", f"rotors.torque_from_{by}", entries.given
    )
    useless = {f"rotors.torque_from_{other}"}
    if not of_speed:
        useless.add("rotors.speed_from_command")
        for key in (k for k in _NEED_SPEED if np.any(entries.values.get(k, 0.0))):
            yield (
                f"{key} needs the rotor speed: give thrust_from_speed "
                f"(and speed_from_command for a vehicle driven by commands)."
            )
    for key in sorted(useless & entries.given):
        yield (
            f"{key} is of no use with thrust_from_{by}. Leave it out, or give "
            f"thrust_from_{other} instead."
        )


def _one_of(what: str, first: str, second: str, given: set[str]) -> Iterator[str]:
    found = [key for key in (first, second) if key in given]
    if len(found) != 1:
        state = f"{first} and {second} are given" if found else "none is given"
        yield f"{what} needs exactly one of {first}, {second}; {state}."


def rotor_doubts(entries: Entries) -> Iterator[str]:
    """What looks odd about rotors but is not refused."""
    given = entries.given
    if "rotors.voltage_exponent" in given and "rotors.reference_voltage" not in given:
        yield "rotors.voltage_exponent counts only with rotors.reference_voltage."
    for key in (k for k in _ADVANCE if k in given):
        at_rest = float(np.interp(0.0, *entries.values[key].T))
        if abs(at_rest - 1) > 1e-6:
            yield f"{key} is {at_rest:g} at rest, where the maps hold and it should be 1."
    if "rotors.diameter" in given and not given & set(_ADVANCE):
        yield "rotors.diameter counts only with thrust_by_advance or torque_by_advance."
    by_command = "rotors.speed_from_command" in given and not given & {"rotors.lag", *_RATES}
    if "rotors.reaction_inertia" in given and by_command:
        yield (
            "rotors.reaction_inertia counts only with measured rotor speeds: by commands and "
            "without lag the rotors have no acceleration."
        )
    of_command = {"rotors.thrust_from_command", "rotors.speed_from_command"}
    if "rotors.command_range" in given and not of_command & given:
        yield "rotors.command_range counts only with a polynomial of the command."


def rotors_too_weak(vehicle: Vehicle) -> Iterator[str]:
    """Whether the rotors cannot carry the weight at full command."""
    rotors = vehicle.rotors
    if vehicle.drive == "rotor_speed":
        return
    most = most_thrust_n(vehicle)
    if most < vehicle.hover_thrust_n:
        yield (
            f"cannot hover: {rotors.count} rotors give at most {most * rotors.count:.4g} N, "
            f"the weight is {vehicle.hover_thrust_n * rotors.count:.4g} N. Check the thrust "
            f"map, its unit and rotors.command_range."
        )


def read_rotors(entries: Entries) -> Rotors:
    """The rotors of entries without mistakes."""
    from_speed = "rotors.thrust_from_speed" in entries.given
    thrust = _map(entries, f"rotors.thrust_from_{'speed' if from_speed else 'command'}")
    if "rotors.torque_per_thrust" in entries.given:
        ratio = entries.number("rotors.torque_per_thrust")
        torque = tuple(ratio * c for c in thrust)
    else:
        torque = _map(entries, f"rotors.torque_from_{'speed' if from_speed else 'command'}")
    by_command = "rotors.speed_from_command" in entries.given
    spin = entries.optional("rotors.spin_inertia", "0, no gyroscopic torque")
    reaction = entries.optional("rotors.reaction_inertia", "0, no reaction to acceleration")
    reference = entries.optional("rotors.reference_voltage", "voltage is ignored")
    exponent = entries.optional("rotors.voltage_exponent", "1")
    lag_up, lag_down = entries.vector("rotors.lag", "no lag", (0.0, 0.0))
    return Rotors(
        position_m=entries.values["rotors.position"],
        direction=entries.values["rotors.direction"],
        from_speed=from_speed,
        thrust_n=thrust,
        torque_n_m=torque,
        speed_rad_s=_map(entries, "rotors.speed_from_command") if by_command else None,
        lag_up_s=float(lag_up),
        lag_down_s=float(lag_down),
        spin_inertia_kg_m2=spin or 0.0,
        reference_voltage_v=reference,
        voltage_exponent=1.0 if exponent is None else exponent,
        run_up=_run_up(entries),
        reaction_inertia_kg_m2=reaction or 0.0,
        air=_rotor_air(entries),
        advance=_advance(entries),
    )


def _advance(entries: Entries) -> Advance | None:
    diameter = entries.optional("rotors.diameter", "of no use")
    thrust, torque = (
        tuple((float(j), float(f)) for j, f in entries.vector(key, "as at rest", ()))
        for key in _ADVANCE
    )
    return Advance(diameter, thrust, torque) if diameter and (thrust or torque) else None


def _run_up(entries: Entries) -> tuple[RunUp, RunUp] | None:
    up, down = (entries.vector(key, "by the lag", ()) for key in _RATES)
    return (RunUp(*up.tolist()), RunUp(*down.tolist())) if len(up) else None


def _rotor_air(entries: Entries) -> RotorAir:
    names = ("drag", "inflow", "lift", "flapping_moment", "rolling_moment")
    return RotorAir(*(entries.optional(f"rotors.{name}", "0, none") or 0.0 for name in names))


def _map(entries: Entries, key: str) -> tuple[float, ...]:
    """Ascending coefficients: of the speed in rad/s as in the file, or of the command 0..1."""
    given = entries.values[key]
    coefficients = given
    if key.endswith("from_command"):
        low, high = entries.vector("rotors.command_range", "commands are 0..1", (0.0, 1.0))
        shifted = Polynomial(given)(Polynomial([low, high - low])).coef
        coefficients = np.zeros(len(given))
        coefficients[: len(shifted)] = shifted
    return tuple(float(c) for c in coefficients)
