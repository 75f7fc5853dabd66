"""Signals at the samples of another one, by cubic splines."""

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.frames import from_euler
from twin.residuals.measured import Signal, rates_of, resample_like, smooth_at, turning_at

T_S = np.arange(2000, dtype=np.float64) * np.float64(0.005)


@pytest.mark.parametrize("every", [2, 4, 10])
def test_what_differs_by_its_samples_alone_does_not_differ(every: int) -> None:
    """A rate and an angle that is its integral, however few samples there are of the angle."""
    rate: NDArray[np.float64] = np.cos(9.0 * T_S) + 0.5 * np.sin(40.0 * T_S)
    angle: NDArray[np.float64] = np.sin(9.0 * T_S) / 9.0 - 0.5 * np.cos(40.0 * T_S) / 40.0
    seen = Signal(T_S[::every], angle[::every, None])
    shown = smooth_at(seen, T_S, 1)
    known = np.isfinite(shown[:, 0])
    taken = resample_like(rate[:, None], T_S, seen, 1)
    assert np.array_equal(np.isfinite(taken[:, 0]), known)
    inside = known & (T_S > 0.5) & (T_S < 9.0)
    np.testing.assert_allclose(taken[inside], shown[inside], atol=2e-4)
    if every == 10:  # the two tell of different motions all the same
        assert np.abs(shown[inside, 0] - rate[inside]).max() > 0.05


def test_body_rates_are_those_between_attitudes_where_these_are_many() -> None:
    roll: NDArray[np.float64] = 0.3 * np.sin(3 * T_S)
    q = from_euler(roll, 0.2 * np.cos(2 * T_S), 0.1 * T_S).T
    between = rates_of(Signal(T_S, q))
    np.testing.assert_allclose(
        turning_at(Signal(T_S, q), between.t_s)[5:-5], between.values[5:-5], atol=1e-4
    )


def test_a_sample_at_the_edge_counts_whatever_its_last_bit() -> None:
    """Of a grid and of a log the same instants differ by rounding."""
    values: NDArray[np.float64] = np.sin(T_S)[:, None]
    values[:400] = np.nan
    for apart in (-1e-12, 1e-12):
        stamps = T_S[::4] + apart
        found = resample_like(values, T_S, Signal(stamps, stamps[:, None]), 1)
        assert np.isfinite(found[400:1990]).all()
        assert np.isnan(found[:400]).all()
