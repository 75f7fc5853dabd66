"""The attitude of a flight table as a quaternion: from Euler angles, and from the acceleration
where some of them are not logged.

A flight with an accelerometer or a gyroscope is not changed: its IMU shows forces and torques by
itself.

Rotors push along -z of the body, and drag is small compared with thrust. So the specific force f =
a - g of the motion has the direction of thrust: -f/|f| is the z axis of the body in NED, and in
axes rotated by the heading it is

    (cos(roll) sin(pitch), -sin(roll), cos(roll) cos(pitch)).

Without an acceleration a missing angle is 0: in a flight without aerobatics its mean rate of change
is 0, too, as the balance of moments requires. A derived angle carries no information on the signal
it was derived from. `Flight.derived_angles` names them, and the model omits the channels that
depend on them.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from ..errors import LogError
from ..frames import from_euler, rotation_vector
from ..vehicle import GRAVITY_M_S2
from .columns import ACC, ACC_NED, EULER, GYRO, POS, QUAT, VEL, Columns
from .flight import Array, Finding

TILT_HZ = 5.0
"""Cut-off of the low-pass before a tilt is read from the acceleration: thrust turns more slowly,
vibration is faster."""
SHARE_OF_RATE = 0.2
"""Cut-off of that low-pass as a share of the sample rate, where the rate is low."""
LEAST_PUSH_M_S2 = 3.0
"""Upward specific force below which no direction is read from it: the aircraft falls."""
_FARTHEST_RAD = 2 * np.pi
"""Largest angle of an attitude: one turn."""
_APART_RAD = 0.02
"""Largest difference of two attitudes; made up: above the rounding of any log, below any mistake of
axes."""
_SETTLED = 16
"""Samples over which the filters settle; half of the fewest that are read."""
_LOST = {
    "roll_rad": "force along y and the answer of roll above 1 Hz (inertia, lag)",
    "pitch_rad": "force along x and the answer of pitch above 1 Hz (inertia, lag)",
    "yaw_rad": "forces along x and y and the torque about z (drag, wind, yaw torque)",
}
"""Quantities that the flights do not determine without an angle."""


@dataclass(frozen=True, slots=True)
class Completed:
    """Attitude of a table that has no quaternion.

    Attributes:
        columns: Columns q_*; empty where the table has a quaternion, or no signal that shows an
            attitude.
        derived: Euler angles derived from the acceleration because they were not logged.
        findings: Findings on samples that were dropped or derived.
    """

    columns: dict[str, Array]
    derived: tuple[str, ...]
    findings: list[Finding]


def with_quaternion(name: str, table: Columns) -> Completed:
    """The columns q_* computed from roll, pitch and yaw.

    Args:
        name: File name, for messages.
        table: Columns of the file by name.

    Raises:
        LogError: Angles that cannot be radians, or that contradict the quaternion.
    """
    given = [c for c in EULER if c in table]
    of_imu = any(c in table for c in (*ACC, *GYRO))
    shown = None if of_imu or any(c in table for c in QUAT) else _acceleration(table)
    if not given and shown is None:
        return Completed({}, (), [])
    time_s = table["time"]
    angles = np.full((len(time_s), len(EULER)), np.nan)
    for k, column in enumerate(EULER):
        if column in table:
            angles[:, k] = table[column]
    _check_radians(name, angles)
    missing = tuple(c for c in EULER if c not in given)
    findings = _partial(angles[:, [c in given for c in EULER]])
    if missing and not {*QUAT} <= {*table}:
        if of_imu:
            text = f"not used, the Euler angles lack {', '.join(missing)}"
            return Completed({}, (), [Finding("warning", "attitude", text)])
        if shown is None:
            angles[:, [c in missing for c in EULER]] = 0.0
        else:
            angles = _by_force(time_s, angles, *shown[1:])
        text = _what_is_lost(missing, "" if shown is None else shown[0])
        findings.append(Finding("warning", "attitude", text))
    whole = np.isfinite(angles).all(axis=1)
    q_euler = np.full((len(angles), 4), np.nan)
    q_euler[whole] = from_euler(*angles[whole].T).T
    if all(c in table for c in QUAT):
        q_nb = np.stack([table[c] for c in QUAT], axis=1)
        if (~np.isnan(q_nb)).all(axis=1).any():
            _check_same(name, q_nb, q_euler)
            return Completed({}, (), findings)
    columns = {c: np.ascontiguousarray(q_euler[:, k]) for k, c in enumerate(QUAT)}
    return Completed(columns, missing, findings)


def _partial(angles: Array) -> list[Finding]:
    """Findings on rows in which only some of the logged angles have a value."""
    there = np.isfinite(angles)
    count = int(np.count_nonzero(there.any(axis=1) & ~there.all(axis=1)))
    message = "rows with NaN in a part of the Euler angles; they are left out there"
    return [Finding("error", "attitude", message, count)] if count else []


# -- from the acceleration ----------------------------------------------------------------------


def _acceleration(table: Columns) -> tuple[str, Array, Array] | None:
    """Acceleration of the motion: name of its signal, times, s, and values, NED, shape (n, 3).

    The acceleration of the table, else the slope of its velocity, else the second slope of its
    position.
    """
    for signal, columns, slopes in (("acc_ned", ACC_NED, 0), ("vel", VEL, 1), ("pos", POS, 2)):
        if not all(c in table for c in columns):
            continue
        values = np.stack([table[c] for c in columns], axis=1)
        there = np.isfinite(values).all(axis=1)
        t_s, values = table["time"][there], values[there]
        if len(t_s) < 2 * _SETTLED:
            continue
        for _ in range(slopes):
            values = np.gradient(values, t_s, axis=0)
        rate_hz = 1 / float(np.median(np.diff(t_s)))
        share = min(TILT_HZ / rate_hz, SHARE_OF_RATE)
        low_pass = scipy.signal.butter(2, 2 * share, output="sos")
        return signal, t_s, scipy.signal.sosfiltfilt(low_pass, values, axis=0)
    return None


def _by_force(time_s: Array, angles: Array, t_s: Array, acceleration_n: Array) -> Array:
    """Angles with missing roll and pitch from the direction of the specific force, and a missing
    heading set to north.

    Args:
        time_s: Times of the rows, shape (n,).
        angles: Roll, pitch, yaw, rad, NaN where missing, shape (n, 3).
        t_s: Times of the acceleration, shape (m,).
        acceleration_n: Acceleration of the motion, NED, m/s^2, shape (m, 3).
    """
    force = np.stack([np.interp(time_s, t_s, a, np.nan, np.nan) for a in acceleration_n.T])
    force[2] = np.minimum(force[2] - GRAVITY_M_S2, -LEAST_PUSH_M_S2)
    north, east, down = -force / np.linalg.norm(force, axis=0)
    roll, pitch, yaw = angles.T
    has_roll, has_pitch, has_yaw = (bool(np.isfinite(a).any()) for a in angles.T)
    yaw = yaw if has_yaw else np.zeros_like(yaw)
    ahead, right = (
        np.cos(yaw) * north + np.sin(yaw) * east,
        np.cos(yaw) * east - np.sin(yaw) * north,
    )
    pitch = pitch if has_pitch else np.arctan2(ahead, down)
    roll = roll if has_roll else np.arcsin(np.clip(-right, -1.0, 1.0))
    return np.stack([roll, pitch, yaw], axis=1)


def _what_is_lost(missing: tuple[str, ...], signal: str) -> str:
    """Text on the derived angles and on the quantities that the flight no longer determines.

    Args:
        missing: Missing angles.
        signal: Signal of the acceleration; "": there is none.
    """
    tilts = [c for c in missing if signal and c != "yaw_rad"]
    how = []
    if tilts:
        how.append(f"{' and '.join(tilts)} from {signal}: thrust points along the specific force")
    how += [f"{c} as 0" for c in missing if c not in tilts]
    lost = [_LOST[c] for c in missing] + ["any force: no acc_ned, vel or pos"] * (not signal)
    return (
        f"{', '.join(missing)} not logged; taken: {', '.join(how)}; not told without it: "
        f"{'; '.join(lost)}"
    )


# -- checks -------------------------------------------------------------------------------------


def _check_radians(name: str, angles: Array) -> None:
    """Check that no angle exceeds a whole turn."""
    rows, columns = np.nonzero(np.abs(angles) > _FARTHEST_RAD)
    if len(rows):
        value, column = angles[rows[0], columns[0]], EULER[columns[0]]
        turns = " Does it count turns? Take off whole ones, of 2 pi." if column == "yaw_rad" else ""
        raise LogError(
            f"{name}: {column} in data row {rows[0] + 1} is {value:.6g}, beyond a whole turn "
            f"({len(rows)} such values). Is it in degrees? 1 degree = 0.0174533 rad.{turns}"
        )


def _check_same(name: str, q_nb: Array, q_euler: Array) -> None:
    """Check that both attitudes agree wherever both have a value."""
    size = np.linalg.norm(q_nb, axis=1)
    both = np.flatnonzero(np.isfinite(size) & (size > 0.5) & np.isfinite(q_euler[:, 0]))
    unit = q_nb[both] / size[both, None]
    apart = np.linalg.norm(rotation_vector(unit, q_euler[both]), axis=1)
    off = np.flatnonzero(apart > _APART_RAD)
    if len(off):
        k = off[0]
        raise LogError(
            f"{name}: in data row {both[k] + 1} the quaternion and roll, pitch, yaw are "
            f"{apart[k]:.3g} rad apart ({len(off)} such rows). Both turn the body into NED, yaw "
            f"first, then pitch, then roll; give one of them."
        )
