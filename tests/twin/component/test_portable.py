"""The portable functions against NumPy's and SciPy's, which are right to the last bit or two."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from twin.component import portable
from twin.flight.lqr import controller
from twin.flight.mission import mission, mission_names
from twin.flight.px4 import px4_controller
from twin.physics.environment import environment
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]


def evaluate(f: Callable[..., ca.SX], *arguments: Array) -> Array:
    symbols = [ca.SX.sym(f"x{i}") for i in range(len(arguments))]
    function = ca.Function("f", symbols, [f(*symbols)])
    return np.asarray(function.map(len(arguments[0]))(*[a[None, :] for a in arguments])).ravel()


GRID = np.concatenate(
    [np.linspace(-1e4, 1e4, 200_001), np.linspace(-4, 4, 100_001), np.arange(-8, 9) * np.pi / 4]
)


@pytest.mark.slow
@pytest.mark.parametrize(("ours", "theirs"), [(portable.sine, np.sin), (portable.cosine, np.cos)])
def test_circle_functions(ours: Callable[..., ca.SX], theirs: Callable[[Array], Array]) -> None:
    assert np.max(np.abs(evaluate(ours, GRID) - theirs(GRID))) < 3e-16


@pytest.mark.slow
def test_slope_of_the_sine_is_the_cosine() -> None:
    x = ca.SX.sym("x")
    slope = ca.Function("d", [x], [ca.jacobian(portable.sine(x), x)])
    values = np.asarray(slope.map(len(GRID))(GRID[None, :])).ravel()
    assert np.max(np.abs(values - np.cos(GRID))) < 1e-15


def test_angle_of_a_point_on_the_circle() -> None:
    a = np.concatenate([np.linspace(-np.pi + 1e-9, np.pi, 100_001), [0.0, 1e-9, -1e-12, np.pi]])
    found = evaluate(portable.angle, np.cos(a), np.sin(a))
    assert np.max(np.abs(found - a)) < 2e-15


def test_decay() -> None:
    x = np.concatenate([np.linspace(0, 30, 100_001), np.logspace(-12, 0, 1000)])
    assert np.max(np.abs(evaluate(portable.decay, x) / np.exp(-x) - 1)) < 2e-14
    assert evaluate(portable.decay, np.array([50.0]))[0] < 1e-13


@pytest.mark.parametrize("exponent", [4.25588, 5.25588, -0.5, 2.0])
def test_binomial_power(exponent: float) -> None:
    x = np.linspace(-0.25, 0.25, 20_001)
    found = evaluate(lambda s: portable.binomial_power(s, exponent), x)
    assert np.max(np.abs(found / (1 + x) ** exponent - 1)) < 1e-14


LIBM = {
    getattr(ca, f"OP_{n}")
    for n in (
        "SIN",
        "COS",
        "TAN",
        "ASIN",
        "ACOS",
        "ATAN",
        "ATAN2",
        "SINH",
        "COSH",
        "TANH",
        "ASINH",
        "ACOSH",
        "ATANH",
        "EXP",
        "LOG",
        "POW",
        "ERF",
        "EXPM1",
        "LOG1P",
        "HYPOT",
    )
}
"""What the C library computes, whose last bit is its own."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["copter_default", "crazyflie", "feisi_x150"])
def test_components_call_nothing_whose_last_bit_differs(name: str) -> None:
    vehicle = load_vehicle(name)
    components = [controller(vehicle), px4_controller(vehicle), environment(vehicle)]
    components += [mission(vehicle, plan) for plan in mission_names()]
    for component in components:
        functions = [component.initial, component.derivatives, component.step, component.outputs]
        if component.sampling is not None:
            functions.append(component.sampling.update)
        for f in functions:
            used = {f.instruction_id(k) for k in range(f.n_instructions())}
            assert not used & LIBM, (component.name, f.name())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["copter_default", "crazyflie", "feisi_x150"])
def test_slopes_are_finite_at_rest(name: str) -> None:
    """Directional derivatives of an FMU in hover: no square root of zero."""
    vehicle = load_vehicle(name)
    for component in (controller(vehicle), environment(vehicle), mission(vehicle, "tour")):
        x, u = (ca.SX.sym(n, len(t)) for n, t in (("x", component.states), ("u", component.inputs)))
        p = component.parameter_values()
        y = component.outputs(x, u, p)
        slopes = ca.Function("d", [x, u], [ca.jacobian(y, ca.vertcat(x, u))])
        start = component.input_values()
        assert np.all(np.isfinite(np.asarray(slopes(component.initial(start, p), start))))
