"""Least squares under noise that is not white, against known answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter

from learning.force.regression import (
    ORDER,
    Moments,
    least_squares,
    missed,
    moments_of,
    noise_of,
    pieces_of,
    summed,
)

N = 6000
PIECES = [slice(0, N)]
FREE = np.full(2, np.inf)


def _slow(rng: np.random.Generator, pole: float = 0.98) -> np.ndarray:
    return np.asarray(lfilter([1.0], [1.0, -pole], rng.normal(size=N)))


def _moments(*columns: np.ndarray) -> Moments:
    return moments_of(np.column_stack(columns), PIECES)


def test_noise_of_an_autoregression_is_that_autoregression() -> None:
    noise, new = noise_of(_moments(_slow(np.random.default_rng(1), 0.9)), np.zeros(0))
    assert noise[1] == pytest.approx(-0.9, abs=0.03)
    assert np.abs(noise[2:]).max() < 0.06
    assert new == pytest.approx(1.0, rel=0.05)


def test_moments_are_those_of_the_filtered_rows() -> None:
    rng = np.random.default_rng(2)
    columns = np.column_stack([_slow(rng), rng.normal(size=N)])
    found = moments_of(columns, [slice(0, 2500), slice(2600, N)])
    noise = np.append(1.0, 0.1 * rng.normal(size=ORDER))
    rows = np.concatenate(
        [lfilter(noise, 1.0, columns[a:b], axis=0)[ORDER:] for a, b in ((0, 2500), (2600, N))]
    )
    assert found.rows == len(rows)
    np.testing.assert_allclose(found.whitened(noise), rows.T @ rows, rtol=1e-9)
    left = rows[:, 1] - 0.3 * rows[:, 0]
    assert missed(found, np.array([0.3]), noise) == pytest.approx(np.mean(left**2), rel=1e-9)
    halves = [moments_of(columns, [p]) for p in (slice(0, 2500), slice(2600, N))]
    np.testing.assert_allclose(summed(halves).products, found.products, rtol=1e-12)


def test_a_feature_that_answers_slow_noise_is_not_taken_for_its_cause() -> None:
    """A controller answers a disturbance; plain least squares reads the answer as the cause."""
    rng = np.random.default_rng(3)
    disturbance, dither = _slow(rng), 0.3 * rng.normal(size=N)
    late = np.concatenate([[0.0], disturbance[:-1]])
    command = -0.8 * late + dither
    y = command + disturbance
    plain = float(command @ y / (command @ command))
    fit = least_squares(_moments(command, y), FREE[:1])
    assert abs(plain - 1) > 1, "the planted trap is one"
    assert fit.weights[0] == pytest.approx(1.0, abs=0.1)
    assert fit.noise[1] == pytest.approx(-0.98, abs=0.1)


def test_a_slow_cause_is_not_taken_for_slow_noise() -> None:
    """Drag of a slow flight: an autoregression foretells it nearly as well as the velocity."""
    rng = np.random.default_rng(6)
    velocity = np.asarray(lfilter(*butter(2, 0.01), 30 * rng.normal(size=N)))
    y = -0.6 * velocity + 0.02 * rng.normal(size=N)
    fit = least_squares(_moments(velocity, y), FREE[:1])
    assert fit.weights[0] == pytest.approx(-0.6, abs=0.01)


def test_a_limit_holds() -> None:
    rng = np.random.default_rng(4)
    features = rng.normal(size=(N, 2))
    sums = _moments(*features.T, features @ [2.0, -1.0] + rng.normal(size=N))
    free = least_squares(sums, FREE).weights
    below = least_squares(sums, np.array([0.5, np.inf])).weights
    assert free == pytest.approx([2.0, -1.0], abs=0.05)
    assert below[0] == pytest.approx(0.5, abs=1e-9)
    assert below[1] == pytest.approx(-1.0, abs=0.1)


def test_nothing_to_fit_leaves_what_is_there() -> None:
    fit = least_squares(_moments(_slow(np.random.default_rng(5))), FREE[:0])
    assert len(fit.weights) == 0 and fit.new == pytest.approx(1.0, rel=0.1)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 80), min_size=1, max_size=6))
def test_pieces_are_those_that_are_long_enough(lengths: list[int]) -> None:
    number = np.repeat(np.arange(len(lengths)), lengths)
    pieces = pieces_of(number)
    assert [p.stop - p.start for p in pieces] == [n for n in lengths if n > 2 * ORDER]
    assert all(len(set(number[p].tolist())) == 1 for p in pieces)
