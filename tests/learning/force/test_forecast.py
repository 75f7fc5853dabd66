"""The observer of a disturbance, against disturbances whose best observer is known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from learning.force.forecast import (
    AHEAD_S,
    FADES_S,
    LAGS_S,
    NO_OBSERVER,
    Observer,
    missed,
    observer_of,
)
from twin.residuals.channels import CHANNEL_HZ

N = round(60 * CHANNEL_HZ)
PIECES = [slice(0, N)]


def _of_time_constant(seconds: float, seed: int) -> np.ndarray:
    pole = np.exp(-1 / (CHANNEL_HZ * seconds))
    shocks = np.sqrt(1 - pole**2) * np.random.default_rng(seed).normal(size=N)
    return np.asarray(lfilter([1.0], [1.0, -pole], shocks))


def test_nothing_is_missed_of_a_constant_that_never_fades() -> None:
    constant = np.full(N, 2.0)
    alone = missed(constant, PIECES, NO_OBSERVER)
    learned = missed(constant, [slice(0, N)], Observer(0.05, 1e9))
    assert alone == pytest.approx(4 * np.square(AHEAD_S), rel=1e-3)
    assert (learned < 0.01 * alone).all()


def test_white_noise_wants_no_observer() -> None:
    flights = [(np.random.default_rng(k).normal(size=N), PIECES) for k in range(3)]
    found = observer_of(flights)
    assert found == NO_OBSERVER or found.fade_s == min(FADES_S)


def test_a_slow_disturbance_is_held_longer_than_a_fast_one() -> None:
    slow = observer_of([(_of_time_constant(5.0, k), PIECES) for k in range(3)])
    fast = observer_of([(_of_time_constant(0.2, k), PIECES) for k in range(3)])
    assert slow.fade_s > fast.fade_s
    assert slow.lag_s < max(LAGS_S)


def test_the_worst_flight_decides() -> None:
    """A flight in which nothing lasts forbids an observer that holds what lasts in another."""
    steady, restless = np.full(N, 3.0), np.random.default_rng(0).normal(size=N)
    both = observer_of([(steady, PIECES), (restless, PIECES)])
    share = missed(restless, PIECES, both) / missed(restless, PIECES, NO_OBSERVER)
    assert float(np.mean(share)) <= 1.0
    assert observer_of([(steady, PIECES)]).fade_s == max(FADES_S)
