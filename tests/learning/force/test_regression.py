"""Ridge regression under noise that is not white, against known answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from learning.force.regression import ORDER, noise_of, pieces_of, ridge

N = 6000
PIECES = [slice(0, N)]


def _slow(rng: np.random.Generator, pole: float = 0.98) -> np.ndarray:
    return np.asarray(lfilter([1.0], [1.0, -pole], rng.normal(size=N)))


def test_noise_of_an_autoregression_is_that_autoregression() -> None:
    noise = noise_of(_slow(np.random.default_rng(1), 0.9), PIECES)
    assert noise.filter[1] == pytest.approx(-0.9, abs=0.03)
    assert np.abs(noise.filter[2:]).max() < 0.06
    assert noise.size == pytest.approx(1.0, rel=0.03)


def test_whitened_noise_is_white_and_of_unit_size() -> None:
    series = _slow(np.random.default_rng(2))
    new = noise_of(series, PIECES).whitened(series, PIECES)
    assert len(new) == N - ORDER
    assert np.std(new) == pytest.approx(1.0, rel=0.02)
    assert abs(np.corrcoef(new[1:], new[:-1])[0, 1]) < 0.03


def test_a_feature_that_answers_slow_noise_is_not_taken_for_its_cause() -> None:
    """A controller answers a disturbance; plain least squares reads the answer as the cause."""
    rng = np.random.default_rng(3)
    disturbance, dither = _slow(rng), 0.3 * rng.normal(size=N)
    late = np.concatenate([[0.0], disturbance[:-1]])
    command = -0.8 * late + dither
    y = command + disturbance
    features = command[:, None]
    plain = float(np.linalg.lstsq(features, y, rcond=None)[0][0])
    fit = ridge(features, y, PIECES, np.zeros(1), np.full(1, np.inf))
    assert abs(plain - 1) > 1, "the planted trap is one"
    assert abs(fit.weights[0] - 1) < 0.35 * abs(plain - 1)


def test_a_penalty_shrinks_and_a_limit_holds() -> None:
    rng = np.random.default_rng(4)
    features = rng.normal(size=(N, 2))
    y = features @ [2.0, -1.0] + rng.normal(size=N)
    free = ridge(features, y, PIECES, np.zeros(2), np.full(2, np.inf)).weights
    held = ridge(features, y, PIECES, np.full(2, 1e9), np.full(2, np.inf)).weights
    below = ridge(features, y, PIECES, np.zeros(2), np.array([0.5, np.inf])).weights
    assert free == pytest.approx([2.0, -1.0], abs=0.05)
    assert np.abs(held).max() < 1e-3
    assert below[0] == pytest.approx(0.5, abs=1e-9) and below[1] == pytest.approx(-1.0, abs=0.05)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 80), min_size=1, max_size=6))
def test_pieces_are_those_that_are_long_enough(lengths: list[int]) -> None:
    number = np.repeat(np.arange(len(lengths)), lengths)
    pieces = pieces_of(number)
    assert [p.stop - p.start for p in pieces] == [n for n in lengths if n > 2 * ORDER]
    assert all(len(set(number[p].tolist())) == 1 for p in pieces)
