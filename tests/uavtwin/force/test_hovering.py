"""Spectra of hovers, and how alike they are."""

import numpy as np
import pytest

from twin.physics.residual_force import NOISE_HZ
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.force.hover_noise import (
    READ_S,
    READINGS,
    HoverLevel,
    flight_levels,
    levels,
    noise_claim,
    wanted_levels,
    white_noise,
)
from uavtwin.vehicles import load_vehicle

COPTER = load_vehicle("copter_default")
UP: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.5, (0.0, 0.0, -2.0)),
    ("hover", 6.0, (0.0, 0.0, -2.0)),
)


@pytest.mark.slow
def test_only_a_flight_that_hovers_has_levels() -> None:
    assert flight_levels(fly(COPTER, COPTER, 1, "up", UP), COPTER) is not None
    legs: Waypoints = (*UP[:2], ("tour", 3.0, (3.0, 0.0, -2.0)))
    assert flight_levels(fly(COPTER, COPTER, 1, "tour", legs), COPTER) is None


def test_white_noise_has_one_level_up_to_half_of_its_rate() -> None:
    rate_hz, sigma = 50.0, 0.2
    x = np.random.default_rng(0).normal(size=(20000, 2)) * [sigma, 2 * sigma]
    found = levels(x, rate_hz)
    known = np.array(NOISE_HZ) * 2 ** (1 / 6) < rate_hz / 2
    assert np.isnan(found[:, ~known]).all()
    white = np.array([[sigma**2], [4 * sigma**2]]) / (rate_hz / 2)
    np.testing.assert_allclose(found[:, known] / white, 1, atol=0.35)
    np.testing.assert_allclose((found[:, known] / white).mean(axis=1), 1, atol=0.1)


def test_what_a_sensor_has_at_all_frequencies_is_its_noise() -> None:
    """And not what its axes move at some."""
    sigma = np.repeat([0.3, 0.01], 3)
    x = np.random.default_rng(1).normal(size=(20000, 6)) * sigma
    t_s = np.arange(len(x)) * READ_S
    x[:, 0] += np.cumsum(x[:, 1]) / 10
    x[:, 4] += sum(0.05 * np.sin(2 * np.pi * f * t_s) for f in (1.0, 2.0, 4.0))
    found = white_noise(wanted_levels([levels(x, 1 / READ_S)]))
    np.testing.assert_allclose(found, sigma[::3], rtol=0.12)
    assert not white_noise(np.zeros((6, len(NOISE_HZ)))).any()


def test_a_line_is_no_noise() -> None:
    """And what no log tells is not drawn."""
    flat = np.ones((len(READINGS), len(NOISE_HZ)))
    lined = flat.copy()
    lined[0, 9:11] = 1e4
    lined[:, 20:] = np.nan
    wanted = wanted_levels([lined])
    np.testing.assert_allclose(wanted[:, :20], 1)
    assert not wanted[:, 20:].any()
    np.testing.assert_allclose(wanted_levels([lined, flat])[:, 20:], 1)


def test_hovers_are_alike_within_a_factor_of_two_of_rms() -> None:
    rows = [HoverLevel("one", "acc_x", 1.0, 1.0, 1e-4, power) for power in (0.3, 3.9, 4.1, 1.0)]
    rows.append(HoverLevel("one", "acc_x", 40.0, None, 1.0, 1.0))
    assert "in 75 % of 4 third-octaves" in noise_claim(rows)
    assert "without it in 0 %" in noise_claim(rows)
