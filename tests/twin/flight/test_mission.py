"""Missions: smooth, consistent, on time, from the ground to the ground."""

import re

import numpy as np
import pytest
from numpy.typing import NDArray
from rig import BUILTIN

from twin.errors import ModelError
from twin.flight import mission as missions
from twin.flight.mission import PHASES, mission, mission_duration_s, mission_names
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]
STEP_S = 0.005
JERK_M_S3 = 12.0


def rows(vehicle: str, name: str, extra_s: float = 1.0, **parameters: float) -> tuple[Array, Array]:
    """Times and outputs, shape (n,) and (n, 12): position, velocity, acceleration, yaw, armed."""
    component = mission(load_vehicle(vehicle), name)
    t = np.arange(0.0, mission_duration_s(name) + extra_s, STEP_S)
    p = np.tile(component.parameter_values(parameters)[:, None], len(t))
    return t, np.asarray(component.outputs(t[None, :], np.zeros((0, len(t))), p)).T


@pytest.mark.parametrize("vehicle", BUILTIN)
@pytest.mark.parametrize("name", mission_names())
def test_setpoints_are_smooth_and_belong_together(vehicle: str, name: str) -> None:
    _, y = rows(vehicle, name)
    for low, high in ((0, 3), (3, 6)):  # velocity of position, acceleration of velocity
        slope = np.gradient(y[:, low : low + 3], STEP_S, axis=0)[1:-1]
        assert np.abs(slope - y[1:-1, high : high + 3]).max() < 0.5 * STEP_S * JERK_M_S3
    assert np.abs(np.diff(y[:, 6:9], axis=0)).max() / STEP_S < JERK_M_S3
    assert np.abs(np.diff(y[:, 9])).max() / STEP_S < 2.0  # turn rate, rad/s


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", BUILTIN)
@pytest.mark.parametrize("name", mission_names())
def test_begins_and_ends_where_it_should(vehicle: str, name: str) -> None:
    t, y = rows(vehicle, name)
    legs = load_vehicle(vehicle).leg_height_m
    ground = np.array([0.0, 0.0, -legs])
    np.testing.assert_allclose(y[0, :3], ground)
    assert y[0, 10] == 0.0
    end = y[np.searchsorted(t, mission_duration_s(name))]
    np.testing.assert_allclose(end[3:9], 0.0, atol=1e-9)
    phases = list(dict.fromkeys(y[:, 11]))
    if name in ("takeoff", "hover"):
        assert end[10] == 1.0
        assert phases == [0, 1, 2]
        assert end[2] < -legs - 0.5
    else:
        assert end[10] == 0.0
        np.testing.assert_allclose(end[:3], ground, atol=1e-9)
        assert y[-1, 11] == PHASES["ground"]
        assert PHASES["land"] in phases
    assert np.all(y[:, 2] <= -legs + 1e-9)  # never below the ground
    assert np.all((y[:, 11] == 0) | (y[:, 10] == 1.0))  # armed in every phase of flight


def test_durations_are_those_of_the_documentation() -> None:
    told = re.findall(r"\| `(\w+)` \|.*\| (\d+) s \|", missions.__doc__ or "")
    assert {name: int(s) for name, s in told} == {
        name: round(mission_duration_s(name)) for name in mission_names()
    }


@pytest.mark.slow
def test_small_vehicles_fly_at_half_the_size_and_speed() -> None:
    for name in ("forward", "tour"):
        large, small = (rows(v, name)[1] for v in ("copter_default", "crazyflie"))
        np.testing.assert_allclose(small[:, 3:6], 0.5 * large[:, 3:6], atol=1e-9)
        speed = np.linalg.norm(large[:, 3:6], axis=1).max()
        assert speed == pytest.approx({"forward": 5.0, "tour": 2.0}[name], rel=1e-3)


@pytest.mark.slow
def test_circle_is_a_circle_and_parameters_move_it() -> None:
    _, y = rows("copter_default", "tour", speed=1.0, radius=0.8, extra_s=40.0)
    middle = np.array([0.0, 0.8])
    radius = np.linalg.norm(y[:, :2] - middle, axis=1)
    assert np.count_nonzero(np.abs(radius - 0.8) < 1e-9) * STEP_S > 5.0  # one turn takes 5 s
    _, moved = rows("copter_default", "tour", extra_s=40.0, **{"waypoint_2.x": 6.0})
    assert moved[:, 0].max() == pytest.approx(6.0)


def test_unknown_mission() -> None:
    with pytest.raises(ModelError, match="Known: takeoff, hover"):
        mission(load_vehicle("crazyflie"), "loop")


@pytest.mark.slow
@pytest.mark.parametrize("name", mission_names())
def test_shapes_that_are_not_flown_are_left_out(name: str) -> None:
    """At each time the first shortcut that holds gives the setpoints; each holds at some time."""
    c = mission(load_vehicle("crazyflie"), name)
    p, u, first = c.parameter_values(), np.zeros(0), set()
    for t in np.arange(0.0, mission_duration_s(name) + 1.0, 0.02):
        held = [i for i, s in enumerate(c.shortcuts) if float(s.holds(t, p, 0.0))]
        for i in held:
            full, cheap = c.outputs(t, u, p), c.shortcuts[i].outputs(t, u, p)
            assert np.array_equal(np.asarray(full), np.asarray(cheap)), (t, i)
        first |= set(held[:1])
    assert first == set(range(len(c.shortcuts)))
    least = [s.outputs.n_instructions() for s in c.shortcuts]
    assert least[0] == min(least) < c.outputs.n_instructions() / 1.5
