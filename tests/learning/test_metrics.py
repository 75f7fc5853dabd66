"""Metrics against what mathematics says of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from learning.evaluation import errors


def wasserstein(a: np.ndarray, b: np.ndarray) -> float:
    return errors(a, b)["wasserstein"]


SAMPLES = st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=50).map(np.array)


@pytest.mark.slow
@given(SAMPLES, st.floats(-100, 100))
def test_wasserstein_of_shifted_samples_is_the_shift(values: np.ndarray, shift: float) -> None:
    assert wasserstein(values, values + shift) == pytest.approx(abs(shift), abs=1e-9)


def test_wasserstein_ignores_order_and_knows_scale() -> None:
    rng = np.random.default_rng(0)
    a = rng.standard_normal(20000)
    assert wasserstein(a, rng.permutation(a)) == pytest.approx(0, abs=1e-12)
    # Two centred Gaussians: (s2 - s1) E|z|.
    expected = np.sqrt(2 / np.pi)
    assert wasserstein(a, 2 * rng.standard_normal(20000)) == pytest.approx(expected, rel=0.03)
