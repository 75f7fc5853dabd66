"""Metrics against what mathematics says of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from learning import evaluation as metrics

SAMPLES = st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=50).map(np.array)


@pytest.mark.slow
@given(SAMPLES, st.floats(-100, 100))
def test_wasserstein_of_shifted_samples_is_the_shift(values: np.ndarray, shift: float) -> None:
    assert metrics.wasserstein(values, values + shift) == pytest.approx(abs(shift), abs=1e-9)


def test_wasserstein_ignores_order_and_knows_scale() -> None:
    rng = np.random.default_rng(0)
    a = rng.standard_normal(20000)
    assert metrics.wasserstein(a, rng.permutation(a)) == pytest.approx(0, abs=1e-12)
    # Two centred Gaussians: (s2 - s1) E|z|.
    expected = np.sqrt(2 / np.pi)
    assert metrics.wasserstein(a, 2 * rng.standard_normal(20000)) == pytest.approx(
        expected, rel=0.03
    )


@pytest.mark.slow
@given(SAMPLES)
def test_a_constant_is_no_achievement(values: np.ndarray) -> None:
    """The best constant leaves the spread, and squares add up."""
    assert metrics.rmse(values - values.mean()) == pytest.approx(
        metrics.spread_of(values), abs=1e-9
    )
    square = metrics.spread_of(values) ** 2 + values.mean() ** 2
    assert metrics.mse(values) == pytest.approx(square, rel=1e-9, abs=1e-12)
    assert metrics.mae(values) <= metrics.rmse(values) * (1 + 1e-12)


def test_of_nothing_nothing_is_known() -> None:
    nothing = np.zeros(0)
    for value in (
        metrics.mse(nothing),
        metrics.rmse(nothing),
        metrics.mae(nothing),
        metrics.spread_of(nothing),
        metrics.wasserstein(nothing, nothing),
        metrics.coverage(nothing, nothing, 1),
        metrics.share_removed(1.0, 0.0),
    ):
        assert np.isnan(value)
    assert metrics.share_removed(0.25, 1.0) == 0.75


def test_coverage_of_a_gaussian() -> None:
    left = 3 * np.random.default_rng(1).standard_normal(100_000)
    spread = np.full(100_000, 3.0)
    assert metrics.coverage(left, spread, 1) == pytest.approx(0.6827, abs=0.01)
    assert metrics.coverage(left, spread, 2) == pytest.approx(0.9545, abs=0.005)
