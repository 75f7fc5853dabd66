"""Ground contact: spring, damper and friction under each foot, enough to stand and take off.

Stiffness follows from the mass: the vehicle on its feet is an oscillator of `CONTACT_HZ` with
damping ratio `CONTACT_DAMPING`, slow enough for RK4 at 1 ms.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..component import ComponentBuilder
from ..frames import cross, to_body, to_ned
from ..vehicle import Vehicle

CONTACT_HZ = 15.0
"""Natural frequency of the vehicle on its feet, Hz; it sinks g / (2 pi f)^2 = 1.1 mm. Made up."""
CONTACT_DAMPING = 0.7
"""Damping ratio on the feet. Made up: no bounce to speak of."""
FRICTION = 0.6
"""Coulomb coefficient, rubber on a floor. Made up."""
CLEARANCE_M = 0.5
"""Farther than this from the ground, and from what speed covers in two steps, contact is not
evaluated: to bridge it within 1 ms takes 10^6 m/s^2."""
SLIP_SPEED_M_S = 0.02
"""Speed at which friction reaches 71 % of its Coulomb value."""


@dataclass(frozen=True, slots=True)
class Contact:
    """What the ground does to the vehicle.

    Attributes:
        force: N, body FRD.
        moment: About the centre of mass, N m, body FRD.
        enabled: Parameter that switches the ground on.
        step: Symbol of the step length, s, in `out_of_reach`.
        out_of_reach: Whether no foot can touch the ground within the step.
    """

    force: list[ca.SX]
    moment: list[ca.SX]
    enabled: ca.SX
    step: ca.SX
    out_of_reach: ca.SX


def ground_contact(
    m: ComponentBuilder,
    vehicle: Vehicle,
    z_ground: ca.SX,
    pos_n: Sequence[ca.SX],
    vel_n: Sequence[ca.SX],
    q_nb: Sequence[ca.SX],
    omega_b: Sequence[ca.SX],
) -> Contact:
    """Declare the parameters of the ground, whose plane is at `z_ground` NED, m."""
    enabled = m.parameter(
        "ground.enabled",
        1.0,
        "1",
        "Whether there is a ground",
        kind="boolean",
        minimum=0,
        maximum=1,
    )
    count = vehicle.rotors.count
    omega0 = 2 * np.pi * CONTACT_HZ
    stiffness = m.parameter(
        "ground.stiffness",
        vehicle.mass_kg * omega0**2 / count,
        "N/m",
        "Stiffness of one foot",
        minimum=0,
    )
    damping = m.parameter(
        "ground.damping",
        2 * CONTACT_DAMPING * omega0 * vehicle.mass_kg / count,
        "N.s/m",
        "Damping of one foot",
        minimum=0,
    )
    friction = m.parameter("ground.friction", FRICTION, "1", "Friction coefficient", minimum=0)
    height = m.parameter(
        "ground.leg_height",
        vehicle.leg_height_m,
        "m",
        "Centre of mass over the ground when standing",
        minimum=0,
    )
    # Out of reach of the feet in any attitude, whatever happens within a step.
    step = ca.SX.sym("step")
    speed_n = ca.sqrt(sum((v * v for v in vel_n), start=ca.SX(0)))
    reach = vehicle.arm_m + height + CLEARANCE_M + 2 * step * speed_n

    # Everything is linear in the place of the foot, so columns in NED are made once:
    # a foot at (x, y, height) is at R_x x + R_y y + R_z height from the centre of mass.
    columns = [to_ned(q_nb, e) for e in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    omega_n = to_ned(q_nb, omega_b)
    rates = [cross(omega_n, c) for c in columns]
    below = [c * height for c in columns[2]]
    speed = [v + r * height for v, r in zip(vel_n, rates[2], strict=True)]
    force_n: list[ca.SX] = [ca.SX(0.0)] * 3
    moment_n: list[ca.SX] = [ca.SX(0.0)] * 3
    for foot, (x, y, _) in enumerate(vehicle.rotors.position_m.tolist(), start=1):
        reach_n = [a * x + b * y + c for a, b, c in zip(columns[0], columns[1], below, strict=True)]
        v_n = [a * x + b * y + c for a, b, c in zip(rates[0], rates[1], speed, strict=True)]
        depth = pos_n[2] + reach_n[2] - z_ground
        m.crossing(
            f"ground.depth_{foot}",
            "m",
            f"Depth of foot {foot} in the ground, -1 without ground; where it is 0 the damper acts",
            ca.if_else(enabled, depth, -1.0),
        )
        push = stiffness * depth + damping * v_n[2]
        normal = ca.if_else(ca.logic_and(depth > 0, push > 0), enabled * push, 0.0)
        grip = friction * normal / ca.sqrt(v_n[0] ** 2 + v_n[1] ** 2 + SLIP_SPEED_M_S**2)
        f_n = [-grip * v_n[0], -grip * v_n[1], -normal]
        force_n = [a + b for a, b in zip(force_n, f_n, strict=True)]
        moment_n = [a + b for a, b in zip(moment_n, cross(reach_n, f_n), strict=True)]
    return Contact(
        to_body(q_nb, force_n), to_body(q_nb, moment_n), enabled, step, pos_n[2] + reach < z_ground
    )
