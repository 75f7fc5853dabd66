"""Every effect of the library, planted at its start value on a flight that has every column: it has
a slope, and explains itself better than any other does that is large enough for a name. On this
flight no two look alike.

Commands are recorded at 200 Hz and held: they come 2.5 ms late, which a small `flapping_moment`
takes up, since no delay is negative. It is a tenth of what is worth a name.

Clocks that are apart explain every delay of the aircraft: which of the two it is, priors alone say,
and no single flight.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from search_rigs.hypotheses import fit_set, nothing_of
from search_rigs.hypotheses import problem_of as problem_about

from benchmarks.planted import blank, flown, library, model_of_library, planted_numbers, shown
from twin.effects import EFFECTS, Shift
from twin.explain.inference.fit import Problem, substantial_effects
from twin.explain.inference.priors import effect_of
from twin.explain.inference.selection import days_of
from twin.explain.model.model import Model, candidates
from twin.explain.model.numbers import columns_of
from twin.logs import Flight
from uavtwin.report.drawing import Budget, degenerate
from uavtwin.report.evidence import steady_evidence

Array = NDArray[np.float64]
TRIED = 3
"""Rivals that are fitted: those that gain most by the first, linear look."""
DAILY = ("steady_wind", "cog_offset", "accel_bias", "heading_offset", "baro_bias")
"""Effects that differ from day to day, by the constant that they are: one flight alone says that
they are there on its day, and nothing of the aircraft."""
LEAST = 5.0
"""Nats by which an effect explains itself."""


def problem_of(flight: Flight) -> Problem:
    """All rotors may differ: an effect is planted with all of its numbers."""
    problem = problem_about(model_of_library(flight))
    return replace(problem, priors=replace(problem.priors, most={}))


def likely(problem: Problem) -> list[str]:
    """Single effects by what they gain where the model as it stands is linear, the best first."""
    laplace, gains = problem.laplace(problem.rest), {}
    for e in problem.model.effects:
        causes = [c for c in problem.priors.causes if effect_of(c) == e]
        gains[e] = laplace.best(causes, 1.0).evidence
    return sorted(gains, key=lambda e: -gains[e])


@pytest.mark.slow
def test_the_flight_shows_every_effect_that_changes_a_mean() -> None:
    _, _, _, names = library()
    assert {*names} == {e.name for e in candidates([blank()])}
    since = {e.name for e in candidates([blank()], since=True)}
    others = {type(e.observable_as).__name__ for e in EFFECTS.values() if e.name not in since}
    assert others == {"NoiseFloor", "Lines", "RandomForce", "Repeats"}  # see test_unsteady


def check_picture(effect: str, model: Model) -> None:
    """The figure of the explain page shows something: curves with an extent, no dot."""
    found = shown(effect, model)
    plots, how = steady_evidence(found.acts, found.with_it, model.flights, Budget(200))
    assert plots and effect.replace("_", " ") in how
    assert [fault for p in plots for fault in degenerate(p)] == []


def few_of(effects: list[str], every: int) -> list[Any]:
    """All, but one in so many marked as long."""
    return [
        pytest.param(e, marks=pytest.mark.long if i % every else ()) for i, e in enumerate(effects)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect", few_of([e.name for e in candidates([blank()]) if e.name not in DAILY], 20)
)
def test_an_effect_is_the_best_single_explanation_of_itself(effect: str) -> None:
    problem = problem_of(flown(effect))
    own = columns_of(problem.model.numbers, [effect])
    (rows,) = problem.model.channels(own)
    assert any(np.any(c.slopes) for c in rows), f"{effect}: slope 0"
    of_clocks = isinstance(EFFECTS[effect].observable_as, Shift) and EFFECTS[effect].of_vehicle
    rivals = [e for e in likely(problem) if EFFECTS[e].of_vehicle or not of_clocks]
    nothing = nothing_of(problem)
    fits = {e: fit_set(problem, [e], nothing) for e in {*rivals[:TRIED], effect}}
    named = [e for e, f in fits.items() if e in substantial_effects(f)]
    best = max(named, key=lambda e: fits[e].gain, default=None)
    check_picture(effect, problem.model)
    gains = {e: round(f.gain, 1) for e, f in sorted(fits.items(), key=lambda f: -f[1].gain)}
    assert fits[effect].gain > LEAST, f"{effect} explains nothing of itself: {gains}"
    assert best == effect, gains


@pytest.mark.slow
@pytest.mark.parametrize("effect", few_of([*DAILY], 2))
def test_a_constant_of_the_day_is_told_of_its_flight(effect: str) -> None:
    problem = problem_of(flown(effect))
    (told,) = days_of(problem, problem.start((), 1.0).best).values()
    numbers = planted_numbers(effect)
    known = {f"{effect}.{p.name}": p for p in EFFECTS[effect].parameters}
    planted = {n for n, p in known.items() if numbers[p.name] != p.neutral}
    assert planted & {*told}, told
    check_picture(effect, problem.model)
    for name in planted & {*told}:
        value, sd = told[name]
        assert value == pytest.approx(numbers[name.partition(".")[2]], abs=4 * sd), name
