"""What a flight table must be (LogError) and what is doubtful about it (Finding)."""

import difflib

import numpy as np
import pandas as pd

from ..errors import LogError
from .columns import (
    ACC,
    ACC_NED,
    COLUMNS,
    EULER,
    GYRO,
    MAG,
    MAX_MOTORS,
    MIN_MOTORS,
    MOTION,
    PHASES,
    POS,
    QUAT,
    VEL,
    is_known,
    motor_columns,
    motor_number,
)
from .flight import Array, Finding

_MOST_UNKNOWN = 100
_SHOWN = 40
_TINY = 1e-6
_NORM_DOUBT = 1e-3
_FASTEST_ROTOR_RAD_S = 4500.0


NO_TABLE = (
    "a recording of uavtwin simulate holds what the parts of a simulation gave, no flight table: "
    "to use it as one, keep time and rename the columns that a flight would log, imu.acc_x to acc_x"
)


def is_recording(columns: list[str]) -> bool:
    """Whether a table is a recording of a simulation: time, and columns PART.VARIABLE alone."""
    others = [c for c in columns if c != "time"]
    return bool(others) and len(others) < len(columns) and all("." in c for c in others)


def check_columns(name: str, columns: list[str]) -> list[Finding]:
    """Check the names of the columns.

    Args:
        name: File name, for messages.
        columns: Column names.

    Returns:
        A finding for every column that is ignored.

    Raises:
        LogError: A misspelt name, no `time`, no motion signal, motors not numbered 1..n.
    """
    if is_recording(columns):
        raise LogError(f"{name}: {NO_TABLE}.")
    findings = []
    known = [c.name for c in COLUMNS if not c.per_motor]
    known += [*motor_columns("cmd", MAX_MOTORS), *motor_columns("rotor", MAX_MOTORS)]
    there = set(columns)
    unknown = [c for c in columns if not is_known(c)]
    for column in unknown[:_MOST_UNKNOWN]:
        shown = column[:_SHOWN]
        near = difflib.get_close_matches(shown.strip().lower(), known, 1, 0.75)
        near = [n for n in near if n not in there]
        if near:
            raise LogError(f"{name}: unknown column '{shown}'. Did you mean '{near[0]}'?")
        findings.append(Finding("warning", shown, "not a column of the flight table; ignored"))
    if len(unknown) > _MOST_UNKNOWN:
        message = "further columns that are not of the flight table; ignored"
        findings.append(Finding("warning", "columns", message, len(unknown) - _MOST_UNKNOWN))
    if "time" not in columns:
        raise LogError(
            f"{name}: no column 'time' (s). It has: {', '.join(c[:_SHOWN] for c in columns[:12])}."
        )
    if not any(c in columns for c in (*MOTION, *EULER)):
        raise LogError(
            f"{name}: no motion signal beside time; at least one of acc, gyro, pos, vel, q, "
            f"roll, pitch and yaw, acc_ned is needed. It has: {', '.join(c[:_SHOWN] for c in columns[:12])}."
        )
    missing = [c for c in QUAT if c not in columns]
    if 0 < len(missing) < len(QUAT):
        raise LogError(
            f"{name}: the attitude lacks {', '.join(missing)}. Give q_w, q_x, q_y and q_z, or none."
        )
    for group in (ACC, GYRO, MAG, POS, VEL, ACC_NED):
        missing = [c for c in group if c not in columns]
        if 0 < len(missing) < len(group):
            findings.append(Finding("warning", group[0][:-2], f"lacks {', '.join(missing)}"))
    _check_motors(name, columns)
    return findings


def _check_motors(name: str, columns: list[str]) -> None:
    """Motors are numbered 1..n without holes, 3 to 12 of them, as many commands as rotors."""
    counts = {}
    for stem in ("cmd", "rotor"):
        numbers = sorted(n for c in columns if (n := motor_number(c)) and c.startswith(stem))
        if not numbers:
            continue
        hole = next((k for k in range(1, numbers[-1] + 1) if k not in numbers), None)
        if hole is not None:
            raise LogError(
                f"{name}: {stem}_{numbers[-1]} is there but {stem}_{hole} is not; number the "
                "motors 1, 2, 3, ..."
            )
        if not MIN_MOTORS <= len(numbers) <= MAX_MOTORS:
            raise LogError(
                f"{name}: {len(numbers)} columns {stem}_i; {MIN_MOTORS} to {MAX_MOTORS} motors "
                "are supported."
            )
        counts[stem] = len(numbers)
    if len(set(counts.values())) > 1:
        raise LogError(f"{name}: {counts['cmd']} commands but {counts['rotor']} rotor speeds.")


def validate(name: str, table: pd.DataFrame) -> tuple[pd.DataFrame, list[Finding]]:
    """Check the values of a flight table whose columns are known.

    Args:
        name: File name, for messages.
        table: Flight table, numbers as float64, `phase` as text.

    Returns:
        The table, with quaternions off unit norm normalised, and the doubts.

    Raises:
        LogError: Time that does not increase, infinite values, commands outside 0..1, ...
    """
    if table.empty:
        raise LogError(f"{name}: no rows.")
    _check_time(name, table["time"].to_numpy())
    for column in table.columns.drop("phase"):
        _check_range(name, str(column), table[column].to_numpy())
    _check_phase(name, table["phase"])
    if not any(table[c].notna().any() for c in MOTION if c in table):
        raise LogError(f"{name}: the motion signals have no sample, all cells are empty.")
    table, findings = _unit_quaternions(name, table)
    empty = [str(c) for c in table if table[c].isna().all()]
    findings += [Finding("warning", c, "has no sample at all") for c in empty]
    findings += _partial_vectors(table)
    return table, [*findings, *_doubt_time(table), *_doubt_units(table), *_doubt_frames(table)]


def _partial_vectors(table: pd.DataFrame) -> list[Finding]:
    """Rows in which a vector has some of its components and NaN for the others."""
    found = []
    for group in (ACC, GYRO, MAG, POS, VEL, QUAT, ACC_NED):
        there = table[[c for c in group if c in table and table[c].notna().any()]].notna()
        count = int((there.any(axis=1) & ~there.all(axis=1)).sum())
        if count:
            message = "rows with NaN in a part of the vector; the vector is left out there"
            found.append(Finding("error", group[0][:-2], message, count))
    return found


def _check_time(name: str, t_s: Array) -> None:
    """Time is there in every row and increases."""
    bad = np.flatnonzero(~np.isfinite(t_s))
    if len(bad):
        raise LogError(f"{name}: time in data row {bad[0] + 1} is {t_s[bad[0]]} ({len(bad)} such).")
    back = np.flatnonzero(np.diff(t_s) <= 0.0)
    if len(back):
        k = int(back[0])
        what = "repeats" if t_s[k + 1] == t_s[k] else "runs backward"
        raise LogError(
            f"{name}: time {what} in data row {k + 2}: {t_s[k + 1]:.9g} s after {t_s[k]:.9g} s "
            f"({len(back)} such rows). Sort the rows and join those of equal time."
        )


def _check_range(name: str, column: str, values: Array) -> None:
    """Finite or empty; commands 0..1; rotor speeds and pressure not negative."""
    bad = np.flatnonzero(np.isinf(values))
    if len(bad):
        raise LogError(
            f"{name}: {column} in data row {bad[0] + 1} is infinite ({len(bad)} such). Leave a "
            "cell empty where there is no sample."
        )
    low, high = -np.inf, np.inf
    if motor_number(column) is not None or column == "baro_pa":
        low = -_TINY
    if column.startswith("cmd_"):
        high = 1.0 + _TINY
    bad = np.flatnonzero((values < low) | (values > high))
    if len(bad):
        value = values[bad[0]]
        hint = ""
        if column.startswith("cmd_"):
            hint = " Scale pulse widths by (PWM - PWM_MIN) / (PWM_MAX - PWM_MIN)."
            if 1.0 < np.nanmax(values) <= 100.0:
                hint = " If it is in percent, divide it by 100."
        limits = f"{max(low, 0.0):g}..{1.0 if np.isfinite(high) else np.inf:g}"
        raise LogError(
            f"{name}: {column} in data row {bad[0] + 1} is {value:.6g}, outside {limits} "
            f"({len(bad)} such values).{hint}"
        )


def _check_phase(name: str, phase: "pd.Series[str]") -> None:
    """Only the known phases."""
    for value in phase.unique():
        if value and value not in PHASES:
            shown = value[:_SHOWN]
            near = difflib.get_close_matches(shown.lower(), PHASES, 1)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            raise LogError(
                f"{name}: unknown phase '{shown}' in data row "
                f"{int((phase == value).to_numpy().argmax()) + 1}; one of {', '.join(PHASES)} or "
                f"empty.{hint}"
            )


def _unit_quaternions(name: str, table: pd.DataFrame) -> tuple[pd.DataFrame, list[Finding]]:
    """Quaternions of unit norm; small deviations are mended and counted."""
    if "q_w" not in table:
        return table, []
    q = table[list(QUAT)].to_numpy(copy=True)
    norm = np.linalg.norm(q, axis=1)
    off = np.abs(norm - 1.0) > _NORM_DOUBT
    wrong = np.flatnonzero(np.abs(norm - 1.0) > 0.1)
    if len(wrong):
        k = int(wrong[0])
        raise LogError(
            f"{name}: the quaternion in data row {k + 1} has norm {norm[k]:.3g}, not 1 "
            f"({len(wrong)} such). Expected: q_w, q_x, q_y, q_z, body to NED."
        )
    if not off.any():
        return table, []
    mended = table.copy()
    q[off] /= norm[off, None]
    mended[list(QUAT)] = q
    count = int(off.sum())
    return mended, [Finding("warning", "q", "off unit norm by over 0.001, normalised", count)]


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
    if len(acc) and 0.3 < np.median(acc) < 3.0:
        message = f"median {np.median(acc):.2f} m/s^2: is it in g? 1 g = 9.80665 m/s^2"
        found.append(Finding("error", "acc", message))
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
    if "pos_z" in table and "vel_z" in table:
        both = table[["time", "pos_z", "vel_z"]].dropna()
        if len(both) > 20:
            climbed = np.gradient(both["pos_z"].to_numpy(), both["time"].to_numpy())
            speed = both["vel_z"].to_numpy()
            if np.std(climbed) > 1e-3 and np.std(speed) > 1e-3:
                fit = float(np.corrcoef(climbed, speed)[0, 1])
                if fit < -0.5:
                    message = f"vel_z and the slope of pos_z have opposite signs (r = {fit:.2f})"
                    found.append(Finding("error", "vel", message))
    return found
