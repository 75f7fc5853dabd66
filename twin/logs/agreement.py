"""Signals of a flight held against each other: rates and attitude, velocity and position, force and
velocity.

What each says of a window of half a second is compared, where both have samples in it: of noise
little is left there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..frames import rotation_vector, to_ned
from .columns import ACC, ACC_NED, GYRO, MAG, POS, QUAT, VEL, Columns
from .flight import Array, Finding

_G_M_S2 = 9.80665
_WINDOW_S = 0.5  # shorter in a short record
_LONGEST_S = 36_000.0
_FEWEST = 20  # windows
_STEPS = 0.02  # windows with a reset of the estimator: three in a minute and a half
_TURNED_RAD = 0.02
"""In a window, rms: of a gyroscope that is off by 2 deg/s at rest it is less."""
_BOTH_TURNED_RAD = 0.005
"""The same where both turn: of an attitude that is known to 0.2 deg it is less at rest."""
_MOVED_M = 0.02
_AGAINST_M = 0.003
"""In a window: noise hides that two signals are the same, and does not turn their sign."""
_ROWS = 1 << 12
"""Samples at a time, where an equation has many terms."""

Signals = dict[str, tuple[str, ...]]
"""Columns that are sampled together, by the name of their signal."""


def signals(table: Columns) -> Signals:
    """Columns that are sampled together and there, by the name of their signal."""
    groups: dict[str, tuple[str, ...]] = {
        **{g[0][:-2]: g for g in (ACC, GYRO, MAG, POS, VEL, QUAT, ACC_NED)},
        **{c: (c,) for c in ("baro_pa", "vbat_v", "ibat_a")},
        **{stem: tuple(c for c in table if c.startswith(f"{stem}_")) for stem in ("cmd", "rotor")},
    }
    return {
        name: columns
        for name, columns in groups.items()
        if columns and all(c in table and np.isfinite(table[c]).any() for c in columns)
    }


def samples(table: Columns, columns: Sequence[str]) -> tuple[Array, Array]:
    """Times, s, shape (n,), and values, shape (n, k), where all of the columns are there."""
    t_s = table["time"]
    values = np.empty((len(t_s), len(columns)))
    for k, column in enumerate(columns):
        values[:, k] = table[column]
    there = np.isfinite(values).all(axis=1) & np.isfinite(t_s)
    return (t_s, values) if there.all() else (t_s[there], values[there])


def _windows(*times_s: Array) -> Array:
    """Edges of the windows that all of these times cover, s."""
    start = max(float(t[0]) for t in times_s)
    end = min(float(t[-1]) for t in times_s)
    if not 0.0 < end - start < _LONGEST_S:
        return np.zeros(0)
    interval_s = max(float(np.median(np.diff(t))) for t in times_s)
    return np.arange(start, end, min(_WINDOW_S, max((end - start) / 40.0, 3.0 * interval_s)))


def _total(t_s: Array, values: Array, edges_s: Array) -> Array:
    """Integral of a signal over each window, shape (windows, k)."""
    total = np.zeros(len(t_s))
    found = np.empty((len(edges_s) - 1, values.shape[1]))
    for k, column in enumerate(values.T):
        np.cumsum(np.diff(t_s) * (column[1:] + column[:-1]) / 2.0, out=total[1:])
        found[:, k] = np.diff(np.interp(edges_s, t_s, total))
    return found


def _at(t_s: Array, values: Array, at_s: Array) -> Array:
    """Linear between the samples, shape (len(at_s), k)."""
    return np.stack([np.interp(at_s, t_s, v) for v in values.T], axis=1)


def _known(t_s: Array, edges_s: Array) -> NDArray[np.bool_]:
    """Whether a signal has a sample within 0.2 s of both ends of each window, and in between."""
    after = np.clip(np.searchsorted(t_s, edges_s), 1, len(t_s) - 1)
    near = (t_s[after] - t_s[after - 1]) < 0.25
    count = np.diff(np.searchsorted(t_s, edges_s))
    return np.asarray(near[1:] & near[:-1] & (count >= 2))


def _compared(a: Array, b: Array, good: NDArray[np.bool_]) -> tuple[float, float, int]:
    """Correlation about zero, ratio of sizes |b| / |a|, and number of windows."""
    a, b = a[good], b[good]
    size_a, size_b = float(np.sqrt(np.sum(a * a))), float(np.sqrt(np.sum(b * b)))
    if size_a == 0.0 or size_b == 0.0:
        return 1.0, 1.0, 0
    return float(np.sum(a * b)) / (size_a * size_b), size_b / size_a, len(a)


@dataclass(frozen=True, slots=True)
class Turns:
    """Rotations over windows, in the axes of the body.

    Attributes:
        by_attitude: From one attitude to the next, rad, shape (n, 3).
        by_gyro: Integral of the body rates, rad, shape (n, 3).
        lasting_s: Length of each window, s, shape (n,).
    """

    by_attitude: Array
    by_gyro: Array
    lasting_s: Array

    def without_steps(self) -> "Turns":
        """Without the 2 % in which they are farthest apart: resets of an estimator."""
        apart = np.linalg.norm(self.by_attitude - self.by_gyro, axis=1)
        order = np.argsort(apart, kind="stable")
        kept = np.sort(order[: len(order) - int(np.ceil(_STEPS * len(order)))])
        return Turns(self.by_attitude[kept], self.by_gyro[kept], self.lasting_s[kept])

    @property
    def residual_rad_s(self) -> Array:
        """Kinematic residual: median size of attitude minus gyroscope, as a rate, per axis, (3,).

        A median, so that resets of an estimator, which are steps of the attitude alone, do not
        count.
        """
        rates = (self.by_attitude - self.by_gyro) / self.lasting_s[:, None]
        return np.asarray(np.median(np.abs(rates), axis=0))


def turns(table: Columns, there: Signals | None = None) -> Turns | None:
    """How attitude and gyroscope say that the body turns; None where they do not say enough.

    Args:
        table: Flight table by column.
        there: Its signals, where they have been looked for already.
    """
    there = signals(table) if there is None else there
    if not {"gyro", "q"} <= there.keys():
        return None
    t_gyro, gyro = samples(table, GYRO)
    t_q, q = samples(table, QUAT)
    if min(len(t_gyro), len(t_q)) < _FEWEST:
        return None
    edges = _windows(t_gyro, t_q)
    if len(edges) < _FEWEST:
        return None
    near = np.clip(np.searchsorted(t_q, edges), 0, len(t_q) - 1)
    edges = t_q[near]  # attitudes as they are: those between are not on the way
    edges, first = np.unique(edges, return_index=True)
    q = q[near][first]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    turned = rotation_vector(q[1:], q[:-1])
    told = _total(t_gyro, gyro, edges)
    small = np.abs(told).max(axis=1) < 1.0  # beyond, angles do not add up
    if small.sum() < _FEWEST:
        small = np.abs(turned).max(axis=1) < 1.0
    good = _known(t_gyro, edges) & _known(t_q, edges) & small
    return Turns(turned[good], told[good], np.diff(edges)[good])


def doubt_turning(table: Columns, there: Signals) -> list[Finding]:
    """Body rates and attitude that do not turn together."""
    found = turns(table, there)
    if found is None or len(found.lasting_s) == 0:
        return []
    moving = float(np.sqrt(np.mean(found.by_gyro**2)))
    still = float(np.sqrt(np.mean(found.by_attitude**2)))
    kept = found.without_steps()
    every = np.ones(len(kept.lasting_s), dtype=np.bool_)
    together, ratio, n = _compared(kept.by_attitude, kept.by_gyro, every)
    if n < _FEWEST or (max(moving, still) < _TURNED_RAD and min(moving, still) < _BOTH_TURNED_RAD):
        return []
    if together > 0.5 and 0.5 < ratio < 2.0:
        return []
    unit = ""
    if together > 0.5:
        unit = ": is a unit wrong, or one of them scaled?"
    message = (
        f"does not turn with the gyroscope (correlation {together:.2f}, the gyroscope {ratio:.2g} "
        f"times as fast){unit or ': order w, x, y, z, body to NED, forward-right-down axes?'}"
    )
    return [Finding("error", "q", message)]


def doubt_velocity(table: Columns, there: Signals) -> list[Finding]:
    """Velocity that is not the slope of the position, axis by axis."""
    if not {"pos", "vel"} <= there.keys():
        return []
    t_pos, pos = samples(table, POS)
    t_vel, vel = samples(table, VEL)
    if min(len(t_pos), len(t_vel)) < _FEWEST:
        return []
    edges = _windows(t_pos, t_vel)
    if len(edges) < _FEWEST:
        return []
    way, told = np.diff(_at(t_pos, pos, edges), axis=0), _total(t_vel, vel, edges)
    good = _known(t_pos, edges) & _known(t_vel, edges)
    good &= np.abs(way).max(axis=1) < 50.0 * _median_way(way)  # resets of an estimator
    found = []
    for k, axis in enumerate("xyz"):
        together, ratio, n = _compared(way[:, k], told[:, k], good)
        if n < _FEWEST:
            continue
        moved = [float(np.std(some[good, k])) for some in (told, way)]
        if together < -0.5 and min(moved) > _AGAINST_M:
            message = (
                f"vel_{axis} and the slope of pos_{axis} have opposite signs (r = {together:.2f})"
            )
            found.append(Finding("error", "vel", message))
        elif max(moved) < _MOVED_M:
            continue
        elif together < 0.5 or not 0.5 < ratio < 2.0:
            message = (
                f"vel_{axis} is {ratio:.3g} times the slope of pos_{axis} (r = {together:.2f}): "
                "is one of them in mm or cm, or in another frame?"
            )
            found.append(Finding("error", "vel", message))
    return found


def _median_way(way: Array) -> float:
    """What a window usually covers, m, at least a little."""
    return max(float(np.median(np.abs(way).max(axis=1))), 0.02)


def _force_ned(t_acc: Array, acc: Array, t_q: Array, q: Array) -> Array:
    """Specific force in NED by the attitude next after each sample, shape as `acc`."""
    force_n = np.empty_like(acc)
    for first in range(0, len(acc), _ROWS):
        rows = slice(first, first + _ROWS)
        near = q[np.clip(np.searchsorted(t_q, t_acc[rows]), 0, len(t_q) - 1)]
        unit = near / np.linalg.norm(near, axis=1, keepdims=True)
        force_n[rows] = np.stack(to_ned(list(unit.T), list(acc[rows].T)), axis=1)
    return force_n


def doubt_force(table: Columns, there: Signals) -> list[Finding]:
    """Specific force that does not explain how the velocity changes."""
    if not {"acc", "q", "vel"} <= there.keys():
        return []
    t_acc, acc = samples(table, ACC)
    t_q, q = samples(table, QUAT)
    t_vel, vel = samples(table, VEL)
    if min(len(t_acc), len(t_q), len(t_vel)) < _FEWEST:
        return []
    edges = _windows(t_acc, t_q, t_vel)
    if len(edges) < _FEWEST:
        return []
    gained = np.diff(_at(t_vel, vel, edges), axis=0)
    del vel  # of a long flight each is a good part of what memory there is
    force_n = _force_ned(t_acc, acc, t_q, q)
    del acc, q
    told = _total(t_acc, force_n, edges)
    good = _known(t_acc, edges) & _known(t_q, edges) & _known(t_vel, edges)
    good &= np.abs(gained).max(axis=1) < 20.0 * np.diff(edges)
    if good.sum() < _FEWEST:
        return []
    weight = (gained[good] - told[good]) / np.diff(edges)[good, None]
    lacks = float(np.median(weight[:, 2])) - _G_M_S2
    found = []
    if abs(lacks) > 3.0:
        message = (
            f"with the attitude it leaves {lacks + _G_M_S2:.1f} m/s^2 down to explain the "
            f"velocity, gravity has {_G_M_S2:.1f}: without gravity, of another sign, in another "
            "unit, or an attitude that is not the body's?"
        )
        found.append(Finding("error", "acc", message))
    level = (gained[:, :2], told[:, :2])
    together, ratio, n = _compared(*level, good)
    if n >= _FEWEST and np.std(level[0][good]) > 0.15 and together < 0.3:
        message = (
            f"does not push the way that the velocity changes (correlation {together:.2f}, "
            f"{ratio:.2g} times as much): another frame, sign, unit or clock?"
        )
        found.append(Finding("error", "acc", message))
    return found
