"""Sensor noise against that of the vehicle file: the flat part of the spectrum, on all axes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...effects import Effect, NoiseFloor
from ...physics.sensors.table import SENSORS
from ..model.model import Model
from ..settings import DEFAULT, StochasticSettings
from .finding import SURE, StochasticEffect, prior_log_odds
from .spectral import Piece, cells_of, level, pieces_of, rate_of

Array = NDArray[np.float64]


def find_noise_level(
    model: Model, effect: Effect, settings: StochasticSettings = DEFAULT.stochastic
) -> StochasticEffect | None:
    """White noise of sensors against that of the vehicle file.

    A noise level is the standard deviation of one reading, at the rate of the log: what a sensor
    averages before, the file has to know.

    Args:
        model: Flights.
        effect: Seen as a noise floor.
    """
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
        return None  # the effect can only add to one sensor alone
    size = float(np.exp(np.mean(np.log(list(off.values())))))
    log_odds = 0.5 * (np.log(size) / own.known) ** 2 + prior_log_odds(settings)
    if log_odds <= 0:
        return None
    values = {scale: 1.0} | dict.fromkeys(further.values(), 0.0)
    intervals = {}
    spread = np.exp(SURE * own.known / 2)
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
    """Noise over the stated one; 1 where estimates differ about it, None where unknown."""
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

    White noise of standard deviation s has the one-sided density 2 s^2 / rate. The noise of the
    last bit, bit^2 / 12, is taken off.

    Args:
        flights: Pieces of each.
        settings: Parts of the band, and window.

    Returns:
        Shape (bands, 4); None where the sensor is too slow.
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
    """Last bit of quantised readings; 0 where there is none to see."""
    levels = np.unique(x)
    return float(np.diff(levels).min()) if 1 < len(levels) < 0.5 * len(x) else 0.0
