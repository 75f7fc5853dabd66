"""PX4's controller: the mixer against the one for logs, and flights with the gains of a log."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from pyulog import ULog
from rig import with_rotors

from twin.component import Component
from twin.errors import ModelError
from twin.flight.closed_loop import closed_loop, fly
from twin.flight.px4 import (
    PARAMETERS,
    from_px4,
    mix_airmode_off,
    px4_controller,
)
from twin.logs.px4.control import Mixer, geometry_scale, low_pass, mix, mixer_scale
from twin.physics.airframe import airframe
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle

FLOWN = ("copter_default", "feisi_x150")


def px4_controller_of_log(vehicle: Vehicle, log: Path) -> Component:
    """With the parameters with which a log was started."""
    with log.open("rb") as file:
        return px4_controller(vehicle, ULog(file, ["none"]).initial_parameters)


@pytest.mark.parametrize("factor", [0.0, 0.3])
@pytest.mark.parametrize("name", ["quad_x", "hex_x", "quad_wide"])
def test_mixer_is_the_one_for_logs(name: str, factor: float) -> None:
    scale = mixer_scale(name)
    controls = np.random.default_rng(1).uniform([-1.2] * 3 + [-0.1], 1.2, (2000, 4))
    symbols = [ca.SX.sym(f"c{i}") for i in range(4)]
    f = ca.Function("mix", symbols, [ca.vertcat(*mix_airmode_off(symbols, scale, ca.SX(factor)))])
    ours = np.asarray(f.map(len(controls))(*controls.T[:, None, :])).T
    np.testing.assert_allclose(ours, mix(controls, Mixer(scale, 0, factor)), atol=1e-12)


@pytest.mark.parametrize("name", FLOWN)
def test_mixer_of_the_built_in_vehicles_is_quad_x(name: str) -> None:
    rotors = load_vehicle(name).rotors
    scale = geometry_scale(np.column_stack([rotors.position_m[:, :2], -rotors.direction]))
    np.testing.assert_allclose(scale, mixer_scale("quad_x"), atol=1e-5)


def test_gyro_low_pass_is_px4s() -> None:
    """Steps of the component against the filter that the log reader uses."""
    control = px4_controller(load_vehicle("copter_default"))
    sampling = control.sampling
    assert sampling is not None
    p, x = control.parameter_values(), np.zeros(len(control.states))
    index = [s.name for s in control.states].index("rate_x")
    signal = np.random.default_rng(2).normal(size=200)
    found = []
    for value in signal:
        u = control.input_values({"omega_x": value})
        x = np.asarray(sampling.update(x, u, p, [], [])).ravel()
        found.append(x[index])
    padded = np.concatenate([[0.0], signal])[:, None]  # at rest before the first sample
    np.testing.assert_allclose(found, low_pass(padded, 1000.0, 30.0)[1:, 0], atol=1e-12)


def test_parameters_of_a_log_reach_the_component(data_dir: Path) -> None:
    control = px4_controller_of_log(
        load_vehicle("feisi_x150"), data_dir / "rflysimdt" / "real_1.ulg"
    )
    p = {v.name: v.start for v in control.parameters}
    assert p["MC_ROLLRATE_P"] == pytest.approx(0.063)
    assert p["MC_PITCHRATE_I"] == pytest.approx(0.125)
    assert p["IMU_GYRO_CUTOFF"] == 35.0
    assert p["MC_ROLLRATE_MAX"] == pytest.approx(np.radians(220.0))
    assert p["MPC_TILTMAX_AIR"] == pytest.approx(np.radians(45.0))
    assert set(PARAMETERS) <= set(p)
    # PX4 estimated the hover thrust in that flight.
    assert p["MPC_THR_HOVER"] == pytest.approx(0.533, abs=1e-3)


def test_only_known_parameters_and_degrees_become_radians() -> None:
    assert from_px4({"MC_YAWRATE_MAX": 90.0, "SYS_AUTOSTART": 4011.0}) == {
        "MC_YAWRATE_MAX": pytest.approx(np.pi / 2)
    }


@pytest.mark.slow
def test_hover_thrust_follows_the_curve_of_the_thrust() -> None:
    vehicle = load_vehicle("copter_default")
    trim = airframe(vehicle).input_values()[0]
    for factor in (0.0, 0.5):
        control = px4_controller(vehicle, {"THR_MDL_FAC": factor})
        hover = {v.name: v.start for v in control.parameters}["MPC_THR_HOVER"]
        assert hover == pytest.approx(factor * trim**2 + (1 - factor) * trim)
    given = px4_controller(vehicle, {"MPC_THR_HOVER": 0.4})
    assert {v.name: v.start for v in given.parameters}["MPC_THR_HOVER"] == 0.4


@pytest.mark.slow
@pytest.mark.parametrize("name", FLOWN)
def test_hovers_with_the_parameters_of_a_log(name: str, data_dir: Path) -> None:
    vehicle = load_vehicle(name)
    control = px4_controller_of_log(vehicle, data_dir / "rflysimdt" / "real_1.ulg")
    flown = closed_loop(vehicle, "hover", control=control)
    assert flown.miss_m.max() < 0.15
    assert flown.miss_m[-1] < 0.01
    assert flown.saturated_s < 0.2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "own"), [("copter_default", False), ("copter_default", True), ("feisi_x150", True)]
)
def test_flies_a_step(name: str, own: bool, data_dir: Path) -> None:
    """1 m north and 0.5 m up with PX4's defaults and with the gains of a log.

    PX4's default rate gains shake the Feisi, whose modelled rotors have no lag: its log has less
    than half of them.
    """
    vehicle = load_vehicle(name)
    log = data_dir / "rflysimdt" / "real_1.ulg"
    control = px4_controller_of_log(vehicle, log) if own else px4_controller(vehicle)
    body = airframe(vehicle).with_starts({"ground.enabled": 0.0, "initial.pos_z": 0.0})
    setpoints = np.tile([1.0, 0.0, -0.5] + [0.0] * 6 + [0.8, 1.0], (10_000, 1))
    states, inputs = fly(body, control, setpoints)
    names = [s.name for s in body.states]
    pos = states[:, [names.index(f"pos_{a}") for a in "xyz"]]
    assert np.linalg.norm(pos[-1] - [1.0, 0.0, -0.5]) < 0.02
    assert pos[:, 0].max() < 1.4
    assert np.abs(pos[:, 1]).max() < 0.1
    heading = 2 * np.arctan2(states[-1, names.index("q_z")], states[-1, names.index("q_w")])
    assert heading == pytest.approx(0.8, abs=0.02)
    # The last second is calm: no oscillation of the rate loop.
    assert np.ptp(inputs[-1000:, :4], axis=0).max() < 0.02


def test_a_vehicle_known_by_rotor_speed_is_refused() -> None:
    vehicle = with_rotors(load_vehicle("copter_default"), speed_rad_s=None, lag_up_s=0.0)
    with pytest.raises(ModelError, match="rotors want speeds"):
        px4_controller(vehicle)
