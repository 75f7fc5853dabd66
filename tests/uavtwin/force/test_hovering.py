"""How a twin hovers beside an aircraft whose numbers are known."""

from dataclasses import replace

import numpy as np
import pytest

from twin.physics.residual_force import NOISE_HZ
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.force.closed_loop import SETTLED_S, flown_hover, hovers, twin_hover
from uavtwin.force.hover_noise import READINGS, HoverLevel, levels, noise_claim, wanted_levels

COPTER = load_vehicle("copter_default")
UP: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.5, (0.0, 0.0, -2.0)),
    ("hover", 6.0, (0.0, 0.0, -2.0)),
)


@pytest.mark.slow
def test_a_twin_hovers_as_the_aircraft_of_its_numbers() -> None:
    """The same command; heavier by a tenth, the square of the command is more by as much."""
    twin = twin_hover(COPTER, None)
    same = flown_hover(fly(COPTER, COPTER, 1, "same", UP), COPTER)
    heavy = replace(COPTER, mass_kg=1.1 * COPTER.mass_kg)
    more = flown_hover(fly(COPTER, heavy, 1, "heavy", UP), COPTER)
    assert twin is not None and same is not None and more is not None
    assert same.seconds == pytest.approx(6.0 - 2 * SETTLED_S, abs=0.1)
    assert same.command == pytest.approx(twin.command, rel=0.01)
    assert more.command > 1.03 * twin.command
    assert same.tilt < 0.02 and twin.tilt < 0.02 and same.velocity < 0.2


@pytest.mark.slow
def test_a_flight_that_never_hovers_is_compared_with_nothing() -> None:
    legs: Waypoints = (*UP[:2], ("tour", 3.0, (3.0, 0.0, -2.0)))
    flight = fly(COPTER, COPTER, 1, "tour", legs)
    assert flown_hover(flight, COPTER) is None
    assert hovers([flight], {"twin": (COPTER, None)}) == {}


def test_white_noise_has_one_level_up_to_half_of_its_rate() -> None:
    rate_hz, sigma = 50.0, 0.2
    x = np.random.default_rng(0).normal(size=(20000, 2)) * [sigma, 2 * sigma]
    found = levels(x, rate_hz)
    known = np.array(NOISE_HZ) * 2 ** (1 / 6) < rate_hz / 2
    assert np.isnan(found[:, ~known]).all()
    white = np.array([[sigma**2], [4 * sigma**2]]) / (rate_hz / 2)
    np.testing.assert_allclose(found[:, known] / white, 1, atol=0.35)
    np.testing.assert_allclose((found[:, known] / white).mean(axis=1), 1, atol=0.1)


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
