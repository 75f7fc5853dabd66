"""Findings on doubtful values of a flight table of any format: units, frames, frozen signals."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..frames import to_ned
from ..vehicle import GRAVITY_M_S2
from ..vehicle.layouts import Layout
from .agreement import (
    Signals,
    doubt_compass,
    doubt_force,
    doubt_turning,
    doubt_velocity,
    samples,
    signals,
)
from .columns import ACC, GYRO, MAG, POS, QUAT, VEL, Columns, other_unit
from .flight import Array, Finding
from .motor_checks import doubt_motors
from .samples import interpolated, stretches_where
from .stamps import missing_ends, pauses

_FASTEST_ROTOR_RAD_S = 4500.0  # 43,000 rpm: over the fastest racing motors under load
_FROZEN_S = 2.0  # without a change, from which a signal is frozen; made up
_FEWEST = 20  # samples of a signal below which nothing is tested
_NOTHING = 0.9
"""Share of samples that are exactly zero in a column without data."""
_LEVEL = 0.9999
"""Component of a quaternion that rounds to one while the others hardly change."""
_APART = 2.0
"""Ratio of one motor to the others from which it is reported; recorded flights have 0.84 to
1.18."""
_OF_MOTION = ("acc", "gyro", "q", "vel", "pos")  # signals that change in flight
_AIRBORNE = ("hover", "forward", "tour")  # phases in the air


def doubts(table: Columns, layout: Layout | None = None) -> list[Finding]:
    """Findings on values of a flight table that contradict each other.

    Args:
        table: Columns by name; angles, frames and units as in the definition of the table.
        layout: Rotors in the order of the commands, by the log; None: not known.
    """
    there = signals(table)
    found = [
        *_doubt_time(table),
        *_doubt_units(table),
        *_doubt_frames(table),
        *_doubt_height(table),
        *_frozen(table, there),
        *_unpowered(table, there),
        *_one_apart(table, there),
        *doubt_turning(table, there),
        *doubt_velocity(table, there),
        *doubt_compass(table, there),
        *incidents(table),
        *doubt_motors(table, there, layout),
    ]
    if not any(f.where == "acc" and f.severity == "error" for f in found):
        found += doubt_force(table, there)  # else it would report the same fault again
    return found


def gaps(table: Columns, there: Signals) -> list[Finding]:
    """Findings on pauses and early ends of each signal; readers of logs check each topic
    themselves."""
    found = []
    begin_us, end_us = (round(float(table["time"][k]) * 1e6) for k in (0, -1))
    for name, columns in there.items():
        t_s, _ = samples(table, columns)
        t_us = np.round(t_s * 1e6).astype(np.int64)
        if pause := pauses(t_us):
            found.append(Finding("warning", name, pause.message, pause.count))
        found += [Finding("warning", name, text) for text in missing_ends(t_us, begin_us, end_us)]
    return found


def _doubt_time(table: Columns) -> list[Finding]:
    """Findings on time in another unit, or not counted from the start of the record."""
    t_s = table["time"]
    found = []
    step = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    if step > 5.0:
        message = f"median step {step:.6g} s: is it in milliseconds or microseconds?"
        found.append(Finding("error", "time", message))
    if not -1.0 <= t_s[0] <= 3600.0:
        message = f"begins at {t_s[0]:.6g} s; expected from the start of the record"
        found.append(Finding("warning", "time", message))
    return found


def _norms(table: Columns, columns: tuple[str, ...]) -> Array:
    """Norm of a vector signal in rows where all its components have a sample, shape (n,)."""
    if any(c not in table for c in columns):
        return np.zeros(0)
    squares = np.zeros(len(table["time"]))
    for column in columns:
        squares += np.square(table[column])
    norm = np.sqrt(squares, out=squares)
    return np.asarray(norm[np.isfinite(norm)])


def _finite(table: Columns, column: str) -> Array:
    """Finite samples of a column, shape (n,); empty where the table has no such column."""
    values = table[column] if column in table else np.zeros(0)
    return np.asarray(values[np.isfinite(values)])


def _doubt_units(table: Columns) -> list[Finding]:
    """Findings on magnitudes that are plausible in another unit only."""
    found = []
    acc, gyro, mag = (_norms(table, g) for g in (ACC, GYRO, MAG))
    if len(acc) and np.median(acc) < 3.0:
        message = (
            f"median {np.median(acc):.2f} m/s^2: is it in g (1 g = 9.80665 m/s^2), or without "
            "gravity? An accelerometer at rest reads 9.8"
        )
        found.append(Finding("error", "acc", message))
    if len(acc) and np.median(acc) > 40.0:
        message = f"median {np.median(acc):.3g} m/s^2: 9.8 at rest and in hover. Another unit?"
        found.append(Finding("error", "acc", message))
    speeds, far = _norms(table, VEL), _norms(table, POS)
    if len(speeds) and np.quantile(speeds, 0.99) > 150.0:
        message = f"99 % below {np.quantile(speeds, 0.99):.3g} m/s: is it in mm/s or cm/s?"
        found.append(Finding("error", "vel", message))
    if len(far) and np.median(far) > 1e5:
        message = f"median {np.median(far):.3g} m from the origin: from a fixed origin, in m?"
        found.append(Finding("error", "pos", message))
    if len(gyro) and np.quantile(gyro, 0.99) > 20.0:
        message = f"99 % below {np.quantile(gyro, 0.99):.0f} rad/s: is it in degrees per second?"
        found.append(Finding("error", "gyro", message))
    if len(mag) and not 1e-6 < np.median(mag) < 1e-3:
        message = (
            f"median {np.median(mag):.3g} T: the Earth has 2.5e-5 to 6.5e-5 T (1 gauss = 1e-4 T)"
        )
        if unit := other_unit("mag", float(np.median(mag))):
            message = f"{message}; {unit}"
        found.append(Finding("error", "mag", message))
    turning = [v[v > 0] for c in table if c.startswith("rotor_") for v in (table[c],)]
    speed = np.concatenate(turning) if turning else np.zeros(0)
    median = float(np.median(speed)) if len(speed) else 0.0
    if median > _FASTEST_ROTOR_RAD_S:
        message = f"median {median:.0f} rad/s: is it in rpm? 1 rpm = 0.10472 rad/s"
        found.append(Finding("error", "rotor", message))
    for column, low, high, message in (
        ("baro_pa", 2e4, 1.2e5, "expected in Pa, about 101325 at sea level"),
        ("vbat_v", 2.0, 120.0, "expected in V, 2 to 120"),
        ("ibat_a", -400.0, 400.0, "expected in A, up to 400"),
    ):
        if len(values := _finite(table, column)):
            median = float(np.median(values))
            if not low <= median <= high:
                unit = other_unit(column.removesuffix("_pa"), abs(median))
                more = f"; {unit}" if unit else ""
                found.append(Finding("error", column, f"median {median:.4g}: {message}{more}"))
    return found


def _doubt_frames(table: Columns) -> list[Finding]:
    """Findings on signs that are plausible in another frame only."""
    found = []
    if len(values := _finite(table, "acc_z")) and (down := float(np.median(values))) > 0.3:
        message = (
            f"acc_z has median {down:+.2f} m/s^2; at rest and in hover it is "
            "-9.8 in FRD. Axes FLU (z up), or gravity instead of specific force?"
        )
        found.append(Finding("error", "acc", message))
    if len(values := _finite(table, "acc_ned_z")) and abs(down := float(np.median(values))) > 5.0:
        message = (
            f"acc_ned_z has median {down:+.2f} m/s^2; that of a motion is about 0 on average: "
            "is gravity in it, or specific force meant?"
        )
        found.append(Finding("error", "acc_ned", message))
    if "pos_z" in table:
        down_m, phase = table["pos_z"], table["phase"]
        there = np.isfinite(down_m)
        air = down_m[there & np.logical_or.reduce([phase == p for p in _AIRBORNE])]
        ground = down_m[there & (phase == "ground")]
        height = float(np.median(air) - np.median(ground)) if len(air) and len(ground) else 0.0
        if height > 0.3:
            message = (
                f"pos_z is {height:+.1f} m higher in flight than on the ground; NED has z down"
            )
            found.append(Finding("error", "pos", message))
    return found


def _doubt_height(table: Columns) -> list[Finding]:
    """Findings on height that is positive upward, by the pressure and by motors that idle at the
    start."""
    if not len(_finite(table, "pos_z")):
        return []
    found = []
    if len(_finite(table, "baro_pa")) > _FEWEST:
        t, down = samples(table, ("pos_z",))
        t_baro, baro = samples(table, ("baro_pa",))
        then = np.interp(t_baro, t, down[:, 0])
        climbs = np.ptp(then) > 2.0 and np.std(baro) > 0.0
        if climbs and np.corrcoef(then, baro[:, 0])[0, 1] < -0.5:
            message = "pos_z falls as the pressure rises; NED has z down: is it a height?"
            found.append(Finding("error", "pos", message))
    commands = [c for c in table if c.startswith("cmd_")]
    if commands:
        t_cmd, cmd = samples(table, commands)
        t, down = samples(table, ("pos_z",))
        mean = np.interp(t, t_cmd, cmd.mean(axis=1)) if len(t_cmd) else np.zeros(len(t))
        idle = np.flatnonzero(mean > 0.15)
        start = down[: idle[0], 0] if len(idle) else down[:0, 0]
        above = np.median(down[mean > 0.15, 0]) - np.median(start) if len(start) > 4 else 0.0
        if above > 0.3 and not found:
            message = (
                f"pos_z is {above:+.1f} m higher with the motors on than before; NED has z down"
            )
            found.append(Finding("error", "pos", message))
    return found


def _frozen(table: Columns, there: Signals) -> list[Finding]:
    """Findings on signals that are constant for seconds of a flight, or for all of it, while others
    change; and on a flight in which no signal of the motion changes."""
    ground = np.asarray(table["phase"] == "ground")
    time = table["time"]
    found = [
        (name, begin, end)
        for name in ("acc", "gyro", "mag", "pos", "vel", "q", "cmd", "rotor")
        if name in there
        for begin, end in _still(*samples(table, there[name]), name in ("cmd", "rotor"))
        if not ground[(time > begin) & (time < end)].all()
    ]
    moves = _moving(table, there, found)
    whole = []
    for (name, begin, end), moving in zip(found, moves, strict=True):
        if moving:
            always = not _changed(samples(table, there[name])[1]).any()
            otherwise = "all of its samples" if always else "changes otherwise"
            message = f"stands still from {begin:.2f} to {end:.2f} s, {otherwise}"
            whole.append(Finding("warning", name, message))
    of_motion = [name for name in _OF_MOTION if name in there]
    still = {name for name, _, _ in found}
    if of_motion and still.issuperset(of_motion) and not moves.any():
        message = f"nothing of the motion changes in the flight: {', '.join(of_motion)} stand still"
        whole.append(Finding("error", "flight", message))
    return [*whole, *_frozen_axes(table, there, ground)]


def _frozen_axes(table: Columns, there: Signals, ground: NDArray[np.bool_]) -> Iterator[Finding]:
    """Findings on single columns that are constant for seconds in which the rest of their signal
    changes in most samples; motors may be constant at either end of their range."""
    time = table["time"]
    for name in ("acc", "gyro", "mag", "pos", "vel", "q", "cmd", "rotor"):
        if name not in there:
            continue
        t_s, values = samples(table, there[name])
        if len(t_s) < _FEWEST:
            continue
        steps = np.cumsum(np.concatenate([[0], _changed(values)]))
        usual_s = float(np.median(np.diff(t_s)))
        for column, own in zip(there[name], values.T, strict=True):
            changes = np.flatnonzero(own[1:] != own[:-1]) + 1
            first = np.concatenate([[0], changes])
            last = np.concatenate([changes, [len(t_s)]]) - 1
            ends = own[first] <= 0.0 if name == "rotor" else (own[first] <= 0) | (own[first] >= 1)
            may = ends & (name in ("cmd", "rotor"))
            lasts = t_s[last] - t_s[first] > max(_FROZEN_S, 20.0 * usual_s)
            if name in ("acc", "gyro", "q") and np.mean(own == 0.0) > _NOTHING:
                continue  # a simulation without drag, or in a plane
            if name == "q":
                may = np.abs(own[first]) > _LEVEL
            busy = steps[last] - steps[first] > 0.5 * (last - first)
            for k in np.flatnonzero(lasts & busy & ~may):
                begin, end = float(t_s[first[k]]), float(t_s[last[k]])
                if not ground[(time > begin) & (time < end)].all():
                    frozen = f"{column} keeps {own[first[k]]:.4g} from {begin:.2f} to {end:.2f} s"
                    message = f"{frozen}, while others of {name} change"
                    yield Finding("warning", name, message)


def _one_apart(table: Columns, there: Signals) -> Iterator[Finding]:
    """Findings on a motor whose command or speed differs far from those of the others in flight."""
    flying = np.asarray(table["phase"] != "ground")
    for name, unit in (("cmd", ""), ("rotor", " rad/s")):
        if name not in there:
            continue
        t_s, values = samples(table, there[name])
        values = values[flying[np.searchsorted(table["time"], t_s)]]
        mean = values.mean(axis=1)
        if len(mean) < _FEWEST:
            continue
        driven = mean > 0.5 * np.quantile(mean, 0.9)
        if not driven.any():
            continue
        usual = np.median(values[driven], axis=0)
        for k, column in enumerate(there[name]):
            others = float(np.median(np.delete(usual, k)))
            if others > 0 and not 1 / _APART < usual[k] / others < _APART:
                message = (
                    f"{column} is {usual[k]:.3g}{unit} in the median, the others "
                    f"{others:.3g}{unit}: scaled, without its motor, or of something else?"
                )
                yield Finding("error", name, message)


def _unpowered(table: Columns, there: Signals) -> list[Finding]:
    """Findings on commands or rotor speeds that are all 0 while the phase is a phase in the air."""
    flying = np.logical_or.reduce([np.asarray(table["phase"] == p) for p in _AIRBORNE])
    if not flying.any():
        return []
    found = []
    for name in ("cmd", "rotor"):
        if name not in there:
            continue
        t_s, values = samples(table, there[name])
        row = np.clip(np.searchsorted(table["time"], t_s), 0, len(flying) - 1)
        off = flying[row] & ~values.any(axis=1)
        seconds = float(np.diff(t_s, append=t_s[-1:])[off].sum())
        if seconds > _FROZEN_S:
            message = f"all 0 for {seconds:.1f} s of flight: are these the outputs of the motors?"
            found.append(Finding("error", name, message))
    return found


def _still(t_s: Array, values: Array, may_stand: bool) -> list[tuple[float, float]]:
    """Spans, s, in which a signal is constant for much longer than usual; all of its time where it
    never changes.

    Args:
        t_s: Times, shape (n,).
        values: Samples, shape (n, k).
        may_stand: Whether all zeros are valid: stopped motors.
    """
    changes = np.flatnonzero(_changed(values)) + 1
    if len(t_s) >= _FEWEST and not len(changes) and not (may_stand and not values[0].any()):
        return [(float(t_s[0]), float(t_s[-1]))] if t_s[-1] - t_s[0] > _FROZEN_S else []
    if len(changes) < _FEWEST:
        return []
    off = np.zeros(len(t_s), dtype=np.bool_)
    if may_stand:
        off = np.asarray(~values.any(axis=1))
    del values
    first = np.concatenate([[0], changes])
    last = np.concatenate([changes, [len(t_s)]]) - 1
    usual_s = float(np.median(t_s[last] - t_s[first] + np.median(np.diff(t_s))))
    long = (t_s[last] - t_s[first] > max(_FROZEN_S, 20.0 * usual_s)) & ~off[first]
    begin, end = t_s[first[long]], t_s[last[long]]
    return list(zip(begin.tolist(), end.tolist(), strict=True))


def _changed(values: Array) -> NDArray[np.bool_]:
    """Whether any of the columns differs from the row before, shape (n - 1,)."""
    changed = np.zeros(max(len(values) - 1, 0), dtype=np.bool_)
    for column in values.T:
        changed |= column[1:] != column[:-1]
    return changed


def _moving(
    table: Columns, there: Signals, spans: Sequence[tuple[str, float, float]]
) -> NDArray[np.bool_]:
    """Whether a signal of the motion, other than that of the span, changes throughout each span."""
    moving = np.zeros(len(spans), dtype=np.bool_)
    for name in _OF_MOTION:
        candidates = [k for k, span in enumerate(spans) if not moving[k] and span[0] != name]
        if not candidates or name not in there:
            continue
        t_s, values = samples(table, there[name])
        for k in candidates:
            _, begin_s, end_s = spans[k]
            inside = values[(t_s > begin_s) & (t_s < end_s)]
            moving[k] = len(inside) > 4 and np.mean(_changed(inside)) > 0.5
    return moving


# -- incidents ----------------------------------------------------------------------------------
#
# What happened to the aircraft itself, by its flight table and its speed controllers: it
# tips over, motors run into their limits, one controller reads a lower voltage than the others.
#
# Thresholds are by judgement, none was fitted to a flight.

_LYING_COS = np.cos(np.radians(45.0))
"""Largest tilt of a multirotor that can be stationary in the air, as a cosine."""
_STILL_M_S2, _STILL_M_S = 2.0, 0.3  # of an aircraft at rest: specific force less gravity; velocity
_LYING_S = 1.0  # duration of a tip-over
_RAN_S = 0.5  # time before a tip-over in which motors ran
_RUNS = 0.05  # mean command of motors that run
_FLIES = 0.15  # mean command of an aircraft in the air
_AT_LIMIT = 0.01  # distance of a command from an end of its range
_WARNED, _NAMED = 0.05, 0.01  # share of the flight at a limit for a warning, and for a word
_LOWER_V, _LOWER_SHARE = 0.25, 0.015  # below the others, V and share, of a lower supply


def incidents(table: Columns) -> list[Finding]:
    """Findings on incidents of a flight, most severe first.

    Args:
        table: Flight table by column.
    """
    return [*_tip_over(table), *_limits(table)]


def _tip_over(table: Columns) -> list[Finding]:
    """Finding on a tilt of over 45 degrees, at rest for a second, with running motors as it tilted.

    At rest means that the specific force in NED is that of gravity alone; without an accelerometer,
    that the velocity is zero.
    """
    drives = [c for c in table if c.startswith("cmd_")]
    if any(c not in table for c in QUAT) or not drives:
        return []
    t_s, q = samples(table, QUAT)
    upright = 1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2)  # cosine of the tilt
    tilted = upright < _LYING_COS
    if len(t_s) < _FEWEST or not tilted.any():
        return []  # before other columns of a long flight are loaded
    t_cmd, cmd = samples(table, drives)
    still = _at_rest(table, t_s, q)
    if len(t_cmd) < _FEWEST or still is None:
        return []
    for first, end in stretches_where(tilted):
        rests = [t_s[first + a : first + b] for a, b in stretches_where(still[first:end])]
        rest_s = max((t[-1] - t[0] for t in rests), default=0.0)
        level = np.interp(t_s[first], t_cmd, cmd.mean(axis=1))
        before = (t_cmd >= t_s[first] - _RAN_S) & (t_cmd <= t_s[first])
        ran = max([level, *cmd[before].mean(axis=1)]) > _RUNS
        if rest_s < _LYING_S or not ran:
            continue
        angle = np.degrees(np.arccos(np.clip(np.median(upright[first:end]), -1.0, 1.0)))
        after = t_cmd[(t_cmd > t_s[first]) & (cmd.mean(axis=1) > _RUNS)]
        turning = f"; motors run until {after[-1]:.1f} s" if len(after) else ""
        message = (
            f"the aircraft tips over at {t_s[first]:.1f} s with a mean command of {level:.2f} and "
            f"lies {angle:.0f} deg from level{turning}. What follows is no flight"
        )
        return [Finding("warning", "flight", message)]
    return []


def _at_rest(table: Columns, t_s: Array, q: Array) -> NDArray[np.bool_] | None:
    """Whether the aircraft is unaccelerated at these times; None without a signal of it."""
    if all(c in table for c in ACC):
        t_acc, acc = samples(table, ACC)
        if len(t_acc) >= _FEWEST:
            force = interpolated(t_s, t_acc, acc)
            turned = np.stack(to_ned(list(q.T), list(force.T)), axis=1)
            turned[:, 2] += GRAVITY_M_S2
            return np.asarray(np.linalg.norm(turned, axis=1) < _STILL_M_S2)
    if all(c in table for c in VEL):
        t_vel, vel = samples(table, VEL)
        if len(t_vel) >= _FEWEST:
            speed = np.interp(t_s, t_vel, np.linalg.norm(vel, axis=1))
            return np.asarray(speed < _STILL_M_S)
    return None


def _limits(table: Columns) -> list[Finding]:
    """Findings on motors whose command is at an end of its range while the others fly the
    aircraft."""
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
            spans = [(t_s[a], t_s[b - 1] + step_s[b - 1]) for a, b in stretches_where(rows)]
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
    """Findings on speed controllers with a lower supply voltage than others on the battery.

    Args:
        volts: Voltages of each motor, from 1, while it turns, V, shape (n,).
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
