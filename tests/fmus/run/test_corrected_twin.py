"""The whole twin and each of its components: fused = parts, saved states, derivatives."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from instance import Array, Instance, unzip

from cosim.master import Master
from cosim.system import System
from cosim.whole_twin import fused_model, system_of
from fmus import build, component_model
from twin.component import Component, Run, Variable
from twin.flight.assembly import CONTROLLERS, Assembly, flying_twin
from twin.vehicle_file import load_vehicle

VEHICLE, H = "crazyflie", 1e-3
FUSED = "corrected_twin"
ON = {
    "environment.wind.x": 3.0,
    "environment.wind.y": -2.0,
    "environment.gust.enabled": 1.0,
    "airframe.rotor_drag.enabled": 1.0,
    "airframe.translational_lift.enabled": 1.0,
    "airframe.motor_lag.enabled": 1.0,
    "airframe.slung_load.enabled": 1.0,
    "imu.acc_noise": 0.2,
    "imu.gyro_noise": 0.01,
    "imu.acc_bias_walk": 0.01,
    "imu.vibration.enabled": 1.0,
    "imu.imu_delay.enabled": 1.0,
    "magnetometer.mag_noise": 1e-6,
    "barometer.baro_noise": 3.0,
    "position.position_delay.enabled": 1.0,
    "mission.wait": 0.05,
}
"""Wind, gusts, every noise, and effects with states of their own."""


@cache
def twin() -> Assembly:
    return flying_twin(load_vehicle(VEHICLE), "tour")


@cache
def component(name: str) -> Component:
    return CONTROLLERS["px4"](load_vehicle(VEHICLE)) if name == "px4" else twin().parts[name]


SINGLE = (
    "environment",
    "mission",
    "controller",
    "px4",
    "airframe",
    "imu",
    "magnetometer",
    "barometer",
    "position",
    "battery",
)
ALL = [(name, fmi) for name in (*SINGLE, FUSED) for fmi in (2, 3)]


def variables(name: str) -> list[Variable]:
    """Interface table of a component or of the whole."""
    if name != FUSED:
        return list(component(name).variables)
    fed = {target for _, target in twin().connections}
    renamed = (
        replace(v, name=f"{part}.{v.name}") for part in twin().parts for v in variables(part)
    )
    return [v for v in renamed if v.name not in fed]


def starts(name: str) -> dict[str, float]:
    """Noise and effects on, of a component or of the whole."""
    seeds = {
        f"{part}.seed": 7.0
        for part in ("environment", "imu", "magnetometer", "barometer", "position")
    }
    values = ON | seeds
    if name == FUSED:
        return values
    return {k.partition(".")[2]: v for k, v in values.items() if k.startswith(f"{name}.")}


@pytest.fixture(scope="module")
def folder_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """(name, FMI version) -> the FMU, extracted."""
    folder = tmp_path_factory.mktemp("twin")

    @cache
    def extracted(name: str, fmi: int) -> Path:
        model = fused_model(twin(), VEHICLE) if name == FUSED else component_model(component(name))
        return unzip(build(model, folder / f"{name}-{fmi}.fmu", fmi), folder / f"{name}-{fmi}")

    return extracted


@pytest.fixture
def new(folder_of: Callable[[str, int], Path]) -> Iterator[Callable[[str, int], Instance]]:
    """(name, FMI version) -> a fresh instance, freed after the test."""
    made: list[Instance] = []

    def instance(name: str, fmi: int) -> Instance:
        made.append(Instance(folder_of(name, fmi)))
        return made[-1]

    yield instance
    for one in made:
        one.close()


def outputs(instance: Instance) -> Array:
    """All outputs, those of one type in one call."""
    types = [instance.types[n] for n in instance.output_names]
    values = np.empty(len(types))
    for kind in set(types):
        chosen = [i for i, t in enumerate(types) if t == kind]
        integers = "Integer" if instance.fmi == 2 else "Int64"
        get = getattr(instance.fmu, "get" + (integers if kind == "Enumeration" else kind))
        values[chosen] = get([instance.reference[instance.output_names[i]] for i in chosen])
    return values


# -- fused = parts --------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_fused_is_the_co_simulation_of_its_parts(
    folder_of: Callable[[str, int], Path], tmp_path: Path, fmi: int
) -> None:
    """A whole tour: one FMU at 10 ms against nine FMUs by Jacobi at 1 ms, to the last bit."""
    stop_s = 50.0
    parts = replace(system_of(twin(), tmp_path, fmi), starts=starts(FUSED))
    whole = folder_of(FUSED, fmi).with_suffix(".fmu")
    one = System({"twin": whole}, starts={f"twin.{k}": v for k, v in starts(FUSED).items()})
    with Master(parts) as master:
        names = master.record_names
        master.initialize()
        fine = master.run(stop_s, H, every=10).values
    with Master(one, [f"twin.{n}" for n in names]) as master:
        master.initialize()
        coarse = master.run(stop_s, 10 * H).values
    assert np.mean(np.ptp(fine, axis=0) > 0) > 0.95  # everything moves
    assert np.ptp(fine[:, names.index("airframe.pos_x")]) > 1.0  # and flies
    assert coarse.tobytes() == fine.tobytes()


@pytest.mark.slow
def test_fused_is_the_same_in_python(new: Callable[[str, int], Instance]) -> None:
    """CasADi's interpreter, part by part, against the C code of the whole."""
    assembly = twin().with_starts(starts(FUSED))
    runs = {k: Run(c, c.input_values(), c.parameter_values()) for k, c in assembly.parts.items()}
    u = {k: c.input_values() for k, c in assembly.parts.items()}
    place = {
        f"{k}.{n}": (k, i) for k, c in assembly.parts.items() for i, n in enumerate(c.input_names)
    }

    def exchange() -> dict[str, float]:
        """Outputs of all parts, and along the connections."""
        values = {
            f"{k}.{n}": float(y)
            for k, c in assembly.parts.items()
            for n, y in zip(c.output_names, runs[k].outputs(u[k]), strict=True)
        }
        for source, target in assembly.connections:
            part, i = place[target]
            u[part][i] = values[source]
        return values

    for _ in range(4):
        exchange()  # at the start until nothing changes
    runs = {k: Run(c, u[k], c.parameter_values()) for k, c in assembly.parts.items()}
    for _ in range(4):
        exchange()
    instance = new(FUSED, 2).start(starts(FUSED))
    for k in range(400):
        for name, run in runs.items():
            run.step(k * H, H, u[name])
        values = exchange()
        instance.step(k * H)
    python = np.array([values[n] for n in instance.output_names])
    assert values["airframe.vel_z"] < -1e-3  # it has left the ground
    np.testing.assert_allclose(outputs(instance), python, rtol=1e-7, atol=1e-9)


# -- saved states ---------------------------------------------------------------------------

INSTANTS = 46  # 22 FMUs: 1,012 in total


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fmi"), ALL)
def test_restored_at_random_instants(
    new: Callable[[str, int], Instance], name: str, fmi: int
) -> None:
    """Saved, run on, restored, run again, noise and gusts on: the same bits, here and in another
    instance that gets the bytes."""
    rng = np.random.default_rng(fmi)
    inputs = [v for v in variables(name) if v.causality == "input"]
    instance, other = new(name, fmi).start(starts(name)), new(name, fmi)

    def run_on(one: Instance, time_s: float, seed: int) -> bytes:
        """Outputs over steps of different lengths with inputs that change."""
        draw, rows = np.random.default_rng(seed), [outputs(one)]
        for _ in range(8):
            one.set({v.name: v.start * draw.uniform(0.9, 1.1) for v in inputs})
            step_s = float(draw.choice([H, 3 * H, 10 * H]))
            one.step(time_s, step_s)
            time_s += step_s
            rows.append(outputs(one))
        return np.array(rows).tobytes()

    at = 0.0
    for seed in range(INSTANTS):
        step_s = float(rng.integers(1, 50) * H)
        instance.step(at, step_s)
        at += step_s
        instance.set({v.name: v.start * rng.uniform(0.9, 1.1) for v in inputs})
        saved = instance.fmu.getFMUState()
        content = instance.fmu.serializeFMUState(saved)
        first = run_on(instance, at, seed)
        instance.fmu.setFMUState(saved)
        assert run_on(instance, at, seed) == first
        rebuilt = other.fmu.deserializeFMUState(content)
        other.fmu.setFMUState(rebuilt)
        assert run_on(other, at, seed) == first
        instance.fmu.setFMUState(saved)
        instance.fmu.freeFMUState(saved)
        other.fmu.freeFMUState(rebuilt)


# -- directional derivatives ----------------------------------------------------------------

STATES, TOLERANCE = 100, 1e-6


def knowns(name: str) -> list[Variable]:
    """Inputs and real parameters that may be set while stepping."""
    return [
        v
        for v in variables(name)
        if v.causality in ("input", "parameter") and v.real and not v.fixed
    ]


def in_flight(name: str, rng: np.random.Generator) -> dict[str, float]:
    """Random start values of the states, high above the ground, rotors turning."""
    values = {}
    for v in variables(name):
        _, initial, state = v.name.partition("initial.")
        if initial and state.startswith("effort"):
            values[v.name] = rng.uniform(0.5, 0.8)
        elif initial and v.maximum is None:
            values[v.name] = v.start + (0.3 if state.startswith("q_") else 1.0) * rng.normal()
        if state == "pos_z":
            values[v.name] = -50.0
    return values


def scattered(name: str, rng: np.random.Generator) -> dict[str, float]:
    """Values of the knowns around their starts, none at a limit, where it could move one way."""
    values = {}
    for v in knowns(name):
        value = v.start * rng.uniform(0.95, 1.05)
        if v.causality == "input" and not v.start:
            value = rng.normal()
        if v.minimum is not None and value - v.minimum < 1e-6:
            value = v.minimum + 0.1
        values[v.name] = value
    return values


def sizes(names: list[str], here: Array) -> Array:
    """What counts as a small step of each known: its own size, for inertia that of the body."""
    size = np.where(here == 0, 1e-2, np.abs(here))
    for i, name in enumerate(names):
        if "inertia." in name:
            size[i] = here[names.index(f"{name[:-2]}xx")]
    return size


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fmi"), ALL)
def test_derivatives_against_central_differences(
    new: Callable[[str, int], Instance], name: str, fmi: int
) -> None:
    rng = np.random.default_rng(3)
    names = [v.name for v in knowns(name)]
    instance, worst = new(name, fmi), []
    references = [instance.reference[n] for n in names]
    unknown = [instance.reference[n] for n in instance.output_names]
    set_all = instance.fmu.setReal if fmi == 2 else instance.fmu.setFloat64
    for _ in range(STATES):
        instance.fmu.reset()
        instance.start(starts(name) | in_flight(name, rng))
        values = scattered(name, rng)
        here = np.array([values[n] for n in names])
        set_all(references, list(here))
        for k in range(3):
            instance.step(k * H)
        seed = rng.normal(size=len(names)) * sizes(names, here)
        exact = np.array(instance.fmu.getDirectionalDerivative(unknown, references, list(seed)))

        def moved(by: float, here: Array = here, seed: Array = seed) -> Array:
            set_all(references, list(here + by * seed))
            return outputs(instance)

        # Fourth-order differences with a short step: few cross a kink.
        e = 1e-5
        slope = (8 * (moved(e) - moved(-e)) - (moved(2 * e) - moved(-2 * e))) / (12 * e)
        scale = np.maximum(np.abs(slope), 1e-3 * np.max(np.abs(slope)) + 1e-12)
        worst.append(float(np.max(np.abs(exact - slope) / scale)))
    assert max(worst) <= TOLERANCE, sorted(worst)[-5:]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["airframe", FUSED])
def test_derivatives_are_finite_while_standing(
    new: Callable[[str, int], Instance], name: str
) -> None:
    """With the rotors at rest, where a square root of the thrust would have none."""
    names = [v.name for v in knowns(name)]
    instance = new(name, 2).start()
    references = [instance.reference[n] for n in names]
    unknown = [instance.reference[n] for n in instance.output_names]
    ones = [1.0] * len(names)
    assert np.isfinite(instance.fmu.getDirectionalDerivative(unknown, references, ones)).all()
