"""Find, name, add, show: from flights and a model to what the model lacks, and the proof of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from ..effects import EFFECTS, RandomForce
from ..errors import LogError
from ..flight.stability import Mission, fly_missions
from ..logs import Flight
from ..representation import short_repr
from ..vehicle import Vehicle
from .attribution import Attribution, attribute_effect
from .design.designer import Suggestion, next_manoeuvre
from .holdout import Comparison, compare_holdout
from .inference.fit import Fit
from .inference.selection import Naming, Verdict, name_effects
from .localization import Place, localize
from .model.numbers import with_effects
from .model.payload import Payloads
from .settings import DEFAULT, SearchSettings, UsableSettings
from .split import Span, held_out_spans, hidden
from .stochastic.finding import StochasticEffect
from .stochastic.search import find_stochastic, find_stuck
from .stochastic.stuck import Stuck, stuck_channels, without_stuck
from .unnamed.equations import Equation, explains_better, find_equations
from .usable import reasons_unusable

DIGITS = 6
"""Significant ones that a fitted number is given with."""
WEAKER = (
    "no flight was held out: one block of time in {} of the same flights stands in for one, "
    "which is weaker, because what one flight has in common is in both parts"
)


@dataclass(frozen=True, slots=True)
class HeldOut:
    """A flight that took no part in the fit.

    Attributes:
        flight: Its name.
        spans: Parts of it that took no part; None: the whole flight.
    """

    flight: str
    spans: tuple[Span, ...] | None = None


@dataclass(frozen=True, slots=True)
class Explanation:
    """What flights say about a model.

    Attributes:
        verdict: In a word.
        vehicle: The model as it stood.
        flights: Names of those that it was fitted on.
        reasons: Why nothing can be learnt, for the verdict "unusable".
        warnings: What to keep in mind, the worst first.
        naming: Hypotheses and their probabilities; None where nothing could be fitted.
        shown: Hypothesis whose gap is shown: the named one; the first candidate where the verdict
            is "cannot_tell"; None: no effect that changes a mean.
        stochastic: Effects that change no mean, found beside it.
        values: Numbers of all these, "effect.number" -> value.
        comparison: Held-out flights before and after; None where nothing could be held out.
        attributions: Where each effect of `shown` acts.
        where: Places of disagreement.
        holdout: What took no part in the fit.
        missions: Closed-loop flights of the new model; none where no effect was added.
        unnamed: Equations for what no effect explains.
        next_manoeuvre: What to fly to learn more.
        settings: What decided all this.
    """

    verdict: Verdict
    vehicle: Vehicle
    flights: tuple[str, ...]
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    naming: Naming | None = None
    shown: Fit | None = None
    stochastic: tuple[StochasticEffect, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    comparison: Comparison | None = None
    attributions: tuple[Attribution, ...] = ()
    where: tuple[Place, ...] = ()
    holdout: tuple[HeldOut, ...] = ()
    missions: tuple[Mission, ...] = ()
    unnamed: tuple[Equation, ...] = ()
    next_manoeuvre: Suggestion | None = None
    settings: SearchSettings = DEFAULT

    __repr__ = short_repr

    @property
    def effects(self) -> tuple[str, ...]:
        """All effects that `values` are of."""
        steady = () if self.shown is None else self.shown.effects
        return (*steady, *(u.effect for u in self.stochastic))

    @property
    def added(self) -> Vehicle | None:
        """The model with the named effects; None where none is named."""
        if self.verdict != "named":
            return None
        return with_effects(self.vehicle, self.effects, self.values)


def explain(
    flights: Sequence[Flight],
    holdout: Sequence[Flight],
    vehicle: Vehicle,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
    missions: Sequence[str] | None = None,
    payloads: Payloads | None = None,
    settings: SearchSettings = DEFAULT,
) -> Explanation:
    """Say what a model lacks, and prove it.

    Args:
        flights: To fit on.
        holdout: To show the gap on; none: blocks of time of the flights are held out.
        vehicle: The model as it stands.
        seed: Of every bootstrap.
        progress: Called with the share done.
        missions: To fly with the new model; default: all.
        payloads: Known masses aboard, of flights of either kind.
        settings: The numbers that decide what is said.
    """
    names = tuple(f.name for f in flights)
    stuck = [s for f in (*flights, *holdout) for s in stuck_channels(f, settings.stochastic.stuck)]
    fit, reasons = _usable([without_stuck(f, stuck) for f in flights], vehicle, settings.usable)
    held, left_out = _usable([without_stuck(f, stuck) for f in holdout], vehicle, settings.usable)
    if not fit:
        return Explanation("unusable", vehicle, names, tuple(reasons), settings=settings)
    warnings = [f"left out: {reason}" for reason in reasons + left_out]
    away = tuple(HeldOut(f.name) for f in held)
    if not held:
        spans = [held_out_spans(f, settings.holdout) for f in fit]
        held = [hidden(f, s, inside=False) for f, s in zip(fit, spans, strict=True)]
        fit = [hidden(f, s, inside=True) for f, s in zip(fit, spans, strict=True)]
        away = tuple(HeldOut(f.name, tuple(s)) for f, s in zip(fit, spans, strict=True))
        warnings.append(WEAKER.format(settings.holdout.spared_every))
    found = Explanation(
        "unusable",
        vehicle,
        tuple(f.name for f in fit),
        warnings=tuple(warnings),
        holdout=away,
        settings=settings,
    )
    try:
        naming = name_effects(
            fit, vehicle, seed, lambda done: progress(0.5 * done), payloads, settings.inference
        )
    except LogError as error:
        return replace(found, reasons=(str(error),))
    found = _named(found, naming, [s for s in stuck if s.flight in names])
    found = replace(found, warnings=(*found.warnings, *_not_felt(naming)))
    progress(0.6)
    found = _with_equations(found, seed)
    progress(0.7)
    found = _with_gap(found, held, seed, payloads)
    progress(0.85)
    if found.verdict in ("named", "cannot_tell"):
        found = replace(
            found, next_manoeuvre=next_manoeuvre(naming, vehicle, seed, settings=settings.design)
        )
    if found.added is None:
        return found
    flown = fly_missions(found.added, missions, lambda done: progress(0.85 + 0.15 * done))
    return replace(found, missions=flown)


def _not_felt(naming: Naming) -> list[str]:
    """A line where effects have no place in what drives the model."""
    unfelt = naming.problem.model.unfelt
    if not unfelt:
        return []
    return [
        f"not visible where measured rotor speeds drive the model, which leave no command to look "
        f"at: {', '.join(unfelt)}"
    ]


def _usable(
    flights: Sequence[Flight], vehicle: Vehicle, settings: UsableSettings
) -> tuple[list[Flight], list[str]]:
    """Flights fit for the search, and why the others are not."""
    found = [(f, reasons_unusable(f, vehicle, settings)) for f in flights]
    return [f for f, against in found if not against], [r for _, against in found for r in against]


def _named(found: Explanation, naming: Naming, stuck: Sequence[Stuck]) -> Explanation:
    """The same with the effects that were found, and their numbers."""
    shown, settings = _shown(naming), found.settings.stochastic
    model, steady = naming.problem.model, {} if shown is None else shown.values
    every = (*find_stuck(stuck, settings), *find_stochastic(model, steady, settings))
    beside = tuple(u for u in every if u.log_odds > 0)
    verdict: Verdict = "named" if naming.verdict == "nothing" and beside else naming.verdict
    exact = dict(steady) | {k: v for u in beside for k, v in u.values.items()}
    values = {k: float(f"{v:.{DIGITS}g}") for k, v in exact.items()}
    bounds = () if shown is None else [text for _, text in shown.edges]
    return replace(
        found,
        verdict=verdict,
        naming=naming,
        shown=shown,
        stochastic=beside,
        values=values,
        warnings=(*bounds, *found.warnings),
    )


def _with_equations(found: Explanation, seed: int) -> Explanation:
    """The same with equations, where they say more than any effect of the library."""
    naming = found.naming
    assert naming is not None
    if any(isinstance(EFFECTS[u.effect].seen_as, RandomForce) for u in found.stochastic):
        return found  # a random force has no equation
    problem, settings = naming.problem, found.settings.unnamed
    alone = find_equations(problem, problem.nothing(), seed, settings)
    if alone is None or not explains_better(problem, naming.likely, alone, settings):
        return found
    return replace(
        found, verdict="unnamed", shown=None, stochastic=(), values={}, unnamed=alone.equations
    )


def _shown(naming: Naming) -> Fit | None:
    """The hypothesis whose gap is shown."""
    if naming.verdict == "named":
        return naming.best
    if naming.verdict == "cannot_tell":
        return next((f for f in naming.likely if f.effects), None)
    return None


def _with_gap(
    found: Explanation, held: Sequence[Flight], seed: int, payloads: Payloads | None
) -> Explanation:
    """The same with the gap of held-out flights, where effects act, and where the gap is."""
    effects = () if found.shown is None else found.shown.effects
    assert found.naming is not None
    settings = found.settings
    steady = {k: v for k, v in found.values.items() if k.partition(".")[0] in effects}
    try:
        comparison = compare_holdout(
            held,
            found.vehicle,
            effects,
            steady,
            seed,
            payloads,
            settings.holdout,
            settings.inference.likelihood,
        )
    except LogError as error:
        problem = f"no gap can be shown on what is held out: {error}"
        return replace(found, warnings=(*found.warnings, problem))
    acts = [
        attribute_effect(e, comparison.model, steady, comparison.after, settings.attribution)
        for e in effects
    ]
    where = localize(found.naming.problem.model, steady, comparison.floors, settings.localization)
    return replace(
        found,
        comparison=comparison,
        attributions=tuple(acts),
        where=tuple(where),
        warnings=(*comparison.warnings, *found.warnings),
    )
