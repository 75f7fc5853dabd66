"""Equations for what the library lacks: the right term, coefficient and unit, or none."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from search_rigs.hypotheses import against, fit_set
from search_rigs.library import library

from twin.component.rows import noiseless_outputs
from twin.explain.explanation import explain
from twin.explain.inference.fit import Fit
from twin.explain.inference.sparse_regression import fold_of, over, sparse
from twin.explain.inference.whitening import Block, WhitenedFlights
from twin.explain.unnamed import _band, _spectrum, covered, explains_better, find_equations
from twin.frames import to_body
from twin.logs import Flight
from twin.logs.columns import MAG
from twin.physics.sensors.magnetometer import magnetometer
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

Array = NDArray[np.float64]
COPTER = load_vehicle("copter_default")
LEGS: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("forward", 2.0, (3.0, 1.0, -1.5)),
    ("forward", 2.0, (0.0, -2.0, -2.0)),
    ("forward", 2.0, (2.5, -2.0, -1.5)),
    ("hover", 1.5, (2.5, -2.0, -1.5)),
)
CUBIC_S_M2 = -0.06
TONE_HZ = 1.37


LIBRARY = ("rotor_drag", "accel_bias", "thrust_scale")
NOTHING = Fit((), {}, (), np.zeros(0), 0.0)


def fitted(flight: Flight, *effects: str) -> tuple[WhitenedFlights, Fit]:
    """The flight with the noise that some effects of a small library leave of it, and their
    numbers."""
    problem = against(flight, COPTER, *LIBRARY)
    fit = fit_set(problem, effects)
    return WhitenedFlights.of(problem.model, fit.values), fit


def planted(flight: Flight, force: Callable[[Array, Array], Array]) -> Flight:
    """The flight with a specific force along body x, of time and body velocity, as it reads."""
    table = flight.table.copy()
    t = table["time"].to_numpy()
    q, v = (
        table[[f"{stem}_{a}" for a in letters]].interpolate(limit_direction="both").to_numpy().T
        for stem, letters in (("q", "wxyz"), ("vel", "xyz"))
    )
    v_b = np.stack([np.asarray(x) for x in to_body(list(q), list(v))])
    table["acc_x"] += force(t, v_b)
    return without_gyro(replace(flight, table=table))


def without_gyro(flight: Flight) -> Flight:
    """The flight with the channels of the accelerometer alone, which is faster."""
    return replace(flight, table=flight.table.drop(columns=[f"gyro_{a}" for a in "xyz"]))


@pytest.fixture(scope="module")
def quiet() -> Flight:
    return fly(COPTER, COPTER, seed=2, name="quiet", waypoints=LEGS)


@pytest.mark.slow
def test_a_foreign_drag_is_found_with_coefficient_and_unit(quiet: Flight) -> None:
    drag = planted(quiet, lambda _, v: CUBIC_S_M2 * (v * v).sum(axis=0) * v[0])
    whitened, _ = fitted(drag)
    found = find_equations(whitened, NOTHING)
    assert found is not None
    (equation,) = found.equations
    assert equation.channel == "acc_x"
    term, coefficient, unit = equation.terms[0]
    assert (term, unit) == ("|v|² v_x", "s/m²")
    assert coefficient == pytest.approx(CUBIC_S_M2, rel=0.05)
    assert equation.expression.startswith(f"acc_x = {coefficient:g} s/m² * |v|² v_x")
    assert equation.share > 0.9
    assert found.gain == pytest.approx(equation.gain)
    _, bias = fitted(drag, "accel_bias")
    assert explains_better(whitened, [NOTHING, bias], found)


@pytest.mark.slow
def test_a_constant_has_no_equation_where_means_are_judged_elsewhere(quiet: Flight) -> None:
    steady, _ = fitted(planted(quiet, lambda t, _: np.full(len(t), 0.5)))
    assert find_equations(steady, NOTHING) is not None
    assert find_equations(steady, NOTHING, means=False) is None
    varied, _ = fitted(planted(quiet, lambda _, v: 0.5 + CUBIC_S_M2 * (v * v).sum(axis=0) * v[0]))
    found = find_equations(varied, NOTHING, means=False)
    assert found is not None
    values = {term: value for term, value, _ in found.equations[0].terms}
    assert values["|v|² v_x"] == pytest.approx(CUBIC_S_M2, rel=0.1)


@pytest.mark.slow
def test_a_shaking_is_found_with_its_frequency(quiet: Flight) -> None:
    whitened, _ = fitted(planted(quiet, lambda t, _: 0.4 * np.sin(2 * np.pi * TONE_HZ * t)))
    found = find_equations(whitened, NOTHING)
    assert found is not None
    (equation,) = found.equations
    hz = [float(term.split()[1]) for term, _, _ in equation.terms if "Hz" in term]
    assert hz
    assert np.allclose(hz, TONE_HZ, atol=0.03)
    size = np.linalg.norm([c for term, c, _ in equation.terms if "Hz" in term][:2])
    assert size == pytest.approx(0.4, rel=0.1)


@pytest.mark.slow
def test_no_equation_where_nothing_is_missing(quiet: Flight) -> None:
    whitened, _ = fitted(quiet)
    assert find_equations(whitened, NOTHING) is None
    assert not explains_better(whitened, [NOTHING], None)


@pytest.mark.slow
def test_an_effect_of_the_library_is_not_called_unnamed() -> None:
    drag = COPTER.drag_linear_n_s_m + 0.5 * COPTER.mass_kg * np.array([1.0, 1.0, 0.0])
    dragged = fly(COPTER, replace(COPTER, drag_linear_n_s_m=drag), 1, "drag", LEGS)
    whitened, right = fitted(without_gyro(dragged), "rotor_drag")
    alone = find_equations(whitened, NOTHING)
    assert alone is not None
    assert covered(whitened, right, alone) > 0.9
    assert not explains_better(whitened, [NOTHING, right], alone)


def test_only_columns_that_pay_out_of_sample_are_picked() -> None:
    rng = np.random.default_rng(0)
    x, keys = rng.standard_normal((40, 50, 30)), [(0, k) for k in range(40)]
    noise = rng.standard_normal((40, 50))
    true = np.zeros(30)
    true[[3, 17]] = 0.5, -0.4
    for coefficients, picked in ((true, (3, 17)), (0 * true, None)):
        y = x @ coefficients + noise
        blocks = {
            k: Block(a.T @ a, a.T @ b, float(b @ b)) for k, a, b in zip(keys, x, y, strict=True)
        }
        found = sparse(blocks, fold_of(keys, 0))
        assert (found and found.picked) == picked
        if found:
            assert found.coefficients == pytest.approx([0.5, -0.4], abs=0.1)
            assert found.gain == pytest.approx(0.5 * 2000 * 0.41, rel=0.15)


@pytest.mark.parametrize(
    ("channel", "term", "text"),
    [
        ({"m": 1, "s": -2}, {"m": 3, "s": -3}, "s/m²"),
        ({"m": 1, "s": -2}, {}, "m/s²"),
        ({"rad": 1, "s": -2}, {"rad": 1, "s": -1}, "1/s"),
        ({"m": 1, "s": -2}, {"m": 1, "s": -2}, "1"),
        ({"m": 1, "s": -2}, {"V": 1}, "m/(s² V)"),
    ],
)
def test_units_of_coefficients(channel: dict[str, int], term: dict[str, int], text: str) -> None:
    assert over(channel, term) == text


@pytest.mark.parametrize("n", [400, 401])
def test_power_by_frequency_is_the_power(n: int) -> None:
    values = np.random.default_rng(0).standard_normal(n) + 2
    assert _spectrum(values)[1].sum() == pytest.approx(values @ values)
    slow = np.sin(2 * np.pi * 1.5 * np.arange(n) / 50)
    assert _band([slow], 0.95) == pytest.approx(1.5, abs=0.2)


@pytest.mark.slow
def test_what_is_too_small_for_a_name_is_no_equation_either() -> None:
    """A compass that nobody calibrated, 1.2 microtesla off, read without much noise."""
    sensor, flights = magnetometer(COPTER), []
    for seed in (1, 2):
        flight = fly(COPTER, COPTER, seed=seed, name=f"compass_{seed}", waypoints=LEGS)
        table, rng = flight.table.copy(), np.random.default_rng(seed)
        rows = np.tile(sensor.input_values(), (len(table), 1))
        for a in "wxyz":
            turned = table[f"q_{a}"].interpolate(limit_direction="both")
            rows[:, sensor.input_names.index(f"q_{a}")] = turned
        field = noiseless_outputs(sensor, rows, 0.005) + np.array([8e-7, -8e-7, 4e-7])
        noisy = field + 5e-8 * rng.standard_normal(field.shape)
        flights.append(replace(flight, table=table.assign(**dict(zip(MAG, noisy.T, strict=True)))))
    with library((*LIBRARY, "mag_hard_iron", "mag_soft_iron", "heading_offset")):
        found = explain(flights[:1], flights[1:], COPTER, missions=(), suggest=False)
    assert found.verdict == "nothing"
