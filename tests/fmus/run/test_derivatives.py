"""Directional derivatives of the FMUs against central differences of their own outputs."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from instance import Array, Instance, unzip
from kinds import COMPONENTS, component

from fmus import build, component_model
from twin.component import ComponentBuilder, Variable

Folder = Callable[[str, int], Path]
STATES = 100
TOLERANCE = 1e-6


def knowns(kind: str) -> list[Variable]:
    """Inputs and real parameters that may be set while stepping."""
    c = component(kind)
    return [v for v in c.inputs + c.parameters if v.real and not v.fixed]


def scatter(kind: str, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """Random start values (away from rest and from the ground) and random inputs."""
    c = component(kind)
    starts = {
        v.name: v.start * rng.uniform(0.8, 1.2)
        if v.name.startswith(("initial.rotor", "initial.effort"))
        else v.start + rng.normal() * (0.3 if v.name.startswith("initial.q") else 1.0)
        for v in c.parameters
        if v.name.startswith("initial.") and v.maximum is None
    }
    if "initial.pos_z" in starts:
        starts["initial.pos_z"] = -50.0
    inputs = {}
    for v in c.inputs:
        wide = v.name.startswith(("cmd_", "vbat"))
        inputs[v.name] = v.start * rng.uniform(0.8, 1.2) if wide else v.start + rng.normal()
    for v in knowns(kind):  # a parameter at its limit could be moved to one side only
        if v.minimum is not None and v.start - v.minimum < 1e-6 * abs(v.start) + 1e-12:
            inputs[v.name] = v.minimum + 0.1
    return starts, inputs


def derivative(instance: Instance, names: list[str], seed: Array) -> Array:
    get = instance.fmu.getDirectionalDerivative
    unknown = [instance.reference[n] for n in instance.output_names]
    return np.array(get(unknown, [instance.reference[n] for n in names], list(seed)))


def sizes(kind: str, here: Array) -> Array:
    """What counts as a small step of each known: its own size, for inertia that of the body."""
    names = [v.name for v in knowns(kind)]
    size = np.where(here == 0, 1e-2, np.abs(here))
    for i, name in enumerate(names):
        if name.startswith("inertia."):
            size[i] = here[names.index("inertia.xx")]
    return size


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", COMPONENTS)
def test_against_central_differences(fmu_folder: Folder, kind: str, fmi: int) -> None:
    rng = np.random.default_rng(7)
    variables = knowns(kind)
    names = [v.name for v in variables]
    instance = Instance(fmu_folder(kind, fmi))
    worst = 0.0
    for _ in range(STATES):
        starts, inputs = scatter(kind, rng)
        instance.fmu.reset()
        instance.start(starts)
        instance.set(inputs)
        for k in range(3):
            instance.step(k * 1e-3)
        here = np.array([instance.get(n) for n in names])
        seed = rng.normal(size=len(names)) * sizes(kind, here)
        exact = derivative(instance, names, seed)

        def moved(by: float, here: Array = here, seed: Array = seed) -> Array:
            instance.set(dict(zip(names, here + by * seed, strict=True)))
            return instance.outputs()

        # Fourth-order differences with a short step: few cross a kink (rotors cannot push down).
        e = 1e-5
        slope = (8 * (moved(e) - moved(-e)) - (moved(2 * e) - moved(-2 * e))) / (12 * e)
        instance.set(dict(zip(names, here, strict=True)))
        scale = np.maximum(np.abs(slope), 1e-3 * np.max(np.abs(slope)) + 1e-12)
        worst = max(worst, float(np.max(np.abs(exact - slope) / scale)))
    instance.close()
    assert worst <= TOLERANCE, worst


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_before_initialization_ends_initial_states_count(fmu_folder: Folder, fmi: int) -> None:
    """A start value moves the position one to one; once stepping it moves nothing."""
    instance = Instance(fmu_folder("airframe-copter_default", fmi))
    instance.enter()
    names = ["initial.pos_x", "initial.vel_y"]
    outputs = instance.output_names
    before = derivative(instance, names, np.array([2.0, 3.0]))
    assert before[outputs.index("pos_x")] == 2.0
    assert before[outputs.index("vel_y")] == 3.0
    instance.leave()
    assert not derivative(instance, names, np.array([2.0, 3.0])).any()
    instance.close()


@pytest.mark.parametrize("fmi", [2, 3])
def test_without_states_derivatives_at_the_start_are_those_of_any_instant(
    fmi: int, tmp_path: Path
) -> None:
    m = ComponentBuilder("lift", "Lift of a wing")
    speed = m.input("speed", "1", "Airspeed over that of a cruise", 2.0)
    m.output("lift", "N", "Lift", m.parameter("c", 3.0, "N", "In a cruise") * speed * speed)
    fmu = build(component_model(m.build()), tmp_path / "lift.fmu", fmi)
    instance = Instance(unzip(fmu, tmp_path / "unpacked"))
    instance.enter()
    assert derivative(instance, ["speed", "c"], np.array([1.0, 0.5])) == [2 * 3 * 2 + 0.5 * 4]
    instance.leave()
    instance.set({"speed": 5.0})
    assert derivative(instance, ["speed", "c"], np.array([1.0, 0.5])) == [2 * 3 * 5 + 0.5 * 25]
    instance.close()


@pytest.mark.parametrize("fmi", [2, 3])
def test_wrong_variables_are_refused(fmu_folder: Folder, fmi: int) -> None:
    instance = Instance(fmu_folder("imu", fmi)).start()
    reference = instance.reference
    for unknown, known, words in (
        ("acc_x", "acc_y", "no input or parameter"),
        ("omega_x", "omega_y", "no output"),
    ):
        with pytest.raises(Exception, match="DirectionalDerivative"):
            instance.fmu.getDirectionalDerivative([reference[unknown]], [reference[known]], [1.0])
        assert words in instance.messages[-1]
    instance.close()


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_recorded_flight_depends_on_time_alone(fmu_folder: Folder, fmi: int) -> None:
    instance = Instance(fmu_folder("replay", fmi)).start()
    assert not derivative(instance, [], np.zeros(0)).any()
    instance.close()
