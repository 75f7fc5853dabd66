"""How a twin hovers beside an aircraft whose numbers are known."""

from dataclasses import replace

import pytest

from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.force.closed_loop import SETTLED_S, flown_hover, hovers, twin_hover

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
