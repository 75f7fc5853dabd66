"""Vibration: lines above the body's motion, which follow the rotors or stand still."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...effects import Effect, Lines
from ...physics.sensors.table import SENSORS, Sensor
from ...residuals.channels import GRID_HZ
from ...residuals.measured import Signal
from ..model.model import Model
from ..settings import DEFAULT, StochasticSettings, VibrationSettings
from .finding import SURE, StochasticEffect, prior_log_odds
from .spectral import Cells, Piece, cells_of, level, pieces_of, rate_of

Array = NDArray[np.float64]
LOG_MEAN, LOG_SD = -0.5772156649 - np.log(np.log(2.0)), np.pi / np.sqrt(6.0)
"""Of the logarithm of an exponential variate over its median."""


@dataclass(frozen=True, slots=True)
class _Shaken:
    """One sensor in all flights.

    Attributes:
        sensor: Its row.
        rate_hz: Samples per second.
        cells: Of every piece.
        logs: Log level of each cell over its neighbourhood, mean 0 in noise, like the power.
        spins: Speed of each rotor over that in hover at each window, shape (m, r).
        predicted: Density that the twin predicts, shape (3, n_f); NaN where it cannot say.
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
    """Lines above the body's motion, which follow the rotors or stand still.

    Args:
        model: Flights.
        effect: Seen as lines.
        settings: Of the spectra, and what makes a line one.
    """
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
    best: tuple[float, float, bool, _Shaken] | None = None
    for sensor in sensors:
        scores = np.array([_score(sensor, f, moves, own.overlap) for f, moves in tracks])
        if not np.isfinite(scores).any():
            continue
        k = int(np.nanargmax(scores))
        if best is None or scores[k] > best[0]:
            best = (float(scores[k]), *tracks[k], sensor)
    if best is None:
        return None
    z, frequency, moves, sensor = best
    prior = prior_log_odds(settings)
    log_odds = 0.5 * z * z - np.log(len(tracks)) + prior if z > 0 else prior
    if log_odds <= 0:
        return None
    return _named_vibration(model, effect, sensors, float(log_odds), frequency, moves, settings)


def _shaken(model: Model, sensor: Sensor, settings: StochasticSettings) -> _Shaken | None:
    """Spectrograms of one sensor."""
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
        motion = np.nan_to_num(alpha if sensor.rate_unit else force)
        m = cells_of(Piece(grid, motion), GRID_HZ, window_s, "hann")
        density = level(m.power, 0)
        if sensor.rate_unit:
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
    """Mean over half a window."""
    n = round(window_s / 2 * GRID_HZ)
    kernel = np.ones(n) / n
    return np.stack([np.convolve(s, kernel, mode="same") for s in spin.T], axis=-1)


def _logs(cells: Cells, rate_hz: float, settings: VibrationSettings) -> Array:
    """Log level of each cell over the higher of its two neighbourhoods, shape as the power.

    Both sides count: a spectrum that falls steeply is no line. Beyond zero and half the rate a
    spectrum is its own mirror image.
    """
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
    """Bin of each rotor's line in each window of a piece, folded at half the rate, shape (m, r)."""
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
    """The line with its sizes, or None where it is too small or predicted as motion."""
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
        values[name] = float(np.mean(sizes))
        spread = SURE * max(float(np.std(sizes)), 0.1 * float(np.mean(sizes)))
        intervals[name] = (
            max(0.0, float(np.mean(sizes)) - spread),
            float(np.mean(sizes)) + spread,
        )
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
    """Power of the lines over their neighbourhood.

    Returns:
        Power per piece and axis, unit^2, shape (p, 3); share of all above `from_hz`, and
        what the twin predicts over it, shape (3,); sum over rotors of spin^4, shape (p,).
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
