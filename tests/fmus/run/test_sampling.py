"""Sampled components: noise, memory and sample instants, in Python and in the FMU alike."""

from pathlib import Path

import numpy as np
import pytest
from instance import Array, Instance, unzip

from cosim.master import Master
from cosim.system import System
from fmus import build, component_model
from twin.component import Component, ComponentBuilder, Run
from twin.component.component import normal

PERIOD_S = 0.0035  # no multiple of the communication step
STEP_S = 1e-3
STEPS = 2000


@pytest.fixture(scope="module")
def sensor() -> Component:
    """A sensor with six noise channels, a random walk, a held reading and a lag behind it."""
    m = ComponentBuilder("sensor", "Sampled example")
    m.sampled(PERIOD_S, "Sample period")
    size = m.parameter("size", 2.0, "m", "Standard deviation of the noise")
    signal = m.input("signal", "m", "What is measured", 1.0)
    draws = [m.noise() for _ in range(6)]
    walk = m.memory("walk", "m", "Random walk")
    m.update("walk", walk + 0.1 * draws[0])
    silence = m.parameter("silence", 0.0, "m", "Standard deviation of a noise that is not drawn")
    held = m.memory("held", "m", "Reading")
    m.update("held", signal + m.noise(silence) + size * draws[5])
    lagged = m.state("lagged", "m", "Reading behind a lag", 0.0)
    m.derivative("lagged", (held - lagged) / 0.02)
    m.output("held", "m", "Reading", held)
    m.output("walk", "m", "Random walk", walk)
    m.output("lagged", "m", "Reading behind a lag", lagged)
    return m.build()


@pytest.fixture(scope="module", params=[2, 3])
def fmu(
    request: pytest.FixtureRequest, sensor: Component, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("sampled")
    return build(component_model(sensor), folder / "sensor.fmu", request.param)


def in_python(sensor: Component, seed: int) -> Array:
    u = sensor.input_values()
    run = Run(sensor, u, sensor.parameter_values({"seed": seed}))
    rows = [run.outputs(u)]
    for k in range(STEPS):
        run.step(k * STEP_S, STEP_S, u)
        rows.append(run.outputs(u))
    return np.array(rows)


def test_noise_of_no_size_is_not_drawn_and_leaves_the_others_alone(sensor: Component) -> None:
    assert sensor.sampling is not None
    sizes = np.asarray(sensor.sampling.sizes(sensor.parameter_values())).ravel()
    assert sizes.tolist() == [1.0] * 6 + [0.0]
    u, p = sensor.input_values(), sensor.parameter_values({"seed": 3})
    loud = sensor.parameter_values({"seed": 3, "silence": 1.0})
    first = normal(3, sensor.sampling.stream, 7, 0, 1)[0]
    held = sensor.output_names.index("held")
    assert Run(sensor, u, p).outputs(u)[held] == 1.0 + 2.0 * first[5]
    assert Run(sensor, u, loud).outputs(u)[held] == 1.0 + first[6] + 2.0 * first[5]


def in_fmu(fmu: Path, seed: int, step_s: float = STEP_S) -> Array:
    with Master(System({"sensor": fmu}, starts={"sensor.seed": seed})) as master:
        master.initialize()
        return master.run(STEPS * STEP_S, step_s).values


@pytest.mark.slow
def test_python_and_fmu_draw_the_same_bits(sensor: Component, fmu: Path) -> None:
    expected, got = in_python(sensor, 5), in_fmu(fmu, 5)
    assert np.array_equal(got[:, :2], expected[:, :2])
    np.testing.assert_allclose(got[:, 2], expected[:, 2], rtol=1e-11, atol=1e-12)
    assert not np.array_equal(in_fmu(fmu, 6)[:, 0], got[:, 0])


def test_readings_are_the_documented_draws(sensor: Component, fmu: Path) -> None:
    """At any time the reading is that of the last sample instant, the first at the start."""
    assert sensor.sampling is not None
    draws = normal(5, sensor.sampling.stream, 6, 0, STEPS)
    times = np.arange(STEPS + 1) * STEP_S
    last = np.floor(times / PERIOD_S + 1e-6).astype(int)
    assert np.array_equal(in_fmu(fmu, 5)[:, 0], 1.0 + 2.0 * draws[last, 5])


def test_the_communication_step_does_not_matter(fmu: Path) -> None:
    fine, coarse = in_fmu(fmu, 5), in_fmu(fmu, 5, 10 * STEP_S)
    assert np.array_equal(fine[::10, :2], coarse[:, :2])
    np.testing.assert_allclose(fine[::10, 2], coarse[:, 2], rtol=1e-5, atol=1e-6)


def test_rollback_with_noise_is_exact(fmu: Path, tmp_path: Path) -> None:
    """Saved at 100 random instants, run on, restored, run again: equal to the last bit."""
    instance = Instance(unzip(fmu, tmp_path)).start({"seed": 3})
    name = "FMUstate" if instance.fmi == 2 else "FMUState"
    get, put, free = (getattr(instance.fmu, verb + name) for verb in ("get", "set", "free"))
    rng = np.random.default_rng(0)
    done = 0
    for _ in range(100):
        ahead = int(rng.integers(1, 20))
        instance.run(ahead, first=done)
        done += ahead
        saved = get()
        once = instance.run(7, first=done)
        put(saved)
        assert np.array_equal(instance.run(7, first=done), once)
        put(saved)
        free(saved)
    instance.close()


def test_a_negative_seed_is_refused(fmu: Path, tmp_path: Path) -> None:
    """Beyond 32 bits and between two integers no importer can ask."""
    instance = Instance(unzip(fmu, tmp_path))
    with pytest.raises(Exception, match="Set"):
        instance.set({"seed": -1})
    assert "seed = -1 is below its minimum 0" in instance.messages[-1]
    instance.close()
