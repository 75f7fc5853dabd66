"""Gusts: a slow random force that falls with frequency and that no curve explains."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...vehicle import Vehicle
from ..model.model import Model
from ..model.numbers import columns_of
from .finding import PRIOR_ODDS, StochasticEffect
from .slow_force import SLOW_BAND_HZ, SLOW_HZ, SLOW_WINDOW_S, Slow, left_over, slow_parts
from .spectral import Piece, cells_of, level

Array = NDArray[np.float64]
NO_NOISE = 1e-8
"""Smallest density that counts, (m/s2)^2/Hz: 0.5 mm/s2 at 50 Hz, the rounding of a simulator."""
SLOPE_BANDS_HZ = ((0.15, 0.35), (0.4, 0.8), (0.8, 1.5), (1.5, 3.0))
"""The density of turbulence falls from each to the next; that of a line or a load does not."""
SMALLEST_FALL = 0.7
"""Density of each of these bands over the next, at least; equal ones differ so by chance."""
LASTING_S, LASTING = 2.0, 0.25
"""Median over mean of the power in blocks of time: turbulence goes on, bumps do not."""
UNEXPLAINED = 0.5
"""Share of the slow power that no curve explains, at least."""
SMALLEST_GUST_M_S2 = 0.03
UNEVEN = 6.0
"""Largest ratio of the power along x and y: turbulence has no preferred direction to speak of."""
KNOWN_MODEL = 0.35
"""Log deviation of the slow power of a complete model from its noise floor."""
LAG_S = 0.2
"""Over which the force is correlated with itself to find its time constant."""
SMALLEST_DRAG_1_S = 0.02
"""Below it the model has no drag to speak of, through which a gust could act."""
TYPICAL_DRAG_1_S = 0.25
"""Drag over mass and speed where the model has none: Faessler et al. 2018 measure 0.2 to 0.4."""


def find_gust(model: Model, values: Mapping[str, float]) -> StochasticEffect | None:
    """A slow random force that no curve over the motion and no effect explains.

    Args:
        model: Flights.
        values: Numbers of the effects that have been named.
    """
    columns = columns_of(model.numbers, model.effects)
    flights = model.channels(columns, values)
    winds = [k for k, i in enumerate(columns) if model.numbers[i].effect == "steady_wind"]
    pieces = [
        piece
        for flight, channels in zip(model.flights, flights, strict=True)
        for piece in slow_parts(flight.aligned, channels, winds)
    ]
    return gust_in(pieces, model.vehicle) if pieces else None


def gust_in(pieces: Sequence[Slow], vehicle: Vehicle) -> StochasticEffect | None:
    """Judge the slow parts of all flights."""
    left = left_over(pieces)
    facts = gust_facts(pieces, left)
    log_odds = 0.5 * (np.log(max(facts["over_floor"], 1.0)) / KNOWN_MODEL) ** 2 + PRIOR_ODDS
    if (
        log_odds <= 0
        or facts["unexplained"] < UNEXPLAINED
        or facts["rms"] < SMALLEST_GUST_M_S2
        or facts["uneven"] > UNEVEN
        or facts["fall"] < SMALLEST_FALL
        or facts["lasting"] < LASTING
    ):
        return None
    values, intervals = _gust_numbers(pieces, left)
    channels = ("acc_x", "acc_y")
    return StochasticEffect(
        "gust", float(log_odds), values, intervals, channels, facts["unexplained"]
    )


def gust_facts(pieces: Sequence[Slow], left: Sequence[Array]) -> dict[str, float]:
    """Figures by which a gust is told, of the horizontal axes."""
    cells = [
        cells_of(Piece(p.t_s, e), SLOW_HZ, SLOW_WINDOW_S, "hann")
        for p, e in zip(pieces, left, strict=True)
    ]
    f = cells[0].f_hz
    power = np.concatenate([c.power for c in cells])  # (windows, 3, f)
    floor = np.maximum(np.mean([p.floor for p in pieces], axis=0), NO_NOISE)
    bands = [(f >= low) & (f < high) for low, high in SLOPE_BANDS_HZ]
    typical = level(power, 0)  # robust to single bumps
    density = np.stack([typical[:, b].mean(axis=1) for b in bands])  # (bands, 3)
    before = np.concatenate([p.residual for p in pieces])
    after = np.concatenate(list(left))
    rms = np.sqrt(np.mean(after**2, axis=0))
    xy = np.sum(density[:, :2] - floor[:2], axis=1)
    tiny = 0.1 * float(floor[:2].sum())
    n = round(LASTING_S * SLOW_HZ)
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
    pieces: Sequence[Slow], left: Sequence[Array]
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Intensities and lengths from the force that is left and the model's answer to wind."""
    rest = np.concatenate(list(left))
    low, high = SLOW_BAND_HZ
    floor = np.mean([p.floor for p in pieces], axis=0) * (high - low)
    power = np.maximum(np.mean(rest**2, axis=0) - floor, 0.0)
    drag = np.concatenate([p.drag for p in pieces])
    known = drag.shape[2] == 3 and float(np.sqrt(np.mean(drag[:, 0] ** 2))) > SMALLEST_DRAG_1_S
    per_speed = (
        np.sqrt(np.mean(np.sum(drag**2, axis=2), axis=0)) if known else np.full(3, TYPICAL_DRAG_1_S)
    )
    lag = round(LAG_S * SLOW_HZ)
    same = sum(float(np.mean(e[lag:, :2] * e[:-lag, :2])) for e in left) / len(left)
    time_s, seen = _time_constant(same / max(float(np.mean(power[:2])), 1e-300))
    sigma = np.sqrt(power / seen) / np.maximum(per_speed, SMALLEST_DRAG_1_S)
    through = np.concatenate([p.speed_m_s for p in pieces])
    length = max(float(np.mean(through)), 1.0) * time_s
    doubt = 1.5 if known else 3.0
    values, intervals = {}, {}
    for way, size in (("u", sigma[:2].mean()), ("v", sigma[:2].mean()), ("w", sigma[2])):
        values[f"gust.intensity_{way}"] = float(size)
        intervals[f"gust.intensity_{way}"] = (float(size) / doubt, float(size) * doubt)
        values[f"gust.length_{way}"] = length
        intervals[f"gust.length_{way}"] = (length / 3, length * 3)
    return values, intervals


def _time_constant(correlation: float) -> tuple[float, float]:
    """Time constant of a first-order process and the share of its power inside `SLOW_BAND_HZ`.

    Args:
        correlation: Of its part inside the band, over `LAG_S`.
    """
    f = np.linspace(*SLOW_BAND_HZ, 200)
    times = np.geomspace(0.05, 5.0, 60)[:, None]
    density = 4 * times / (1 + (2 * np.pi * f * times) ** 2)
    inside = density.mean(axis=1) * (f[-1] - f[0])
    expected = (density * np.cos(2 * np.pi * f * LAG_S)).mean(axis=1) * (f[-1] - f[0]) / inside
    k = int(np.argmin(np.abs(expected - correlation)))
    return float(times[k, 0]), float(inside[k])
