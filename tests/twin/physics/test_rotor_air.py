"""Laws that other simulators have, by hand and against their equations written once more."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import BUILTIN, Rig, plain, q, vec, with_rotors

from fmus.names import base_exponents
from twin.component import Component
from twin.effects import EFFECTS
from twin.frames import from_euler, to_body
from twin.physics.airframe import airframe
from twin.vehicle import Advance, RotorAir, RunUp, Vehicle
from twin.vehicle.vehicle import hover_level
from twin.vehicle_file import load_vehicle, parse_vehicle, vehicle_text

Array = np.ndarray
PAGE = Path(__file__).parents[3] / "docs" / "reference" / "simulators.md"
(HUMMINGBIRD,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
FLIP = np.array([1.0, -1.0, -1.0])
"""FRD to FLU, NED to north-west-up, and back."""
MASS, HUB = 1.2, 0.16
MOMENTS = np.array([0.020, 0.027, 0.036])


def spinning(**air: float) -> Vehicle:
    """1.2 kg, thrust 1e-5 w^2, torque 2e-7 w^2, no lag, with these loads of the air."""
    return with_rotors(
        plain(),
        from_speed=True,
        thrust_n=(0.0, 0.0, 1e-5),
        torque_n_m=(0.0, 0.0, 2e-7),
        speed_rad_s=(0.0, 1000.0),
        lag_up_s=0.0,
        lag_down_s=0.0,
        air=RotorAir(**air),
    )


def in_free_air(vehicle: Vehicle) -> Rig:
    """Driven by rotor speeds, without ground."""
    return Rig(airframe(vehicle, "rotor_speed"), {"ground.enabled": 0.0})


def wrench(
    vehicle: Vehicle, speeds: list[float], state: dict[str, float], **inputs: float
) -> tuple[Array, Array]:
    """Force without weight, N, and moment, N m, in body axes, at these rotor speeds."""
    return wrench_in(in_free_air(vehicle), vehicle, speeds, state, inputs)


def wrench_in(
    rig: Rig,
    vehicle: Vehicle,
    speeds: list[float],
    state: dict[str, float],
    inputs: dict[str, float],
) -> tuple[Array, Array]:
    """The same, in a rig that is there already."""
    u = rig.inputs({f"rotor_{i}": w for i, w in enumerate(speeds, start=1)} | inputs)
    y = rig.outputs(rig.state(state), u)
    force = vehicle.mass_kg * np.array([y[f"specific_force_{a}"] for a in "xyz"])
    omega = np.array([state.get(f"omega_{a}", 0.0) for a in "xyz"])
    J = vehicle.inertia_kg_m2
    alpha = np.array([y[f"angular_acceleration_{a}"] for a in "xyz"])
    return force, J @ alpha + np.cross(omega, J @ omega)


def added(
    vehicle: Vehicle, base: Vehicle, speeds: list[float], state: dict[str, float], **inputs: float
) -> tuple[Array, Array]:
    """Force and moment that one vehicle feels beyond another."""
    (f, m), (f0, m0) = (wrench(v, speeds, state, **inputs) for v in (vehicle, base))
    return f - f0, m - m0


# -- by hand ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_parasitic_drag_is_the_whole_speed_times_each_component() -> None:
    vehicle = plain(drag_parasitic_n_s2_m2=np.array([0.005, 0.006, 0.01]))
    rig = Rig(airframe(vehicle), {"ground.enabled": 0.0})
    bare = Rig(airframe(plain()), {"ground.enabled": 0.0})
    state = vec("vel", [2.0, -3.0, 6.0])  # 7 m/s
    got, without = (r.rates(r.state(state), r.inputs()) for r in (rig, bare))
    change = [MASS * (got[f"vel_{a}"] - without[f"vel_{a}"]) for a in "xyz"]
    assert change == pytest.approx([-0.005 * 7 * 2, 0.006 * 7 * 3, -0.01 * 7 * 6], rel=1e-12)


def test_parasitic_drag_turns_with_the_body_and_feels_the_wind_and_the_density() -> None:
    """Nose up 90 degrees: what falls is felt along the body's x axis."""
    vehicle = plain(drag_parasitic_n_s2_m2=np.array([0.005, 0.006, 0.01]))
    rig = Rig(airframe(vehicle), {"ground.enabled": 0.0})
    bare = Rig(airframe(plain()), {"ground.enabled": 0.0})
    state = q(from_euler(0.0, np.pi / 2, 0.0)) | vec("vel", [0.0, 0.0, 1.0])
    air = {"wind_z": 4.0, "density": 0.5 * 1.225}  # 3 m/s upwards through the air
    got, without = (r.rates(r.state(state), r.inputs(air)) for r in (rig, bare))
    change = [MASS * (got[f"vel_{a}"] - without[f"vel_{a}"]) for a in "xyz"]
    assert change == pytest.approx([0.0, 0.0, 0.5 * 0.005 * 9], abs=1e-12)


def test_air_stops_a_turn_with_the_square_of_its_rate() -> None:
    vehicle = plain(drag_angular_n_m_s2=np.array([1e-3, 2e-3, 3e-3]))
    rig = Rig(airframe(vehicle), {"ground.enabled": 0.0})
    state = vec("omega", [0.0, 0.0, -2.0])
    rate = rig.rates(rig.state(state), rig.inputs())["omega_z"]
    assert rate == pytest.approx(3e-3 * 4 / MOMENTS[2], rel=1e-12)


SPEEDS = [500.0, 600.0, 700.0, 800.0]


@pytest.mark.slow
def test_rotor_drag_acts_at_each_hub() -> None:
    """Flying forward at 3 m/s: rear left and front right pull harder where they turn faster."""
    force, moment = added(
        spinning(drag_kg_rad=1e-4), spinning(), SPEEDS, vec("vel", [3.0, 0.0, 2.0])
    )
    np.testing.assert_allclose(force, [-1e-4 * 2600 * 3.0, 0.0, 0.0], atol=1e-12)
    # Right rotors are 1 and 4, left ones 2 and 3: yaw = sum of -y F_x.
    yaw = HUB * 1e-4 * 3.0 * (500 - 600 - 700 + 800)
    np.testing.assert_allclose(moment, [0.0, 0.0, yaw], atol=1e-12)


def test_a_yawing_body_moves_its_hubs_sideways() -> None:
    """Drag of all rotors damps a yaw rate of 2 rad/s at a radius of sqrt(2) 0.16 m."""
    force, moment = added(
        spinning(drag_kg_rad=1e-4), spinning(), [600.0] * 4, vec("omega", [0, 0, 2.0])
    )
    np.testing.assert_allclose(force, 0.0, atol=1e-12)
    assert moment[2] == pytest.approx(-1e-4 * 4 * 600 * 2.0 * 2 * HUB**2, rel=1e-9)


def test_inflow_takes_thrust_in_a_climb_in_proportion_to_the_rotor_speed() -> None:
    force, moment = added(
        spinning(inflow_kg_rad=2e-4), spinning(), SPEEDS, vec("vel", [0.0, 0.0, -2.0])
    )
    np.testing.assert_allclose(force, [0.0, 0.0, 2e-4 * 2600 * 2.0], atol=1e-12)
    roll = HUB * 2e-4 * 2.0 * (500 - 600 - 700 + 800)  # the right side sinks
    pitch = -HUB * 2e-4 * 2.0 * (500 - 600 + 700 - 800)  # rotors 1 and 3 are in front
    np.testing.assert_allclose(moment, [roll, pitch, 0.0], atol=1e-12)


def test_lift_grows_with_the_square_of_the_speed_in_the_rotor_plane() -> None:
    force, moment = added(spinning(lift_kg_m=2e-3), spinning(), SPEEDS, vec("vel", [3.0, 4.0, 5.0]))
    np.testing.assert_allclose(force, [0.0, 0.0, -4 * 2e-3 * 25.0], atol=1e-12)
    np.testing.assert_allclose(moment, 0.0, atol=1e-12)


def test_flapping_is_a_moment_without_a_force_nose_up_in_forward_flight() -> None:
    force, moment = added(
        spinning(flapping_kg_m_rad=1e-6), spinning(), SPEEDS, vec("vel", [3.0, 2.0, 7.0])
    )
    np.testing.assert_allclose(force, 0.0, atol=1e-12)
    np.testing.assert_allclose(moment, 1e-6 * 2600 * np.array([-2.0, 3.0, 0.0]), atol=1e-12)


def test_rolling_moment_is_against_the_velocity() -> None:
    force, moment = added(
        spinning(rolling_kg_m_rad=1e-6), spinning(), SPEEDS, vec("vel", [3.0, 2.0, 7.0])
    )
    np.testing.assert_allclose(force, 0.0, atol=1e-12)
    np.testing.assert_allclose(moment, -1e-6 * 2600 * np.array([3.0, 2.0, 0.0]), atol=1e-12)


@pytest.mark.parametrize(
    ("climb", "share"), [(-3.0, 1.0), (0.0, 1.0), (2.0, 0.9), (4.0, 0.8), (6.0, 0.5), (99.0, 0.2)]
)
def test_thrust_by_advance_is_read_off_straight_lines(climb: float, share: float) -> None:
    """100 turns per second and 0.2 m: 20 m/s are an advance ratio of 1."""
    table = ((0.0, 1.0), (0.2, 0.8), (0.4, 0.2))
    vehicle = with_rotors(spinning(), advance=Advance(0.2, table, ((0.0, 1.0), (1.0, 0.5))))
    speed = 100 * 2 * np.pi
    rig = Rig(airframe(vehicle, "rotor_speed"), {"ground.enabled": 0.0})
    u = rig.inputs({f"rotor_{i}": speed for i in range(1, 5)})
    thrust = rig.outputs(rig.state(vec("vel", [0, 0, -climb])), u)["thrust_1"]
    assert thrust == pytest.approx(share * 1e-5 * speed**2, rel=1e-9)
    at_rest = {f"rotor_{i}": 0.0 for i in range(1, 5)}
    still = rig.outputs(rig.state(vec("vel", [0, 0, -climb])), rig.inputs(at_rest))
    assert still["thrust_1"] == 0.0


def test_a_rotor_runs_up_by_its_own_law_to_the_exact_speed() -> None:
    """dw/dt = b (u^2 - w^2) is solved by u tanh(b u t); the decay is a Bernoulli equation."""
    linear, b = 4.0, 0.02
    vehicle = with_rotors(spinning(), run_up=(RunUp(0.0, b), RunUp(linear, b)))
    rig = Rig(airframe(vehicle, "command"), {"ground.enabled": 0.0})
    x = rig.state({f"rotor_{i}": 0.0 for i in range(1, 5)})
    up = rig.fly(x, rig.commands([0.6] * 4), 0.1)[-1]
    assert rig.get(up, "rotor_1")[0] == pytest.approx(600 * np.tanh(b * 600 * 0.1), rel=1e-6)
    x = rig.state({f"rotor_{i}": 800.0 for i in range(1, 5)})
    down = rig.fly(x, rig.commands([0.0] * 4), 0.1)[-1]
    # dw/dt = -(a w + b w^2): 1 / w grows as (1 / w0 + b / a) exp(a t) - b / a.
    inverse = (1 / 800 + b / linear) * np.exp(linear * 0.1) - b / linear
    assert rig.get(down, "rotor_1")[0] == pytest.approx(1 / inverse, rel=1e-6)


def test_a_further_lag_adds_to_the_rotors_own_law() -> None:
    """With a linear law of 1 / tau, motor_lag gives the sum of the time constants."""
    vehicle = with_rotors(spinning(), run_up=(RunUp(20.0, 0.0), RunUp(20.0, 0.0)))
    rig = Rig(
        airframe(vehicle, "command", ["motor_lag"]),
        {"ground.enabled": 0.0, "motor_lag.enabled": 1.0, "motor_lag.tau_s": 0.03},
    )
    x = rig.state({f"rotor_{i}": 500.0 for i in range(1, 5)})
    end = rig.fly(x, rig.commands([0.7] * 4), 0.1)[-1]
    assert (700 - rig.get(end, "rotor_1")[0]) / 200 == pytest.approx(np.exp(-0.1 / 0.08), rel=1e-6)


@pytest.mark.slow
def test_a_rotor_that_speeds_up_turns_the_body_the_other_way() -> None:
    vehicle = with_rotors(spinning(), lag_up_s=0.05, lag_down_s=0.05, reaction_inertia_kg_m2=2e-5)
    rig, bare = (
        Rig(airframe(v, "command"), {"ground.enabled": 0.0})
        for v in (vehicle, with_rotors(vehicle, reaction_inertia_kg_m2=0.0))
    )
    commands = [0.9, 0.9, 0.3, 0.3]
    with_it, without = (r.rates(r.state(), r.commands(commands)) for r in (rig, bare))
    trim = hover_speed(rig)
    spin_up = (1000 * np.array(commands) - trim) / 0.05
    torque = -2e-5 * vehicle.rotors.direction @ spin_up
    change = MOMENTS[2] * (with_it["omega_z"] - without["omega_z"])
    assert change == pytest.approx(torque, rel=1e-9)
    measured = Rig(airframe(vehicle, "rotor_speed"), {"ground.enabled": 0.0})
    rates = {f"spin_rate_{i}": v for i, v in enumerate(spin_up, start=1)}
    found = measured.rates(measured.state(), measured.inputs(rates))["omega_z"]
    assert MOMENTS[2] * found == pytest.approx(torque, rel=1e-9)


def hover_speed(rig: Rig) -> float:
    return float(rig.get(rig.state(), "rotor_1")[0])


def test_a_vehicle_hovers_at_the_gravity_of_its_site() -> None:
    moon = replace(spinning(), gravity_m_s2=1.62)
    rig = in_free_air(moon)
    speed = rig.component.input_values()[0]
    assert speed == pytest.approx(np.sqrt(MASS * 1.62 / 4 / 1e-5), rel=1e-12)
    rates = rig.rates(rig.state(), rig.inputs())
    assert rates["vel_z"] == pytest.approx(0.0, abs=1e-9)


# -- against RotorPy --------------------------------------------------------------------------


def rotorpy(
    p: dict[str, float], hubs: Array, turns: Array, w: Array, v: Array, omega: Array
) -> tuple[Array, Array]:
    """Force and moment of RotorPy's multirotor, forward-left-up: Folk et al., arXiv 2306.04485."""
    up = np.array([0.0, 0.0, 1.0])
    drag = np.array([p["k_d"], p["k_d"], p["k_z"]])
    force = -np.linalg.norm(v) * np.array([p["c_Dx"], p["c_Dy"], p["c_Dz"]]) * v
    moment = np.zeros(3)
    for hub, turn, speed in zip(hubs, turns, w, strict=True):
        V = v + np.cross(omega, hub)
        push = (p["k_eta"] * speed**2 + p["k_h"] * (V[0] ** 2 + V[1] ** 2)) * up
        push = push - speed * drag * V
        force = force + push
        moment = moment + np.cross(hub, push) + turn * p["k_m"] * speed**2 * up
        moment = moment - p["k_flap"] * speed * np.cross(V, up)
    return force, moment


@pytest.mark.slow
@pytest.mark.parametrize("k_h, k_flap", [(0.0, 0.0), (3e-4, 0.0), (1e-3, -2e-6), (0.0, 4e-6)])
def test_the_hummingbird_of_the_documentation_feels_what_rotorpys_does(
    k_h: float, k_flap: float
) -> None:
    vehicle = parse_vehicle(HUMMINGBIRD, "hummingbird.toml")
    assert vehicle.doubts == ()
    air = replace(vehicle.rotors.air, lift_kg_m=k_h, flapping_kg_m_rad=-k_flap)
    vehicle = with_rotors(vehicle, air=air)
    d = 0.17 * 0.70710678118
    hubs = d * np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]])
    p = {"c_Dx": 0.5e-2, "c_Dy": 0.5e-2, "c_Dz": 1e-2, "k_eta": 5.57e-06, "k_m": 1.36e-07}
    p |= {"k_d": 1.19e-04, "k_z": 2.32e-04, "k_h": k_h, "k_flap": k_flap}
    rng, rig = np.random.default_rng(7), in_free_air(vehicle)
    for _ in range(20):
        attitude = from_euler(*rng.uniform(-1, 1, 3))
        vel, wind, omega = (rng.uniform(-s, s, 3) for s in (8.0, 4.0, 3.0))
        w = rng.uniform(200.0, 1400.0, 4)
        state = q(attitude) | vec("vel", vel) | vec("omega", omega)
        force, moment = wrench_in(rig, vehicle, w.tolist(), state, vec("wind", wind))
        through_air = np.array(to_body(attitude.tolist(), (vel - wind).tolist()))
        wanted = rotorpy(p, hubs, np.array([1, -1, 1, -1]), w, FLIP * through_air, FLIP * omega)
        np.testing.assert_allclose(FLIP * force, wanted[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(FLIP * moment, wanted[1], rtol=1e-9, atol=1e-9)


def test_the_hummingbird_turns_with_its_inertia_and_hovers_at_its_speed() -> None:
    vehicle = parse_vehicle(HUMMINGBIRD, "hummingbird.toml")
    np.testing.assert_array_equal(vehicle.inertia_kg_m2, np.diag([3.65e-3, 3.68e-3, 7.03e-3]))
    rig = Rig(airframe(vehicle), {"ground.enabled": 0.0})
    trim = rig.component.input_values()[0]
    assert 1500 * trim == pytest.approx(np.sqrt(0.5 * 9.81 / 4 / 5.57e-06), rel=1e-9)


def test_every_key_that_the_documentation_names_is_one() -> None:
    from twin.vehicle_file.fields import FIELDS

    named = set(re.findall(r"`((?:body|rotors|imu|site)\.\w+)`", PAGE.read_text("utf-8")))
    assert len(named) > 20
    assert named <= set(FIELDS), named - set(FIELDS)


# -- properties -------------------------------------------------------------------------------

DRAGGED = replace(
    spinning(drag_kg_rad=1e-4, inflow_kg_rad=2e-4),
    drag_linear_n_s_m=np.array([0.1, 0.2, 0.3]),
    drag_quadratic_n_s2_m2=np.array([0.01, 0.02, 0.03]),
    drag_parasitic_n_s2_m2=np.array([0.005, 0.006, 0.01]),
    drag_angular_n_m_s2=np.array([1e-3, 2e-3, 3e-3]),
)
CLEAN = replace(spinning(), drag_linear_n_s_m=np.zeros(3), drag_quadratic_n_s2_m2=np.zeros(3))
triples = st.tuples(*[st.floats(-20, 20)] * 3)


@pytest.mark.slow
@settings(deadline=None, max_examples=200)
@given(triples, triples, st.tuples(*[st.floats(0, 2000)] * 4), triples)
def test_drag_of_body_and_rotors_never_gives_power(
    v: tuple[float, ...], omega: tuple[float, ...], w: tuple[float, ...], lean: tuple[float, ...]
) -> None:
    attitude = from_euler(*(0.15 * a for a in lean))
    state = q(attitude) | vec("vel", v) | vec("omega", omega)
    with_drag, without = (_felt(_rig(dragged), state, w) for dragged in (True, False))
    force, twist = MASS * (with_drag[:3] - without[:3]), MOMENTS * (with_drag[3:] - without[3:])
    through_air = np.array(to_body(attitude.tolist(), list(v)))
    power = float(force @ through_air + twist @ np.array(omega))
    assert power <= 1e-9 * (1 + np.abs(force).max() * np.abs(through_air).max())
    if np.abs(through_air).max() > 1e-3:
        assert power < 0


@cache
def _rig(dragged: bool) -> Rig:
    return in_free_air(DRAGGED if dragged else CLEAN)


def _felt(rig: Rig, state: dict[str, float], w: tuple[float, ...]) -> Array:
    """Specific force and angular acceleration, shape (6,)."""
    u = rig.inputs({f"rotor_{i}": x for i, x in enumerate(w, start=1)})
    y = rig.outputs(rig.state(state), u)
    names = [f"{s}_{a}" for s in ("specific_force", "angular_acceleration") for a in "xyz"]
    return np.array([y[n] for n in names])


def code_of(component: Component) -> str:
    """C code of the equations, and the interface table."""
    generator = ca.CodeGenerator("kernels.c")
    for f in (component.initial, component.derivatives, component.step, component.outputs):
        generator.add(f)
    return str(generator.dump()) + repr(component.variables) + repr(component.states)


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILTIN)
def test_zeros_and_nothing_are_the_same_equations(name: str) -> None:
    """A vehicle that leaves these laws out pays nothing for them, and nothing of them is in it."""
    text, file = vehicle_text(name)
    source = 'source = "s" }\n'
    zero = "".join(
        f'{key} = {{ value = [0, 0, 0], unit = "{unit}", {source}'
        for key, unit in (
            ("drag_parasitic", "N*s^2/m^2"),
            ("drag_angular", "N*m*s^2/rad^2"),
        )
    )
    none = "".join(
        f'{key} = {{ value = 0, unit = "{unit}", {source}'
        for key, unit in (
            ("drag", "kg/rad"),
            ("inflow", "kg/rad"),
            ("lift", "kg/m"),
            ("flapping_moment", "kg*m/rad"),
            ("rolling_moment", "kg*m/rad"),
            ("reaction_inertia", "kg*m^2"),
        )
    )
    full = text.replace("[body]\n", f"[body]\n{zero}").replace("[rotors]\n", f"[rotors]\n{none}")
    full += f'[site]\ngravity = {{ value = 9.80665, unit = "m/s^2", {source}'
    bare = airframe(load_vehicle(name))
    assert code_of(airframe(parse_vehicle(full, file))) == code_of(bare)
    names = {v.name for v in bare.parameters}
    new = ("rotor_air.", "run_up.", "drag.parasitic", "drag.angular", "diameter", "reaction_in")
    assert not [n for n in names if n.startswith(new)]


@pytest.mark.slow
def test_every_number_is_a_parameter_with_a_unit_that_fmi_knows() -> None:
    air = {"drag_kg_rad": 1e-4, "inflow_kg_rad": 2e-4, "lift_kg_m": 1e-3}
    air |= {"flapping_kg_m_rad": 1e-6, "rolling_kg_m_rad": 2e-6}
    vehicle = with_rotors(
        replace(DRAGGED, rotors=spinning(**air).rotors),
        run_up=(RunUp(5.0, 0.01), RunUp(4.0, 0.02)),
        reaction_inertia_kg_m2=1e-5,
        advance=Advance(0.2, ((0.0, 1.0), (1.0, 0.5)), ()),
    )
    table = {v.name: v.start for v in airframe(vehicle, "command").parameters}
    wanted = {
        "rotor_air.drag": 1e-4,
        "rotor_air.inflow": 2e-4,
        "rotor_air.lift": 1e-3,
        "rotor_air.flapping_moment": 1e-6,
        "rotor_air.rolling_moment": 2e-6,
        "drag.parasitic_z": 0.01,
        "drag.angular_y": 2e-3,
        "run_up.linear_rising": 5.0,
        "run_up.quadratic_falling": 0.02,
        "reaction_inertia": 1e-5,
        "diameter": 0.2,
    }
    assert wanted.items() <= table.items()
    for v in airframe(vehicle, "command", EFFECTS).variables:
        base_exponents(v.unit)


# -- the effects that name them ---------------------------------------------------------------


def test_the_effect_flapping_moment_is_the_law_of_the_vehicle_file() -> None:
    """k of all rotors in hover: n times the speed of hover times that of one rotor."""
    base = spinning()
    k = 4 * hover_level(base) * 1e-6
    named = base.with_effects({"flapping_moment": {"k_n_s": k}})
    state = vec("vel", [3.0, 2.0, 7.0]) | vec("omega", [0.5, -0.4, 0.3])
    by_effect = wrench(named, SPEEDS, state)
    by_file = wrench(spinning(flapping_kg_m_rad=1e-6), SPEEDS, state)
    np.testing.assert_allclose(by_effect[0], by_file[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(by_effect[1], by_file[1], rtol=1e-12, atol=1e-12)


def test_the_effect_parasitic_drag_is_the_law_of_the_vehicle_file() -> None:
    c = {"c_1_m": 0.02, "more_y_1_m": 0.01, "more_z_1_m": 0.04}
    named = spinning().with_effects({"parasitic_drag": c})
    state = vec("vel", [3.0, 2.0, 7.0])
    by_effect = wrench(named, SPEEDS, state)
    in_file = MASS * np.array([0.02, 0.03, 0.06])
    by_file = wrench(replace(spinning(), drag_parasitic_n_s2_m2=in_file), SPEEDS, state)
    np.testing.assert_allclose(by_effect[0], by_file[0], rtol=1e-12)
