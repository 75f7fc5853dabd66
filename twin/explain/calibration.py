"""Calibration: all numbers of one aircraft, fitted jointly to normal flights of it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from ..effects import EFFECTS, prior_of
from ..effects.parameters import RARE
from ..errors import LogError
from ..logs import Flight
from ..representation import ShortRepr
from ..residuals.channels import Array
from ..vehicle import Calibration, Vehicle
from .balance import trim_of
from .estimates import UNDETERMINED
from .inference.adequacy import coherent
from .inference.estimate import Estimate, fitted_estimates
from .inference.evidence import LaplaceEvidence
from .inference.fit import Fit, Problem, State, fit_of
from .inference.posterior import SearchResult
from .inference.priors import Priors, effect_of, priors_of
from .inference.search import CLEAR, calibration_start, search, with_instruments_of_end
from .inference.selection import days_of, shares_of
from .model.model import candidates, model_of
from .model.numbers import Payloads, with_effects
from .settings import DEFAULT, InferenceSettings


@dataclass(frozen=True, slots=True)
class Calibrated(ShortRepr):
    """Result of a calibration.

    Attributes:
        vehicle: Vehicle with the calibrated numbers and their joint covariance.
        fit: The numbers with their intervals.
        estimates: Estimates by "effect.number", without shape parameters; `no_effect` is the
            neutral value.
        prior_share: Posterior over prior standard deviation of each number of `fit`: 1 where the
            flights contain no information.
        undetermined: Numbers, "effect.number", without shape parameters, that these flights do not
            determine. Those of the vehicle file keep its value unless that is clearly worse, others
            the prior mean; those of effects that are not in `fit` keep the vehicle's value.
        days: Significant day-to-day deviations: flight -> "effect.number" -> difference from the
            shared value, and its standard deviation.
        problem: Estimation problem.
        state: MAP estimate with the residuals there.
        shares: By effect, its largest share of the power of a force or moment channel, and the
            channel.
    """

    vehicle: Vehicle
    fit: Fit
    estimates: Mapping[str, Estimate]
    prior_share: Mapping[str, float]
    undetermined: tuple[str, ...]
    days: Mapping[str, Mapping[str, tuple[float, float]]]
    problem: Problem
    state: State
    shares: Mapping[str, tuple[float, str]]


def calibrate(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    progress: Callable[[float], None] = lambda _: None,
    payloads: Payloads | None = None,
    settings: InferenceSettings = DEFAULT.inference,
) -> Calibrated:
    """Fit an aircraft's numbers to normal flights of it.

    Args:
        flights: Flights of an undamaged aircraft. Three or more also give its day-to-day variation.
        vehicle: Draft vehicle: the prior of each number depends on the reliability of its source.
        payloads: Known payload masses.

    Raises:
        LogError: A flight cannot be compared with this vehicle.
    """
    if not flights:
        raise LogError("calibrate: no flight to calibrate on.")
    model = model_of(
        flights, vehicle, candidates(flights), lambda done: progress(0.1 * done), payloads
    )
    problem = Problem.of(model, _of_sound(priors_of(model, trusted=False)), settings.evidence)
    found = search(
        problem, calibration_start(problem.priors), progress=lambda done: progress(0.1 + 0.6 * done)
    )
    problem, found = with_instruments_of_end(
        problem, found, lambda done: progress(0.7 + 0.2 * done)
    )
    state, sd, unclear = _profiled(problem, found)
    best, priors = state.best, problem.priors
    free = [int(i) for i in best.free if i < len(priors.now)]
    causes = sorted({priors.cause[i] for i in free})
    fit = fit_of(problem, causes, best.x, sd, 0.0)
    prior = _spread(priors, state.effects)
    share = {priors.names[i]: min(1.0, float(sd[i] / prior[i])) for i in free}
    shapes = {priors.names[i] for i in np.flatnonzero(priors.shape)}
    undetermined = [
        name
        for name, s in share.items()
        if (s > UNDETERMINED or name in unclear) and name not in shapes
    ]
    undetermined += _undetermined_beyond(priors, found.laplace, state)
    every = zip(*problem.channels(state.best.x), strict=True)  # each flight with its day
    of_records = {f"{e}.{p.name}" for e in fit.effects for p in EFFECTS[e].of_logs}
    reported = Calibration(
        tuple(f.name for f in flights),
        tuple(priors.names[i] for i in free),
        _shared_covariance(state, free, sd),
        problem.between_days(state),
        problem.constants_between_days(state, problem.noise.bands.days),
        {n: v for n, v in fit.values.items() if n in of_records},
        *_trim(problem, state),
        {o[0].name: math.sqrt(coherent(o, settings.adequacy)[0]) for o in every},
    )
    made = replace(with_effects(vehicle, fit.effects, fit.values), calibration=reported)
    days, shares = days_of(problem, best), shares_of(problem, state)
    estimates = _estimates(fit, priors, share, settings)
    return Calibrated(
        made, fit, estimates, share, tuple(undetermined), days, problem, state, shares
    )


def _of_sound(priors: Priors) -> Priors:
    """Priors without effects of damage or load, which are rare: a calibration assumes an undamaged
    aircraft. Each rotor keeps its own factor.
    """
    damage = {e.name for e in EFFECTS.values() if e.change is not None}
    odds = {c: v for c, v in priors.odds.items() if v > RARE or effect_of(c) not in damage}
    return replace(priors, odds=odds)


# -- what is handed on --------------------------------------------------------------------------

CLEARLY = 0.5 * float(chi2.isf(0.05, 1))
"""Log likelihood, nats, by which the file's value must be worse, with all others refitted, to be
replaced: the likelihood ratio test at 95 % (Wilks, Ann. Math. Stat. 9, 1938)."""
AT_FILE = 1e-9
"""Interval to which a number is constrained at the file's value, prior standard deviations."""


def _profiled(problem: Problem, found: SearchResult) -> tuple[State, Array, frozenset[str]]:
    """Result of a search with numbers at the file's value where that is not clearly worse.

    A factor far from its file value may look certain by its local curvature, and yet be no better
    than the file's value once all others are refitted. Numbers are constrained one after the other,
    the least certain first: of thrust and mass, of which only the ratio is observable, the file's
    mass is kept. Where the file's value is not excluded, the profile is as wide as a parabola
    through both points. A number at the edge of its range has the width of its prior.

    Returns:
        The state, the profile standard deviation of each entry of `MapEstimate.x`, and the
        undetermined numbers.
    """
    end = found.laplace.at_linearisation(found.state.effects, found.state.kappa)
    state = replace(found.state, best=end)
    b, sd = problem.priors, end.deviations()
    prior, moved = _spread(b, state.effects), state.best.x[: len(b.now)]
    inside = ~(np.isclose(b.now + moved, b.low) | np.isclose(b.now + moved, b.high))
    given = [
        int(i)
        for i in state.best.free
        if i < len(b.now) and _of_file(b, i) and sd[i] <= UNDETERMINED * prior[i]
    ]
    pinned, width, unclear = problem, sd.copy(), set()
    for i in sorted(given, key=lambda i: abs(moved[i]) / sd[i]):
        alone = _at_file(pinned, i)
        start = state.best.x.copy()
        start[i] = 0.0
        there = alone.settle(state.effects, state.kappa, found.laplace.spectrum, start)
        away = abs(float(state.best.x[i]))
        worse = _density(pinned, state) - _density(alone, there)
        if sd[i] < away and worse < CLEAR:
            chord = away / math.sqrt(2 * max(worse, AT_FILE))
            width[i] = np.clip(chord, sd[i], max(prior[i], sd[i]))
        if worse < CLEARLY:
            pinned, state = alone, there
            unclear.add(b.names[i])
    edge = [i for i in range(len(b.now)) if sd[i] > 0 and not inside[i] and not b.shape[i]]
    width[edge] = np.maximum(width[edge], prior[edge])
    return state, width, frozenset(unclear | {b.names[i] for i in edge})


def _of_file(priors: Priors, i: int) -> bool:
    """Whether a number corrects a value of the vehicle file; each rotor has a factor in any
    case."""
    corrects = prior_of(EFFECTS[effect_of(priors.cause[i])]).corrects is not None
    return corrects and not priors.shape[i] and ":" not in priors.cause[i]


def _at_file(problem: Problem, i: int) -> Problem:
    """The problem with one number constrained at the file's value."""
    b = problem.priors
    low, high = b.low.copy(), b.high.copy()
    low[i], high[i] = b.now[i] - AT_FILE * b.slab[i], b.now[i] + AT_FILE * b.slab[i]
    return replace(problem, priors=replace(b, low=low, high=high))


def _density(problem: Problem, state: State) -> float:
    """Log density of residuals and numbers of a state."""
    return problem.laplace(state.spectrum).at(state.effects, state.kappa)


def _spread(priors: Priors, effects: Sequence[str]) -> Array:
    """Prior standard deviation of each number given the present effects."""
    there = np.isin(np.arange(len(priors.now)), priors.of(effects))
    return np.asarray(np.where(there, priors.slab, priors.spike))


def _estimates(
    fit: Fit, priors: Priors, share: Mapping[str, float], settings: InferenceSettings
) -> dict[str, Estimate]:
    """Every number with its interval, widened with the number of fitted effects as in `explain`."""
    reported = {
        n.effect for n in fit.numbers if not n.shape and share.get(n.full, 1.0) <= UNDETERMINED
    }
    wider = math.sqrt(1 + settings.selection.variance_per_effect * len(reported))
    found = {}
    for effect in fit.effects:
        for t in fitted_estimates(fit, priors, effect, wider):
            if not t.number.shape:
                neutral, known = t.number.about.neutral, share.get(t.number.full, 1.0)
                found[t.number.full] = replace(t, no_effect=neutral, prior_share=known)
    return found


def _undetermined_beyond(priors: Priors, laplace: LaplaceEvidence, state: State) -> list[str]:
    """Undetermined numbers of the effects that were left out."""
    found = []
    for cause in (c for c in priors.causes if c not in state.effects):
        sd = laplace.best((*state.effects, cause), state.kappa).deviations()
        own = [i for i in priors.of([cause]) if priors.cause[i] == cause and not priors.shape[i]]
        found += [priors.names[i] for i in own if sd[i] > UNDETERMINED * priors.slab[i]]
    return found


def _trim(problem: Problem, state: State) -> tuple[dict[str, float], dict[str, float]]:
    """`Calibration.means` and `.scatter`: mean balance of the flights without day-to-day variation,
    and its scatter."""
    x = state.best.x.copy()
    x[len(problem.priors.now) :] = 0.0
    trim = trim_of(problem.model, problem.values(x), slopes=False)
    return ({}, {}) if trim is None else trim.by_name()


def _shared_covariance(state: State, free: Sequence[int], sd: Array) -> Array:
    """Covariance of numbers that all flights share, scaled to the widths of their profiles."""
    place = {int(i): k for k, i in enumerate(state.best.free)}
    at = [place[i] for i in free]
    covariance = state.best.covariance[np.ix_(at, at)]
    wider = np.maximum(sd[list(free)] / np.sqrt(np.diag(covariance)), 1.0)
    return np.asarray(covariance * np.outer(wider, wider))
