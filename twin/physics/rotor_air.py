"""What the air does to a rotor that moves through it: advance, drag, inflow, lift, moments.

The laws, their signs and their sources are those of `twin.vehicle.RotorAir` and `Advance`. All act
at the hub, whose velocity through the air is that of the centre of mass and of the turning body. A
number that is zero has no place in the equations.
"""

import itertools
from collections.abc import Sequence

import casadi as ca
import numpy as np

from ..component import ComponentBuilder
from ..effects.stages import Motion, Thrust
from ..frames import cross
from ..vehicle import RotorAir, Rotors, Vehicle
from ..vehicle.thrust_map import hover_level

SLOWEST_RAD_S = 1e-3
"""Rotor speed below which the advance ratio is that at this speed: there is no thrust to change."""


def by_advance(
    m: ComponentBuilder, rotors: Rotors, motion: Motion, speed: list[ca.SX]
) -> tuple[list[ca.SX], list[ca.SX]]:
    """Factors on thrust and on reaction torque of each rotor, at rotor speeds in rad/s.

    The rows of the tables are constants of the equations, not parameters.
    """
    one = [ca.SX(1)] * len(speed)
    if rotors.advance is None:
        return one, one
    diameter = m.parameter(
        "diameter", rotors.advance.diameter_m, "m", "Diameter of a rotor", minimum=1e-4
    )
    ratios = [
        -z * 2 * np.pi / (ca.fmax(w, SLOWEST_RAD_S) * diameter)
        for w, (_, _, z) in zip(speed, motion.hubs_air_b, strict=True)
    ]
    thrust, torque = (
        [_on_lines(table, j) for j in ratios] if table else one
        for table in (rotors.advance.thrust, rotors.advance.torque)
    )
    return thrust, torque


def _on_lines(table: Sequence[tuple[float, float]], x: ca.SX) -> ca.SX:
    """Value at x of straight lines between rows, the first and last values beyond."""
    value = ca.SX(table[0][1])
    for (x0, y0), (x1, y1) in itertools.pairwise(table):
        way = ca.if_else(x > x0, ca.if_else(x < x1, x - x0, x1 - x0), 0.0)
        value += (y1 - y0) / (x1 - x0) * way
    return value


def gained_thrust(
    m: ComponentBuilder, air: RotorAir, motion: Motion, speed: list[ca.SX]
) -> list[ca.SX]:
    """Thrust that each rotor gains by moving through the air, N, at these rotor speeds, rad/s."""
    gained = [ca.SX(0)] * len(speed)
    if air.lift_kg_m:
        k = m.parameter(
            "rotor_air.lift",
            air.lift_kg_m,
            "N.s2/m2",
            "Thrust of one rotor per square of its in-plane speed through the air",
        )
        gained = [
            t + motion.density * k * (x * x + y * y)
            for t, (x, y, _) in zip(gained, motion.hubs_air_b, strict=True)
        ]
    if air.inflow_kg_rad:
        k = m.parameter(
            "rotor_air.inflow",
            air.inflow_kg_rad,
            "kg/rad",
            "Thrust that one rotor loses per rotor speed and climb speed",
            minimum=0,
        )
        gained = [
            t + motion.density * k * w * z
            for t, w, (_, _, z) in zip(gained, speed, motion.hubs_air_b, strict=True)
        ]
    return gained


def hub_loads(
    m: ComponentBuilder, vehicle: Vehicle, rotors: Thrust
) -> list[tuple[list[ca.SX], list[ca.SX]]]:
    """Force, N, and moment about the centre of mass, N m, of the air on each rotor, body FRD.

    Thrust and reaction torque aside. Empty where the vehicle knows of none.
    """
    air, motion = vehicle.rotors.air, rotors.motion
    if not (air.drag_kg_rad or air.flapping_kg_m_rad or air.rolling_kg_m_rad):
        return []
    zero = ca.SX(0)
    drag, flapping, rolling = (
        m.parameter(f"rotor_air.{name}", value, unit, meaning, minimum=minimum) if value else zero
        for name, value, unit, meaning, minimum in (
            (
                "drag",
                air.drag_kg_rad,
                "kg/rad",
                "In-plane drag of one rotor per rotor speed and hub speed",
                0,
            ),
            (
                "flapping_moment",
                air.flapping_kg_m_rad,
                "kg.m/rad",
                "Moment of one rotor, leading edge up, per rotor speed and hub speed",
                None,
            ),
            (
                "rolling_moment",
                air.rolling_kg_m_rad,
                "kg.m/rad",
                "Moment of one rotor against its velocity, per rotor speed and hub speed",
                None,
            ),
        )
    )
    hover, loads = hover_level(vehicle), []
    for hub, spin, (x, y, _) in zip(motion.body.hubs, rotors.spin, motion.hubs_air_b, strict=True):
        blow = motion.density * hover * spin
        force = [-blow * drag * x, -blow * drag * y, zero]
        tilt = [
            -blow * (flapping * y + rolling * x),
            blow * (flapping * x - rolling * y),
            zero,
        ]
        loads.append((force, [a + b for a, b in zip(cross(hub, force), tilt, strict=True)]))
    return loads
