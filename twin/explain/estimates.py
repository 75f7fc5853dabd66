"""Reported results of each effect, for programs and texts alike."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ..effects import EFFECTS
from .explanation import Explanation
from .inference.detection import Detectable
from .inference.estimate import Estimate
from .inference.priors import effect_of
from .inference.selection import Total
from .inference.setpoints import turns
from .model.numbers import numbers_of
from .stochastic.spectral import StochasticEffect

MOST_RIVALS = 5
"""Maximum number of alternatives listed."""
UNDETERMINED = 0.7
"""Posterior over prior standard deviation from which on a number is undetermined."""


def listed_effects(found: Explanation) -> list[str]:
    """Effects that are reported, the most probable first; among practically certain ones, that with
    the largest evidence first."""
    naming = found.naming
    if naming is None or found.verdict not in ("named", "cannot_tell"):
        return []
    effects = {*naming.named, *naming.undecided}
    if naming.verdict == found.verdict == "cannot_tell":
        every = {e for f in naming.fitted for e in f.effects}
        alike = {r.effect for r in naming.resemblances}
        effects |= {e for e in every - alike if probability_of(found, e) >= naming.settings.least}
    effects |= {u.effect for u in found.stochastic}
    added: dict[str, float] = {}
    for cause, nats in naming.posterior.without.items():
        added[effect_of(cause)] = max(nats, added.get(effect_of(cause), 0.0))
    for effect, total in naming.standing.items():
        added[effect] = max(added.get(e, 0.0) for e in total.effects)
    return sorted(
        effects, key=lambda e: (-round(probability_of(found, e), 1), -added.get(e, 0.0), e)
    )


def calibrated_effects(found: Explanation) -> list[str]:
    """Effects whose numbers were uncertain in the file, and that are within this uncertainty."""
    unsure = frozenset() if found.naming is None else found.naming.problem.priors.unsure
    return [e for e in _untold(found) if e in unsure]


def doubtful_effects(found: Explanation) -> list[str]:
    """Effects of the new model that were certain in the file, and too uncertain for a name."""
    added = {} if found.added is None else found.added.effects
    known = {*calibrated_effects(found)}
    return [e for e in _untold(found) if e in added and e not in known]


def _untold(found: Explanation) -> list[str]:
    """Effects of the new model that are not reported."""
    if found.naming is None or found.shown is None:
        return []
    reported = {*listed_effects(found), *(r.effect for r in found.naming.resemblances)}
    return [e for e in found.shown.effects if e not in reported]


def undecided(found: Explanation) -> tuple[str, ...]:
    """Named effects that have alternatives; empty for other verdicts."""
    if found.naming is None or found.verdict != "named":
        return ()
    return tuple(e for e in found.naming.undecided if stochastic_effect(found, e) is None)


def totals(found: Explanation) -> Sequence[Total]:
    """Certain families of effects; for a family with a single effect, the figure of that effect as
    reported: models of low probability assign others a part of the sum, which is known more
    accurately than that one."""
    if found.naming is None or found.verdict not in ("named", "cannot_tell"):
        return ()
    return [_of_one_effect(found, t) for t in found.naming.totals]


def _of_one_effect(found: Explanation, total: Total) -> Total:
    """A total with the interval of its effect, where it is of one effect with one number."""
    weights = total.family.weights
    own = [t for e in total.effects for t in estimates_of(found, e) if t.number.full in weights]
    if len(total.effects) > 1 or len(own) != 1 or own[0].ci95 is None:
        return total
    weight, (low, high) = weights[own[0].number.full], own[0].ci95
    return replace(total, value=weight * own[0].value, ci95=(weight * low, weight * high))


def detectable(found: Explanation) -> Mapping[str, Detectable]:
    """The smallest visible change of each effect that is not named; for the balance of forces and
    moments, by the balance."""
    shown = {} if found.naming is None else found.naming.detectable
    return {**shown, **({} if found.balance is None else found.balance.detectable)}


def unasked(found: Explanation) -> str:
    """Axes, of "xyz", about which no flight commands a rotation, or none contains it."""
    assert found.naming is not None
    problem = found.naming.problem
    names = [n for c, n in enumerate(problem.rest.channels) if c not in problem.noise.mute]
    return "".join(a for a in "xyz" if not any(turns(n) and n[-1] == a for n in names))


def probability_of(found: Explanation, effect: str) -> float:
    """Probability that an effect is missing, alone or with others."""
    stochastic = stochastic_effect(found, effect)
    if stochastic is not None:
        return stochastic.probability
    assert found.naming is not None
    return found.naming.probability_of(effect)


def stochastic_effect(found: Explanation, effect: str) -> StochasticEffect | None:
    """A zero-mean effect; None for an effect with a mean."""
    return next((u for u in found.stochastic if u.effect == effect), None)


def nothing_probability(found: Explanation) -> float | None:
    """Probability that no effect is missing; since a calibration, that nothing has changed. None:
    not evaluated."""
    naming = found.naming
    if naming is None:
        return None
    none = sum(p for f, p in zip(naming.fitted, naming.probabilities, strict=True) if not f.effects)
    return float(none) * (1.0 if found.balance is None else found.balance.nothing)


def reported_count(found: Explanation) -> int:
    """Number of effects reported at once, including those that the cause only resembles."""
    resembled = () if found.naming is None else found.naming.resemblances
    return len(listed_effects(found)) + len(resembled)


def estimates_of(found: Explanation, effect: str) -> list[Estimate]:
    """Estimates of a listed effect given that it is present; for the representative of a family,
    the figure of the family.

    Intervals widen with the number of reported effects, beyond the posterior: see
    `SelectionSettings.stochastic`.
    """
    own = estimates_alone(found, effect)
    if found.naming is None or effect not in found.naming.standing:
        return own
    total, priors = found.naming.standing[effect], found.naming.problem.priors
    slab = dict(zip(priors.names, priors.slab, strict=True))
    return [
        replace(t, value=total.value, ci95=total.ci95, prior_share=total.sd / slab[t.number.full])
        if t.number.full in total.family.weights
        else t
        for t in own
    ]


def estimates_alone(found: Explanation, effect: str) -> list[Estimate]:
    """The same for the effect alone, whatever its family."""
    stochastic = stochastic_effect(found, effect)
    if stochastic is not None:
        numbers = numbers_of([EFFECTS[effect]], found.vehicle)
        values, before, own = stochastic.values, stochastic.before, stochastic.intervals
        return [
            Estimate(n, values[n.full], before.get(n.full, n.about.neutral), own.get(n.full))
            for n in numbers
            if n.full in values
        ]
    assert found.naming is not None
    fitted = found.naming.shown if effect in _untold(found) else None
    return found.naming.estimates(effect, reported_count(found), fitted)


def channels_and_phases(found: Explanation, effect: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Channels and phases on which an effect acts most; empty where unknown."""
    stochastic = stochastic_effect(found, effect)
    if stochastic is not None:
        return stochastic.channels, ()
    acts = next((a for a in found.attributions if a.effect == effect), None)
    return ((), ()) if acts is None else (acts.channels, acts.phases)


def rivals(found: Explanation, effect: str) -> list[dict[str, Any]]:
    """Alternatives to an effect, the most probable first, and their differences in log posterior; a
    zero-mean effect has one alternative, `nothing`, of which only the probability is known.

    `behind`: difference in log posterior between the best model with the effect and the best one
    with the alternative in its place, together with the effects `with`.
    """
    stochastic, naming = stochastic_effect(found, effect), found.naming
    if stochastic is not None:
        return [{"name": "nothing", "probability": 1 - stochastic.probability}]
    assert naming is not None
    own = {effect, *(naming.standing[effect].effects if effect in naming.standing else ())}
    fitted = next(f for f in naming.fitted if own & {*f.effects})  # the most probable model with it
    others: dict[str, dict[str, Any]] = {}
    for f, p in zip(naming.fitted, naming.probabilities, strict=True):
        if own & {*f.effects}:
            continue
        for name in f.effects or ("nothing",):
            if name in fitted.effects:
                continue
            entry = others.setdefault(name, {"name": name, "probability": 0.0, "behind": math.inf})
            entry["probability"] += p
            if fitted.gain - f.gain < entry["behind"]:
                partners = [e for e in f.effects if e != name]
                entry |= {"behind": fitted.gain - f.gain, "with": partners}
    ranked = sorted(
        others.values(),
        key=lambda r: (-round(r["probability"], 6), r["name"] == "nothing", r["behind"]),
    )
    return ranked[:MOST_RIVALS]
