"""Search for zero-mean effects in repeated readings and spectra.

| observable as | in | distinguished by |
|---|---|---|
| Repeats | a reading that repeats exactly | the other axes keep changing |
| NoiseFloor | flat part of the spectrum, all axes | same level in every part of the band |
| Lines | lines at rotor or constant frequencies | level over the neighbouring frequencies |
| RandomForce | slow part of the accelerometer | no function of motion, falls with frequency |

Noise changes the last bit of a reading at nearly every sample. A reading that repeats exactly for a
long time is stuck, unless nothing moves, the sensor is slower than the table, its resolution is
coarse, or the column was never measured: these also appear in the other axes of the sensor, or in
the reading at other times.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from ...effects import EFFECTS, Effect, Lines, NoiseFloor, RandomForce, Repeats
from ...effects.stages import Air
from ...frames import to_body
from ...logs import Flight
from ...logs.columns import ACC
from ...physics.sensors.table import BODY, SENSORS
from ...residuals.aligned import AlignedFlight
from ...residuals.channels import CHANNEL_HZ, GRID_HZ, Array, ChannelData
from ...vehicle import GRAVITY_M_S2
from ..model.model import Model
from ..model.numbers import columns_of
from ..settings import DEFAULT, GustSettings, StochasticSettings, StuckSettings
from .imu_noise import find_noise_level, find_vibration
from .spectral import Piece, StochasticEffect, cells_of, level, prior_log_odds

PLACEHOLDERS = (0.0, GRAVITY_M_S2, 9.81, 9.8)
"""Magnitudes that are placeholders in columns without measurement."""


@dataclass(frozen=True, slots=True)
class Stuck:
    """A stuck channel.

    Attributes:
        flight: Name of the flight.
        channel: Column of the flight table.
        from_s: Time of the first repeated sample, s.
        to_s: Time of the last repeated sample, s.
        value: Constant reading.
        to_the_end: Whether it stays constant until the end.
    """

    flight: str
    channel: str
    from_s: float
    to_s: float
    value: float
    to_the_end: bool


def stuck_channels(
    flight: Flight, settings: StuckSettings = DEFAULT.stochastic.stuck
) -> list[Stuck]:
    """All long constant spans of a reading that only a fault explains, in order of time."""
    found = []
    for channel, sensor in ((c, s.columns) for s in SENSORS for c in s.columns if flight.has(c)):
        found += _of_channel(flight, channel, [c for c in sensor if c != channel], settings)
    return sorted(found, key=lambda s: (s.from_s, s.channel))


def without_stuck(flight: Flight, stuck: Sequence[Stuck]) -> Flight:
    """The flight with all axes of a sensor unknown (NaN) while one of them is stuck."""
    own = [s for s in stuck if s.flight == flight.name]
    if not own:
        return flight
    table = flight.table.copy()
    time = table["time"].to_numpy(dtype=np.float64)
    for s in own:
        sensor = next(r.columns for r in SENSORS if s.channel in r.columns)
        rows = (time >= s.from_s) & (time <= s.to_s)
        table.loc[rows, [c for c in sensor if c in table]] = np.nan
    return replace(flight, table=table)


def stuck_numbers(stuck: Sequence[Stuck], effect: Effect) -> Mapping[str, float]:
    """Numbers of the effect, "effect.number" -> value, for the channel that is stuck for longest to
    the end; empty where none is."""
    observable_as = effect.observable_as
    assert isinstance(observable_as, Repeats)
    own = [s for s in stuck if s.channel in observable_as.channels and s.to_the_end]
    if not own:
        return {}
    worst = max(own, key=lambda s: s.to_s - s.from_s).channel
    times = [s.from_s for s in own if s.channel == worst]
    return {
        f"{effect.name}.{observable_as.channel}": 1.0 + observable_as.channels.index(worst),
        f"{effect.name}.{observable_as.since}": float(np.median(times)),
    }


def _of_channel(
    flight: Flight, channel: str, others: Sequence[str], settings: StuckSettings
) -> list[Stuck]:
    """Stuck spans of one channel."""
    t, x = _samples(flight, channel)
    starts, ends = _runs(x)
    steps, moves = ends - starts, np.abs(np.diff(x))
    bit = float(moves[moves > 0].min(initial=np.inf)) if np.any(moves > 0) else 0.0
    if not others:  # a scalar sensor: the IMU must change, and its own noise move it
        others = [c for s in SENSORS if s.group == BODY for c in s.columns]
        bit = 0.0 if float(np.std(np.diff(x))) > settings.moving_bits * bit else np.inf
    neighbours = [_samples(flight, c) for c in others if flight.has(c)]
    found = []
    for k in np.flatnonzero(t[ends] - t[starts] >= settings.shortest_s):
        first, last = int(starts[k]), int(ends[k])
        if steps[k] < settings.longer * np.delete(steps, k).max(initial=1):
            continue
        if _never_measured(x, first, last) or _comes_to_rest(x, first, settings.smooth):
            continue
        inside = [y[(ty >= t[first]) & (ty <= t[last])] for ty, y in neighbours]
        if not any(_goes_on(y, bit, steps[k], settings) for y in inside):
            continue
        span, to_the_end = (float(t[first]), float(t[last])), last == len(x) - 1
        found.append(Stuck(flight.name, channel, *span, float(x[first]), to_the_end))
    return found


def _samples(flight: Flight, channel: str) -> tuple[Array, Array]:
    """Times, s, and finite readings of one column, shape (n,) each."""
    t, x = flight.signal([channel])
    return t, x[:, 0]


def _runs(x: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last index of each run of equal samples, including single ones."""
    edges = np.flatnonzero(np.diff(x) != 0)
    return np.concatenate([[0], edges + 1]), np.concatenate([edges, [len(x) - 1]])


def _never_measured(x: Array, first: int, last: int) -> bool:
    """Whether the constant value is a placeholder for no measurement."""
    return bool(np.isclose(abs(x[first]), PLACEHOLDERS, rtol=0, atol=1e-9).any()) and (
        last - first + 1 == len(x) or x[first] == 0.0
    )


def _comes_to_rest(x: Array, first: int, smooth: float) -> bool:
    """Whether a noise-free reading converges smoothly to its constant value, or begins there."""
    moving = x[np.flatnonzero(np.diff(x))]
    if len(moving) < 8:
        return first == 0 and len(np.unique(x)) > 1
    steps, bends = np.diff(moving), np.diff(moving, 2)
    size = float(np.sqrt(np.mean(steps**2)))
    if float(np.median(np.abs(bends))) > smooth * float(np.median(np.abs(steps))):
        return False
    return first == 0 or abs(x[first] - x[first - 1]) < smooth * size


def _goes_on(y: Array, bit: float, steps: int, settings: StuckSettings) -> bool:
    """Whether the readings `y` of another axis change like those of a working sensor while one axis
    is constant for so many steps."""
    if len(y) < 8:
        return False
    first, last = _runs(y)
    lively = np.std(y) > settings.moving_bits * bit
    return bool(settings.longer * (last - first).max() <= steps and lively)


# -- search --------------------------------------------------------------------------------


def find_stochastic(
    model: Model, values: Mapping[str, float], settings: StochasticSettings = DEFAULT.stochastic
) -> list[StochasticEffect]:
    """Zero-mean effects present in the flights, the most probable first."""
    found = []
    for effect in EFFECTS.values():
        match effect.observable_as:
            case NoiseFloor():
                found.append(find_noise_level(model, effect, settings))
            case Lines():
                found.append(find_vibration(model, effect, settings))
            case RandomForce():
                found.append(find_gust(model, values, effect, settings))
    return sorted((u for u in found if u is not None), key=lambda u: -u.log_odds)


def find_stuck(
    stuck: Sequence[Stuck], settings: StochasticSettings = DEFAULT.stochastic
) -> list[StochasticEffect]:
    """Effects of stuck readings; empty where none is stuck."""
    if not stuck:
        return []
    channels = tuple(dict.fromkeys(s.channel for s in stuck))
    odds = -prior_log_odds(settings)
    return [
        StochasticEffect(e.name, odds, stuck_numbers(stuck, e), {}, channels, 1.0)
        for e in EFFECTS.values()
        if isinstance(e.observable_as, Repeats)
    ]


# -- gusts -----------------------------------------------------------------------------------


SLOW_HZ = 10.0
"""Sample rate of the low-frequency part, Hz."""
LAG_S = 0.2
"""Lag of the autocorrelation that gives the time constant of the force, s; by judgement."""
SMALLEST_DRAG_1_S = 0.02
"""Drag coefficient, 1/s, below which a gust hardly acts; a twelfth of the usual one."""
RIDGES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Prior variances of a coefficient that are tried, in units of the noise of one sample."""


@dataclass(frozen=True, slots=True)
class Slow:
    """Low-frequency part of the accelerometer residuals of one piece of flight.

    Attributes:
        t_s: Times, s, shape (n,), at `SLOW_HZ`.
        residual: Residual, m/s2, shape (n, 3).
        features: Regressors per axis, shape (n, 3, k).
        drag: Response to north, east and down wind, 1/s, shape (n, 3, 3); empty without drag.
        speed_m_s: Speed of the vehicle, m/s, shape (n,).
        floor: Density of the white noise floor per axis, (m/s2)^2/Hz, shape (3,).
    """

    t_s: Array
    residual: Array
    features: Array
    drag: Array
    speed_m_s: Array
    floor: Array


def slow_parts(
    aligned: AlignedFlight,
    channels: Sequence[ChannelData],
    winds: Sequence[int],
    settings: GustSettings = DEFAULT.stochastic.gust,
) -> list[Slow]:
    """Low-frequency parts of one flight; `winds`: slope columns of a wind north, east, down."""
    acc = [c for c in channels if c.name in ACC]
    motion = aligned.motion
    if len(acc) < 3 or motion.velocity is None or motion.attitude is None:
        return []
    found = []
    every = round(CHANNEL_HZ / SLOW_HZ)
    sos = butter(2, settings.band_hz, "bandpass", fs=CHANNEL_HZ, output="sos")
    spin, force = aligned.predicted("spin_", "specific_force_")
    for t in pieces_in_common(acc):
        if len(t) < (settings.window_s + 1) * CHANNEL_HZ:
            continue
        rows = [np.searchsorted(c.t_s, t) for c in acc]
        residual = np.stack([c.residual[k] for c, k in zip(acc, rows, strict=True)], axis=-1)
        own = [c.slopes[k] for c, k in zip(acc, rows, strict=True)]
        slopes = np.stack(own, axis=1)  # (n, 3, k)
        at = np.rint((t - aligned.inputs.t_s[0]) * GRID_HZ).astype(np.intp)
        curves = _curves(aligned, at, spin, force)  # (n, c)
        still = np.delete(slopes, list(winds), axis=2)  # a constant wind in body axes
        features = np.concatenate([still, np.repeat(curves[:, None, :], 3, axis=1)], axis=2)
        speed = np.linalg.norm(motion.velocity.at(t), axis=1)
        cells = cells_of(Piece(t, residual), CHANNEL_HZ, settings.window_s, "hann")
        quiet = (cells.f_hz >= settings.floor_hz[0]) & (cells.f_hz <= settings.floor_hz[1])
        found.append(
            Slow(
                t[::every],
                sosfiltfilt(sos, residual, axis=0)[::every],
                sosfiltfilt(sos, features, axis=0)[::every],
                slopes[::every][:, :, list(winds)],
                speed[::every],
                level(cells.power[:, :, quiet], (0, 2)),
            )
        )
    return found


def pieces_in_common(channels: Sequence[ChannelData]) -> list[Array]:
    """Times of uninterrupted pieces that all of these channels share."""
    t = reduce(np.intersect1d, [c.t_s for c in channels])
    return np.split(t, np.flatnonzero(np.diff(t) > 1.5 / CHANNEL_HZ) + 1)


def _curves(aligned: AlignedFlight, at: NDArray[np.intp], spin: Array, force: Array) -> Array:
    """Speed, thrust and rotation rates, and products of them, shape (n, c)."""
    assert aligned.motion.velocity is not None
    column = {s.name: i for i, s in enumerate(aligned.airframe.states)}
    q, v, w = (
        aligned.states[at][:, [column[f"{stem}_{a}"] for a in axes]]
        for stem, axes in (("q", "wxyz"), ("vel", "xyz"), ("omega", "xyz"))
    )
    body = np.stack(to_body(list(q.T), list(v.T)), axis=-1)
    size = np.linalg.norm(body, axis=1, keepdims=True)
    thrust = force[at][:, 2:]
    load = spin[at] ** 2
    height = np.exp(aligned.states[at][:, [column["pos_z"]]])
    drags = body, np.abs(body), size * body, size**2 * body, thrust * body
    turns = w, np.abs(w), body * np.roll(w, 1, axis=1), body * np.roll(w, 2, axis=1)
    return np.concatenate([*drags, load, *turns, height], axis=1)


def left_over(
    pieces: Sequence[Slow], settings: GustSettings = DEFAULT.stochastic.gust
) -> list[Array]:
    """Residual of each piece after a ridge regression fitted on other time blocks, shape (n, 3)."""
    blocks = [np.floor(p.t_s / settings.fold_s).astype(int) for p in pieces]
    fold = [(b + i) % settings.folds for i, b in enumerate(blocks)]
    folds = np.concatenate(fold)
    left = []
    for axis in range(3):
        y = np.concatenate([p.residual[:, axis] for p in pieces])
        x = np.nan_to_num(np.concatenate([p.features[:, axis] for p in pieces]))
        size = np.sqrt(np.mean(x * x, axis=0))
        x = x[:, size > 1e-9 * max(float(size.max(initial=0.0)), 1e-9)]
        x = x / np.maximum(np.sqrt(np.mean(x * x, axis=0)), 1e-300)
        tries = [y]
        for ridge in RIDGES:
            out = np.array(y)
            for k in range(settings.folds):
                test, train = folds == k, folds != k
                gram = x[train].T @ x[train] + ridge * train.sum() * 1e-2 * np.eye(x.shape[1])
                out[test] -= x[test] @ np.linalg.solve(gram, x[train].T @ y[train])
            tries.append(out)
        left.append(min(tries, key=lambda e: float(np.median(e * e))))
    rest = np.stack(left, axis=-1)
    return np.split(rest, np.cumsum([len(p.t_s) for p in pieces])[:-1])


NO_NOISE = 1e-8
"""Smallest density, (m/s2)^2/Hz: 0.5 mm/s2 at 50 Hz, the rounding of a simulator."""


def find_gust(
    model: Model,
    values: Mapping[str, float],
    effect: Effect,
    settings: StochasticSettings = DEFAULT.stochastic,
) -> StochasticEffect | None:
    """A slow random force that no function of the motion and no effect explains."""
    own, columns = settings.gust, columns_of(model.numbers, model.effects)
    flights = model.channels(columns, values)
    winds = [k for k, i in enumerate(columns) if EFFECTS[model.numbers[i].effect].stage is Air]
    pieces = [
        piece
        for flight, channels in zip(model.flights, flights, strict=True)
        for piece in slow_parts(flight.aligned, channels, winds, own)
    ]
    if not pieces:
        return None
    left = left_over(pieces, own)
    facts = gust_facts(pieces, left, own)
    beyond = np.log(max(facts["over_floor"], 1.0)) / own.known
    log_odds = 0.5 * beyond**2 + prior_log_odds(settings)
    if (
        log_odds <= 0
        or facts["unexplained"] < own.unexplained
        or facts["rms"] < own.smallest_m_s2
        or facts["uneven"] > own.uneven
        or facts["fall"] < own.smallest_fall
        or facts["lasting"] < own.lasting
    ):
        return None
    numbers, intervals = _gust_numbers(pieces, left, effect, own)
    share, channels = facts["unexplained"], ("acc_x", "acc_y")
    return StochasticEffect(effect.name, float(log_odds), numbers, intervals, channels, share)


def gust_facts(
    pieces: Sequence[Slow], left: Sequence[Array], own: GustSettings = DEFAULT.stochastic.gust
) -> dict[str, float]:
    """Statistics of the horizontal axes that decide on a gust."""
    cells = [
        cells_of(Piece(p.t_s, e), SLOW_HZ, own.window_s, "hann")
        for p, e in zip(pieces, left, strict=True)
    ]
    f = cells[0].f_hz
    power = np.concatenate([c.power for c in cells])  # (windows, 3, f)
    floor = np.maximum(np.mean([p.floor for p in pieces], axis=0), NO_NOISE)
    bands = [(f >= low) & (f < high) for low, high in own.slope_bands_hz]
    typical = level(power, 0)  # robust against single peaks
    density = np.stack([typical[:, b].mean(axis=1) for b in bands])  # (bands, 3)
    before = np.concatenate([p.residual for p in pieces])
    after = np.concatenate(list(left))
    rms = np.sqrt(np.mean(after**2, axis=0))
    xy = np.sum(density[:, :2] - floor[:2], axis=1)
    tiny = 0.1 * float(floor[:2].sum())
    n = round(own.lasting_s * SLOW_HZ)
    blocks = np.concatenate(
        [(e[: len(e) // n * n, :2] ** 2).reshape(-1, n * 2).mean(axis=1) for e in left]
    )
    return {
        "over_floor": float(np.min(np.mean(density[:3, :2], axis=0) / floor[:2])),
        "unexplained": float(np.sum(after[:, :2] ** 2) / max(np.sum(before[:, :2] ** 2), NO_NOISE)),
        "rms": float(np.min(rms[:2])),
        "uneven": float(np.max(rms[:2]) ** 2 / max(np.min(rms[:2]) ** 2, NO_NOISE)),
        "lasting": float(np.median(blocks) / max(np.mean(blocks), NO_NOISE)),
        "fall": float(np.min(xy[:-1] / np.maximum(xy[1:], tiny))),
    }


def _gust_numbers(
    pieces: Sequence[Slow], left: Sequence[Array], effect: Effect, own: GustSettings
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Intensities and length scales from the remaining force and the model's response to wind."""
    rest = np.concatenate(list(left))
    low, high = own.band_hz
    floor = np.mean([p.floor for p in pieces], axis=0) * (high - low)
    power = np.maximum(np.mean(rest**2, axis=0) - floor, 0.0)
    drag = np.concatenate([p.drag for p in pieces])
    least = SMALLEST_DRAG_1_S
    known = drag.shape[2] == 3 and float(np.sqrt(np.mean(drag[:, 0] ** 2))) > least
    per_speed = np.full(3, own.typical_drag_1_s)
    if known:
        per_speed = np.sqrt(np.mean(np.sum(drag**2, axis=2), axis=0))
    lag = round(LAG_S * SLOW_HZ)
    same = sum(float(np.mean(e[lag:, :2] * e[:-lag, :2])) for e in left) / len(left)
    time_s, seen = _time_constant(same / max(float(np.mean(power[:2])), 1e-300), own.band_hz)
    sigma = np.sqrt(power / seen) / np.maximum(per_speed, least)
    through = np.concatenate([p.speed_m_s for p in pieces])
    length = max(float(np.mean(through)), 1.0) * time_s
    doubt = 1.5 if known else 3.0
    values, intervals = {}, {}
    observable_as = effect.observable_as
    assert isinstance(observable_as, RandomForce)
    sizes = (sigma[:2].mean(), sigma[:2].mean(), sigma[2])
    for strength, reach, size in zip(
        observable_as.intensity, observable_as.length, sizes, strict=True
    ):
        values[f"{effect.name}.{strength}"] = float(size)
        intervals[f"{effect.name}.{strength}"] = (float(size) / doubt, float(size) * doubt)
        values[f"{effect.name}.{reach}"] = length
        intervals[f"{effect.name}.{reach}"] = (length / 3, length * 3)
    return values, intervals


def _time_constant(correlation: float, band_hz: tuple[float, float]) -> tuple[float, float]:
    """Time constant of a first-order process, s, and the share of its power inside a band."""
    f = np.linspace(*band_hz, 200)
    times = np.geomspace(0.05, 5.0, 60)[:, None]
    density = 4 * times / (1 + (2 * np.pi * f * times) ** 2)
    inside = density.mean(axis=1) * (f[-1] - f[0])
    expected = (density * np.cos(2 * np.pi * f * LAG_S)).mean(axis=1) * (f[-1] - f[0]) / inside
    k = int(np.argmin(np.abs(expected - correlation)))
    return float(times[k, 0]), float(inside[k])
