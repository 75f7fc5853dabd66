"""What happened to the aircraft itself, told from its flight table and its speed controllers: it
tips over, motors run into their limits, one controller reads a lower voltage than the others.

Thresholds are by judgement, none was fitted to a flight.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..vehicle import GRAVITY_M_S2
from .agreement import samples
from .columns import ACC, QUAT, VEL, Columns
from .flight import Array, Finding

_LYING_COS = np.cos(np.radians(45.0))
"""A multirotor that is tilted further cannot stand still in the air."""
_STILL_M_S2, _STILL_M_S = 2.0, 0.3
_LYING_S = 1.0
_RAN_S = 0.5
_RUNS = 0.05
_FLIES = 0.15
_AT_LIMIT = 0.01
_WARNED, _NAMED = 0.05, 0.01
_LOWER_V, _LOWER_SHARE = 0.25, 0.015
_FEWEST = 20


def incidents(table: Columns) -> list[Finding]:
    """Findings on a flight, most severe first.

    Args:
        table: By column.
    """
    return [*_tip_over(table), *_limits(table)]


def _tip_over(table: Columns) -> list[Finding]:
    """Tilted by over 45 degrees and at rest for a second, with motors that ran when it tilted.

    At rest is a specific force, turned to NED, that is that of gravity alone; without an
    accelerometer no velocity.
    """
    drives = [c for c in table if c.startswith("cmd_")]
    if any(c not in table for c in QUAT) or not drives:
        return []
    t_s, q = samples(table, QUAT)
    upright = 1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2)  # cosine of the tilt
    tilted = upright < _LYING_COS
    if len(t_s) < _FEWEST or not tilted.any():
        return []  # of a long flight, before anything else of it is held
    t_cmd, cmd = samples(table, drives)
    still = _at_rest(table, t_s, q)
    if len(t_cmd) < _FEWEST or still is None:
        return []
    for first, last in _runs(tilted):
        rests = still[first : last + 1]
        rest_s = max((t_s[first + b] - t_s[first + a] for a, b in _runs(rests)), default=0.0)
        level = np.interp(t_s[first], t_cmd, cmd.mean(axis=1))
        before = (t_cmd >= t_s[first] - _RAN_S) & (t_cmd <= t_s[first])
        ran = max([level, *cmd[before].mean(axis=1)]) > _RUNS
        if rest_s < _LYING_S or not ran:
            continue
        angle = np.degrees(np.arccos(np.clip(np.median(upright[first : last + 1]), -1.0, 1.0)))
        after = t_cmd[(t_cmd > t_s[first]) & (cmd.mean(axis=1) > _RUNS)]
        turning = f"; motors run until {after[-1]:.1f} s" if len(after) else ""
        message = (
            f"the aircraft tips over at {t_s[first]:.1f} s with a mean command of {level:.2f} and "
            f"lies {angle:.0f} deg from level{turning}. What follows is no flight"
        )
        return [Finding("warning", "flight", message)]
    return []


def _at_rest(table: Columns, t_s: Array, q: Array) -> NDArray[np.bool_] | None:
    """Whether nothing accelerates the aircraft at these times; None where no signal tells."""
    if all(c in table for c in ACC):
        t_acc, acc = samples(table, ACC)
        if len(t_acc) >= _FEWEST:
            force = np.column_stack([np.interp(t_s, t_acc, a) for a in acc.T])
            w, v = q[:, :1], q[:, 1:]
            turned = force + 2.0 * np.cross(v, np.cross(v, force) + w * force)
            turned[:, 2] += GRAVITY_M_S2
            return np.asarray(np.linalg.norm(turned, axis=1) < _STILL_M_S2)
    if all(c in table for c in VEL):
        t_vel, vel = samples(table, VEL)
        if len(t_vel) >= _FEWEST:
            speed = np.interp(t_s, t_vel, np.linalg.norm(vel, axis=1))
            return np.asarray(speed < _STILL_M_S)
    return None


def _limits(table: Columns) -> list[Finding]:
    """Motors whose command is at an end of its range while the others fly the aircraft."""
    columns = [c for c in table if c.startswith("cmd_")]
    if not columns:
        return []
    t_s, cmd = samples(table, columns)
    if len(t_s) < _FEWEST:
        return []
    step_s = np.minimum(np.diff(t_s, append=t_s[-1]), 1.0)
    flies = cmd.mean(axis=1) > _FLIES
    flown_s = float(step_s[flies].sum())
    if flown_s < _LYING_S:
        return []
    parts, worst, count = [], 0.0, 0
    for end, at in (("upper", cmd >= 1.0 - _AT_LIMIT), ("lower", cmd <= _AT_LIMIT)):
        for motor, rows in enumerate((at & flies[:, None]).T, start=1):
            share = float(step_s[rows].sum()) / flown_s
            if share < _NAMED:
                continue
            spans = [(t_s[a], t_s[b] + step_s[b]) for a, b in _runs(rows)]
            longest = max(b - a for a, b in spans)
            parts.append(
                f"motor {motor} at its {end} limit in {share:.1%} of the {flown_s:.0f} s with "
                f"thrust (first at {spans[0][0]:.1f} s, longest {longest:.2f} s)"
            )
            worst, count = max(worst, share), count + int(rows.sum())
    if not parts:
        return []
    return [Finding("warning" if worst >= _WARNED else "info", "cmd", "; ".join(parts), count)]


def lower_voltage(volts: Mapping[int, Array]) -> list[Finding]:
    """Speed controllers that read a lower supply voltage than the others of the same battery.

    Args:
        volts: By motor, from 1: voltages while it turns, V, shape (n,).
    """
    known = {m: v[np.isfinite(v) & (v > 1.0)] for m, v in volts.items()}
    medians = {m: float(np.median(v)) for m, v in known.items() if len(v) >= _FEWEST}
    if len(medians) < 3:
        return []
    found = []
    for motor, own in medians.items():
        others = float(np.median([v for m, v in medians.items() if m != motor]))
        if others - own > max(_LOWER_V, _LOWER_SHARE * others):
            message = (
                f"the speed controller of motor {motor} reads {own:.2f} V, {others - own:.2f} V "
                f"below the median of the others ({others:.2f} V): a poor connection, or its "
                "measurement"
            )
            found.append(Finding("warning", "vbat_v", message, len(known[motor])))
    return found


def _runs(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of each stretch in which something holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
