"""Consistency of flight signals: rates and attitude, velocity and position, force and velocity.

Signals are compared by their integrals over windows of half a second in which both have samples;
integration suppresses most of the noise.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..frames import rotation_vector, to_body, to_ned
from ..physics.sensors.table import SENSORS
from ..vehicle import GRAVITY_M_S2
from .columns import ACC, ACC_NED, GYRO, MAG, POS, QUAT, VEL, Columns
from .flight import Array, Finding
from .samples import interpolated

_WINDOW_S = 0.5  # length of a window; shorter in a short record
_LONGEST_S = 36_000.0  # longest record that is compared; limits the number of windows
_FEWEST = 20  # smallest number of windows
_STEPS = 0.02  # share of windows with a reset of the estimator: three in a minute and a half
_TURNED_RAD = 0.02
"""Least rms rotation per window; a gyroscope with a bias of 2 deg/s at rest shows less."""
_BOTH_TURNED_RAD = 0.005
"""Least rms rotation per window in both signals; an attitude accurate to 0.2 deg shows less at
rest."""
_MOVED_M = 0.02  # least displacement per window of a moving position; below it is noise
_AGAINST_M = 0.003
"""Least rms change per window for a sign test: noise hides a correlation but does not invert it."""
_ROWS = 1 << 12
"""Samples per block, where an equation has many terms."""

_SAME, _OTHER = 0.8, 0.5
"""Correlation from which two axes are the same motion, and below which they are different ones."""
_SCALES = (0.45, 2.2)
"""Ratio of rms values of the same motion outside of which one axis is scaled wrongly. All recorded
logs at hand (docs/results/axis_faults.md) have 0.66 to 1.93 where the correlation is above
`_SAME`."""
_SURE = 4.0
"""Standard errors by which a correlation of opposite sign must differ from zero."""
_FAR = 5.0
"""Windows this many times the median distance from the median are falls or resets."""
_TURNING_RAD = 0.002
"""Rotation per window, from the median, from which an axis of the gyroscope is tested by itself."""
_MOUNTED_RAD = np.radians(15.0)
"""Mounting angle of the IMU about body z from which it is reported; recorded logs have at most 6
degrees."""
_PUSHED_M_S2 = 0.1
"""Change of the acceleration from which an axis is tested; below it levelling and wind dominate."""
_HEADINGS = 0.3
"""Rms variation of the heading direction from which compass axes are tested: +-20 degrees."""
_TILTS = 0.05
"""Rms variation of the vertical axis, which observes the level field through tilts."""
_LIKE, _UNLIKE = 0.1, 0.2
"""Share of compass variance unexplained by one constant field: consistent up to the first value,
not from the second."""

Signals = dict[str, tuple[str, ...]]
"""Columns that are sampled together, by the name of their signal."""


def signals(table: Columns) -> Signals:
    """Columns of this table that are sampled together, by the name of their signal."""
    vectors = [s.columns for s in SENSORS if len(s.columns) > 1]
    scalars = [s.columns[0] for s in SENSORS if len(s.columns) == 1]
    groups: dict[str, tuple[str, ...]] = {
        **{g[0][:-2]: g for g in (*vectors, POS, VEL, QUAT, ACC_NED)},
        **{c: (c,) for c in (*scalars, "vbat_v", "ibat_a")},
        **{stem: tuple(c for c in table if c.startswith(f"{stem}_")) for stem in ("cmd", "rotor")},
    }
    return {
        name: columns
        for name, columns in groups.items()
        if columns and all(c in table and np.isfinite(table[c]).any() for c in columns)
    }


def samples(table: Columns, columns: Sequence[str]) -> tuple[Array, Array]:
    """Times, s, shape (n,), and values, shape (n, k), of the rows in which all of the columns have
    a sample."""
    t_s = table["time"]
    values = np.empty((len(t_s), len(columns)))
    for k, column in enumerate(columns):
        values[:, k] = table[column]
    there = np.isfinite(values).all(axis=1) & np.isfinite(t_s)
    return (t_s, values) if there.all() else (t_s[there], values[there])


def _windows(*times_s: Array) -> Array:
    """Edges of the windows within the time span that all of these series share, s."""
    start = max(float(t[0]) for t in times_s)
    end = min(float(t[-1]) for t in times_s)
    if not 0.0 < end - start < _LONGEST_S:
        return np.zeros(0)
    interval_s = max(float(np.median(np.diff(t))) for t in times_s)
    return np.arange(start, end, min(_WINDOW_S, max((end - start) / 40.0, 3.0 * interval_s)))


def window_integrals(t_s: Array, values: Array, edges_s: Array) -> Array:
    """Integral of a signal over each window, shape (windows, k)."""
    total = np.zeros(len(t_s))
    found = np.empty((len(edges_s) - 1, values.shape[1]))
    for k, column in enumerate(values.T):
        np.cumsum(np.diff(t_s) * (column[1:] + column[:-1]) / 2.0, out=total[1:])
        found[:, k] = np.diff(np.interp(edges_s, t_s, total))
    return found


def _known(t_s: Array, edges_s: Array) -> NDArray[np.bool_]:
    """Whether a signal has a sample within 0.2 s of both ends of each window, and in between."""
    after = np.clip(np.searchsorted(t_s, edges_s), 1, len(t_s) - 1)
    near = (t_s[after] - t_s[after - 1]) < 0.25
    count = np.diff(np.searchsorted(t_s, edges_s))
    return np.asarray(near[1:] & near[:-1] & (count >= 2))


def _compared(a: Array, b: Array, good: NDArray[np.bool_]) -> tuple[float, float, int]:
    """Correlation about zero, ratio of rms values |b| / |a|, and number of windows."""
    a, b = a[good], b[good]
    size_a, size_b = float(np.sqrt(np.sum(a * a))), float(np.sqrt(np.sum(b * b)))
    if size_a == 0.0 or size_b == 0.0:
        return 1.0, 1.0, 0
    return float(np.sum(a * b)) / (size_a * size_b), size_b / size_a, len(a)


def axis_faults(reference: Array, measured: Array, least: float) -> Iterator[str]:
    """Texts on axes of a vector signal that disagree with a reference of the same motion.

    Args:
        reference: Mean or integral over windows, shape (n, 3).
        measured: Mean or integral over windows of the tested signal, shape (n, 3).
        least: Deviation of the reference from its median from which an axis is tested; a fifth of
            the windows must exceed it, so that no single fall decides.
    """
    if len(reference) < _FEWEST:
        return
    away = np.abs(reference - np.median(reference, axis=0))
    usual = np.quantile(away, 0.8, axis=0)
    apart = np.linalg.norm(reference - measured, axis=1)
    within = apart <= np.quantile(apart, 1 - _STEPS)
    within &= np.all(away <= _FAR * np.maximum(usual, least), axis=1)
    a, b = (v[within] - v[within].mean(axis=0) for v in (reference, measured))
    size_a, size_b = (np.sqrt(np.mean(v * v, axis=0)) for v in (a, b))
    with np.errstate(divide="ignore", invalid="ignore"):
        r = np.nan_to_num((a.T @ b) / len(a) / np.outer(size_a, size_b))
    moved = usual > least
    swapped = set[int]()
    for i, j in ((0, 1), (0, 2), (1, 2)):
        own, crossed = np.abs([r[i, i], r[j, j]]), np.abs([r[i, j], r[j, i]])
        if moved[i] and moved[j] and own.max() < _OTHER and crossed.min() > _SAME:
            swapped |= {i, j}
            yield f"_{'xyz'[i]} and _{'xyz'[j]} are swapped (r = {r[i, j]:.2f}, {r[j, i]:.2f})"
    for i in (k for k in range(3) if moved[k] and k not in swapped):
        ratio = size_b[i] / size_a[i]
        if r[i, i] < -max(_OTHER, _SURE / np.sqrt(len(a))):
            yield f"_{'xyz'[i]} has the opposite sign (r = {r[i, i]:.2f})"
        elif r[i, i] > _SAME and not _SCALES[0] < ratio < _SCALES[1]:
            yield f"_{'xyz'[i]} is {ratio:.2g} times as large (r = {r[i, i]:.2f})"


@dataclass(frozen=True, slots=True)
class Turns:
    """Rotations over windows, in the axes of the body.

    Attributes:
        by_attitude: Rotation from one attitude to the next, rad, shape (n, 3).
        by_gyro: Integral of the body rates, rad, shape (n, 3).
        lasting_s: Length of each window, s, shape (n,).
    """

    by_attitude: Array
    by_gyro: Array
    lasting_s: Array

    def without_steps(self) -> "Turns":
        """The rotations without the 2 % of windows with the largest difference: resets of an
        estimator."""
        apart = np.linalg.norm(self.by_attitude - self.by_gyro, axis=1)
        order = np.argsort(apart, kind="stable")
        nearest = np.sort(order[: len(order) - int(np.ceil(_STEPS * len(order)))])
        return Turns(self.by_attitude[nearest], self.by_gyro[nearest], self.lasting_s[nearest])

    @property
    def residual_rad_s(self) -> Array:
        """Kinematic residual: median size of attitude minus gyroscope, as a rate, per axis, (3,).

        A median, so that resets of an estimator, which are steps of the attitude alone, do not
        count.
        """
        rates = (self.by_attitude - self.by_gyro) / self.lasting_s[:, None]
        return np.asarray(np.median(np.abs(rates), axis=0))


def turns(table: Columns, there: Signals | None = None) -> Turns | None:
    """Rotations by attitude and by gyroscope; None where too few windows show rotation.

    Args:
        table: Flight table by column.
        there: Signals of the table, where they are known already.
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
    edges = t_q[near]  # logged attitudes, not interpolated ones
    edges, first = np.unique(edges, return_index=True)
    q = q[near][first]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    turned = rotation_vector(q[1:], q[:-1])
    integrated = window_integrals(t_gyro, gyro, edges)
    small = np.abs(integrated).max(axis=1) < 1.0  # beyond, rotation angles do not add up
    if small.sum() < _FEWEST:
        small = np.abs(turned).max(axis=1) < 1.0
    good = _known(t_gyro, edges) & _known(t_q, edges) & small
    return Turns(turned[good], integrated[good], np.diff(edges)[good])


def mounted_at(turned: Turns) -> float:
    """Mounting angle of a gyroscope about body z against the attitude, rad, -pi to pi; 0 where no
    such rotation makes both agree about each of the level axes."""
    shown, real = turned.by_gyro, turned.by_attitude
    (gx, gy, gz), (ax, ay, az) = shown.T, real.T
    angle = float(np.arctan2(gx @ ay - gy @ ax, gx @ ax + gy @ ay))
    c, s = np.cos(angle), np.sin(angle)
    back = (c * gx - s * gy, ax), (s * gx + c * gy, ay)
    sizes = [(float(np.linalg.norm(g)), float(np.linalg.norm(a))) for g, a in back]
    alike = all(
        g @ a > _SAME * n * m > 0.0 and _SCALES[0] < n / m < _SCALES[1]
        for (g, a), (n, m) in zip(back, sizes, strict=True)
    )
    return angle if alike and gz @ az >= 0.0 else 0.0


def doubt_turning(table: Columns, there: Signals) -> list[Finding]:
    """Findings where body rates and attitude do not agree."""
    found = turns(table, there)
    if found is None or len(found.lasting_s) == 0:
        return []
    moving = float(np.sqrt(np.mean(found.by_gyro**2)))
    still = float(np.sqrt(np.mean(found.by_attitude**2)))
    steady = found.without_steps()
    every = np.ones(len(steady.lasting_s), dtype=np.bool_)
    together, ratio, n = _compared(steady.by_attitude, steady.by_gyro, every)
    little = max(moving, still) < _TURNED_RAD and min(moving, still) < _BOTH_TURNED_RAD
    angle = 0.0 if little else mounted_at(steady)
    if abs(angle) > _MOUNTED_RAD:
        message = (
            f"turned by {np.degrees(angle):.0f} degrees about body down against the turning of the "
            "attitude: is the IMU mounted at this angle? Turn gyro and acc back by it."
        )
        return [Finding("error", "gyro", message)]
    if n < _FEWEST or little or (together > 0.5 and 0.5 < ratio < 2.0):
        return [
            Finding("error", "gyro", f"against the turning of the attitude, gyro{fault}")
            for fault in axis_faults(found.by_attitude, found.by_gyro, _TURNING_RAD)
        ]
    unit = ""
    if together > 0.5:
        unit = ": is a unit wrong, or one of them scaled?"
    message = (
        f"does not turn with the gyroscope (correlation {together:.2f}, the gyroscope {ratio:.2g} "
        f"times as fast){unit or ': order w, x, y, z, body to NED, forward-right-down axes?'}"
    )
    return [Finding("error", "q", message)]


def doubt_velocity(table: Columns, there: Signals) -> list[Finding]:
    """Findings where the velocity is not the slope of the position, axis by axis."""
    if not {"pos", "vel"} <= there.keys():
        return []
    t_pos, pos = samples(table, POS)
    t_vel, vel = samples(table, VEL)
    if min(len(t_pos), len(t_vel)) < _FEWEST:
        return []
    edges = _windows(t_pos, t_vel)
    if len(edges) < _FEWEST:
        return []
    way, integrated = (
        np.diff(interpolated(edges, t_pos, pos), axis=0),
        window_integrals(t_vel, vel, edges),
    )
    good = _known(t_pos, edges) & _known(t_vel, edges)
    good &= np.abs(way).max(axis=1) < 50.0 * _median_way(way)  # resets of an estimator
    found = []
    for k, axis in enumerate("xyz"):
        together, ratio, n = _compared(way[:, k], integrated[:, k], good)
        if n < _FEWEST:
            continue
        moved = [float(np.std(some[good, k])) for some in (integrated, way)]
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
    """Median displacement per window, m, with a small lower bound."""
    return max(float(np.median(np.abs(way).max(axis=1))), 0.02)


def _force_ned(t_acc: Array, acc: Array, t_q: Array, q: Array) -> Array:
    """Specific force in NED, rotated by the attitude nearest to each sample, shape as `acc`."""
    force_n = np.empty_like(acc)
    for first in range(0, len(acc), _ROWS):
        rows = slice(first, first + _ROWS)
        near = q[np.clip(np.searchsorted(t_q, t_acc[rows]), 0, len(t_q) - 1)]
        unit = near / np.linalg.norm(near, axis=1, keepdims=True)
        force_n[rows] = np.stack(to_ned(list(unit.T), list(acc[rows].T)), axis=1)
    return force_n


def doubt_force(table: Columns, there: Signals) -> list[Finding]:
    """Findings where specific force does not explain the change of velocity."""
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
    gained = np.diff(interpolated(edges, t_vel, vel), axis=0)
    del vel  # frees memory: in a long flight each is a large array
    read = window_integrals(t_acc, acc, edges)
    force_n = _force_ned(t_acc, acc, t_q, q)
    del acc
    integrated = window_integrals(t_acc, force_n, edges)
    good = _known(t_acc, edges) & _known(t_q, edges) & _known(t_vel, edges)
    good &= np.abs(gained).max(axis=1) < 20.0 * np.diff(edges)
    if good.sum() < _FEWEST:
        return []
    weight = (gained[good] - integrated[good]) / np.diff(edges)[good, None]
    lacks = float(np.median(weight[:, 2])) - GRAVITY_M_S2
    found = []
    if abs(lacks) > 3.0:
        message = (
            f"with the attitude it leaves {lacks + GRAVITY_M_S2:.1f} m/s^2 down to explain the "
            f"velocity, gravity has {GRAVITY_M_S2:.1f}: without gravity, of another sign, in "
            "another unit, or an attitude that is not the body's?"
        )
        found.append(Finding("error", "acc", message))
    level = (gained[:, :2], integrated[:, :2])
    together, ratio, n = _compared(*level, good)
    if n >= _FEWEST and np.std(level[0][good]) > 0.15 and together < 0.3:
        message = (
            f"does not push the way that the velocity changes (correlation {together:.2f}, "
            f"{ratio:.2g} times as much): another frame, sign, unit or clock?"
        )
        found.append(Finding("error", "acc", message))
    if not found:
        lasting = np.diff(edges)[:, None]
        pushed = gained / lasting - [0.0, 0.0, GRAVITY_M_S2]
        pushed_b = _in_body((edges[1:] + edges[:-1]) / 2, pushed, t_q, q)
        read = read / lasting
        found += [
            Finding("error", "acc", f"against the change of the velocity, acc{fault}")
            for fault in axis_faults(pushed_b[good], read[good], _PUSHED_M_S2)
        ]
    return found


def _in_body(t_s: Array, vector_n: Array, t_q: Array, q: Array) -> Array:
    """Vectors in body axes, rotated by the attitude nearest to each time, shape as `vector_n`."""
    near = q[np.clip(np.searchsorted(t_q, t_s), 0, len(t_q) - 1)]
    unit = near / np.linalg.norm(near, axis=1, keepdims=True)
    return np.stack(to_body(list(unit.T), list(vector_n.T)), axis=1)


def doubt_compass(table: Columns, there: Signals) -> list[Finding]:
    """Findings where magnetometer axes do not measure one constant field of the Earth.

    Each axis alone is fitted by a field and a bias, m_k = (R_bn m_n)_k + b_k; the level parts of
    the fields of two axes must agree. Axes are swapped where one field fits them all when swapped
    and none fits them as they are.
    """
    if not {"mag", "q"} <= there.keys():
        return []
    t_mag, mag = samples(table, MAG)
    t_q, q = samples(table, QUAT)
    if min(len(t_mag), len(t_q)) < _FEWEST:
        return []
    few = slice(None, None, max(len(t_mag) // _ROWS, 1))
    t_mag, mag = t_mag[few], mag[few] - mag[few].mean(axis=0)
    axes = [_in_body(t_mag, np.tile(e, (len(t_mag), 1)), t_q, q) for e in np.eye(3)]
    rows = np.stack(axes, axis=-1)  # (n, body, NED)
    rows -= rows.mean(axis=0)

    def fitted(x: Array, y: Array) -> tuple[Array, float]:
        """Least-squares field, and the share of the variance that it does not explain."""
        field = np.linalg.lstsq(x, y, rcond=1e-2)[0]
        share = float(np.sum((y - x @ field) ** 2)) / max(float(y @ y), 1e-300)
        return np.asarray(field, dtype=np.float64), share

    turned = np.sqrt(np.mean(np.sum(rows[:, :, :2] ** 2, axis=2), axis=0))
    if turned[0] < _HEADINGS:
        return []
    every = rows.reshape(-1, 3)
    if fitted(every, mag.ravel())[1] > _UNLIKE:
        for swap in ([1, 0, 2], [2, 1, 0], [0, 2, 1]):
            if fitted(every, mag[:, swap].ravel())[1] < _LIKE:
                axes_of = " and ".join(f"mag_{'xyz'[k]}" for k in range(3) if swap[k] != k)
                return [Finding("error", "mag", f"as the attitude turns, {axes_of} are swapped")]
    fields: dict[str, Array] = {}
    for k, axis in enumerate("xyz"):
        field, left = fitted(rows[:, k], mag[:, k])
        if left < _LIKE and turned[k] > (_HEADINGS if axis != "z" else _TILTS):
            fields[axis] = field[:2]
    found = []
    for one, other in (("x", "y"), ("x", "z"), ("y", "z")):
        if not {one, other} <= fields.keys():
            continue
        a, b = fields[one], fields[other]
        size = [float(np.linalg.norm(v)) for v in (a, b)]
        same, ratio = float(a @ b) / (size[0] * size[1]), size[1] / size[0]
        if same < -_SAME:
            message = f"mag_{one} or mag_{other} has the opposite sign"
        elif same > _SAME and not _SCALES[0] < ratio < _SCALES[1]:
            message = f"mag_{other} is {ratio:.2g} times as large as mag_{one}"
        else:
            continue
        found.append(Finding("error", "mag", f"as the attitude turns, {message}"))
    return found
