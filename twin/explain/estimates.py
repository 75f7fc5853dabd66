"""What a result reports of each effect, to programs and to people alike."""

import math
from dataclasses import dataclass
from typing import Any

from scipy.stats import norm

from ..effects import EFFECTS
from .explanation import Explanation
from .inference.fit import INTERVAL, Fit
from .inference.priors import Priors, effect_of, parameter_of
from .inference.selection import Naming
from .model.numbers import Number, numbers_of
from .stochastic.spectral import StochasticEffect

MOST_RIVALS = 5
"""That are listed."""
UNDETERMINED = 0.7
"""Posterior over prior deviation of a number from which on flights do not tell it."""
MOST_OF_PRIOR = 0.5
"""The same for a number that a headline gives: the flights say more of it than the prior."""
_CREDIBLE = 0.95  # probability that an interval holds its number


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number of an effect.

    Attributes:
        number: What it is.
        value: In its unit.
        no_effect: Its value where the effect is absent, or has not changed; None: a shape, which
            has none.
        ci95: 95 % interval; None: it has none.
        prior_share: Posterior over prior deviation: 1 where the flights say nothing; None: it has
            no prior.
        tension: Prior deviations between the value and what was expected; None: the same.
    """

    number: Number
    value: float
    no_effect: float | None
    ci95: tuple[float, float] | None
    prior_share: float | None = None
    tension: float | None = None

    @property
    def may_be_none(self) -> bool:
        """Whether the 95 % interval contains `no_effect`; of a shape, and without one, no."""
        if self.ci95 is None or self.no_effect is None:
            return False
        return self.ci95[0] <= self.no_effect <= self.ci95[1]

    @property
    def determined(self) -> bool:
        """Whether a headline may give it: the 95 % interval excludes `no_effect`, and the flights
        say more of it than the prior."""
        known = self.ci95 is not None and self.no_effect is not None and not self.may_be_none
        return known and (self.prior_share or 0.0) <= MOST_OF_PRIOR

    @property
    def change(self) -> float:
        """Difference from `no_effect`; of a shape from 0."""
        return self.value - (self.no_effect or 0.0)


def credible_interval(number: Number, value: float, half_width: float) -> tuple[float, float]:
    """95 % interval of a number whose posterior is normal in the search, inside its physical range.

    A factor (no effect: 1) is log-normal, with `value` as its median and the coefficient of
    variation of the search: what doubles is as far away as what halves. Any other quantity that
    cannot be negative has the normal posterior truncated at its physical minimum, and the interval
    is that of highest density: it contains the minimum exactly where no effect is credible.

    Args:
        number: Gives the physical range.
        value: Mode of the posterior, in the unit of the number.
        half_width: Of the 95 % interval of a normal posterior.

    Returns:
        Lower and upper end.
    """
    sd, about = half_width / INTERVAL, number.about
    if not sd > 0 or not math.isfinite(sd):
        return value - half_width, value + half_width
    if parameter_of(number)[0].bounds[0] < 0:
        return value - half_width, value + half_width
    if about.neutral and about.bounds[0] > 0 and value > 0:
        spread = math.exp(INTERVAL * math.sqrt(math.log1p((sd / value) ** 2)))
        return value / spread, value * spread
    least = min(about.bounds[0], value)
    inside = float(norm.cdf((value - least) / sd))
    half = sd * float(norm.ppf((1 + _CREDIBLE * inside) / 2))
    if value - half >= least:
        return value - half, value + half
    return least, value + sd * float(norm.ppf(1 - inside + _CREDIBLE * inside))


def fitted_estimates(
    fitted: Fit, priors: Priors, effect: str, wider: float = 1.0
) -> list[Estimate]:
    """The numbers of an effect in one fit.

    Args:
        fitted: Values and half widths.
        priors: Priors of the same search.
        effect: Identifier.
        wider: Factor on the half widths.
    """
    tension = priors.tension({n.full: fitted.values[n.full] for n in fitted.numbers})
    place = {n: i for i, n in enumerate(priors.names)}
    found = []
    for n, w in zip(fitted.numbers, fitted.half_widths, strict=True):
        if n.effect != effect:
            continue
        i, value = place[n.full], fitted.values[n.full]
        found.append(
            Estimate(
                n,
                value,
                None if n.shape else float(priors.now[i] + priors.held[i]),
                credible_interval(n, value, wider * float(w)),
                min(1.0, float(w) / INTERVAL / float(priors.slab[i])),
                tension[n.full],
            )
        )
    return found


def listed_effects(found: Explanation) -> list[str]:
    """Effects that are told about, the most probable first; of those that are as good as sure, the
    one without which the flights are least probable."""
    naming = found.naming
    if naming is None or found.verdict not in ("named", "cannot_tell"):
        return []
    effects = {*naming.named, *naming.undecided}
    if naming.verdict == "cannot_tell":
        every = {e for f in naming.fitted for e in f.effects}
        alike = {r.effect for r in naming.resemblances}
        effects |= {e for e in every - alike if probability_of(found, e) >= naming.settings.least}
    effects |= {u.effect for u in found.stochastic}
    added: dict[str, float] = {}
    for cause, nats in naming.posterior.without.items():
        added[effect_of(cause)] = max(nats, added.get(effect_of(cause), 0.0))
    return sorted(
        effects, key=lambda e: (-round(probability_of(found, e), 1), -added.get(e, 0.0), e)
    )


def calibrated_effects(found: Explanation) -> list[str]:
    """Effects whose numbers the file was unsure of, and that lack nothing beyond that."""
    if found.naming is None or found.shown is None:
        return []
    priors = found.naming.problem.priors
    unsure = {effect_of(c) for c, sd in zip(priors.cause, priors.spike, strict=True) if sd > 0}
    reported = {*listed_effects(found), *(r.effect for r in found.naming.resemblances)}
    return [e for e in found.shown.effects if e in unsure and e not in reported]


def undecided(found: Explanation) -> tuple[str, ...]:
    """Effects among the named ones that something else may stand for; none for other verdicts."""
    return () if found.naming is None or found.verdict != "named" else found.naming.undecided


def probability_of(found: Explanation, effect: str) -> float:
    """That an effect is missing, alone or with others."""
    stochastic = stochastic_effect(found, effect)
    if stochastic is not None:
        return stochastic.probability
    assert found.naming is not None
    return found.naming.probability_of(effect)


def stochastic_effect(found: Explanation, effect: str) -> StochasticEffect | None:
    """An effect that changes no mean; None where it changes one."""
    return next((u for u in found.stochastic if u.effect == effect), None)


def nothing_probability(found: Explanation) -> float | None:
    """That no effect is missing; since a calibration, that nothing has changed. None: not asked."""
    naming = found.naming
    if naming is None:
        return None
    none = sum(p for f, p in zip(naming.fitted, naming.probabilities, strict=True) if not f.effects)
    return float(none) * (1.0 if found.balance is None else found.balance.nothing)


def best_with(naming: Naming, effect: str) -> Fit:
    """The most probable hypothesis that an effect is part of."""
    return next(f for f in naming.fitted if effect in f.effects)


def reported_count(found: Explanation) -> int:
    """How many effects are told at once, those among them that something acts like."""
    resembled = () if found.naming is None else found.naming.resemblances
    return len(listed_effects(found)) + len(resembled)


def estimates_of(found: Explanation, effect: str) -> list[Estimate]:
    """The numbers of an effect that is listed, where it is there.

    The more effects are told, the more is open beside what the posterior holds, which
    `SelectionSettings.stochastic` counts.
    """
    stochastic = stochastic_effect(found, effect)
    if stochastic is not None:
        numbers = numbers_of([EFFECTS[effect]], found.vehicle)
        own = stochastic.intervals
        return [
            Estimate(
                n,
                stochastic.values[n.full],
                stochastic.before.get(n.full, n.about.neutral),
                own.get(n.full),
            )
            for n in numbers
            if n.full in stochastic.values
        ]
    naming = found.naming
    assert naming is not None
    wider = math.sqrt(1 + naming.settings.variance_per_effect * reported_count(found))
    return fitted_estimates(naming.conditional, naming.problem.priors, effect, wider)


def channels_and_phases(found: Explanation, effect: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Channels and phases on which an effect acts most; none where that is not known."""
    stochastic = stochastic_effect(found, effect)
    if stochastic is not None:
        return stochastic.channels, ()
    acts = next((a for a in found.attributions if a.effect == effect), None)
    return ((), ()) if acts is None else (acts.channels, acts.phases)


def rivals(found: Explanation, effect: str) -> list[dict[str, Any]]:
    """Other explanations than an effect, the most probable first, and how far they fell behind.

    Of those that are all but impossible, nothing at all comes last.

    An effect that changes no mean has one, `nothing`, and only its probability is known.

    `behind`: log probability below the best set with the effect, of the best set with the rival in
    its place, together with the effects `with`.
    """
    stochastic, naming = stochastic_effect(found, effect), found.naming
    if stochastic is not None:
        return [{"name": "nothing", "probability": 1 - stochastic.probability}]
    assert naming is not None
    fitted = best_with(naming, effect)
    others: dict[str, dict[str, Any]] = {}
    for f, p in zip(naming.fitted, naming.probabilities, strict=True):
        if effect in f.effects:
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
