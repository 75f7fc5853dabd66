"""Vehicles with effects of their own, as `uavtwin explain` writes them: every verb takes them."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fmu_gap import window_ends_of_fmus

from cosim.master import Master
from cosim.system import System
from fmus import build, component_model
from twin.component import Component, Run
from twin.effects import EFFECTS
from twin.flight import closed_loop
from twin.flight.assembly import flying_twin
from twin.flight.lqr import controller
from twin.flight.mission import mission
from twin.logs import Flight
from twin.physics.airframe import airframe
from twin.residuals.aligned import align_flight
from twin.residuals.flight_gap import flight_gap
from twin.residuals.gap import Channel
from twin.residuals.short_horizon import READ
from twin.residuals.teacher_forced import GRID_S
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import ACC_NOISE_M_S2, fly

Array = np.ndarray
WAYPOINTS = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 1.5, (0.0, 0.0, -1.5)),
    ("forward", 1.5, (2.0, 1.0, -1.8)),
)
NO_WINDOWS = 60.0
"""A horizon longer than the flight: what is left of the gap is Python."""
NOT_READ = {"imu_delay", "vibration"}
"""The gap takes the motion from the gyroscope as it reads, late or shaken."""


def having(name: str, effect: str, **numbers: float) -> Vehicle:
    """A built-in vehicle, without a lag of its own or with one, with one effect on."""
    base, about = load_vehicle(name), EFFECTS[effect]
    of_logs = {p.name: 0.0 for p in about.of_logs}
    return base.with_effects({effect: about.starts(base) | of_logs | numbers})


@cache
def flown(name: str, effect: str) -> Flight:
    vehicle = having(name, effect)
    return fly(vehicle, vehicle, seed=0, waypoints=WAYPOINTS)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_a_flight_of_the_vehicle_itself_leaves_the_noise(effect: str) -> None:
    vehicle, flight = having("feisi_x150", effect), flown("feisi_x150", effect)
    found: dict[str, Channel] = {
        c.name: c for c in flight_gap(flight, vehicle, NO_WINDOWS).channels
    }
    for axis in "xyz":
        bound = 1.3 * ACC_NOISE_M_S2
        if effect == "vibration":  # of four rotors, their phase known from commands held for 5 ms
            bound = 0.5 * vehicle.effects[effect]["accel_m_s2"] * np.sqrt(4 / 2)
        assert rms(found[f"acc_{axis}"].residual) < bound, axis
        if effect not in NOT_READ:
            assert rms(found[f"gyro_rate_{axis}"].residual) < 0.7, axis
    assert flying_twin(vehicle, effects=()).parts["controller"].states


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "effect"),
    [
        ("feisi_x150", "motor_lag"),
        ("feisi_x150", "slung_load"),
        ("feisi_x150", "command_delay"),
        ("copter_default", "command_delay"),
    ],
)
def test_windows_start_where_the_teacher_forced_twin_is(
    name: str, effect: str, tmp_path: Path
) -> None:
    """Effects with a memory: windows end where those of the FMUs do, near the flight."""
    vehicle, flight = having(name, effect), flown(name, effect)
    steps = 300
    found = {
        c.name: c for c in flight_gap(flight, vehicle, steps * GRID_S).channels if c.horizon_s > 0
    }
    twin = align_flight(flight, vehicle)
    ends = np.searchsorted(twin.inputs.t_s, found["vel_x"].t_s - 1e-9)
    assert len(ends) >= 3
    exact = window_ends_of_fmus(flight, twin, (ends - steps).tolist(), steps, tmp_path)
    for i, channel in enumerate(READ):
        if channel in found:
            np.testing.assert_allclose(found[channel].simulated, exact[:, i], rtol=1e-9, atol=1e-9)
    for stem, bound in (("vel", 0.04), ("att", 0.02), ("gyro", 0.08)):
        for axis in "xyz":
            assert rms(found[f"{stem}_{axis}"].residual) < bound, f"{stem}_{axis}"


@pytest.mark.parametrize("loss", [0.65, 1.0])
def test_an_fmu_has_the_torque_of_a_weak_rotor(loss: float, tmp_path: Path) -> None:
    """Of one that lost most of its thrust, and all of it."""
    body, steps = airframe(having("copter_default", "rotor_efficiency_loss")), 50
    numbers = {
        f"rotor_efficiency_loss.{n}": v for n, v in (("loss_2", loss), ("torque_share", 1.5))
    }
    fmu = build(component_model(body), tmp_path / "airframe.fmu")
    starts = {f"airframe.{name}": value for name, value in numbers.items()}
    with Master(System({"airframe": fmu}, (), starts=starts)) as master:
        master.initialize(0.0, {})
        turned = master.run(steps * GRID_S, GRID_S, "settled")["airframe.omega_z"]
    p, names = body.parameter_values(), [v.name for v in body.parameters]
    p[[names.index(n) for n in numbers]] = [*numbers.values()]
    run = Run(body, body.input_values(), p, 0.0)
    for k in range(steps):
        run.step(k * GRID_S, GRID_S, body.input_values())
    exact = run.x[[s.name for s in body.states].index("omega_z")]
    assert turned[-1] == pytest.approx(exact, rel=1e-9)
    assert abs(exact) > 0.01


@pytest.mark.slow
def test_a_command_arrives_in_a_flight_when_it_does_in_a_simulation() -> None:
    """Of a whole number of sample periods and not; never within one."""
    flight = flown("feisi_x150", "command_delay")
    for delay_s in (0.0, 0.001, 0.0123, 0.02):
        vehicle = having("feisi_x150", "command_delay", delay_s=delay_s)
        twin = align_flight(flight, vehicle)
        raw = align_flight(flight, load_vehicle("feisi_x150")).inputs.u
        body = airframe(vehicle)
        held = [i for i, s in enumerate(body.states) if s.name.startswith("command_delay.")]
        assert [s.name for s in twin.airframe.states] == [s.name for s in body.states]
        run = Run(body, raw[0], body.parameter_values(), float(twin.inputs.t_s[0]))
        for k in range(700):
            np.testing.assert_allclose(run.x[held], twin.states[k, held], rtol=0, atol=1e-9)
            np.testing.assert_array_equal(twin.states[k, held], twin.inputs.u[k, : len(held)])
            run.step(float(twin.inputs.t_s[k]), GRID_S, raw[k])
        assert np.ptp(raw[:700, 0]) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.0, 0.0123, 0.02])
def test_a_closed_loop_delays_commands_as_a_run_does(delay_s: float) -> None:
    vehicle = having("copter_default", "command_delay", delay_s=delay_s)
    body = airframe(vehicle)
    body = body.with_starts(closed_loop.standing(body, vehicle))
    plan = mission(vehicle, "hover")
    t_s = 1.9 + GRID_S * np.arange(1200, dtype=np.float64)
    rows = plan.outputs_along(t_s[:, None], np.zeros((len(t_s), 0)))
    setpoints = rows[:, [plan.output_names.index(n) for n in closed_loop.SETPOINTS]]
    states, inputs = closed_loop.fly(body, controller(vehicle), setpoints)
    run = Run(body, inputs[0], body.parameter_values())
    for k, (x, u) in enumerate(zip(states, inputs, strict=True)):
        np.testing.assert_allclose(x, run.x, rtol=1e-9, atol=1e-9)
        run.step(k * GRID_S, GRID_S, u)
    assert np.ptp(inputs[:, 0]) > 0.1
    assert states[-1, [s.name for s in body.states].index("vel_z")] < -0.05


@pytest.mark.slow
def test_a_delay_does_not_change_the_gains() -> None:
    """They are those of motors that get their commands at once."""
    late, base = having("copter_default", "command_delay"), load_vehicle("copter_default")
    assert controller(late).parameters == controller(base).parameters


def rates(body: Component, changes: dict[str, float]) -> dict[str, float]:
    u, p = body.input_values(), body.parameter_values({"ground.enabled": 0.0} | changes)
    dx = np.asarray(body.derivatives(body.initial(u, p), u, p)).ravel()
    return dict(zip((s.name for s in body.states), dx.tolist(), strict=True))


def test_a_lag_that_is_switched_on_later_is_in_trim_as_well() -> None:
    """A lopsided vehicle: every rotor has a level of its own."""
    base = load_vehicle("feisi_x150")
    hubs = base.rotors.position_m - 0.1 * base.arm_m * np.array([1.0, 0.5, 0.0])
    vehicle = replace(base, rotors=replace(base.rotors, position_m=hubs))
    found = rates(airframe(vehicle, effects=["motor_lag"]), {"motor_lag.enabled": 1.0})
    still = [v for n, v in found.items() if not n.startswith("pos_")]
    np.testing.assert_allclose(still, 0.0, atol=1e-9)
    rest = closed_loop.standing(airframe(vehicle, effects=["motor_lag"]), vehicle)
    assert {rest[f"initial.effort_{i}"] for i in range(1, 5)} == {0.0}


def test_a_load_starts_where_it_is_put() -> None:
    body = airframe(having("feisi_x150", "slung_load", length_m=0.5))
    at_rest = rates(body, {})
    assert max(abs(v) for v in at_rest.values()) < 1e-9
    pushed = rates(body, {"initial.vel_x": 2.0, "initial.slung_load.v_y": 0.3})
    assert pushed["slung_load.r_x"] == pytest.approx(0.0, abs=1e-12)
    assert pushed["slung_load.r_y"] == pytest.approx(0.3)
    aside = rates(body, {"initial.slung_load.r_x": 0.1})
    assert aside["slung_load.v_x"] < -1.0
    assert aside["vel_x"] > 0.1
