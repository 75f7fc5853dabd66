"""Readings of a sensor at its own rate, their spectrograms, and the effects found in them.

Spectrogram cells of white noise are exponentially distributed; quantiles give its level even if a
few cells contain other signals (Percival & Walden, Spectral Analysis for Physical Applications, ch.
6).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import spectrogram

from ...residuals.channels import GRID_HZ, Array
from ..model.model import FlightModel
from ..settings import DEFAULT, StochasticSettings


def prior_log_odds(settings: StochasticSettings = DEFAULT.stochastic) -> float:
    """Prior log odds of an effect."""
    return -float(np.log(settings.one_of))


@dataclass(frozen=True, slots=True)
class StochasticEffect:
    """A zero-mean effect with its evidence.

    Attributes:
        effect: Identifier of the effect.
        log_odds: Posterior log odds, natural logarithm.
        values: Estimates, "effect.number" -> value.
        intervals: 95 % interval of each number.
        channels: Channels in which it was found.
        share: Share of their power in the frequency band where it acts.
        before: Values without the effect, for numbers whose neutral value is not zero.
    """

    effect: str
    log_odds: float
    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    channels: tuple[str, ...]
    share: float
    before: Mapping[str, float] = field(default_factory=dict)

    @property
    def probability(self) -> float:
        """Posterior probability of the effect."""
        return float(1 / (1 + np.exp(-self.log_odds)))


@dataclass(frozen=True, slots=True)
class Piece:
    """Uninterrupted readings of one sensor in the air without repeats, shape (n, 3), at nearly
    uniform times, s, shape (n,)."""

    t_s: Array
    values: Array


@dataclass(frozen=True, slots=True)
class Cells:
    """Spectrogram of one piece: power spectral density per window, axis and frequency, unit^2/Hz,
    shape (m, 3, n), with the centre time of each window, s, shape (m,), and the frequencies, Hz,
    shape (n,)."""

    t_s: Array
    f_hz: Array
    power: Array


def pieces_of(flight: FlightModel, columns: Sequence[str], window_s: float) -> list[Piece]:
    """Pieces of readings in the air at the sensor's own rate; repeats of a slower sensor, and
    pieces shorter than four windows, are omitted."""
    if not flight.flight.has(*columns):
        return []
    t, x = flight.flight.signal(columns)
    grid = flight.aligned.inputs.t_s
    near = np.clip(np.rint((t - grid[0]) * GRID_HZ).astype(np.intp), 0, len(grid) - 1)
    t, x = t[flight.aligned.airborne[near]], x[flight.aligned.airborne[near]]
    if len(t) < 2:
        return []
    repeated = np.all(x[1:] == x[:-1], axis=1)
    if np.mean(repeated) > 0.2:
        fresh = np.concatenate([[True], ~repeated])
        t, x = t[fresh], x[fresh]
    if len(t) < 2:
        return []
    gaps = np.flatnonzero(np.diff(t) > 2.5 * np.median(np.diff(t))) + 1
    whole = (Piece(a, b) for a, b in zip(np.split(t, gaps), np.split(x, gaps), strict=True))
    return [p for p in whole if len(p.t_s) > 16 and p.t_s[-1] - p.t_s[0] >= 4 * window_s]


def rate_of(pieces: Sequence[Piece]) -> float:
    """Sample rate, Hz; 0 without a piece."""
    steps = [np.diff(p.t_s) for p in pieces]
    return 1.0 / float(np.median(np.concatenate(steps))) if steps else 0.0


def cells_of(piece: Piece, rate_hz: float, window_s: float, window: str) -> Cells:
    """Spectrogram with half-overlapping windows, linearly detrended."""
    n = min(len(piece.t_s), round(window_s * rate_hz))
    f, t, power = spectrogram(
        piece.values, rate_hz, window, n, n // 2, detrend="linear", axis=0, mode="psd"
    )
    return Cells(piece.t_s[0] + t, f, np.moveaxis(power, 2, 0).transpose(0, 2, 1))


def level(power: Array, axis: int | tuple[int, ...]) -> Array:
    """Noise level: mean of the cells estimated from their median, robust against lines and
    peaks."""
    return np.asarray(np.median(power, axis=axis) / np.log(2.0), dtype=np.float64)
