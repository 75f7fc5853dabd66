"""Decision on what a model lacks: some effects, none, or a tie that the flights cannot resolve.

| result for an effect | condition |
|---|---|
| named | certainly present, plausible numbers, an interval excludes its absence |
| undecided | possibly present, or replaced by another one |
| acts like it | a number is at its bound, or its law leaves a large residual |
| calibrated | within the uncertainty of the vehicle file |
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from ...effects import EFFECTS, FAMILIES, Family
from ...logs import Flight
from ...representation import ShortRepr
from ...vehicle import Vehicle
from ..model.model import Model, candidates, model_of
from ..model.numbers import Number, Payloads
from ..settings import DEFAULT, InferenceSettings, SelectionSettings
from .adequacy import UNKNOWN_POWER, credible, misfits, powers
from .detection import Detectable, smallest_detectable
from .estimate import Estimate, fitted_estimates
from .evidence import MapEstimate
from .fit import INTERVAL, Fit, Problem, State, fit_of, fit_of_best, substantial_effects
from .posterior import Posterior, SearchResult, log_posterior, weigh
from .priors import edges, effect_of, priors_of, priors_since
from .search import (
    NO_CHECKPOINT,
    Checkpoint,
    calibration_start,
    score_test_candidates,
    search,
    with_instruments_of_end,
)
from .spectrum import force_shares
from .valley import leaves_motion
from .whitening import WhitenedFlights

Verdict = Literal["named", "nothing", "unnamed", "cannot_tell", "unusable"]


@dataclass(frozen=True, slots=True)
class Resemblance:
    """An effect that the cause only resembles, and the reason why it is not the cause, a text after
    a colon."""

    effect: str
    why: str


@dataclass(frozen=True, slots=True)
class Total:
    """Sum over the effects of a family.

    Attributes:
        family: Family of the effects.
        effects: Effects that may be present, the more probable first.
        probability: Probability that at least one of them is present.
        value: Value in the unit of the family.
        sd: Standard deviation of the value.
        ci95: 95 % interval.
    """

    family: Family
    effects: tuple[str, ...]
    probability: float
    value: float
    sd: float
    ci95: tuple[float, float]


@dataclass(frozen=True)
class Naming(ShortRepr):
    """Result of the selection of effects.

    Attributes:
        fitted: Candidate models whose effects are large enough to be named, at their MAP estimates,
            the most probable first, `nothing` among them; without those about which the flights
            contain no information.
        probabilities: Posterior probability of each.
        inclusion: Probability that each effect of the search is present and large enough to be
            named.
        shown: Model average: every effect that may be present, with its mean numbers over all
            candidate models; it predicts best. Uncertain numbers of the file are included.
        conditional: The same effects, with their mean numbers given that they are present.
        credible: Probability that the cause of each effect is inside the library.
        resemblances: Effects that the cause only resembles.
        posterior: Posterior over all candidate models.
        problem: Estimation problem.
        whitened: Flights with their day-to-day deviations, whitened by a noise model of the
            residuals of `shown`.
        kappa: Factor on the standard deviation of day-to-day variation of these flights.
        days: Significant day-to-day deviations: flight -> "effect.number" -> difference from the
            shared value, and its standard deviation.
        shares: By effect, its largest share of the power of a force or moment channel, and the
            channel.
        detectable: Smallest visible change of each effect that is not named in the most probable
            model.
        settings: Thresholds from which on an effect is named.
        further: Number of zero-mean effects reported as well: they widen the intervals.
        unexplained: Channels with a larger residual under the final model than that between sensor
            and pose.
    """

    fitted: tuple[Fit, ...]
    probabilities: tuple[float, ...]
    inclusion: Mapping[str, float]
    shown: Fit
    conditional: Fit
    credible: Mapping[str, float]
    resemblances: tuple[Resemblance, ...]
    posterior: Posterior
    problem: Problem
    whitened: WhitenedFlights
    kappa: float
    days: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)
    shares: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    detectable: Mapping[str, Detectable] = field(default_factory=dict)
    settings: SelectionSettings = DEFAULT.inference.selection
    further: int = 0
    unexplained: tuple[str, ...] = ()

    @property
    def best(self) -> Fit:
        """The most probable candidate model."""
        return self.fitted[0]

    @property
    def nothing(self) -> Fit:
        """The candidate model without any effect."""
        return next(f for f in self.fitted if not f.effects)

    @property
    def likely(self) -> tuple[Fit, ...]:
        """Plausible candidate models, the most probable first."""
        pairs = zip(self.fitted, self.probabilities, strict=True)
        return tuple(f for f, p in pairs if p >= self.settings.least)

    def probability_of(self, effect: str) -> float:
        """Probability that an effect is missing, alone or with others; for the representative of a
        family, that at least one of the family is."""
        total = self.standing.get(effect)
        return self.joint_probability([effect]) if total is None else total.probability

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that are certain, and representatives of certain families."""
        of_families = {e for t in self.standing.values() for e in t.effects}
        alone = (e for e in self.best.effects if e not in of_families and self._is_sure(e))
        return (*alone, *self.standing)

    @property
    def undecided(self) -> tuple[str, ...]:
        """Effects of the most probable model that are not certain, but may be the cause."""
        placed = {r.effect for r in self.resemblances} | {*self.named}
        placed |= {e for t in self.standing.values() for e in t.effects}
        return tuple(e for e in self.best.effects if e not in placed)

    @cached_property
    def totals(self) -> tuple[Total, ...]:
        """Certain families: at least one of the effects is present with the probability required
        for a name, and the 95 % interval of their sum excludes the model's value."""
        alike, least, made = {r.effect for r in self.resemblances}, self.settings.least, []
        priors, half = self.problem.priors, self.wider(len(self.best.effects) + self.further)
        for family in FAMILIES:
            chance = {e: self.inclusion.get(e, 0.0) for e in family.effects}
            own = sorted((e for e in chance if chance[e] >= least), key=lambda e: -chance[e])
            row = np.array([family.weights.get(name, 0.0) for name in priors.names])
            there, change, sd = self.posterior.total(row, own)
            wide = half * INTERVAL * sd
            if alike & {*own} or there < self.settings.sure or not abs(change) > wide:
                continue
            believed = min(self.credible.get(e, 1.0) for e in own)
            value = float(row @ priors.now) + change
            ends = value - wide, value + wide
            made.append(Total(family, tuple(own), there * believed, value, sd, ends))
        return tuple(made)

    @property
    def standing(self) -> dict[str, Total]:
        """Certain families whose split between the effects is uncertain, whether one of them is
        certain or not, by their representative effect."""
        return {t.family.first: t for t in self.totals if len(t.effects) > 1}

    @cached_property
    def of_flights(self) -> dict[str, Fit]:
        """`conditional` with the values of each flight, for numbers that differ between flights by
        more than `APART`: their mean may be zero, or known poorly, where flights tell their own."""
        b, best, shared = self.problem.priors, self.posterior.sets[0].best, self.conditional
        usual, made = self.problem.usual, {}
        for f, flight in enumerate(self.problem.model.flights):
            values, widths = dict(shared.values), shared.half_widths.copy()
            for i, column in enumerate(b.days, len(b.now) + f * len(b.days)):
                name, row = b.names[column], np.zeros(len(best.x))
                if name in values and abs(best.x[i]) > APART * usual[column]:
                    row[[column, i]] = 1.0
                    values[name] = float(b.now[column] + row @ best.x)
                    k = [n.full for n in shared.numbers].index(name)
                    widths[k] = INTERVAL * math.sqrt(best.variance(row))
            made[flight.flight.name] = replace(shared, values=values, half_widths=widths)
        return made

    @property
    def verdict(self) -> Verdict:
        """Verdict: "named" where one effect is certain, even if others are not."""
        if self.named:
            return "named"
        if self.resemblances:
            return "unnamed"
        quiet = not self.best.effects and self.probabilities[0] >= self.settings.sure
        return "nothing" if quiet else "cannot_tell"

    def _is_sure(self, effect: str) -> bool:
        if any(r.effect == effect for r in self.resemblances) or self._may_be_none(effect):
            return False
        believed = self.credible.get(effect, 1.0)
        return self.joint_probability([effect]) >= self.settings.sure * believed

    def _may_be_none(self, effect: str) -> bool:
        """Whether every reported interval of its numbers contains no effect, in each flight."""
        reported = len(self.best.effects) + self.further

        def none(fit: Fit | None) -> bool:
            own = self.estimates(effect, reported, fit)
            own = [t for t in own if t.no_effect is not None]
            return bool(own) and all(t.may_be_none for t in own)

        return none(None) and all(map(none, self.of_flights.values()))

    def estimates(self, effect: str, reported: int, fitted: Fit | None = None) -> list[Estimate]:
        """Estimates of an effect given that it is present, or in a fit; intervals widen with the
        number of reported effects."""
        fitted = fitted or self.conditional
        return fitted_estimates(fitted, self.problem.priors, effect, self.wider(reported))

    def wider(self, reported: int) -> float:
        """Factor by which intervals widen with the number of reported effects."""
        return math.sqrt(1 + self.settings.variance_per_effect * reported)

    def joint_probability(self, effects: Collection[str]) -> float:
        """Probability that all of these effects are missing, and each cause is inside the
        library."""
        pairs = zip(self.fitted, self.probabilities, strict=True)
        among = float(sum(p for f, p in pairs if set(effects) <= set(f.effects)))
        return among * math.prod(self.credible.get(e, 1.0) for e in effects)

    @property
    def outside(self) -> float:
        """Probability that a cause is outside the library, though the most probable model names
        it."""
        return 1 - math.prod(self.credible.get(e, 1.0) for e in self.best.effects)

    def one_of(self, effect: str) -> tuple[str, ...]:
        """Alternative causes to one: effects, or "effect:rotor"."""
        own = [c for c in self.problem.priors.causes if effect_of(c) == effect]
        members = self.standing[effect].effects if effect in self.standing else ()
        others = (o for c in own for o in self.posterior.exchangeable(c))
        return tuple(dict.fromkeys(o for o in (*members, *others) if o != effect))


def name_effects(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
    payloads: Payloads | None = None,
    settings: InferenceSettings = DEFAULT.inference,
    since: bool = False,
    apart: Collection[str] = (),
    silent: Collection[str] = (),
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> Naming:
    """Find the most probable candidate models; arguments as of `explain`.

    Args:
        flights: Flights for the fit.
        vehicle: Nominal model.
        apart: See `since_problem`.
        silent: See `since_problem`.
        checkpoint: Stores the states of the searches.

    Raises:
        ModelError: The vehicle contains no calibration from which to search changes.
    """
    known = candidates(flights, since)
    model = model_of(flights, vehicle, known, lambda done: progress(0.1 * done), payloads)
    if since:
        problem = since_problem(model, settings, apart, silent)
    else:
        problem = Problem.of(model, priors_of(model), settings.evidence)
    days_shown, first = len(model.flights) >= DAYS_SHOWN, problem
    if days_shown and not since:
        first = problem.acquainted(calibration_start(problem.priors))
    found = climb(first, lambda done: progress(0.1 + 0.4 * done), not days_shown, checkpoint)
    if days_shown:
        problem = problem.with_instruments_at(found.state).accustomed(found.state)
        state = problem.settle(found.state.effects, 1.0, found.laplace.spectrum, found.state.best.x)
        found = search(
            problem, state, lambda done: progress(0.5 + 0.2 * done), checkpoint=checkpoint
        )
    else:
        problem, found = with_instruments_of_end(
            problem, found, lambda done: progress(0.5 + 0.2 * done), checkpoint
        )
    posterior = weigh(problem, found, seed, lambda done: progress(0.7 + 0.25 * done))
    calibration = vehicle.calibration if since else None
    usual = calibration.left if calibration is not None else {}
    return _named(problem, found, posterior, settings, usual)


def since_problem(
    model: Model,
    settings: InferenceSettings = DEFAULT.inference,
    apart: Collection[str] = (),
    silent: Collection[str] = (),
) -> Problem:
    """Estimation problem of changes on a calibrated aircraft.

    Args:
        model: New flights with the calibrated vehicle.
        settings: Settings of the noise.
        apart: Effects that are judged elsewhere.
        silent: Channels whose constants are judged elsewhere and are unrestricted here.
    """
    priors = priors_since(model)
    odds = {c: v for c, v in priors.odds.items() if effect_of(c) not in apart}
    priors = replace(priors, odds=odds)
    assert model.vehicle.calibration is not None
    constants = {**model.vehicle.calibration.constants, **dict.fromkeys(silent, UNKNOWN_CONSTANT)}
    return Problem.of(model, priors, settings.evidence, constants=constants)


def climb(
    problem: Problem,
    progress: Callable[[float], None] = lambda _: None,
    last: bool = True,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> SearchResult:
    """Result of the search from the most promising start; `last` and `checkpoint` as of `search`.

    A model that lacks little is searched from the empty set. One that lacks many effects is
    searched from those that are unmeasured on every aircraft: from the empty set, each effect would
    be judged while all others are absent.
    """
    every = calibration_start(problem.priors)
    if len(score_test_candidates(problem)) > MANY:
        return search(problem, every, progress, last, checkpoint)
    found = search(problem, (), progress, last, checkpoint)
    if len(found.state.effects) <= MANY:
        return found
    other = search(problem, every, progress, last, checkpoint)
    return max(found, other, key=lambda f: log_posterior(f.state))


LEFT = "it leaves much of what its law should take"
"""Reason why a cause only resembles an effect."""
UNKNOWN_CONSTANT = 1e6
"""Standard deviation of an unrestricted constant, in the unit of any channel."""
DAYS_SHOWN = 3
"""Number of flights from which on their day-to-day variation is reported."""
APART = 3.0
"""Between-flight standard deviations of a number by which flights differ far more than usual."""
MANY = 4
"""Number of effects that an approximately right model may lack."""


def _named(
    problem: Problem,
    found: SearchResult,
    posterior: Posterior,
    settings: InferenceSettings,
    usual: Mapping[str, float],
) -> Naming:
    laplace, kappa, rules = found.laplace, found.state.kappa, settings.selection
    none = laplace.best((), kappa)
    chances: dict[tuple[str, ...], float] = {(): 0.0}
    fits: dict[tuple[str, ...], Fit] = {(): fit_of_best(problem, (), none, none.evidence)}
    causes: dict[tuple[str, ...], list[str]] = {(): []}
    inclusion = dict.fromkeys(problem.model.effects, 0.0)
    silent = _silent(problem, posterior, rules)
    for s in posterior.sets:
        whole = fit_of_best(problem, s.effects, s.best, none.evidence)
        for e in substantial_effects(whole):
            inclusion[e] += s.probability
        heard = [c for c in s.effects if c not in silent]
        own = substantial_effects(fit_of(problem, heard, s.best.x, s.best.deviations(), 0.0))
        chances[own] = chances.get(own, 0.0) + s.probability
        if own not in fits:
            causes[own] = [c for c in heard if effect_of(c) in own]
            fits[own] = fit_of(problem, causes[own], s.best.x, s.best.deviations(), whole.gain)
    order = sorted(chances, key=lambda k: -chances[k])
    fitted, probabilities = tuple(fits[k] for k in order), tuple(chances[k] for k in order)
    shown, conditional = averaged(problem, posterior, causes[order[0]], rules)
    believable = _credible(problem, found, fitted[0], settings, usual)
    return Naming(
        fitted,
        probabilities,
        inclusion,
        shown,
        conditional,
        believable,
        tuple(_resemblances(problem, conditional, fitted[0], believable, rules)),
        posterior,
        problem,
        WhitenedFlights.of(shown.on_its_days(problem.model), shown.values, settings.likelihood),
        kappa,
        days_of(problem, found.state.best),
        shares_of(problem, found.state),
        smallest_detectable(problem.model, laplace, found.state, fitted[0].effects, rules.sure),
        rules,
        unexplained=tuple(n for n, more in leaves_motion(laplace.spectrum).items() if more),
    )


def _silent(problem: Problem, posterior: Posterior, rules: SelectionSettings) -> frozenset[str]:
    """Causes about which the flights contain no information: their posterior odds do not exceed the
    prior ones, which is no sign that they are present."""
    odds, moved = problem.priors.odds, math.log(rules.moved)
    unsure = {c: p for c, p in posterior.inclusion.items() if rules.least <= p < 0.5}
    return frozenset(c for c, p in unsure.items() if math.log(p / (1 - p)) < odds[c] + moved)


def averaged(
    problem: Problem, posterior: Posterior, named: Sequence[str], rules: SelectionSettings
) -> tuple[Fit, Fit]:
    """Effects that may be present, with their mean numbers over all candidate models, and over
    those that contain them: those named in the most probable model, and others that shift the mean
    of a number by the least size that is named, or would, at probability one half. Others stay as
    in the file: a lag of half a row of the log is no property of an aircraft."""
    b, k = problem.priors, len(problem.priors.now)
    p = np.array([s.probability for s in posterior.sets])
    x = np.array([s.best.x[:k] for s in posterior.sets])
    days = p @ np.array([s.best.x[k:] for s in posterior.sets])
    sd = np.array([s.best.deviations()[:k] for s in posterior.sets])
    there = np.zeros(x.shape, dtype=np.bool_)
    for row, s in zip(there, posterior.sets, strict=True):
        row[b.of(s.effects)] = True
    spiked = b.spike > 0
    weight = p[:, None] * (there | spiked)
    total = np.maximum(weight.sum(axis=0), 1e-300)
    held = (weight * x).sum(axis=0) / total
    spread = np.sqrt((weight * (sd**2 + (x - held) ** 2)).sum(axis=0) / total)
    mean = np.where(b.shape, held, p @ x)
    wide = np.where(b.shape, spread, np.sqrt(p @ (sd**2 + (x - mean) ** 2)))
    mean, alone = (np.concatenate([x, days]) for x in (mean, held))

    def moves(cause: str) -> bool:
        """Whether a cause is named, or changes the prediction."""
        chance = posterior.inclusion[cause]
        at = alone if chance >= 0.5 else mean
        large = fit_of(problem, [cause], at, spread, 0.0).sizes()[effect_of(cause)] >= 1
        of_log = chance >= 0.5 and not EFFECTS[effect_of(cause)].of_vehicle
        return cause in named or of_log or (chance >= rules.least and large)

    likely = {c for c in b.causes if moves(c)}
    retained = [c for c in dict.fromkeys(b.cause) if c in likely or np.any(spiked[b.of([c])])]
    there_alone = fit_of(problem, retained, alone, spread, 0.0)
    ridges = {n.full: _ridge(problem, posterior, n) for n in there_alone.numbers}
    return fit_of(problem, retained, mean, wide, 0.0), replace(there_alone, ridges=ridges)


def _ridge(problem: Problem, posterior: Posterior, number: Number) -> float:
    """Ratio of standard deviations, see `Fit.ridges`; in the most probable model with the number's
    cause."""
    b = problem.priors
    i = b.names.index(number.full)
    shapes = [int(j) for j in b.of([number.effect]) if b.shape[j]]
    own = (s.best for s in posterior.sets if b.cause[i] in s.effects)
    best = next(own, None)
    return 1.0 if b.shape[i] or best is None else best.ridge(i, shapes)


def _credible(
    problem: Problem,
    found: SearchResult,
    best: Fit,
    settings: InferenceSettings,
    usual: Mapping[str, float],
) -> dict[str, float]:
    """Credibility of each effect of the most probable model, by `adequacy.credible`.

    Not evaluated for a model that lacks many effects at once: the error of one law cannot be
    separated from those of the others. The prior probability remains.
    """
    if len(best.effects) > settings.adequacy.most:
        return dict.fromkeys(best.effects, 1 - settings.adequacy.outside)
    state = found.state

    def whole(on: Sequence[str]) -> Fit:
        """A candidate model with every number that it changes, including uncertain ones of the
        file."""
        made = found.laplace.best(on, state.kappa)
        return replace(fit_of_best(problem, on, made, 0.0), values=problem.values(made.x))

    without = {e: whole([a for a in state.effects if effect_of(a) != e]) for e in best.effects}
    left = misfits(problem.model, whole(state.effects), without, settings.adequacy, usual)
    asked = powers(problem, found.laplace, state, settings.adequacy)
    return {e: credible(m, asked.get(e, UNKNOWN_POWER), settings.adequacy) for e, m in left.items()}


def _resemblances(
    problem: Problem,
    conditional: Fit,
    best: Fit,
    believable: Mapping[str, float],
    rules: SelectionSettings,
) -> Sequence[Resemblance]:
    why = {e: LEFT for e in best.effects if believable.get(e, 1.0) < rules.credible}
    why |= dict(edges(conditional.numbers, conditional.values, problem.model.vehicle))
    return [Resemblance(e, why[e]) for e in best.effects if e in why]


def shares_of(problem: Problem, state: State) -> dict[str, tuple[float, str]]:
    """Shares of each effect by `force_shares`, at the end of a search."""
    b = problem.priors
    return force_shares(state.spectrum, [effect_of(c) for c in b.cause], state.best.x)


def days_of(problem: Problem, best: MapEstimate) -> dict[str, dict[str, tuple[float, float]]]:
    """Significant day-to-day deviations of each flight: flight -> "effect.number" -> value and
    standard deviation."""
    b, sd = problem.priors, best.deviations()
    found = {}
    for f, flight in enumerate(problem.model.flights):
        first = len(b.now) + f * len(b.days)
        own = {}
        for i, column in enumerate(b.days, first):
            smallest = problem.model.numbers[b.columns[column]].about.smallest
            if abs(best.x[i]) > max(2 * sd[i], smallest):
                own[b.names[column]] = float(best.x[i]), float(sd[i])
        found[flight.flight.name] = own
    return found
