"""Equations as text: what they say is what the component computes."""

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.equations import Equation, equations_of
from twin.component import Component
from twin.effects import EFFECTS, effects_for
from twin.flight.assembly import CONTROLLERS
from twin.physics.airframe import airframe
from twin.physics.environment import environment
from twin.physics.sensors.magnetometer import magnetometer
from twin.vehicle_file import load_vehicle

COPTER, X150 = load_vehicle("copter_default"), load_vehicle("feisi_x150")
DRAG = {"rotor_drag.enabled": 1.0, "rotor_drag.k_xy_1_s": 0.3}
CASES: dict[str, tuple[Callable[[], Component], dict[str, float]]] = {
    "rotor speeds": (lambda: airframe(COPTER, effects=effects_for(COPTER)), {}),
    "with rotor drag": (lambda: airframe(X150, effects=effects_for(X150)), DRAG),
    "controller": (lambda: CONTROLLERS["lqr"](COPTER), {}),
    "magnetometer": (lambda: magnetometer(X150, effects_for(X150)), {}),
}


def evaluated(lines: list[Equation], values: dict[str, float]) -> dict[str, float]:
    """Every left side, by Python's own arithmetic; in the order of the lines."""
    known = dict(values)
    functions = {n: getattr(math, n) for n in ("sqrt", "floor", "exp", "sin", "cos", "atan2")}
    functions |= {"max": max, "min": min, "abs": abs, "sign": np.sign}
    for line in lines:
        names = sorted(known, key=len, reverse=True)
        pattern = "|".join(rf"(?<![\w.]){re.escape(n)}(?![\w.(])" for n in names)
        text = re.sub(pattern, lambda m: f"known[{m.group()!r}]", line.right)
        known[line.left] = float(eval(text.replace("^", "**"), {"known": known, **functions}))
    return known


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_text_computes_what_the_component_does(case: str, seed: int) -> None:
    """High above the ground; numbers are written with six digits."""
    make, values = CASES[case]
    component = make()
    rng = np.random.default_rng(seed)
    p = component.parameter_values(values)
    u = component.input_values() + rng.normal(0, 0.1, len(component.inputs))
    x = np.asarray(component.initial(u, p)).ravel()
    names = [s.name for s in component.states]
    moved = [
        i
        for i, n in enumerate(names)
        if re.fullmatch(r"(vel|q|omega|rotor|effort|integral)_\w+", n)
    ]
    x[moved] += rng.normal(0, 0.3, len(moved))
    found = evaluated(
        equations_of(component, values),
        dict(zip(names, x, strict=True)) | dict(zip(component.input_names, u, strict=True)),
    )
    outputs = np.asarray(component.outputs(x, u, p)).ravel()
    rates = np.asarray(component.derivatives(x, u, p)).ravel()
    for name, value in zip(component.output_names, outputs, strict=True):
        assert found[name] == pytest.approx(value, rel=1e-3, abs=1e-3), name
    for i, (name, value) in enumerate(zip(names, rates, strict=True)):
        if f"d {name}/dt" in found:
            assert found[f"d {name}/dt"] == pytest.approx(value, rel=1e-3, abs=1e-3), name
        elif value:
            other = np.array(x)
            other[i] += 0.1
            same = np.asarray(component.outputs(other, u, p)).ravel()
            np.testing.assert_array_equal(same, outputs, name)


def test_a_thrust_is_a_line_with_its_unit() -> None:
    lines = {e.left: e for e in equations_of(airframe(COPTER))}
    assert lines["thrust_1"].unit == "N"
    assert lines["d vel_x/dt"].unit == "m/s2"
    assert lines["d vel_x/dt"].right == (
        "R_xx*specific_force_x + R_xy*specific_force_y + R_xz*specific_force_z"
    )
    assert lines["specific_force_x"].right == "force_x/1.4"


@pytest.mark.slow
def test_ground_contact_is_left_out_unless_asked_for() -> None:
    shown = equations_of(airframe(COPTER)), equations_of(airframe(COPTER), contact=True)
    flight, contact = ("\n".join(e.right for e in lines) for lines in shown)
    assert "pos_z" not in flight
    assert "pos_z" in contact


@pytest.mark.slow
def test_effects_that_are_off_add_nothing() -> None:
    """The same left sides as of a component without them; no state of theirs is read."""
    with_effects = equations_of(airframe(X150, effects=effects_for(X150)))
    assert [e.left for e in with_effects] == [e.left for e in equations_of(airframe(X150))]
    assert not any(name in e.right for e in with_effects for name in EFFECTS)


def test_an_environment_without_gusts_is_its_wind() -> None:
    lines = {e.left: e.right for e in equations_of(environment(COPTER), {"wind.x": 5.0})}
    assert lines["wind_x"] == "5"
