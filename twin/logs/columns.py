"""The flight table: every column, its unit and its meaning, written once."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]
"""A flight table by column: numbers as float64, `phase` as text, shape (n,) each. In memory, or in
a file from which each is read when it is asked for."""

PHASES = ("takeoff", "hover", "forward", "tour", "land", "ground")
MIN_MOTORS, MAX_MOTORS = 3, 12


@dataclass(frozen=True, slots=True)
class Column:
    """One column of the flight table; `{i}` in the name stands for 1..n, n the number of motors."""

    name: str
    unit: str
    description: str

    @property
    def per_motor(self) -> bool:
        """Whether there is one such column for each motor."""
        return "{i}" in self.name


COLUMNS: tuple[Column, ...] = (
    Column("time", "s", "time from the start of the record, strictly increasing; required"),
    Column("cmd_{i}", "1", "command of motor i as the speed controller receives it, 0..1"),
    Column("rotor_{i}", "rad/s", "measured speed of rotor i, not negative"),
    Column("acc_x", "m/s^2", "specific force along body x (forward), FRD"),
    Column("acc_y", "m/s^2", "specific force along body y (right), FRD"),
    Column("acc_z", "m/s^2", "specific force along body z (down), FRD; about -9.8 at rest"),
    Column("gyro_x", "rad/s", "body rate about x (roll), FRD"),
    Column("gyro_y", "rad/s", "body rate about y (pitch), FRD"),
    Column("gyro_z", "rad/s", "body rate about z (yaw), FRD"),
    Column("mag_x", "T", "magnetic flux density along body x, FRD"),
    Column("mag_y", "T", "magnetic flux density along body y, FRD"),
    Column("mag_z", "T", "magnetic flux density along body z, FRD"),
    Column("baro_pa", "Pa", "static pressure"),
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

ACC = ("acc_x", "acc_y", "acc_z")
GYRO = ("gyro_x", "gyro_y", "gyro_z")
MAG = ("mag_x", "mag_y", "mag_z")
POS = ("pos_x", "pos_y", "pos_z")
VEL = ("vel_x", "vel_y", "vel_z")
QUAT = ("q_w", "q_x", "q_y", "q_z")
ACC_NED = ("acc_ned_x", "acc_ned_y", "acc_ned_z")
EULER = ("roll_rad", "pitch_rad", "yaw_rad")
MOTION = (*ACC, *GYRO, *POS, *VEL, *QUAT, *ACC_NED)

_MOTOR = re.compile(r"(cmd|rotor)_([1-9][0-9]{0,3})")


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
        """Rank of the definition, then number of the motor."""
        number = motor_number(name)
        if number is None:
            return rank.get(name, len(rank)), 0
        return rank[name[: name.index("_")] + "_{i}"], number

    return sorted(names, key=key)


class _Over(Columns):
    """See `over`."""

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
    """A table with some columns changed, others new, in the order of the definition; nothing of it
    is read or copied."""
    return _Over(changed, table)
