"""Rigid body: states, mass properties, Euler's equation; what acts on it comes from elsewhere."""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import ComponentBuilder
from ..effects.stages import Motion
from ..frames import AXES, FRD, NED, carried, cross, quaternion_rate, to_ned

Array = NDArray[np.float64]
START_HEIGHT_M = 10.0
"""Height at which it starts, when no start value says otherwise."""
START = {"pos_z": -START_HEIGHT_M, "q_w": 1.0}
"""Start values of states that are not zero."""
MOTION = (
    *((f"pos_{a}", "m", f"position, NED {d}") for a, d in zip(AXES, NED, strict=True)),
    *((f"vel_{a}", "m/s", f"velocity, NED {d}") for a, d in zip(AXES, NED, strict=True)),
    *((f"q_{a}", "1", f"attitude quaternion body to NED, {a}") for a in "wxyz"),
    *((f"omega_{a}", "rad/s", f"body rate about {d}") for a, d in zip(AXES, FRD, strict=True)),
)
"""States: name, unit, meaning."""
OUTSIDE = tuple(
    (f"{name}_{a}", unit, f"{meaning} {d}")
    for name, unit, meaning in (
        ("force", "N", "Force from outside, body"),
        ("moment", "N.m", "Moment from outside about"),
    )
    for a, d in zip(AXES, FRD, strict=True)
)
"""What may act on it from outside, about the centre of mass: name, unit, meaning."""


def motion_states(
    m: ComponentBuilder,
) -> tuple[dict[str, ca.SX], list[ca.SX], list[ca.SX], list[ca.SX], list[ca.SX]]:
    """Start values by name; position and velocity NED, attitude, body rates."""
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
) -> None:
    """Declare how the states change, and output them with force and acceleration.

    Args:
        m: Of the airframe.
        motion: Its states.
        specific_force_b: Body FRD, m/s2.
        angular_acceleration_b: Body FRD, rad/s2.
    """
    acceleration_n = to_ned(motion.q_nb, specific_force_b)
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
