"""Gauss-Newton on the exact residuals: numbers that were planted come back, several at once."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from search_rigs.courses import LEGS
from search_rigs.hypotheses import against, state_of

from twin.explain.inference import search
from twin.explain.inference.fit import Problem
from twin.logs import Flight
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly

COPTER = load_vehicle("copter_default")
PLANTED = {
    "thrust_scale.scale": 0.85,
    "rotor_drag.k_xy_1_s": 0.4,
    "cog_offset.x_m": 0.06 * COPTER.arm_m,
    "motor_lag.tau_s": 0.03,
    "imu_lever_arm.x_m": 0.2 * COPTER.arm_m,
}
EFFECTS_AT_ONCE = tuple(dict.fromkeys(name.partition(".")[0] for name in PLANTED))


@cache
def flown() -> Flight:
    changes: dict[str, dict[str, float]] = {}
    for name, value in PLANTED.items():
        effect, _, number = name.partition(".")
        changes.setdefault(effect, {})[number] = value
    return fly(COPTER, COPTER.with_effects(changes), 3, "five", LEGS)


@cache
def problem() -> Problem:
    return against(flown(), COPTER, *EFFECTS_AT_ONCE)


@pytest.mark.slow
def test_five_effects_at_once_come_back_with_their_numbers() -> None:
    state = state_of(problem(), EFFECTS_AT_ONCE)
    b = problem().priors
    sd = state.best.deviations()
    for name, value in PLANTED.items():
        i = b.names.index(name)
        found = b.now[i] + state.best.x[i]
        assert found == pytest.approx(value, rel=0.1, abs=3 * sd[i]), name
        assert sd[i] < 0.5 * b.slab[i], name
    nothing = problem().start((), 1.0)
    assert state.evidence > nothing.evidence + 200


@pytest.mark.slow
def test_drag_in_hover_is_told_apart_from_its_growth_where_the_thrust_map_is_wrong() -> None:
    best, names = state_of(problem(), EFFECTS_AT_ONCE).best, problem().priors.names
    drag, growth = (
        int(np.flatnonzero(best.free == names.index(f"rotor_drag.{n}"))[0])
        for n in ("k_xy_1_s", "spin_share")
    )
    c = best.covariance
    assert abs(c[drag, growth]) < 0.2 * np.sqrt(c[drag, drag] * c[growth, growth])


@pytest.mark.slow
def test_a_fit_ends_where_its_residuals_are_those_of_the_model() -> None:
    """What the end of a fit says of itself is what the model says there."""
    state = state_of(problem(), EFFECTS_AT_ONCE)
    there = state.spectrum.moved(problem().channels(state.best.x), *problem().split(state.best.x))
    for own, then in zip(state.spectrum.rows, there.rows, strict=True):
        for a, b in zip(own, then, strict=True):
            np.testing.assert_allclose(a.residual, b.residual, atol=1e-12)


@pytest.mark.slow
def test_more_effects_never_fit_worse_and_numbers_stay_in_range() -> None:
    few = state_of(problem(), EFFECTS_AT_ONCE[:2])
    every = problem().settle(EFFECTS_AT_ONCE, 1.0, problem().rest, few.best.x)
    laplace = problem().laplace(every.spectrum)
    assert every.evidence > few.evidence
    b = problem().priors
    k = len(b.now)
    values = b.now + every.best.x[:k]
    on = b.of(EFFECTS_AT_ONCE)
    assert np.all(values[on] >= b.low[on] - 1e-12) and np.all(values[on] <= b.high[on] + 1e-12)
    assert laplace.at(every.effects, 1.0) == pytest.approx(
        laplace.at(every.effects, 1.0, every.best.x), abs=1e-6
    )


@pytest.mark.slow
def test_a_hopeless_fit_is_given_up_with_what_its_linearisation_promises() -> None:
    whole = state_of(problem(), EFFECTS_AT_ONCE)
    gained = whole.evidence - problem().start((), 1.0).evidence
    given_up = problem().start(EFFECTS_AT_ONCE, 1.0, whole.evidence + 2 * gained)
    assert not np.array_equal(given_up.best.x, whole.best.x)
    assert given_up.evidence == pytest.approx(whole.evidence, abs=0.5 * gained + 10)
    within_reach = problem().start(EFFECTS_AT_ONCE, 1.0, whole.evidence - 1)
    assert within_reach.evidence == pytest.approx(whole.evidence, abs=1.0)


@pytest.mark.slow
def test_a_lag_that_is_far_from_the_files_is_found() -> None:
    """Steps along it are short where it bends and grow where it does not."""
    rotors = replace(COPTER.rotors, lag_up_s=0.15, lag_down_s=0.15)
    sluggish = replace(COPTER, rotors=rotors)
    flight = fly(COPTER, COPTER, 3, "prompt", LEGS)
    far = against(flight, sluggish, "motor_lag", "command_delay")
    state = far.start(far.priors.causes, 1.0)
    found = far.values(state.best.x)["motor_lag.tau_s"]
    assert found == pytest.approx(COPTER.rotors.lag_up_s - 0.15, abs=0.005)


def test_a_delay_that_no_channel_shows_yet_is_tried_once_one_does() -> None:
    names, none, one = ("imu_delay", "motor_lag"), np.zeros(2), np.ones(2)
    known: Any = SimpleNamespace(
        causes=names,
        odds=dict.fromkeys(names, 0.0),
        of=lambda causes: np.array([names.index(c) for c in causes]),
        **{"now": none, "mean": 0.1 * one, "slab": one, "low": none, "high": one},
    )
    some: Any = SimpleNamespace(priors=known)
    at: Any = SimpleNamespace(effects=(), best=SimpleNamespace(x=none))
    begun: set[str] = set()

    def tried(*silent: str) -> list[tuple[str, ...]]:
        near: Any = SimpleNamespace(silent=lambda c: c in silent)
        return [on for on, _ in search._late(some, near, at, begun)]

    assert tried("imu_delay") == [("motor_lag",)]
    assert tried() == [("imu_delay",)]
    assert not tried()
