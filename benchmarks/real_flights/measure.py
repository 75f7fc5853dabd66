"""One flight held out: what is named on the others, and its gap beside trivial baselines."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.explain.explanation import Explanation, explain
from twin.explain.result_json import explain_json
from twin.residuals.channels import CHANNEL_HZ, ChannelData

from .scenarios import Scenario, read

Array = NDArray[np.float64]
HORIZONS_S = (0.02, 0.5)
"""For which the last residual is held: one sample of a channel, and the horizon of the gap."""
EDGE = 1e-4
"""A number this close to the end of its prior range, as a share of the range, is at it."""


def measure(data: Path, scenario: Scenario, holdout: str) -> dict[str, Any]:
    """Everything the page needs to know about one rotation, as JSON content."""
    start = time.perf_counter()
    fit = [read(data, f) for f in scenario.flights if f != holdout]
    away = read(data, holdout)
    found = explain(fit, [away], scenario.read_vehicle(), missions=())
    return {
        "scenario": scenario.name,
        "holdout": away.name,
        "said": explain_json(found),
        "at_edge": at_edge(found),
        "by_flight": by_flight(found),
        "channels": channels(found),
        "seconds": round(time.perf_counter() - start, 1),
    }


def at_edge(found: Explanation) -> dict[str, list[float]]:
    """Numbers at the end of their prior range, "effect.number" -> the range; shapes as well."""
    if found.naming is None:
        return {}
    ends = {}
    for number in found.naming.problem.model.numbers:
        value = found.values.get(number.full)
        low, high = number.about.prior
        if value is None or value == number.about.neutral:
            continue
        if min(abs(value - low), abs(value - high)) <= EDGE * (high - low):
            ends[number.full] = [low, high]
    return ends


def by_flight(found: Explanation) -> dict[str, dict[str, float]]:
    """Log likelihood, out of sample, that each effect adds to the others, per fitted flight."""
    if found.naming is None or found.shown is None:
        return {}
    problem, shown = found.naming.problem, found.shown
    flight = np.array([f for f, _ in problem.rest.keys])
    added = {}
    for effect in shown.effects:
        if effect not in problem.model.effects:
            continue
        without = problem.fit([e for e in shown.effects if e != effect])
        more = shown.gains - without.gains
        added[effect] = {
            name: float(more[flight == i].sum()) for i, name in enumerate(found.flights)
        }
    return added


def channels(found: Explanation) -> list[dict[str, Any]]:
    """Rms of the held-out flight per channel: every correction beside each other."""
    if found.comparison is None or found.naming is None:
        return []
    fitted = _by_name(found.naming.problem.model.channels([]))
    before = _by_name(found.comparison.before)
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
        }
        for gap in sorted(found.comparison.gaps, key=lambda g: list(before).index(g.name))
    ]


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
