"""Ground contact: spring, damper and friction under each foot, enough to stand and take off.

Stiffness follows from the mass: the vehicle on its feet is an oscillator of `CONTACT_HZ` with
damping ratio `CONTACT_DAMPING`, slow enough for RK4 at 1 ms.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from .component import ComponentBuilder
from .frames import cross, to_body, to_ned
from .vehicle import Vehicle

CONTACT_HZ = 15.0
"""Natural frequency of the vehicle on its feet, Hz; it sinks g / (2 pi f)^2 = 1.1 mm. Made up."""
CONTACT_DAMPING = 0.7
"""Damping ratio on the feet. Made up: no bounce to speak of."""
FRICTION = 0.6
"""Coulomb coefficient, rubber on a floor. Made up."""
SLIP_SPEED_M_S = 0.02
"""Speed at which friction reaches 71 % of its Coulomb value."""


def ground_wrench(
    m: ComponentBuilder,
    vehicle: Vehicle,
    pos_n: Sequence[ca.SX],
    vel_n: Sequence[ca.SX],
    q_nb: Sequence[ca.SX],
    omega_b: Sequence[ca.SX],
) -> tuple[list[ca.SX], list[ca.SX]]:
    """Force (N) and moment about the centre of mass (N m) of the ground, body FRD."""
    enabled = m.parameter(
        "ground.enabled", 1.0, "1", "Whether there is a ground", boolean=True, minimum=0, maximum=1
    )
    z_ground = m.parameter("ground.z", 0.0, "m", "Ground plane, NED down")
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
    force: list[ca.SX] = [ca.SX(0.0)] * 3
    moment: list[ca.SX] = [ca.SX(0.0)] * 3
    for x, y, _ in vehicle.rotors.position_m:
        foot_b = [float(x), float(y), height]
        reach_n = to_ned(q_nb, foot_b)
        v_n = [v + w for v, w in zip(vel_n, to_ned(q_nb, cross(omega_b, foot_b)), strict=True)]
        depth = pos_n[2] + reach_n[2] - z_ground
        normal = enabled * ca.if_else(
            depth > 0, ca.fmax(stiffness * depth + damping * v_n[2], 0.0), 0.0
        )
        slip = ca.sqrt(v_n[0] ** 2 + v_n[1] ** 2 + SLIP_SPEED_M_S**2)
        f_n = [-friction * normal * v_n[0] / slip, -friction * normal * v_n[1] / slip, -normal]
        f_b = to_body(q_nb, f_n)
        force = [a + b for a, b in zip(force, f_b, strict=True)]
        moment = [a + b for a, b in zip(moment, cross(foot_b, f_b), strict=True)]
    return force, moment
