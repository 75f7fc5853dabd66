"""Rigid bodies of other files: poses, combined masses, and axes turned to forward-right-down."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ... import Array

FLU_TO_FRD = np.array([1.0, -1.0, -1.0])
"""Forward-left-up to forward-right-down, and back."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a frame is in another: origin, m, shape (3,), and its axes as columns, (3, 3)."""

    origin: Array
    axes: Array

    def of(self, inner: "Pose") -> "Pose":
        """A pose given in this frame, as seen from outside."""
        return Pose(self.origin + self.axes @ inner.origin, self.axes @ inner.axes)

    def relative_to(self, other: "Pose") -> "Pose":
        """This pose in the frame of another, both given in one frame."""
        back = other.axes.T
        return Pose(back @ (self.origin - other.origin), back @ self.axes)


HERE = Pose(np.zeros(3), np.eye(3))


def pose_of(place: Sequence[float], roll_pitch_yaw: Sequence[float]) -> Pose:
    """Pose from a place, m, and rotations about fixed axes x, y, z in this order, rad."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(roll_pitch_yaw), np.cos(roll_pitch_yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return Pose(np.array(place, dtype=np.float64), about_z @ about_y @ about_x)


@dataclass(frozen=True, slots=True)
class MassProperties:
    """A rigid part.

    Attributes:
        mass_kg: Of the part.
        centre_m: Its centre of mass, shape (3,).
        inertia_kg_m2: About its centre of mass, shape (3, 3).
    """

    mass_kg: float
    centre_m: Array
    inertia_kg_m2: Array


def combined(bodies: Sequence[MassProperties]) -> MassProperties:
    """One rigid body of several, all in one frame.

    Source: parallel axis theorem (Steiner).
    """
    mass = sum(p.mass_kg for p in bodies)
    centre = sum((p.mass_kg * p.centre_m for p in bodies), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for p in bodies:
        r = p.centre_m - centre
        inertia += p.inertia_kg_m2 + p.mass_kg * (r @ r * np.eye(3) - np.outer(r, r))
    return MassProperties(mass, centre, inertia)


def six_elements(inertia: Array) -> Array:
    """Elements [xx, yy, zz, xy, xz, yz] of an inertia matrix; three where the others are zero."""
    diagonal, rest = np.diag(inertia), inertia[[0, 0, 1], [1, 2, 2]]
    # What is left of zero by rounding is zero.
    rest = np.where(np.abs(rest) < 1e-12 * diagonal.max(), 0.0, rest)
    return np.concatenate([diagonal, rest]) if np.any(rest) else diagonal


def turned(inertia: Array) -> Array:
    """Inertia matrix in FLU as one in FRD, or back."""
    return inertia * np.outer(FLU_TO_FRD, FLU_TO_FRD)
