"""Gusts: a slow random force that falls with frequency and that no curve explains."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Effect, RandomForce
from ...effects.stages import Air
from ..model.model import Model
from ..model.numbers import columns_of
from ..settings import DEFAULT, StochasticSettings
from .finding import StochasticEffect, prior_log_odds
from .slow_force import SLOW_HZ, Slow, left_over, slow_parts
from .spectral import Piece, cells_of, level

Array = NDArray[np.float64]
NO_NOISE = 1e-8
"""Smallest density that counts, (m/s2)^2/Hz: 0.5 mm/s2 at 50 Hz, the rounding of a simulator."""


def find_gust(
    model: Model,
    values: Mapping[str, float],
    effect: Effect,
    settings: StochasticSettings = DEFAULT.stochastic,
) -> StochasticEffect | None:
    """A slow random force that no curve over the motion and no effect explains.

    Args:
        model: Flights.
        values: Numbers of the effects that have been named.
        effect: Seen as a random force.
        settings: Of the slow force, and what makes it a gust.
    """
    columns = columns_of(model.numbers, model.effects)
    flights = model.channels(columns, values)
    winds = [k for k, i in enumerate(columns) if _blows(model.numbers[i].effect)]
    pieces = [
        piece
        for flight, channels in zip(model.flights, flights, strict=True)
        for piece in slow_parts(flight.aligned, channels, winds, settings.slow_force)
    ]
    return gust_in(pieces, effect, settings) if pieces else None


def _blows(effect: str) -> bool:
    """Whether an effect moves the air: its numbers are those of a wind, north, east and down."""
    return EFFECTS[effect].stage is Air


def gust_in(
    pieces: Sequence[Slow], effect: Effect, settings: StochasticSettings = DEFAULT.stochastic
) -> StochasticEffect | None:
    """Judge the slow parts of all flights."""
    own = settings.gust
    left = left_over(pieces, settings.slow_force)
    facts = gust_facts(pieces, left, settings)
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
    values, intervals = _gust_numbers(pieces, left, effect, settings)
    channels = ("acc_x", "acc_y")
    return StochasticEffect(
        effect.name, float(log_odds), values, intervals, channels, facts["unexplained"]
    )


def gust_facts(
    pieces: Sequence[Slow],
    left: Sequence[Array],
    settings: StochasticSettings = DEFAULT.stochastic,
) -> dict[str, float]:
    """Figures by which a gust is told, of the horizontal axes."""
    own = settings.gust
    cells = [
        cells_of(Piece(p.t_s, e), SLOW_HZ, settings.slow_force.window_s, "hann")
        for p, e in zip(pieces, left, strict=True)
    ]
    f = cells[0].f_hz
    power = np.concatenate([c.power for c in cells])  # (windows, 3, f)
    floor = np.maximum(np.mean([p.floor for p in pieces], axis=0), NO_NOISE)
    bands = [(f >= low) & (f < high) for low, high in own.slope_bands_hz]
    typical = level(power, 0)  # robust to single bumps
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
    pieces: Sequence[Slow],
    left: Sequence[Array],
    effect: Effect,
    settings: StochasticSettings,
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Intensities and lengths from the force that is left and the model's answer to wind."""
    own = settings.gust
    rest = np.concatenate(list(left))
    low, high = settings.slow_force.band_hz
    floor = np.mean([p.floor for p in pieces], axis=0) * (high - low)
    power = np.maximum(np.mean(rest**2, axis=0) - floor, 0.0)
    drag = np.concatenate([p.drag for p in pieces])
    least = own.smallest_drag_1_s
    known = drag.shape[2] == 3 and float(np.sqrt(np.mean(drag[:, 0] ** 2))) > least
    per_speed = (
        np.sqrt(np.mean(np.sum(drag**2, axis=2), axis=0))
        if known
        else np.full(3, own.typical_drag_1_s)
    )
    lag = round(own.lag_s * SLOW_HZ)
    same = sum(float(np.mean(e[lag:, :2] * e[:-lag, :2])) for e in left) / len(left)
    time_s, seen = _time_constant(same / max(float(np.mean(power[:2])), 1e-300), settings)
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


def _time_constant(correlation: float, settings: StochasticSettings) -> tuple[float, float]:
    """Time constant of a first-order process and the share of its power inside the slow band.

    Args:
        correlation: Of its part inside the band, over `lag_s`.
        settings: Of the slow force and of gusts.
    """
    f = np.linspace(*settings.slow_force.band_hz, 200)
    times = np.geomspace(0.05, 5.0, 60)[:, None]
    density = 4 * times / (1 + (2 * np.pi * f * times) ** 2)
    inside = density.mean(axis=1) * (f[-1] - f[0])
    expected = (
        (density * np.cos(2 * np.pi * f * settings.gust.lag_s)).mean(axis=1)
        * (f[-1] - f[0])
        / inside
    )
    k = int(np.argmin(np.abs(expected - correlation)))
    return float(times[k, 0]), float(inside[k])
