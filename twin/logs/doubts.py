"""What is doubtful about a flight table, whatever its format: units, frames, signals that stand
still. Findings, never errors."""

import numpy as np
import pandas as pd

from .agreement import doubt_force, doubt_turning, doubt_velocity, samples, signals
from .clock import missing_ends, pauses
from .columns import ACC, GYRO, MAG, POS, VEL
from .flight import Array, Finding

_FASTEST_ROTOR_RAD_S = 4500.0
_FROZEN_S = 2.0
_FEWEST = 20  # samples that tell anything


def doubts(table: pd.DataFrame) -> list[Finding]:
    """What the values of a flight table contradict.

    Args:
        table: As in `Flight`; angles, frames and units as in its definition.
    """
    found = [
        *_doubt_time(table),
        *_doubt_units(table),
        *_doubt_frames(table),
        *_doubt_height(table),
        *_frozen(table),
        *doubt_turning(table),
        *doubt_velocity(table),
    ]
    if not any(f.where == "acc" and f.severity == "error" for f in found):
        found += doubt_force(table)  # else it would say the same again
    return found


def gaps(table: pd.DataFrame) -> list[Finding]:
    """Pauses and early ends of each signal; the reader of a log does it topic by topic."""
    found = []
    begin_us, end_us = (round(float(table["time"].iloc[k]) * 1e6) for k in (0, -1))
    for name, columns in signals(table).items():
        t_s, _ = samples(table, columns)
        t_us = np.round(t_s * 1e6).astype(np.int64)
        if pause := pauses(t_us):
            found.append(Finding("warning", name, pause.told, pause.count))
        found += [Finding("warning", name, text) for text in missing_ends(t_us, begin_us, end_us)]
    return found


def _doubt_time(table: pd.DataFrame) -> list[Finding]:
    """Time in another unit, or not from the start of the record."""
    t_s = table["time"].to_numpy()
    found = []
    step = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    if step > 5.0:
        message = f"median step {step:.6g} s: is it in milliseconds or microseconds?"
        found.append(Finding("error", "time", message))
    if not -1.0 <= t_s[0] <= 3600.0:
        message = f"begins at {t_s[0]:.6g} s; expected from the start of the record"
        found.append(Finding("warning", "time", message))
    return found


def _norms(table: pd.DataFrame, columns: tuple[str, ...]) -> Array:
    """Norm of a vector signal where all its parts are there, shape (n,)."""
    if any(c not in table for c in columns):
        return np.zeros(0)
    norm = np.linalg.norm(table[list(columns)].to_numpy(), axis=1)
    return np.asarray(norm[np.isfinite(norm)])


def _doubt_units(table: pd.DataFrame) -> list[Finding]:
    """Magnitudes that fit another unit better."""
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
        found.append(Finding("error", "mag", message))
    speed = table[[c for c in table if str(c).startswith("rotor_")]].to_numpy()
    median = float(np.median(speed[speed > 0])) if (speed > 0).any() else 0.0
    if median > _FASTEST_ROTOR_RAD_S:
        message = f"median {median:.0f} rad/s: is it in rpm? 1 rpm = 0.10472 rad/s"
        found.append(Finding("error", "rotor", message))
    for column, low, high, message in (
        ("baro_pa", 2e4, 1.2e5, "expected in Pa, about 101325 at sea level"),
        ("vbat_v", 2.0, 500.0, "expected in V"),
        ("ibat_a", -1e3, 1e3, "expected in A"),
    ):
        if column in table and table[column].notna().any():
            median = float(table[column].median())
            if not low <= median <= high:
                found.append(Finding("error", column, f"median {median:.4g}: {message}"))
    return found


def _doubt_frames(table: pd.DataFrame) -> list[Finding]:
    """Signs that fit another frame better."""
    found = []
    if "acc_z" in table and table["acc_z"].notna().any() and table["acc_z"].median() > 0.3:
        message = (
            f"acc_z has median {table['acc_z'].median():+.2f} m/s^2; at rest and in hover it is "
            "-9.8 in FRD. Axes FLU (z up), or gravity instead of specific force?"
        )
        found.append(Finding("error", "acc", message))
    if "acc_ned_z" in table and table["acc_ned_z"].notna().any():
        down = float(table["acc_ned_z"].median())
        if abs(down) > 5.0:
            message = (
                f"acc_ned_z has median {down:+.2f} m/s^2; that of a motion is about 0 on average: "
                "is gravity in it, or specific force meant?"
            )
            found.append(Finding("error", "acc_ned", message))
    air = table["phase"].isin(["hover", "forward", "tour"])
    ground = table["phase"] == "ground"
    if "pos_z" in table:
        height = table.loc[air, "pos_z"].median() - table.loc[ground, "pos_z"].median()
        if height > 0.3:
            message = (
                f"pos_z is {height:+.1f} m higher in flight than on the ground; NED has z down"
            )
            found.append(Finding("error", "pos", message))
    return found


def _doubt_height(table: pd.DataFrame) -> list[Finding]:
    """Height that is counted upwards, by the pressure and by motors that idle at the start."""
    if "pos_z" not in table or not table["pos_z"].notna().any():
        return []
    found = []
    pressure = table.get("baro_pa")
    if pressure is not None and pressure.notna().sum() > _FEWEST:
        t, down = samples(table, ("pos_z",))
        t_baro, baro = samples(table, ("baro_pa",))
        then = np.interp(t_baro, t, down[:, 0])
        climbs = np.ptp(then) > 2.0 and np.std(baro) > 0.0
        if climbs and np.corrcoef(then, baro[:, 0])[0, 1] < -0.5:
            message = "pos_z falls as the pressure rises; NED has z down: is it a height?"
            found.append(Finding("error", "pos", message))
    commands = [c for c in table if str(c).startswith("cmd_")]
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


def _frozen(table: pd.DataFrame) -> list[Finding]:
    """Signals that keep a value for seconds of a flight in which they change otherwise."""
    there = signals(table)
    ground = (table["phase"] == "ground").to_numpy()
    time = table["time"].to_numpy()
    found = []
    for name in ("acc", "gyro", "mag", "pos", "vel", "q", "cmd", "rotor"):
        if name not in there:
            continue
        t_s, values = samples(table, there[name])
        changes = np.flatnonzero((np.diff(values, axis=0) != 0.0).any(axis=1)) + 1
        if len(changes) < _FEWEST:
            continue
        first = np.concatenate([[0], changes])
        last = np.concatenate([changes, [len(t_s)]]) - 1
        usual_s = float(np.median(t_s[last] - t_s[first] + np.median(np.diff(t_s))))
        off = name in ("cmd", "rotor") and ~values.any(axis=1)  # motors that stand are no fault
        stopped = np.broadcast_to(off, len(t_s))[first]
        begin, end = t_s[first], t_s[last]
        long = (end - begin > max(_FROZEN_S, 20.0 * usual_s)) & ~stopped
        for a, b in zip(begin[long], end[long], strict=True):
            if not ground[(time > a) & (time < b)].all():
                found.append((name, float(a), float(b)))
    return [
        Finding("warning", name, f"stands still from {begin:.2f} to {end:.2f} s, changes otherwise")
        for name, begin, end in found
        if _moves(table, there, name, begin, end)
    ]


def _moves(
    table: pd.DataFrame,
    there: dict[str, tuple[str, ...]],
    but: str,
    begin_s: float,
    end_s: float,
) -> bool:
    """Whether another signal of the motion changes all along a span."""
    for name in ("acc", "gyro", "q", "vel", "pos"):
        if name == but or name not in there:
            continue
        t_s, values = samples(table, there[name])
        inside = values[(t_s > begin_s) & (t_s < end_s)]
        if len(inside) > 4 and np.mean((np.diff(inside, axis=0) != 0.0).any(axis=1)) > 0.5:
            return True
    return False
