"""What depends on parameters alone is computed once, and again whenever one of them changes."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from instance import Instance, unzip

from fmus import build, component_model
from fmus.kernels import kernels
from twin.component import Component, ComponentBuilder, Run


def swing() -> Component:
    """A pendulum: its frequency and its line of late readings depend on parameters alone."""
    m = ComponentBuilder("swing", "Damped pendulum with a late reading")
    period = m.sampled(1e-3, "Period of the readings")
    length = m.parameter("length", 0.3, "m", "Length", minimum=0.01)
    late = m.parameter("late", 2.5, "1", "Delay in periods", minimum=0, maximum=8)
    a = m.state("angle", "rad", "Angle", 0.4)
    w = m.state("rate", "rad/s", "Rate", 0.0)
    m.derivative("angle", w)
    m.derivative("rate", -9.81 / length * a - 0.1 * ca.sqrt(9.81 / length) * w)
    kept = m.memory("kept", "rad", "Reading", a)
    m.update("kept", m.delayed("kept", a, late * period, 10))
    m.output("angle", "rad", "Angle", a)
    m.output("height", "m", "Height", length * length * a * a / (2 * length))
    m.output("reading", "rad", "Late angle", kept)
    return m.build()


def test_operations_on_parameters_alone_are_taken_out() -> None:
    """No kernel of a step has a square root left; `prepare` has them, each once."""
    made = {f.name(): f for f in kernels(swing(), exchange=False).functions}
    roots = {
        name: sum(f.instruction_id(k) == ca.OP_SQRT for k in range(f.n_instructions()))
        for name, f in made.items()
        if name in ("prepare", "step", "outputs", "update")
    }
    assert roots == {"prepare": 1, "step": 0, "outputs": 0, "update": 0}


@pytest.mark.parametrize("fmi", [2, 3])
def test_changes_are_felt_as_in_python(tmp_path: Path, fmi: int) -> None:
    """Set while stepping, after a reset, and brought back with a saved state: bit by bit."""
    c = swing()
    instance = Instance(unzip(build(component_model(c), tmp_path / "s.fmu", fmi), tmp_path / "s"))
    u = np.zeros(0)

    def python(lengths: list[float]) -> list[list[float]]:
        """Outputs after each step at these lengths."""
        run, rows = Run(c, u, c.parameter_values({"length": lengths[0]})), []
        for k, length in enumerate(lengths):
            run.p = c.parameter_values({"length": length})
            run.step(k * 1e-3, 1e-3, u)
            rows.append(run.outputs(u).tolist())
        return rows

    def native(lengths: list[float], first: int = 0) -> list[list[float]]:
        """The same of the FMU."""
        rows = []
        for k, length in enumerate(lengths, start=first):
            instance.set({"length": length})
            instance.step(k * 1e-3)
            rows.append(instance.outputs().tolist())
        return rows

    instance.start()
    long = [0.3] * 5
    assert native(long + [0.1] * 5) == python(long + [0.1] * 5)
    instance.fmu.reset()
    instance.start()
    instance.step(0.0)  # the length is the one at the start again: nobody set it
    assert instance.outputs().tolist() == python([0.3])[0]
    instance.fmu.reset()
    instance.start({"length": 0.7})
    assert native([0.7] * 5) == python([0.7] * 5)
    saved = instance.fmu.getFMUState()
    native([0.2] * 3, first=5)
    instance.fmu.setFMUState(saved)
    instance.step(5e-3)  # the length came back with the state: nobody set it
    assert instance.outputs().tolist() == python([0.7] * 6)[-1]
    instance.close()
