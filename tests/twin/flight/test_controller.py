"""The controller derived from the airframe: stable, any heading and tilt, limits, saturation."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from rig import BUILTIN, FULL_INERTIA, Rig, in_air, plain, q, vec, with_rotors
from scipy.spatial.transform import Rotation

from twin.component import Component, ComponentBuilder
from twin.errors import ModelError
from twin.flight.closed_loop import SETPOINTS, fly
from twin.flight.control_laws import (
    _steady_thrust_n,
    attitude_error,
    desired_axes,
    linearise,
    thrust_inverse,
)
from twin.flight.lqr import controller, design, mix
from twin.frames import from_euler
from twin.physics.airframe import airframe
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]
ANGLE = np.radians(30 + 60 * np.arange(6))
HEXA = with_rotors(
    plain(),
    position_m=np.stack([0.2 * np.cos(ANGLE), 0.2 * np.sin(ANGLE), 0 * ANGLE], axis=-1),
    direction=np.array([1.0, -1, 1, -1, 1, -1]),
)
BY_SPEED = with_rotors(
    plain(),
    from_speed=True,
    thrust_n=(0.0, 0.0, 8e-6),
    torque_n_m=(0.0, 0.0, 1.3e-7),
    lag_up_s=0.0,
    lag_down_s=0.0,
)
VEHICLES = {
    **{name: load_vehicle(name) for name in BUILTIN},
    "hexacopter": HEXA,
    "full inertia": plain(inertia_kg_m2=FULL_INERTIA),
    "three times the mass": replace(load_vehicle("copter_default"), mass_kg=3.0),
    "known by rotor speed": BY_SPEED,
}
ORIGIN = np.array([0.0] * 10 + [1.0])
"""Setpoint: the origin, nose north, armed."""


def unbounded(vehicle: Vehicle, state: dict[str, float]) -> Component:
    """The airframe without ground, started in a state."""
    start = {f"initial.{n}": v for n, v in state.items()}
    return airframe(vehicle).with_starts({"ground.enabled": 0.0, **start})


def fly_to_origin(
    vehicle: Vehicle, state: dict[str, float], seconds: float, yaw: float = 0.0
) -> Array:
    """States under control."""
    setpoints = np.tile(ORIGIN, (round(seconds / 1e-3), 1))
    setpoints[:, 9] = yaw
    return fly(unbounded(vehicle, state), controller(vehicle), setpoints)[0]


@pytest.mark.parametrize("name", VEHICLES)
def test_all_poles_are_stable_and_damped(name: str) -> None:
    gains = design(linearise(VEHICLES[name]))
    for chain in (gains.horizontal, gains.vertical, gains.heading):
        assert chain.poles.real.max() < -0.2
        ratio = -chain.poles.real / np.abs(chain.poles)
        assert ratio.min() > 0.4  # no oscillation to speak of


@pytest.mark.slow
@pytest.mark.parametrize("name", VEHICLES)
def test_whole_loop_has_the_poles_of_its_chains(name: str) -> None:
    """Airframe and cascade, linearised together about hover, against the Riccati designs."""
    vehicle = VEHICLES[name]
    rig, control = in_air(vehicle), controller(vehicle)
    x, c = ca.SX.sym("x", len(rig.names)), ca.SX.sym("c", len(control.states))
    y = rig.component.outputs(x, rig.inputs(), rig.p)
    sources = {n: y[i] for i, n in enumerate(rig.component.output_names)}
    sources |= {n: ca.SX(v) for n, v in zip(SETPOINTS, ORIGIN, strict=True)}
    sensed = ca.vertcat(*[sources[n] for n in control.input_names])
    p = control.parameter_values()
    u = ca.SX(rig.inputs())
    u[: vehicle.rotors.count] = control.outputs(c, sensed, p)
    both = ca.vertcat(x, c)
    rate = ca.vertcat(rig.component.derivatives(x, u, rig.p), control.derivatives(c, sensed, p))
    jacobian = ca.Function("j", [both], [ca.jacobian(rate, both)])
    start = np.concatenate([rig.state(pos_z=0.0), np.zeros(len(control.states))])
    if linearise(vehicle).lag_s > 0:
        start[len(rig.names) + 4] = 9.80665  # lift of the modelled rotors
    a = np.asarray(jacobian(start), dtype=np.float64)
    # The norm of the quaternion is no motion, q_w stays where it is.
    keep = [i for i in range(len(start)) if i != rig.names.index("q_w")]
    found = np.linalg.eigvals(a[np.ix_(keep, keep)])
    assert found.real.max() < -0.2, found
    gains = design(linearise(vehicle))
    for pole in (*gains.vertical.poles, *gains.heading.poles):
        # The horizontal chain has one gain for two unlike axes, the Crazyflie an inverse thrust
        # map that is a fit.
        near = 0.1 if name == "crazyflie" else 1e-3
        assert np.abs(found - pole).min() < near * abs(pole), (pole, found)


@pytest.mark.slow
@pytest.mark.parametrize("name", VEHICLES)
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_comes_back_from_a_push(name: str, yaw: float) -> None:
    vehicle = VEHICLES[name]
    state = {
        **vec("pos", [1.0, -0.5, 0.3]),
        **vec("vel", [0.5, 0.5, -0.3]),
        **q(from_euler(0.2, -0.2, yaw)),
    }
    states = fly_to_origin(vehicle, state, 15.0)
    rig = Rig(airframe(vehicle))
    assert np.linalg.norm(rig.vector(states[-1], "pos")) < 0.02
    assert np.linalg.norm(rig.vector(states[-1], "vel")) < 0.02
    turned = Rotation.from_quat(np.roll(rig.vector(states[-1], "q"), -1))
    assert turned.magnitude() < 0.02  # the heading is north again


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILTIN)
@pytest.mark.parametrize("roll_deg", [70.0, 150.0])
def test_recovers_from_a_large_tilt(name: str, roll_deg: float) -> None:
    states = fly_to_origin(VEHICLES[name], q(from_euler(np.radians(roll_deg), 0.3, -1.0)), 20.0)
    rig = Rig(airframe(VEHICLES[name]))
    assert np.linalg.norm(rig.vector(states[-1], "pos")) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILTIN)
def test_far_setpoint_is_reached_within_the_tilt_limit_and_without_much_overshoot(
    name: str,
) -> None:
    states = fly_to_origin(VEHICLES[name], vec("pos", [-10.0, 0.0, 0.0]), 20.0)
    rig = Rig(airframe(VEHICLES[name]))
    assert rig.get(states, "pos_x").max() < 1.0
    assert abs(rig.get(states, "pos_x")[-1]) < 0.05
    assert np.abs(rig.get(states, "pos_z")).max() < 0.3
    x, y = rig.get(states, "q_x", "q_y").T
    assert np.arccos(1 - 2 * (x**2 + y**2)).max() < 0.7 + 0.1  # the limit and some overshoot


@pytest.mark.slow
def test_flight_is_the_same_at_any_heading() -> None:
    """Equal roll and pitch inertia: turned by 1.1 rad, the flight is the same one turned."""
    vehicle = plain(inertia_kg_m2=np.diag([0.02, 0.02, 0.036]))
    offset, yaw = np.array([1.5, -1.0, 0.2]), 1.1
    turn = Rotation.from_euler("Z", yaw)
    one = fly_to_origin(vehicle, vec("pos", offset), 4.0)
    other = fly_to_origin(
        vehicle, {**vec("pos", turn.apply(offset)), **q(from_euler(0, 0, yaw))}, 4.0, yaw
    )
    rig = Rig(airframe(vehicle))
    np.testing.assert_allclose(
        rig.vector(other, "pos"), turn.apply(rig.vector(one, "pos")), atol=1e-9
    )


def answer(control: Component, **inputs: float) -> Array:
    """Outputs at the start, from inputs by name; at the origin, level, armed."""
    u = control.input_values({"armed": 1.0, **inputs})
    p = control.parameter_values()
    x = np.asarray(control.initial(u, p))
    return np.asarray(control.outputs(x, u, p), dtype=np.float64).ravel()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["feisi_x150", "known by rotor speed"])
def test_hover_command_is_the_trim_and_disarmed_is_zero(name: str) -> None:
    """Without lag there is nothing to lead."""
    component = airframe(VEHICLES[name])
    control = controller(VEHICLES[name])
    np.testing.assert_allclose(answer(control), component.input_values()[:4], rtol=1e-9)
    np.testing.assert_array_equal(answer(control, armed=0.0), np.zeros(4))


def test_sign_of_the_quaternion_means_nothing() -> None:
    control = controller(load_vehicle("copter_default"))
    attitude = from_euler(0.1, -0.2, 0.3)
    one, other = (answer(control, **q(s * attitude)) for s in (1.0, -1.0))
    np.testing.assert_allclose(one, other, atol=1e-14)


def test_commands_stay_within_their_range() -> None:
    control = controller(load_vehicle("crazyflie"))
    for z in (-100.0, 100.0):
        for omega in (-60.0, 0.0, 60.0):
            commands = answer(control, pos_z=z, omega_x=omega, omega_z=-omega)
            assert commands.min() > 0.0
            assert commands.max() < 1.0 + 1e-6


def test_mixer_gives_up_yaw_first_and_roll_last() -> None:
    vehicle = load_vehicle("feisi_x150")
    hover, inverse = linearise(vehicle), thrust_inverse(vehicle)
    m = ComponentBuilder("mixer", "Mixer alone")
    wanted = [m.input(n, "1", n) for n in ("lift", "roll", "pitch", "yaw")]
    mixed = mix(m, design(hover).mixer_n, inverse, "1", wanted[0], wanted[1:])
    for i, value in enumerate([*mixed.inputs, mixed.lift, *mixed.angular]):
        m.output(f"y{i}", "1", "Result", value)
    part = m.build()

    def result(*values: float) -> tuple[Array, Array]:
        y = np.asarray(part.outputs([], values, part.parameter_values()), dtype=np.float64).ravel()
        root = np.polynomial.polynomial.polyval(0.0, inverse.coefficients)
        command = np.maximum(y[:4], root)
        thrust = np.polynomial.polynomial.polyval(command, vehicle.rotors.thrust_n)
        return hover.effect @ thrust, y[4:]

    for easy in ((9.8, 5.0, -3.0, 1.0), (12.0, 0.0, 0.0, 0.0), (9.8, 0.0, 20.0, -2.0)):
        given, told = result(*easy)
        np.testing.assert_allclose(given, easy, atol=1e-8)
        np.testing.assert_allclose(told, easy, atol=1e-12)
    given, told = result(9.8, 100.0, 0.0, 60.0)  # yaw is cut, the rest as wanted
    np.testing.assert_allclose(given, told, atol=1e-8)
    np.testing.assert_allclose(given[:3], [9.8, 100.0, 0.0], atol=1e-8)
    assert 0 <= given[3] < 60.0
    given, told = result(18.0, 60.0, 0.0, 10.0)  # too much lift for that roll
    np.testing.assert_allclose(given, told, atol=1e-8)
    assert given[0] < 18.0
    assert given[1] == pytest.approx(60.0)
    given, told = result(9.8, 1e4, 0.0, 0.0)  # more roll than there is
    np.testing.assert_allclose(given, told, atol=1e-7)
    assert 100.0 < given[1] < 1e4


@pytest.mark.parametrize("name", VEHICLES)
def test_inverse_thrust_map(name: str) -> None:
    """Command of a thrust, and back through the vehicle's maps."""
    vehicle = VEHICLES[name]
    inverse, rotors = thrust_inverse(vehicle), vehicle.rotors
    thrust = np.linspace(inverse.idle_n, inverse.full_n, 400)
    level = np.polynomial.polynomial.polyval(np.sqrt(thrust / inverse.full_n), inverse.coefficients)
    if rotors.speed_rad_s:
        level = np.polynomial.polynomial.polyval(level, rotors.speed_rad_s)
    back = np.polynomial.polynomial.polyval(level, rotors.thrust_n)
    off = np.abs(back - thrust).max()
    exact = name != "crazyflie"  # a cubic of the command has no such inverse
    assert off < (1e-6 * inverse.full_n if exact else 0.004 * inverse.hover_n)
    assert (np.diff(inverse.input(thrust)) > 0.0).all()
    low, high = inverse.bounds
    assert 0 < low < high
    if vehicle.drive == "command":
        assert high == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("slope", [-0.75, -0.3, 0.6, 2.0])
@pytest.mark.parametrize("name", ["copter_default", "crazyflie", "feisi_x150"])
def test_inverse_thrust_map_with_a_curve(name: str, slope: float) -> None:
    """Rises everywhere and is right from idle to full thrust, where the map is flat as well."""
    vehicle = load_vehicle(name).with_effects({"thrust_curve": {"slope": slope}})
    inverse = thrust_inverse(vehicle)
    thrust = np.linspace(inverse.idle_n, inverse.full_n, 400)
    driven = inverse.input(thrust)
    assert (np.diff(driven) > 0.0).all()
    back = _steady_thrust_n(airframe(vehicle), vehicle, driven).mean(axis=1)
    assert np.abs(back - thrust).max() < 0.02 * inverse.hover_n
    assert inverse.bounds[1] == pytest.approx(1.0, abs=1e-6)


def test_a_thrust_map_that_no_polynomial_inverts_is_refused() -> None:
    """Thrust that hardly depends on the command."""
    vehicle = load_vehicle("crazyflie").with_effects({"thrust_curve": {"slope": -0.9}})
    with pytest.raises(ModelError, match=r"to 30.*% of the hover thrust, 3% is needed"):
        thrust_inverse(vehicle)


@pytest.mark.parametrize("slope", [-1.0, -1.2])
@pytest.mark.parametrize("name", ["copter_default", "crazyflie"])
def test_thrust_that_does_not_rise_with_the_command_is_refused(name: str, slope: float) -> None:
    vehicle = load_vehicle(name).with_effects({"thrust_curve": {"slope": slope}})
    with pytest.raises(ModelError, match=f"{name}: .*thrust_curve.slope = {slope:g}"):
        linearise(vehicle)


WEAK = {
    "thrust_scale": {"scale": 0.59},
    "thrust_curve": {"slope": -0.3},
    "rotor_efficiency_loss": {
        "loss_1": 0.15,
        "loss_2": 0.0,
        "loss_3": 0.0,
        "loss_4": 0.05,
        "torque_share": 1.0,
    },
}
"""As an explanation of flights may have it: well above the weight, far from the file's map."""


def test_hover_command_is_that_of_the_rotors_with_their_effects() -> None:
    """A controller that trusts the file's map commands 0.59 of the weight, and stays down."""
    weak = load_vehicle("crazyflie").with_effects(WEAK)
    flown = Rig(controller(weak)), Rig(airframe(weak))
    settled = flown[0].state({"lift": weak.gravity_m_s2})
    outputs = flown[0].outputs(settled, flown[0].inputs(armed=1.0, q_w=1.0))
    given = [outputs[f"cmd_{i}"] for i in range(1, 5)]
    trim = flown[1].inputs()[
        [flown[1].component.input_names.index(f"cmd_{i}") for i in range(1, 5)]
    ]
    np.testing.assert_allclose(given, trim, rtol=0.01)


def test_attitude_error_is_the_rotation_in_body_axes() -> None:
    """Against SciPy for a turn of tilt, then heading; small and large."""
    rng = np.random.default_rng(0)
    attitude = [ca.SX.sym(f"q{i}") for i in range(4)]
    up, yaw = [ca.SX.sym(f"u{i}") for i in range(3)], ca.SX.sym("yaw")
    error = attitude_error(attitude, *desired_axes(up, yaw))
    f = ca.Function("f", [*attitude, *up, yaw], [ca.vertcat(*error)])
    for _ in range(200):
        roll, pitch, heading = rng.uniform([-1.2, -1.2, -3.1], [1.2, 1.2, 3.1])
        wanted = Rotation.from_quat(np.roll(from_euler(roll, pitch, heading), -1))
        now = Rotation.random(random_state=int(rng.integers(1 << 30)))
        if rng.random() < 0.5:
            now = wanted * Rotation.from_rotvec(rng.normal(size=3) * 0.3)
        back = (now.inv() * wanted).as_quat()
        value = np.asarray(
            f(*np.roll(now.as_quat(), 1), *wanted.apply([0, 0, -1.0]), heading)
        ).ravel()
        # The heading of a desired attitude is where its nose points, seen from above.
        nose = wanted.apply([1.0, 0.0, 0.0])
        if abs(np.arctan2(nose[1], nose[0]) - heading) < 1e-9:
            np.testing.assert_allclose(value, 2 * np.sign(back[3]) * back[:3], atol=1e-7)


def test_rotors_that_cannot_turn_the_vehicle_are_refused() -> None:
    """All spin the same way round and have no arm sideways: no roll."""
    flat = np.array([[0.16, 0, 0], [-0.16, 0, 0], [0.08, 0, 0], [-0.08, 0, 0]])
    with pytest.raises(ModelError, match="turn it about all axes"):
        linearise(with_rotors(plain(), position_m=flat))
