"""What the tests of the inference share: a flight against some effects, and sets fitted to it."""

from collections.abc import Sequence

from twin.effects import EFFECTS
from twin.explain.inference.fit import Fit, Problem, State, fit_of
from twin.explain.inference.priors import effect_of, priors_of
from twin.explain.model.model import Model, candidates, model_of
from twin.logs import Flight
from twin.vehicle import Vehicle


def problem_of(model: Model) -> Problem:
    """What hypotheses about flights are fitted against."""
    return Problem.of(model, priors_of(model))


def against(flight: Flight, vehicle: Vehicle, *effects: str) -> Problem:
    """A flight against a vehicle with some effects; none: all that it can show."""
    known = [EFFECTS[e] for e in effects] or candidates([flight])
    return problem_of(model_of([flight], vehicle, known))


def nothing_of(problem: Problem) -> State:
    """No effect at all, at its best: where every set begins, and what its gain is over."""
    return problem.start((), 1.0)


def state_of(problem: Problem, effects: Sequence[str], nothing: State | None = None) -> State:
    """A set of effects at its best, from the model as it stands or from what is expected.

    Args:
        problem: Flights.
        effects: Identifiers.
        nothing: `nothing_of`, where several sets of a problem are asked for.
    """
    causes = [c for c in problem.priors.causes if effect_of(c) in effects]
    nothing = nothing or nothing_of(problem)
    starts = (
        problem.start(causes, 1.0),
        problem.settle(causes, 1.0, problem.rest, nothing.best.x),
    )
    return max(starts, key=lambda s: s.evidence)


def fit_set(problem: Problem, effects: Sequence[str], nothing: State | None = None) -> Fit:
    """The same with its numbers, and what it gains over nothing."""
    nothing = nothing or nothing_of(problem)
    state = state_of(problem, effects, nothing)
    gain = state.evidence - nothing.evidence
    return fit_of(problem, state.effects, state.best.x, state.best.deviations(), gain)
