"""Lag of the measured rotor speeds behind the motor commands, and correction of late time stamps.

A rotor follows its command by a first-order lag; a telemetry link adds a pure delay, which no rotor
has. Both are fitted to the speeds,

    w_i(t) = g_i x_i(t - d) + slow,    T dx_i/dt = c_i - x_i,

by least squares over a grid of (T, d), one gain per motor, with variations slower than `_SLOW_S`
removed. A second regression estimates the time of the motion that the speeds cause: angular
acceleration about x and y and specific force along z on the squares of all speeds, with free
coefficients, so that neither needs the vehicle. Speeds cannot come after their effect: where they
do, their stamps are late. Where they do not, the commands act late, and the stamps stay.

Standard deviations come from a jackknife over blocks of `_BLOCK_S`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray

from .columns import ACC, GYRO, MAX_MOTORS, motor_columns
from .flight import Array, Finding, Flight
from .lags import Blocks, LaggedMoments, best_lag
from .stored import AnyFlight, StoredFlight

_F = TypeVar("_F", bound=AnyFlight)

_SPEEDS = motor_columns("rotor", MAX_MOTORS)
LONGEST_DEAD_TIME_S = 0.03
"""Longest pure delay from a command to its rotor: a frame of 50 Hz servo pulses, 20 ms, is the
slowest protocol of speed controllers; half as much again for the controller, by judgement."""
LONGEST_TIME_CONSTANT_S = 0.2
"""Longest time constant: published first-order lags are 15 to 75 ms, that of the 0.6 m propellers
of an 18 kg aircraft is 0.1 s (Quiver PT1, measured here); twice that, by judgement."""
LEAST_R2 = 0.3
"""Smallest R^2 of an informative regression."""
_SURE = 2.0
"""Standard deviations by which a delay must exceed a limit."""
_BLOCK_S = 2.0  # of the jackknife: several time constants
_FEWEST_BLOCKS, _MOST_BLOCKS = 5, 150  # blocks of a record
_FEWEST_SAMPLES = 40  # samples of a signal
_SLOW_S = 1.0  # slower variations are removed
_TURNING = 0.05  # least command of a turning motor
_MOST_HZ = 50.0  # highest rate of speeds in use: more adds no information
_CONSTANTS_S = np.array([0.0, 0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.14, 0.2, 0.28, 0.4])
"""Grid of T."""
_DELAYS_S = np.arange(-0.1, 0.601, 0.02)  # coarse grid of d
_NEAR_S = np.arange(-0.04, 0.0401, 0.005)  # fine grid about the best of it
_LAG_STEP_S = 0.005  # step of integration of the lag
_INTERPOLATED = 0.1
"""Uncertainty from straight lines between commands, as a share of their interval: the smoothing
shifts the delay, which the jackknife does not show (found at 10 Hz on simulated flights)."""
_GRID_S = 0.02  # of motion and speeds
_AHEAD = np.arange(-15, 31)  # candidate leads of the motion over the speeds, in steps of the grid
_BAND_HZ = (0.4, 4.0)  # frequencies at which motion follows the speeds
_LONGEST_S = 1200.0
"""Longest record in use; of a longer one, the middle."""


@dataclass(frozen=True, slots=True)
class SpeedLag:
    """Lag of the speeds of a flight behind its commands and its motion.

    Attributes:
        delay_s: Pure delay behind the commands.
        delay_sd_s: Standard deviation of the delay.
        time_constant_s: Time constant of the first-order lag behind the commands, on the grid of
            the fit.
        r2: Share of the variance of the speeds that the commands explain.
        motion_s: Lead of the motion over the speeds; None: not observable.
        motion_sd_s: Standard deviation of that lead.
        motion_r2: Share of the variance of the motion that the speeds explain at that lead.
    """

    delay_s: float
    delay_sd_s: float
    time_constant_s: float
    r2: float
    motion_s: float | None = None
    motion_sd_s: float = 0.0
    motion_r2: float = 0.0

    @property
    def surplus_s(self) -> float:
        """Part of the lag that no motor can have, s; 0 where a motor may have all of it."""
        late_s = self.delay_s + max(self.time_constant_s - LONGEST_TIME_CONSTANT_S, 0.0)
        return late_s if late_s - _SURE * self.delay_sd_s > LONGEST_DEAD_TIME_S else 0.0

    @property
    def in_step(self) -> bool:
        """Whether the motion shows that the time stamps of the speeds are correct despite the
        lag."""
        if self.motion_s is None:
            return False
        return self.motion_s + _SURE * self.motion_sd_s < self.surplus_s / 2

    def __str__(self) -> str:
        text = (
            f"{1e3 * self.delay_s:.0f} ms (sd {1e3 * self.delay_sd_s:.0f}) and a time constant of "
            f"{1e3 * self.time_constant_s:.0f} ms behind the commands (R2 {self.r2:.2f})"
        )
        if self.motion_s is None:
            return text
        return (
            f"{text}; {1e3 * self.motion_s:.0f} ms (sd {1e3 * self.motion_sd_s:.0f}) behind the "
            f"motion (R2 {self.motion_r2:.2f})"
        )


def align_speed_stamps(flight: _F) -> _F:
    """The flight with time stamps of rotor speeds corrected by the lag that no motor can have.

    A fact states the lag of every flight in which it is observable; a finding states the
    correction.
    """
    lag = speed_lag(flight)
    if lag is None:
        return flight
    flight = replace(flight, facts={**flight.facts, "rotor lag": str(lag)})
    late_s = round(lag.surplus_s, 3)
    if late_s <= 0.0:
        return flight
    if lag.in_step:
        message = (
            f"the speeds come {lag}: they are in step with the motion, so that the commands are "
            "early or act late (effect command_delay)"
        )
        return _noted(flight, Finding("warning", "rotor", message))
    message = (
        f"time stamps were late and are set {1e3 * late_s:.0f} ms earlier: the speeds come {lag}; "
        f"a motor has a pure delay of at most {1e3 * LONGEST_DEAD_TIME_S:.0f} ms. What is left of "
        "it is clock_offset.rotor_s"
    )
    moved = replace(_earlier(flight, _SPEEDS, late_s), speeds_late_s=flight.speeds_late_s + late_s)
    return _noted(moved, Finding("warning", "rotor", message))


def as_stamped(flight: Flight) -> Flight:
    """The flight with rotor speeds, accelerometer and gyroscope at their original time stamps.

    The low-pass of the vehicle explains the delay of these sensors then. Rows left without a sample
    are dropped.
    """
    moves = [(_SPEEDS, flight.speeds_late_s)]
    for signal, delay_s in flight.filter_delays_s.items():
        moves.append((tuple(f"{signal}_{a}" for a in "xyz"), delay_s))
    if not any(late_s for _, late_s in moves):
        return flight
    for columns, late_s in moves:
        flight = _earlier(flight, columns, -late_s) if late_s else flight
    sampled = [c for c in flight.table if c not in ("time", "phase")]
    table = flight.table.dropna(how="all", subset=sampled, ignore_index=True)
    return replace(flight, table=table, speeds_late_s=0.0, filter_delays_s={})


def _noted(flight: _F, finding: Finding) -> _F:
    return replace(flight, findings=(*flight.findings, finding))


def _earlier(flight: _F, columns: Sequence[str], late_s: float) -> _F:
    """The flight with samples of some columns earlier; those before the start of the record are
    dropped."""
    there = [c for c in columns if flight.has(c)]
    if not there:
        return flight
    if isinstance(flight, StoredFlight):
        # the rows of the file remain: values move to rows that had a value
        mended = dict(flight.mended)
        for column in there:
            t_s, values = flight.signal([column])
            known = np.isfinite(flight.columns[column])
            moved = np.full(len(known), np.nan)
            moved[known] = np.interp(t_s + late_s, t_s, values[:, 0], right=np.nan)
            mended[column] = moved
        return replace(flight, mended=mended)
    own = flight.table[["time", *there]].dropna(how="all", subset=there)
    own = own.assign(time=np.round(own["time"] - late_s, 6))
    own = own[own["time"] >= flight.table["time"].iloc[0]]
    rest = flight.table.drop(columns=there)
    nearest = np.round(rest["time"], 6)  # rows within one microsecond are one row
    table = pd.merge(
        rest.assign(_key=nearest), own.rename(columns={"time": "_key"}), on="_key", how="outer"
    ).sort_values("_key", ignore_index=True)
    table["time"] = table["time"].fillna(table["_key"])
    if "phase" in table:
        table["phase"] = table["phase"].ffill()
    return replace(flight, table=table[list(flight.table.columns)])


# -- measured ---------------------------------------------------------------------------------


def speed_lag(flight: AnyFlight) -> SpeedLag | None:
    """Lag of the rotor speeds of a flight behind its commands and its motion.

    Returns:
        None where the flight lacks either signal, or the lag is not observable.
    """
    n = next((k for k in range(MAX_MOTORS) if not flight.has(f"rotor_{k + 1}")), MAX_MOTORS)
    if n == 0 or not flight.has(*motor_columns("cmd", n)):
        return None
    numbers = range(1, n + 1)
    speeds = [_one(flight, f"rotor_{k}") for k in numbers]
    commands = [_one(flight, f"cmd_{k}") for k in numbers]
    edges = _blocks([*speeds, *commands], commands)
    if edges is None:
        return None
    behind = _behind_commands(speeds, commands, edges)
    if behind is None:
        return None
    motion = _behind_motion(flight, speeds, edges)
    return behind if motion is None else replace(behind, **motion)


Samples = tuple[Array, Array]
"""Times, s, and values of one column, shape (n,) each."""


def _samples(flight: AnyFlight, columns: Sequence[str]) -> tuple[Array, Array]:
    """Times, shape (n,), and values, shape (n, k), of the middle of a flight."""
    middle_s = (flight.time_s[0] + flight.time_s[-1]) / 2
    span = float(middle_s - _LONGEST_S / 2), float(middle_s + _LONGEST_S / 2)
    if isinstance(flight, StoredFlight):
        t_s, values, _ = flight.around(columns, *span)
    else:
        t_s, values = flight.signal(columns)
    inside = (t_s >= span[0]) & (t_s <= span[1])
    return t_s[inside], values[inside]


def _one(flight: AnyFlight, column: str) -> Samples:
    t_s, values = _samples(flight, [column])
    return t_s, values[:, 0]


def _blocks(signals: list[Samples], commands: list[Samples]) -> Array | None:
    """Starts of the blocks in which all motors turn and every signal has its samples, shape (b,);
    an evenly spaced selection where there are very many."""
    if any(len(t) < _FEWEST_SAMPLES for t, _ in signals):
        return None
    begin = max(t[0] for t, _ in signals) + _SLOW_S
    end = min(t[-1] for t, _ in signals) - _SLOW_S
    if end - begin < _FEWEST_BLOCKS * _BLOCK_S:
        return None
    edges = np.arange(begin, end, _BLOCK_S)
    good = np.ones(len(edges) - 1, dtype=np.bool_)
    for t, _ in signals:
        count = np.diff(np.searchsorted(t, edges))
        good &= count >= 0.5 * _BLOCK_S / float(np.median(np.diff(t)))
    middle = (edges[1:] + edges[:-1]) / 2
    for t, values in commands:
        good &= np.interp(middle, t, values) > _TURNING
    chosen = edges[:-1][good]
    if len(chosen) < _FEWEST_BLOCKS:
        return None
    if len(chosen) > _MOST_BLOCKS:
        chosen = chosen[np.linspace(0, len(chosen) - 1, _MOST_BLOCKS).round().astype(np.intp)]
    return np.asarray(chosen)


def _block_of(t_s: Array, begins: Array) -> NDArray[np.intp]:
    """Number of the block at each time, -1 outside."""
    block = np.searchsorted(begins, t_s, side="right") - 1
    inside = (block >= 0) & (t_s < begins[np.maximum(block, 0)] + _BLOCK_S)
    return np.asarray(np.where(inside, block, -1), dtype=np.intp)


def _without_slow(t_s: Array, values: Array) -> Array:
    """Values less their mean over `_SLOW_S` to either side."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    low = np.searchsorted(t_s, t_s - _SLOW_S)
    high = np.searchsorted(t_s, t_s + _SLOW_S, side="right")
    mean = (total[high] - total[low]) / (high - low)
    return np.asarray(values - mean, dtype=np.float64)


class _Motor:
    """Speeds of one motor and its commands."""

    def __init__(self, speed: Samples, command: Samples, begins: Array) -> None:
        t_s, values = speed
        hz = 1.0 / float(np.median(np.diff(t_s)))
        each = slice(None, None, max(1, round(hz / _MOST_HZ)))
        near = _block_of(t_s, begins - _SLOW_S) >= 0
        near |= _block_of(t_s, begins + _SLOW_S) >= 0
        self._t_s = t_s[near][each]
        y = _without_slow(self._t_s, values[near][each])
        block = _block_of(self._t_s, begins)
        self._inside, self._count = block >= 0, len(begins)
        self._block = block[self._inside]
        y = y[self._inside]
        size = float(np.sqrt(np.mean(y * y)))
        self._y = y / size if size > 0.0 else y
        self._grid_s = np.arange(command[0][0], command[0][-1], _LAG_STEP_S)
        self._command = np.interp(self._grid_s, *command)
        self.total = self._sums(self._y * self._y)

    def _sums(self, values: Array) -> Array:
        return np.asarray(np.bincount(self._block, values, self._count), dtype=np.float64)

    def lagged(self, constant_s: float) -> Array:
        """The command after a first-order lag, on the grid of the commands."""
        if constant_s <= 0.0:
            return self._command
        keep, first = float(np.exp(-_LAG_STEP_S / constant_s)), self._command[0]
        new = (1.0 - keep) / 2.0  # trapezoidal: no delay of half a step
        return np.asarray(
            scipy.signal.lfilter([new, new], [1.0, -keep], self._command - first) + first
        )

    def products(self, lagged: Array, delay_s: float) -> tuple[Array, Array]:
        """Sums over each block of model squared and of model times speed, shape (b,) each."""
        model = np.interp(self._t_s - delay_s, self._grid_s, lagged)
        model = _without_slow(self._t_s, model)[self._inside]
        return self._sums(model * model), self._sums(model * self._y)


def _behind_commands(
    speeds: list[Samples], commands: list[Samples], begins: Array
) -> SpeedLag | None:
    motors = [_Motor(s, c, begins) for s, c in zip(speeds, commands, strict=True)]
    total = np.array([m.total for m in motors])  # (motors, b)
    if not (total.sum(axis=1) > 0.0).all():
        return None

    def table(constants_s: Array, delays_s: Array) -> Array:
        """Sums of products, shape (2, constants, delays, motors, b)."""
        found = np.empty((2, len(constants_s), len(delays_s), len(motors), len(begins)))
        for m, motor in enumerate(motors):
            for i, constant in enumerate(constants_s):
                lagged = motor.lagged(float(constant))
                for k, delay in enumerate(delays_s):
                    found[:, i, k, m] = motor.products(lagged, float(delay))
        return found

    def r2(products: Array, blocks: Blocks = slice(None)) -> Array:
        """Share of variance explained over some blocks, shape (constants, delays)."""
        square, cross = products[..., blocks].sum(axis=-1)
        explained = np.maximum(cross, 0.0) ** 2 / np.maximum(square, 1e-30)
        return np.asarray(explained.sum(axis=-1) / total[:, blocks].sum())

    coarse = r2(table(_CONSTANTS_S, _DELAYS_S))
    at, near = divmod(int(coarse.argmax()), len(_DELAYS_S))
    if coarse.max() < LEAST_R2:
        return None
    low, high = _CONSTANTS_S[max(at - 1, 0)], _CONSTANTS_S[min(at + 1, len(_CONSTANTS_S) - 1)]
    constants_s, delays_s = np.linspace(low, high, 13), _DELAYS_S[near] + _NEAR_S
    products = table(constants_s, delays_s)

    delay_s, sd_s, share = best_lag(
        delays_s, lambda used: r2(products, used).max(axis=0), len(begins)
    )
    constant_s = float(constants_s[r2(products).max(axis=1).argmax()])
    interval_s = max(float(np.median(np.diff(t))) for t, _ in commands)
    return SpeedLag(delay_s, float(np.hypot(sd_s, _INTERPOLATED * interval_s)), constant_s, share)


def _behind_motion(
    flight: AnyFlight, speeds: list[Samples], begins: Array
) -> dict[str, float] | None:
    """Lead of angular acceleration and specific force over the speeds."""
    channels: list[Samples] = []
    if flight.has(*GYRO):
        t_s, rates = _samples(flight, GYRO)
        channels += [(t_s, rates[:, 0]), (t_s, rates[:, 1])]
    turning = len(channels)
    if flight.has(*ACC):
        t_s, force = _samples(flight, ACC)
        channels.append((t_s, force[:, 2]))
    if not channels or any(len(t) < _FEWEST_SAMPLES for t, _ in channels):
        return None
    reach_s = 3.0
    ends = (begins[0] - reach_s, begins[-1] + _BLOCK_S + reach_s)
    grid_s = np.arange(*ends, _GRID_S)
    slowest = min(1.0 / float(np.median(np.diff(t))) for t, _ in (*channels, *speeds))
    band = (_BAND_HZ[0], min(_BAND_HZ[1], 0.4 * slowest))
    if band[1] < 2 * band[0]:
        return None
    filters = scipy.signal.butter(2, band, "band", fs=1 / _GRID_S, output="sos")
    y = np.column_stack([np.interp(grid_s, *c) for c in channels])
    y[:, :turning] = np.gradient(y[:, :turning], _GRID_S, axis=0)
    x = np.column_stack([np.interp(grid_s, t, np.square(w)) for t, w in speeds])
    y, x = (scipy.signal.sosfiltfilt(filters, v, axis=0) for v in (y, x))
    block = _block_of(grid_s, begins)
    for t, _ in channels:  # a block with a gap is not used
        count = np.diff(np.searchsorted(t, np.column_stack([begins, begins + _BLOCK_S])), axis=1)
        hole = count[:, 0] < 0.5 * _BLOCK_S / float(np.median(np.diff(t)))
        block[hole[np.maximum(block, 0)]] = -1
    rows = np.flatnonzero(block >= 0)
    rows = rows[(rows + _AHEAD[0] >= 0) & (rows + _AHEAD[-1] < len(grid_s))]
    size = np.sqrt(np.mean(np.square(y[rows]), axis=0)) if len(rows) else np.zeros(1)
    if len(np.unique(block[rows])) < _FEWEST_BLOCKS or not (size > 0.0).all():
        return None
    y = y[rows] / size
    x = x / np.maximum(np.sqrt(np.mean(np.square(x), axis=0)), 1e-30)
    order = [np.flatnonzero(block[rows] == b) for b in range(len(begins))]
    there = [r for r in order if len(r)]
    moments = LaggedMoments.of([x[rows + ahead] for ahead in _AHEAD], y, there)

    def r2(used: Blocks) -> Array:
        """Share of variance explained over some blocks, shape (leads,)."""
        chosen = moments.over(used)
        return np.asarray(chosen.regressed()[1].sum(axis=1) / chosen.channels.sum())

    ahead_s, sd_s, share = best_lag(np.asarray(_AHEAD * _GRID_S, dtype=np.float64), r2, len(there))
    if share < LEAST_R2:
        return None
    return {"motion_s": ahead_s, "motion_sd_s": sd_s, "motion_r2": share}
