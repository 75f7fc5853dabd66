"""The numbers of one aircraft, told by normal flights of it: all of them, together."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..errors import LogError
from ..logs import Flight
from ..representation import short_repr
from ..vehicle import Calibration, Vehicle
from .estimates import UNTOLD
from .inference.beliefs import Beliefs, beliefs_of
from .inference.evidence import Judge
from .inference.fit import Fit, fit_of
from .inference.refit import Problem, State
from .inference.search import calibration_start, search
from .inference.selection import days_of
from .model.model import candidates, model_of
from .model.numbers import with_effects
from .model.payload import Payloads
from .settings import DEFAULT, InferenceSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibrated:
    """What flights tell of an aircraft's numbers.

    Attributes:
        vehicle: With the numbers, and with how well they are known together.
        fit: The numbers with their intervals.
        prior_share: Posterior over prior deviation of each number of `fit`: 1 where the flights
            say nothing.
        untold: Numbers, "effect.number", shapes left out, that these flights do not tell: they
            stand as expected, those of effects that are not in `fit` as the vehicle has them.
        days: What stands out of the day of a flight: flight -> "effect.number" -> difference from
            what all flights share, and its standard deviation.
        problem: What was fitted.
        state: The numbers and the residuals there.
    """

    vehicle: Vehicle
    fit: Fit
    prior_share: Mapping[str, float]
    untold: tuple[str, ...]
    days: Mapping[str, Mapping[str, tuple[float, float]]]
    problem: Problem
    state: State

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
    problem = Problem.of(model, beliefs_of(model, trusted=False), settings.evidence, gated=True)
    start = calibration_start(problem.beliefs)
    found = search(problem, start, progress=lambda done: progress(0.1 + 0.85 * done))
    state = replace(found.state, best=found.judge.here_as(found.state.effects, found.state.kappa))
    best, beliefs = state.best, problem.beliefs
    free = [int(i) for i in best.free if i < len(beliefs.now)]
    causes = sorted({beliefs.cause[i] for i in free})
    fit = fit_of(problem, causes, best.x, best.deviations(), 0.0)
    prior = np.where(
        np.isin(np.arange(len(beliefs.now)), beliefs.of(state.effects)), beliefs.slab, beliefs.spike
    )
    sd = best.deviations()
    share = {beliefs.names[i]: min(1.0, float(sd[i] / prior[i])) for i in free}
    shapes = {beliefs.names[i] for i in np.flatnonzero(beliefs.shape)}
    untold = [name for name, s in share.items() if s > UNTOLD and name not in shapes]
    untold += _untold_beyond(beliefs, found.judge, state)
    told = Calibration(
        tuple(f.name for f in flights),
        tuple(beliefs.names[i] for i in free),
        _shared_covariance(state, free),
        problem.between_days(state),
        problem.constants_between_days(state),
        _of_records(fit),
    )
    made = replace(with_effects(vehicle, fit.effects, fit.values), calibration=told)
    return Calibrated(made, fit, share, tuple(untold), days_of(problem, best), problem, state)


def _untold_beyond(beliefs: Beliefs, judge: Judge, state: State) -> list[str]:
    """Numbers of effects that were left out, for all that these flights say of them."""
    found = []
    for cause in (c for c in beliefs.causes if c not in state.effects):
        sd = judge.best((*state.effects, cause), state.kappa).deviations()
        own = [i for i in beliefs.of([cause]) if beliefs.cause[i] == cause and not beliefs.shape[i]]
        found += [beliefs.names[i] for i in own if sd[i] > UNTOLD * beliefs.slab[i]]
    return found


def _of_records(fit: Fit) -> dict[str, float]:
    """Numbers that the vehicle itself cannot hold."""
    held = {f"{e}.{p.name}" for e in fit.effects for p in EFFECTS[e].of_logs}
    return {n: v for n, v in fit.values.items() if n in held}


def _shared_covariance(state: State, free: Sequence[int]) -> Array:
    """Covariance of some numbers that all flights share."""
    place = {int(i): k for k, i in enumerate(state.best.free)}
    at = [place[i] for i in free]
    return np.asarray(state.best.covariance[np.ix_(at, at)])
