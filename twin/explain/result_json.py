"""`explain.json`: what flights say about a model, for programs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from ..effects import EFFECTS
from .explanation import LEAST, Explanation
from .flying import Mission
from .naming import Naming
from .numbers import numbers_of
from .places import Place
from .refine import Fitted
from .showing import ChannelGap
from .unnamed import Equation
from .unsteady_effect import Unsteady

Z95 = 1.959964
MOST_RIVALS = 5


def explain_json(found: Explanation) -> dict[str, Any]:
    """Everything that was found, as strict JSON content; what is not defined is null."""
    content = {
        "verdict": found.verdict,
        "reasons": list(found.reasons),
        "warnings": list(found.warnings),
        "flights": list(found.flights),
        "vehicle": found.vehicle.name,
        "nothing_probability": None if found.naming is None else nothing_probability(found.naming),
        "effects": [_effect(found, e) for e in listed(found)],
        "unnamed": [_equation(e) for e in found.unnamed],
        "where": [_place(p) for p in found.where],
        "gap": {} if found.showing is None else {g.name: _gap(g) for g in found.showing.gaps},
        "holdout": [
            {"flight": h.flight, "spans_s": None if h.spans is None else [list(s) for s in h.spans]}
            for h in found.holdout
        ],
        "closed_loop": _missions(found.missions) if found.missions else None,
        "next_manoeuvre": None if found.next_manoeuvre is None else asdict(found.next_manoeuvre),
    }
    strict = _strict(content)
    assert isinstance(strict, dict)
    return strict


def listed(found: Explanation) -> list[str]:
    """Effects that are told about, the most probable first."""
    naming = found.naming
    if naming is None or found.verdict not in ("named", "cannot_tell"):
        return []
    if naming.verdict == "cannot_tell":
        every = {e for f in naming.fitted for e in f.effects}
        effects = {e for e in every if naming.probability_of(e) >= LEAST}
    else:
        effects = set(naming.best.effects)
    effects |= {u.effect for u in found.unsteady}
    return sorted(effects, key=lambda e: (-probability_of(found, e), e))


def probability_of(found: Explanation, effect: str) -> float:
    """That an effect is missing, alone or with others."""
    beside = beside_mean(found, effect)
    if beside is not None:
        return beside.probability
    assert found.naming is not None
    return found.naming.probability_of(effect)


def beside_mean(found: Explanation, effect: str) -> Unsteady | None:
    """An effect that changes no mean; None where it changes one."""
    return next((u for u in found.unsteady if u.effect == effect), None)


def nothing_probability(naming: Naming) -> float:
    """That no effect is missing."""
    return float(
        sum(p for f, p in zip(naming.fitted, naming.probabilities, strict=True) if not f.effects)
    )


def best_with(naming: Naming, effect: str) -> Fitted:
    """The most probable hypothesis that an effect is part of."""
    return next(f for f in naming.fitted if effect in f.effects)


def intervals(fitted: Fitted) -> dict[str, tuple[float, float]]:
    """95 % intervals, "effect.number" -> low, high; shapes have none."""
    deviation = np.sqrt(np.diag(fitted.covariance))
    return {
        n.full: (fitted.values[n.full] - Z95 * float(s), fitted.values[n.full] + Z95 * float(s))
        for n, s in zip(fitted.numbers, deviation, strict=True)
    }


def rivals(naming: Naming, effect: str) -> list[dict[str, Any]]:
    """Other explanations than an effect, the most probable first, and how far they fell behind.

    `behind`: log likelihood, out of sample, below the best hypothesis with the effect; `share`: of
    the power of a channel that it takes, at its best together with the effects `with`.
    """
    fitted = best_with(naming, effect)
    found: dict[str, dict[str, Any]] = {}
    for f, p, share in zip(naming.fitted, naming.probabilities, naming.shares, strict=True):
        if effect in f.effects:
            continue
        for name in f.effects or ("nothing",):
            if name in fitted.effects:
                continue
            entry = found.setdefault(name, {"name": name, "probability": 0.0, "behind": math.inf})
            entry["probability"] += p
            if fitted.gain - f.gain < entry["behind"]:
                partners = [e for e in f.effects if e != name]
                entry |= {"behind": fitted.gain - f.gain, "share": share, "with": partners}
    ranked = sorted(found.values(), key=lambda r: (-r["probability"], r["behind"]))
    return ranked[:MOST_RIVALS]


def _effect(found: Explanation, effect: str) -> dict[str, Any]:
    assert found.naming is not None
    beside = beside_mean(found, effect)
    if beside is not None:
        return _unsteady(found, beside)
    fitted = best_with(found.naming, effect)
    own = intervals(fitted)
    about = {n.full: n for n in found.naming.ground.model.numbers}
    acts = next((a for a in found.acting if a.effect == effect), None)
    return {
        "name": effect,
        "probability": found.naming.probability_of(effect),
        "parameters": {
            about[full].name: {
                "value": value,
                "unit": about[full].about.unit,
                "ci95": own.get(full),
            }
            for full, value in fitted.values.items()
            if about[full].effect == effect
        },
        "channels": [] if acts is None else list(acts.channels),
        "phases": [] if acts is None else list(acts.phases),
        "rivals": rivals(found.naming, effect),
    }


def _unsteady(found: Explanation, effect: Unsteady) -> dict[str, Any]:
    units = {n.name: n.about.unit for n in numbers_of([EFFECTS[effect.effect]], found.vehicle)}
    return {
        "name": effect.effect,
        "probability": effect.probability,
        "parameters": {
            full.partition(".")[2]: {
                "value": value,
                "unit": units[full.partition(".")[2]],
                "ci95": effect.intervals.get(full),
            }
            for full, value in effect.values.items()
        },
        "channels": list(effect.channels),
        "phases": [],
        "rivals": [{"name": "nothing", "probability": 1 - effect.probability}],
    }


def _equation(equation: Equation) -> dict[str, Any]:
    return {
        "channel": equation.channel,
        "unit": equation.unit,
        "expression": equation.expression,
        "share": equation.share,
        "terms": [
            {"product": product, "coefficient": value, "unit": unit}
            for product, value, unit in equation.terms
        ],
    }


def _gap(gap: ChannelGap) -> dict[str, Any]:
    return {
        "unit": gap.unit,
        "before": gap.before,
        "after": gap.after,
        "noise_floor": gap.noise_floor,
        "shrink": gap.shrink,
        "shrink_ci95": gap.shrink_ci95 if math.isfinite(gap.shrink_ci95[0]) else None,
        "closed": gap.closed,
        "n": gap.n,
    }


def _place(place: Place) -> dict[str, Any]:
    return {
        "channel": place.channel,
        "phase": place.phase,
        "unit": place.unit,
        "n": place.n,
        "rms": place.rms,
        "over_floor": place.over_floor,
        "explained": place.explained,
        "band_hz": place.band_hz,
        "goes_with": None
        if place.goes_with is None
        else {"quantity": place.goes_with[0], "share": place.goes_with[1]},
    }


def _missions(missions: Sequence[Mission]) -> dict[str, Any]:
    flown = [m.worst_m for m in missions if math.isfinite(m.worst_m)]
    return {
        "stable": all(m.stable for m in missions),
        "worst_tracking_m": max(flown, default=None),
        "missions": {
            m.name: {"stable": m.stable, "worst_m": m.worst_m, "problem": m.problem or None}
            for m in missions
        },
    }


def _strict(value: Any) -> Any:
    """Six significant digits, null for what is not finite, lists for tuples."""
    if isinstance(value, Mapping):
        return {k: _strict(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(v) for v in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value
