"""The flight table: every column, its unit and its meaning, written once.

Columns and limits of a sensor come from its declaration in `twin.physics.sensors.table`.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..physics.sensors.table import SENSORS

Columns = Mapping[str, NDArray[Any]]
"""A flight table by column: numbers as float64, `phase` as text, shape (n,) each. In memory, or in
a file from which each is read on demand."""

PHASES = ("takeoff", "hover", "forward", "tour", "land", "ground")  # phases of a flight
MIN_MOTORS, MAX_MOTORS = 3, 12  # number of motors of a multirotor


@dataclass(frozen=True, slots=True)
class Column:
    """One column of the flight table; `{i}` in the name stands for 1..n, n the number of motors."""

    name: str
    unit: str
    description: str

    @property
    def per_motor(self) -> bool:
        """Whether the table has one such column for each motor."""
        return "{i}" in self.name


COLUMNS: tuple[Column, ...] = (  # in the order of a table
    Column("time", "s", "time from the start of the record, strictly increasing; required"),
    Column("cmd_{i}", "1", "command of motor i as the speed controller receives it, 0..1"),
    Column("rotor_{i}", "rad/s", "measured speed of rotor i, not negative"),
    *(
        Column(name, s.plain_unit, meaning)
        for s in SENSORS
        for name, meaning in zip(s.columns, s.meanings, strict=True)
    ),
    Column("pos_x", "m", "position north, NED, from a fixed origin"),
    Column("pos_y", "m", "position east, NED"),
    Column("pos_z", "m", "position down, NED; negative above the origin"),
    Column("vel_x", "m/s", "velocity north, NED"),
    Column("vel_y", "m/s", "velocity east, NED"),
    Column("vel_z", "m/s", "velocity down, NED"),
    Column("q_w", "1", "attitude, body to NED, Hamilton quaternion, scalar part"),
    Column("q_x", "1", "attitude, body to NED, x part"),
    Column("q_y", "1", "attitude, body to NED, y part"),
    Column("q_z", "1", "attitude, body to NED, z part"),
    Column("roll_rad", "rad", "roll, in place of q_*: the last of yaw, pitch, roll, NED to body"),
    Column("pitch_rad", "rad", "pitch, in place of q_*: positive nose up"),
    Column("yaw_rad", "rad", "yaw, in place of q_*: 0 north, positive to the east"),
    Column(
        "acc_ned_x", "m/s^2", "acceleration north, NED, of the motion: 0 at rest, no gravity in it"
    ),
    Column("acc_ned_y", "m/s^2", "acceleration east, NED"),
    Column("acc_ned_z", "m/s^2", "acceleration down, NED"),
    Column("vbat_v", "V", "battery voltage"),
    Column("ibat_a", "A", "battery current, positive while discharging"),
    Column("phase", "", "phase of flight: " + ", ".join(PHASES) + ', or "" where unknown'),
)

ACC = ("acc_x", "acc_y", "acc_z")  # specific force, FRD, m/s^2
GYRO = ("gyro_x", "gyro_y", "gyro_z")  # body rates, FRD, rad/s
MAG = ("mag_x", "mag_y", "mag_z")  # magnetic field, FRD, T
POS = ("pos_x", "pos_y", "pos_z")  # NED, m
VEL = ("vel_x", "vel_y", "vel_z")  # NED, m/s
QUAT = ("q_w", "q_x", "q_y", "q_z")  # body FRD to NED, Hamilton, unit norm
ACC_NED = ("acc_ned_x", "acc_ned_y", "acc_ned_z")  # acceleration of the motion, NED, m/s^2
EULER = ("roll_rad", "pitch_rad", "yaw_rad")  # yaw, then pitch, then roll
ALIASES = {f"acc_world_{a}": f"acc_ned_{a}" for a in "xyz"}
"""Names of columns that stand for another column, and that column."""
MOTION = (*ACC, *GYRO, *POS, *VEL, *QUAT, *ACC_NED)  # a flight needs at least one of these

_MOTOR = re.compile(r"(cmd|rotor)_([1-9][0-9]{0,3})")  # name of a motor's column


def motor_columns(stem: str, n: int) -> tuple[str, ...]:
    """Names of the columns of n motors: `motor_columns("cmd", 4)` is cmd_1 .. cmd_4."""
    return tuple(f"{stem}_{i}" for i in range(1, n + 1))


def motor_number(name: str) -> int | None:
    """Number of the motor a column belongs to, None where it belongs to none."""
    match = _MOTOR.fullmatch(name)
    return int(match.group(2)) if match else None


def is_known(name: str) -> bool:
    """Whether a flight table may have a column of this name."""
    return motor_number(name) is not None or name in {c.name for c in COLUMNS}


def in_order(names: Iterable[str]) -> list[str]:
    """Column names in the order of the definition, motors by number; then unknown ones."""
    rank = {c.name: k for k, c in enumerate(COLUMNS)}

    def key(name: str) -> tuple[int, int]:
        """Rank in the definition, then number of the motor."""
        number = motor_number(name)
        if number is None:
            return rank.get(name, len(rank)), 0
        return rank[name[: name.index("_")] + "_{i}"], number

    return sorted(names, key=key)


class _Over(Columns):
    """Columns of a table, some of them replaced: `over`."""

    def __init__(self, changed: Columns, table: Columns) -> None:
        self._changed, self._table = changed, table

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._changed[name] if name in self._changed else self._table[name]

    def __iter__(self) -> Iterator[str]:
        yield from in_order({*self._table, *self._changed})

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return name in self._changed or name in self._table


def over(changed: Columns, table: Columns) -> Columns:
    """A table with some columns changed, others new, in the order of the definition; no data is
    read or copied."""
    return _Over(changed, table)


# -- limits -------------------------------------------------------------------------------------
#
# Limits that no flight exceeds: a value beyond is damaged, or in another unit. For every format.

Array = NDArray[np.float64]

LIMITS = {
    **{s.signal: s.limit for s in SENSORS},
    "acc_ned": 2e3,
    "pos": 1e6,
    "vel": 1e3,
    "vbat_v": 1e3,
    "ibat_a": 1e4,
    "rotor": 1e5,
}
"""Largest magnitude of each component of a signal, SI, by signal."""
SIGNALS: dict[str, tuple[str, ...]] = {
    **{s.signal: s.columns for s in SENSORS},
    "acc_ned": ACC_NED,
    "pos": POS,
    "vel": VEL,
    "vbat_v": ("vbat_v",),
    "ibat_a": ("ibat_a",),
}
"""Columns to which a limit applies; `rotor` has one column per motor."""

_DAMAGED = {  # the likeliest mistake, by signal
    **{s.signal: s.damaged for s in SENSORS},
    "pos": "in mm, or in degrees times 1e7?",
    "vel": "in mm/s?",
}


def _parts(unit: str, thousandth: str) -> tuple[tuple[str, float], ...]:
    return (f"tenths of {unit}", 0.1), (f"hundredths of {unit}", 1e-2), (thousandth, 1e-3)


READINGS: dict[str, tuple[str, float, float, tuple[tuple[str, float], ...]]] = {
    **{
        s.signal: (s.plain_unit, s.usual.low, s.usual.high, s.usual.other_units)
        for s in SENSORS
        if s.usual is not None
    },
    "vbat_v": ("V", 2.0, 120.0, _parts("a volt", "mV")),
    "ibat_a": ("A", 0.05, 400.0, _parts("an ampere", "mA")),
}
"""Unit of a signal, range of the median of its magnitude while a multirotor flies, and other units
in which it is written, with their factors to the unit. Current and voltage cover a 1S whoop to a
24S lifter, by judgement, pressure up to 9 km, the magnetic field that of the Earth near iron.
"""


def other_unit(signal: str, reading: float) -> str:
    """Other units in which a reading would be plausible: `in mV 16.4 V, ...?`.

    Args:
        signal: A key of `READINGS`; the result is "" for any other.
        reading: Median magnitude, in the unit of the flight table.

    Returns:
        "" where the reading is plausible as it is, or in none of the other units.
    """
    if signal not in READINGS:
        return ""
    unit, low, high, others = READINGS[signal]
    if low <= reading <= high:
        return ""
    fitting = [
        f"in {name} it would be {reading * factor:.4g} {unit}"
        for name, factor in others
        if low <= reading * factor <= high
    ]
    return f"{', '.join(fitting)}: another unit?" if fitting else ""


def beyond_limit(signal: str, values: Array) -> NDArray[np.bool_]:
    """Samples with a component beyond the limit of the signal, shape (n,).

    Args:
        signal: A key of `LIMITS`; for any other no sample is beyond.
        values: Samples, shape (n, k).
    """
    return np.asarray((np.abs(values) > LIMITS.get(signal, np.inf)).any(axis=1))


def beyond_message(signal: str, values: Array) -> str:
    """The text of a finding on samples beyond the limit.

    Args:
        signal: A key of `LIMITS`.
        values: Samples beyond the limit, shape (n, k).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.linalg.norm(values, axis=1)
    finite = size[np.isfinite(size)]
    unit = other_unit(signal, float(np.median(finite))) if len(finite) else ""
    if unit:
        unit = f"median {np.median(finite):.4g}; {unit}"
    unit = unit or f"damaged, or {_DAMAGED.get(signal, 'another unit?')}"
    return f"samples left out, a value is beyond {LIMITS[signal]:g} (SI): {unit}"
