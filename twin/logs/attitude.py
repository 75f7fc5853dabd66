"""Attitude as logs have it: quaternions of unit norm, Euler angles turned into them."""

import numpy as np
from numpy.typing import NDArray

from ..errors import LogError
from ..frames import from_euler, rotation_vector
from .columns import EULER, QUAT, Columns
from .flight import Array, Finding, Noted

NORM_DOUBT = 1e-3
"""Distance of a norm from 1 beyond which that a quaternion was normalised is said."""
_LEAST_NORM, _MOST_NORM = 0.5, 2.0
_FARTHEST_RAD = 2 * np.pi
_APART_RAD = 0.02  # made up: over the rounding of any log, under any mistake of axes


def unit_quaternions(log: Noted, q: Array) -> tuple[NDArray[np.bool_], Array]:
    """Logged quaternions normalised, those left out whose norm is far from 1; both are told.

    Args:
        log: Which has them; gets the findings.
        q: Shape (n, 4).

    Returns:
        Which are used, shape (n,), and these, shape (m, 4).
    """
    with np.errstate(invalid="ignore", over="ignore"):  # damaged logs hold any number
        norm = np.linalg.norm(q, axis=1)
    usable = np.isfinite(norm) & (norm > _LEAST_NORM) & (norm < _MOST_NORM)
    off = usable & (np.abs(norm - 1.0) > NORM_DOUBT)
    if not usable.all():
        count = int(np.count_nonzero(~usable))
        log.note("error", "q", "samples left out, the quaternion is far from unit norm", count)
    if off.any():
        message = f"quaternions off unit norm by over {NORM_DOUBT:g}, normalised"
        log.note("warning", "q", message, int(off.sum()))
    return usable, q[usable] / norm[usable, None]


def with_quaternion(name: str, table: Columns) -> tuple[dict[str, Array], list[Finding]]:
    """The q_* that stand in for roll, pitch and yaw.

    Args:
        name: File name, for messages.
        table: By column, one for each of what the file gives.

    Returns:
        Columns q_*, none where the file gives no Euler angles, not all of them, or a quaternion as
        well, which then counts; and findings.

    Raises:
        LogError: Angles that cannot be radians, or another attitude than that of the quaternion.
    """
    given = [c for c in EULER if c in table]
    if not given:
        return {}, []
    missing = [c for c in EULER if c not in table]
    if missing:
        return {}, [
            Finding("warning", "attitude", f"not used, the Euler angles lack {', '.join(missing)}")
        ]
    angles = np.stack([table[c] for c in EULER], axis=1)
    _check_radians(name, angles)
    there = np.isfinite(angles)
    whole = there.all(axis=1)
    findings = []
    partial = int(np.count_nonzero(there.any(axis=1) & ~whole))
    if partial:
        message = "rows with NaN in a part of the Euler angles; they are left out there"
        findings.append(Finding("error", "attitude", message, partial))
    told = np.full((len(angles), 4), np.nan)
    told[whole] = from_euler(*angles[whole].T).T
    if all(c in table for c in QUAT):
        q_nb = np.stack([table[c] for c in QUAT], axis=1)
        if (~np.isnan(q_nb)).all(axis=1).any():
            _check_same(name, q_nb, told)
            return {}, findings
    return {c: np.ascontiguousarray(told[:, k]) for k, c in enumerate(QUAT)}, findings


def _check_radians(name: str, angles: Array) -> None:
    """No angle beyond a whole turn."""
    rows, columns = np.nonzero(np.abs(angles) > _FARTHEST_RAD)
    if len(rows):
        value, column = angles[rows[0], columns[0]], EULER[columns[0]]
        raise LogError(
            f"{name}: {column} in data row {rows[0] + 1} is {value:.6g}, beyond a whole turn "
            f"({len(rows)} such values). Is it in degrees? 1 degree = 0.0174533 rad."
        )


def _check_same(name: str, q_nb: Array, told: Array) -> None:
    """Both attitudes are the same wherever both are there."""
    size = np.linalg.norm(q_nb, axis=1)
    both = np.flatnonzero(np.isfinite(size) & (size > 0.5) & np.isfinite(told[:, 0]))
    unit = q_nb[both] / size[both, None]
    apart = np.linalg.norm(rotation_vector(unit, told[both]), axis=1)
    off = np.flatnonzero(apart > _APART_RAD)
    if len(off):
        k = off[0]
        raise LogError(
            f"{name}: in data row {both[k] + 1} the quaternion and roll, pitch, yaw are "
            f"{apart[k]:.3g} rad apart ({len(off)} such rows). Both turn the body into NED, yaw "
            f"first, then pitch, then roll; give one of them."
        )
