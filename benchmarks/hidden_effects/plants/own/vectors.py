"""Vectors and rotations over the first axis, flights or samples over the last."""

import numpy as np

from .parameters import Array


def cross(a: Array, b: Array) -> Array:
    """Cross product over the first axis; one shape must hold the other."""
    c = np.empty(a.shape if a.size >= b.size else b.shape)
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]
    return c


def rotation(q: Array) -> Array:
    """Matrix body to NED of unit quaternions, shape (3, 3, n)."""
    w, x, y, z = q
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    r = np.empty((3, 3, q.shape[1]))
    r[0, 0], r[1, 1], r[2, 2] = 1 - 2 * (yy + zz), 1 - 2 * (xx + zz), 1 - 2 * (xx + yy)
    r[0, 1], r[1, 0] = 2 * (xy - wz), 2 * (xy + wz)
    r[0, 2], r[2, 0] = 2 * (xz + wy), 2 * (xz - wy)
    r[1, 2], r[2, 1] = 2 * (yz - wx), 2 * (yz + wx)
    return r


def to_ned(r: Array, v: Array) -> Array:
    """Body vectors in NED."""
    return np.asarray((r * v).sum(axis=1))


def to_body(r: Array, v: Array) -> Array:
    """NED vectors in body axes."""
    return np.asarray((r * v[:, None]).sum(axis=0))


def quaternion_rate(q: Array, omega: Array) -> Array:
    """Time derivative of quaternions body to NED turning with body rates."""
    half = 0.5 * omega
    rate = np.empty_like(q)
    rate[0] = -(q[1:] * half).sum(axis=0)
    rate[1:] = q[0] * half + cross(q[1:], half)
    return rate


def turned(q: Array, angle: Array) -> Array:
    """Attitudes after small turns about the body axes, rad; shapes (4, n) and (3, n)."""
    w, v = q[0], q[1:]
    half = 0.5 * angle
    q = np.concatenate([(w - (v * half).sum(axis=0))[None], v + w * half + cross(v, half)])
    return np.asarray(q / np.sqrt((q * q).sum(axis=0)))
