"""`explain.json`: what flights say about a model, for programs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ..flight.stability import Mission
from .estimates import (
    calibrated_effects,
    channels_and_phases,
    estimates_of,
    listed_effects,
    nothing_probability,
    probability_of,
    rivals,
    undecided,
)
from .explanation import Explanation
from .holdout import ChannelGap
from .inference.selection import Naming
from .localization import Place
from .unnamed import Equation


def explain_json(found: Explanation) -> dict[str, Any]:
    """Everything that was found, as strict JSON content; what is not defined is null."""
    content = {
        "verdict": found.verdict,
        "reasons": list(found.reasons),
        "warnings": list(found.warnings),
        "flights": list(found.flights),
        "since": None if found.since is None else list(found.since),
        "vehicle": found.vehicle.name,
        "nothing_probability": None if found.naming is None else nothing_probability(found.naming),
        "outside_probability": None if found.naming is None else found.naming.outside,
        "effects": [_effect(found, e) for e in listed_effects(found)],
        "undecided": list(undecided(found)),
        "inclusion": {} if found.naming is None else dict(found.naming.inclusion),
        "acts_like": []
        if found.naming is None
        else [{"name": r.effect, "why": r.why} for r in found.naming.resemblances],
        "calibrated": [
            {"effect": e, "parameters": _parameters(found, e)} for e in calibrated_effects(found)
        ],
        "hover": [h.json() for h in found.hovers],
        "not_visible": _not_visible(found),
        "per_flight": {} if found.naming is None else _per_flight(found.naming),
        "unnamed": [_equation(e) for e in found.unnamed],
        "where": [_place(p) for p in found.where],
        "gap": {} if found.comparison is None else {g.name: _gap(g) for g in found.comparison.gaps},
        "holdout": [
            {"flight": h.flight, "spans_s": None if h.spans is None else [list(s) for s in h.spans]}
            for h in found.holdout
        ],
        "closed_loop": _missions(found.missions) if found.missions else None,
        "next_manoeuvre": None if found.next_manoeuvre is None else asdict(found.next_manoeuvre),
        "settings": {"hash": found.settings.hash, "changed": found.settings.changed},
    }
    strict = _strict(content)
    assert isinstance(strict, dict)
    return strict


def _effect(found: Explanation, effect: str) -> dict[str, Any]:
    channels, phases = channels_and_phases(found, effect)
    return {
        "name": effect,
        "probability": probability_of(found, effect),
        "parameters": _parameters(found, effect),
        "one_of": [] if found.naming is None else list(found.naming.one_of(effect)),
        "channels": channels,
        "phases": phases,
        "rivals": rivals(found, effect),
    }


def _parameters(found: Explanation, effect: str) -> dict[str, Any]:
    return {
        t.number.name: {
            "value": t.value,
            "unit": t.number.about.unit,
            "ci95": t.ci95,
            "no_effect": t.no_effect,
            "prior_share": t.prior_share,
            "tension": t.tension,
        }
        for t in estimates_of(found, effect)
    }


def _not_visible(found: Explanation) -> list[dict[str, Any]]:
    """Effects that are not named, and the smallest change that these flights would show."""
    detectable = {} if found.naming is None else found.naming.detectable
    named = listed_effects(found)
    return [
        {
            "cause": effect,
            "number": d.number.partition(".")[2],
            "smallest_detectable": None if d.value is None else {"value": d.value, "unit": d.unit},
        }
        for effect, d in detectable.items()
        if effect not in named
    ]


def _per_flight(naming: Naming) -> dict[str, Any]:
    """What stands out of the day of each flight."""
    unit = {n.full: n.about.unit for n in naming.problem.model.numbers}
    return {
        flight: {
            name: {"difference": value, "sd": sd, "unit": unit[name]}
            for name, (value, sd) in own.items()
        }
        for flight, own in naming.days.items()
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
        "on_its_day": gap.on_its_day,
        "fit_mean": gap.fit_mean,
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
