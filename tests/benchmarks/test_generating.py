"""Generators: coefficients found again, alike in distribution, spectrum and correlation."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from benchmarks.paper.innovations import (
    INNOVATIONS,
    Generator,
    burg,
    fit_generator,
    fit_recording,
    innovations,
    synthesis,
)
from benchmarks.paper.trainings import log_spectral_distance
from learning.data.channels import CHANNELS, GROUPS, PHASE_CODES
from learning.data.flights import ResidualFlight, held
from learning.model.family import Model

Array = np.ndarray
HOVER, TAKEOFF = PHASE_CODES["hover"], PHASE_CODES["takeoff"]
AR = np.array([1.5, -0.7])
N = 3000
MAG = GROUPS["mag"]


def flight_of(seed: int, n: int = N) -> ResidualFlight:
    """AR(2) driven by rare kicks, the same ones in gyro x and y; takeoff moves twice as much.

    Position and velocity have a sample every 5, the magnetometer has none.
    """
    rng = np.random.default_rng(seed)
    drive = rng.standard_normal((n, 15)) * rng.choice([0.3, 3.0], (n, 1), p=[0.9, 0.1])
    drive[:, 1] = 0.9 * drive[:, 0] + 0.1 * drive[:, 1]
    phase = np.repeat([TAKEOFF, HOVER], [n // 4, n - n // 4]).astype(np.intp)
    size = np.where(phase == TAKEOFF, 2.0, 1.0)[:, None]
    fresh = np.ones((n, 15), dtype=np.bool_)
    fresh[:, 9:] = (np.arange(n) % 5 == 0)[:, None]
    fresh[:, MAG] = False
    residual = 4 + size * lfilter([1.0], [1.0, *-AR], drive, axis=0)
    slow = np.repeat(lfilter([1.0], [1.0, *-AR], drive[::5, 9:], axis=0), 5, axis=0)[:n]
    residual[:, 9:] = 4 + size * slow
    return ResidualFlight(
        name=f"flight {seed}",
        rate_hz=100.0,
        t_s=np.arange(n) / 100,
        virtual=np.zeros((n, 15)),
        residual=held(np.where(fresh, residual, np.nan)),
        fresh=fresh,
        commands=np.zeros((n, 4)),
        phase=phase,
        spans=((0, n),),
    )


TRAIN, TEST = [flight_of(0), flight_of(1)], [flight_of(2)]


@pytest.fixture(scope="module")
def generators() -> dict[str, Generator]:
    return {p.name: p.fit(TRAIN) for p in INNOVATIONS.values()}


@pytest.fixture(scope="module")
def generator(generators: dict[str, Generator]) -> Generator:
    return generators["ar-codebook"]


# -- autoregression -------------------------------------------------------------------------


def test_coefficients_of_a_known_process_from_several_pieces() -> None:
    rng = np.random.default_rng(0)
    pieces = [lfilter([1.0], [1.0, *-AR], rng.standard_normal(3000)) for _ in range(4)]
    found = burg(pieces, 4)
    np.testing.assert_allclose(found, [*AR, 0, 0], atol=0.03)
    assert innovations(pieces[0], found).std() == pytest.approx(1.0, rel=0.05)


@given(
    st.lists(
        st.lists(st.floats(-1e3, 1e3, width=32), min_size=0, max_size=40).map(np.array),
        min_size=1,
        max_size=3,
    ),
    st.integers(0, 8),
)
def test_synthesis_never_blows_up(pieces: list[Array], order: int) -> None:
    found = burg(pieces, order)
    assert len(found) == order
    poles = np.roots(np.append(1.0, -found))
    assert np.all(np.abs(poles) < 1 + 1e-5)


def test_synthesis_undoes_the_innovations() -> None:
    signal = np.random.default_rng(1).standard_normal(50)
    found = np.array([0.5, 0.2])
    np.testing.assert_allclose(synthesis(lfilter([1.0, *-found], [1.0], signal), found), signal)


# -- generator ------------------------------------------------------------------------------


def correlation(pair: Array) -> float:
    """Of two columns, shape (n, 2)."""
    return float(np.atleast_2d(np.corrcoef(pair.T))[0, 1])


@pytest.mark.slow
def test_draws_have_mean_spread_and_correlation_of_each_phase(generator: Generator) -> None:
    drawn = generator.run(TEST[0]).correction
    for phase, size in ((TAKEOFF, 2.0), (HOVER, 1.0)):
        here = TEST[0].phase == phase
        measured = np.concatenate([f.residual[f.phase == phase] for f in TRAIN])
        for c in (0, 1, 4):
            assert abs(drawn[here, c].mean() - 4) < 0.6 * size
            assert drawn[here, c].std() == pytest.approx(measured[:, c].std(), rel=0.2)
        assert correlation(drawn[here, :2]) > 0.95
        assert abs(correlation(drawn[here][:, [0, 2]])) < 0.4


def test_codebook_keeps_what_is_rare_and_large(generators: dict[str, Generator]) -> None:
    """The kicks have a kurtosis that no Gaussian has; the codes come near it."""

    def kurtosis(values: Array) -> float:
        steps = values - values.mean()
        return float(np.mean(steps**4) / np.mean(steps**2) ** 2)

    def kicks(name: str) -> float:
        drawn = generators[name].run(TEST[0]).correction[TEST[0].phase == HOVER, 4]
        return kurtosis(lfilter([1.0, *-AR], [1.0], drawn - 4)[10:])

    assert kicks("ar-codebook") > 6
    assert kicks("ar-gaussian") < 4


def test_slow_sensors_are_drawn_at_their_own_rate(generator: Generator) -> None:
    drawn = generator.run(TEST[0]).correction
    x = CHANNELS.index("pos_x")
    hover = np.flatnonzero(TEST[0].phase == HOVER)
    changes = np.flatnonzero(np.diff(drawn[hover, x]) != 0) + 1 + hover[0]
    assert np.all(changes % 5 == 0) and len(changes) > 100
    assert not drawn[:, MAG].any()


@pytest.mark.slow
def test_seeds_decide_and_measurements_do_not(generator: Generator) -> None:
    flight = TEST[0]
    first = generator.run(flight).correction
    blind = replace(flight, residual=flight.residual + 9, fresh=np.zeros_like(flight.fresh))
    np.testing.assert_array_equal(first, generator.run(blind).correction)
    np.testing.assert_array_equal(first, fit_generator(TRAIN).run(flight).correction)
    assert not np.array_equal(first, generator.with_seed(1).run(flight).correction)
    assert not np.array_equal(first, generator.run(replace(flight, name="other")).correction)


def test_a_phase_never_seen_and_hardly_any_samples(generator: Generator) -> None:
    unknown = replace(TEST[0], phase=np.full(N, PHASE_CODES["tour"], dtype=np.intp))
    assert np.isfinite(generator.run(unknown).correction).all()
    few = replace(TRAIN[0], fresh=TRAIN[0].fresh & (np.arange(N) < 15)[:, None])
    for preset in INNOVATIONS.values():
        assert np.isfinite(preset.fit([few]).run(TEST[0]).correction).all()


# -- score ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_distances_rank_what_is_alike_above_what_is_not(generators: dict[str, Generator]) -> None:
    """Of gyroscopes in hover: a spectrum tells white noise, a recording is as near as can be."""
    away, hover = TEST[0], TEST[0].phase == HOVER
    gyro = range(15)[GROUPS["gyro"]]

    def apart(model: Model) -> float:
        drawn = model.run(away).correction
        return float(
            np.mean(
                [
                    log_spectral_distance(away.t_s[hover], away.residual[hover, c], drawn[hover, c])
                    for c in gyro
                ]
            )
        )

    found = {n: apart(g) for n, g in generators.items()}
    assert found["white-noise"] > 3 * found["ar-codebook"]
    assert found["ar-codebook"] < 1.3 * apart(fit_recording(TRAIN))


def test_recordings_are_pieces_of_the_same_phase() -> None:
    said = fit_recording(TRAIN).run(TEST[0]).correction
    for phase in (TAKEOFF, HOVER):
        known = {tuple(r) for f in TRAIN for r in np.nan_to_num(f.residual[f.phase == phase])}
        assert {tuple(r) for r in said[TEST[0].phase == phase]} <= known


def test_log_spectral_distance_of_a_louder_signal() -> None:
    t = np.arange(8000) / 100
    values = np.random.default_rng(3).standard_normal(8000)
    assert log_spectral_distance(t, values, values) == 0
    louder = log_spectral_distance(t, values, 2 * values)
    assert louder == pytest.approx(20 * np.log10(2), rel=1e-9)
    assert np.isnan(log_spectral_distance(t, values, np.zeros(8000)))
