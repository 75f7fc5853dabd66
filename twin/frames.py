"""Frames and quaternions: NED for navigation, FRD for body, `q = [w, x, y, z]` body to NED.

Every function takes the components in a sequence and uses only `+ - * /`, so one definition serves
NumPy arrays (component first, any batch shape after it) and CasADi expressions.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

AXES = ("x", "y", "z")
"""Letters of the axes, in the order of vectors."""
FRD = ("forward", "right", "down")
"""Names of the body axes."""
NED = ("north", "east", "down")
"""Names of the navigation axes."""
Scalar = Any
"""A float, a NumPy array or a CasADi expression: any type with `+ - * /`."""


def rotation_matrix(q_nb: Sequence[Scalar]) -> list[list[Scalar]]:
    """Rows of `R_nb`, with `v_n = R_nb @ v_b`, of a unit quaternion.

    Source: Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., eq. 1.8-16.
    """
    w, x, y, z = q_nb
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def to_ned(q_nb: Sequence[Scalar], v_b: Sequence[Scalar]) -> list[Scalar]:
    """Rotate a body vector (FRD) into NED."""
    return [row[0] * v_b[0] + row[1] * v_b[1] + row[2] * v_b[2] for row in rotation_matrix(q_nb)]


def to_body(q_nb: Sequence[Scalar], v_n: Sequence[Scalar]) -> list[Scalar]:
    """Rotate a NED vector into body axes (FRD)."""
    R_nb = rotation_matrix(q_nb)
    return [R_nb[0][i] * v_n[0] + R_nb[1][i] * v_n[1] + R_nb[2][i] * v_n[2] for i in range(3)]


def quaternion_rate(q_nb: Sequence[Scalar], omega_b: Sequence[Scalar]) -> list[Scalar]:
    """Time derivative of `q_nb` at body rates `omega_b` (rad/s): `q * [0, omega] / 2`."""
    w, x, y, z = q_nb
    p, q, r = omega_b
    return [
        0.5 * (-x * p - y * q - z * r),
        0.5 * (w * p + y * r - z * q),
        0.5 * (w * q - x * r + z * p),
        0.5 * (w * r + x * q - y * p),
    ]


def multiply(a: Sequence[Scalar], b: Sequence[Scalar]) -> list[Scalar]:
    """Hamilton product of two quaternions."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]


def cross(a: Sequence[Scalar], b: Sequence[Scalar]) -> list[Scalar]:
    """Vector product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def carried(
    force: Sequence[Scalar], arm: Sequence[Scalar], omega: Sequence[Scalar], alpha: Sequence[Scalar]
) -> list[Scalar]:
    """Specific force at another point of a rigid body, all in body axes.

    Args:
        force: Specific force at the known point, m/s2.
        arm: Position of the other point from the known one, m.
        omega: Body rates, rad/s.
        alpha: Angular acceleration, rad/s2.
    """
    tangential, centripetal = cross(alpha, arm), cross(omega, cross(omega, arm))
    return [f + t + c for f, t, c in zip(force, tangential, centripetal, strict=True)]


def rotation_vector(q_a: NDArray[np.float64], q_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation from attitude `b` to attitude `a`, in the body axes of `b`, rad.

    Args:
        q_a: Unit quaternions body to NED, shape (n, 4).
        q_b: Unit quaternions body to NED, shape (n, 4).

    Returns:
        Rotation vectors, shape (n, 3): about forward, right and down, at most pi long.
    """
    conjugate = q_b.T * np.array([[1.0], [-1.0], [-1.0], [-1.0]])
    w, *v = multiply(list(conjugate), list(q_a.T))
    vector = np.stack(v, axis=-1) * np.where(w < 0, -1.0, 1.0)[:, None]
    sine = np.linalg.norm(vector, axis=-1)
    angle = 2.0 * np.arctan2(sine, np.abs(w))
    scale = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 1e-12)
    return np.asarray(vector * scale[:, None], dtype=np.float64)


def from_euler(
    roll_rad: float | NDArray[np.float64],
    pitch_rad: float | NDArray[np.float64],
    yaw_rad: float | NDArray[np.float64],
) -> NDArray[np.float64]:
    """Quaternion body to NED of the aerospace sequence yaw, pitch, roll; for n angles, (4, n)."""
    cr, sr = np.cos(roll_rad / 2), np.sin(roll_rad / 2)
    cp, sp = np.cos(pitch_rad / 2), np.sin(pitch_rad / 2)
    cy, sy = np.cos(yaw_rad / 2), np.sin(yaw_rad / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def to_euler(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Roll, pitch and yaw of unit quaternions body to NED, rad, as in `from_euler`; of (4, n) shape
    (3, n)."""
    r = rotation_matrix(list(q))
    pitch = np.arcsin(np.clip(-np.asarray(r[2][0]), -1.0, 1.0))
    return np.array([np.arctan2(r[2][1], r[2][2]), pitch, np.arctan2(r[1][0], r[0][0])])
