"""Noise of the channels: its law is found again, and columns that begin or pass are exact."""

import numpy as np
import pytest
from scipy.signal import lfilter

from twin.why.noise import Law, Whitened

ONE = 1
"""Place of the constant among the columns."""


@pytest.mark.parametrize(("phi", "theta"), [(0.98, 0.9), (0.8, 0.0), (0.99, 0.5)])
def test_columns_from_an_onset_on_are_those_of_a_filter_that_saw_them_so(
    phi: float, theta: float
) -> None:
    """Sums over time against the filter run on truncated columns; equal up to rounding."""
    rng, n = np.random.default_rng(0), 200
    columns, weight = rng.standard_normal((n, 3)), rng.uniform(0.02, 1.0, n)
    columns[:, ONE] = 1.0
    law = Law(phi, theta, 0.7)
    whole = Whitened.each(law, weight, columns[:, None])[0]
    start, onset, over, end = (np.array(x) for x in ([5, 20], [60, 100], [75, 101], [180, 140]))
    found = whole.passing(whole.joined(start, onset, end), ONE, onset, over, end)
    for i in range(2):
        begun = np.where(np.arange(n)[:, None] < onset[i], 0.0, columns)
        passes = (np.arange(n) >= onset[i]) & (np.arange(n) < over[i])
        joined = np.column_stack([columns, begun, passes])
        rows = Whitened.each(law, weight, joined[:, None])[0].rows[start[i] : end[i]]
        assert found[i] == pytest.approx(rows.T @ rows, abs=1e-9)


@pytest.mark.parametrize(("phi", "theta"), [(0.98, 0.9), (0.8, 0.0)])
def test_columns_that_grow_are_those_of_a_filter_that_saw_them_grow(
    phi: float, theta: float
) -> None:
    rng, n = np.random.default_rng(1), 200
    columns, more = rng.standard_normal((n, 3)), rng.standard_normal((n, 2))
    weight = rng.uniform(0.02, 1.0, n)
    whole = Whitened.each(Law(phi, theta, 0.7), weight, columns[:, None])[0]
    start, onset, end = (np.array(x) for x in ([5, 20], [60, 100], [180, 140]))
    found = whole.growing(whole.joined(start, onset, end), more, 30.0, onset, end)
    for i in range(2):
        since = np.arange(n) - onset[i]
        begun = np.where(since[:, None] < 0, 0.0, columns)
        grown = np.clip((since + 0.5) / 30.0, 0.0, 1.0)[:, None] * more
        joined = np.column_stack([columns, begun, grown])
        rows = Whitened.each(Law(phi, theta, 0.7), weight, joined[:, None])[0].rows
        inside = rows[start[i] : end[i]]
        assert found[i] == pytest.approx(inside.T @ inside, abs=1e-9)


def test_a_shape_that_is_over_enters_as_if_it_were_a_column() -> None:
    """Also where the record ends within it."""
    rng = np.random.default_rng(0)
    columns, weight = rng.standard_normal((400, 3)), rng.uniform(0.01, 1.0, 400)
    law, shape = Law(0.95, 0.6, 0.3), np.hanning(42)[1:-1]
    start, onset, end = np.array([10, 20]), np.array([100, 150]), np.array([300, 160])
    whitened = Whitened.each(law, weight, columns[:, None])[0]
    found = whitened.pulsed(whitened.joined(start, onset, end), shape, onset, end)
    for i, begins in enumerate(onset):
        pulse = np.zeros(400)
        pulse[begins : begins + len(shape)] = shape
        begun = columns * (np.arange(400) >= begins)[:, None]
        joined = np.column_stack([columns, begun, pulse])
        rows = Whitened.each(law, weight, joined[:, None])[0].rows
        inside = rows[start[i] : end[i]]
        assert found[i] == pytest.approx(inside.T @ inside, abs=1e-9)


def test_a_step_that_lasts_counts_more_than_its_first_interval() -> None:
    """Under a slow level with white noise; an AR(1) of the same lag forgets it at once."""
    n, step = 300, np.ones((300, 1, 1))
    weights = np.ones(n)
    slow = Whitened.each(Law(0.98, 0.9, 1.0), weights, step)[0].rows[:, 0]
    quick = Whitened.each(Law(0.95, 0.0, 1.0), weights, step)[0].rows[:, 0]
    assert (slow**2).sum() > 4 * (quick**2).sum()


@pytest.mark.parametrize(("phi", "theta"), [(0.95, 0.0), (0.98, 0.8)])
def test_the_law_is_found_in_noise_with_outliers(phi: float, theta: float) -> None:
    rng = np.random.default_rng(3)
    left = lfilter([1.0, -theta], [1.0, -phi], 0.5 * rng.standard_normal(4000))
    found = Law.of(np.asarray(left), 0.0)
    assert abs(found.phi - phi) <= 0.03 and abs(found.theta - theta) <= 0.1
    assert found.sd == pytest.approx(0.5, rel=0.05)


def test_an_outlier_of_no_weight_leaves_no_trace() -> None:
    values = np.zeros((50, 1, 1))
    values[20] = 100.0
    weight = np.where(np.arange(50) == 20, 0.0, 1.0)
    rows = Whitened.each(Law(0.98, 0.5, 1.0), weight, values)[0].rows
    assert np.abs(rows).max() == 0.0
