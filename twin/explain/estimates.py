"""What is told of each effect, to programs and to people alike."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..effects import EFFECTS
from .explanation import Explanation
from .inference.fit import Fit
from .inference.selection import Naming
from .model.numbers import Number, numbers_of
from .stochastic.finding import StochasticEffect

MOST_RIVALS = 5
"""That are listed."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number of an effect.

    Attributes:
        number: What it is.
        value: In its unit.
        ci95: 95 % interval; None: it has none.
    """

    number: Number
    value: float
    ci95: tuple[float, float] | None


def listed_effects(found: Explanation) -> list[str]:
    """Effects that are told about, the most probable first."""
    naming = found.naming
    if naming is None or found.verdict not in ("named", "cannot_tell"):
        return []
    if naming.verdict == "cannot_tell":
        every = {e for f in naming.fitted for e in f.effects}
        effects = {e for e in every if naming.probability_of(e) >= naming.settings.least}
    else:
        effects = set(naming.best.effects)
    effects |= {u.effect for u in found.stochastic}
    return sorted(effects, key=lambda e: (-probability_of(found, e), e))


def undecided(found: Explanation) -> tuple[str, ...]:
    """Effects among the named ones that something else may stand for; none for other verdicts."""
    return () if found.naming is None or found.verdict != "named" else found.naming.undecided


def probability_of(found: Explanation, effect: str) -> float:
    """That an effect is missing, alone or with others."""
    beside = beside_mean(found, effect)
    if beside is not None:
        return beside.probability
    assert found.naming is not None
    return found.naming.probability_of(effect)


def beside_mean(found: Explanation, effect: str) -> StochasticEffect | None:
    """An effect that changes no mean; None where it changes one."""
    return next((u for u in found.stochastic if u.effect == effect), None)


def nothing_probability(naming: Naming) -> float:
    """That no effect is missing."""
    return float(
        sum(p for f, p in zip(naming.fitted, naming.probabilities, strict=True) if not f.effects)
    )


def best_with(naming: Naming, effect: str) -> Fit:
    """The most probable hypothesis that an effect is part of."""
    return next(f for f in naming.fitted if effect in f.effects)


def intervals(fitted: Fit) -> dict[str, tuple[float, float]]:
    """95 % intervals, "effect.number" -> low, high; shapes have none."""
    return {
        n.full: (fitted.values[n.full] - float(w), fitted.values[n.full] + float(w))
        for n, w in zip(fitted.numbers, fitted.half_widths, strict=True)
    }


def estimates_of(found: Explanation, effect: str) -> list[Estimate]:
    """The numbers of an effect that is listed."""
    beside = beside_mean(found, effect)
    own: Mapping[str, tuple[float, float]]
    if beside is None:
        assert found.naming is not None
        fitted = best_with(found.naming, effect)
        numbers, values, own = found.naming.problem.model.numbers, fitted.values, intervals(fitted)
    else:
        numbers = tuple(numbers_of([EFFECTS[effect]], found.vehicle))
        values, own = beside.values, beside.intervals
    return [
        Estimate(n, values[n.full], own.get(n.full))
        for n in numbers
        if n.effect == effect and n.full in values
    ]


def where_felt(found: Explanation, effect: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Channels and phases on which an effect acts most; none where that is not known."""
    beside = beside_mean(found, effect)
    if beside is not None:
        return beside.channels, ()
    acts = next((a for a in found.attributions if a.effect == effect), None)
    return ((), ()) if acts is None else (acts.channels, acts.phases)


def rivals(found: Explanation, effect: str) -> list[dict[str, Any]]:
    """Other explanations than an effect, the most probable first, and how far they fell behind.

    An effect that changes no mean has one, `nothing`, and only its probability is known.

    `behind`: log likelihood, out of sample, below the best hypothesis with the effect; `share`: of
    the power of a channel that it takes, at its best together with the effects `with`.
    """
    beside, naming = beside_mean(found, effect), found.naming
    if beside is not None:
        return [{"name": "nothing", "probability": 1 - beside.probability}]
    assert naming is not None
    fitted = best_with(naming, effect)
    others: dict[str, dict[str, Any]] = {}
    for f, p, share in zip(naming.fitted, naming.probabilities, naming.shares, strict=True):
        if effect in f.effects:
            continue
        for name in f.effects or ("nothing",):
            if name in fitted.effects:
                continue
            entry = others.setdefault(name, {"name": name, "probability": 0.0, "behind": math.inf})
            entry["probability"] += p
            if fitted.gain - f.gain < entry["behind"]:
                partners = [e for e in f.effects if e != name]
                entry |= {"behind": fitted.gain - f.gain, "share": share, "with": partners}
    ranked = sorted(others.values(), key=lambda r: (-r["probability"], r["behind"]))
    return ranked[:MOST_RIVALS]
