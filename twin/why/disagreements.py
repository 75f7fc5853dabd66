"""Disagreement of two instruments, or of one with its own past: residuals over a part in the air.

Attitude rotates with the gyroscope, velocity changes with the accelerometer, the field of the
compass has constant strength and heading, the barometer follows the height. Steps that the
estimator reports itself are removed. Also: the text on each cause.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from ..frames import rotation_vector
from ..logs.autopilot import Reset, ResetOf
from ..logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL
from ..logs.flight import Flight
from ..logs.samples import interpolated, stretches_where
from ..residuals.measured import Signal
from ..vehicle import GRAVITY_M_S2
from .consistency import Residual, running_median, trailing_median
from .flight import rotations

Array = NDArray[np.float64]
Signals = Mapping[str, Signal]

BIN_S = 0.1
"""Shortest bin of a residual."""
SLOWEST_HZ = 4.0
"""Lowest rate of attitude, velocity and position that are compared with a change."""
FAST_HZ = 15.0
"""Lowest rate of gyroscope and accelerometer for integration and noise."""
SCALE_ERROR = 0.01
"""Relative error of the body rate by intact gyroscopes and late stamps of the attitude."""
CLOCK_S = 0.01
"""Difference of the stamps of attitude and accelerometer; more where attitude is logged slowly."""
FEWEST = 20
"""Fewest samples of a signal in use."""
PRESSURE_SCALE_M = 8434.0
"""Scale height of the atmosphere at 288 K, ISO 2533."""
JOLT_S = 1.5
"""Window for noise: a touch of the ground or of a branch takes less than half of it, a lasting
increase more."""
NOISE = "sensor_noise_level"
"""The cause whose size is a ratio of levels."""
HEIGHT_S = 20.0
"""Window for height by barometer less that of the estimate, whose median is the reference."""
STEPPED_BY: Mapping[str, tuple[ResetOf, ...]] = {
    "attitude_estimate": ("attitude", "yaw"),
    "velocity_estimate": ("velocity", "position", "height"),
    "position_estimate": ("position", "height"),
    "baro_disturbance": ("height",),
}
"""Resets that step a residual, by its passing cause: with a position that jumps, EKF2 and EKF3
reset the velocity."""
STEP_LASTS_S: Mapping[str, float] = {"heading": np.inf, "height": HEIGHT_S / 2.0}
"""Duration of a step in a residual of levels, by quantity: permanent, or until it is the median.
Other residuals compare changes, and deviate in its bin only."""
NEARBY_S, NEAR_BINS = 1.0, 3
"""Times before and after a reset whose medians give the step of a level; largest number of bins in
a step: its own and one on either side, since clocks of messages and samples differ."""


def _binned(t: Array, values: Array, step_s: float = BIN_S) -> tuple[Array, Array]:
    """Midpoints of the bins, and mean of the values in each, NaN where there is none."""
    place = ((t - t[0]) / step_s).astype(np.intp)
    n = np.bincount(place)
    total = np.bincount(place, weights=values)
    mean = np.where(n > 0, total / np.maximum(n, 1), np.nan)
    return t[0] + step_s * (0.5 + np.arange(len(n))), mean


def _integral_at(signal: Signal, t: Array) -> Array:
    """Integral of a signal from its first sample, at other times, shape (len(t), k)."""
    total = cumulative_trapezoid(signal.values, signal.t_s, axis=0, initial=0)
    return interpolated(t, signal.t_s, total)


def _attitude_at(q: Signal, t: Array) -> Array:
    """Matrices body to NED, linear between samples of the quaternion, shape (len(t), 3, 3)."""
    turned = (q.values[1:] * q.values[:-1]).sum(axis=1) < 0
    sign = np.cumprod(np.append(1.0, np.where(turned, -1.0, 1.0)))
    near = interpolated(t, q.t_s, q.values * sign[:, None])
    return rotations(near / np.linalg.norm(near, axis=1, keepdims=True))


def _fast(signals: Signals, *names: str) -> bool:
    """Whether signals are available and fast enough to be compared with a change."""
    return all(n in signals and signals[n].rate_hz >= SLOWEST_HZ for n in names)


def _turn(signals: Signals) -> Iterator[Residual]:
    """Rate of the gyroscope less that of the attitude, per body axis.

    Both are means between two samples of the attitude: the errors of the attitude cancel in sums.
    """
    if not _fast(signals, "q", "gyro") or signals["gyro"].rate_hz < FAST_HZ:
        return
    q = signals["q"]
    angle = np.diff(_integral_at(signals["gyro"], q.t_s), axis=0)
    between = np.diff(q.t_s)[:, None]
    apart = (angle - rotation_vector(q.values[1:], q.values[:-1])) / between
    apart = apart[slow := np.linalg.norm(angle, axis=1) < 1.0]  # beyond, angles do not add up
    if len(apart) <= FEWEST:
        return
    middle = (q.t_s[1:] + q.t_s[:-1])[slow] / 2
    _, turning = _binned(middle, (np.linalg.norm(angle, axis=1) / between[:, 0])[slow])
    for k, column in enumerate(GYRO):
        t, r = _binned(middle, apart[:, k])
        _, reading = _binned(middle, (angle / between)[slow, k])
        error = SCALE_ERROR * turning
        causes, named = ("gyro_bias", "attitude_estimate", "gyro_scale"), (column, "rate", "rad/s")
        bins, windows = (t, r, np.nan_to_num(error)), ((1.0, 0.04), (5.0, 0.015))
        yield from _of_windows(causes, named, bins, reading, windows, (0.1, 1.0))


def _force(signals: Signals) -> Iterator[Residual]:
    """Specific force less that of attitude and change of velocity, per body axis."""
    if not _fast(signals, "q", "vel", "acc") or signals["acc"].rate_hz < FAST_HZ:
        return
    acc, vel = signals["acc"], signals["vel"]
    ned = np.einsum("nij,nj->ni", _attitude_at(signals["q"], acc.t_s), acc.values)
    ned[:, 2] += GRAVITY_M_S2
    gained = np.diff(_integral_at(Signal(acc.t_s, ned), vel.t_s), axis=0)
    apart = (gained - np.diff(vel.values, axis=0)) / np.diff(vel.t_s)[:, None]
    middle, step = (vel.t_s[1:] + vel.t_s[:-1]) / 2, max(BIN_S, 1.0 / vel.rate_hz)
    body = np.einsum("nji,nj->ni", _attitude_at(signals["q"], middle), apart)
    _, size = _binned(middle, _turned(signals["q"], middle) * np.linalg.norm(gained, axis=1), step)
    late = CLOCK_S + 0.1 / signals["q"].rate_hz
    for k, column in enumerate(ACC):
        t, r = _binned(middle, body[:, k], step)
        _, reading = _binned(middle, np.interp(middle, acc.t_s, acc.values[:, k]), step)
        error = late * size
        causes = "accel_bias", "velocity_estimate", "accel_scale"
        named, windows = (column, "acceleration", "m/s^2"), ((2.0, 0.5), (8.0, 0.2))
        bins, sizes = (t, r, np.nan_to_num(error)), (1.0, GRAVITY_M_S2)
        yield from _of_windows(causes, named, bins, reading, windows, sizes)


def _of_windows(
    causes: tuple[str, str, str],
    named: tuple[str, str, str],
    bins: tuple[Array, Array, Array],
    reading: Array,
    windows: Sequence[tuple[float, float]],
    sizes: tuple[float, float],
) -> list[Residual]:
    """Residuals of one axis, for each window and least change: permanent, passing and scaling
    cause; sensor, quantity and unit; times, differences and their errors; usual and largest
    size."""
    (lasting, passing, scaled), (sensor, quantity, unit), (t, r, error) = causes, named, bins
    usual, largest = sizes
    return [
        Residual(
            lasting=lasting,
            passing=passing,
            scaled=scaled,
            sensor=sensor,
            quantity=quantity,
            unit=unit,
            t_s=t,
            reading=reading,
            difference=r,
            error=error,
            window_s=window_s,
            least=least,
            usual=usual,
            largest=largest,
        )
        for window_s, least in windows
    ]


def _turned(q: Signal, t: Array) -> Array:
    """Rotation rate of the attitude, rad/s, shape (len(t),)."""
    rate = np.linalg.norm(rotation_vector(q.values[1:], q.values[:-1]), axis=1) / np.diff(q.t_s)
    return np.asarray(np.interp(t, (q.t_s[1:] + q.t_s[:-1]) / 2, rate))


def _single(
    causes: tuple[str, str],
    named: tuple[str, str, str],
    bins: tuple[Array, Array],
    reading: Array,
    window_s: float,
    sizes: tuple[float, float, float],
) -> Residual:
    """A residual without axes: permanent and passing cause; sensor, quantity and unit; least, usual
    and largest size."""
    given = (*bins, np.zeros(len(bins[0])))
    windows = ((window_s, sizes[0]),)
    return _of_windows((*causes, ""), named, given, reading, windows, sizes[1:])[0]


def _field(signals: Signals) -> Iterator[Residual]:
    """Strength of the field, and its heading by the attitude."""
    if "mag" not in signals:
        return
    mag = signals["mag"]
    strength = np.linalg.norm(mag.values, axis=1)
    usual = float(np.median(strength))
    if usual < 1e-6:
        return
    step = max(BIN_S, 1.0 / mag.rate_hz)
    bins = _binned(mag.t_s, strength / usual - 1.0, step)
    causes = "mag_hard_iron", "mag_disturbance"
    named, sizes = ("compass", "field_strength", "1"), (0.25, 0.25, 2.0)
    yield _single(causes, named, bins, bins[1] + 1.0, 2.0, sizes)
    if "q" in signals:
        ned = np.einsum("nij,nj->ni", _attitude_at(signals["q"], mag.t_s), mag.values)
        bins = _binned(mag.t_s, np.unwrap(np.arctan2(ned[:, 1], ned[:, 0])), step)
        causes = "mag_hard_iron", "attitude_estimate"
        named, sizes = ("compass", "heading", "rad"), (0.35, 0.35, np.pi)
        yield _single(causes, named, bins, bins[1], 3.0, sizes)


def _height(signals: Signals) -> Iterator[Residual]:
    """Height by the barometer less that of the estimate, on a time scale shorter than their drift;
    none where it reads no pressure."""
    if not {"baro", "pos"} <= signals.keys():
        return
    baro, pos = signals["baro"], signals["pos"]
    if baro.values.min() <= 0.0:
        return
    height = -PRESSURE_SCALE_M * np.log(baro.values[:, 0] / np.median(baro.values))
    step = max(BIN_S, 1.0 / baro.rate_hz)
    t, apart = _binned(baro.t_s, height + np.interp(baro.t_s, pos.t_s, pos.values[:, 2]), step)
    _, reading = _binned(baro.t_s, height, step)
    bins = t, apart - trailing_median(apart, HEIGHT_S / step)
    causes = "baro_bias", "baro_disturbance"
    named = "barometer", "height", "m"
    yield _single(causes, named, bins, reading, 1.0, (4.0, 10.0, 100.0))


def _place(signals: Signals) -> Iterator[Residual]:
    """Rate of change of the position less the velocity, per axis: shows a jump of either."""
    if not _fast(signals, "pos", "vel"):
        return
    pos = signals["pos"]
    between = np.diff(pos.t_s)[:, None]
    moved = np.diff(pos.values, axis=0) / between
    apart = moved - np.diff(_integral_at(signals["vel"], pos.t_s), axis=0) / between
    middle, step = (pos.t_s[1:] + pos.t_s[:-1]) / 2, max(BIN_S, 1.0 / pos.rate_hz)
    for k, column in enumerate(POS):
        _, reading = _binned(middle, moved[:, k], step)
        bins = _binned(middle, apart[:, k], step)
        causes = "position_estimate", "position_estimate"
        yield _single(causes, (column, "speed", "m/s"), bins, reading, 1.0, (1.5, 1.5, 100.0))


def _noise(signals: Signals) -> Iterator[Residual]:
    """Logarithm of the noise of gyroscope and accelerometer: of second differences, by fifths of a
    second, and the median of a second of these, since a touch of the ground is short."""
    for name, sensor, floor in (("gyro", "gyroscope", 1e-4), ("acc", "accelerometer", 0.01)):
        if name not in signals or signals[name].rate_hz < FAST_HZ:
            continue
        signal = signals[name]
        quick = np.linalg.norm(np.diff(signal.values, 2, axis=0), axis=1)
        step = max(0.2, 8.0 / signal.rate_hz)
        t, power = _binned(signal.t_s[2:], quick**2, step)
        level = running_median(0.5 * np.log(power + floor**2), JOLT_S / step)
        causes = NOISE, NOISE
        named = sensor, "noise_ratio", "1"
        least, largest = float(np.log(4.0)), float(np.log(100.0))
        yield _single(causes, named, (t, level), level, 1.0, (least, least, largest))


def _voltage(signals: Signals) -> Iterator[Residual]:
    """Voltage over that of the half minute before, less one."""
    if "vbat" not in signals or np.median(signals["vbat"].values) < 2.0:
        return
    vbat = signals["vbat"]
    step = max(0.2, 1.0 / vbat.rate_hz)
    t, level = _binned(vbat.t_s, vbat.values[:, 0], step)
    bins = t, level / trailing_median(level, 30.0 / step) - 1.0
    causes = "battery_sag", "battery_sag"
    yield _single(causes, ("battery", "voltage", "1"), bins, level, 1.0, (0.12, 0.12, 1.0))


def within(flight: Flight, start_s: float, end_s: float) -> dict[str, Signal]:
    """Signals as logged within a span; derived ones would agree with their sources."""
    found: dict[str, Signal] = {}
    named: dict[str, tuple[str, ...]] = {"acc": ACC, "gyro": GYRO, "mag": MAG, "q": QUAT}
    named |= {"pos": POS, "vel": VEL}
    named |= {"baro": ("baro_pa",), "vbat": ("vbat_v",)}
    for name, columns in named.items():
        if flight.has(*columns):
            t, values = flight.signal(columns)
            inside = (t >= start_s) & (t <= end_s)
            if inside.sum() > FEWEST:
                found[name] = Signal(t[inside], values[inside])
    return found


Maker = Callable[[Signals], Iterator[Residual]]
RESIDUALS: tuple[Maker, ...] = (_turn, _force, _field, _height, _place, _noise, _voltage)
"""Every comparison of two instruments, or of one with its own past."""


def without_resets(r: Residual, resets: Sequence[Reset]) -> Residual:
    """A residual without the steps that the estimator reports itself.

    Within one bin of a reset it is replaced by the values on both sides, and a level is continued:
    deviations that begin before, or continue after, remain. Resets without a pause of a bin, for
    longer than the running mean, are no steps, and remain.
    """
    of = STEPPED_BY.get(r.passing, ())
    at = np.array([x.t_s for x in resets if x.of in of])
    begin, end = (np.searchsorted(r.t_s, at + k * r.step_s) for k in (-1.5, 1.5))
    rest, near = r.difference.copy(), np.zeros(len(r.t_s), dtype=np.bool_)
    for a, b in zip(begin.tolist(), end.tolist(), strict=True):
        near[a:b] = True
    for a, b in stretches_where(near):
        if b - a <= max(r.width, NEAR_BINS):
            _take_out(r.t_s, rest, (a, b), STEP_LASTS_S.get(r.quantity, 0.0))
    return replace(r, difference=rest)


def _take_out(t_s: Array, rest: Array, step: tuple[int, int], lasts_s: float) -> None:
    """Remove the step within some bins from a residual, in place; for a level as long as it
    lasts."""
    a, b = step
    before = rest[:a][(t_s[:a] >= t_s[a] - NEARBY_S) & np.isfinite(rest[:a])]
    after = rest[b:][(t_s[b:] <= t_s[b - 1] + NEARBY_S) & np.isfinite(rest[b:])]
    if not (len(before) and len(after)):
        rest[a:b] = np.nan
    elif lasts_s > 0.0:
        moved = (t_s >= t_s[b]) & (t_s <= t_s[a] + lasts_s)
        rest[moved] -= np.median(after) - np.median(before)
        rest[a:b] = np.median(before)
    else:
        rest[a:b] = min(before[-1], after[0], key=abs)


@dataclass(frozen=True, slots=True)
class SensorCause:
    """Text on a cause.

    Attributes:
        text: Sentence; {sensor}, {size} and {t} are filled in.
        bench_check: Check on the bench.
    """

    text: str
    bench_check: str


SENSOR_CAUSES: Mapping[str, SensorCause] = {
    "gyro_bias": SensorCause(
        "From {t} s on {sensor} is off by {size} against the attitude",
        "Leave the aircraft at rest for a minute, warm and cold: the gyroscope should read less "
        "than 0.01 rad/s.",
    ),
    "gyro_scale": SensorCause(
        "From {t} s on {sensor} reads {size} too much in proportion",
        "Turn the aircraft by a full turn about that axis: the integral should be 360 degrees.",
    ),
    "attitude_estimate": SensorCause(
        "At {t} s the attitude estimate turns {size} unlike {sensor}",
        "Read the estimator's messages about that time: a reset of yaw, a change of compass or of "
        "the estimator in use.",
    ),
    "accel_bias": SensorCause(
        "From {t} s on {sensor} is off by {size} against the change of velocity",
        "Lay the aircraft on each of its sides: the accelerometer should read 9.81 m/s2.",
    ),
    "accel_scale": SensorCause(
        "From {t} s on {sensor} reads {size} too much in proportion",
        "Lay the aircraft on each of its sides: the accelerometer should read 9.81 m/s2.",
    ),
    "velocity_estimate": SensorCause(
        "At {t} s the velocity estimate changes by {size} unlike {sensor}",
        "Look for a jump of the satellite position, or for another source of velocity.",
    ),
    "position_estimate": SensorCause(
        "At {t} s {sensor} moves {size} unlike the velocity",
        "Look for a jump of the satellite position: few satellites, or a reset of the estimator.",
    ),
    "mag_hard_iron": SensorCause(
        "From {t} s on the {sensor} is off by {size}",
        "Look for something magnetic that was carried or moved, and calibrate the compass.",
    ),
    "mag_disturbance": SensorCause(
        "At {t} s the {sensor} is disturbed by {size}",
        "Look for steel or a current near the place, and for power cables near the compass.",
    ),
    "baro_bias": SensorCause(
        "From {t} s on the {sensor} is off by {size} against the height",
        "Look at the foam over the barometer: light or a stream of air moves its reading.",
    ),
    "baro_disturbance": SensorCause(
        "At {t} s the {sensor} is off by {size} against the height",
        "Look at the foam over the barometer: light or a stream of air moves its reading.",
    ),
    NOISE: SensorCause(
        "From {t} s on the {sensor} shakes more, {size}",
        "Look for something loose at the board, then at propellers, bells and screws.",
    ),
    "battery_sag": SensorCause(
        "At {t} s the voltage leaves that of the half minute before by {size}",
        "Measure the resistance of the cells, look at the plug and its solder.",
    ),
    "stuck_sensor": SensorCause(
        "From {t} s on {sensor} stays exactly the same for {size}",
        "Look at plug and bus of the sensor: a driver that repeats its last reading hides a fault.",
    ),
    "sensor_dropout": SensorCause(
        "From {t} s on no sample of the {sensor} comes for {size}",
        "Look at plug, bus and supply of the sensor.",
    ),
}
"""Texts by cause: effects of the library where there is one, and events of the state estimate."""
