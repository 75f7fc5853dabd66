"""Calibration: all numbers of one aircraft, fitted together to normal flights of it."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..effects.parameters import RARE
from ..errors import LogError
from ..logs import Flight
from ..representation import short_repr
from ..vehicle import Calibration, Vehicle
from .balance import trim_of
from .estimates import UNDETERMINED
from .inference.estimate import Estimate, fitted_estimates
from .inference.evidence import LaplaceEvidence
from .inference.fit import Fit, Problem, State, fit_of
from .inference.priors import Priors, effect_of, priors_of
from .inference.search import calibration_start, search
from .inference.selection import days_of, shares_of
from .model.model import candidates, model_of
from .model.numbers import Payloads, with_effects
from .settings import DEFAULT, InferenceSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibrated:
    """What flights tell of an aircraft's numbers.

    Attributes:
        vehicle: With the numbers, and with how well they are known together.
        fit: The numbers with their intervals.
        estimates: The same by "effect.number", shapes left out; `no_effect` is the neutral value.
        prior_share: Posterior over prior deviation of each number of `fit`: 1 where the flights
            say nothing.
        undetermined: Numbers, "effect.number", shapes left out, that these flights do not
            determine: they stay at the prior mean, those of effects that are not in `fit` as the
            vehicle has them.
        days: What stands out of the day of a flight: flight -> "effect.number" -> difference from
            what all flights share, and its standard deviation.
        problem: What was fitted.
        state: The numbers and the residuals there.
        shares: By effect, the largest share of the power of a force or moment channel that it
            takes, and the channel.
        refused: Effects that the flights would have and that a sound aircraft has not, and why.
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
    refused: Mapping[str, str]

    __repr__ = short_repr


def calibrate(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    progress: Callable[[float], None] = lambda _: None,
    payloads: Payloads | None = None,
    settings: InferenceSettings = DEFAULT.inference,
) -> Calibrated:
    """Fit an aircraft's numbers to normal flights of it.

    Args:
        flights: Nothing is wrong with the aircraft in them. Three or more also teach how much its
            days differ.
        vehicle: A draft: each number is believed as far as the word of its source goes.
        progress: Called with the share done.
        payloads: Known masses aboard.
        settings: Noise.

    Raises:
        LogError: A flight cannot be compared with this vehicle.
    """
    if not flights:
        raise LogError("calibrate: no flight to calibrate on.")
    model = model_of(
        flights, vehicle, candidates(flights), lambda done: progress(0.1 * done), payloads
    )
    problem = Problem.of(model, priors_of(model, trusted=False), settings.evidence)
    found = search(
        problem,
        calibration_start(problem.priors),
        progress=lambda done: progress(0.1 + 0.45 * done),
    )
    refused = _refused(problem, found.state, settings)
    if refused:
        problem = _without(problem, refused)
        found = search(
            problem,
            calibration_start(problem.priors),
            progress=lambda done: progress(0.55 + 0.4 * done),
        )
    estimate = found.laplace.at_linearisation(found.state.effects, found.state.kappa)
    state = replace(found.state, best=estimate)
    best, priors = state.best, problem.priors
    free = [int(i) for i in best.free if i < len(priors.now)]
    causes = sorted({priors.cause[i] for i in free})
    fit = fit_of(problem, causes, best.x, best.deviations(), 0.0)
    prior = np.where(
        np.isin(np.arange(len(priors.now)), priors.of(state.effects)), priors.slab, priors.spike
    )
    sd = best.deviations()
    share = {priors.names[i]: min(1.0, float(sd[i] / prior[i])) for i in free}
    shapes = {priors.names[i] for i in np.flatnonzero(priors.shape)}
    undetermined = [name for name, s in share.items() if s > UNDETERMINED and name not in shapes]
    undetermined += _undetermined_beyond(priors, found.laplace, state)
    reported = Calibration(
        tuple(f.name for f in flights),
        tuple(priors.names[i] for i in free),
        _shared_covariance(state, free),
        problem.between_days(state),
        problem.constants_between_days(state),
        _of_records(fit),
        *_trim(problem, state),
    )
    made = replace(with_effects(vehicle, fit.effects, fit.values), calibration=reported)
    days, shares = days_of(problem, best), shares_of(problem, state)
    estimates = _estimates(fit, priors, share, settings)
    return Calibrated(
        made, fit, estimates, share, tuple(undetermined), days, problem, state, shares, refused
    )


def _refused(problem: Problem, state: State, settings: InferenceSettings) -> dict[str, str]:
    """Effects that come with damage or a load, are rare on a sound aircraft, and would be larger
    than `explain` believes: nothing is wrong with the aircraft, that is what a calibration is told.
    """
    b, found = problem.priors, {}
    rare = [c for c in state.effects if b.odds[c] <= RARE]
    damage = [c for c in rare if EFFECTS[effect_of(c)].change is not None]
    values = problem.values(state.best.x)
    tension = b.tension({b.names[i]: values[b.names[i]] for i in b.of(damage) if not b.shape[i]})
    for name, away in tension.items():
        if away > settings.selection.tension:
            found[name.partition(".")[0]] = (
                f"{name} = {values[name]:.3g} would be {away:.1f} deviations from what such a "
                f"number is expected to be"
            )
    return found


def _without(problem: Problem, effects: Collection[str]) -> Problem:
    """The same search without some effects."""
    odds = {c: v for c, v in problem.priors.odds.items() if effect_of(c) not in effects}
    return replace(problem, priors=replace(problem.priors, odds=odds))


def _estimates(
    fit: Fit, priors: Priors, share: Mapping[str, float], settings: InferenceSettings
) -> dict[str, Estimate]:
    """Every number with its interval, which the number of effects that are fitted together widens
    as it does in `explain`."""
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
    """Numbers of effects that were left out, for all that these flights say of them."""
    found = []
    for cause in (c for c in priors.causes if c not in state.effects):
        sd = laplace.best((*state.effects, cause), state.kappa).deviations()
        own = [i for i in priors.of([cause]) if priors.cause[i] == cause and not priors.shape[i]]
        found += [priors.names[i] for i in own if sd[i] > UNDETERMINED * priors.slab[i]]
    return found


def _trim(problem: Problem, state: State) -> tuple[dict[str, float], dict[str, float]]:
    """`Calibration.means` and `.scatter`: the balance of each flight, its day apart."""
    x = state.best.x.copy()
    x[len(problem.priors.now) :] = 0.0
    trim = trim_of(problem.model, problem.values(x), slopes=False)
    return ({}, {}) if trim is None else trim.by_name()


def _of_records(fit: Fit) -> dict[str, float]:
    """Numbers that the vehicle itself cannot hold."""
    held = {f"{e}.{p.name}" for e in fit.effects for p in EFFECTS[e].of_logs}
    return {n: v for n, v in fit.values.items() if n in held}


def _shared_covariance(state: State, free: Sequence[int]) -> Array:
    """Covariance of some numbers that all flights share."""
    place = {int(i): k for k, i in enumerate(state.best.free)}
    at = [place[i] for i in free]
    return np.asarray(state.best.covariance[np.ix_(at, at)])
