"""The measured state of a flight at any time, from whatever the flight holds.

Where the flight lacks velocity or body rates, they are derived from position and attitude, and
`MeasuredMotion.notes` says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt, savgol_filter

from ..errors import LogError
from ..frames import rotation_vector
from ..logs import Flight
from ..logs.columns import GYRO, POS, QUAT, VEL
from ..representation import short_repr

Array = NDArray[np.float64]
RATE_CUTOFF_HZ = 30.0
"""Zero-phase low-pass of measured body rates before they become a state or are differentiated.
Above it there is rotor vibration (28 Hz and more in the X150 logs), not motion of the body."""
AGREEMENT_HZ = 3.0
"""Below it attitude and gyroscope are compared."""
LONGEST_GAP_INTERVALS = 5.0
"""A pause of more than so many median intervals is a gap: no state is made up inside it."""
LONGEST_GAP_S = 0.25
"""No gap longer than this is bridged, however slow the signal."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A vector signal with its own times, interpolated linearly, NaN outside and in gaps."""

    t_s: Array
    values: Array

    __repr__ = short_repr

    @property
    def rate_hz(self) -> float:
        """Samples per second by the median interval; 0 for a single sample."""
        return 0.0 if len(self.t_s) < 2 else 1.0 / float(np.median(np.diff(self.t_s)))

    def at(self, t_s: Array) -> Array:
        """Interpolated values, shape (len(t_s), k)."""
        out = np.stack([np.interp(t_s, self.t_s, v) for v in self.values.T], axis=-1)
        if len(self.t_s) < 2:
            out[np.abs(t_s - self.t_s[0]) > 1e-9] = np.nan
            return out
        after = np.clip(np.searchsorted(self.t_s, t_s, side="left"), 1, len(self.t_s) - 1)
        span = self.t_s[after] - self.t_s[after - 1]
        limit = max(LONGEST_GAP_INTERVALS / self.rate_hz, 1e-9)
        outside = (t_s < self.t_s[0] - 1e-9) | (t_s > self.t_s[-1] + 1e-9)
        out[outside | (span > min(limit, max(LONGEST_GAP_S, 1.5 / self.rate_hz)))] = np.nan
        return out

    def held(self, t_s: Array) -> Array:
        """Last sample at or before each time (the first one before the record)."""
        index = np.searchsorted(self.t_s, t_s + 1e-9, side="right") - 1
        return self.values[np.maximum(index, 0)]


@dataclass(frozen=True, slots=True)
class MeasuredMotion:
    """Measured position, velocity, attitude and body rates; None where the flight has none.

    Attributes:
        rates: Body rates low-passed at `RATE_CUTOFF_HZ`, rad/s.
        rates_measured: Whether a gyroscope measured them; else they come from the attitude.
        notes: What was derived or is missing, for the report.
    """

    position: Signal | None
    velocity: Signal | None
    attitude: Signal | None
    rates: Signal | None
    rates_measured: bool
    notes: tuple[str, ...]

    __repr__ = short_repr


def measured_motion(flight: Flight) -> MeasuredMotion:
    """Collect the motion signals of a flight.

    Raises:
        LogError: The flight has neither accelerometer, gyro, attitude nor position.
    """
    notes: list[str] = []
    position, velocity, attitude = (_signal(flight, c) for c in (POS, VEL, QUAT))
    gyro = _signal(flight, GYRO)
    if attitude is not None:
        attitude = _continuous(attitude)
    measured = gyro is not None
    if velocity is None and position is not None and len(position.t_s) > 9:
        velocity = _derivative(position)
        notes.append("velocity derived from position (Savitzky-Golay, 9 samples)")
    if gyro is None and attitude is not None and len(attitude.t_s) > 9:
        gyro = rates_of(attitude)
        notes.append("body rates derived from attitude")
    missing = [
        n
        for n, s in (("attitude", attitude), ("velocity", velocity), ("body rates", gyro))
        if s is None
    ]
    if len(missing) == 3 and not flight.has("acc_x"):
        raise LogError(
            f"{flight.name}: no motion signal. The gap needs acc_*, gyro_*, q_* or pos_*; the "
            f"flight has {', '.join(c for c in flight.table if flight.has(c))}."
        )
    if missing:
        notes.append(f"no {', no '.join(missing)}: channels that need them are left out")
    rates = None if gyro is None else Signal(gyro.t_s, zero_phase(gyro, RATE_CUTOFF_HZ))
    if measured and rates is not None and attitude is not None:
        notes += _attitude_doubt(attitude, rates)
    return MeasuredMotion(position, velocity, attitude, rates, measured, tuple(notes))


def zero_phase(signal: Signal, cutoff_hz: float) -> Array:
    """Values low-passed forward and backward (Butterworth, second order each way).

    A cutoff above 0.4 of the sample rate leaves the values as they are.
    """
    rate = signal.rate_hz
    if len(signal.t_s) < 16 or cutoff_hz > 0.4 * rate:
        return signal.values
    b, a = butter(2, cutoff_hz / (rate / 2))
    return np.asarray(filtfilt(b, a, signal.values, axis=0), dtype=np.float64)


def differentiate(signal: Signal) -> Array:
    """Central differences on the signal's own times, shape as the values."""
    return np.asarray(np.gradient(signal.values, signal.t_s, axis=0), dtype=np.float64)


def _signal(flight: Flight, columns: Sequence[str]) -> Signal | None:
    return Signal(*flight.signal(columns)) if flight.has(*columns) else None


def _continuous(attitude: Signal) -> Signal:
    """Unit quaternions with signs such that neighbours are close."""
    q = attitude.values / np.linalg.norm(attitude.values, axis=1, keepdims=True)
    flips = np.sign(np.sum(q[1:] * q[:-1], axis=1))
    flips[flips == 0] = 1.0
    signs = np.concatenate([[1.0], np.cumprod(flips)])
    return Signal(attitude.t_s, q * signs[:, None])


def _derivative(signal: Signal) -> Signal:
    smooth = savgol_filter(signal.values, 9, 2, axis=0)
    return Signal(signal.t_s, differentiate(Signal(signal.t_s, smooth)))


def rates_of(attitude: Signal) -> Signal:
    """Body rates between neighbouring attitudes, rad/s, at the times half-way."""
    step = rotation_vector(attitude.values[1:], attitude.values[:-1])
    dt = np.diff(attitude.t_s)[:, None]
    return Signal((attitude.t_s[1:] + attitude.t_s[:-1]) / 2, step / dt)


def agreement(attitude: Signal, rates: Signal, later_s: float = 0.0) -> float | None:
    """Correlation of the turning of the attitude with the gyroscope, -1 to 1.

    Both pass a low-pass at `AGREEMENT_HZ`; a conjugated quaternion, one in the order x, y, z, w or
    one of other axes gives little or nothing.

    Args:
        attitude: Quaternions of neighbouring signs.
        rates: Body rates, rad/s.
        later_s: By how much the attitude lags behind the gyroscope.

    Returns:
        None where there is too little of either, or hardly any turning.
    """
    if len(attitude.t_s) < 40 or attitude.rate_hz < 5 * AGREEMENT_HZ:
        return None
    turning = rates_of(attitude)
    slow = zero_phase(turning, AGREEMENT_HZ)
    gyro = Signal(rates.t_s, zero_phase(rates, AGREEMENT_HZ)).at(turning.t_s - later_s)
    known = np.all(np.isfinite(gyro) & np.isfinite(slow), axis=1)
    a, b = slow[known], gyro[known]
    size = float(np.sqrt(np.mean(b**2))) if known.any() else 0.0
    if size < 0.05:
        return None
    return float(np.sum(a * b) / np.sqrt(np.sum(a * a) * np.sum(b * b) + 1e-30))


def _attitude_doubt(attitude: Signal, rates: Signal) -> list[str]:
    """A warning when attitude and gyroscope turn in different ways."""
    same = agreement(attitude, rates)
    if same is None or same > 0.5:
        return []
    return [
        f"attitude and gyroscope do not turn together (correlation {same:.2f}): check that q "
        f"is [w, x, y, z], body to NED, and that both use forward-right-down axes"
    ]
