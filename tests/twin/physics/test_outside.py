"""What acts on the airframe from outside, and the airframe set anew while it runs."""

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import FULL_INERTIA, Array, Rig, in_air, plain, q, vec

from twin.component import Run
from twin.frames import to_ned
from twin.physics.airframe import airframe

numbers = st.floats(-3.0, 3.0)
three = st.tuples(numbers, numbers, numbers)
FREE = plain(inertia_kg_m2=FULL_INERTIA)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return in_air(FREE)


@settings(max_examples=20)
@given(three, three, three, three)
def test_force_and_moment_are_added_to_its_own(
    rig: Rig, force: Array, moment: Array, omega: Array, vel: Array
) -> None:
    """By Newton and Euler alone, whatever else acts, at any attitude."""
    x = rig.state({**q([0.5, -0.5, 0.5, 0.5]), **vec("omega", omega), **vec("vel", vel)})
    before = rig.rates(x, rig.inputs())
    after = rig.rates(x, rig.inputs({**vec("force", force), **vec("moment", moment)}))
    more = {n: after[n] - before[n] for n in after}
    push = [float(f) / FREE.mass_kg for f in force]
    q_nb = [0.5, -0.5, 0.5, 0.5]
    np.testing.assert_allclose([more[f"vel_{a}"] for a in "xyz"], to_ned(q_nb, push), atol=1e-12)
    turn = np.linalg.solve(FULL_INERTIA, moment)
    np.testing.assert_allclose([more[f"omega_{a}"] for a in "xyz"], turn, atol=1e-10)
    felt = rig.outputs(x, rig.inputs(vec("force", force)))
    alone = rig.outputs(x, rig.inputs())
    gained = [felt[f"specific_force_{a}"] - alone[f"specific_force_{a}"] for a in "xyz"]
    np.testing.assert_allclose(gained, push, atol=1e-12)


def test_a_constant_force_gives_a_parabola(rig: Rig) -> None:
    x = rig.state()
    path = rig.fly(x, rig.inputs(force_x=0.6), 2.0)
    t = np.linspace(0, 2, len(path))
    np.testing.assert_allclose(rig.get(path, "pos_x")[:, 0], 0.25 * t**2, atol=1e-9)


# -- set anew ------------------------------------------------------------------------------


GIVEN = {
    **{f"pos_{a}": v for a, v in zip("xyz", (1.0, -2.0, -7.0), strict=True)},
    **{f"vel_{a}": v for a, v in zip("xyz", (3.0, 0.5, -1.0), strict=True)},
    **q(np.array([0.9, 0.1, -0.3, 0.2]) / np.sqrt(0.95)),
    **{f"omega_{a}": v for a, v in zip("xyz", (0.4, -0.6, 0.1), strict=True)},
}


def running() -> tuple[Run, Rig]:
    """Half a second of a climb, with a restart in it as it runs."""
    component = airframe(FREE, restart=True)
    rig = Rig(component, {"ground.enabled": 0.0})
    u = rig.commands([0.5, 0.45, 0.47, 0.52])
    run = Run(component, u, rig.p)
    for k in range(500):
        run.step(1e-3 * k, 1e-3, u)
    return run, rig


@pytest.mark.slow
def test_motion_becomes_the_given_one_and_rotors_go_on() -> None:
    run, rig = running()
    u = rig.commands([0.5, 0.45, 0.47, 0.52])
    anew = rig.inputs({"restart": 1.0, **{f"restart.{k}": v for k, v in GIVEN.items()}})
    anew[:4] = u[:4]
    before = run.x
    run.step(0.5, 1e-3, anew)
    np.testing.assert_allclose(rig.get(run.x, *GIVEN)[...], list(GIVEN.values()), atol=1e-15)
    own = [n for n in rig.names if n.startswith("effort_")]
    expected = before.copy()
    alone = np.asarray(rig.component.step(expected, u, rig.p, 1e-3)).ravel()
    np.testing.assert_array_equal(rig.get(run.x, *own), rig.get(alone, *own))
    run.step(0.501, 1e-3, u)
    free = rig.get(run.x, "pos_x")[0] - GIVEN["pos_x"]
    assert free == pytest.approx(3e-3, rel=0.01)


@pytest.mark.slow
def test_without_a_restart_it_is_the_airframe_as_ever() -> None:
    run, rig = running()
    plain_rig = in_air(FREE)
    path = plain_rig.fly(plain_rig.state(), plain_rig.commands([0.5, 0.45, 0.47, 0.52]), 0.5)
    mine = run.x[[rig.names.index(n) for n in plain_rig.names]]
    np.testing.assert_array_equal(mine, path[-1])


@pytest.mark.slow
def test_a_given_attitude_is_made_a_unit_quaternion() -> None:
    run, rig = running()
    given_now = {**GIVEN, **{f"q_{a}": 3 * GIVEN[f"q_{a}"] for a in "wxyz"}}
    u = rig.inputs({"restart": 1.0, **{f"restart.{k}": v for k, v in given_now.items()}})
    run.step(0.5, 1e-3, u)
    assert np.linalg.norm(rig.vector(run.x, "q")) == pytest.approx(1, abs=1e-12)


# -- disturbance ---------------------------------------------------------------------------

LACKING = {**vec("force", (0.4, -0.3, 0.8)), **vec("moment", (0.02, -0.01, 0.005))}
LEARNED = {
    **{f"gravity_{a}": LACKING[f"force_{a}"] / FREE.mass_kg for a in "xy"},
    **{n: v for n, v in LACKING.items() if n not in ("force_x", "force_y")},
}
LAG_S, FADE_S = 0.1, 0.5


def follow(
    given_motion: Array, parameters: Mapping[str, float], push: Mapping[str, float]
) -> tuple[Run, Rig]:
    """An airframe that is given a motion, shape (n, 13), millisecond by millisecond.

    Args:
        given_motion: As `GIVEN`.
        parameters: Of the airframe.
        push: What acts from outside meanwhile.
    """
    component = airframe(FREE, restart=True)
    rig = Rig(component, {"ground.enabled": 0.0, "disturbance.enabled": 1.0, **parameters})
    run = Run(component, rig.inputs(), rig.p)
    for k, row in enumerate(given_motion):
        given_now = dict(zip((f"restart.{n}" for n in GIVEN), row, strict=True))
        run.step(1e-3 * k, 1e-3, rig.inputs({"restart": 1.0, **given_now, **push}))
    return run, rig


@pytest.mark.slow
def test_what_the_equations_lack_is_learned_and_fades() -> None:
    """A plant that a constant force and moment push, in body axes; exponential both ways."""
    plant, seconds = Rig(airframe(FREE), {"ground.enabled": 0.0, "initial.omega_z": 0.1}), 0.6
    there = plant.fly(plant.state(), plant.inputs(LACKING), seconds)
    switched = {"initial.omega_z": 0.1}
    for name in LEARNED:
        switched |= {f"disturbance.lag.{name}": LAG_S, f"disturbance.fade.{name}": FADE_S}
    run, rig = follow(plant.get(there[1:], *GIVEN), switched, {})
    known = rig.outputs(run.x, rig.inputs())
    # The first instant has nothing to compare with.
    grown = 1 - (1 - 1e-3 / LAG_S) ** (len(there) - 2)
    for name, value in LEARNED.items():
        assert known[f"disturbance.{name}"] == pytest.approx(grown * value, rel=2e-3), name
    for k in range(500):
        run.step(seconds + 1e-3 * k, 1e-3, rig.inputs())
    later = rig.outputs(run.x, rig.inputs())
    for name in LEARNED:
        left = later[f"disturbance.{name}"] / known[f"disturbance.{name}"]
        assert left == pytest.approx(np.exp(-1), rel=2e-3)


@pytest.mark.slow
def test_what_is_said_from_outside_acts_once_the_twin_is_left_alone() -> None:
    """A plant that is pushed, and a twin that is told so: as long as it follows it is as one that
    is not, whose observer sees the push; alone it goes on as the plant, and the other's fades. With
    the observer off it follows as the others, and what it learned does not act afterwards."""
    plant, seconds = in_air(FREE), 1.5
    flown = plant.fly(plant.state(), plant.inputs(LACKING), seconds + 0.5)
    motion = plant.get(flown[1:], *GIVEN)
    given_motion, later = motion[: round(1e3 * seconds)], motion[-1]
    off, shown = [], []
    cases: tuple[tuple[Mapping[str, float], float], ...] = ((LACKING, 1.0), ({}, 1.0), ({}, 0.0))
    for push, on in cases:
        run, rig = follow(given_motion, {"disturbance.enabled": on}, push)
        following = rig.outputs(run.x, rig.inputs({**push, "restart": 1.0}))
        shown.append([following[n] for n in rig.component.output_names])
        for k in range(500):
            run.step(seconds + 1e-3 * k, 1e-3, rig.inputs(push))
        off.append(np.linalg.norm(rig.get(run.x, *GIVEN)[3:6] - later[3:6]))
    for other in shown[1:]:
        np.testing.assert_array_equal(shown[0], other)
    assert 20 * off[0] < off[1] < off[2]


@pytest.mark.slow
def test_a_tilt_of_the_given_attitude_is_no_force() -> None:
    """A hover whose attitude is given rolled by 3 degrees and pitched by 2: the accelerometer goes
    on to read what it does at the true one, and let go, the twin stays where it is."""
    roll, pitch, seconds = np.radians(3.0), np.radians(2.0), 2.0
    plant = in_air(FREE)
    there = plant.fly(plant.state(), plant.inputs(), seconds)
    truth = plant.outputs(there[-1], plant.inputs())
    given_motion = plant.get(there[1:], *GIVEN)
    given_motion[:, 6:10] = np.array([1.0, roll / 2, pitch / 2, 0.0])
    run, rig = follow(given_motion, {}, {})
    shown = rig.outputs(run.x, rig.inputs())
    g = FREE.gravity_m_s2
    assert shown["disturbance.gravity_x"] == pytest.approx(g * np.sin(pitch), rel=0.01)
    assert shown["disturbance.gravity_y"] == pytest.approx(-g * np.sin(roll), rel=0.01)
    assert abs(shown["disturbance.force_z"]) < 0.1 * FREE.mass_kg * g * np.sin(pitch)
    for a in "xyz":
        off = shown[f"specific_force_{a}"] - truth[f"specific_force_{a}"]
        assert abs(off) < 0.1 * g * np.sin(pitch)
    for k in range(200):
        run.step(seconds + 1e-3 * k, 1e-3, rig.inputs())
    moved = rig.get(run.x, "vel_x", "vel_y")
    assert np.abs(moved).max() < 0.05 * 0.2 * g * np.sin(pitch)  # over 0.2 s; fades, with 5 s


@pytest.mark.slow
def test_a_restart_alone_teaches_nothing() -> None:
    """However far it is from where the twin was."""
    run, rig = running()
    u = rig.inputs({"restart": 1.0, **{f"restart.{k}": v for k, v in GIVEN.items()}})
    run.step(0.5, 1e-3, u)
    names = [n for n in rig.names if n.startswith("disturbance.")]
    np.testing.assert_array_equal(rig.get(run.x, *names), np.zeros(len(names)))
    run.step(0.501, 1e-3, u)  # it was to stay where it had moved from
    assert np.abs(rig.get(run.x, *names)).max() > 0
