"""Shortcuts in the FMU: tried in order, for steps and for outputs."""

from pathlib import Path

import casadi as ca
import pytest
from instance import Instance, unzip

from fmus import build, component_model
from twin.component import ComponentBuilder


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_first_that_holds_is_taken(tmp_path: Path, fmi: int) -> None:
    """The switched equations are not idle at all, so that the outputs tell which were left out."""
    m = ComponentBuilder("steps", "Rates that shortcuts leave out")
    a, b = (m.parameter(n, 1.0, "1", "Switch", kind="boolean") for n in ("a", "b"))
    x = m.state("x", "1", "What grows", m.parameter("initial.x", 0.0, "1", "Start", fixed=True))
    m.derivative("x", 1 + 10 * a + 100 * b)
    m.output("x", "1", "What grows", x)
    m.output("seen", "1", "Switches that are seen", a + 2 * b)
    h = ca.SX.sym("h")
    m.idle_while(ca.logic_and(x > 10, x < 20), h, [a, b])
    m.idle_while(ca.logic_and(x > 10, x < 30), h, [a])
    m.idle_while(ca.logic_and(x > 40 - 1e4 * h, x < 50), h, [b])
    folder = unzip(build(component_model(m.build()), tmp_path / "s.fmu", fmi), tmp_path / "s")
    instance = Instance(folder)
    for start, rate, seen in (
        (0, 111, 3),
        (15, 1, 0),
        (25, 101, 2),
        (35, 11, 3),
        (45, 11, 1),
        (55, 111, 3),
    ):
        instance.fmu.reset()
        instance.start({"initial.x": start})
        assert instance.get("seen") == seen
        instance.step(0.0)
        assert instance.get("x") == pytest.approx(start + rate * 1e-3, rel=1e-12)
    instance.close()
