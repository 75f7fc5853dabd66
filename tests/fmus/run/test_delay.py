"""Delay lines of sampled components: against exact answers, in Python and in the FMU alike."""

import copy
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from instance import Array, Instance, unzip

from cosim.master import Master
from cosim.system import System
from fmus import build, component_model
from twin.component import Component, ComponentBuilder, Run
from twin.errors import ModelError

PERIOD_S = 0.004
STEP_S = 1e-3
OMEGA = 12.0
CAPACITY = 11
DELAYS_S = (0.0, 0.004, 0.0054, 0.0131, 0.04)  # present, one period, fractions, the longest


def delayed(delays_s: Sequence[float] = DELAYS_S, period_s: float = PERIOD_S) -> Component:
    """A ramp, a sine and an input, each seen a while ago, and the input as it is."""
    m = ComponentBuilder("late", "Late signals")
    m.sampled(period_s, "Time between two samples")
    u = m.input("u", "1", "Any signal", 0.5)
    signals = {"u": u}
    for name, start, rate in (("ramp", 2.0, 1.0), ("sine", 0.0, None), ("cosine", 1.0, None)):
        signals[name] = m.state(name, "1", name.capitalize(), start)
        if rate is not None:
            m.derivative(name, rate)
    m.derivative("sine", OMEGA * signals["cosine"])
    m.derivative("cosine", -OMEGA * signals["sine"])
    for i, delay_s in enumerate(delays_s):
        delay = m.parameter(f"delay_{i}", delay_s, "s", "Delay")
        for name in ("ramp", "sine", "u"):
            memory = m.memory(f"{name}_{i}", "1", f"Late {name}")
            late = m.delayed(f"{name}_{i}", signals[name], delay, CAPACITY)
            m.update(f"{name}_{i}", late)
            m.output(f"{name}_{i}", "1", f"Late {name}", memory)
    held = m.memory("held", "1", "Input at the last sample instant")
    m.update("held", u)
    m.output("held", "1", "Input at the last sample instant", held)
    return m.build()


@pytest.fixture(scope="module")
def component() -> Component:
    return delayed()


@pytest.fixture(scope="module", params=[2, 3])
def folder(
    request: pytest.FixtureRequest, component: Component, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The FMU, extracted."""
    made = tmp_path_factory.mktemp("delay")
    path = build(component_model(component), made / "late.fmu", request.param)
    return unzip(path, made / "late")


def in_python(component: Component, inputs: Array, step_s: float = STEP_S) -> Array:
    """Outputs at the start and after each step, the input changing before each."""
    run = Run(component, inputs[:1], component.parameter_values())
    rows = [run.outputs(inputs[:1])]
    for k in range(1, len(inputs)):
        run.step((k - 1) * step_s, step_s, inputs[k : k + 1])
        rows.append(run.outputs(inputs[k : k + 1]))
    return np.array(rows)


def in_fmu(folder: Path, inputs: Array, step_s: float = STEP_S) -> Array:
    instance = Instance(folder)
    instance.start({"u": inputs[0]})
    rows = [instance.outputs()]
    for k in range(1, len(inputs)):
        instance.set({"u": inputs[k]})
        instance.step((k - 1) * step_s, step_s)
        rows.append(instance.outputs())
    instance.close()
    return np.array(rows)


def column(component: Component, values: Array, name: str) -> Array:
    """An output at the sample instants."""
    return values[:: round(PERIOD_S / STEP_S), component.output_names.index(name)]


@pytest.mark.slow
def test_ramp_sine_and_samples_against_the_exact_answer(component: Component) -> None:
    inputs = np.random.default_rng(0).standard_normal(2001)
    values = in_python(component, inputs)
    t = np.arange(501) * PERIOD_S
    sampled = inputs[::4]
    for i, delay_s in enumerate(DELAYS_S):
        at = np.maximum(t - delay_s, 0.0)
        ramp = column(component, values, f"ramp_{i}")
        np.testing.assert_allclose(ramp, 2.0 + at, rtol=0, atol=1e-12)
        whole = abs(delay_s / PERIOD_S - round(delay_s / PERIOD_S)) < 1e-9
        bound = 1e-7 if whole else (OMEGA * PERIOD_S) ** 2 / 8  # RK4; of the straight line
        sine = column(component, values, f"sine_{i}")
        assert np.abs(sine - np.sin(OMEGA * at)).max() < bound * (1 + 1e-6)
        expected = np.interp(at, t, sampled)
        np.testing.assert_allclose(column(component, values, f"u_{i}"), expected, atol=1e-11)


def test_no_delay_is_the_signal_itself(component: Component) -> None:
    values = in_python(component, np.random.default_rng(1).standard_normal(400))
    names = component.output_names
    assert np.array_equal(values[:, names.index("u_0")], values[:, names.index("held")])


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [STEP_S, 0.0025, 0.03])
def test_python_and_fmu_agree_to_the_bit(component: Component, folder: Path, step_s: float) -> None:
    """Of samples; of integrated states to the rounding of two compilers."""
    inputs = np.random.default_rng(2).standard_normal(600)
    expected, got = in_python(component, inputs, step_s), in_fmu(folder, inputs, step_s)
    exact = [n.startswith(("u_", "held")) for n in component.output_names]
    assert expected[:, exact].tobytes() == got[:, exact].tobytes()
    np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-12)


@pytest.mark.slow
def test_rollback_is_exact(component: Component, folder: Path) -> None:
    """Of the FMU by its state, of the Python run by a copy."""
    rng = np.random.default_rng(3)
    instance = Instance(folder).start()
    run = Run(component, component.input_values(), component.parameter_values())

    def onward(first: int, inputs: Array) -> tuple[bytes, bytes]:
        """Both, some steps on."""
        rows: tuple[list[Array], list[Array]] = [], []
        for k, u in enumerate(inputs, start=first):
            instance.set({"u": float(u)})
            instance.step(k * STEP_S)
            run.step(k * STEP_S, STEP_S, np.array([u]))
            rows[0].append(instance.outputs())
            rows[1].append(run.outputs(np.array([u])))
        return np.array(rows[0]).tobytes(), np.array(rows[1]).tobytes()

    done = 0
    for ahead in rng.integers(1, 30, size=30):
        onward(done, rng.standard_normal(ahead))
        done += int(ahead)
        inputs, state, kept = rng.standard_normal(60), instance.fmu.getFMUState(), copy.copy(run)
        first = onward(done, inputs)
        instance.fmu.setFMUState(state)
        run = copy.copy(kept)
        assert onward(done, inputs) == first
        instance.fmu.setFMUState(state)
        instance.fmu.freeFMUState(state)
        run = kept
    instance.close()


def test_delays_that_do_not_fit(component: Component, folder: Path) -> None:
    longest = (CAPACITY - 1) * PERIOD_S
    u = component.input_values()
    instance = Instance(folder)
    for delay_s in (longest * 1.001, -1e-9):
        text = (
            f"delay ramp_2 = {delay_s:g} s must be from 0 to {longest:g} s: "
            f"make it shorter or sample_period longer"
        )
        with pytest.raises(ModelError, match=f"late: {text}"):
            Run(component, u, component.parameter_values({"delay_2": delay_s}))
        with pytest.raises(Exception, match="Exit"):
            instance.start({"delay_2": delay_s})
        assert instance.messages[-1] == text
        instance.fmu.reset()
    # A tunable delay may leave the range later; the step in which it does so fails.
    instance.start()
    instance.set({"delay_2": 0.05})
    instance.run(3)
    with pytest.raises(Exception, match="DoStep"):
        instance.step(3 * STEP_S)
    assert "delay ramp_2 = 0.05 s" in instance.messages[-1]
    instance.close()


def test_directional_derivative_at_the_start(folder: Path) -> None:
    """Whatever the delay, the first value is the input's."""
    instance = Instance(folder)
    instance.enter()
    reference = instance.reference
    for i in range(len(DELAYS_S)):
        get = instance.fmu.getDirectionalDerivative
        assert get([reference[f"u_{i}"]], [reference["u"]], [3.0])[0] == 3.0
        assert get([reference[f"u_{i}"]], [reference[f"delay_{i}"]], [3.0])[0] == 0.0
    instance.close()


def test_one_sample_is_enough_for_no_delay(tmp_path: Path) -> None:
    m = ComponentBuilder("late", "Capacity one")
    m.sampled(PERIOD_S, "Time between two samples")
    u = m.input("u", "1", "Any signal", 0.5)
    m.output("y", "1", "The same", m.memory("y", "1", "The same"))
    m.update("y", m.delayed("y", 2 * u, m.parameter("delay", 0.0, "s", "Delay"), 1))
    c = m.build()
    path = build(component_model(c), tmp_path / "late.fmu")
    with Master(System({"late": path}, starts={"late.u": 0.7})) as master:
        master.initialize()
        assert set(master.run(0.1, STEP_S)["late.y"]) == {1.4}


# -- builder --------------------------------------------------------------------------------


def test_the_seed_comes_with_the_noise() -> None:
    def names(noisy: bool) -> list[str]:
        m = ComponentBuilder("c", "")
        m.parameter("first", 1.0, "1", "")
        m.sampled(PERIOD_S, "")
        m.parameter("last", 1.0, "1", "")
        x = m.memory("x", "1", "")
        m.update("x", x + (m.noise() if noisy else 1.0))
        return [v.name for v in m.build().parameters]

    assert names(True) == ["first", "sample_period", "seed", "last"]
    assert names(False) == ["first", "sample_period", "last"]


def test_refusals() -> None:
    m = ComponentBuilder("c", "")
    x = m.memory("x", "1", "")
    with pytest.raises(ModelError, match="delay 'x' needs at least 1 sample, not 0"):
        m.delayed("x", x, x, 0)
    m.update("x", x + 1)
    with pytest.raises(ModelError, match=r"c: updates need a sample period: call sampled\(\)"):
        m.build()
