"""Algebraic loops: against exact solutions, with and without derivatives and dependencies."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from alter import NO_DERIVATIVES, UNKNOWN_DEPENDENCIES, altered
from numpy.typing import NDArray

from cosim.master import Algorithm, Master
from cosim.slave import Slave, jacobian
from cosim.stepping import batches, stepping_order
from cosim.system import Connection, System
from fmus import build, component_model
from fmus.order import Loop, visits
from twin.component import Component, ComponentBuilder
from twin.errors import FmuError

Array = NDArray[np.float64]
H = 0.01


def line() -> Component:
    """y = a u + b + t-dependent drift."""
    m = ComponentBuilder("line", "A straight line")
    a, b = (m.parameter(n, v, "1", "Coefficient") for n, v in (("a", 0.2), ("b", 0.5)))
    u, drift = (m.input(n, "1", "Input") for n in ("u", "drift"))
    m.output("y", "1", "Output", a * u + b + drift)
    return m.build()


def parabola() -> Component:
    """y = u**2: with the line, y1 = a y1**2 + b."""
    m = ComponentBuilder("parabola", "A parabola")
    u = m.input("u", "1", "Input")
    m.output("y", "1", "Output", u * u)
    m.output("other", "1", "Does not feel u", 3.0)
    return m.build()


def ramp() -> Component:
    m = ComponentBuilder("ramp", "Its output is its state")
    rate = m.parameter("rate", 1.0, "1/s", "Slope")
    x = m.state("x", "1", "State", 0.0)
    m.derivative("x", rate)
    m.output("y", "1", "Output", x)
    return m.build()


def settled_state() -> Component:
    """A lag that starts settled on half of its input plus one."""
    m = ComponentBuilder("settled_state", "A lag")
    u = m.input("u", "1", "Input")
    x = m.state("x", "1", "State", 0.5 * u + 1.0)
    m.derivative("x", 0.5 * u + 1.0 - x)
    m.output("y", "1", "Output", x)
    return m.build()


COMPONENTS = {
    "line": line,
    "parabola": parabola,
    "ramp": ramp,
    "settled_state": settled_state,
}


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """(component, FMI version, changes of modelDescription.xml) -> FMU."""
    folder = tmp_path_factory.mktemp("loops")

    def get(name: str, fmi: int = 2, changes: Mapping[str, str] | None = None) -> Path:
        path = folder / f"{name}{fmi}.fmu"
        if not path.exists():
            build(component_model(COMPONENTS[name]()), path, fmi)
        if not changes:
            return path
        new = f"{path.stem}-{len(list(folder.iterdir()))}.fmu"
        return altered(path, new, changes)

    return get


def ring(
    fmu: Callable[..., Path], fmi: int = 2, changes: Mapping[str, str] | None = None
) -> System:
    """A loop of line and parabola whose offset grows in time."""
    return System(
        {
            "line": fmu("line", fmi, changes),
            "parabola": fmu("parabola", fmi, changes),
            "ramp": fmu("ramp", fmi),
        },
        (
            Connection("line.y", "parabola.u"),
            Connection("parabola.y", "line.u"),
            Connection("ramp.y", "line.drift"),
        ),
    )


def solution(b: Array, a: float = 0.2) -> Array:
    """The smaller root of a y**2 - y + b = 0, next to the start at y = 0."""
    return np.asarray((1 - np.sqrt(1 - 4 * a * b)) / (2 * a))


@pytest.mark.parametrize("algorithm", ["settled", "gauss_seidel"])
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    "changes",
    [None, NO_DERIVATIVES, UNKNOWN_DEPENDENCIES, UNKNOWN_DEPENDENCIES | NO_DERIVATIVES],
    ids=["derivatives", "differences", "unknown", "unknown differences"],
)
def test_against_the_exact_solution(
    fmu: Callable[..., Path], algorithm: Algorithm, fmi: int, changes: Mapping[str, str] | None
) -> None:
    with Master(ring(fmu, fmi, changes)) as master:
        master.initialize()
        run = master.run(50 * H, H, algorithm)
    exact = solution(0.5 + run.time_s)
    assert np.ptp(exact) > 0.5
    np.testing.assert_allclose(run["line.y"], exact, rtol=2e-12)
    np.testing.assert_allclose(run["parabola.y"], exact**2, rtol=4e-12)


@pytest.mark.slow
def test_jacobi_solves_the_start_alone(fmu: Callable[..., Path]) -> None:
    """While stepping, each slave takes what the other had at the start of the step."""
    with Master(ring(fmu)) as master:
        master.initialize()
        run = master.run(20 * H, H, "jacobi")
    assert run["line.y"][0] == pytest.approx(float(solution(np.array(0.5))), rel=1e-12)
    drift = np.concatenate([[0.0], run.time_s[:-1]])
    np.testing.assert_allclose(
        run["line.y"][1:], 0.2 * run["parabola.y"][:-1] + 0.5 + drift[1:], rtol=1e-13
    )
    np.testing.assert_allclose(run["parabola.y"][1:], run["line.y"][:-1] ** 2, rtol=1e-13)


def test_loop_of_initial_states(fmu: Callable[..., Path]) -> None:
    """x = 0.5 y + 1, y = 0.5 x + 1 at the start alone; two rounds of passing on miss it."""
    system = System(
        {"a": fmu("settled_state"), "b": fmu("settled_state", 3)},
        (Connection("a.y", "b.u"), Connection("b.y", "a.u")),
    )
    with Master(system) as master:
        assert not any(master._stepping._bus.dependencies().values())
        master.initialize()
        run = master.run(1.0, 0.1)
    np.testing.assert_allclose(run.values, 2.0, rtol=1e-12)


@pytest.mark.parametrize("algorithm", ["settled", "gauss_seidel"])
def test_slower_slave_in_a_loop_holds(fmu: Callable[..., Path], algorithm: Algorithm) -> None:
    """Between its own steps the parabola answers nothing, so there is no loop to solve."""
    system = ring(fmu)
    slow = System(system.fmus, system.connections, {}, {"parabola": 4})
    with Master(slow) as master:
        master.initialize()
        run = master.run(16 * H, H, algorithm)
    held = run["parabola.y"]
    assert len(np.unique(held)) == 5
    np.testing.assert_allclose(run["line.y"], 0.2 * held + 0.5 + run.time_s, rtol=1e-11)
    np.testing.assert_allclose(run["line.y"][::4], solution(0.5 + run.time_s[::4]), rtol=1e-11)


def test_no_solution_names_loop_and_time(fmu: Callable[..., Path]) -> None:
    """1 - 4 a b < 0 from t = 0.75 s on."""
    with Master(ring(fmu)) as master:
        master.initialize()
        with pytest.raises(
            FmuError,
            match=r"Algebraic loop line\.y -> parabola\.y at 0\.76 s: Newton's method does not "
            r"converge; residual .* at \w+\.y\. Put a state or a delay",
        ):
            master.run(1.0, H, "settled")
        with pytest.raises(FmuError, match="call initialize"):  # half a step is no state to go on
            master.run(2.0, H)
        master.initialize()
        master.run(0.5, H, "settled")


def test_no_unique_solution(fmu: Callable[..., Path]) -> None:
    """y = y: any value would do."""
    system = System({"a": fmu("line")}, (Connection("a.y", "a.u"),), {"a.a": 1.0, "a.b": 0.0})
    with Master(system) as master:
        with pytest.raises(FmuError, match=r"loop a\.y at 0 s: it has no unique solution"):
            master.initialize()
        master.initialize(starts={"a.a": -3.0, "a.b": 2.0})
        assert master.run(H, H, "settled")["a.y"] == pytest.approx([0.5, 0.5], rel=1e-13)


@pytest.mark.parametrize("fmi", [2, 3])
def test_jacobian_by_call_and_by_differences(fmu: Callable[..., Path], fmi: int) -> None:
    for changes in (None, NO_DERIVATIVES):
        slave = Slave("p", fmu("parabola", fmi, changes))
        try:
            slave.bind(["u"], ["y", "other"], np.array([0.75]), np.zeros(2))
            slave.initialize(0.0, {})
            slave.finish_initialization()
            slave.write_inputs()
            slave.read_outputs()
            matrix = jacobian(slave, ["other", "y"], ["u"])()
            np.testing.assert_allclose(matrix, [[0.0], [1.5]], rtol=1e-7)
            assert slave.outputs.tolist() == [0.5625, 3.0]
        finally:
            slave.close()


# -- order ----------------------------------------------------------------------------------


def test_order_of_visits() -> None:
    """c needs the loop of a and b; a comes again for what c gives."""
    dependencies = {
        "c.y": {"b.y"},
        "a.y": {"b.y"},
        "a.z": {"c.y"},
        "b.y": {"a.y", "d.y"},
        "d.y": set(),
    }
    order = visits(dependencies)
    loop = Loop(("a.y", "b.y"))
    assert order == ["d", loop, "c", "a"]
    assert stepping_order(order, ["a", "b", "c", "d", "e"]) == ["d", "b", "c", "a", loop, "e"]


def test_slaves_that_do_not_feel_each_other_are_one_batch() -> None:
    dependencies = {"a.y": {"x.y"}, "b.y": {"x.y"}, "c.y": {"b.y"}}
    assert batches(visits(dependencies), dependencies) == [("a", "b"), ("c",)]


def test_two_loops_are_two() -> None:
    dependencies = {"a.y": {"b.y"}, "b.y": {"a.y"}, "c.y": {"d.y", "a.y"}, "d.y": {"c.y"}}
    assert visits(dependencies) == [Loop(("a.y", "b.y")), Loop(("c.y", "d.y"))]
    assert stepping_order(visits(dependencies), "abcd") == [
        "a",
        "b",
        Loop(("a.y", "b.y")),
        "c",
        "d",
        Loop(("c.y", "d.y")),
    ]


def test_loops_with_a_common_slave_are_solved_in_their_order() -> None:
    dependencies = {"a.y": {"b.y"}, "b.y": {"a.y"}, "a.z": {"b.z"}, "b.z": {"a.z", "a.y"}}
    first, second = Loop(("a.y", "b.y")), Loop(("a.z", "b.z"))
    assert visits(dependencies) == [first, second]
    assert stepping_order(visits(dependencies), "ab") == ["a", "b", first, second]
