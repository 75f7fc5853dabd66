"""The law of what the equations leave: against its formula, by symmetry, at its ends, in an FMU."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instance import Instance, unzip
from numpy.typing import NDArray
from rig import FULL_INERTIA, Rig, plain, q, vec
from scipy.signal import welch
from scipy.spatial.transform import Rotation

from cosim.whole_twin import fused_model
from fmus import build
from fmus.model import component_model
from fmus.source import generated_sources
from twin.component import Run
from twin.errors import ModelError
from twin.flight.assembly import driven_twin
from twin.physics.residual_force import (
    FADED,
    FEATURES,
    INPUTS,
    NOISE_HZ,
    OUTPUTS,
    PERIOD_S,
    ForceLaw,
    noise_values,
    residual_force,
)
from twin.vehicle import Vehicle

Array = NDArray[np.float64]
VEHICLE = plain(inertia_kg_m2=FULL_INERTIA)
NAMES = [f"{kind}_{a}" for kind, a in OUTPUTS]


def units(vehicle: Vehicle) -> Array:
    found = np.zeros((6, 6))
    found[:3, :3], found[3:, 3:] = vehicle.mass_kg * np.eye(3), vehicle.inertia_kg_m2
    return found


def law(seed: int = 0) -> ForceLaw:
    """Weights of every feature, an envelope of a metre per second and the like."""
    rng = np.random.default_rng(seed)
    d = len(INPUTS)
    return ForceLaw(
        linear=rng.normal(size=(6, len(FEATURES))),
        centre=np.zeros(d),
        scale=np.ones(d),
        whitening=np.eye(d),
        reach=1.0,
        most=np.full(6, 1e6),
        units=units(VEHICLE),
    )


def alone(**weights: float) -> ForceLaw:
    """A law of a few linear weights, "output feature" -> value."""
    linear = np.zeros((6, len(FEATURES)))
    for name, value in weights.items():
        output, _, feature = name.partition("__")
        linear[NAMES.index(output), FEATURES.index(feature)] = value
    return replace(law(), linear=linear)


def motion(**values: float) -> dict[str, float]:
    """Hover far above the ground, some of it changed."""
    return {**{f"spin_{i}": 1.0 for i in range(1, 5)}, "pos_z": -1e6, **values}


def said(rig: Rig, u: Array) -> dict[str, float]:
    """Outputs of a law that has just been evaluated on inputs."""
    return rig.outputs(np.asarray(rig.component.initial(u, rig.p)).ravel(), u)


three = st.tuples(*[st.floats(-0.6, 0.6)] * 3)


@pytest.mark.slow
@settings(max_examples=25)
@given(three, three, st.tuples(*[st.floats(0.9, 1.1)] * 4), st.integers(0, 99))
def test_within_the_envelope_it_is_its_formula(
    vel: Array, omega: Array, spin: Array, seed: int
) -> None:
    """Written again in numpy, for a level vehicle: velocity is that through the air."""
    one, rig = law(seed=seed), Rig(residual_force(VEHICLE, law(seed=seed)))
    given_now = motion(**vec("vel", vel), **vec("omega", omega))
    given_now |= {f"spin_{i}": s for i, s in enumerate(spin, start=1)}
    found = said(rig, rig.inputs(given_now))
    square, hubs = np.square(spin), VEHICLE.rotors.position_m / VEHICLE.arm_m
    turning = [
        np.mean(-hubs[:, 1] * square),
        np.mean(hubs[:, 0] * square),
        np.mean(-VEHICLE.rotors.direction * square),
    ]
    mean = np.mean(square) - 1
    x = np.array([*vel, *omega, mean, *turning, 0.0, 0.0])
    (wx, wy, wz), v = omega, np.array(vel)
    products = [*(mean * v), *(np.linalg.norm(v) * v), mean**2, wy * wz, wx * wz, wx * wy]
    whole = one.linear @ np.array([1.0, *x, *products])
    assert found["distance"] == pytest.approx(np.sqrt(np.mean(x**2)), abs=1e-9)
    np.testing.assert_allclose(
        [found[n] for n in NAMES], units(VEHICLE) @ whole, rtol=1e-9, atol=1e-9
    )


@pytest.mark.slow
@settings(max_examples=25)
@given(st.floats(-3, 3), three, st.tuples(st.floats(-50, 50), st.floats(-50, 50)))
def test_neither_heading_nor_place_takes_part(turn: float, vel: Array, place: Array) -> None:
    """The same flight turned about the vertical and elsewhere, at the same height."""
    rig = Rig(residual_force(VEHICLE, law()))
    tilt = Rotation.from_euler("xyz", [0.2, -0.1, 0.0])
    found = []
    for about in (Rotation.identity(), Rotation.from_euler("z", turn)):
        x, y, z, w = (about * tilt).as_quat()
        now = motion(**q([w, x, y, z]), **vec("vel", about.apply(vel)), pos_z=-2.0)
        answer = said(rig, rig.inputs(now))
        found.append([answer[n] for n in NAMES])
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)
    assert not {"pos_x", "pos_y"} & set(rig.component.input_names)
    del place


@pytest.mark.slow
def test_noise_has_the_level_of_its_third_octave_and_is_off_by_default() -> None:
    k, level = NOISE_HZ.index(min(NOISE_HZ, key=lambda f: abs(f - 5))), 0.3
    noise = np.zeros((len(OUTPUTS), len(NOISE_HZ)))
    noise[2, k] = level
    made = replace(alone(), noise=noise)
    rig = Rig(residual_force(VEHICLE, made), {"noise.enabled": 1.0, "seed": 3.0})
    run, u = Run(rig.component, rig.inputs(motion()), rig.p), rig.inputs(motion())
    drawn = np.zeros((8000, len(NAMES)))
    for i in range(len(drawn)):
        run.step(i * PERIOD_S, PERIOD_S, u)
        y = np.asarray(rig.component.outputs(run.x, u, rig.p)).ravel()
        drawn[i] = [y[rig.component.output_names.index(n)] for n in NAMES]
    force = drawn[:, 2] / VEHICLE.mass_kg
    assert not np.delete(drawn, 2, axis=1).any()
    assert np.std(force) == pytest.approx(level, rel=0.1)
    f, power = welch(force, 1 / PERIOD_S, nperseg=2000)
    edge = 2 ** (1 / 6)
    inside = (f > NOISE_HZ[k] / edge) & (f < NOISE_HZ[k] * edge)
    assert power[inside].sum() > 0.4 * power.sum(), "half of it, between half-power points"
    assert power[f < NOISE_HZ[k] / 8].max() < 1e-2 * power[inside].max()
    plain = Rig(residual_force(VEHICLE, made))
    quiet = Run(plain.component, u, plain.p)
    for i in range(20):
        quiet.step(i * PERIOD_S, PERIOD_S, u)
    assert not quiet.x[[n.startswith("noise.") for n in plain.names]].any()
    assert set(noise_values(noise)) >= {"noise.force_z.1"}


def test_a_law_is_held_between_two_instants() -> None:
    rig = Rig(residual_force(VEHICLE, alone(force_x__air_x=1.0)))
    u, place = rig.inputs(motion()), rig.component.output_names.index("force_x")
    run, seen = Run(rig.component, u, rig.p), []
    for k in range(20):
        u[rig.component.input_names.index("vel_x")] = 0.1 * k
        run.step(1e-3 * k, 1e-3, u)
        seen.append(run.outputs(u)[place] / VEHICLE.mass_kg)
    every = round(PERIOD_S / 1e-3)
    changes = np.flatnonzero(np.diff(seen)) + 2  # steps at whose ends it was evaluated
    assert changes.tolist() == [k for k in range(2, 21) if k % every == 0]
    assert seen[every - 1] == pytest.approx(0.1 * (every - 1))


def test_it_fades_without_a_step_and_ends_at_zero() -> None:
    rig = Rig(residual_force(VEHICLE, law()))
    speeds = np.linspace(0, 1.2 * FADED * np.sqrt(len(INPUTS)), 4001)
    u = np.tile(rig.inputs(motion())[:, None], len(speeds))
    u[rig.component.input_names.index("vel_x")] = speeds
    p = np.tile(rig.p[:, None], len(speeds))
    y = np.asarray(rig.component.outputs(rig.component.initial(u, p), u, p)).T
    acts = y[:, [rig.component.output_names.index(n) for n in NAMES]]
    away = y[:, rig.component.output_names.index("distance")]
    assert np.all(acts[away >= FADED] == 0)
    assert np.abs(acts[away < 1]).max() > 1
    steps = np.abs(np.diff(acts, axis=0)).max(axis=0)
    assert np.all(steps < 0.01 * np.ptp(acts, axis=0))  # one of 4000 steps, not a jump


def test_a_module_that_overflows_is_bounded_and_fades_to_zero() -> None:
    """One output is infinite, one no number, where the vehicle is fast."""
    x = ca.SX.sym("x", len(INPUTS))
    whole = ca.vertcat(ca.exp(1e3 * x[0]), ca.sqrt(1 - x[0]), 0, 0, 0, 0)
    made = replace(alone(), module=ca.Function("module", [x], [whole]), most=np.full(6, 2.0))
    rig = Rig(residual_force(VEHICLE, made))
    near, far = (said(rig, rig.inputs(motion(vel_x=v))) for v in (2.0, 1e2))
    assert near["force_x"] == pytest.approx(2.0 * VEHICLE.mass_kg)
    assert abs(near["force_y"]) == pytest.approx(2.0 * VEHICLE.mass_kg)
    assert [far[n] for n in NAMES] == [0.0] * len(NAMES)


@pytest.mark.slow
@settings(max_examples=25)
@given(three, st.floats(0, 3), st.integers(0, 99))
def test_nothing_is_said_beyond_what_may_be(vel: Array, most: float, seed: int) -> None:
    """And the same is said below it."""
    free = replace(law(seed=seed), units=np.eye(6))
    bound = replace(free, most=np.linspace(0, most, len(NAMES)))
    rigs = [Rig(residual_force(VEHICLE, one)) for one in (free, bound)]
    both = [said(r, r.inputs(motion(**vec("vel", vel)))) for r in rigs]
    whole, held = (np.array([answer[n] for n in NAMES]) for answer in both)
    np.testing.assert_array_equal(held, np.clip(whole, -bound.most, bound.most))


def test_wind_is_no_ground_speed() -> None:
    rig = Rig(residual_force(VEHICLE, alone(force_x__air_x=-0.5)))
    still = said(rig, rig.inputs(motion(vel_x=2.0)))
    blown = said(rig, rig.inputs(motion(wind_x=-2.0)))
    assert still["force_x"] == pytest.approx(-1.0 * VEHICLE.mass_kg)
    assert blown["force_x"] == still["force_x"]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"centre": np.zeros(4)}, "shape"),
        ({"centre": np.full(len(INPUTS), np.nan)}, "finite"),
        ({"scale": np.zeros(len(INPUTS))}, "above 0"),
        ({"reach": np.inf}, "above 0"),
        ({"most": np.full(6, -1.0)}, "at least 0"),
    ],
)
def test_numbers_that_make_no_law_are_refused(change: dict[str, Array], text: str) -> None:
    with pytest.raises(ModelError, match=text):
        replace(law(), **change)  # type: ignore[arg-type]


def test_its_arrays_make_it_again() -> None:
    again = ForceLaw.of(law().arrays())
    assert all(np.array_equal(a, law().arrays()[k]) for k, a in again.arrays().items())
    with pytest.raises(ModelError, match="has"):
        ForceLaw.of({"linear": law().linear})


def test_laws_of_other_numbers_have_the_kernels_of_one_compilation() -> None:
    one, other = (
        generated_sources(component_model(residual_force(VEHICLE, law(seed))), "token")
        for seed in (0, 1)
    )
    assert [name for name in one if one[name] != other[name]] == ["part_residual_force.c"]


@pytest.mark.slow
def test_fused_fmu_flies_by_the_law(tmp_path: Path) -> None:
    """Against airframe and law in Python, outputs exchanged at each millisecond (Jacobi): every
    `PERIOD_S` the law answers what it was given at the start of the step."""
    one = replace(law(), linear=0.2 * law().linear, reach=3.0)
    parts = driven_twin(VEHICLE, "command", (), one).parts
    body, beyond = parts["airframe"], Rig(parts["residual_force"])
    path = build(
        fused_model(driven_twin(VEHICLE, "command", (), one), "plain"), tmp_path / "twin.fmu"
    )
    instance = Instance(unzip(path, tmp_path / "twin"))
    above = {"airframe.initial.pos_z": -20.0}
    instance.start({**above, **{f"airframe.cmd_{i}": 0.4 for i in range(1, 5)}})
    p = body.parameter_values({"initial.pos_z": -20.0})
    index = {n: i for i, n in enumerate(body.input_names)}
    u = body.input_values({f"cmd_{i}": 0.4 for i in range(1, 5)})
    air = [n for n in body.input_names if n.startswith(("wind_", "density"))]
    run = Run(body, u, p)

    def answer() -> list[float]:
        """Of the law to the airframe's present motion."""
        y = dict(zip(body.output_names, run.outputs(u), strict=True))
        known = {n: y[n] for n in beyond.component.input_names if n in y}
        acts = said(beyond, beyond.inputs(known))
        return [acts[n] for n in NAMES]

    every = round(PERIOD_S / 1e-3)
    u[[index[n] for n in NAMES]] = answer()
    for k in range(300):
        u[[index[n] for n in air]] = [instance.get(f"environment.{n}") for n in air]
        late = answer() if (k + 1) % every == 0 else u[[index[n] for n in NAMES]]
        turn = 0.4 + 0.01 * np.sin(0.05 * k + np.arange(4))
        instance.set({f"airframe.cmd_{i + 1}": float(c) for i, c in enumerate(turn)})
        u[:4] = turn
        instance.step(1e-3 * k)
        run.step(1e-3 * k, 1e-3, u)
        u[[index[n] for n in NAMES]] = late
        for name in ("pos_x", "vel_y", "omega_z", "q_x"):
            mine = run.x[[s.name for s in body.states].index(name)]
            assert instance.get(f"airframe.{name}") == pytest.approx(mine, rel=1e-8, abs=1e-9)
    assert abs(instance.get("residual_force.moment_x")) > 1e-4
    instance.close()
