"""Hover of a flight: the part in which the rotors carry the weight, and its commands.

Also whether a flight turned as the rotors of a layout predict: a check of order and direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ..logs import AnyFlight, Flight
from ..logs.columns import ACC, GYRO, MIN_MOTORS, POS, QUAT, VEL, motor_columns
from ..logs.samples import interpolated
from ..logs.stored import phases_at
from ..representation import ShortRepr
from ..vehicle import GRAVITY_M_S2
from ..vehicle.layouts import FRAMES, Layout, frame, frames_of

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

LEAST_S = 2.0
"""Shortest stretch of hover."""
_SLOW_M_S = 0.5
"""Speed below which a flight without phases is in hover, m/s; by judgement."""
LONGEST_STEP_S = 0.2  # longest time for which one command is valid
_NOT_FLOWN = ("ground", "takeoff", "land")  # phases without a hover


@dataclass(frozen=True, slots=True)
class Hover(ShortRepr):
    """Commands of the motors while the rotors carry the weight.

    Attributes:
        flight: Name of the flight.
        t_s: Times of the commands, s, shape (n,).
        cmd: Commands 0..1, shape (n, motors); None: the flight has rotor speeds only.
        rotor_rad_s: Measured speeds at the same times, shape (n, motors); None: not measured.
        load: Mean thrust over weight.
        voltage_v: Battery voltage at the same times, shape (n,); None: not logged.
        seconds: Duration.
        hovers: Whether the aircraft hovered; else all of its time in the air is used.
        where: Part of the flight in words.
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

    @property
    def motors(self) -> int:
        """Number of motors."""
        return int(self._drive.shape[1])

    @property
    def level(self) -> float:
        """Median over time of the mean over motors: of commands, else of speeds, rad/s."""
        return float(np.median(self._drive.mean(axis=1)))

    @property
    def each(self) -> tuple[float, ...]:
        """Median command of each motor, else its speed."""
        return tuple(np.median(self._drive, axis=0).tolist())

    @property
    def split(self) -> tuple[float, ...]:
        """Command of each motor, else its speed, over the mean of all, less one."""
        each = np.array(self.each)
        return tuple((each / each.mean() - 1).tolist())

    @property
    def _drive(self) -> Array:
        drive = self.cmd if self.cmd is not None else self.rotor_rad_s
        assert drive is not None
        return drive


def drives(flight: AnyFlight) -> tuple[str, ...]:
    """Names of the columns with the inputs of a model: commands, else rotor speeds; () without
    either."""
    for stem in ("cmd", "rotor"):
        count = sum(c.startswith(f"{stem}_") for c in flight.columns)
        if count >= MIN_MOTORS and flight.has(*motor_columns(stem, count)):
            return motor_columns(stem, count)
    return ()


def hover_of(flight: AnyFlight) -> Hover | None:
    """Hover of a flight: by its phases, else where it is slow, else all of its time in the air.

    Returns:
        None where it has no commands and no rotor speeds, where all are 0, or with less than 2 s in
        the air.
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
    """Whether a flight is in the air, at the times of its commands or rotor speeds, shape (n,)."""
    t_s, drive = flight.signal(drives(flight))
    return _flown(flight, t_s, drive)


def common_samples(flight: AnyFlight, columns: Sequence[str]) -> tuple[Array, Array] | None:
    """Samples of columns at common times; None: there are none."""
    if not flight.has(*columns):
        return None
    t_s, values = flight.signal(columns)
    return (t_s, values) if len(t_s) else None


def sampled(flight: AnyFlight, column: str, t_s: Array) -> Array | None:
    """A column at given times, by linear interpolation; None without the column."""
    if not flight.has(column):
        return None
    t, values = flight.signal((column,))
    return np.interp(t_s, t, values[:, 0])


def _choices(flight: AnyFlight, t_s: Array, drive: Array) -> list[tuple[Rows, bool, str]]:
    """Rows, whether the aircraft hovers in them, and their description; the best first."""
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
    """Rows in the air: not on the ground by the phases; else above half a metre; else with high
    commands."""
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
    """Measured rotor speeds at given times, shape (n, motors)."""
    measured = common_samples(flight, motor_columns("rotor", motors))
    if measured is None:
        return None
    return interpolated(t_s, *measured)


def _load(flight: AnyFlight, t_s: Array, hovers: bool) -> float:
    """Mean thrust over weight: by the tilt in hover, else by the accelerometer."""
    attitude = common_samples(flight, QUAT) if hovers else None
    if attitude is not None:
        t, q = attitude
        upright = 1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2)
        return float(np.mean(1.0 / np.interp(t_s, t, np.clip(upright, 0.2, 1.0))))
    down = None if hovers else sampled(flight, ACC[2], t_s)
    return 1.0 if down is None else float(-np.mean(down)) / GRAVITY_M_S2


AXES = ("roll", "pitch", "yaw")  # axes of the moments
CLEAR = 0.3
"""Correlation from which a flight is informative on how its rotors turn it."""
_GRID_S = 0.01
"""Time step for the comparison of commands and body rates, s."""
_BAND_HZ = (0.5, 8.0)
"""Frequency band of that comparison, Hz: above slow trims, below vibration."""
_LAG_S = 0.03
"""Usual lag of a motor, s, by which commands are delayed."""
_LEAST_S = 3.0
"""Shortest flight whose rotation is compared with layouts, s; by judgement."""


@dataclass(frozen=True, slots=True)
class Turning:
    """Agreement of a flight with a layout.

    Attributes:
        roll: Correlation of angular acceleration with the moment of the rotors about x.
        pitch: Correlation about y.
        yaw: Correlation about z.
    """

    roll: float
    pitch: float
    yaw: float

    @property
    def worst(self) -> float:
        """Smaller correlation of roll and pitch."""
        return min(self.roll, self.pitch)

    def __str__(self) -> str:
        return f"roll {self.roll:+.2f}, pitch {self.pitch:+.2f}, yaw {self.yaw:+.2f}"


def turning(flight: Flight, layout: Layout) -> Turning | None:
    """Correlation of angular acceleration with moments of the commands, 0.5 to 8 Hz, in flight.

    Returns:
        None: no body rates, another number of motors, or too short.
    """
    columns = drives(flight)
    driven, rotated = common_samples(flight, columns), common_samples(flight, GYRO)
    if len(columns) != layout.count or driven is None or rotated is None:
        return None
    (t_s, commands), (t_gyro, rates) = driven, rotated
    air = flown(flight)
    grid = np.arange(max(t_s[0], t_gyro[0]), min(t_s[-1], t_gyro[-1]), _GRID_S)
    if len(grid) < _LEAST_S / _GRID_S:
        return None
    thrust = interpolated(grid - _LAG_S, t_s, commands)
    x, y = layout.position[:, 0], layout.position[:, 1]
    moments = thrust @ np.column_stack([-y, x, -layout.direction])
    turned = interpolated(grid, t_gyro, rates)
    band = scipy.signal.butter(2, np.array(_BAND_HZ) * 2.0 * _GRID_S, "bandpass", output="sos")
    inside = np.interp(grid, t_s, air.astype(np.float64)) > 0.5
    if inside.sum() < _LEAST_S / _GRID_S:
        return None
    pushed = scipy.signal.sosfiltfilt(band, moments, axis=0)[inside]
    rose = np.gradient(scipy.signal.sosfiltfilt(band, turned, axis=0), _GRID_S, axis=0)[inside]
    return Turning(*(_correlation(pushed[:, k], rose[:, k]) for k in range(3)))


def best_frame(flight: Flight, motors: int) -> tuple[str, Turning] | None:
    """The frame with this number of motors that agrees best with a flight; None: none agrees
    clearly."""
    found = [(name, t) for name in frames_of(motors) if (t := turning(flight, frame(name)))]
    clear = [(name, t) for name, t in found if t.worst > CLEAR]
    return max(clear, key=lambda each: each[1].worst + each[1].yaw, default=None)


def same_shape(flights: Sequence[Flight], name: str) -> str | None:
    """The other frame with the same hubs by which flights turned, clearly about all three axes;
    None: the given one is clear in a flight, or the flights match none or several."""
    found: set[str] = set()
    for flight in flights:
        turned, best = turning(flight, frame(name)), best_frame(flight, frame(name).count)
        if turned is not None and min(turned.worst, turned.yaw) > CLEAR:
            return None
        if best is not None and best[1].yaw > CLEAR:
            found.add(best[0])
    if len(found) != 1 or _hubs(other := found.pop()) != _hubs(name):
        return None
    return other


def _hubs(name: str) -> set[tuple[float, float]]:
    """Hub positions of a frame, without their order and directions."""
    return {(x, y) for x, y, _ in FRAMES[name][0]}


def _correlation(a: Array, b: Array) -> float:
    size = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / size if size > 0 else 0.0
