"""The part of a flight in which the rotors carry the weight, and their commands meanwhile."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..logs import AnyFlight
from ..logs.columns import ACC, MIN_MOTORS, POS, QUAT, VEL, motor_columns
from ..representation import short_repr
from ..vehicle import GRAVITY_M_S2

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

LEAST_S = 2.0
"""A shorter stretch is no hover."""
_SLOW_M_S = 0.5
LONGEST_STEP_S = 0.2  # of what one command stands for
_NOT_FLOWN = ("ground", "takeoff", "land")


@dataclass(frozen=True, slots=True)
class Hover:
    """What the motors were told while the rotors carried the weight.

    Attributes:
        flight: Its name.
        t_s: Times of the commands, s, shape (n,).
        cmd: Commands 0..1, shape (n, motors); None: the flight has rotor speeds alone.
        rotor_rad_s: Measured speeds at the same times, shape (n, motors); None: not measured.
        load: Mean thrust over weight.
        voltage_v: Battery voltage at the same times, shape (n,); None: not logged.
        seconds: How long it is.
        hovers: Whether it hovered; else it flew all the while.
        where: Which part of the flight it is, in words.
    """

    flight: str
    t_s: Array
    cmd: Array | None
    rotor_rad_s: Array | None
    load: float
    voltage_v: Array | None
    seconds: float
    hovers: bool
    where: str

    __repr__ = short_repr

    @property
    def motors(self) -> int:
        """Number of motors."""
        return int(self._drive.shape[1])

    @property
    def level(self) -> float:
        """Median of the mean over the motors: of the commands, else of the speeds, rad/s."""
        return float(np.median(self._drive.mean(axis=1)))

    @property
    def each(self) -> tuple[float, ...]:
        """Median of each motor's command, else speed."""
        return tuple(np.median(self._drive, axis=0).tolist())

    @property
    def split(self) -> tuple[float, ...]:
        """Of each motor the command, else the speed, over the mean of all, less one."""
        each = np.array(self.each)
        return tuple((each / each.mean() - 1).tolist())

    @property
    def _drive(self) -> Array:
        drive = self.cmd if self.cmd is not None else self.rotor_rad_s
        assert drive is not None
        return drive


def drives(flight: AnyFlight) -> tuple[str, ...]:
    """Names of the columns that drive a model: commands, else rotor speeds; () without either."""
    for stem in ("cmd", "rotor"):
        count = sum(c.startswith(f"{stem}_") for c in flight.columns)
        if count >= MIN_MOTORS and flight.has(*motor_columns(stem, count)):
            return motor_columns(stem, count)
    return ()


def hover_of(flight: AnyFlight) -> Hover | None:
    """Hover of a flight: by its phases, else where it is slow, else all that it flew.

    Returns:
        None where it has no commands and no rotor speeds, all of them 0, or less than 2 s in the
        air.
    """
    columns = drives(flight)
    if not columns:
        return None
    t_s, drive = flight.signal(columns)
    if len(t_s) < 2:
        return None
    step_s = np.minimum(np.diff(t_s, append=t_s[-1]), LONGEST_STEP_S)
    for rows, hovers, where in _choices(flight, t_s, drive):
        seconds = float(step_s[rows].sum())
        if seconds >= LEAST_S and drive[rows].any():
            speeds = _speeds(flight, t_s[rows], drive.shape[1])
            return Hover(
                flight.name,
                t_s[rows],
                drive[rows] if columns[0].startswith("cmd") else None,
                drive[rows] if columns[0].startswith("rotor") else speeds,
                _load(flight, t_s[rows], hovers),
                sampled(flight, "vbat_v", t_s[rows]),
                seconds,
                hovers,
                where.format(seconds),
            )
    return None


def flown(flight: AnyFlight) -> Rows:
    """Where a flight is in the air, at the times of what drives its rotors, shape (n,)."""
    t_s, drive = flight.signal(drives(flight))
    return _flown(flight, t_s, drive)


def phases_at(flight: AnyFlight, t_s: Array) -> NDArray[np.object_]:
    """Phase at each time; "" where it is not known."""
    time, (codes, names) = flight.time_s, flight.phase_codes
    row = np.clip(np.searchsorted(time, t_s, side="right") - 1, 0, len(time) - 1)
    return names[codes[row]]


def common_samples(flight: AnyFlight, columns: Sequence[str]) -> tuple[Array, Array] | None:
    """Samples of columns that are taken at the same times; None: there are none."""
    if not flight.has(*columns):
        return None
    t_s, values = flight.signal(columns)
    return (t_s, values) if len(t_s) else None


def sampled(flight: AnyFlight, column: str, t_s: Array) -> Array | None:
    """A column at some times, on straight lines between its samples; None without it."""
    if not flight.has(column):
        return None
    t, values = flight.signal((column,))
    return np.interp(t_s, t, values[:, 0])


def _choices(flight: AnyFlight, t_s: Array, drive: Array) -> list[tuple[Rows, bool, str]]:
    """Rows, whether the aircraft hovers there, and which they are in words; the best first."""
    phase, air = phases_at(flight, t_s), _flown(flight, t_s, drive)
    steady = air & ~np.isin(phase, _NOT_FLOWN)
    found = [(phase == "hover", True, "phase hover, {:.0f} s")]
    moved = common_samples(flight, VEL)
    if moved is not None:
        speed = np.interp(t_s, moved[0], np.linalg.norm(moved[1], axis=1))
        slow = steady & (speed < _SLOW_M_S)
        found.append((slow, True, f"in the air below {_SLOW_M_S:g} m/s, {{:.0f}} s"))
    if flight.has(*ACC):
        text = "it never hovers: all {:.0f} s in the air, their thrust by the accelerometer"
        found.append((steady, False, text))
    else:
        text = "it never hovers, no accelerometer: all {:.0f} s in the air, as if level"
        found.append((steady, True, text))
    return found


def _flown(flight: AnyFlight, t_s: Array, drive: Array) -> Rows:
    """In the air: not on the ground by its phases; else above half a metre; else well driven."""
    phase = phases_at(flight, t_s)
    if np.any(phase == "ground"):
        return np.asarray(phase != "ground")
    mean = drive.mean(axis=1)
    driven = mean > 0.5 * np.percentile(mean, 90)
    place = common_samples(flight, POS)
    if place is not None:
        height = np.interp(t_s, place[0], -place[1][:, 2])
        return np.asarray(driven & (height > height.min() + 0.5)) if np.ptp(height) > 1 else driven
    return np.asarray(driven)


def _speeds(flight: AnyFlight, t_s: Array, motors: int) -> Array | None:
    """Measured rotor speeds at some times, shape (n, motors)."""
    measured = common_samples(flight, motor_columns("rotor", motors))
    if measured is None:
        return None
    t, speeds = measured
    return np.column_stack([np.interp(t_s, t, speeds[:, k]) for k in range(motors)])


def _load(flight: AnyFlight, t_s: Array, hovers: bool) -> float:
    """Mean thrust over weight: what a tilted aircraft needs, else what the accelerometer felt."""
    attitude = common_samples(flight, QUAT) if hovers else None
    if attitude is not None:
        t, q = attitude
        upright = 1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2)
        return float(np.mean(1.0 / np.interp(t_s, t, np.clip(upright, 0.2, 1.0))))
    down = None if hovers else sampled(flight, ACC[2], t_s)
    return 1.0 if down is None else float(-np.mean(down)) / GRAVITY_M_S2
