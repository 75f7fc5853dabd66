"""Baselines: known answers, the last sample truly measured, and no look into the future."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from learning.data.channels import CHANNELS, PHASE_CODES
from learning.data.flights import ResidualFlight, held
from learning.model.baselines import ORDER, fit_baselines, lags, phase_means

Array = np.ndarray
HOVER, TOUR = PHASE_CODES["hover"], PHASE_CODES["tour"]
AR = (1.5, -0.7)


def flight_of(
    residual: Array, name: str = "flight", fresh: Array | None = None, **changes: object
) -> ResidualFlight:
    """A flight in hover, one span; what is not fresh is held."""
    n = len(residual)
    new = np.ones(residual.shape, dtype=np.bool_) if fresh is None else fresh
    made = ResidualFlight(
        name=name,
        rate_hz=100.0,
        t_s=np.arange(n) / 100,
        virtual=np.zeros((n, 15)),
        residual=held(np.where(new, residual, np.nan)),
        fresh=new,
        commands=np.zeros((n, 4)),
        phase=np.full(n, HOVER, dtype=np.intp),
        spans=((0, n),),
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def noise(seed: int, n: int) -> Array:
    return np.asarray(np.random.default_rng(seed).standard_normal((n, 15)))


def process(seed: int, n: int = 4000) -> Array:
    """AR(2) of known coefficients in every channel, about a mean of 3."""
    return np.asarray(3 + lfilter([1.0], [1.0, -AR[0], -AR[1]], noise(seed, n), axis=0))


def left(
    flight: ResidualFlight, name: str, train: list[ResidualFlight], protocol: str, horizon: int = 0
) -> Array:
    correction = fit_baselines(train, protocol, horizon)[name].run(flight).correction
    return np.where(flight.fresh, flight.residual - correction, np.nan)


# -- known answers --------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("horizon", [1, 2, 5])
def test_autoregression_of_a_known_process(horizon: int) -> None:
    """Its error is that of the best predictor: sum of the squared first terms of the response."""
    train, test = flight_of(process(0, 20000), "a"), flight_of(process(1, 20000), "b")
    response = lfilter([1.0], [1.0, -AR[0], -AR[1]], np.eye(1, horizon)[0])
    error = left(test, f"linear AR({ORDER})", [train], "track", horizon)
    best = np.sqrt(np.sum(response**2))
    assert np.sqrt(np.mean(error[50:] ** 2)) == pytest.approx(best, rel=0.02)


@pytest.mark.slow
def test_spread_of_a_baseline_is_what_it_left_in_training() -> None:
    train, test = flight_of(process(0, 20000), "a"), flight_of(process(1, 20000), "b")
    spread = fit_baselines([train], "track", 1)[f"linear AR({ORDER})"].run(test).spread
    np.testing.assert_allclose(spread, 1.0, rtol=0.03)


def test_regression_on_inputs_finds_a_linear_law_and_its_lag() -> None:
    def flown(seed: int) -> ResidualFlight:
        rng = np.random.default_rng(seed)
        n = 3000
        speed = lfilter([0.05], [1.0, -0.95], rng.standard_normal((n, 15)), axis=0)
        command = lfilter([0.02], [1.0, -0.98], rng.standard_normal((n, 4)), axis=0)
        share = 1 - np.exp(-1 / (100 * 0.5))
        slow = lfilter([share], [1.0, share - 1.0], command[:, 0])
        residual = 0.01 * rng.standard_normal((n, 15))
        residual[:, 3] += 2.0 * speed[:, 12] - 5.0 * slow + 1.0
        return flight_of(residual, str(seed), virtual=speed, commands=command)

    error = left(flown(3), "linear in inputs", [flown(1), flown(2)], "free")
    assert np.std(error[500:, 3]) < 0.02


def test_regression_on_inputs_says_nothing_where_there_is_nothing_to_say() -> None:
    """Chosen on flights left out: on pure noise it is the mean."""
    flights = [
        flight_of(
            noise(k, 400), str(k), virtual=noise(10 + k, 400), commands=noise(20 + k, 400)[:, :4]
        )
        for k in range(3)
    ]
    fitted = fit_baselines(flights[:2], "free")
    said = fitted["linear in inputs"].run(flights[2]).correction
    mean = fitted["mean"].run(flights[2]).correction
    assert np.sqrt(np.mean((said - mean) ** 2)) < 0.1


def test_one_training_flight_is_enough() -> None:
    flight = flight_of(process(0, 500), virtual=noise(1, 500))
    for protocol, horizon in (("reconstruct", 0), ("track", 7), ("free", 0)):
        for name, baseline in fit_baselines([flight], protocol, horizon).items():
            assert np.isfinite(baseline.run(flight).correction).all(), (protocol, name)


def test_mean_of_a_phase_and_of_an_unknown_one() -> None:
    residual = np.concatenate([np.full((100, 15), 2.0), np.full((300, 15), 6.0)])
    phase = np.repeat([HOVER, PHASE_CODES["takeoff"]], [100, 300])
    train = flight_of(residual, phase=phase)
    test = flight_of(np.zeros((3, 15)), phase=np.array([HOVER, PHASE_CODES["takeoff"], TOUR]))
    said = fit_baselines([train], "free")["mean"].run(test).correction
    np.testing.assert_allclose(said[:, 0], [2.0, 6.0, 5.0])


def test_readings_do_without_the_twin() -> None:
    """A twin that reads nonsense: the sensor's own mean, and its own last reading."""
    nonsense = 10 * noise(0, 2000)
    measured = 4 + 0.1 * np.cumsum(noise(1, 2000), axis=0) / 30
    flight = flight_of(measured - nonsense, virtual=nonsense)
    still = left(flight, "mean reading", [flight], "free")
    assert np.allclose(still, measured - measured.mean(axis=0))
    step = left(flight, "last reading", [flight], "track", 3)
    np.testing.assert_allclose(step[3:], measured[3:] - measured[:-3], atol=1e-9)


# -- what is known when ---------------------------------------------------------------------


def test_last_is_the_last_sample_truly_measured() -> None:
    """A sensor that has a sample every 5: at t - h that of the instant before, not the next one."""
    n, every, horizon = 60, 5, 3
    fresh = np.zeros((n, 15), dtype=np.bool_)
    fresh[::every] = True
    residual = np.tile(np.arange(n, dtype=np.float64)[:, None], 15)
    flight = flight_of(residual, fresh=fresh)
    said = fit_baselines([flight], "track", horizon)["last"].run(flight).correction
    for t in range(horizon, n):
        assert said[t, 0] == (t - horizon) // every * every
    mean = phase_means([flight])[HOVER, 0]
    np.testing.assert_allclose(said[:horizon], mean)


@pytest.mark.slow
@given(st.integers(0, 12), st.integers(1, 10), st.integers(0, 2**31))
def test_lags_are_the_values_of_their_age(horizon: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((40, 15))
    fresh = rng.random((40, 15)) < 0.4
    flight = flight_of(values, fresh=fresh, spans=((0, 17), (21, 40)))
    found = lags(flight, values, horizon, count)
    for a, b in flight.spans:
        for t in range(a, b):
            for k in range(count):
                known = np.flatnonzero(fresh[a : max(t - horizon - k + 1, a), 7]) + a
                expected = values[known[-1], 7] if len(known) else 0.0
                assert found[t, 7, k] == expected
    assert not found[17:21].any()


@pytest.mark.parametrize(("protocol", "horizon"), [("reconstruct", 0), ("track", 1), ("track", 10)])
def test_what_comes_after_t_minus_h_changes_nothing_at_t(protocol: str, horizon: int) -> None:
    fresh = np.random.default_rng(5).random((300, 15)) < 0.5
    train, test = flight_of(process(0, 300), "a"), flight_of(process(1, 300), "b", fresh=fresh)
    changed_at = 150
    later = np.where(np.arange(300)[:, None] >= changed_at, 99.0, test.residual)
    other = flight_of(later, "b", fresh=fresh)
    for name, baseline in fit_baselines([train], protocol, horizon).items():
        one, two = baseline.run(test).correction, baseline.run(other).correction
        np.testing.assert_array_equal(one[: changed_at + horizon], two[: changed_at + horizon])
        if name not in ("none", "mean", "mean reading", "linear in inputs"):
            assert not np.array_equal(one, two), name


def test_free_sees_no_residual() -> None:
    train = [flight_of(process(0, 300), "a", virtual=noise(2, 300), commands=noise(4, 300)[:, :4])]
    test = flight_of(process(1, 300), "b", virtual=noise(3, 300))
    other = replace(test, residual=test.residual + 50.0)
    for baseline in fit_baselines(train, "free").values():
        said = [baseline.run(f).correction for f in (test, other)]
        np.testing.assert_array_equal(said[0], said[1])


def test_channel_without_a_sample_is_left_alone() -> None:
    residual, fresh = process(0, 300), np.ones((300, 15), dtype=np.bool_)
    virtual = np.ones((300, 15))
    mag = CHANNELS.index("mag_x")
    residual[:, mag], fresh[:, mag], virtual[:, mag] = np.nan, False, np.nan
    flight = flight_of(residual, fresh=fresh, virtual=virtual)
    for protocol, horizon in (("reconstruct", 0), ("track", 2), ("free", 0)):
        for name, baseline in fit_baselines([flight], protocol, horizon).items():
            corrected = baseline.run(flight)
            assert np.isfinite(corrected.correction).all(), name
            assert np.isfinite(corrected.spread).all(), name
            assert not corrected.correction[:, mag].any(), name
