"""The measured state of a flight at any time, from the signals of the flight.

Where the flight lacks velocity or body rates, they are derived from position and attitude, and
`MeasuredMotion.notes` reports it. Between samples a signal is linear, or a cubic spline
(`smooth_at`); `resample_like` resamples a continuous signal at the samples of another one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from ..errors import LogError
from ..frames import multiply, rotation_vector
from ..logs import AnyFlight, Flight, StoredFlight
from ..logs.columns import GYRO, POS, QUAT, VEL
from ..logs.samples import interpolated
from ..representation import ShortRepr

Array = NDArray[np.float64]
RATE_CUTOFF_HZ = 30.0
"""Zero-phase low-pass of measured body rates before they are used as a state or differentiated.
Above it there is rotor vibration (28 Hz and more in the X150 logs), not motion of the body."""
AGREEMENT_HZ = 3.0
"""Low-pass before attitude and gyroscope are compared."""
AGREEMENT_BLOCK_S = 600.0
"""Length of blocks in which they are compared in a longer flight, with the results summed."""
CLOCK_WINDOW_S, CLOCK_STEP_S, OLDEST_S = 3.0, 0.005, 0.15
"""Length of windows in which the age of an attitude is estimated, step, and largest age on either
side."""
CLOCK_BAND_HZ = 0.5, 6.0
"""Band of body rates in which the age is estimated."""
CLEAR, FEWEST_WINDOWS = 0.7, 4
"""Correlation from which a window is used, and smallest number of windows. Made up."""
WANDER_S = 0.04
"""Difference of the tenth and ninetieth percentile of these ages from which a single age is not
valid. Chosen on NanoBench's four flights, which have 0.03 to 0.09; a log of PX4 at 83 Hz has
none."""
ROWS = 1 << 18
"""Samples per block, where an equation has many terms."""
_EDGE = 9
"""Samples by which a signal is mirrored at its ends before it is filtered, as in `filtfilt`."""
_BEFORE, _AFTER = slice(_EDGE, 0, -1), slice(-2, -_EDGE - 2, -1)
"""Samples that are mirrored at the start and at the end."""
LONGEST_GAP_INTERVALS = 5.0
"""A pause of more median intervals than this is a gap, in which no state is interpolated."""
LONGEST_GAP_S = 0.25
"""Longest gap that is interpolated, however slow the signal."""
_COINCIDENT = 0.02
"""Share of the usual interval below which two samples all but coincide; made up."""


@dataclass(frozen=True, slots=True)
class Signal(ShortRepr):
    """A vector signal with its own times, linear between samples, NaN outside and in gaps.

    Attributes:
        t_s: Times, s, shape (n,).
        values: Samples, shape (n, k).
        settled_hz: Sample rate that was fixed during recording; None: by its times.
    """

    t_s: Array
    values: Array
    settled_hz: float | None = None

    @property
    def rate_hz(self) -> float:
        """Sample rate by the median interval; 0 for a single sample."""
        return self.settled_hz or _rate_hz(self.t_s)

    def at(self, t_s: Array) -> Array:
        """Interpolated values, shape (len(t_s), k)."""
        return _interpolated(t_s, self.t_s, self.values, self.rate_hz)

    def held(self, t_s: Array) -> Array:
        """Last sample at or before each time (the first one before the record)."""
        return _held(t_s, self.t_s, self.values)

    def between(self, start_s: float, end_s: float) -> "Signal":
        """Samples within a span of time, both ends included."""
        first = int(np.searchsorted(self.t_s, start_s, side="left"))
        end = int(np.searchsorted(self.t_s, end_s, side="right"))
        return replace(self, t_s=self.t_s[first:end], values=self.values[first:end])


@dataclass(frozen=True, slots=True)
class StoredSignal(ShortRepr):
    """A signal of a flight that stays in its file: the interface of `Signal`, read on demand.

    Attributes:
        flight: Flight with the signal.
        columns: Columns of the flight table.
        rate_hz: Sample rate by the median interval; 0 for a single sample.
        signs: Signs that make neighbouring unit quaternions continuous, shape (rows,); None: values
            as in the table.
        settled_hz: Fixed sample rate as in `Signal`.
    """

    flight: StoredFlight
    columns: tuple[str, ...]
    rate_hz: float
    signs: NDArray[np.int8] | None = None
    settled_hz: float | None = None

    @property
    def t_s(self) -> Array:
        """Times of all samples."""
        return self.flight.signal(self.columns)[0]

    @property
    def values(self) -> Array:
        """All samples."""
        return self.between(-np.inf, np.inf).values

    def at(self, t_s: Array) -> Array:
        """Interpolated values, shape (len(t_s), k)."""
        there = self._around(float(np.min(t_s)), float(np.max(t_s)))
        return _interpolated(t_s, there.t_s, there.values, self.rate_hz)

    def held(self, t_s: Array) -> Array:
        """Last sample at or before each time (the first one before the record)."""
        there = self._around(float(np.min(t_s)), float(np.max(t_s)))
        return _held(t_s, there.t_s, there.values)

    def between(self, start_s: float, end_s: float) -> Signal:
        """Samples within a span of time, both ends included."""
        return self._around(start_s, end_s).between(start_s, end_s)

    def _around(self, start_s: float, end_s: float) -> Signal:
        """Samples within a span of time, and some on either side."""
        t_s, values, first = self.flight.around(self.columns, start_s, end_s)
        if self.signs is None:
            return Signal(t_s, values, self.settled_hz)
        signs = self.signs[self.flight.rows_of(t_s, first)]
        return Signal(t_s, _unit(values) * signs[:, None], self.settled_hz)


AnySignal = Signal | StoredSignal


def signal_of(flight: AnyFlight, columns: Sequence[str]) -> AnySignal:
    """Samples of some columns, left in the file for a stored flight.

    Raises:
        LogError: A column is missing or has no finite sample.
    """
    settled = None if flight.settled is None else flight.settled.rates_hz.get(columns[0])
    if isinstance(flight, Flight):
        return Signal(*flight.signal(columns), settled)
    rate_hz = settled or _rate_hz(flight.signal(columns)[0])
    return StoredSignal(flight, tuple(columns), rate_hz, settled_hz=settled)


def blocks_of(signal: AnySignal, block_s: float) -> Iterator[Signal]:
    """A signal in blocks of time of about equal length."""
    t_s = signal.t_s
    start_s, end_s = float(t_s[0]), float(t_s[-1])
    del t_s
    count = max(1, int(np.ceil((end_s - start_s) / block_s)))
    edges = np.linspace(start_s, end_s, count + 1)
    for first, last in pairwise(edges):
        yield signal.between(float(first), float(last))


def _rate_hz(t_s: Array) -> float:
    return 0.0 if len(t_s) < 2 else 1.0 / float(np.median(np.diff(t_s)))


def _interpolated(t_s: Array, known_s: Array, values: Array, rate_hz: float) -> Array:
    """Values at times, NaN outside the known span and in gaps."""
    out = interpolated(t_s, known_s, values)
    if len(known_s) < 2:
        out[np.abs(t_s - known_s[0]) > 1e-9] = np.nan
        return out
    after = np.clip(np.searchsorted(known_s, t_s, side="left"), 1, len(known_s) - 1)
    span = known_s[after] - known_s[after - 1]
    limit = max(LONGEST_GAP_INTERVALS / rate_hz, 1e-9)
    outside = (t_s < known_s[0] - 1e-9) | (t_s > known_s[-1] + 1e-9)
    out[outside | (span > min(limit, max(LONGEST_GAP_S, 1.5 / rate_hz)))] = np.nan
    return out


def _held(t_s: Array, known_s: Array, values: Array) -> Array:
    index = np.searchsorted(known_s, t_s + 1e-9, side="right") - 1
    return values[np.maximum(index, 0)]


@dataclass(frozen=True, slots=True)
class MeasuredMotion(ShortRepr):
    """Measured position, velocity, attitude and body rates; None where the flight has none.

    Attributes:
        rates: Body rates low-passed at `RATE_CUTOFF_HZ`, rad/s.
        rates_measured: Whether a gyroscope measured them; else they are derived from the attitude.
        notes: Notes on derived and missing signals, for the report.
    """

    position: AnySignal | None
    velocity: AnySignal | None
    attitude: AnySignal | None
    rates: AnySignal | None
    rates_measured: bool
    notes: tuple[str, ...]

    @property
    def restarts(self) -> bool:
        """Whether a twin can be set to the measured state: attitude, velocity and rates are
        there."""
        return not (self.attitude is None or self.velocity is None or self.rates is None)


def measured_motion(flight: AnyFlight, doubts: bool = True) -> MeasuredMotion:
    """Motion signals of a flight.

    Args:
        flight: Flight as read.
        doubts: Whether to check if attitude and gyroscope agree.

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
            f"flight has {', '.join(c for c in flight.columns if flight.has(c))}."
        )
    if missing:
        notes.append(f"no {', no '.join(missing)}: channels that need them are left out")
    rates = None
    if gyro is not None:
        rates = Signal(gyro.t_s, zero_phase(gyro, RATE_CUTOFF_HZ), gyro.settled_hz)
    if doubts and measured and rates is not None and attitude is not None:
        notes += [*_attitude_doubt(attitude, rates), *clock_doubt(attitude, rates)]
    return MeasuredMotion(position, velocity, attitude, rates, measured, tuple(notes))


def zero_phase(signal: AnySignal, cutoff_hz: float) -> Array:
    """Values low-passed forward and backward (Butterworth, second order each way).

    A cutoff above 0.4 of the sample rate leaves the values unchanged.
    """
    values, rate = signal.values, signal.rate_hz
    if not _is_filtered(len(values), rate, cutoff_hz):
        return values
    found = np.empty_like(values)
    for k, column in enumerate(values.T):  # one by one to save memory
        found[:, k] = _filtered(column, rate, cutoff_hz)
    return found


def filtered_at(signal: AnySignal, cutoff_hz: float, t_s: Array) -> Array:
    """Low-passed values, interpolated at times, shape (len(t_s), k)."""
    t_known_s, values, rate = signal.t_s, signal.values, signal.rate_hz
    if not _is_filtered(len(values), rate, cutoff_hz):
        return _interpolated(t_s, t_known_s, values, rate)
    each = (
        _interpolated(t_s, t_known_s, _filtered(column, rate, cutoff_hz)[:, None], rate)
        for column in values.T
    )
    return np.hstack([*each])


def _is_filtered(samples: int, rate_hz: float, cutoff_hz: float) -> bool:
    return samples >= 16 and cutoff_hz <= 0.4 * rate_hz


def _filtered(column: Array, rate_hz: float, cutoff_hz: float) -> Array:
    """Butterworth, forward and backward, of a column, shape (n,)."""
    b, a, settled = _butterworth(cutoff_hz / (rate_hz / 2))
    # as scipy's filtfilt, which computes the state of a settled filter at each call
    start, end = (2 * column[k] - column[rows] for k, rows in ((0, _BEFORE), (-1, _AFTER)))
    passed = np.concatenate([start, column, end])
    for _ in range(2):
        passed = scipy.signal.lfilter(b, a, passed, zi=settled * passed[0])[0][::-1]
    return np.asarray(passed[_EDGE:-_EDGE], dtype=np.float64)


@lru_cache(256)
def _butterworth(share: float) -> tuple[Array, Array, Array]:
    """Second-order filter at a share of half the rate: coefficients, and steady state for an input
    of one."""
    b, a = scipy.signal.butter(2, share)
    return b, a, scipy.signal.lfilter_zi(b, a)


def differentiate(signal: AnySignal) -> Array:
    """Central differences at the signal's own times, shape as the values."""
    return np.asarray(np.gradient(signal.values, signal.t_s, axis=0), dtype=np.float64)


def _signal(flight: AnyFlight, columns: Sequence[str]) -> AnySignal | None:
    return signal_of(flight, columns) if flight.has(*columns) else None


def _unit(q: Array) -> Array:
    """Quaternions of unit norm."""
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))


def _continuous(attitude: AnySignal) -> AnySignal:
    """Unit quaternions with continuous signs."""
    if isinstance(attitude, Signal):
        q = _unit(attitude.values)
        return replace(attitude, values=q * _signs(q)[:, None])
    flight = attitude.flight
    signs = np.ones(len(flight.time_s), dtype=np.int8)
    before = np.zeros((0, 4))
    for first in range(0, len(signs), ROWS):
        last = min(first + ROWS, len(signs)) - 1
        span_s = float(flight.time_s[first]), float(flight.time_s[last])
        t_s, values, low = flight.around(attitude.columns, *span_s)
        inside = (t_s >= span_s[0]) & (t_s <= span_s[1])
        q = np.vstack([before, _unit(values[inside])])
        if len(q):
            new_signs = _signs(q)
            signs[flight.rows_of(t_s[inside], low)] = new_signs[len(before) :]
            before = q[-1:] * new_signs[-1]
    return replace(attitude, signs=signs)


def _signs(q: Array) -> NDArray[np.int8]:
    """Signs that make neighbouring quaternions continuous, the first unchanged, shape (n,)."""
    flips = np.sign(np.sum(q[1:] * q[:-1], axis=1))
    flips[flips == 0] = 1.0
    return np.concatenate([[1.0], np.cumprod(flips)]).astype(np.int8)


def _derivative(signal: AnySignal) -> Signal:
    smooth = scipy.signal.savgol_filter(signal.values, 9, 2, axis=0)
    t_s = signal.t_s
    return Signal(t_s, differentiate(Signal(t_s, smooth)), signal.settled_hz)


def rates_of(attitude: AnySignal) -> Signal:
    """Body rates between neighbouring attitudes, rad/s, at the midpoints in time."""
    t_s, q = attitude.t_s, attitude.values
    rates = np.empty((len(q) - 1, 3))
    for first in range(0, len(rates), ROWS):
        rows = slice(first, min(first + ROWS, len(rates)))
        after = slice(rows.start + 1, rows.stop + 1)
        rates[rows] = rotation_vector(q[after], q[rows]) / (t_s[after] - t_s[rows])[:, None]
    return Signal((t_s[1:] + t_s[:-1]) / 2, rates, attitude.settled_hz)


def agreement(attitude: AnySignal, rates: AnySignal, later_s: float = 0.0) -> float | None:
    """Correlation of body rates from the attitude with the gyroscope, -1 to 1.

    Both pass a low-pass at `AGREEMENT_HZ`; a conjugated quaternion, one in the order x, y, z, w or
    one of other axes gives a small correlation.

    Args:
        attitude: Quaternions with continuous signs.
        rates: Body rates, rad/s.
        later_s: Lag of the attitude behind the gyroscope.

    Returns:
        None with too little data, or hardly any rotation.
    """
    if len(attitude.t_s) < 40 or attitude.rate_hz < 5 * AGREEMENT_HZ:
        return None
    sums = np.zeros(4)  # of a * b, a * a, b * b and number of samples
    for block in blocks_of(attitude, AGREEMENT_BLOCK_S):
        if len(block.t_s) > 1:
            sums += _turned_together(block, rates, later_s)
    both, first, second, n = sums
    if n == 0 or np.sqrt(second / n) < 0.05:
        return None
    return float(both / np.sqrt(first * second + 1e-30))


def _turned_together(attitude: Signal, rates: AnySignal, later_s: float) -> Array:
    """Sums of products of the low-passed rates by attitude and by gyroscope, and their number."""
    turning = rates_of(attitude)
    slow = zero_phase(turning, AGREEMENT_HZ)
    start_s, end_s = float(turning.t_s[0]) - later_s - 1.0, float(turning.t_s[-1]) - later_s + 1.0
    nearby = rates.between(start_s, end_s)
    if not len(nearby.t_s):
        return np.zeros(4)
    gyro = Signal(nearby.t_s, zero_phase(nearby, AGREEMENT_HZ)).at(turning.t_s - later_s)
    known = np.all(np.isfinite(gyro) & np.isfinite(slow), axis=1)
    a, b = slow[known], gyro[known]
    return np.array([np.sum(a * b), np.sum(a * a), np.sum(b * b), b.size])


def _attitude_doubt(attitude: AnySignal, rates: AnySignal) -> list[str]:
    """Warning where attitude and gyroscope disagree."""
    same = agreement(attitude, rates)
    if same is None or same > 0.5:
        return []
    return [
        f"attitude and gyroscope do not turn together (correlation {same:.2f}): check that q "
        f"is [w, x, y, z], body to NED, and that both use forward-right-down axes"
    ]


def clock_doubt(attitude: AnySignal, rates: AnySignal) -> list[str]:
    """Warning where the age of the attitude relative to the gyroscope changes during the flight."""
    ages_s = attitude_ages(attitude, rates)
    if len(ages_s) < FEWEST_WINDOWS:
        return []
    low, high = np.percentile(ages_s, [10, 90])
    if high - low < WANDER_S:
        return []
    return [
        f"the clocks of attitude and gyroscope drift: the age of the attitude is {1e3 * low:+.0f} "
        f"to {1e3 * high:+.0f} ms in {len(ages_s)} windows of {CLOCK_WINDOW_S:.0f} s; a single age "
        f"is its mean at best. Stamp both by one clock."
    ]


def attitude_ages(attitude: AnySignal, rates: AnySignal) -> Array:
    """Age of an attitude relative to a gyroscope, s, in each window with enough rotation.

    The lag of their largest correlation; shape (n,), empty for an attitude of too low a rate.

    Args:
        attitude: Quaternions with continuous signs.
        rates: Body rates, rad/s.
    """
    if attitude.rate_hz < 4 * CLOCK_BAND_HZ[1]:
        return np.zeros(0)
    found = []
    for block in blocks_of(attitude, AGREEMENT_BLOCK_S):
        if len(block.t_s) > 1:
            found += _ages_in(rates_of(block), rates)
    return np.array(found)


def _ages_in(turning: Signal, rates: AnySignal) -> list[float]:
    """Ages in one block."""
    grid = np.arange(turning.t_s[0], turning.t_s[-1], CLOCK_STEP_S)
    a, b = (_clock_band(Signal(grid, s.at(grid))) for s in (turning, rates))
    most, window = round(OLDEST_S / CLOCK_STEP_S), round(CLOCK_WINDOW_S / CLOCK_STEP_S)
    lags, found = np.arange(-most, most + 1), []
    for first in range(most, len(grid) - window - most, window):
        x, near = a[first : first + window], b[first - most : first + window + most]
        same = np.array([_alike(x, near[most - k : most - k + window]) for k in lags])
        k = int(np.argmax(same)) if np.all(np.isfinite(same)) else 0
        if same[k] > CLEAR and 0 < k < len(lags) - 1:
            found.append(float(lags[k]) * CLOCK_STEP_S)
    return found


def _clock_band(signal: Signal) -> Array:
    low, high = (zero_phase(signal, hz) for hz in CLOCK_BAND_HZ)
    return high - low


def _alike(a: Array, b: Array) -> float:
    """Correlation of two signals without means, all columns together."""
    return float(np.sum(a * b) / np.sqrt(np.sum(a * a) * np.sum(b * b) + 1e-30))


SAME_S = 1e-9
"""Difference below which times of a grid and of a log are equal."""


def smooth_at(signal: AnySignal, t_s: Array, derivative: int = 0) -> Array:
    """A signal or its derivative in time by cubic splines, NaN outside and in gaps.

    Linear interpolation between samples h apart, and differences over h, would be averages over
    time, with mean variances of h^2/6 and h^2/12. Of two samples that all but coincide the first
    counts: through both, their noise would be a slope that swings far beyond them.

    Args:
        signal: Signal of any rate.
        t_s: Times, s, shape (n,).
        derivative: Order of the derivative.

    Returns:
        Values, shape (n, k).
    """
    there = signal.between(float(np.min(t_s)) - LONGEST_GAP_S, float(np.max(t_s)) + LONGEST_GAP_S)
    own = np.append(True, np.diff(there.t_s) * signal.rate_hz > _COINCIDENT)
    if np.count_nonzero(own) < 4:
        return np.full((len(t_s), signal.values.shape[1]), np.nan)
    spline = scipy.interpolate.CubicSpline(there.t_s[own], there.values[own], bc_type="natural")
    found = spline(t_s, derivative)
    found[~np.isfinite(signal.at(t_s))] = np.nan
    return np.asarray(found)


def resample_like(values: Array, t_s: Array, signal: AnySignal, derivative: int = 0) -> Array:
    """`smooth_at` of a continuous signal that is sampled at the times of another signal.

    It applies the sampling of one of two compared signals to the other one, which matters near half
    the sample rate.

    Args:
        values: Derivative of the continuous signal, shape (n, k).
        t_s: Times of these values, s, shape (n,).
        signal: Signal whose times are used.
        derivative: Order of the derivative.

    Returns:
        Values, shape (n, k), NaN where either is unknown.
    """
    known = np.all(np.isfinite(values), axis=1)
    if np.count_nonzero(known) < 4:
        return np.full_like(values, np.nan)
    whole = scipy.interpolate.CubicSpline(t_s[known], values[known])
    if derivative:
        whole = whole.antiderivative(derivative)
    there = signal.between(float(t_s[known][0]) - SAME_S, float(t_s[known][-1]) + SAME_S)
    found = smooth_at(Signal(there.t_s, whole(there.t_s)), t_s, derivative)
    found[~known] = np.nan
    return found


def turning_at(attitude: AnySignal, t_s: Array) -> Array:
    """Body rates of an attitude, rad/s, by cubic splines, NaN outside and in gaps, shape (n, 3)."""
    q, rate = (list(smooth_at(attitude, t_s, k).T) for k in (0, 1))
    back = [q[0], -q[1], -q[2], -q[3]]
    half = np.stack(multiply(back, rate)[1:], axis=-1)
    return np.asarray(2.0 * half / sum(x * x for x in q)[:, None])
