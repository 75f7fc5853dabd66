"""One flight on a uniform grid, as input of every finder: signals, rotors, parts in the air.

No vehicle is needed: commands are per rotor, forces per mass, moments per inertia. Positions and
directions of the rotors are those in the log, else those of the usual frame that explains best how
the body rotates.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from ..errors import LogError
from ..logs import Flight
from ..logs.airframe import Airframe
from ..logs.columns import (
    ACC,
    ACC_NED,
    GYRO,
    MAG,
    MAX_MOTORS,
    MIN_MOTORS,
    QUAT,
    VEL,
    motor_columns,
)
from ..logs.samples import stretches_where
from ..residuals.measured import Signal, measured_motion, signal_of
from ..vehicle import GRAVITY_M_S2, Vehicle
from ..vehicle.layouts import Layout, frame, frames_of

Array = NDArray[np.float64]
FINEST_S, COARSEST_S = 0.02, 0.1
"""Limits of the grid interval: a controller responds within 0.1 s; below 0.03 s vibration
dominates."""
FEWEST_SAMPLES = 20
"""Fewest samples of a signal in use."""
SHORTEST_S = 5.0
"""Shortest part in the air that is analysed."""
LOSS_TILT_RAD = np.radians(60.0)
"""Tilt of a loss of control, if it is twice the largest until a second before."""
LOSS_RATE_RAD_S = 4.0
"""Body rate of a loss of control, if it is three times the largest until a second before."""
FLIES_ON_S = 5.0
"""Time in the air after an impact from which it was no crash."""
CONTACT_M_S2 = 30.0
"""Specific force of an impact after a loss of control."""
FALLS_G = 0.5
"""Specific force of a falling body, over gravity: rotors spin down and carry part of it, and drag
is smaller up to 10 m/s."""
CLEAR_FALL_M = 0.5
"""Height of a fall after a flight that did not end on the ground, independent of its height signal:
a landing that rebounds falls by 0.05 m (nanobench B5). By judgement."""
GROUND_S = 2.0
"""Time before and after clearance from the ground in which the aircraft stands on it."""
LEAST_COMMAND = 0.02
"""Lower bound of a command in logarithms."""
FRAME_LAG_S = 0.2
"""Longest lag of the body's rotation behind commands in the search for the frame."""
LIFTING = 0.65
"""Assumed curvature of thrust by command in the detection of lift: between linear and square."""
FIT_SHARE, FIT_LEAST = 0.5, 0.6
"""Share of the best usual frame's correlation that the rotors of a vehicle file must reach, and
least correlation for a decision. By judgement."""
MISFIT = (
    "this vehicle file does not fit: the aircraft turns as if its rotors were in the order of "
    "another frame. Correct [rotors], or draft a file: uavtwin vehicle draft."
)
"""Text for rotors that do not reach it."""

_SIGNALS: dict[str, tuple[str, ...]] = {
    "acc": ACC,
    "mag": MAG,
    "baro": ("baro_pa",),
    "vbat": ("vbat_v",),
    "ibat": ("ibat_a",),
}
"""Signals of the flight table, except motion and motors."""


@dataclass(frozen=True, slots=True)
class Airborne:
    """A part of a flight in the air, as places of the grid.

    Attributes:
        start: First place.
        end: Place behind the last.
        lost: Place of a loss of control; None: there is none.
        crash: Place of an impact after that; None: there is none.
        falls: Whether it falls at its end, in the air.
    """

    start: int
    end: int
    lost: int | None = None
    crash: int | None = None
    falls: bool = False

    @property
    def flown(self) -> int:
        """Place behind the last one under control."""
        return self.end if self.lost is None else min(self.end, self.lost)


@dataclass(frozen=True, eq=False)
class FlightFrame:
    """A flight on a uniform grid.

    Attributes:
        flight: Flight as read.
        signals: Logged signals by name: command or rotor_speed, gyro, acc, q, pos, vel, mag, baro,
            vbat, ibat; only those in the log.
        edges_s: Edges of the intervals, shape (n + 1,).
        grid: Means over the intervals, shape (n, k) each.
        notes: Notes on derived signals and assumptions.
        cache: Results that several finders need, by name.
    """

    flight: Flight
    signals: Mapping[str, Signal]
    edges_s: Array
    grid: Mapping[str, Array]
    notes: tuple[str, ...]
    cache: dict[str, object] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def of(cls, flight: Flight) -> "FlightFrame":
        """Resample a flight to its grid.

        Raises:
            LogError: It has no motion.
        """
        signals, notes = _signals_of(flight)
        dt = _interval_s(signals)
        start, end = flight.time_s[0], flight.time_s[-1]
        if end - start < SHORTEST_S:
            raise LogError(
                f"{flight.name}: the log lasts less than {SHORTEST_S:g} s ({end - start:.3g} s), "
                "too short to know what is usual in it. Give a log of a longer flight."
            )
        # No sample is on an edge, where rounding would decide its interval.
        quarter = 0.25 / max(s.rate_hz for s in signals.values())
        edges = np.arange(start - quarter, end + dt, dt)
        grid = {name: binned(s, edges) for name, s in signals.items()}
        if "q" in grid:
            grid["q"] /= np.linalg.norm(grid["q"], axis=1, keepdims=True)
        return cls(flight, signals, edges, grid, tuple(notes))

    @property
    def crash_begins_s(self) -> float | None:
        """Time of the final loss of control, s, followed by an impact; None: there is none."""
        last = self.airborne[-1] if self.airborne else None
        if last is None or last.lost is None or last.crash is None:
            return None
        flies_on = last.end - last.crash > self.places(FLIES_ON_S)
        return None if flies_on else float(self.t_s[last.lost])

    @property
    def dt_s(self) -> float:
        """Interval of the grid."""
        return float(self.edges_s[1] - self.edges_s[0])

    @cached_property
    def t_s(self) -> Array:
        """Midpoints of the intervals, s from the start of the log, shape (n,)."""
        return np.asarray((self.edges_s[1:] + self.edges_s[:-1]) / 2)

    def places(self, seconds: float) -> int:
        """Number of intervals of a length of time."""
        return int(seconds / self.dt_s)

    def rate_hz(self, name: str) -> float:
        """Rate at which a signal is logged; 0: not logged."""
        return self.signals[name].rate_hz if name in self.signals else 0.0

    @cached_property
    def attitude(self) -> Array:
        """R_nb, body to NED, shape (n, 3, 3). The log must have an attitude."""
        return rotations(self.grid["q"])

    @cached_property
    def tilt_rad(self) -> Array | None:
        """Angle of the body's z axis from the vertical, shape (n,)."""
        if "q" not in self.grid:
            return None
        return np.asarray(np.arccos(np.clip(self.attitude[:, 2, 2], -1, 1)))

    @cached_property
    def drive(self) -> str | None:
        """Signal of the rotors: "command", else "rotor_speed" over its largest; None: neither."""
        return next((s for s in ("command", "rotor_speed") if s in self.grid), None)

    @cached_property
    def layout(self) -> Layout | None:
        """Rotors in the order of the commands, scaled to an arm of 1; None: not known."""
        if self.drive is None:
            return None
        count = self.grid[self.drive].shape[1]
        airframe = self.flight.airframe
        stated = None if airframe is None else airframe.layout
        if stated is not None and stated.count == count:
            return stated.sized(1.0, "scaled")
        usual = frames_of(count)
        if not usual:
            return None
        if airframe is not None:  # PX4 and ArduPilot number the motors of the first frame alike
            return frame(usual[0])
        return max(map(frame, usual), key=self.turning_explained)

    def turning_explained(self, layout: Layout) -> float:
        """Correlation, over roll, pitch and yaw, of demanded moments with the body's rotation; at
        the best of some lags."""
        if self.drive is None or "gyro" not in self.grid:
            return 0.0
        asked = lift(self.grid[self.drive]) @ moment_signs(layout)[1:].T
        turned = np.gradient(self.grid["gyro"], self.dt_s, axis=0)
        flown = np.zeros(len(self.t_s), dtype=bool)
        for part in self.airborne:
            flown[part.start : part.flown] = True
        if flown.sum() < FEWEST_SAMPLES:
            return 0.0
        lags = range(self.places(FRAME_LAG_S) + 1)
        return max(_alike(np.roll(asked, k, axis=0)[flown], turned[flown]) for k in lags)

    @cached_property
    def airborne(self) -> tuple[Airborne, ...]:
        """Parts in the air, with the loss of control in each."""
        joined: list[tuple[int, int]] = []
        for start, end in stretches_where(self._lifted()):
            if joined and start - joined[-1][1] < self.places(0.4):
                joined[-1] = joined[-1][0], end
            else:
                joined.append((start, end))
        clear = [self._off_the_ground(*part) for part in joined]
        return tuple(
            Airborne(a, z, *self._lost(a, z), self._falls_behind(z))
            for a, z in clear
            if (z - a) * self.dt_s > SHORTEST_S
        )

    @cached_property
    def above_ground_m(self) -> Array:
        """Height over the ground of take-off and landing, linear between them since barometers
        drift, shape (n,); infinity where neither is in the log, or no height."""
        above, near = np.full(len(self.t_s), np.inf), self.places(GROUND_S)
        if "pos" not in self.grid:
            return above
        height = -self.grid["pos"][:, 2]
        for part in self.airborne:
            ends = (part.start, max(part.start - near, 0)), (part.end, part.end)
            known = [(k, height[a : a + near].min()) for k, a in ends if 0 < k < len(height)]
            if known:
                rows = np.arange(part.start, part.end)
                at, ground = np.array(known).T
                above[rows] = height[rows] - np.interp(rows, at, ground)
        return above

    def fall(self, start: int, end: int) -> tuple[float, int, int]:
        """Longest fall that begins in a range of places, by the specific force only, from rest: its
        height, m, its first place and the place behind it; without one a height of 0."""
        if "acc" not in self.grid:
            return 0.0, start, start
        force = np.linalg.norm(self.grid["acc"][start:], axis=1) / GRAVITY_M_S2
        falls = [f for f in stretches_where(force < FALLS_G) if f[0] < end - start]
        if not falls:
            return 0.0, start, start
        a, z = max(falls, key=lambda f: f[1] - f[0])
        speed = np.cumsum(1.0 - force[a:z]) * GRAVITY_M_S2 * self.dt_s
        return float(speed.sum() * self.dt_s), start + a, start + z

    def _falls_behind(self, end: int) -> bool:
        """Whether it falls after the end of the rotor commands."""
        near = self.places(0.5)
        return self.fall(max(end - near, 0), end + near)[0] > CLEAR_FALL_M

    def _lifted(self) -> NDArray[np.bool_]:
        """Whether it may fly, by its rotor signal, else by height, else by vibration."""
        if self.drive is not None:
            raised = lift(self.grid[self.drive]).mean(axis=1)
            raised = scipy.ndimage.uniform_filter1d(raised, max(self.places(0.5), 1))
            usual = np.median(raised[raised >= 0.4 * np.percentile(raised, 90)])
            return np.asarray(raised > 0.5 * usual)
        if "pos" in self.grid:
            height = -self.grid["pos"][:, 2]
            return np.asarray(height > np.percentile(height, 5) + 0.4)
        if "gyro" in self.grid:
            turning = np.linalg.norm(self.grid["gyro"], axis=1)
            return np.asarray(
                scipy.ndimage.uniform_filter1d(turning, max(self.places(2.0), 1)) > 0.03
            )
        return np.ones(len(self.t_s), dtype=bool)

    def _off_the_ground(self, start: int, end: int) -> tuple[int, int]:
        """The part without moments in which the feet may touch the ground: by height over its
        ends."""
        if "pos" not in self.grid:
            return start, end
        height = -self.grid["pos"][:, 2]
        reach = np.ptp(height[start:end])
        before = height[max(start - self.places(1.0), 0)]
        later = end + self.places(0.5)
        after = height[later] if later < len(height) else -np.inf  # the record ends in the air
        clear = max(0.25, 0.15 * reach)
        up = np.flatnonzero((height[start:end] > before + clear) | (start == 0))
        down = np.flatnonzero((height[start:end] > after + clear) | (end == len(height)))
        if reach > 0.8 and len(up) and len(down) and up[0] < down[-1]:
            near = end if self._falls_behind(end) else start + int(down[-1]) + 1
            return start + int(up[0]), near
        return start, end

    def _lost(self, start: int, end: int) -> tuple[int | None, int | None]:
        """Places of a loss of control, with tilt or rates far beyond those before, and of the
        subsequent impact."""
        bad = np.zeros(end - start, dtype=bool)
        if self.tilt_rad is not None:
            tilt = self.tilt_rad[start:end]
            bad |= (tilt > LOSS_TILT_RAD) & (tilt > 2 * self._flown_until(tilt))
        if "gyro" in self.grid:
            smooth = scipy.ndimage.uniform_filter1d(
                self.grid["gyro"][start:end], 2 * self.places(0.08) + 1, axis=0
            )
            turning = np.linalg.norm(smooth, axis=1)
            bad |= (turning > LOSS_RATE_RAD_S) & (turning > 3 * self._flown_until(turning))
        bad[: self.places(3.0)] = False
        if not bad.any():
            return None, None
        lost = start + int(np.argmax(bad))
        if "acc" not in self.grid:
            return lost, None
        hit = np.linalg.norm(self.grid["acc"][lost:], axis=1) > CONTACT_M_S2
        return lost, lost + int(np.argmax(hit)) if hit.any() else None

    def _flown_until(self, values: Array) -> Array:
        """Largest value until a second before each place."""
        back = self.places(1.0)
        largest = np.maximum.accumulate(values)
        return np.concatenate([np.full(min(back, len(values)), values[0]), largest])[: len(values)]


def layout_of(vehicle: Vehicle) -> Layout:
    """Positions and directions of a vehicle's rotors."""
    rotors = vehicle.rotors
    return Layout(rotors.position_m, rotors.direction, True, 0.0, "the vehicle file")


def of_vehicle(flight: Flight, vehicle: Vehicle) -> Flight:
    """The flight with the rotors of a vehicle file in place of those in its log."""
    known = Airframe() if flight.airframe is None else flight.airframe
    return replace(flight, airframe=replace(known, layout=layout_of(vehicle)))


def misfit(flight: FlightFrame) -> str:
    """Reason why the rotors of a flight are not those of the aircraft; "": they may be."""
    layout = flight.layout
    usual = () if layout is None else frames_of(layout.count)
    if layout is None or not usual:
        return ""
    best = max(flight.turning_explained(frame(name)) for name in usual)
    own = flight.turning_explained(layout)
    return MISFIT if best > FIT_LEAST and own < FIT_SHARE * best else ""


def rotations(q_nb: Array) -> Array:
    """Matrices body to NED of unit quaternions, shape (n, 3, 3)."""
    return np.asarray(
        scipy.spatial.transform.Rotation.from_quat(q_nb, scalar_first=True).as_matrix()
    )


def lift(command: Array, curvature: float = LIFTING) -> Array:
    """Thrust of a command over that at full command: (1 - e) c + e c^2."""
    return (1 - curvature) * command + curvature * command * command


def moment_signs(layout: Layout) -> Array:
    """Effect of unit thrust of each rotor, up to a positive factor per row: specific force along z,
    angular acceleration about x, y, z (FRD). Shape (4, rotors)."""
    x, y = layout.position[:, 0], layout.position[:, 1]
    return np.stack([-np.ones(layout.count), -y, x, -layout.direction])


def _alike(asked: Array, turned: Array) -> float:
    """Sum over the axes of the correlation of changes, each clipped to a usual size: a crash has no
    influence."""
    a, b = _clipped(np.diff(asked, axis=0)), _clipped(np.diff(turned, axis=0))
    scale = np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    return float(np.sum((a * b).sum(axis=0) / np.maximum(scale, 1e-12)))


def _clipped(changes: Array) -> Array:
    """Changes clipped to three robust standard deviations."""
    most = 3 * 1.4826 * np.median(np.abs(changes), axis=0)
    return np.clip(changes, -most, most)


def binned(signal: Signal, edges_s: Array) -> Array:
    """Mean in each interval; empty intervals are interpolated. Shape (n, k)."""
    middle = (edges_s[1:] + edges_s[:-1]) / 2
    place = np.searchsorted(edges_s, signal.t_s, side="right") - 1
    inside = (place >= 0) & (place < len(middle))
    count = np.bincount(place[inside], minlength=len(middle))
    full = count > 0
    out = np.full((len(middle), signal.values.shape[1]), np.nan)
    for k, column in enumerate(signal.values.T):
        total = np.bincount(place[inside], column[inside], minlength=len(middle))
        out[:, k] = np.interp(middle, middle[full], total[full] / count[full])
    return out


def _signals_of(flight: Flight) -> tuple[dict[str, Signal], list[str]]:
    """Logged signals, missing motion derived, and notes on that."""
    motion = measured_motion(flight, doubts=False)
    notes = [n for n in motion.notes if "derived" in n]
    found: dict[str, Signal | None] = {name: _signal(flight, c) for name, c in _SIGNALS.items()}
    found |= {
        "pos": _whole(motion.position),
        "vel": _signal(flight, VEL) or _whole(motion.velocity),
    }
    found |= {"q": _whole(motion.attitude), "gyro": _signal(flight, GYRO) or _whole(motion.rates)}
    if found["acc"] is None and flight.has(*ACC_NED, *QUAT):
        found["acc"] = _derived_force(flight)
        notes.append("specific force derived from the motion")
    found["command"], speeds = (_motors(flight, stem) for stem in ("cmd", "rotor"))
    if speeds is not None:
        top = float(np.percentile(speeds.values, 99.5))
        found["rotor_speed"] = Signal(speeds.t_s, speeds.values / max(top, 1e-9))
    usable = {n: s for n, s in found.items() if s is not None and len(s.t_s) > FEWEST_SAMPLES}
    return usable, notes


def _signal(flight: Flight, columns: tuple[str, ...]) -> Signal | None:
    return _whole(signal_of(flight, columns)) if flight.has(*columns) else None


def _whole(signal: object) -> Signal | None:
    return signal if isinstance(signal, Signal) else None


def _derived_force(flight: Flight) -> Signal:
    """Specific force, body FRD, from acceleration NED and attitude in the same rows."""
    t_s, values = flight.signal((*ACC_NED, *QUAT))
    force = values[:, :3] - np.array([0.0, 0.0, GRAVITY_M_S2])
    return Signal(t_s, np.einsum("kij,ki->kj", rotations(values[:, 3:]), force))


def _motors(flight: Flight, stem: str) -> Signal | None:
    """Commands or speeds of all motors."""
    for count in range(MAX_MOTORS, MIN_MOTORS - 1, -1):
        if flight.has(*motor_columns(stem, count)):
            return _signal(flight, motor_columns(stem, count))
    return None


def _interval_s(signals: Mapping[str, Signal]) -> float:
    """Interval of the grid: half the rate of the gyroscope, twice the rate of the rotor signal."""
    drive = signals.get("command", signals.get("rotor_speed"))
    rates = [2 * drive.rate_hz] if drive is not None else []
    rates += [signals["gyro"].rate_hz / 2] if "gyro" in signals else []
    known = [r for r in rates if r > 0]
    return float(np.clip(1 / min(known), FINEST_S, COARSEST_S)) if known else COARSEST_S
