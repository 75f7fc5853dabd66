"""The controller derived from the airframe: stable, and blind to heading and quaternion sign."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from rig import BUILTIN, FULL_INERTIA, Rig, in_air, plain, q, vec, with_rotors
from scipy.spatial.transform import Rotation

from twin.airframe import airframe
from twin.controller import feedback, lqr
from twin.frames import from_euler
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle

ANGLE = np.radians(30 + 60 * np.arange(6))
HEXA = with_rotors(
    plain(),
    position_m=np.stack([0.2 * np.cos(ANGLE), 0.2 * np.sin(ANGLE), 0 * ANGLE], axis=-1),
    direction=np.array([1.0, -1, 1, -1, 1, -1]),
)
VEHICLES = {
    **{name: load_vehicle(name) for name in BUILTIN},
    "hexacopter": HEXA,
    "full inertia": plain(inertia_kg_m2=FULL_INERTIA),
    "three times the mass": replace(load_vehicle("copter_default"), mass_kg=3.0),
}


@pytest.mark.parametrize("name", VEHICLES)
def test_all_poles_are_stable_and_damped(name: str) -> None:
    design = lqr(airframe(VEHICLES[name]))
    assert design.poles.real.max() < -0.2
    ratio = -design.poles.real / np.abs(design.poles)
    assert ratio.min() > 0.4  # no oscillation to speak of
    assert design.trim.min() > 0.0


def fly_to_origin(vehicle: Vehicle, start: dict[str, float], seconds: float) -> np.ndarray:
    """States under feedback, setpoint the origin."""
    rig = in_air(vehicle)
    control = feedback(lqr(rig.component), rig.component)
    both = ca.SX.sym("both", len(rig.names) + 3)
    x, integral = both[: len(rig.names)], both[len(rig.names) :]
    u, rate = control(x, integral, np.zeros(6), rig.inputs())
    step = rig.component.step(x, u, rig.p, 1e-3)
    run = ca.Function("run", [both], [ca.vertcat(step, integral + 1e-3 * rate)])
    x0 = np.concatenate([rig.state(start), np.zeros(3)])
    n = round(seconds / 1e-3)
    return np.asarray(run.mapaccum("fly", n)(x0), dtype=np.float64).T[:, : len(rig.names)]


@pytest.mark.parametrize("name", VEHICLES)
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_comes_back_from_a_push(name: str, yaw: float) -> None:
    vehicle = VEHICLES[name]
    start = {
        **vec("pos", [1.0, -0.5, 0.3]),
        **vec("vel", [0.5, 0.5, -0.3]),
        **q(from_euler(0.2, -0.2, yaw)),
    }
    states = fly_to_origin(vehicle, start, 25.0)
    rig = Rig(airframe(vehicle))
    assert np.linalg.norm(rig.vector(states[-1], "pos")) < 0.01
    assert np.linalg.norm(rig.vector(states[-1], "vel")) < 0.01
    turned = Rotation.from_quat(np.roll(rig.vector(states[-1], "q"), -1))
    assert turned.magnitude() < 0.02  # the heading is held north


def test_command_is_the_same_at_any_heading_but_for_the_yaw_error() -> None:
    """Errors turned with the vehicle: the difference in commands is that of the heading alone."""
    component = airframe(load_vehicle("feisi_x150"))
    rig, design = Rig(component), lqr(component)
    control = feedback(design, component)

    def command(yaw: float, position: np.ndarray) -> np.ndarray:
        x = rig.state({**q(from_euler(0.0, 0.0, yaw)), **vec("pos", position)})
        u, _ = control(x, np.zeros(3), np.zeros(6), rig.inputs())
        return np.asarray(u, dtype=np.float64).ravel()[:4]

    offset, yaw = np.array([0.1, -0.05, 0.02]), 0.9
    turned = Rotation.from_euler("Z", yaw).apply(offset)
    by_position = command(yaw, turned) - command(yaw, np.zeros(3))
    np.testing.assert_allclose(
        by_position, command(0.0, offset) - command(0.0, np.zeros(3)), atol=1e-12
    )


def test_sign_of_the_quaternion_means_nothing() -> None:
    component = airframe(load_vehicle("copter_default"))
    rig = Rig(component)
    control = feedback(lqr(component), component)
    attitude = from_euler(0.1, -0.2, 0.3)
    commands = [
        np.asarray(control(rig.state(q(s * attitude)), np.zeros(3), np.zeros(6), rig.inputs())[0])
        for s in (1.0, -1.0)
    ]
    np.testing.assert_allclose(commands[0], commands[1], atol=1e-14)


def test_commands_stay_within_0_and_1_and_other_inputs_as_they_are() -> None:
    component = airframe(load_vehicle("crazyflie"))
    rig = Rig(component)
    control = feedback(lqr(component), component)
    for far in (-100.0, 100.0):
        held = rig.inputs({"wind_x": 3.0, "vbat_v": 3.7})
        u, rate = control(rig.state(pos_z=far), np.zeros(3), np.zeros(6), held)
        values = dict(zip(component.input_names, np.asarray(u).ravel().tolist(), strict=True))
        assert {values[f"cmd_{i}"] for i in range(1, 5)} == {0.0 if far < 0 else 1.0}
        assert (values["wind_x"], values["vbat_v"]) == (3.0, 3.7)
        assert np.asarray(rate).ravel()[2] == far
