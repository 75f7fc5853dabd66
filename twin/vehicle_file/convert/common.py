"""Functions shared by the converters: safe reading of XML, and rigid bodies.

XML of other programs is read without entities, document types or network access. Bodies have poses
and combined masses, and their axes are rotated to forward-right-down.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from ...errors import ModelError
from ...vehicle import Array

Element = Any
"""An element of lxml, which is not typed."""
LARGEST_BYTES = 20_000_000
"""Largest XML file that is read. Made up."""


def read_xml(path: Path) -> Element:
    """Root of an XML file.

    Raises:
        ModelError: The file cannot be read, is no XML, is too large or has a document type.
    """
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise ModelError(f"{path.name}: has more than {LARGEST_BYTES // 10**6} MB; too large.")
        parser = etree.XMLParser(
            resolve_entities=False,
            no_network=True,
            load_dtd=False,
            remove_comments=True,
            remove_pis=True,
        )
        tree = etree.fromstring(path.read_bytes(), parser).getroottree()
    except OSError as error:
        raise ModelError(f"{path.name}: cannot be read: {error}.") from error
    except etree.XMLSyntaxError as error:
        raise ModelError(f"{path.name}: not valid XML: {error}.") from error
    if tree.docinfo.doctype:
        raise ModelError(
            f"{path.name}: has a document type ({tree.docinfo.doctype[:60]}), which may hold "
            f"entities; take it out."
        )
    return tree.getroot()


def floats(file: str, what: str, text: str | None, count: int) -> Array:
    """A given number of finite numbers, separated by blanks.

    Raises:
        ModelError: The text is something else; the error names the file, the quantity, and the
            text.
    """
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        raise ModelError(f"{file}: {what} is {text!r}, not {count} number(s).")
    return values


def number(file: str, parent: Element, tag: str) -> float:
    """The number in a child element.

    Raises:
        ModelError: There is no such child, or it has no number.
    """
    child = parent.find(tag)
    if child is None:
        raise ModelError(f"{file}: <{parent.tag}> has no <{tag}>.")
    return float(floats(file, f"<{tag}>", child.text, 1)[0])


FLU_TO_FRD = np.array([1.0, -1.0, -1.0])
"""Forward-left-up to forward-right-down, and back."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of a frame in another one: origin, m, shape (3,), and its axes as columns, (3, 3)."""

    origin: Array
    axes: Array

    def of(self, inner: "Pose") -> "Pose":
        """Pose in the outer frame of a pose that is given in this frame."""
        return Pose(self.origin + self.axes @ inner.origin, self.axes @ inner.axes)

    def relative_to(self, other: "Pose") -> "Pose":
        """This pose relative to another one, both given in the same frame."""
        back = other.axes.T
        return Pose(back @ (self.origin - other.origin), back @ self.axes)


HERE = Pose(np.zeros(3), np.eye(3))  # the frame itself


def pose_of(place: Sequence[float], roll_pitch_yaw: Sequence[float]) -> Pose:
    """Pose from a position, m, and rotations about fixed axes x, y, z in this order, rad."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(roll_pitch_yaw), np.cos(roll_pitch_yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return Pose(np.array(place, dtype=np.float64), about_z @ about_y @ about_x)


@dataclass(frozen=True, slots=True)
class MassProperties:
    """Mass properties of a rigid part.

    Attributes:
        mass_kg: Mass of the part.
        centre_m: Centre of mass, shape (3,).
        inertia_kg_m2: Inertia about the centre of mass, shape (3, 3).
    """

    mass_kg: float
    centre_m: Array
    inertia_kg_m2: Array


def combined(bodies: Sequence[MassProperties]) -> MassProperties:
    """Mass properties of several rigid bodies as one, all in the same frame.

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
    # Off-diagonal elements within rounding of zero are zero.
    rest = np.where(np.abs(rest) < 1e-12 * diagonal.max(), 0.0, rest)
    return np.concatenate([diagonal, rest]) if np.any(rest) else diagonal


def turned(inertia: Array) -> Array:
    """Inertia matrix converted from FLU to FRD, or back."""
    return inertia * np.outer(FLU_TO_FRD, FLU_TO_FRD)
