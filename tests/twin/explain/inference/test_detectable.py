"""How large an effect has to be to be named: mathematics, draws, and the evidence of flights."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm
from search_rigs.hypotheses import against, nothing_of

from twin.explain.inference.detection import POWER_95, critical_size, smallest_detectable
from twin.explain.inference.fit import COVERED
from twin.vehicle_file import load_vehicle, parse_vehicle, vehicle_text
from uavtwin.demo.flights import Waypoints, fly

COPTER = load_vehicle("copter_default")
ROUND: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("tour", 2.0, (1.5, 0.0, -1.5)),
    ("tour", 2.0, (0.0, 0.0, -1.5)),
)
SURE = 0.8


def log_bayes(x: float, noise_var: float, none_var: float, mean: float, there_var: float) -> float:
    """Of an estimate, by the densities themselves."""
    there = norm.logpdf(x, mean, math.sqrt(noise_var + there_var))
    return float(there - norm.logpdf(x, 0.0, math.sqrt(noise_var + none_var)))


@given(
    st.floats(1e-3, 1.0),
    st.floats(0.0, 0.5),
    st.floats(-1.0, 1.0),
    st.floats(1.1, 10.0),
    st.floats(-2.0, 20.0),
)
def test_the_critical_size_is_where_the_bayes_factor_reaches_the_threshold(
    noise: float, none: float, mean: float, there: float, needed: float
) -> None:
    variances = noise**2, none**2, mean, (none**2 + there**2)
    size = critical_size(*variances, needed)
    if size == 0:
        assert log_bayes(0.0, *variances) >= needed - 1e-9
    else:
        assert log_bayes(size, *variances) == pytest.approx(needed, rel=1e-6, abs=1e-6)
        assert log_bayes(1.01 * size, *variances) > needed


@pytest.mark.slow
def test_95_of_100_draws_of_a_detectable_effect_are_named() -> None:
    rng, noise, there, needed = np.random.default_rng(0), 0.02, 0.3, 4.0
    size = critical_size(noise**2, 0.0, 0.0, there**2, needed) + POWER_95 * noise
    drawn = size + noise * rng.standard_normal(20000)
    named = [log_bayes(x, noise**2, 0.0, 0.0, there**2) >= needed for x in drawn]
    assert np.mean(named) == pytest.approx(0.95, abs=0.01)


@pytest.mark.slow
def test_the_evidence_of_flights_agrees() -> None:
    """Half as much again as is detectable is named by the full evidence, a fifth of it is not."""
    names = ("mass_offset", "rotor_efficiency_loss", "cog_offset")
    quiet = against(fly(COPTER, COPTER, seed=4, waypoints=ROUND), COPTER, *names)
    nothing = nothing_of(quiet)
    laplace = quiet.linearised(nothing)
    found = smallest_detectable(quiet.model, laplace, nothing, (), SURE)
    assert {*found} == {*names}
    assert found["mass_offset"].unit == "kg"
    size = found["mass_offset"].value
    assert size is not None and size < 0.2 * COPTER.mass_kg
    loss = found["rotor_efficiency_loss"]
    assert loss.number.startswith("rotor_efficiency_loss.loss_")
    assert loss.value is not None and loss.value < 0.3
    for factor, named in ((1.5, True), (0.2, False)):
        plant = COPTER.with_effects({"mass_offset": {"mass_kg": factor * size}})
        problem = against(fly(COPTER, plant, seed=5, waypoints=ROUND), COPTER, *names)
        around = problem.linearised(nothing_of(problem))
        gain = around.best(("mass_offset",), 1.0).evidence - around.best((), 1.0).evidence
        assert (gain > math.log(SURE / (1 - SURE))) == named, factor


def test_what_the_file_covers_shows_no_sooner_than_the_file_allows() -> None:
    """A mass within the deviation of the file: in the final set, and without a name."""
    text, name = vehicle_text("copter_default")
    mass = 'mass = { value = 1.4, unit = "kg", '
    assert mass in text
    unsure = parse_vehicle(text.replace(mass, f'{mass}sd = "5 %", '), name)
    plant = COPTER.with_effects({"mass_offset": {"mass_kg": 0.1}})
    flight = fly(COPTER, plant, seed=4, waypoints=ROUND)
    problem = against(flight, unsure, "mass_offset", "cog_offset")
    state = problem.start(("mass_offset",), 1.0)
    laplace = problem.linearised(state)
    said = smallest_detectable(problem.model, laplace, state, (), SURE)["mass_offset"].value
    assert said is not None and said > COVERED * 0.05 * COPTER.mass_kg
    assert {*smallest_detectable(problem.model, laplace, state, ("mass_offset",), SURE)} == {
        "cog_offset"
    }
