"""Rigid body: states, mass properties, Euler's equation, and contact with the ground.

Other forces come from the airframe. Ground contact: spring, damper and friction under each foot,
enough for standing and take-off. Stiffness follows from the mass: the vehicle on its feet is an
oscillator of `CONTACT_HZ` with damping ratio `CONTACT_DAMPING`, slow enough for RK4 at 1 ms.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import ComponentBuilder
from ..effects.stages import Motion
from ..frames import AXES, FRD, NED, carried, cross, quaternion_rate, to_body, to_ned
from ..vehicle import Vehicle

Array = NDArray[np.float64]
START_HEIGHT_M = 10.0
"""Initial height, unless a start value overrides it."""
START = {"pos_z": -START_HEIGHT_M, "q_w": 1.0}
"""Start values of states that are not zero."""
MOTION = (
    *((f"pos_{a}", "m", f"position, NED {d}") for a, d in zip(AXES, NED, strict=True)),
    *((f"vel_{a}", "m/s", f"velocity, NED {d}") for a, d in zip(AXES, NED, strict=True)),
    *((f"q_{a}", "1", f"attitude quaternion body to NED, {a}") for a in "wxyz"),
    *((f"omega_{a}", "rad/s", f"body rate about {d}") for a, d in zip(AXES, FRD, strict=True)),
)
"""States of the motion: name, unit, meaning."""
OUTSIDE = tuple(
    (f"{name}_{a}", unit, f"{meaning} {d}")
    for name, unit, meaning in (
        ("force", "N", "Force from outside, body"),
        ("moment", "N.m", "Moment from outside about"),
    )
    for a, d in zip(AXES, FRD, strict=True)
)
"""External loads about the centre of mass: name, unit, meaning."""


def motion_states(
    m: ComponentBuilder,
) -> tuple[dict[str, ca.SX], list[ca.SX], list[ca.SX], list[ca.SX], list[ca.SX]]:
    """Declared states: start values by name; position and velocity NED, attitude, body rates."""
    initial = {
        name: m.parameter(
            f"initial.{name}", START.get(name, 0.0), unit, f"Initial {meaning}", fixed=True
        )
        for name, unit, meaning in MOTION
    }
    q0 = [initial[f"q_{a}"] for a in "wxyz"]
    norm = ca.sqrt(sum((c * c for c in q0), start=ca.SX(0)))
    for a in "wxyz":
        initial[f"q_{a}"] = initial[f"q_{a}"] / norm
    x = {name: m.state(name, unit, meaning, initial[name]) for name, unit, meaning in MOTION}
    q = [x[f"q_{a}"] for a in "wxyz"]
    length = ca.sqrt(sum((c * c for c in q), start=ca.SX(0)))
    for a, c in zip("wxyz", q, strict=True):
        m.projection(f"q_{a}", c / length)
    return (
        initial,
        [x[f"pos_{a}"] for a in AXES],
        [x[f"vel_{a}"] for a in AXES],
        q,
        [x[f"omega_{a}"] for a in AXES],
    )


def inertia_matrix(m: ComponentBuilder, J: Array) -> list[list[ca.SX]]:
    """Parameters `inertia.xx` to `inertia.zz` of a symmetric matrix `J` (3, 3), kg m2, as rows."""
    element = {
        a + b: m.parameter(
            f"inertia.{a}{b}",
            float(J[i, j]),
            "kg.m2",
            f"Inertia matrix about the centre of mass, element {a}{b}",
            minimum=1e-9 if i == j else None,
        )
        for i, a in enumerate(AXES)
        for j, b in enumerate(AXES)
        if i <= j
    }
    return [[element["".join(sorted(a + b))] for b in AXES] for a in AXES]


def angular_acceleration(motion: Motion, moment_b: Sequence[ca.SX]) -> list[ca.SX]:
    """Euler's equation: `J domega/dt = M - omega x (J omega)`."""
    inertia, omega_b = motion.body.inertia, motion.omega_b
    momentum = [
        sum((j * w for j, w in zip(row, omega_b, strict=True)), start=ca.SX(0)) for row in inertia
    ]
    net = [a - b for a, b in zip(moment_b, cross(omega_b, momentum), strict=True)]
    return [
        sum((i * t for i, t in zip(row, net, strict=True)), start=ca.SX(0))
        for row in _symmetric_inverse(inertia)
    ]


def move(
    m: ComponentBuilder,
    motion: Motion,
    specific_force_b: Sequence[ca.SX],
    angular_acceleration_b: Sequence[ca.SX],
    unsensed_b: Sequence[ca.SX],
) -> None:
    """Declare the derivatives of the states, and output states, force and acceleration.

    Args:
        m: Builder of the airframe.
        motion: States of the airframe.
        specific_force_b: Specific force, body FRD, m/s2.
        angular_acceleration_b: Angular acceleration, body FRD, rad/s2.
        unsensed_b: Acceleration that is no specific force, in addition to gravity, body FRD, m/s2.
    """
    moved_b = [f + a for f, a in zip(specific_force_b, unsensed_b, strict=True)]
    acceleration_n = to_ned(motion.q_nb, moved_b)
    acceleration_n[2] += motion.gravity
    for i, axis in enumerate(AXES):
        m.derivative(f"pos_{axis}", motion.vel_n[i])
        m.derivative(f"vel_{axis}", acceleration_n[i])
        m.derivative(f"omega_{axis}", angular_acceleration_b[i])
    for name, rate in zip("wxyz", quaternion_rate(motion.q_nb, motion.omega_b), strict=True):
        m.derivative(f"q_{name}", rate)

    for i, axis in enumerate(AXES):
        m.output(f"pos_{axis}", "m", f"Position, NED {NED[i]}", motion.pos_n[i])
    for i, axis in enumerate(AXES):
        m.output(f"vel_{axis}", "m/s", f"Velocity, NED {NED[i]}", motion.vel_n[i])
    for i, name in enumerate("wxyz"):
        m.output(f"q_{name}", "1", f"Attitude quaternion body to NED, {name}", motion.q_nb[i])
    for i, axis in enumerate(AXES):
        m.output(f"omega_{axis}", "rad/s", f"Body rate about {FRD[i]}", motion.omega_b[i])
    at_origin_b = carried(
        specific_force_b, motion.body.origin, motion.omega_b, angular_acceleration_b
    )
    for i, axis in enumerate(AXES):
        m.output(
            f"specific_force_{axis}",
            "m/s2",
            f"Specific force where the vehicle file has the centre of mass, body {FRD[i]}",
            at_origin_b[i],
        )
    for i, axis in enumerate(AXES):
        m.output(
            f"angular_acceleration_{axis}",
            "rad/s2",
            f"Angular acceleration about {FRD[i]}",
            angular_acceleration_b[i],
        )


def _symmetric_inverse(J: list[list[ca.SX]]) -> list[list[ca.SX]]:
    """Inverse of a symmetric 3x3 matrix by its adjugate."""
    (a, b, c), (_, d, e), (_, _, f) = J
    adjugate = [
        [d * f - e * e, c * e - b * f, b * e - c * d],
        [c * e - b * f, a * f - c * c, b * c - a * e],
        [b * e - c * d, b * c - a * e, a * d - b * b],
    ]
    determinant = a * adjugate[0][0] + b * adjugate[0][1] + c * adjugate[0][2]
    return [[value / determinant for value in row] for row in adjugate]


CONTACT_HZ = 15.0
"""Natural frequency of the vehicle on its feet, Hz; it sinks g / (2 pi f)^2 = 1.1 mm. Made up."""
CONTACT_DAMPING = 0.7
"""Damping ratio on the feet. Made up: almost no bounce."""
FRICTION = 0.6
"""Coulomb coefficient, rubber on a floor. Made up."""
CLEARANCE_M = 0.5
"""Distance to the ground, in addition to that covered in two steps, beyond which contact is not
evaluated: to cover it within 1 ms takes 10^6 m/s^2."""
SLIP_SPEED_M_S = 0.02
"""Speed at which friction reaches 71 % of its Coulomb value."""


@dataclass(frozen=True, slots=True)
class Contact:
    """Contact force and moment on the vehicle.

    Attributes:
        force: Force, N, body FRD.
        moment: Moment about the centre of mass, N m, body FRD.
        enabled: Parameter that enables the ground.
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
    """Declare the parameters of the ground, a plane at `z_ground` NED, m."""
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
    # No foot can reach the ground in any attitude within a step.
    step = ca.SX.sym("step")
    speed_n = ca.sqrt(sum((v * v for v in vel_n), start=ca.SX(0)))
    reach = vehicle.arm_m + height + CLEARANCE_M + 2 * step * speed_n

    # Everything is linear in the position of the foot, so columns in NED are computed once: a foot
    # at (x, y, height) is at R_x x + R_y y + R_z height from the centre of mass.
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
