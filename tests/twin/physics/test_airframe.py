"""The rigid body against exact solutions, conservation laws, symmetries and signs."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import BUILTIN, FULL_INERTIA, Array, Rig, in_air, plain, q, vec, with_rotors
from scipy.spatial.transform import Rotation
from scipy.special import ellipj

from twin.errors import ModelError
from twin.frames import from_euler, rotation_matrix
from twin.physics.airframe import airframe, hover_trim
from twin.vehicle import GRAVITY_M_S2
from twin.vehicle_file import load_vehicle

FREE = plain(inertia_kg_m2=FULL_INERTIA)
angles = st.floats(-3.1, 3.1)


@pytest.fixture(scope="module")
def free() -> Rig:
    """A body without drag, its rotors at rest and off unless a test says otherwise."""
    return in_air(FREE)


def at_rest(rig: Rig, **changes: float) -> Array:
    off = {n: 0.0 for n in rig.names if n.startswith("effort_")}
    return rig.state({**off, **changes})


def matrices(rig: Rig, states: Array) -> Array:
    w, x, y, z = rig.vector(states, "q").T
    return np.asarray(Rotation.from_quat(np.stack([x, y, z, w], axis=-1)).as_matrix())


# -- integration --------------------------------------------------------------------------


def test_order_of_convergence_is_four() -> None:
    """Tumbling with full inertia matrix, linear drag and rotors that are still speeding up."""
    rig = in_air(
        plain(inertia_kg_m2=FULL_INERTIA, drag_linear_n_s_m=np.array([0.3, 0.5, 0.9])),
    )
    x = at_rest(rig, **vec("omega", [3.0, -4.0, 5.0]), **vec("vel", [4.0, -3.0, 1.0]))
    u = rig.commands([0.5, 0.45, 0.47, 0.52], wind_x=2.0)
    seconds = 1.28
    exact = rig.fly(x, u, seconds, 0.02 / 64)[-1]
    steps = 0.02 / 2.0 ** np.arange(4)
    errors = np.array([np.abs(rig.fly(x, u, seconds, h)[-1] - exact) for h in steps])
    for group in ("pos", "vel", "q", "omega"):
        size = np.linalg.norm(rig.vector(errors, group), axis=1)
        orders = np.log2(size[:-1] / size[1:])
        assert np.all((orders > 3.7) & (orders < 4.2)), (group, orders, size)


@pytest.mark.slow
def test_torque_free_spin_conserves_energy_and_momentum(free: Rig) -> None:
    x = at_rest(free, **vec("omega", [2.0, -3.0, 4.0]))
    states = free.fly(x, free.commands(0.0), 60.0)
    omega = free.vector(states, "omega")
    momentum_b = omega @ FULL_INERTIA
    energy = np.sum(omega * momentum_b, axis=1)
    momentum_n = np.einsum("kij,kj->ki", matrices(free, states), momentum_b)
    length = np.linalg.norm(momentum_n[0])
    assert np.max(np.abs(energy / energy[0] - 1)) < 1e-8
    assert np.max(np.linalg.norm(momentum_n - momentum_n[0], axis=1)) / length < 1e-8
    assert np.max(np.abs(np.linalg.norm(free.vector(states, "q"), axis=1) - 1)) < 1e-15 * 4
    assert np.ptp(omega[:, 0]) > 1.0  # it does tumble


def test_torque_free_spin_follows_the_jacobi_elliptic_functions() -> None:
    """Euler's top. Source: Landau & Lifshitz, Mechanics, 3rd ed., sec. 37."""
    i1, i2, i3 = 0.020, 0.027, 0.036
    w1, w3 = 1.5, 4.0
    energy2, momentum2 = i1 * w1**2 + i3 * w3**2, (i1 * w1) ** 2 + (i3 * w3) ** 2
    assert momentum2 > energy2 * i2  # the case with dn about the largest axis
    rate = np.sqrt((i3 - i2) * (momentum2 - energy2 * i1) / (i1 * i2 * i3))
    modulus2 = (i2 - i1) * (energy2 * i3 - momentum2) / ((i3 - i2) * (momentum2 - energy2 * i1))
    rig = in_air(plain())
    states = rig.fly(at_rest(rig, omega_x=w1, omega_z=w3), rig.commands(0.0), 10.0)
    sn, cn, dn, _ = ellipj(rate * 1e-3 * np.arange(len(states)), modulus2)
    w2 = np.sqrt((energy2 * i3 - momentum2) / (i2 * (i3 - i2)))
    exact = np.stack([w1 * cn, w2 * sn, w3 * dn], axis=-1)
    np.testing.assert_allclose(rig.vector(states, "omega"), exact, atol=1e-9)


def test_symmetric_top_precesses_about_its_angular_momentum() -> None:
    """Attitude: R(t) = turn about the momentum at L / J_t, then about the body axis."""
    j_t, j_z, p, r = 0.02, 0.035, 2.0, 5.0
    rig = in_air(plain(inertia_kg_m2=np.diag([j_t, j_t, j_z])))
    states = rig.fly(at_rest(rig, omega_x=p, omega_z=r), rig.commands(0.0), 5.0)
    momentum = np.array([j_t * p, 0.0, j_z * r])
    t = 1e-3 * np.arange(len(states))[:, None]
    turn = Rotation.from_rotvec(momentum / j_t * t)
    spin = Rotation.from_rotvec(np.array([0.0, 0.0, r * (1 - j_z / j_t)]) * t)
    np.testing.assert_allclose(matrices(rig, states), (turn * spin).as_matrix(), atol=1e-9)


def test_free_fall_is_exact(free: Rig) -> None:
    """A parabola: RK4 has no truncation error on it."""
    x = at_rest(free, **vec("vel", [3.0, -2.0, -5.0]), **vec("pos", [1.0, 2.0, -30.0]))
    end = free.fly(x, free.commands(0.0), 2.0)[-1]
    np.testing.assert_allclose(free.vector(end, "vel"), [3, -2, -5 + 2 * GRAVITY_M_S2], rtol=1e-12)
    fallen = -30 - 10 + 2 * GRAVITY_M_S2
    np.testing.assert_allclose(free.vector(end, "pos"), [7.0, -2.0, fallen], rtol=1e-12)


def test_linear_drag_against_exact_solution() -> None:
    """m dv/dt = m g - c (v - wind), the same at any attitude when the drag is isotropic."""
    c, mass, wind, t_s = 0.8, 1.2, np.array([3.0, -2.0, 1.0]), 1.5
    rig = in_air(plain(drag_linear_n_s_m=np.full(3, c)))
    x = at_rest(rig, **q(from_euler(0.5, -0.7, 2.0)), **vec("vel", [5.0, 0.0, 0.0]))
    states = rig.fly(x, rig.commands(0.0, **vec("wind", wind)), t_s)
    final = wind + np.array([0.0, 0.0, mass * GRAVITY_M_S2 / c])
    away = np.array([5.0, 0.0, 0.0]) - final
    decay = np.exp(-c * t_s / mass)
    np.testing.assert_allclose(rig.vector(states[-1], "vel"), final + away * decay, rtol=1e-11)
    moved = final * t_s + away * mass / c * (1 - decay)
    np.testing.assert_allclose(rig.vector(states[-1] - states[0], "pos"), moved, rtol=1e-11)


def test_quadratic_drag_against_exact_solution() -> None:
    """Fall from rest: v = vt tanh(g t / vt), the depth its integral."""
    c, mass = 0.4, 1.2
    rig = in_air(plain(drag_quadratic_n_s2_m2=np.array([0.0, 0.0, c])))
    states = rig.fly(at_rest(rig), rig.commands(0.0), 2.0)
    terminal = np.sqrt(mass * GRAVITY_M_S2 / c)
    t = 1e-3 * np.arange(len(states))
    speed = terminal * np.tanh(GRAVITY_M_S2 * t / terminal)
    np.testing.assert_allclose(rig.get(states, "vel_z")[:, 0], speed, rtol=1e-10)
    depth = terminal**2 / GRAVITY_M_S2 * np.log(np.cosh(GRAVITY_M_S2 * t / terminal)) - 10.0
    np.testing.assert_allclose(rig.get(states, "pos_z")[:, 0], depth, rtol=1e-10)


def test_drag_acts_along_body_axes_against_the_air() -> None:
    """Turned 90 degrees nose east, an east wind component meets the forward coefficient."""
    rig = in_air(plain(drag_linear_n_s_m=np.array([0.6, 0.2, 0.1])))
    x = at_rest(rig, **q(from_euler(0, 0, np.pi / 2)), vel_y=4.0)
    y = rig.outputs(x, rig.commands(0.0, wind_y=1.0))
    assert y["specific_force_x"] == pytest.approx(-0.6 * 3.0 / 1.2, rel=1e-12)
    assert y["specific_force_y"] == pytest.approx(0.0, abs=1e-12)


# -- gravity ------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_gravity_stays_down_in_hover_at_30_degrees_of_tilt(free: Rig, axis: str) -> None:
    """The test of equation 5: weight-sized thrust at 30 degrees sinks at g (1 - cos 30)."""
    tilt = np.radians(30.0)
    attitude = from_euler(tilt, 0, 0) if axis == "roll" else from_euler(0, tilt, 0)
    rates = free.rates(free.state(q(attitude)), free.inputs())
    assert rates["vel_z"] == pytest.approx(GRAVITY_M_S2 * (1 - np.cos(tilt)), rel=1e-9)
    east, north = rates["vel_y"], rates["vel_x"]
    side = GRAVITY_M_S2 * np.sin(tilt)
    # Rolled right it slides right (east); pitched up it slides back (south).
    expected = (0.0, side) if axis == "roll" else (-side, 0.0)
    np.testing.assert_allclose((north, east), expected, atol=1e-9)


@given(roll=angles, pitch=angles, yaw=angles, thrust=st.floats(0.0, 1.0))
@settings(max_examples=60, deadline=None)
def test_acceleration_is_gravity_down_plus_thrust_along_the_rotor_axis(
    roll: float, pitch: float, yaw: float, thrust: float
) -> None:
    rig = _FREE_RIG
    x = rig.state(
        {**q(from_euler(roll, pitch, yaw)), **{f"effort_{i}": thrust for i in range(1, 5)}}
    )
    rates, y = rig.rates(x, rig.inputs()), rig.outputs(x, rig.inputs())
    up_n = Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply([0.0, 0.0, -1.0])
    expected = np.array([0, 0, GRAVITY_M_S2]) + up_n * 4 * 8.0 * thrust / 1.2
    np.testing.assert_allclose([rates[f"vel_{a}"] for a in "xyz"], expected, atol=1e-11)
    # An accelerometer does not feel gravity.
    felt = [y[f"specific_force_{a}"] for a in "xyz"]
    np.testing.assert_allclose(felt, [0, 0, -32.0 * thrust / 1.2], atol=1e-12)


_FREE_RIG = in_air(FREE)


# -- moments ------------------------------------------------------------------------------


@pytest.mark.parametrize("vehicle", BUILTIN)
@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_each_rotor_turns_the_body_the_right_way(vehicle: str, rotor: int) -> None:
    """A stronger rotor lifts its own corner, and yaws the body against its own spin."""
    v = load_vehicle(vehicle)
    rig = in_air(v)
    x, u = rig.state(), rig.inputs()
    more_x, more_u = x.copy(), u.copy()
    states = [i for i, n in enumerate(rig.names) if n.startswith(("rotor_", "effort_"))]
    if states:
        more_x[states[rotor - 1]] *= 1.1
    else:
        more_u[rotor - 1] *= 1.1
    rates = rig.rates(more_x, more_u)
    forward, right, _ = v.rotors.position_m[rotor - 1]
    assert np.sign(rates["omega_x"]) == -np.sign(right)  # a left rotor rolls it right
    assert np.sign(rates["omega_y"]) == np.sign(forward)  # a front rotor pitches it up
    assert np.sign(rates["omega_z"]) == -v.rotors.direction[rotor - 1]  # ccw rotor: clockwise yaw
    # Sizes: lever arm times thrust, torque map.
    extra = rig.outputs(more_x, more_u)[f"thrust_{rotor}"] - rig.outputs(x, u)[f"thrust_{rotor}"]
    assert rates["omega_x"] == pytest.approx(-right * extra / v.inertia_kg_m2[0, 0], rel=1e-6)
    assert rates["omega_y"] == pytest.approx(forward * extra / v.inertia_kg_m2[1, 1], rel=1e-6)
    ratio = v.rotors.torque_n_m[-1] / v.rotors.thrust_n[-1]
    assert abs(rates["omega_z"]) == pytest.approx(ratio * extra / v.inertia_kg_m2[2, 2], rel=1e-6)


def test_front_left_rotor_by_name() -> None:
    """Spelled out once, without the formula: PX4's motor 3, front left, clockwise."""
    rig = in_air(load_vehicle("copter_default"))
    u = rig.inputs()
    u[2] += 0.05
    end = rig.fly(rig.state(), u, 0.3)[-1]
    roll_rate, pitch_rate, yaw_rate = rig.vector(end, "omega")
    assert roll_rate > 0.1  # right side down
    assert pitch_rate > 0.1  # nose up
    assert yaw_rate < -0.01  # clockwise rotor: nose to the left


def test_spinning_rotors_make_a_gyroscopic_torque() -> None:
    """Momentum H about body z: M = -omega x H e_z; rolling right with H > 0 pitches up."""
    v = load_vehicle("copter_default")
    rig = in_air(v, "rotor_speed")
    speeds = np.array([300.0, 320.0, 700.0, 680.0])  # clockwise pair faster: H > 0
    spin = v.rotors.spin_inertia_kg_m2 * float(v.rotors.direction @ speeds)
    assert spin > 0
    u = rig.commands(speeds)
    still = rig.rates(rig.state(), u)
    rolling = rig.rates(rig.state(omega_x=2.0), u)
    change = rolling["omega_y"] - still["omega_y"]
    assert change == pytest.approx(2.0 * spin / v.inertia_kg_m2[1, 1], rel=1e-9)
    pitching = rig.rates(rig.state(omega_y=2.0), u)
    change = pitching["omega_x"] - still["omega_x"]
    assert change == pytest.approx(-2.0 * spin / v.inertia_kg_m2[0, 0], rel=1e-9)


def test_a_gyrostat_conserves_momentum_with_its_rotors() -> None:
    """Rotors spinning in a vacuum: J omega + H e_z stays put in space."""
    v = load_vehicle("copter_default")
    rig = in_air(v, "rotor_speed", **{"thrust.c2": 0.0, "torque.c2": 0.0})
    speeds = np.array([300.0, 320.0, 700.0, 680.0])
    spin = v.rotors.spin_inertia_kg_m2 * float(v.rotors.direction @ speeds)
    states = rig.fly(rig.state(vec("omega", [1.0, 2.0, -3.0])), rig.commands(speeds), 10.0)
    momentum_b = rig.vector(states, "omega") @ v.inertia_kg_m2 + np.array([0.0, 0.0, spin])
    momentum_n = np.einsum("kij,kj->ki", matrices(rig, states), momentum_b)
    drift = np.linalg.norm(momentum_n - momentum_n[0], axis=1) / np.linalg.norm(momentum_n[0])
    assert drift.max() < 1e-8
    without = np.einsum("kij,kj->ki", matrices(rig, states), momentum_b - [0.0, 0.0, spin])
    assert np.ptp(without, axis=0).max() > 0.1 * np.linalg.norm(momentum_n[0])


# -- symmetries ---------------------------------------------------------------------------


@pytest.mark.parametrize("yaw", [0.4, np.pi / 2, -2.7])
def test_turning_the_whole_problem_turns_the_answer(yaw: float) -> None:
    """Position, velocity, attitude and wind yawed together; with drag, and a hard landing.

    In the air equal to rounding; the feet that catch and slip amplify it by 1e7.
    """
    rig = Rig(airframe(load_vehicle("feisi_x150")))
    attitude, vel = from_euler(0.1, -0.15, 0.3), np.array([1.0, -0.5, 0.8])
    pos, wind = np.array([0.4, -0.7, -0.2]), np.array([2.0, 1.0, 0.5])
    turn = Rotation.from_euler("Z", yaw)

    def fly(R: Rotation, attitude: Array) -> Array:
        start = {**vec("vel", R.apply(vel)), **vec("pos", R.apply(pos))}
        x = rig.state({**q(attitude), **start, **vec("omega", [0.5, -0.3, 0.8])})
        return rig.fly(x, rig.inputs(vec("wind", R.apply(wind))), 0.8)

    one = fly(Rotation.identity(), attitude)
    two = fly(turn, np.roll((turn * Rotation.from_quat(np.roll(attitude, -1))).as_quat(), 1))
    touched = int(np.argmax(rig.get(one, "pos_z")[:, 0] > -0.08))
    assert 50 < touched < 400
    for span, atol in ((slice(0, touched), 1e-12), (slice(touched, None), 1e-6)):
        for stem in ("pos", "vel"):
            turned = turn.apply(rig.vector(one, stem)[span])
            np.testing.assert_allclose(rig.vector(two, stem)[span], turned, atol=atol)
        turned = turn.as_matrix() @ matrices(rig, one)[span]
        np.testing.assert_allclose(matrices(rig, two)[span], turned, atol=atol)


def test_steady_wind_is_a_moving_frame() -> None:
    """In a uniform wind everything happens as in still air, carried along."""
    rig = in_air(load_vehicle("feisi_x150"))
    wind, u = np.array([3.0, -1.0, 0.5]), rig.inputs()
    start = vec("omega", [0.4, 0.2, -0.5])
    still = rig.fly(rig.state(start), u, 1.0)
    carried = rig.fly(rig.state({**start, **vec("vel", wind)}), rig.inputs(vec("wind", wind)), 1.0)
    t = 1e-3 * np.arange(len(still))[:, None]
    shift = rig.vector(carried, "pos") - rig.vector(still, "pos")
    np.testing.assert_allclose(shift, wind * t, atol=1e-11)


def test_sign_of_the_quaternion_means_nothing(free: Rig) -> None:
    attitude = from_euler(0.3, -0.2, 1.0)
    rates = [free.rates(free.state(q(s * attitude)), free.inputs()) for s in (1.0, -1.0)]
    for name in ("vel_x", "vel_y", "vel_z", "omega_x"):
        assert rates[0][name] == pytest.approx(rates[1][name], abs=1e-14)


def test_outputs_are_consistent_with_derivatives(free: Rig) -> None:
    """Specific force rotated plus gravity is the acceleration, at a state with everything on."""
    x = free.state({**q(from_euler(0.5, -0.4, 2.0)), **vec("vel", [3, 2, 1]), "omega_z": 2.0})
    rates, y = free.rates(x, free.inputs()), free.outputs(x, free.inputs())
    R_nb: Array = np.array(rotation_matrix(list(free.vector(x, "q"))))
    force = R_nb @ [y[f"specific_force_{a}"] for a in "xyz"] + [0, 0, GRAVITY_M_S2]
    np.testing.assert_allclose([rates[f"vel_{a}"] for a in "xyz"], force, atol=1e-12)
    for a in "xyz":
        assert rates[f"omega_{a}"] == y[f"angular_acceleration_{a}"]


# -- trim ---------------------------------------------------------------------------------


def hexacopter() -> Array:
    angle = np.radians(30 + 60 * np.arange(6))
    return np.stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), np.zeros(6)], axis=-1)


TRIMMED = {
    **{name: load_vehicle(name) for name in BUILTIN},
    "full inertia": FREE,
    "shifted centre of mass": with_rotors(
        load_vehicle("crazyflie"),
        position_m=load_vehicle("crazyflie").rotors.position_m - np.array([0.004, -0.003, 0.0]),
    ),
    "no lag": with_rotors(plain(), lag_up_s=0.0, lag_down_s=0.0),
    "hexacopter": with_rotors(
        plain(), position_m=hexacopter(), direction=np.array([1.0, -1, 1, -1, 1, -1])
    ),
}


@pytest.mark.parametrize("name", TRIMMED)
def test_start_values_hover(name: str) -> None:
    vehicle = TRIMMED[name]
    rig = Rig(airframe(vehicle))
    rates = rig.rates(rig.state(), rig.inputs())
    assert max(abs(v) for v in rates.values()) < 1e-9, rates
    total = sum(
        v for n, v in rig.outputs(rig.state(), rig.inputs()).items() if n.startswith("thrust_")
    )
    assert total == pytest.approx(vehicle.mass_kg * GRAVITY_M_S2, rel=1e-9)


def test_trim_of_a_shifted_centre_of_mass_loads_the_near_rotors() -> None:
    rig = Rig(airframe(TRIMMED["shifted centre of mass"]))
    y = rig.outputs(rig.state(), rig.inputs())
    front = y["thrust_1"] + y["thrust_4"]
    weight = 0.027 * GRAVITY_M_S2
    assert front == pytest.approx(weight * (0.5 + 0.004 / 0.056), rel=1e-6)  # lever rule


@pytest.mark.parametrize("drive", ["rotor_speed", "command"])
def test_hover_trim_of_both_drives_gives_the_same_thrust(drive: str) -> None:
    rig = Rig(airframe(load_vehicle("copter_default"), drive))  # type: ignore[arg-type]
    y = rig.outputs(rig.state(), rig.inputs())
    for i in range(1, 5):
        assert y[f"thrust_{i}"] == pytest.approx(1.4 * GRAVITY_M_S2 / 4, rel=1e-9)


@pytest.mark.parametrize(
    ("positions", "direction"),
    [
        pytest.param([[0.2, 0, 0], [-0.1, 0.17, 0], [-0.1, -0.17, 0]], [1, 1, 1], id="all cw"),
        pytest.param([[0.2, 0, 0], [-0.1, 0.17, 0], [-0.1, -0.17, 0]], [1, -1, 1], id="mixed"),
        pytest.param([[0.2, 0.2, 0], [0.1, 0.2, 0], [0.2, 0.1, 0]], [1, -1, 1], id="off to a side"),
    ],
)
def test_what_cannot_hover_is_said(positions: Array, direction: list[int]) -> None:
    vehicle = with_rotors(
        plain(), position_m=np.array(positions), direction=np.array(direction, dtype=float)
    )
    with pytest.raises(ModelError, match=r"no hover trim.*directions"):
        airframe(vehicle)


@pytest.mark.slow
def test_too_heavy_is_said() -> None:
    with pytest.raises(ModelError, match="no hover trim"):
        airframe(plain(mass_kg=3.3))  # 4 * 8 N carry 3.26 kg
    trim = hover_trim(airframe(plain(mass_kg=3.2)), plain(mass_kg=3.2))
    assert trim["cmd_1"] == pytest.approx(3.2 * GRAVITY_M_S2 / 32, rel=1e-9)


def test_rotor_speed_drive_needs_a_map_of_the_speed() -> None:
    with pytest.raises(ModelError, match=r"rotors\.thrust_from_speed"):
        airframe(load_vehicle("feisi_x150"), "rotor_speed")


@pytest.mark.slow
def test_a_parameter_acts_as_the_number_in_the_vehicle_file() -> None:
    base, J = plain(), np.diag([0.03, 0.027, 0.036])
    changed = with_rotors(
        plain(mass_kg=1.5, inertia_kg_m2=J, drag_linear_n_s_m=np.array([0.3, 0, 0])),
        thrust_n=(0.0, 9.0),
    )
    numbers = {"mass": 1.5, "inertia.xx": 0.03, "thrust.c1": 9.0, "drag.linear_x": 0.3}
    one = in_air(base, None, **numbers)
    two = in_air(changed)
    efforts = {f"effort_{i}": 0.3 + 0.1 * i for i in range(1, 5)}
    state = {**vec("vel", [1, 2, 3]), **vec("omega", [1, -2, 3]), **efforts}
    a = one.rates(one.state(state), one.commands(0.5))
    b = two.rates(two.state(state), two.commands(0.5))
    assert a == pytest.approx(b, rel=1e-12, abs=1e-14)


@pytest.mark.slow
def test_every_combination_of_signs_of_the_inertia_products_is_inverted() -> None:
    for signs in itertools.product((-1, 1), repeat=3):
        J = np.diag([0.02, 0.027, 0.036])
        J[0, 1] = J[1, 0] = 0.003 * signs[0]
        J[0, 2] = J[2, 0] = 0.002 * signs[1]
        J[1, 2] = J[2, 1] = 0.004 * signs[2]
        rig = in_air(plain(inertia_kg_m2=J))
        omega = np.array([1.0, -2.0, 0.5])
        rates = rig.rates(at_rest(rig, **vec("omega", omega)), rig.commands(0.0))
        exact = np.linalg.solve(J, -np.cross(omega, J @ omega))
        np.testing.assert_allclose([rates[f"omega_{a}"] for a in "xyz"], exact, rtol=1e-11)
