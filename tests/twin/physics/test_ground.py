"""Ground contact at the communication step of 1 ms, on each built-in vehicle."""

import numpy as np
import pytest
from rig import BUILTIN, Array, Rig, q, vec

from twin.frames import from_euler
from twin.physics.airframe import airframe
from twin.physics.rigid_body import CONTACT_HZ, FRICTION
from twin.vehicle import GRAVITY_M_S2
from twin.vehicle_file import load_vehicle

SINK_M = GRAVITY_M_S2 / (2 * np.pi * CONTACT_HZ) ** 2


@pytest.fixture(scope="module", params=BUILTIN)
def rig(request: pytest.FixtureRequest) -> Rig:
    return Rig(airframe(load_vehicle(request.param)))


def legs(rig: Rig) -> float:
    index = [v.name for v in rig.component.parameters].index("ground.leg_height")
    return float(rig.p[index])


def off(rig: Rig, height: float, **changes: float) -> Array:
    """On the ground or above it, rotors at rest."""
    still = {n: 0.0 for n in rig.names if n.startswith(("rotor_", "effort_"))}
    return rig.state({**still, "pos_z": -legs(rig) - height, **changes})


def tilt_deg(rig: Rig, states: Array) -> Array:
    _, x, y, _ = rig.vector(states, "q").T
    return np.asarray(np.degrees(2 * np.arcsin(np.minimum(np.hypot(x, y), 1.0))))


@pytest.mark.slow
def test_stands_still_for_a_minute(rig: Rig) -> None:
    settled = rig.fly(off(rig, 0.0, **q(from_euler(0, 0, 0.7))), rig.commands(0.0), 1.0)[-1]
    states = rig.fly(settled, rig.commands(0.0), 60.0)
    drift = np.linalg.norm(rig.vector(states, "pos") - rig.vector(settled, "pos"), axis=1)
    assert drift.max() < 1e-6
    assert tilt_deg(rig, states).max() < 1e-6
    assert rig.get(states[-1], "pos_z")[0] == pytest.approx(SINK_M - legs(rig), rel=1e-6)


def test_feels_one_g_upward_at_rest(rig: Rig) -> None:
    settled = rig.fly(off(rig, 0.0), rig.commands(0.0), 2.0)[-1]
    y = rig.outputs(settled, rig.commands(0.0))
    assert y["specific_force_z"] == pytest.approx(-GRAVITY_M_S2, rel=1e-9)


def test_stands_in_a_breeze_with_the_rotors_idling(rig: Rig) -> None:
    """Friction is smooth at zero speed: what leans on the feet creeps, at less than 10 mm/s."""
    u = rig.inputs({"wind_x": 1.0})
    u[:4] *= 0.3
    states = rig.fly(off(rig, 0.0), u, 5.0)
    assert np.linalg.norm(rig.vector(states[-1], "pos")[:2]) < 0.05
    assert tilt_deg(rig, states).max() < 1.0


def test_takes_off(rig: Rig) -> None:
    u = rig.inputs()
    u[:4] *= 1.2
    states = rig.fly(off(rig, 0.0), u, 1.5)
    height = -rig.get(states, "pos_z")[:, 0] - legs(rig)
    assert height[-1] > 0.3
    assert tilt_deg(rig, states).max() < 0.01
    np.testing.assert_allclose(rig.vector(states[-1], "pos")[:2], 0.0, atol=1e-6)
    assert np.all(np.diff(height[400:]) > 0)


@pytest.mark.parametrize(
    ("roll", "pitch", "spin", "vel"),
    [(0, 0, 0, 0), (0.2, -0.15, 0, 0), (0.1, 0.1, 3.0, 1.0)],
    ids=["flat", "tilted", "tilted, turning and moving"],
)
def test_lands_from_one_metre(rig: Rig, roll: float, pitch: float, spin: float, vel: float) -> None:
    start = off(rig, 1.0, **q(from_euler(roll, pitch, 0.4)), omega_z=spin, vel_x=vel)
    states = rig.fly(start, rig.commands(0.0), 4.0)
    assert np.all(np.isfinite(states))
    impact = np.sqrt(2 * GRAVITY_M_S2)
    speeds = np.linalg.norm(rig.vector(states, "vel"), axis=1)
    assert speeds.max() < 1.05 * np.hypot(impact, vel)
    landed = int(np.argmax(rig.get(states, "pos_z")[:, 0] > -legs(rig)))
    assert 400 < landed < 500
    bounce = -rig.get(states[landed + 100 :], "pos_z").min() - legs(rig)
    assert bounce < 0.25  # it keeps less than a quarter of its height
    assert speeds[-1] < 1e-6
    assert tilt_deg(rig, states[-1:])[0] < 1e-3
    assert rig.get(states[-1], "pos_z")[0] == pytest.approx(SINK_M - legs(rig), rel=1e-3)


def test_landing_at_one_ms_agrees_with_a_quarter_of_it(rig: Rig) -> None:
    start, u = off(rig, 0.3, **q(from_euler(0.1, -0.05, 0.4))), rig.commands(0.0)
    coarse, fine = rig.fly(start, u, 0.6), rig.fly(start, u, 0.6, 2.5e-4)
    gap = rig.vector(coarse, "pos") - rig.vector(fine[::4], "pos")
    assert np.linalg.norm(gap, axis=1).max() < 2e-3


def test_slides_to_a_stop_by_friction() -> None:
    """Way to stop v^2 / (2 mu g): coefficient and normal force act as they should."""
    rig = Rig(airframe(load_vehicle("copter_default")))
    settled = rig.fly(off(rig, 0.0), rig.commands(0.0), 1.0)[-1]
    moving = settled.copy()
    moving[[rig.names.index(f"vel_{a}") for a in "xyz"]] = 0.6, 0.8, 0.0
    states = rig.fly(moving, rig.commands(0.0), 1.0)
    way = rig.vector(states[-1], "pos") - rig.vector(settled, "pos")
    np.testing.assert_allclose(way[:2] / np.linalg.norm(way[:2]), [0.6, 0.8], atol=0.02)
    assert np.linalg.norm(way[:2]) == pytest.approx(1 / (2 * FRICTION * GRAVITY_M_S2), rel=0.05)


def test_ground_can_be_elsewhere_or_absent() -> None:
    component = airframe(load_vehicle("feisi_x150"))
    raised, none = Rig(component, {"ground.z": -2.0}), Rig(component, {"ground.enabled": 0.0})
    start = {"pos_z": -2.5, **vec("vel", [0, 0, 0])}
    down = raised.fly(raised.state(start), raised.commands(0.0), 2.0)[-1]
    assert raised.get(down, "pos_z")[0] == pytest.approx(-2.0 - legs(raised) + SINK_M, abs=1e-5)
    fallen = none.fly(none.state(start), none.commands(0.0), 2.0)[-1]
    assert none.get(fallen, "pos_z")[0] > 5.0


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", BUILTIN)
def test_leaving_contact_out_far_from_the_ground_changes_no_bit(vehicle: str) -> None:
    """Near the ground, fast, upside down: wherever the shortcut holds it gives the full step."""
    component = airframe(load_vehicle(vehicle))
    (shortcut,) = component.shortcuts
    rng = np.random.default_rng(5)
    rig, held = Rig(component), 0
    for _ in range(300):
        attitude = rng.standard_normal(4)
        x = rig.state(
            {
                "pos_z": -rng.uniform(0.0, 2.0),
                **vec("vel", rng.choice([1.0, 30.0]) * rng.standard_normal(3)),
                **vec("omega", 10 * rng.standard_normal(3)),
                **q(attitude / np.linalg.norm(attitude)),
            }
        )
        if bool(shortcut.holds(x, rig.p, 1e-3)):
            held += 1
            arguments = (x, rig.inputs(), rig.p, 1e-3)
            full, cheap = component.step(*arguments), shortcut.step(*arguments)
            np.testing.assert_array_equal(np.asarray(full), np.asarray(cheap))
    assert 50 < held < 250
