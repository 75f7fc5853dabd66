"""Requirements on a flight table (LogError) and doubts about it (Finding)."""

import difflib

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import LogError, NoLogError
from .agreement import signals
from .assemble import NORM_DOUBT
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
    SIGNALS,
    VEL,
    Columns,
    beyond_limit,
    beyond_message,
    is_known,
    motor_columns,
    motor_number,
    over,
)
from .doubts import gaps
from .flight import Array, Finding

_MOST_UNKNOWN = 100  # columns that are listed by name
_SHOWN = 40  # characters of a name in an error
_TINY = 1e-6  # rounding of a command
_OVERFLOW = 0.5
"""Excess of commands outside 0..1 that counts as overflow, where less than `_MOSTLY` are
outside."""
_MOSTLY = 0.2  # share of commands outside from which the unit is wrong


NO_TABLE = (  # text for a recording
    "a recording of uavtwin simulate holds what the parts of a simulation gave, no flight table: "
    "to use it as one, keep time and rename the columns that a flight would log, imu.acc_x to acc_x"
)


def is_recording(columns: list[str]) -> bool:
    """Whether a table is a recording of a simulation: only time and columns PART.VARIABLE."""
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
    first = ", ".join(c[:_SHOWN] for c in columns[:12])
    alien = not any(is_known(c) for c in columns if c not in ("time", "phase"))
    error = NoLogError if alien else LogError
    if "time" not in columns:
        raise error(f"{name}: no column 'time' (s). It has: {first}.")
    if not any(c in columns for c in (*MOTION, *EULER)):
        raise error(
            f"{name}: no motion signal besides time; at least one of acc, gyro, pos, vel, q, "
            f"roll, pitch and yaw, acc_ned is needed. It has: {first}."
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
    """Check that motors are numbered 1..n without gaps, 3 to 12 of them, with as many commands as
    rotors."""
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


def validate(name: str, table: Columns) -> tuple[dict[str, Array], list[Finding]]:
    """Check the values of a flight table whose columns are known.

    Args:
        name: File name, for messages.
        table: Flight table by column, `phase` among them.

    Returns:
        Columns that had to be corrected: samples beyond all limits dropped, commands slightly
        outside 0..1 clipped, quaternions normalised. And the doubts.

    Raises:
        LogError: Time that does not increase, infinite values, commands outside 0..1, ...
    """
    if not len(table["time"]):
        raise LogError(f"{name}: no rows.")
    _check_time(name, table["time"])
    numbers = [c for c in table if c != "phase"]
    empty = [c for c in numbers if np.isnan(table[c]).all()]
    mended, bounded = _bounded(table)
    table = over(mended, table)
    for column in numbers:
        _check_range(name, column, table[column])
    _check_phase(name, table["phase"])
    if not any(np.isfinite(table[c]).any() for c in MOTION if c in table):
        left_out = f" {bounded[0].where}: {bounded[0].message}" if bounded else ""
        raise LogError(f"{name}: the motion signals have no sample, all cells are empty.{left_out}")
    unit, findings = _unit_quaternions(name, table)
    mended |= unit
    findings += [Finding("warning", c, "has no sample at all") for c in empty]
    findings += _partial_vectors(table)
    return mended, [*bounded, *findings, *gaps(table, signals(table))]


def _partial_vectors(table: Columns) -> list[Finding]:
    """Findings on rows in which some components of a vector are NaN."""
    found = []
    for group in (ACC, GYRO, MAG, POS, VEL, QUAT, ACC_NED):
        there = [~np.isnan(table[c]) for c in group if c in table]
        there = [t for t in there if t.any()]
        if not there:
            continue
        some, every = there[0].copy(), there[0].copy()
        for one in there[1:]:
            some |= one
            every &= one
        count = int(np.count_nonzero(some & ~every))
        if count:
            message = "rows with NaN in a part of the vector; the vector is left out there"
            found.append(Finding("error", group[0][:-2], message, count))
    return found


def _check_time(name: str, t_s: Array) -> None:
    """Check that every row has a time and that time increases."""
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


def _bounded(table: Columns) -> tuple[dict[str, Array], list[Finding]]:
    """Columns with samples beyond all limits dropped and commands slightly outside 0..1 clipped."""
    mended: dict[str, Array] = {}
    found = []
    rotors = {"rotor": tuple(c for c in table if c.startswith("rotor_"))}
    for signal, columns in (SIGNALS | rotors).items():
        there = [c for c in columns if c in table]
        out = np.zeros(len(table["time"]), dtype=np.bool_)
        refused = out.copy()  # infinite values are refused, below
        for column in there:
            out |= beyond_limit(signal, table[column][:, None])
            refused |= np.isinf(table[column])
        out &= ~refused
        if out.any():
            for column in there:
                mended[column] = np.where(out, np.nan, table[column])
            left_out = np.column_stack([table[column][out] for column in there])
            message = beyond_message(signal, left_out)
            found.append(Finding("error", signal, message, int(np.count_nonzero(out))))
    commands = [c for c in table if c.startswith("cmd_")]
    count, worst = 0, 0.5
    for column in commands:
        cmd = table[column]
        off = cmd[(cmd < -_TINY) | (cmd > 1.0 + _TINY)]
        count += len(off)
        if len(off):
            farthest = float(off[np.argmax(np.abs(off - 0.5))])
            worst = max(worst, farthest, key=lambda c: abs(c - 0.5))
    if (
        count
        and abs(worst - 0.5) <= 0.5 + _OVERFLOW
        and count < _MOSTLY * len(commands) * len(table["time"])
    ):
        message = (
            f"values outside 0..1, the farthest {worst:.4g}, set to its end: a duty cycle that "
            "overflows?"
        )
        mended |= {c: np.clip(table[c], 0.0, 1.0) for c in commands}
        found.append(Finding("error", "cmd", message, count))
    return mended, found


def _check_range(name: str, column: str, values: Array) -> None:
    """Check that values are finite or empty; commands 0..1; rotor speeds and pressure not
    negative."""
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
            if 1.0 < np.nanmedian(values) <= 100.0:
                hint = " If it is in percent, divide it by 100."
        limits = f"{max(low, 0.0):g}..{1.0 if np.isfinite(high) else np.inf:g}"
        raise LogError(
            f"{name}: {column} in data row {bad[0] + 1} is {value:.6g}, outside {limits} "
            f"({len(bad)} such values).{hint}"
        )


def _check_phase(name: str, phase: NDArray[np.object_]) -> None:
    """Check that phases are known ones."""
    for value in pd.unique(phase):
        if value and value not in PHASES:
            shown = value[:_SHOWN]
            near = difflib.get_close_matches(shown.lower(), PHASES, 1)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            raise LogError(
                f"{name}: unknown phase '{shown}' in data row "
                f"{int(np.asarray(phase == value).argmax()) + 1}; one of {', '.join(PHASES)} or "
                f"empty.{hint}"
            )


def _unit_quaternions(name: str, table: Columns) -> tuple[dict[str, Array], list[Finding]]:
    """Quaternions of unit norm; small deviations are corrected and counted."""
    if "q_w" not in table:
        return {}, []
    norm = np.zeros(len(table["time"]))
    for column in QUAT:
        norm += np.square(table[column])
    norm = np.sqrt(norm, out=norm)
    off = np.abs(norm - 1.0) > NORM_DOUBT
    wrong = np.flatnonzero(np.abs(norm - 1.0) > 0.1)
    if len(wrong):
        k = int(wrong[0])
        raise LogError(
            f"{name}: the quaternion in data row {k + 1} has norm {norm[k]:.3g}, not 1 "
            f"({len(wrong)} such). Expected: q_w, q_x, q_y, q_z, body to NED."
        )
    if not off.any():
        return {}, []
    norm[~off] = 1.0
    count = int(np.count_nonzero(off))
    found = [Finding("warning", "q", "off unit norm by over 0.001, normalised", count)]
    return {c: table[c] / norm for c in QUAT}, found
