"""What differs from day to day: each flight on its own, and how much days differ."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from search_rigs.courses import LEGS
from search_rigs.hypotheses import problem_of

from twin.effects import EFFECTS
from twin.explain.inference.fit import Problem
from twin.explain.model.model import model_of
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly

COPTER = load_vehicle("copter_default")
BIASES = (-0.25, 0.02, 0.23)
"""Of the accelerometer's x axis in three flights, m/s²; its other constants stay."""
X, Z = "accel_bias.x_m_s2", "accel_bias.z_m_s2"


@cache
def problem() -> Problem:
    """Three flights, each with its bias, against bias and thrust."""
    plants = [
        COPTER.with_effects({"accel_bias": {"x_m_s2": bias, "y_m_s2": 0.0, "z_m_s2": 0.0}})
        for bias in BIASES
    ]
    flights = [fly(COPTER, p, seed, f"day_{seed}", LEGS) for seed, p in enumerate(plants)]
    effects = [EFFECTS[e] for e in ("accel_bias", "thrust_scale")]
    return problem_of(model_of(flights, COPTER, effects))


@pytest.mark.slow
def test_a_model_on_its_days_is_each_flight_with_its_numbers() -> None:
    model, shared = problem().model, {X: 0.1, "thrust_scale.scale": 0.9}
    days: tuple[dict[str, float], ...] = ({X: 0.2}, {}, {X: -0.1, Z: 0.3})
    alone: tuple[dict[str, float], ...] = ({X: 0.1 + 0.2}, {}, {X: 0.1 - 0.1, Z: 0.3})
    together = replace(model, days=days).channels([], shared)
    for flight, own, rows in zip(model.flights, alone, together, strict=True):
        for a, b in zip(flight.channels([], {**shared, **own}), rows, strict=True):
            np.testing.assert_array_equal(a.residual, b.residual)


@pytest.mark.slow
def test_days_of_a_start_are_learned_before_any_other_effect_is_there() -> None:
    usual = problem()
    b, known = usual.priors, usual.acquainted(("thrust_scale",))
    np.testing.assert_array_equal(known.priors.day, b.day)  # its numbers have no days
    learned = usual.acquainted(("accel_bias",)).priors
    place = b.names.index(X)
    assert learned.day[place] > 1.3 * b.day[place]
    assert learned.day[place] < np.std(BIASES) * 1.5


@pytest.mark.slow
def test_flights_teach_by_how_much_their_days_differ_number_by_number() -> None:
    usual = problem()
    state = usual.start((), 1.0)
    told = np.array([day.get(X, 0.0) for day in usual.days(state.best.x)])
    planted = np.array(BIASES)
    # A fifth of each is pulled back to what days usually bring.
    np.testing.assert_allclose(told - told.mean(), planted - planted.mean(), atol=0.05)
    accustomed = usual.accustomed(state)
    assert len(usual.kappas) > 1
    assert accustomed.kappas == (1.0,)  # learned once: not to be halved again by a common factor
    b, learned = usual.priors, accustomed.priors
    place = {n: i for i, n in enumerate(b.names)}
    assert learned.day[place[X]] > 1.3 * b.day[place[X]]
    assert learned.day[place[Z]] < 0.8 * b.day[place[Z]]
    aged = replace(usual, priors=replace(b, ages={place[Z]: np.array([place[Z]])}))
    assert aged.accustomed(state).priors.day[place[Z]] == b.day[place[Z]]  # no narrower
    untold = [i for i in range(len(b.names)) if i not in b.days]
    np.testing.assert_array_equal(learned.day[untold], b.day[untold])


@pytest.mark.slow
def test_means_that_disturbances_leave_stay_when_days_are_learned() -> None:
    usual = problem()
    state, bands = usual.start((), 1.0), usual.noise.bands
    wide = {(c, 0): 9.0 * v for c, v in enumerate(bands.days)}
    windy = replace(bands, floor={**bands.floor, **wide})
    calm, learned = (
        replace(usual, noise=replace(usual.noise, bands=b)).accustomed(state).noise.bands
        for b in (bands, windy)
    )
    for c, name in enumerate(usual.rest.channels):
        assert learned.floor[c, 0] > 2.0 * calm.floor[c, 0], name
    assert usual.constants_between_days(state, bands.days) == pytest.approx(
        {n: calm.floor[c, 0] ** 0.5 for c, n in enumerate(usual.rest.channels)}
    )
