"""Consistency of commands, rotor speeds and motion of a flight, and with the airframe.

A wrong order, sign or unit of the motors becomes a wrong mass or inertia in later estimates. Three
relations are tested, each only where the flight excites it:

* speed of rotor i follows the command of motor i better than that of another motor;
* angular acceleration follows the moments of the commands, by positions and directions of rotors;
* specific force follows the sum of the commands, which hover between 0.1 and 0.95.

Signals are means over cells of 20 ms or longer, with variations slower than 2 s removed; a lag of
up to 0.3 s (motor, telemetry) is estimated. One labelling explains a channel with R^2; it is
doubted where another one explains it far better: `_CARRIES`, `_UNEXPLAINED`, `_HALF`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
import scipy
from numpy.typing import NDArray

from ..vehicle.layouts import Layout
from .agreement import Signals, samples, window_integrals
from .columns import ACC, GYRO, Columns
from .flight import Array, Finding
from .lags import TINY, LaggedMoments

_CARRIES = 0.3
"""R^2 from which a channel is informative on the motors."""
_UNEXPLAINED = 1.2
"""Ratio of the variance unexplained by the labelling of the log to that unexplained by another one,
from which the first is doubted, if its R^2 is also at most `_HALF` of the other's on a channel."""
_HALF = 0.5  # see `_UNEXPLAINED`
_CLEARLY = 1.5
"""The ratio that suffices alone: neighbouring motors of a hexarotor have nearly equal effects.

Chosen on the recorded flights of rflysimdt, px4_negatives, quiver_pt1, nanobench,
crazyflie_motor_delay and rflymad_sil (docs/dev/decisions/motor_checks.md): none is doubted. Lowered
from 2 on a simulated octorotor of the tests, which is therefore no evidence for it.
"""
_CELL_S = 0.02  # shortest cell over which signals are averaged
_MARGIN_S = 1.0
"""Margin around the cells, for the lags."""
_SLOW_S = 2.0  # slower variations are removed
_LAGS_S = (-0.04, -0.02, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2, 0.3)
"""Candidate lags of motor and telemetry together."""
_FEWEST, _MOST = 200, 30_000
"""Smallest and largest number of cells."""
_MOST_EXHAUSTIVE, _LIKELY = 8, 50
"""Largest number of motors of which every order is tested; number of orders tested at every lag."""
_ALIKE = 0.03
"""Difference of R^2 below which two labellings cannot be distinguished."""
_FEW_CHANGES = 2
"""Largest number of changes (two motors exchanged, a sign) for one of several equal labellings to
be named."""
_STILL = 0.2
"""Least rms of a command over the median of all motors; recorded flights have 0.8 or more."""
_FLOWN = 0.5
"""Least mean command in flight, as a share of its upper quartile."""
_HOVER = 0.1, 0.95
"""Plausible command in hover; recorded flights: 0.13 (ekf_failure) to 0.91
(B3_figure8_medium_rep2)."""
_ELASTICITY = 0.35, 5.0
"""Plausible relative thrust per relative command: 2 for a speed proportional to the command, 1 for
a thrust; recorded flights have 0.8 to 1.6."""
_AXES = "xyz"  # body axes


@dataclass(frozen=True, slots=True)
class _Cells:
    """Signals as means over cells of time.

    Attributes:
        edges_s: Edges of the cells, shape (cells + 1,).
        flown: Whether a cell and its surroundings are in the air, shape (cells,).
    """

    edges_s: Array
    flown: NDArray[np.bool_]

    @property
    def width_s(self) -> float:
        return float(self.edges_s[1] - self.edges_s[0])

    def means(self, t_s: Array, values: Array, lag_s: float = 0.0) -> Array:
        """Mean of each column over each cell, `lag_s` before it, shape (cells, k)."""
        near = slice(*np.searchsorted(t_s, self.edges_s[[0, -1]] + (-_MARGIN_S, _MARGIN_S)))
        t_s, values = t_s[near], values[near]
        return window_integrals(t_s, values, self.edges_s - lag_s) / self.width_s

    def fast(self, values: Array) -> Array:
        """Values without variations slower than two seconds, for cells in the air, shape (cells in
        the air, k)."""
        wide = max(round(_SLOW_S / self.width_s), 3)
        quick = values - scipy.ndimage.uniform_filter1d(values, wide, axis=0, mode="nearest")
        chosen = quick[self.flown]
        return np.asarray(chosen - chosen.mean(axis=0))


def doubt_motors(table: Columns, there: Signals, layout: Layout | None) -> list[Finding]:
    """Findings on order, signs and unit of the motors that contradict the flight.

    Args:
        table: Flight table by column.
        there: Signals of the table, from `agreement.signals`.
        layout: Positions and directions of rotation of the rotors by the log or the vehicle; None:
            not known.
    """
    if "cmd" not in there:
        return []
    found = doubt_rotors(table, there)
    if layout is not None and layout.count == len(there["cmd"]):
        found += doubt_moments(table, there, layout)
    return found + doubt_thrust(table, there)


def _cells(table: Columns, there: Signals, *others: str) -> _Cells | None:
    """Cells over the time that commands and others have in common; None where it is too short."""
    t_cmd, cmd = samples(table, there["cmd"])
    times = [t_cmd, *(samples(table, there[name])[0] for name in others)]
    if min(map(len, times)) < _FEWEST // 2:
        return None
    width_s = max(_CELL_S, *(float(np.median(np.diff(t))) for t in times))
    mean = cmd.mean(axis=1)
    level = _FLOWN * float(np.quantile(mean, 0.75))
    begin = max(*(float(t[0]) for t in times), float(t_cmd[np.argmax(mean > level)]) - _SLOW_S)
    end = min(*(float(t[-1]) for t in times), begin + _MOST * width_s)
    begin, end = begin + _LAGS_S[-1], end + _LAGS_S[0]
    if not level > 0.0 or not end - begin > _FEWEST * width_s:
        return None
    edges = np.arange(begin, end, width_s)
    cells = _Cells(edges, np.ones(len(edges) - 1, dtype=np.bool_))
    lifted = (cells.means(t_cmd, mean[:, None])[:, 0] > level).astype(np.float64)
    wide = max(round(_SLOW_S / width_s), 3)
    flown = scipy.ndimage.uniform_filter1d(lifted, wide, mode="nearest") > 1.0 - 0.5 / wide
    for t in times:  # without cells in a pause of a signal
        flown &= np.diff(np.searchsorted(t, edges)) > 0 if width_s > _CELL_S else _near(t, edges)
    return _Cells(edges, flown) if np.count_nonzero(flown) >= _FEWEST else None


def _near(t_s: Array, edges_s: Array) -> NDArray[np.bool_]:
    """Whether a signal has a sample near each cell, shape (cells,)."""
    after = np.clip(np.searchsorted(t_s, edges_s[:-1]), 1, len(t_s) - 1)
    return np.asarray(t_s[after] - t_s[after - 1] < 5.0 * _CELL_S)


def _moments(cells: _Cells, inputs: tuple[Array, Array], channels: Array) -> LaggedMoments:
    """Second moments of inputs (times and values) at every lag and of the channels."""
    lagged = [cells.fast(cells.means(*inputs, lag_s)) for lag_s in _LAGS_S]
    fast = cells.fast(channels)
    return LaggedMoments.of(lagged, fast, [np.arange(len(fast))]).over(slice(None))


def _beaten(own: Array, other: Array) -> bool:
    """Whether another labelling explains channels far better than that of the log.

    Args:
        own: R^2 of the log's labelling by channel, negative for an inverted effect.
        other: R^2 of the other labelling by channel.
    """
    carries = other >= _CARRIES
    if not carries.any():
        return False
    own, other = own[carries], other[carries]
    ratio = float(np.prod((1.0 - own) / np.maximum(1.0 - other, TINY)))
    return ratio >= _CLEARLY or (ratio >= _UNEXPLAINED and bool((own <= _HALF * other).any()))


# -- rotor speeds behind commands -------------------------------------------------------------

_MISNUMBERED = "left out: speeds do not follow the commands of their own motors"
"""Start of the text of a finding, by which it is recognised."""


def is_misnumbered(finding: Finding) -> bool:
    """Whether a finding states that rotor speeds are those of other motors."""
    return finding.where == "rotor" and finding.message.startswith(_MISNUMBERED)


def doubt_rotors(table: Columns, there: Signals) -> list[Finding]:
    """Findings on speeds that follow another motor's command, by the differences from the mean
    motor."""
    if not {"cmd", "rotor"} <= there.keys() or len(there["cmd"]) != len(there["rotor"]):
        return []
    cells = _cells(table, there, "rotor")
    if cells is None:
        return []
    t_cmd, cmd = samples(table, there["cmd"])
    speeds = cells.means(*samples(table, there["rotor"]))
    apart = (t_cmd, cmd - cmd.mean(axis=1, keepdims=True))
    moments = _moments(cells, apart, speeds - speeds.mean(axis=1, keepdims=True))
    n = len(there["cmd"])
    r2 = np.stack([moments.r2(np.eye(n), rotor) for rotor in range(n)], axis=1)
    labels = [scipy.optimize.linear_sum_assignment(-each)[1] for each in r2]
    best = max(range(len(r2)), key=lambda k: float(r2[k, range(n), labels[k]].sum()))
    moved = np.flatnonzero(labels[best] != np.arange(n))
    if not len(moved):
        return []
    motors = labels[best][moved]
    own = r2[:, moved, moved].mean(axis=1).max()
    other = r2[best, moved, motors].mean()
    if not _beaten(np.array([own]), np.array([other])):
        return []
    text = ", ".join(
        f"rotor_{k + 1} follows cmd_{m + 1}" for k, m in zip(moved, motors, strict=True)
    )
    message = (
        f"{_MISNUMBERED}: {text} (R2 {other:.2f}, with their own {max(own, 0.0):.2f}). Give each "
        "speed the number of the motor whose command it follows, or correct the order of the "
        "commands"
    )
    return [Finding("error", "rotor", message)]


# -- angular acceleration behind commands -----------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Labelling:
    """A possible meaning of the commands other than that of the log.

    Attributes:
        weights: Moments about x, y, z per command, up to a factor each, shape (3, n).
        text: Description of the labelling.
        changes: Number of changes from the log's labelling.
    """

    weights: Array
    text: str
    changes: int = 1


def moments_of(layout: Layout) -> Array:
    """Moments about x, y, z of unit thrust of each rotor, each up to a factor, shape (3, n)."""
    forward, right = layout.position[:, 0], layout.position[:, 1]
    return np.stack([-right, forward, -layout.direction])


def _labellings(allocation: Array, hint: Array, at: LaggedMoments) -> Iterator[_Labelling]:
    """All tested labellings: other orders, signs, and a command without a motor.

    Args:
        allocation: Moments of the rotors by the layout, shape (3, n).
        hint: Weights of an unconstrained regression, shape (3, n).
        at: Moments at the lag of that regression.
    """
    n = allocation.shape[1]
    for labels in _orders(allocation, hint, at):
        moved = [k for k in range(n) if labels[k] != k]
        text = ", ".join(f"cmd_{k + 1} drove rotor {labels[k] + 1}" for k in moved)
        yield _Labelling(allocation[:, labels], text, len(moved))
    yield _Labelling(-allocation, "every command were reversed (full power at its lowest value)")
    for k in range(n):
        for factor, text in ((-1.0, "were reversed"), (0.0, "drove no rotor")):
            changed = allocation.copy()
            changed[:, k] *= factor
            yield _Labelling(changed, f"cmd_{k + 1} {text}")
    for axis, why in enumerate(("left and right", "front and rear", "the senses of rotation")):
        turned = allocation.copy()
        turned[axis] *= -1.0
        text = f"{why} were exchanged, or the gyroscope's {_AXES[axis]} axis turned"
        yield _Labelling(turned, text)


def _orders(allocation: Array, hint: Array, at: LaggedMoments) -> NDArray[np.intp]:
    """The likeliest other orders of the motors, shape (orders, n): from all orders for up to eight
    motors; for more, all exchanges of two and the order that regression suggests."""
    n = allocation.shape[1]
    if n <= _MOST_EXHAUSTIVE:
        orders = np.array(list(permutations(range(n))))[1:]
    else:
        pairs = np.tile(np.arange(n), (n * (n - 1) // 2, 1))
        for row, (one, two) in zip(pairs, combinations(range(n), 2), strict=True):
            row[[one, two]] = two, one
        unit = allocation / np.maximum(np.linalg.norm(allocation, axis=1, keepdims=True), TINY)
        orders = np.vstack([pairs, scipy.optimize.linear_sum_assignment(-(hint.T @ unit))[1]])
    total = sum(at.r2(allocation[axis][orders], axis)[0] for axis in range(3))
    likely = np.argsort(-np.asarray(total))[:_LIKELY]
    moved = (orders[likely] != np.arange(n)).any(axis=1)
    return np.asarray(orders[likely][moved])


def doubt_moments(table: Columns, there: Signals, layout: Layout) -> list[Finding]:
    """Findings on angular acceleration that does not follow the moments of the commands.

    Roll and pitch share a lag, that of thrust; yaw has its own, as the reaction to a rotor's
    acceleration precedes that to its drag.
    """
    if "gyro" not in there:
        return []
    cells = _cells(table, there, "gyro")
    if cells is None:
        return []
    rates = cells.means(*samples(table, GYRO))
    moments = _moments(
        cells, samples(table, there["cmd"]), np.gradient(rates, cells.width_s, axis=0)
    )
    allocation = moments_of(layout)
    r2 = np.stack([moments.r2(allocation[a], a) for a in range(3)], axis=1)  # lag, axis
    free, at, hint = _regressed(moments)
    if not _beaten(np.array([*r2[r2[:, :2].sum(axis=1).argmax(), :2], r2[:, 2].max()]), free):
        return []
    others = list(_labellings(allocation, hint, at))
    every = np.stack([allocation, *(o.weights for o in others)])
    r2 = np.stack([moments.r2(every[:, a], a) for a in range(3)], axis=1)  # lag, axis, label
    level = r2[:, :2].sum(axis=1)
    lag = level.argmax(axis=0)  # for each labelling
    yaw = r2[:, 2].max(axis=0)
    total = level.max(axis=0) + yaw
    best = int(total.argmax())
    if not best:
        return []
    own, other = (np.array([*r2[lag[k], :2, k], yaw[k]]) for k in (0, best))
    if not _beaten(own, other):
        return []
    axes = np.flatnonzero(other >= _CARRIES)
    reached = np.stack([*(np.take_along_axis(r2[:, a], lag[None], axis=0)[0] for a in (0, 1)), yaw])
    alike = (np.abs(reached[axes] - other[axes, None]) < _ALIKE).all(axis=0)
    measured = ", ".join(
        f"{_AXES[a]} {max(own[a], 0.0):.2f} as stated, {other[a]:.2f} so" for a in axes
    )
    changed = np.array([0, *(o.changes for o in others)])
    least = alike & (changed == changed[alike].min())
    sure = {0, 1} <= {*axes.tolist()} and changed[alike].min() <= _FEW_CHANGES
    if np.count_nonzero(least) == 1 and (sure or alike.sum() == 1):
        text = others[int(np.argmax(least)) - 1].text
        several = ", the least of several changes that would do" if alike.sum() > 1 else ""
        message = f"the aircraft turns as if {text}{several} (R2 about {measured})"
    else:
        message = (
            "the aircraft does not turn as its commands would have it, and several "
            f"other orders or signs of them would do (R2 about {measured})"
        )
    message += (
        f". Its rotors are those of {layout.source}: correct their order or directions, or that "
        "of the outputs"
    )
    return [Finding("error", "cmd", message)]


def _regressed(moments: LaggedMoments) -> tuple[Array, LaggedMoments, Array]:
    """R^2 by channel of an unconstrained regression on all commands, roll and pitch at one lag; the
    moments at that lag, and the weights there, of unit norm, shape (3, n)."""
    weights, explained = moments.regressed()
    r2 = explained / np.maximum(moments.channels, TINY)
    lag = int(r2[:, :2].sum(axis=1).argmax())
    hint = weights[lag].T / np.maximum(np.linalg.norm(weights[lag], axis=0), TINY)[:, None]
    return np.array([*r2[lag, :2], r2[:, 2].max()]), moments.at(lag), hint


# -- specific force behind commands -----------------------------------------------------------


def _doubt_still(commands: Array) -> list[Finding]:
    """Finding on a command that does not vary as the others do, from fast parts, shape (cells,
    n)."""
    rms = np.sqrt(np.mean(commands**2, axis=0))
    share = rms / max(float(np.median(rms)), TINY)
    still = [f"cmd_{k + 1} ({share[k]:.1%})" for k in np.flatnonzero(share < _STILL)]
    if not still or float(np.median(rms)) < TINY:
        return []
    message = (
        f"hardly changes in flight compared with the other motors: {', '.join(still)}. Is it the "
        "output of something else, frozen or at its limit?"
    )
    return [Finding("error", "cmd", message)]


def doubt_thrust(table: Columns, there: Signals) -> list[Finding]:
    """Findings where specific force does not follow the sum of commands, or the hover command is
    implausible."""
    cells = _cells(table, there, *(["acc"] if "acc" in there else []))
    if cells is None:
        return []
    t_cmd, cmd = samples(table, there["cmd"])
    mean = (t_cmd, cmd.mean(axis=1, keepdims=True))
    hover = float(np.median(cells.means(*mean)[cells.flown]))
    found = _doubt_still(cells.fast(cells.means(t_cmd, cmd)))
    if not _HOVER[0] <= hover <= _HOVER[1]:
        message = (
            f"{hover:.2f} in the median of the flight, expected {_HOVER[0]} to {_HOVER[1]}: is "
            f"their range (pulse widths, DShot or CAN values of "
            "command 0 and 1) another one?"
        )
        found.append(Finding("warning", "cmd", message))
    if "acc" not in there:
        return found
    t_acc, acc = samples(table, ACC)
    up = cells.means(t_acc, -acc[:, 2:])
    moments = _moments(cells, mean, up)
    r2 = moments.r2(np.ones(1), 0)
    if -r2.min() >= _CARRIES and _beaten(r2.max(keepdims=True), -r2.min(keepdims=True)):
        message = (
            f"specific force falls as the commands rise (R2 {-r2.min():.2f}): are commands "
            "reversed, or is acc_z of the other sign?"
        )
        found.append(Finding("error", "cmd", message))
    elif r2.max() >= _CARRIES:
        at = int(r2.argmax())
        slope = float(moments.cross[at, 0, 0] / moments.inputs[at, 0, 0])
        elasticity = slope * hover / max(float(np.median(up[cells.flown])), TINY)
        if not _ELASTICITY[0] <= elasticity <= _ELASTICITY[1]:
            message = (
                f"1 % more command gives {elasticity:.2g} % more thrust, expected "
                f"{_ELASTICITY[0]} to {_ELASTICITY[1]:g}: is the range of the commands another one?"
            )
            found.append(Finding("warning", "cmd", message))
    return found
