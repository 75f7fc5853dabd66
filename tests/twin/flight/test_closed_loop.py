"""Every built-in vehicle flies every mission, in still air and in wind, under its controller."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from rig import BUILTIN

from fmus.names import base_exponents
from twin.component import Run
from twin.flight.closed_loop import (
    SETPOINTS,
    STEP_S,
    ClosedLoop,
    Trajectory,
    closed_loop,
    fly_missions,
    standing,
)
from twin.flight.lqr import controller
from twin.flight.mission import mission, mission_names
from twin.frames import AXES
from twin.physics.airframe import airframe
from twin.physics.environment import environment
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle

WIND_M_S = (3.0, 4.0, 0.0)
"""5 m/s from the south-west."""
ROTOR_DRAG_1_S = 0.3
"""Where the vehicle file gives no drag, that of rotors of this size, or the wind would not be felt.
Order of magnitude of Förster, System Identification of the Crazyflie 2.0, ETH 2015: 0.27 1/s."""


def real(vehicle: Vehicle) -> Vehicle:
    """The vehicle with drag, which its controller does not know."""
    if vehicle.drag_linear_n_s_m.any():
        return vehicle
    return replace(vehicle, drag_linear_n_s_m=np.full(3, ROTOR_DRAG_1_S * vehicle.mass_kg))


@cache
def loop(name: str, windy: bool) -> ClosedLoop:
    vehicle = load_vehicle(name)
    return ClosedLoop(vehicle, WIND_M_S if windy else (0.0, 0.0, 0.0), plant=real(vehicle))


@cache
def flown(name: str, plan: str, windy: bool) -> Trajectory:
    return loop(name, windy).fly(plan)


def is_long(name: str, plan: str, windy: bool) -> bool:
    """Neither of the first vehicle nor every vehicle's tour in wind or hover in still air."""
    return name != BUILTIN[0] and (plan, windy) not in (("tour", True), ("hover", False))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "plan", "windy"),
    [
        pytest.param(*case, marks=pytest.mark.long if is_long(*case) else ())
        for case in product(BUILTIN, mission_names(), (False, True))
    ],
)
def test_flies_every_mission(name: str, plan: str, windy: bool) -> None:
    flight = flown(name, plan, windy)
    miss = flight.miss_m
    assert np.sqrt(np.mean(miss**2)) < (0.15 if windy else 0.06)
    assert miss.max() < (0.4 if windy else 0.15)
    assert flight.saturated_s < 0.2
    assert np.degrees(flight.tilt_rad.max()) < 45.0
    end, speed = (flight.state(*(f"{s}_{a}" for a in AXES))[-1] for s in ("pos", "vel"))
    assert np.linalg.norm(speed) < 0.02
    if plan in ("takeoff", "hover"):
        assert miss[-1] < 0.02
    else:  # landed: on its feet, not far from where it was to be
        legs = load_vehicle(name).leg_height_m
        assert end[2] == pytest.approx(-legs, abs=3e-3)
        assert np.linalg.norm(end[:2] - flight.setpoints[-1, :2]) < 0.15


@pytest.mark.slow
def test_same_flight_component_by_component() -> None:
    """The compiled loop against `Run` of each component, as a co-simulation would step them."""
    name, seconds = "crazyflie", 6.0
    reference = flown(name, "hover", True)
    vehicle = load_vehicle(name)
    body = airframe(real(vehicle))
    body = body.with_starts(standing(body, vehicle))
    parts = {"body": body, "plan": mission(vehicle, "hover"), "control": controller(vehicle)}
    u = {k: c.input_values() for k, c in parts.items()}
    for axis, wind in zip(AXES, WIND_M_S, strict=True):
        u["body"][body.input_names.index(f"wind_{axis}")] = wind
    runs = {k: Run(c, u[k], c.parameter_values()) for k, c in parts.items()}
    for k in range(round(seconds / STEP_S)):
        values: dict[str, float] = {}
        for source in ("body", "plan"):
            values |= dict(
                zip(parts[source].output_names, runs[source].outputs(u[source]), strict=True)
            )
        u["control"] = np.array([values[n] for n in parts["control"].input_names])
        commands = runs["control"].outputs(u["control"])
        drives = [body.input_names.index(n) for n in parts["control"].output_names]
        u["body"][drives] = commands
        for part, run in runs.items():
            run.step(k * STEP_S, STEP_S, u[part])
    np.testing.assert_allclose(runs["body"].x, reference.states[round(seconds / STEP_S)], atol=1e-9)
    assert [n for n in parts["control"].input_names if n in SETPOINTS] == list(SETPOINTS)


@pytest.mark.slow
def test_names_fit_together() -> None:
    """What one component reads is what another one gives, under the same name and unit."""
    for name in BUILTIN:
        vehicle = load_vehicle(name)
        body, control = airframe(vehicle), controller(vehicle)
        plan, air = mission(vehicle, "tour"), environment(vehicle)
        given = {v.name: v.unit for c in (body, plan) for v in c.output_variables}
        for variable in (*control.inputs, *air.inputs):
            assert given[variable.name] == variable.unit
        wanted = {v.name: v.unit for v in body.inputs}
        for variable in control.output_variables:
            assert wanted[variable.name] == variable.unit
        for axis in AXES:
            assert f"wind_{axis}" in air.output_names
            assert f"wind_{axis}" in wanted


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILTIN)
def test_flies_with_a_heavier_vehicle_than_it_was_designed_for(name: str) -> None:
    vehicle = load_vehicle(name)
    flight = closed_loop(vehicle, "hover", plant=vehicle.with_mass(1.2 * vehicle.mass_kg))
    assert flight.miss_m[-1] < 0.02
    assert flight.miss_m.max() < 0.5
    assert flight.saturated_s < 0.2


@pytest.mark.slow
def test_a_twin_with_weak_rotors_flies_by_its_own_numbers() -> None:
    loss = {"loss_1": 0.15, "loss_2": 0.0, "loss_3": 0.0, "loss_4": 0.05, "torque_share": 1.0}
    weak = load_vehicle("crazyflie").with_effects(
        {
            "thrust_scale": {"scale": 0.59},
            "thrust_curve": {"slope": -0.3},
            "rotor_efficiency_loss": loss,
        }
    )
    missions = fly_missions(weak, ["hover", "tour"])
    assert all(m.stable for m in missions)
    assert max(m.worst_m for m in missions) < 0.1


TURNED = load_vehicle("crazyflie").with_effects(
    {"blade_flapping": {"k_rad_s_m": 0.037, "height_m": 0.044}}
)
"""The air turns it: drag above the centre of mass."""


@pytest.mark.slow
def test_a_twin_that_the_air_turns_flies_its_way() -> None:
    """Without that in the controller it was 4 m off at 2 m/s."""
    missions = fly_missions(TURNED, ["forward", "tour"])
    assert max(m.worst_m for m in missions) < 0.1


@pytest.mark.slow
def test_a_twin_that_the_air_turns_stays_where_it_is_in_wind() -> None:
    """A moment of the wind that is not learned leaves an attitude error, and it is blown away."""
    wind = (-1.5, 3.0, 0.0)
    learns = ClosedLoop(TURNED, wind).fly("hover")
    never = controller(TURNED).with_starts({"air_moment.time": 1e6})
    assert learns.miss_m[-1] < 0.1
    assert learns.miss_m.max() < 1.5
    assert ClosedLoop(TURNED, wind, control=never).fly("hover").miss_m[-1] > 10.0


def test_an_fmu_has_the_units_of_a_controller_that_knows_what_the_air_turns() -> None:
    units = {v.name: v.unit for v in controller(TURNED).parameters}
    assert base_exponents(units["air_moment.x"]) == {"rad": 1, "m": -1, "s": -1}
