"""Vibration and noise of the IMU, in the spectrum above the motion of the body.

Vibration: spectral lines that follow the rotor speeds or are constant. Sensor noise, compared with
the vehicle file: the flat part of the spectrum, in all axes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...effects import Effect, Lines, NoiseFloor
from ...physics.sensors.table import SENSORS, Sensor
from ...residuals.channels import GRID_HZ, Array
from ...residuals.measured import Signal
from ..inference.fit import INTERVAL
from ..model.model import Model
from ..settings import DEFAULT, StochasticSettings, VibrationSettings
from .spectral import (
    Cells,
    Piece,
    StochasticEffect,
    cells_of,
    level,
    pieces_of,
    prior_log_odds,
    rate_of,
)

LOG_MEAN, LOG_SD = -0.5772156649 - np.log(np.log(2.0)), np.pi / np.sqrt(6.0)
"""Mean and standard deviation of the logarithm of an exponential variate over its median."""


@dataclass(frozen=True, slots=True)
class _Shaken:
    """Spectra of one sensor in all flights.

    Attributes:
        sensor: Row of the sensor in the table of sensors.
        rate_hz: Sample rate, Hz.
        cells: Spectrogram of every piece.
        logs: Log level of each cell over its neighbourhood, with mean 0 for noise, shape as the
            power.
        spins: Speed of each rotor over its hover speed in each window, shape (m, r).
        predicted: Density predicted by the twin, shape (3, n_f); NaN where unknown.
    """

    sensor: Sensor
    rate_hz: float
    cells: tuple[Cells, ...]
    logs: tuple[Array, ...]
    spins: tuple[Array, ...]
    predicted: Array


def find_vibration(
    model: Model, effect: Effect, settings: StochasticSettings = DEFAULT.stochastic
) -> StochasticEffect | None:
    """Spectral lines above the body's motion that follow the rotor speeds or are constant."""
    observable_as, own = effect.observable_as, settings.vibration
    assert isinstance(observable_as, Lines)
    affected = (s for s in SENSORS if s.signal in observable_as.amplitudes)
    sensors = [s for s in (_shaken(model, sensor, settings) for sensor in affected) if s]
    hover_hz = next(p for p in effect.parameters if p.name == observable_as.frequency).sized(
        model.vehicle
    )
    if not sensors:
        return None
    rel = np.exp(np.arange(np.log(hover_hz.bounds[0]), np.log(hover_hz.bounds[1]), 0.005))
    tracks = [(f, True) for f in rel.tolist()]
    top = max(s.rate_hz for s in sensors) / 2
    tracks += [(f, False) for f in np.arange(own.from_hz, 0.97 * top, 1.0).tolist()]
    scores = np.array([[_score(s, f, moves, own.overlap) for f, moves in tracks] for s in sensors])
    if not np.isfinite(scores).any():
        return None
    frequency, moves = tracks[int(np.nanargmax(scores)) % len(tracks)]
    z, prior = float(np.nanmax(scores)), prior_log_odds(settings)
    log_odds = 0.5 * z * z - np.log(len(tracks)) + prior if z > 0 else prior
    if log_odds <= 0:
        return None
    return _named_vibration(model, effect, sensors, float(log_odds), frequency, moves, settings)


def _shaken(model: Model, sensor: Sensor, settings: StochasticSettings) -> _Shaken | None:
    """Spectrograms of one sensor with its neighbourhood levels."""
    own, window_s = settings.vibration, settings.line_window_s
    cells, spins, predicted = [], [], []
    pieces = [(f, p) for f in model.flights for p in pieces_of(f, sensor.columns, window_s)]
    rate = rate_of([p for _, p in pieces])
    if rate / 2 < 1.2 * own.from_hz:
        return None
    stems = ("spin_", "specific_force_", "angular_acceleration_")
    answers = {id(f): f.aligned.predicted(*stems) for f in model.flights}
    for flight, piece in pieces:
        c = cells_of(piece, rate, window_s, "hann")
        spin, force, alpha = answers[id(flight)]
        grid = flight.aligned.inputs.t_s
        cells.append(c)
        spins.append(Signal(grid, _smooth(spin, window_s)).at(c.t_s))
        motion = np.nan_to_num(alpha if sensor.rate else force)
        m = cells_of(Piece(grid, motion), GRID_HZ, window_s, "hann")
        density = level(m.power, 0)
        if sensor.rate:
            density = density / np.maximum(2 * np.pi * m.f_hz, 1.0) ** 2
        predicted.append([np.interp(c.f_hz, m.f_hz, v, right=0.0) for v in density])
    return _Shaken(
        sensor,
        rate,
        tuple(cells),
        tuple(_logs(c, rate, own) for c in cells),
        tuple(spins),
        np.mean(predicted, axis=0),
    )


def _smooth(spin: Array, window_s: float) -> Array:
    """Moving average over half a window."""
    n = round(window_s / 2 * GRID_HZ)
    kernel = np.ones(n) / n
    return np.stack([np.convolve(s, kernel, mode="same") for s in spin.T], axis=-1)


def _logs(cells: Cells, rate_hz: float, settings: VibrationSettings) -> Array:
    """Log level of each cell over the higher of its two neighbourhoods, shape as the power; beyond
    zero and the Nyquist frequency the spectrum is mirrored."""
    f = cells.f_hz
    half = max(4, round(settings.neighbours * rate_hz / (f[1] - f[0])))
    mirrored = np.pad(cells.power, ((0, 0), (0, 0), (half, half)), mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(mirrored, half, axis=2), axis=3)
    below, above = middle[:, :, : len(f)], middle[:, :, half + 1 :][:, :, : len(f)]
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(cells.power / np.maximum(below, above)) - LOG_MEAN
    logs[:, :, (f < settings.from_hz) | (f > 0.485 * rate_hz)] = np.nan
    return np.asarray(logs, dtype=np.float64)


def _bins(sensor: _Shaken, k: int, frequency_hz: float, moves: bool) -> NDArray[np.intp]:
    """Frequency bin of each rotor's line in each window of a piece, with aliasing, shape (m, r)."""
    c, rate = sensor.cells[k], sensor.rate_hz
    f = frequency_hz * (sensor.spins[k] if moves else np.ones((len(c.t_s), 1)))
    folded = np.abs((np.nan_to_num(f) + rate / 2) % rate - rate / 2)
    return np.asarray(np.rint(folded / (c.f_hz[1] - c.f_hz[0])), dtype=np.intp)


def _score(sensor: _Shaken, frequency_hz: float, moves: bool, overlap: float) -> float:
    """Mean log level along lines of a frequency, in standard deviations of that of noise."""
    sums, counts = np.zeros(3), np.zeros(3)
    for k, logs in enumerate(sensor.logs):
        at = _bins(sensor, k, frequency_hz, moves)
        found = logs[np.arange(len(logs))[:, None], :, at]  # (windows, rotors, 3)
        known = np.isfinite(found)
        several = np.maximum(known.sum(axis=1), 1)
        sums += (np.where(known, found, 0.0).sum(axis=1) / several).sum(axis=0)
        counts += known.any(axis=1).sum(axis=0)
    if counts.min() < 8:
        return float("nan")
    together = sums[:2].sum() / (LOG_SD * np.sqrt(counts[:2].sum() / overlap))
    across = sums[2] / (LOG_SD * np.sqrt(counts[2] / overlap))
    return float(max(together, across))


def _named_vibration(
    model: Model,
    effect: Effect,
    sensors: Sequence[_Shaken],
    log_odds: float,
    frequency_hz: float,
    moves: bool,
    settings: StochasticSettings,
) -> StochasticEffect | None:
    """The vibration effect with its amplitudes, or None where it is too small or predicted as
    motion."""
    observable_as, own = effect.observable_as, settings.vibration
    assert isinstance(observable_as, Lines)
    smallest = {"acc": own.smallest_acc_m_s2, "gyro": own.smallest_gyro_rad_s}
    frequency = f"{effect.name}.{observable_as.frequency}"
    values = {frequency: frequency_hz}
    doubt = 0.02 * frequency_hz if moves else 0.5 / settings.line_window_s
    intervals = {frequency: (frequency_hz - doubt, frequency_hz + doubt)}
    channels: list[str] = []
    shares: list[float] = []
    for sensor in sensors:
        power, share, motion, lift = _line_power(sensor, frequency_hz, moves, own.line_bins)
        name = f"{effect.name}.{observable_as.amplitudes[sensor.sensor.signal]}"
        cutoff = sensor.sensor.cutoff_hz(model.vehicle)
        passed = 1.0 if cutoff is None else 1 / np.sqrt(1 + (frequency_hz / cutoff) ** 4)
        plane = power[:, :2].mean(axis=1)  # (pieces,)
        sizes = np.sqrt(2 * np.maximum(plane, 0.0) / lift) / passed
        values[name] = size = float(np.mean(sizes))
        spread = INTERVAL * max(float(np.std(sizes)), 0.1 * size)
        intervals[name] = (max(0.0, size - spread), size + spread)
        mean = power.mean(axis=0)
        large = np.sqrt(np.maximum(mean, 0.0)) > smallest[sensor.sensor.signal]
        large &= share > own.line_share
        for axis in np.flatnonzero(large & (motion < own.motion_share)):
            channels.append(sensor.sensor.columns[axis])
            shares.append(float(share[axis]))
    if not channels:
        return None
    return StochasticEffect(effect.name, log_odds, values, intervals, tuple(channels), max(shares))


def _line_power(
    sensor: _Shaken, frequency_hz: float, moves: bool, line_bins: int
) -> tuple[Array, Array, Array, Array]:
    """Power of the lines above their neighbourhood.

    Returns:
        Power per piece and axis, unit^2, shape (p, 3); share of all power above `from_hz`, and
        ratio of the twin's prediction to it, shape (3,); sum over rotors of spin^4, shape (p,).
    """
    powers, totals, motions, lifts = [], [], [], []
    for k, c in enumerate(sensor.cells):
        usable = np.isfinite(sensor.logs[k][0, 0])
        at = _bins(sensor, k, frequency_hz, moves)
        mine = np.min(np.abs(np.arange(len(c.f_hz))[None, None] - at[:, :, None]), axis=1)
        line = (mine <= line_bins) & usable
        floor = np.stack(
            [
                level(p[:, usable & ~m] if np.any(usable & ~m) else p[:, usable], 1)
                for p, m in zip(c.power, line, strict=True)
            ]
        )  # (m, 3)
        width = c.f_hz[1] - c.f_hz[0]
        excess = (c.power - floor[:, :, None]) * line[:, None, :] * width
        powers.append(excess.sum(axis=2).mean(axis=0))
        totals.append((c.power * usable).sum(axis=2).mean(axis=0) * width)
        motions.append((sensor.predicted[None] * line[:, None, :]).sum(axis=2).mean(axis=0) * width)
        spin = sensor.spins[k]
        lifts.append(max(float(np.mean(np.nansum(spin**4, axis=1))), 1e-3))
    power, total = np.stack(powers), np.stack(totals)
    mean = np.maximum(power.mean(axis=0), 1e-300)
    return power, mean / total.mean(axis=0), np.mean(motions, axis=0) / mean, np.array(lifts)


# -- noise level ---------------------------------------------------------------------------


def find_noise_level(
    model: Model, effect: Effect, settings: StochasticSettings = DEFAULT.stochastic
) -> StochasticEffect | None:
    """White noise of sensors compared with the vehicle file: the standard deviation of one reading
    at the rate of the log."""
    observable_as, own = effect.observable_as, settings.noise_level
    assert isinstance(observable_as, NoiseFloor)
    noisy = [s for s in SENSORS if s.signal in observable_as.further]
    stated = {s.columns: s.noise(model.vehicle) for s in noisy}
    further = {s.columns: f"{effect.name}.{observable_as.further[s.signal]}" for s in noisy}
    scale = f"{effect.name}.{observable_as.scale}"
    each = {c: _ratio(model, c, s, settings) for c, s in stated.items() if s > 0}
    ratios = {c: r for c, r in each.items() if r is not None}
    off = {c: r for c, r in ratios.items() if r != 1.0}
    if not off:
        return None
    both = len(off) == len(ratios) and max(off.values()) < own.alike * min(off.values())
    if not both and min(off.values()) < 1:
        return None  # the effect can only increase the noise of one sensor
    size = float(np.exp(np.mean(np.log(list(off.values())))))
    log_odds = 0.5 * (np.log(size) / own.known) ** 2 + prior_log_odds(settings)
    if log_odds <= 0:
        return None
    values = {scale: 1.0} | dict.fromkeys(further.values(), 0.0)
    intervals = {}
    spread = np.exp(INTERVAL * own.known / 2)
    if both:
        values[scale] = size
        intervals[scale] = (size / spread, size * spread)
    else:
        for columns, ratio in off.items():
            name = further[columns]
            low, values[name], high = (
                stated[columns] * float(np.sqrt(max(r * r - 1, 0.0)))
                for r in (ratio / spread, ratio, ratio * spread)
            )
            intervals[name] = (low, high)
    return StochasticEffect(
        effect.name,
        float(log_odds),
        values,
        intervals,
        tuple(c for columns in off for c in columns),
        float(abs(1 - 1 / size**2)) if size > 1 else 1 - size**2,
    )


def _ratio(
    model: Model, columns: Sequence[str], stated: float, settings: StochasticSettings
) -> float | None:
    """Ratio of the noise to the stated one; 1 where estimates differ around it, None where
    unknown."""
    own, window_s = settings.noise_level, settings.line_window_s
    pieces = [pieces_of(f, columns, window_s) for f in model.flights]
    estimates = noise_estimates(pieces, settings)
    if estimates is None:
        return None
    ratios = estimates / stated
    low, high = float(ratios.min()), float(ratios.max())
    if low < own.ratios[0] or high > own.ratios[1]:
        return None
    if low <= 1 <= high or ratios[:, -1].max() > own.flat * ratios[:, -1].min():
        return 1.0
    return float(ratios[:, -1].min()) if low > 1 else float(ratios[:, -1].max())


def noise_estimates(
    flights: Sequence[Sequence[Piece]], settings: StochasticSettings = DEFAULT.stochastic
) -> Array | None:
    """Standard deviation of a reading, by part of the band, and by axis and for all axes together.

    White noise of standard deviation s has the one-sided density 2 s^2 / rate. The quantisation
    noise, bit^2 / 12, is subtracted.

    Returns:
        Estimates, shape (bands, 4); None where the sensor is too slow.
    """
    own = settings.noise_level
    by_band: list[list[Array]] = [[] for _ in own.bands]
    bits = []
    for pieces in flights:
        rate = rate_of(pieces)
        if rate < own.slowest_hz:
            continue
        bits += [_bit(p.values[:, i]) for p in pieces for i in range(3)]
        for piece in pieces:
            c = cells_of(piece, rate, settings.line_window_s, "blackmanharris")
            for found, (low, high) in zip(by_band, own.bands, strict=True):
                inside = (c.f_hz >= low * rate) & (c.f_hz < high * rate)
                cells = c.power[:, :, inside].transpose(0, 2, 1).reshape(-1, 3)
                found.append(0.5 * rate * cells)
    if not bits:
        return None
    levels = []
    for found in by_band:
        cells = np.concatenate(found)
        low = float(np.quantile(cells, own.low)) / -np.log1p(-own.low)
        levels.append([*level(cells, 0), low])
    return np.sqrt(np.maximum(np.array(levels) - np.median(bits) ** 2 / 12, 0.0))


def _bit(x: Array) -> float:
    """Resolution of quantised readings; 0 where none is visible."""
    levels = np.unique(x)
    return float(np.diff(levels).min()) if 1 < len(levels) < 0.5 * len(x) else 0.0
