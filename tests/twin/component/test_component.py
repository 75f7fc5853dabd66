"""The component framework: names, ranges, batches, steps."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import BUILTIN

from twin.component import Component, ComponentBuilder, substeps
from twin.errors import ModelError
from twin.physics.airframe import airframe
from twin.vehicle_file import load_vehicle


def oscillator(max_step_s: float = 0.01) -> Component:
    """x'' = -w^2 x + force, with an output that needs the input."""
    m = ComponentBuilder("oscillator", "test", max_step_s)
    w = m.parameter("omega.natural", 2.0, "rad/s", "natural frequency", minimum=0.1, maximum=10.0)
    x0 = m.parameter("initial.x", 1.0, "m", "start", fixed=True)
    force = m.input("force", "m/s2", "specific force", 0.5)
    x = m.state("x", "m", "position", x0)
    v = m.state("v", "m/s", "speed", 0.0)
    m.derivative("x", v)
    m.derivative("v", force - w**2 * x)
    m.output("x", "m", "position", x)
    m.output("sum", "m", "position plus force", x + force)
    return m.build()


def test_step_is_rk4_of_order_four() -> None:
    c = oscillator()
    u, p = c.input_values(), c.parameter_values()
    errors = []
    for n in (20, 40, 80):
        x = np.array([1.0, 0.0])
        for _ in range(n):
            x = np.asarray(c.step(x, u, p, 1.0 / n), dtype=np.float64).ravel()
        errors.append(abs(x[0] - (0.125 + 0.875 * np.cos(2.0))))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all((orders > 3.8) & (orders < 4.2)), orders


def test_unknown_names_get_a_suggestion() -> None:
    c = oscillator()
    with pytest.raises(ModelError, match=r"no parameter 'omega\.naturl'.*mean 'omega\.natural'"):
        c.parameter_values({"omega.naturl": 1.0})
    with pytest.raises(ModelError, match=r"no input 'zzz'\. Known: force"):
        c.input_values({"zzz": 1.0})
    with pytest.raises(ModelError, match=r"no parameter or input 'forc'.*mean 'force'"):
        c.with_starts({"forc": 1.0})


@pytest.mark.parametrize("value", [0.05, 11.0, np.nan, np.inf])
def test_values_out_of_range_are_refused(value: float) -> None:
    with pytest.raises(ModelError, match=r"omega\.natural = "):
        oscillator().parameter_values({"omega.natural": value})


@pytest.mark.parametrize("value", [0.1, 10.0])
def test_bounds_themselves_are_allowed(value: float) -> None:
    assert oscillator().parameter_values({"omega.natural": value})[0] == value


def test_start_value_out_of_range_is_refused_when_declared() -> None:
    m = ComponentBuilder("c", "")
    with pytest.raises(ModelError, match=r"c: mass = -1 kg is outside its range \[0, inf\]"):
        m.parameter("mass", -1.0, "kg", "", minimum=0)


def test_a_name_is_declared_once() -> None:
    m = ComponentBuilder("c", "")
    m.parameter("mass", 1.0, "kg", "")
    with pytest.raises(ModelError, match="'mass' is declared twice"):
        m.input("mass", "kg", "")
    with pytest.raises(ModelError, match="'mass' is declared twice"):
        m.output("mass", "kg", "", 1.0)


def test_with_starts_changes_values_and_leaves_the_original() -> None:
    c = oscillator()
    other = c.with_starts({"force": 0.7, "initial.x": 2.0})
    assert other.input_values()[0] == 0.7
    assert c.input_values()[0] == 0.5
    start = np.asarray(other.initial(other.input_values(), other.parameter_values()))
    np.testing.assert_array_equal(start.ravel(), [2.0, 0.0])
    assert other.variables[0] == c.variables[0]


def test_with_starts_keeps_to_the_range() -> None:
    with pytest.raises(ModelError, match=r"omega\.natural = 99"):
        oscillator().with_starts({"omega.natural": 99.0})
    with pytest.raises(ModelError, match=r"force = nan"):
        oscillator().with_starts({"force": float("nan")})


@pytest.mark.parametrize("vehicle", BUILTIN)
def test_batch_equals_sample_by_sample(vehicle: str) -> None:
    """All four functions take one column per sample; the same bits come out."""
    c = airframe(load_vehicle(vehicle))
    rng = np.random.default_rng(3)
    n = 9
    u, p = c.input_values(), c.parameter_values()
    x = np.asarray(c.initial(u, p), dtype=np.float64).ravel()
    xs = x[:, None] + 0.1 * rng.standard_normal((len(x), n))
    us = u[:, None] + 0.1 * rng.standard_normal((len(u), n))
    ps = np.tile(p[:, None], n)
    for call, arguments in (
        (c.initial, (us, ps)),
        (c.derivatives, (xs, us, ps)),
        (c.outputs, (xs, us, ps)),
        (c.step, (xs, us, ps, np.full((1, n), 1e-3))),
    ):
        batch = np.asarray(call(*arguments))
        for k in range(n):
            one = np.asarray(call(*(a[:, k] for a in arguments))).ravel()
            np.testing.assert_array_equal(batch[:, k], one)


@pytest.mark.slow
@given(duration=st.floats(1e-4, 10.0), longest=st.floats(1e-3, 1.0))
@settings(max_examples=200)
def test_substeps_are_equal_and_short_enough(duration: float, longest: float) -> None:
    n, h = substeps(duration, longest)
    assert n >= 1
    assert n * h == pytest.approx(duration, rel=1e-12)
    assert h <= longest * (1 + 1e-5)
    assert n == 1 or duration / (n - 1) > longest * (1 - 1e-5)  # no more than needed


@pytest.mark.parametrize(
    ("duration", "n"), [(0.001, 1), (0.005, 5), (0.0050000000001, 5), (0.0051, 6), (0.0004, 1)]
)
def test_substeps_forgive_rounding(duration: float, n: int) -> None:
    assert substeps(duration, 1e-3)[0] == n


def test_advance_divides_a_long_step() -> None:
    c = oscillator(max_step_s=0.01)
    u, p = c.input_values(), c.parameter_values()
    whole = c.advance(np.array([1.0, 0.0]), u, p, 0.05)
    parts = np.array([1.0, 0.0])
    for _ in range(5):
        parts = c.advance(parts, u, p, 0.01)
    np.testing.assert_array_equal(whole, parts)
    coarse = np.asarray(c.step(np.array([1.0, 0.0]), u, p, 0.05)).ravel()
    assert np.abs(coarse - whole).max() > 1e-9


def test_projection_follows_each_step() -> None:
    m = ComponentBuilder("c", "")
    x = m.state("x", "1", "", 1.0)
    m.derivative("x", 1.0)
    m.projection("x", ca.fmin(x, 1.05))
    c = m.build()
    assert c.advance(np.array([1.0]), np.zeros(0), np.zeros(0), 0.02)[0] == pytest.approx(1.02)
    assert c.advance(np.array([1.0]), np.zeros(0), np.zeros(0), 0.2)[0] == 1.05


def test_shortcuts_leave_out_what_their_switches_turn_on() -> None:
    """The first leaves out both pulls, the second one of them; with both on neither is exact."""
    m = ComponentBuilder("c", "")
    near, far = (m.parameter(n, 1.0, "1", "", kind="boolean") for n in ("near", "far"))
    x = m.state("x", "1", "", 0.0)
    m.derivative("x", -near * x + far * x**2)
    m.output("pull", "1", "", 3 * near + 5 * far)
    step = ca.SX.sym("step")
    m.idle_while(ca.fabs(x) + step > 8, step, [near, far])
    m.idle_while(ca.fabs(x) > 4, step, [near])
    first, second = m.build().shortcuts
    p, off, half = np.array([1.0, 1.0]), np.array([0.0, 0.0]), np.array([0.0, 1.0])
    c, u = m.build(), np.zeros(0)
    for shortcut, switched in ((first, off), (second, half)):
        for x0 in (-2.0, 0.3, 5.0):
            assert shortcut.step(x0, u, p, 0.01) == c.step(x0, u, switched, 0.01)
            assert shortcut.outputs(x0, u, p) == c.outputs(x0, u, switched)
    over = [[float(s.holds(7.5, p, h)) for s in (first, second)] for h in (1.0, 0.0)]
    assert over == [[1.0, 1.0], [0.0, 1.0]]


def test_flags_stand_for_conditions_and_switch_equations_off() -> None:
    """As a switch: the shortcut is the equations with the condition false, whatever it is."""
    m = ComponentBuilder("c", "")
    x = m.state("x", "1", "", 0.0)
    high = m.flag("high", x > 2)
    m.derivative("x", 1 + ca.if_else(high, x, 0.0))
    m.output("y", "1", "", x + ca.if_else(high, x**2, 0.0))
    m.idle_while(x <= 2, ca.SX.sym("step"), [high])
    c, none = m.build(), np.zeros(0)
    (shortcut,) = c.shortcuts
    for x0, rate, y in ((1.0, 1.0, 1.0), (3.0, 4.0, 12.0)):
        assert float(c.derivatives(x0, none, none)) == rate
        assert float(c.outputs(x0, none, none)) == y
        assert float(shortcut.holds(x0, none, 0.0)) == (x0 <= 2)
        assert float(shortcut.derivatives(x0, none, none)) == 1.0
        assert float(shortcut.outputs(x0, none, none)) == x0


@pytest.mark.parametrize("vehicle", BUILTIN)
def test_interface_table_is_complete(vehicle: str) -> None:
    """Every variable has unit and meaning, names are unique, and starts are within range."""
    c = airframe(load_vehicle(vehicle))
    names = [v.name for v in c.variables]
    assert len(set(names)) == len(names)
    assert all(v.unit and v.description for v in c.variables)
    c.parameter_values({v.name: v.start for v in c.parameters})
