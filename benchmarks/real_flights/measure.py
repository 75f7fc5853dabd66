"""One flight held out: what is named on the others, and its gap against trivial baselines.

Residuals by frequency: the bands that the page shows of angular acceleration.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from twin.effects import EffectParameter
from twin.explain.estimates import estimates_of, listed_effects
from twin.explain.explanation import Explanation, explain
from twin.frames import to_body
from twin.logs import Flight
from twin.logs.columns import QUAT, VEL
from twin.residuals.channels import CHANNEL_HZ, ChannelData
from uavtwin.explain_record import explain_record

from .scenarios import Scenario, read

Array = NDArray[np.float64]
EDGES_HZ = (0.8, 4.5, 13.0)
"""Between the bands; the constant is in the first one."""
NAMES = ("< 0.8 Hz", "0.8-4.5 Hz", "4.5-13 Hz", "> 13 Hz")


def band_rms(flights: Sequence[ChannelData]) -> list[float]:
    """Rms of one channel of some flights by band; the squares sum up to that of the whole.

    By the orthonormal discrete cosine transform of each uninterrupted piece.
    """
    powers, n = np.zeros(len(NAMES)), 0
    for c in flights:
        for k in np.unique(c.piece):
            values = dct(c.residual[c.piece == k], norm="ortho")
            hz = np.arange(len(values)) * CHANNEL_HZ / 2 / len(values)
            band = np.searchsorted(EDGES_HZ, hz, side="right")
            powers += np.bincount(band, values**2, minlength=len(NAMES))
            n += len(values)
    return [float(v) for v in np.sqrt(powers / max(n, 1))]


def above(bands: Sequence[float]) -> float:
    """Rms of all bands but the slowest."""
    return float(np.sqrt(sum(b * b for b in bands[1:])))


def about_mean(rms: float, mean: float) -> float:
    """Rms about the mean."""
    return float(np.sqrt(max(rms**2 - mean**2, 0.0)))


HORIZONS_S = (0.02, 0.5)
"""For which the last residual is held: one sample of a channel, and the horizon of the gap."""
EDGE = 1e-4
"""A number this close to the end of its prior range, as a share of the range, is at it."""


def measure(data: Path, scenario: Scenario, holdout: str) -> dict[str, Any]:
    """Everything the page needs to know about one rotation, as JSON content."""
    start = time.perf_counter()
    fit = [read(data, f) for f in scenario.flights if f != holdout]
    away, vehicle = read(data, holdout), scenario.read_vehicle()
    found = explain(fit, [away], vehicle, indoors=scenario.indoors)
    return {
        "scenario": scenario.name,
        "holdout": away.name,
        "said": explain_record(found).json(),
        "numbers": numbers(found),
        "predicted": dict(found.values),
        "channels": channels(found),
        "braking": braking(fit),
        "seconds": round(time.perf_counter() - start, 1),
    }


def braking(flights: Sequence[Flight]) -> float | None:
    """The trivial rule for drag, 1/s: least squares of specific force across the thrust on the
    velocity in body axes, both less their means in the tour of a flight, by nothing else; None
    where no flight has both in one row."""
    columns, along, square = [*QUAT, *VEL, "acc_x", "acc_y"], 0.0, 0.0
    for flight in (f for f in flights if f.has(*columns)):
        way = ~flight.table.phase.isin(["ground", "takeoff", "land"])
        tour = flight.table.loc[way, columns].dropna().to_numpy().T
        if not tour.size:
            continue
        velocity = np.array(to_body(tour[:4], tour[4:7])[:2])
        v, force = (x - x.mean(axis=1, keepdims=True) for x in (velocity, tour[7:]))
        along, square = along - float(np.sum(v * force)), square + float(np.sum(v * v))
    return along / square if square else None


def numbers(found: Explanation) -> dict[str, dict[str, Any]]:
    """Numbers of every effect that may be there, where it is there: "effect.number" -> facts.

    Among them those of effects that something merely acts like, and of those without a mean.
    `edge` is the prior range of a number that is at the end of it.
    """
    if found.naming is None:
        return {}
    facts = {}
    for effect in dict.fromkeys([*found.naming.conditional.effects, *listed_effects(found)]):
        for e in estimates_of(found, effect):
            facts[e.number.full] = {
                "value": e.value,
                "unit": e.number.about.unit,
                "ci95": None if e.ci95 is None else list(e.ci95),
                "prior_share": e.prior_share,
                "neutral": e.number.about.neutral,
                "edge": _edge(e.value, e.number.about),
            }
    return facts


def _edge(value: float, about: EffectParameter) -> list[float] | None:
    low, high = about.bounds
    near = min(abs(value - low), abs(value - high)) <= EDGE * (high - low)
    return [low, high] if near and value != about.neutral else None


def channels(found: Explanation) -> list[dict[str, Any]]:
    """Rms of the held-out flight per channel: every correction beside each other."""
    if found.comparison is None or found.naming is None:
        return []
    fitted = _by_name(found.naming.problem.model.channels([]))
    before, after, best = (
        _by_name(flights)
        for flights in (found.comparison.before, found.comparison.after, found.comparison.best)
    )
    return [
        {
            "name": gap.name,
            "unit": gap.unit,
            "n": gap.n,
            "none": gap.before,
            **baselines(before[gap.name], fitted.get(gap.name, [])),
            "effects": gap.after,
            "floor": gap.noise_floor,
            "shrink_ci95": [x if np.isfinite(x) else None for x in gap.shrink_ci95],
            **spectra(
                {"none": before[gap.name], "effects": after[gap.name], "floor": best[gap.name]},
                fitted.get(gap.name, []),
            ),
        }
        for gap in sorted(found.comparison.gaps, key=lambda g: list(before).index(g.name))
    ]


def spectra(
    left: Mapping[str, Sequence[ChannelData]], fit: Sequence[ChannelData]
) -> dict[str, dict[str, Any]]:
    """Mean and rms by band of what every correction leaves of one channel.

    Args:
        left: By correction, `none` among them, the channel of each held-out flight.
        fit: The same channel of each flight that was fitted on, without any effect.
    """
    own = _mean(left["none"])
    shifts = {"own_mean": own} | ({"fit_mean": _mean(fit)} if fit else {})
    every = dict(left) | {
        name: [replace(c, residual=c.residual - by) for c in left["none"]]
        for name, by in shifts.items()
    }
    return {
        "mean": {name: _mean(flights) for name, flights in every.items()},
        "bands": {name: band_rms(flights) for name, flights in every.items()},
    }


def _mean(flights: Sequence[ChannelData]) -> float:
    return float(np.mean(np.concatenate([c.residual for c in flights])))


def baselines(away: Sequence[ChannelData], fit: Sequence[ChannelData]) -> dict[str, float | None]:
    """Rms of what trivial corrections leave of held-out flights.

    Args:
        away: One channel of each held-out flight, without any effect.
        fit: The same channel of each flight that was fitted on.
    """
    residual = np.concatenate([c.residual for c in away])
    mean = float(np.mean(np.concatenate([c.residual for c in fit]))) if fit else None
    return {
        "fit_mean": None if mean is None else rms(residual - mean),
        "own_mean": rms(residual - residual.mean()),
        **{f"last_{1000 * h:.0f}_ms": held(away, h) for h in HORIZONS_S},
    }


def held(flights: Sequence[ChannelData], horizon_s: float) -> float | None:
    """Rms of the residual less what it was a horizon ago, within uninterrupted pieces."""
    step = round(horizon_s * CHANNEL_HZ)
    parts = [
        values[step:] - values[:-step]
        for c in flights
        for k in np.unique(c.piece)
        if len(values := c.residual[c.piece == k]) > step
    ]
    return rms(np.concatenate(parts)) if parts else None


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _by_name(flights: Sequence[Sequence[ChannelData]]) -> dict[str, list[ChannelData]]:
    return {c.name: [f[i] for f in flights] for i, c in enumerate(flights[0])}
