"""Counter-based noise: distribution, independence, and draws that need no memory."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtri
from scipy.stats import kstest

from twin.component.component import normal, normal_of_bits

COUNT = 200_000


@pytest.mark.slow
def test_draws_are_standard_normal() -> None:
    draws = normal(seed=1, stream=2, channels=3, first=0, count=COUNT)
    for channel in draws.T:
        assert kstest(channel, "norm").pvalue > 1e-3
    assert np.all(np.abs(np.corrcoef(draws.T) - np.eye(3)) < 5 / np.sqrt(COUNT))
    lagged = np.corrcoef(draws[1:, 0], draws[:-1, 0])[0, 1]
    assert abs(lagged) < 5 / np.sqrt(COUNT)


def test_quantile_against_scipy() -> None:
    bits = np.random.default_rng(0).integers(0, 2**64, COUNT, dtype=np.uint64)
    bits[:2] = 0, 2**64 - 1
    p = ((bits >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    assert np.all(np.isfinite(normal_of_bits(bits)))
    np.testing.assert_allclose(normal_of_bits(bits), ndtri(p), rtol=1e-13, atol=1e-14)


@given(st.integers(0, 2**53), st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(0, 2**40))
def test_any_draw_can_be_had_alone(seed: int, stream: int, channels: int, first: int) -> None:
    several = normal(seed, stream, channels, first, 4)
    assert np.array_equal(several[2:3], normal(seed, stream, channels, first + 2, 1))
    assert np.array_equal(several[:, :1], normal(seed, stream, 1, first, 4))


def test_seeds_streams_and_channels_differ() -> None:
    one = normal(1, 1, 8, 0, 100)
    assert not np.any(one == normal(2, 1, 8, 0, 100))
    assert not np.any(one == normal(1, 2, 8, 0, 100))
    assert len(np.unique(one)) == one.size
