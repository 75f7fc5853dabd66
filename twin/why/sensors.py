"""Sensors and state estimate: which of them began to disagree with the others, and when.

Attitude turns as the gyroscope says, velocity changes as the accelerometer says, the field that the
compass measures keeps its strength and heading, the barometer follows the height. Readings that
stand still, or are missing, are seen in themselves. No motor command is needed.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from ..formatting import number
from ..frames import rotation_vector
from ..logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL
from ..logs.flight import Flight
from ..logs.stretches import stretches_where
from ..residuals.measured import Signal
from ..vehicle import GRAVITY_M_S2
from .consistency import (
    FALSE_IN_10_H,
    Budget,
    Change,
    Residual,
    changed_at,
    running_median,
    smallest_detectable,
    trailing_median,
)
from .findings import Findings
from .flight import Airborne, FlightFrame, rotations
from .records import Amount, Candidate, Event, EvidenceSeries, NotVisible, Severity

Array = NDArray[np.float64]
Signals = Mapping[str, Signal]

BIN_S = 0.1
"""Least length of a bin of a residual."""
SLOWEST_HZ = 4.0
"""Of attitude, velocity and position that are compared with a change."""
FAST_HZ = 15.0
"""Least rate of gyroscope and accelerometer that are integrated, or whose noise is looked at."""
SCALE_ERROR = 0.01
"""Share of the body rate by which sound gyroscopes and late stamps of the attitude err."""
CLOCK_S = 0.01
"""By which stamps of attitude and accelerometer differ; more where attitude is logged slowly."""
FEWEST = 20
"""Samples of a signal that is used."""
CLEAR_S, LANDING_S = 1.0, 3.0
"""After the aircraft is clear of the ground, and before it comes near it again."""
TOGETHER_S = 1.0
"""Changes that begin so close to each other are of one cause: the windows of residuals differ."""
FOLLOWS_S = 10.0
"""An estimator takes so long to settle after a jump or a wrong reading: EKF2 and EKF3 reset after 5
to 10 s of rejected measurements."""
PRESSURE_SCALE_M = 8434.0
"""Scale height of the atmosphere at 288 K, ISO 2533."""
JOLT_S = 1.5
"""Of which a touch of the ground or of a branch takes less than half, noise that sets in more."""
AROUND_S = 8.0
"""Drawn before and after an onset."""
MOST_POINTS = 240
"""Of a signal that is drawn."""
NOISE = "sensor_noise_level"
"""The cause whose size is a ratio of levels."""


@dataclass(frozen=True, slots=True)
class SensorCause:
    """What is said of a cause.

    Attributes:
        text: A sentence; {sensor}, {size} and {t} are filled in.
        bench_check: What to check on the bench.
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
"""By cause: effects of the library where it is one, and events of the state estimate."""
SELF_EVIDENT = ("stuck_sensor", "sensor_dropout")
"""Causes that are seen in the reading itself, without another instrument."""
OF_ESTIMATE = ("attitude_estimate", "velocity_estimate", "position_estimate")
"""Causes that are of no instrument."""


def sensors(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Events of sensors and state estimate in the air, each against the flight's own past."""
    events: list[Event] = []
    hidden: dict[str, NotVisible] = {}
    for part in flight.airborne:
        residuals, found = part_events(flight, part)
        events += found
        hidden |= _hidden(residuals, _budget(residuals))
    sound = np.prod([1.0 - e.probability for e in events if not e.consequence])
    return Findings(events=events, not_visible=tuple(hidden.values()), nothing=float(sound))


def part_events(flight: FlightFrame, part: Airborne) -> tuple[list[Residual], list[Event]]:
    """Residuals of a part in the air, and its events."""
    start = float(flight.t_s[part.start]) + CLEAR_S
    end = float(flight.t_s[part.flown - 1]) - (LANDING_S if part.lost is None else 0.0)
    signals = within(flight.flight, start, end)
    residuals = [r for make in RESIDUALS for r in make(signals)]
    budget = _budget(residuals)
    found = [c for r in residuals if (c := changed_at(r, budget)) is not None]
    standing = [*frozen(signals, budget), *missing(signals, end)]
    return residuals, grouped([*map(_of_change, found), *standing])


def _budget(residuals: Sequence[Residual]) -> Budget:
    return Budget(FALSE_IN_10_H, max(len(residuals), 1))


def grouped(events: Sequence[Event]) -> list[Event]:
    """Each cause of a sensor once; what follows from another event marked as its consequence.

    What begins within `TOGETHER_S` of the first is of one cause: a reading that stands still, or is
    missing, is evidence of itself and comes first, then the most probable one. What begins within
    `FOLLOWS_S` after that, or after what follows from it, is a consequence.
    """
    left = sorted(events, key=_onset)
    found: list[Event] = []
    while left:
        together = [e for e in left if _onset(e) - _onset(left[0]) <= TOGETHER_S]
        first = max(together, key=lambda e: (e.cause in SELF_EVIDENT, e.probability))
        follow = _chain(left, first)
        left = [e for e in left if e is not first and e not in follow]
        own = {(first.cause, first.sensor)}
        found.append(first)
        for e in follow:
            if (e.cause, e.sensor) not in own:
                own.add((e.cause, e.sensor))
                found.append(replace(e, consequence=True))
    return found


def _onset(event: Event) -> float:
    return -np.inf if event.onset_s is None else event.onset_s


def _chain(events: Sequence[Event], first: Event) -> list[Event]:
    """Events that begin not much later than the first, or than one of the chain."""
    until, chain = max(_onset(events[0]), _onset(first)), []
    for e in events:
        if e is not first and _onset(e) - until <= FOLLOWS_S:
            until = max(until, _onset(e))
            chain.append(e)
    return chain


def _hidden(residuals: Sequence[Residual], budget: Budget) -> dict[str, NotVisible]:
    """Of each lasting cause, the smallest change that the worst axis would have shown."""
    least: dict[tuple[str, str], tuple[float, Residual]] = {}
    for r in residuals:
        key, size = (r.lasting, r.sensor), smallest_detectable(r, budget)
        if key not in least or size < least[key][0]:
            least[key] = size, r
    found: dict[str, NotVisible] = {}
    for (cause, _), (size, r) in sorted(least.items(), key=lambda x: x[1][0]):
        if cause not in OF_ESTIMATE:
            found[cause] = _not_visible(cause, size, r)
    return found


def _not_visible(cause: str, size: float, r: Residual) -> NotVisible:
    """A change that would not have shown; of any size where none is possible that would."""
    if not size <= r.largest:
        reason = "the instruments differ by more than any such change anyhow"
        if np.isinf(size):
            reason = "the flight is too short to know what is usual"
        amount = Amount(value=None, unit=r.unit)
        return NotVisible(cause=cause, smallest_detectable=amount, reason=reason)
    share = np.expm1(size) if cause == NOISE else size
    reason = "a smaller change is within what the instruments differ by anyhow"
    amount = Amount(value=float(share), unit=r.unit)
    return NotVisible(cause=cause, smallest_detectable=amount, reason=reason)


def within(flight: Flight, start_s: float, end_s: float) -> dict[str, Signal]:
    """Signals as logged within a span; derived ones would agree with what they are derived of."""
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


# -- as events ----------------------------------------------------------------------------------


def _of_change(change: Change) -> Event:
    r = change.residual
    quantity = "scale_change" if change.cause == r.scaled else r.quantity
    value, low, high = (_plain(r, v) for v in (change.size, change.low, change.high))
    return _event(
        change.cause,
        r.sensor,
        change.onset_s,
        Severity(quantity=quantity, value=value, low=low, high=high, unit=change.unit),
        change.probability,
        tuple(Candidate(cause=c, rotor=None, probability=p) for c, p in change.others),
        _drawn(change),
    )


def _plain(r: Residual, size: float) -> float:
    """A size as people read it: noise is a ratio, of which the residual is the logarithm."""
    return float(np.exp(size)) if r.quantity == "noise_ratio" else size


def _event(
    cause: str,
    sensor: str,
    onset_s: float,
    severity: Severity,
    probability: float,
    others: tuple[Candidate, ...] = (),
    evidence: tuple[EvidenceSeries, ...] = (),
) -> Event:
    about, size = SENSOR_CAUSES[cause], _size(severity)
    return Event(
        cause=cause,
        sensor=None if cause in OF_ESTIMATE else sensor,
        onset_s=onset_s,
        severity=severity,
        probability=probability,
        alternatives=others,
        text=about.text.format(sensor=sensor, size=size, t=f"{onset_s:.2f}"),
        bench_check=about.bench_check,
        evidence=evidence,
    )


def _size(severity: Severity) -> str:
    """A size in a sentence."""
    value = severity.value
    if severity.quantity == "noise_ratio":
        return f"{value:.1f} times"
    if severity.unit == "1":
        return f"{100 * value:.0f} %"
    return f"{number(value)} {severity.unit}"


def _drawn(change: Change) -> tuple[EvidenceSeries, ...]:
    """The reading with what the other instrument asks for, and their difference."""
    r = change.residual
    near = np.abs(r.t_s - change.onset_s) <= AROUND_S
    near &= np.isfinite(r.difference) & np.isfinite(r.reading)
    rows = np.flatnonzero(near)[:: max(1, int(near.sum()) // MOST_POINTS)]
    t, apart = r.t_s[rows], r.difference[rows] - change.middle
    series = [(r.sensor, r.reading[rows], r.reading[rows] - apart)]
    series.append(("difference", apart, np.zeros(len(rows))))
    return tuple(
        EvidenceSeries(
            name=what,
            unit=r.unit,
            t_s=tuple(t.tolist()),
            measured=tuple(measured.tolist()),
            expected=tuple(expected.tolist()),
        )
        for what, measured, expected in series
    )


# -- the residuals ------------------------------------------------------------------------------


def _binned(t: Array, values: Array, step_s: float = BIN_S) -> tuple[Array, Array]:
    """Middle of the bins, and mean of the values in each, NaN where there is none."""
    place = ((t - t[0]) / step_s).astype(np.intp)
    n = np.bincount(place)
    total = np.bincount(place, weights=values)
    mean = np.where(n > 0, total / np.maximum(n, 1), np.nan)
    return t[0] + step_s * (0.5 + np.arange(len(n))), mean


def _integral_at(signal: Signal, t: Array) -> Array:
    """Integral of a signal from its first sample on, at other times, shape (len(t), k)."""
    v = signal.values
    area = np.diff(signal.t_s)[:, None] * (v[1:] + v[:-1]) / 2.0
    total = np.vstack([np.zeros(v.shape[1]), np.cumsum(area, axis=0)])
    return np.stack([np.interp(t, signal.t_s, c) for c in total.T], axis=1)


def _attitude_at(q: Signal, t: Array) -> Array:
    """Matrices body to NED, linear between samples of the quaternion, shape (len(t), 3, 3)."""
    turned = (q.values[1:] * q.values[:-1]).sum(axis=1) < 0
    sign = np.cumprod(np.append(1.0, np.where(turned, -1.0, 1.0)))
    near = np.stack([np.interp(t, q.t_s, c) for c in (q.values * sign[:, None]).T], axis=1)
    return rotations(near / np.linalg.norm(near, axis=1, keepdims=True))


def _fast(signals: Signals, *names: str) -> bool:
    """Whether signals are there and come fast enough to be compared with a change."""
    return all(n in signals and signals[n].rate_hz >= SLOWEST_HZ for n in names)


def _turn(signals: Signals) -> Iterator[Residual]:
    """Rate of the gyroscope less that at which the attitude turns, per axis of the body.

    Both are means between two samples of the attitude: the errors of the attitude cancel in sums.
    """
    if not _fast(signals, "q", "gyro") or signals["gyro"].rate_hz < FAST_HZ:
        return
    q = signals["q"]
    angle = np.diff(_integral_at(signals["gyro"], q.t_s), axis=0)
    between = np.diff(q.t_s)[:, None]
    apart = (angle - rotation_vector(q.values[1:], q.values[:-1])) / between
    apart = apart[slow := np.linalg.norm(angle, axis=1) < 1.0]  # farther, angles do not add up
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
    """Specific force less what attitude and change of velocity ask for, per axis of the body."""
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
    """Residuals of one axis, for each window and least change: lasting, passing and scaling cause;
    sensor, quantity and unit; times, differences and their errors; usual and largest size."""
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
    """How fast the attitude turns, rad/s, shape (len(t),)."""
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
    """A residual that has no axes: lasting and passing cause; sensor, quantity and unit; least,
    usual and largest size."""
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
    """Height by the barometer less that of the estimate, quicker than either drifts; none where it
    reads no pressure."""
    if not {"baro", "pos"} <= signals.keys():
        return
    baro, pos = signals["baro"], signals["pos"]
    if baro.values.min() <= 0.0:
        return
    height = -PRESSURE_SCALE_M * np.log(baro.values[:, 0] / np.median(baro.values))
    step = max(BIN_S, 1.0 / baro.rate_hz)
    t, apart = _binned(baro.t_s, height + np.interp(baro.t_s, pos.t_s, pos.values[:, 2]), step)
    _, reading = _binned(baro.t_s, height, step)
    bins = t, apart - trailing_median(apart, 20.0 / step)
    causes = "baro_bias", "baro_disturbance"
    named = "barometer", "height", "m"
    yield _single(causes, named, bins, reading, 1.0, (4.0, 10.0, 100.0))


def _place(signals: Signals) -> Iterator[Residual]:
    """Speed by which the position changes less the velocity, per axis: a jump of either."""
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
    second, and the median of a second of these, since a touch of the ground is a jolt, no noise."""
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


Maker = Callable[[Signals], Iterator[Residual]]
RESIDUALS: tuple[Maker, ...] = (_turn, _force, _field, _height, _place, _noise, _voltage)
"""Every comparison of two instruments, or of one with its own past."""


# -- readings that stand still, or are missing ---------------------------------------------------

_READINGS: Mapping[str, tuple[str, Sequence[str], float]] = {
    "gyro": ("gyroscope", GYRO, 0.3),
    "acc": ("accelerometer", ACC, 0.3),
    "mag": ("compass", MAG, 3.0),
    "baro": ("barometer", ("baro_pa",), 5.0),
}
"""Sensors that may stick: words, columns, and the least time, s, of a frozen reading."""


def frozen(signals: Signals, budget: Budget) -> Iterator[Event]:
    """Readings that stay exactly the same for longer than chance repeats them.

    A reading repeats its predecessor with the frequency that is counted in the flight; a run of
    them is so much the rarer. One that stays at the largest magnitude of the flight is clipped, not
    stuck, and left out, unless it is the only reading of the flight.
    """
    for name, (words, columns, least_s) in _READINGS.items():
        if name in signals:
            asked = np.flatnonzero(~_unknown(signals, name)).tolist()
            each = [(_standing(signals[name], k, least_s, budget), columns[k]) for k in asked]
            hits = [(s, c) for s, c in each if s is not None]
            if hits:
                (begin, long, p), column = min(hits)
                which = words if len(hits) == len(columns) else column
                yield _event("stuck_sensor", which, begin, _duration(long), p)


def _unknown(signals: Signals, name: str) -> NDArray[np.bool_]:
    """Axes, shape (k,), whose only reading proves no fault: a recorder fills with 0 what it does
    not measure, and without noise what does not turn stands still. Gyroscope and accelerometer
    that read 0 on all axes while the body turns are at fault."""
    values = signals[name].values
    still = np.ptp(values, axis=0) == 0.0
    others = [signals[n].values for n in ("q", "gyro", "mag") if n != name and n in signals]
    if not any(np.ptp(v, axis=0).any() for v in others):
        return np.asarray(still)
    empty = still & (values[0] == 0.0)
    return np.asarray(empty & (name not in ("gyro", "acc") or not empty.all()))


def _standing(
    signal: Signal, k: int, least_s: float, budget: Budget
) -> tuple[float, float, float] | None:
    """Begin, length and probability of the first frozen stretch of a reading; None without one."""
    t, v = signal.t_s, signal.values[:, k]
    same, top = np.diff(v) == 0.0, np.abs(v).max() if np.ptp(v) > 0.0 else np.inf
    runs = stretches_where(same)
    within = sum(b - a for a, b in runs if t[b] - t[a] > least_s)
    repeats = max((same.sum() - within) / max(len(same) - within, 1), 0.2)
    for a, b in runs:
        chance, long = float(repeats ** (b - a)), float(t[b] - t[a])
        if long > least_s and abs(v[a]) < top and chance < budget.chance(1.0 / signal.rate_hz):
            return float(t[a]), long, budget.probability(chance, 1.0 / signal.rate_hz)
    return None


def missing(signals: Signals, end_s: float) -> Iterator[Event]:
    """Sensors of which no sample comes for a second and twenty of their periods, while others
    do."""
    for name, (words, _, _) in _READINGS.items():
        if name not in signals:
            continue
        t = np.append(signals[name].t_s, end_s)
        gap = np.diff(t)
        others = [s.t_s for other, s in signals.items() if other != name]
        for k in np.flatnonzero(gap > max(1.0, 20.0 * float(np.median(gap)))):
            inside = [((s > t[k] + 0.1) & (s < t[k + 1] - 0.1)).sum() for s in others]
            if max(inside, default=0) > 5:
                yield _event("sensor_dropout", words, float(t[k]), _duration(float(gap[k])), 0.99)
                break


def _duration(seconds: float) -> Severity:
    return Severity(quantity="duration", value=seconds, low=seconds, high=seconds, unit="s")
