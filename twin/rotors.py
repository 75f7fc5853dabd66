"""Rotors: from motor commands or rotor speeds to thrust and reaction torque.

Three kinds, chosen by the vehicle file and by what the flight holds:

| thrust map | driven by | state per rotor |
|---|---|---|
| of the speed | command, through `speed_from_command` and a lag | speed, rad/s |
| of the speed | measured rotor speed | none |
| of the command | command, through a lag | effective command, 0..1 |
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca

from .component_builder import ComponentBuilder
from .errors import ModelError
from .vehicle import Rotors

Drive = Literal["command", "rotor_speed"]


@dataclass(frozen=True, slots=True)
class RotorExpressions:
    """What the rigid body needs of each rotor, as expressions.

    Attributes:
        thrust_n: Along body -z, one per rotor.
        torque_n_m: Reaction torque, positive number, one per rotor.
        speed_rad_s: Speed, one per rotor; empty when the thrust map is of the command.
    """

    thrust_n: list[ca.SX]
    torque_n_m: list[ca.SX]
    speed_rad_s: list[ca.SX]


def polynomial(coefficients: Sequence[ca.SX], argument: ca.SX) -> ca.SX:
    """Value of a polynomial with ascending coefficients (Horner)."""
    value = coefficients[-1]
    for c in coefficients[-2::-1]:
        value = c + argument * value
    return value


def rotor_equations(m: ComponentBuilder, rotors: Rotors, drive: Drive) -> RotorExpressions:
    """Declare inputs, parameters and states of the rotors; return their thrust and torque.

    Raises:
        ModelError: The vehicle's maps do not allow this drive.
    """
    argument, argument_unit = ("rotor speed", "rad/s") if rotors.from_speed else ("command", "1")
    thrust = _coefficients(m, "thrust", "N", "Thrust", rotors.thrust_n, argument, argument_unit)
    torque = _coefficients(
        m, "torque", "N.m", "Reaction torque", rotors.torque_n_m, argument, argument_unit
    )
    if drive == "rotor_speed":
        if not rotors.from_speed:
            raise ModelError(
                "Measured rotor speeds cannot drive a vehicle whose thrust map is of the command; "
                "give rotors.thrust_from_speed in the vehicle file."
            )
        # Hover trim is a start value of the inputs, set once the whole airframe is known.
        level = [
            m.input(f"rotor_{i}", "rad/s", f"Speed of rotor {i}")
            for i in range(1, rotors.count + 1)
        ]
    else:
        level = _driven_by_command(m, rotors)
    # A fitted polynomial may be negative near zero, where a rotor at rest does not push down.
    return RotorExpressions(
        thrust_n=[_not_negative(polynomial(thrust, x)) for x in level],
        torque_n_m=[_not_negative(polynomial(torque, x)) for x in level],
        speed_rad_s=level if rotors.from_speed else [],
    )


def _driven_by_command(m: ComponentBuilder, rotors: Rotors) -> list[ca.SX]:
    """Rotor speed or effective command behind saturation, voltage and lag."""
    commands = [
        m.input(f"cmd_{i}", "1", f"Command of motor {i}, 0..1") for i in range(1, rotors.count + 1)
    ]
    steady = [ca.fmin(ca.fmax(c, 0.0), 1.0) for c in commands]
    if rotors.reference_voltage_v is not None:
        reference = m.parameter(
            "reference_voltage",
            rotors.reference_voltage_v,
            "V",
            "Battery voltage at which the maps of the command hold",
            minimum=1e-3,
        )
        exponent = m.parameter(
            "voltage_exponent",
            rotors.voltage_exponent,
            "1",
            "Power of voltage over reference voltage that multiplies the command",
        )
        voltage = m.input("vbat_v", "V", "Battery voltage", rotors.reference_voltage_v)
        scale = ca.fmax(voltage / reference, 0.0) ** exponent
        steady = [c * scale for c in steady]
    if rotors.speed_rad_s:
        speed = _coefficients(
            m, "speed", "rad/s", "Steady rotor speed", rotors.speed_rad_s, "command", "1"
        )
        steady = [ca.fmax(polynomial(speed, c), 0.0) for c in steady]
    if rotors.lag_up_s == 0:
        return steady
    up = m.parameter("lag.up", rotors.lag_up_s, "s", "Rotor time constant, rising", minimum=1e-3)
    down = m.parameter(
        "lag.down", rotors.lag_down_s, "s", "Rotor time constant, falling", minimum=1e-3
    )
    state, unit, meaning = (
        ("rotor", "rad/s", "speed of rotor")
        if rotors.from_speed
        else ("effort", "1", "effective command of motor")
    )
    level = []
    for i, target in enumerate(steady, start=1):
        start = m.parameter(f"initial.{state}_{i}", 0.0, unit, f"Initial {meaning} {i}", fixed=True)
        x = m.state(f"{state}_{i}", unit, meaning.capitalize() + f" {i}", start)
        m.derivative(f"{state}_{i}", (target - x) / ca.if_else(target > x, up, down))
        level.append(x)
    return level


def _coefficients(
    m: ComponentBuilder,
    prefix: str,
    unit: str,
    meaning: str,
    values: Sequence[float],
    argument: str,
    argument_unit: str,
) -> list[ca.SX]:
    """Coefficients as parameters; those that are zero are left out of the equations."""
    return [
        m.parameter(
            f"{prefix}.c{k}",
            value,
            per_power(unit, argument_unit, k),
            f"{meaning} polynomial, coefficient of {argument}^{k}",
        )
        if value
        else ca.SX(0)
        for k, value in enumerate(values)
    ]


def _not_negative(value: ca.SX) -> ca.SX:
    """Zero where a fitted polynomial is negative; compiles to no call, unlike fmax."""
    return ca.if_else(value > 0, value, 0.0)


def per_power(unit: str, argument_unit: str, power: int) -> str:
    """Unit of the coefficient of `argument^power` in a polynomial with the given unit."""
    if power == 0 or argument_unit == "1":
        return unit
    suffix = "" if power == 1 else str(power)
    if unit == "rad/s":
        raise ValueError("a speed is a polynomial of the command only")
    return f"{unit}.s{suffix}/rad{suffix}"
