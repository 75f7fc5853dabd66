"""Intervals of numbers inside their physical range, and which of them a headline may give."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import truncnorm

from twin.effects import EFFECTS
from twin.explain.estimates import unasked
from twin.explain.inference.estimate import (
    Estimate,
    credible_interval,
    fitted_estimates,
    share,
)
from twin.explain.inference.evidence import tail_weights
from twin.explain.inference.fit import INTERVAL, Fit
from twin.explain.inference.priors import Priors
from twin.explain.model.numbers import Number, numbers_of
from twin.vehicle_file import load_vehicle

COPTER = load_vehicle("copter_default")
NUMBERS = {n.full: n for n in numbers_of(EFFECTS.values(), COPTER)}
POSITIVE = (
    "thrust_scale.scale",
    "yaw_torque_scale.scale",
    "inertia_error.scale_z",
    "rotor_drag.k_xy_1_s",
    "battery_sag.slope",
    "mag_soft_iron.xx",
    "motor_lag.tau_s",
)
SIZES = st.floats(0.01, 3.0)


@given(st.sampled_from(POSITIVE), SIZES, SIZES)
def test_what_cannot_be_negative_has_no_negative_interval(
    name: str, value: float, half_width: float
) -> None:
    """A further lag of the motors may take back nearly all of the file's own."""
    low, high = credible_interval(NUMBERS[name], value, half_width)
    assert min(NUMBERS[name].about.bounds[0], 0.0) <= low <= value <= high
    assert math.isfinite(high)


@given(st.sampled_from(sorted(NUMBERS)))
def test_a_narrow_posterior_keeps_its_normal_interval(name: str) -> None:
    number = NUMBERS[name]
    value = 0.5 * sum(number.about.bounds) + 0.1 * number.about.bounds[1]
    half = 1e-3 * abs(value)
    expected = pytest.approx((value - half, value + half), abs=0.01 * half)
    assert credible_interval(number, value, half) == expected


def test_a_factor_is_log_normal_about_its_value() -> None:
    """With the coefficient of variation of the normal posterior."""
    low, high = credible_interval(NUMBERS["inertia_error.scale_x"], 1.5, INTERVAL * 0.9)
    assert low * high == pytest.approx(1.5**2)
    sigma = math.log(high / 1.5) / INTERVAL
    assert math.sqrt(math.expm1(sigma**2)) == pytest.approx(0.9 / 1.5)


@pytest.mark.parametrize(("value", "sd"), [(0.0, 0.2), (0.1, 0.2), (0.3, 0.2), (0.5, 0.2)])
def test_a_coefficient_has_the_interval_of_highest_density(value: float, sd: float) -> None:
    """Of the truncated normal distribution, by its own cumulative distribution."""
    low, high = credible_interval(NUMBERS["rotor_drag.k_xy_1_s"], value, INTERVAL * sd)
    posterior = truncnorm(-value / sd, np.inf, loc=value, scale=sd)
    assert posterior.cdf(high) - posterior.cdf(low) == pytest.approx(0.95, abs=1e-6)
    assert posterior.pdf(low) >= posterior.pdf(high) * (1 - 1e-6)
    assert (low == 0) or posterior.pdf(low) == pytest.approx(posterior.pdf(high))


SHAPED = ("ground_effect.gain", "translational_lift.gain", "blade_flapping.k_rad_s_m")


@given(st.sampled_from(SHAPED), SIZES, SIZES, st.floats(1.0, 30.0))
def test_no_effect_is_as_far_away_as_with_the_shape_held(
    name: str, value: float, half: float, ridge: float
) -> None:
    """Along a ridge of size and shape nothing vanishes, however wide it is."""
    low, high = credible_interval(NUMBERS[name], value, half, ridge)
    held, _ = credible_interval(NUMBERS[name], value, half / ridge)
    assert 0 <= low <= value <= high
    assert (low > 0) == (held > 0)


def test_a_size_on_a_ridge_is_as_wide_as_the_search_says() -> None:
    """Where it is told well: the power of a normal quantity is normal there."""
    low, high = credible_interval(NUMBERS["ground_effect.gain"], 0.4, 1e-3, 8.0)
    assert (low, high) == pytest.approx((0.399, 0.401), rel=1e-4)


def estimate(number: Number, value: float, half: float, prior_share: float) -> Estimate:
    """As a search makes it."""
    interval = credible_interval(number, value, half)
    return Estimate(number, value, number.about.neutral, interval, prior_share)


@given(st.sampled_from(sorted(NUMBERS)), st.floats(-1, 1), st.floats(1e-3, 2), st.floats(0, 1))
def test_a_headline_gives_no_number_that_may_be_none(
    name: str, place: float, half: float, prior_share: float
) -> None:
    number = NUMBERS[name]
    low, high = number.about.bounds
    value = min(max(0.5 * (low + high) + 0.5 * place * (high - low), low), high)
    made = estimate(number, value, half * (high - low), prior_share)
    if made.determined:
        assert made.ci95 is not None and made.no_effect is not None
        assert not made.ci95[0] <= made.no_effect <= made.ci95[1]
        assert prior_share <= 0.5
    elif not number.shape and prior_share <= 0.5:
        assert made.may_be_none


def test_a_number_that_only_the_prior_knows_is_not_determined() -> None:
    scale = NUMBERS["thrust_scale.scale"]
    assert estimate(scale, 1.4, 0.1, 0.4).determined
    assert not estimate(scale, 1.4, 0.1, 0.6).determined
    assert not estimate(scale, 1.4, 0.1, 0.6).may_be_none
    assert estimate(scale, 1.05, 0.1, 0.4).may_be_none
    assert not estimate(NUMBERS["slung_load.length_m"], 0.7, 0.1, 0.1).determined


def test_what_no_flight_asks_for_or_shows_is_not_told() -> None:
    """A mute channel knows of the controller alone; of another axis there is none."""
    rest = SimpleNamespace(channels=("acc_z", "gyro_rate_x", "gyro_rate_y"))
    for mute, axes in (((), "z"), ((1,), "xz"), ((1, 2), "xyz")):
        problem = SimpleNamespace(rest=rest, noise=SimpleNamespace(mute=frozenset(mute)))
        found: Any = SimpleNamespace(naming=SimpleNamespace(problem=problem))
        assert unasked(found) == axes


def test_what_is_far_from_its_prior_is_told_by_the_flights() -> None:
    """A number with half the width of its prior, 5.4 deviations off, is told, one at its mean is
    not; nothing tells less than the prior does."""
    near, far = tail_weights(np.array([0.0, 5.4]), np.ones(2))
    assert share(0.52, 1.0, near) == pytest.approx(0.52)
    assert share(0.52, 1.0, far) < 0.2
    assert share(2.0, 1.0, near) == 1.0 == share(0.1, 0.0, near)


def test_the_prior_of_a_share_is_that_of_the_fit() -> None:
    """Linear for a factor as well; normal for a shape parameter, however far off it is."""
    numbers = tuple(NUMBERS[f"slung_load.{n}"] for n in ("mass_kg", "length_m"))
    names, none, one = tuple(n.full for n in numbers), np.zeros(2), np.ones(2)
    b = Priors(
        columns=(0, 1),
        names=names,
        cause=("slung_load",) * 2,
        shape=np.array([n.shape for n in numbers]),
        now=none,
        mean=one,
        slab=0.3 * one,
        file=np.diag(none),
        low=0.1 * one,
        high=9 * one,
        held=none,
        day=none,
        odds={"slung_load": 0.0},
    )
    values = dict.fromkeys(names, 0.35)
    fitted = Fit(("slung_load",), values, numbers, INTERVAL * 0.2 * one, 0.0)
    mass, length = fitted_estimates(fitted, b, "slung_load")
    assert mass.prior_share == pytest.approx(0.2 / 0.3 * math.sqrt(4 / (3 + (0.65 / 0.3) ** 2)))
    assert length.prior_share == pytest.approx(0.2 / 0.3)
