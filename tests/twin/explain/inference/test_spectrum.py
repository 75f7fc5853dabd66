"""Residuals by frequency: what the transform keeps, and where it puts what it keeps."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from twin.explain.inference.fit import gained_by_following
from twin.explain.inference.noise import BandNoise
from twin.explain.inference.spectrum import BANDS_HZ, SHORTEST, Spectrum, force_shares
from twin.explain.inference.whitening import autoregression_of
from twin.explain.model.factors import POSE_PASSES
from twin.residuals.channels import (
    CHANNEL_HZ,
    GRID_HZ,
    POSE_BAND_HZ,
    ChannelData,
    low_pass,
    shifted,
)
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]


def channel(
    residual: Array, slopes: Array | None = None, pieces: Sequence[int] = ()
) -> ChannelData:
    """A channel in pieces of these lengths; default: one."""
    n = len(residual)
    lengths = pieces or [n]
    piece = np.repeat(np.arange(len(lengths)), lengths)
    columns = np.zeros((n, 1)) if slopes is None else slopes
    return ChannelData(
        "acc_x", "m/s²", np.arange(n) / CHANNEL_HZ, residual, residual, columns, piece
    )


def of(*flights: ChannelData) -> Spectrum:
    width = flights[0].slopes.shape[1]
    none = np.zeros((len(flights), 0))
    return Spectrum.of([[f] for f in flights], np.zeros(width), none, np.zeros(0, dtype=np.intp))


def moving(spectrum: Spectrum) -> float:
    """Power beside the constants."""
    return sum(p for (_, band), (p, _) in spectrum.power().items() if band)


def constant(spectrum: Spectrum) -> float:
    return spectrum.power()[0, 0][0]


@pytest.mark.parametrize("pieces", [(), (200, 100), (60, 90, 150)])
def test_sums_of_squares_and_products_are_kept(pieces: Sequence[int]) -> None:
    rng = np.random.default_rng(0)
    r, s = rng.standard_normal((2, 300))
    ends = np.cumsum(pieces or (300,))[:-1]
    apart = [np.concatenate([p - p.mean() for p in np.split(v, ends)]) for v in (r, s)]
    spectrum = of(channel(r, s[:, None], pieces))
    assert moving(spectrum) == pytest.approx(apart[0] @ apart[0])
    (rows,) = spectrum.rows[0]
    inside = rows.band > 0
    product = rows.residual[inside] @ rows.slopes[inside, 0]
    assert product == pytest.approx(apart[0] @ apart[1])


@pytest.mark.parametrize("pieces", [(), (200, 100), (60, 90, 150), (100, 100, 100)])
def test_a_constant_of_a_flight_counts_once_whatever_its_pieces(pieces: Sequence[int]) -> None:
    spectrum = of(channel(np.full(300, 0.7), None, pieces))
    assert constant(spectrum) == pytest.approx(0.7**2)
    assert moving(spectrum) == pytest.approx(0.0, abs=1e-20)


def test_constants_of_flights_add_up() -> None:
    spectrum = of(*(channel(np.full(n, 0.7)) for n in (100, 400)))
    assert constant(spectrum) == pytest.approx(2 * 0.7**2)


@pytest.mark.parametrize("row", [1, 5, 12, 40, 250, 499])
def test_a_wave_is_in_the_band_of_its_frequency(row: int) -> None:
    n = 500
    wave = np.cos(np.pi * (np.arange(n) + 0.5) * row / n)
    hz = row * CHANNEL_HZ / 2 / n
    power = of(channel(wave)).power()
    (band,) = (b for (_, b), (p, _) in power.items() if p > 1e-9)
    assert BANDS_HZ[band - 1] <= hz < BANDS_HZ[band]
    assert power[0, band][0] == pytest.approx(n / 2)
    assert sum(count for _, count in power.values()) == n


def test_a_piece_that_is_too_short_does_not_count() -> None:
    short = SHORTEST - 1
    residual = np.concatenate([np.ones(100), np.full(short, 50.0)])
    assert constant(of(channel(residual, None, (100, short)))) == pytest.approx(1.0)
    assert of(channel(np.ones(short))).power() == {}


def test_slopes_of_columns_are_left_out_or_taken_anew() -> None:
    rng = np.random.default_rng(1)
    residual, slopes = rng.standard_normal(200), rng.standard_normal((200, 3))
    slopes[:, 1] = 0.0
    whole = of(channel(residual, slopes))
    assert list(whole.rows[0][0].active) == [0, 2]
    assert list(whole.only(np.array([1, 2])).rows[0][0].active) == [2]
    other = rng.standard_normal((200, 1))
    renewed = whole.renewed([[channel(residual, other)]], np.array([1]))
    expected = of(channel(residual, np.column_stack([slopes[:, 0], other, slopes[:, 2]])))
    np.testing.assert_allclose(renewed.rows[0][0].slopes, expected.rows[0][0].slopes)
    moved = whole.moved([[channel(2 * residual, slopes)]], np.ones(3), np.zeros((1, 0)))
    np.testing.assert_allclose(moved.rows[0][0].residual, 2 * whole.rows[0][0].residual)
    np.testing.assert_array_equal(moved.rows[0][0].slopes, whole.rows[0][0].slopes)


def test_what_a_pose_implies_has_no_comb_over_its_age() -> None:
    """Bursts in a motion capture's velocity, as what is implied for an accelerometer, at ages of
    which none is truer than another."""
    t_s, grid = np.arange(0.0, 6.0, 1 / 100.0), np.arange(0.0, 6.0, 1 / GRID_HZ)
    combs = []
    for seed in range(4):
        noise = np.random.default_rng(seed).standard_normal(len(t_s))
        burst = np.where(np.abs(t_s - 3.0) < 0.05, 0.07, 0.001) * noise
        implied = CubicSpline(t_s, burst)(grid, 1)[:, None]
        usual, of_pose = [], []
        for age_s in np.arange(0.0, 0.02, 0.0025):
            seen = [shifted(implied, age_s)]
            seen += [low_pass(seen[-1], POSE_BAND_HZ)]
            seen += [low_pass(seen[-1], POSE_BAND_HZ)]
            usual.append(_log_power("acc_x", seen[1]))
            of_pose.append(_log_power("pose_acc_x", seen[POSE_PASSES]))
        combs.append((np.ptp(of_pose), np.ptp(usual)))
    mean = np.mean(combs, axis=0)
    assert mean[0] < 15.0 < 100.0 < mean[1]


def _log_power(name: str, values: Array) -> float:
    """What the likelihood has of a channel on the grid: logarithms of the levels of its bands."""
    made = replace(channel(values[:: round(GRID_HZ / CHANNEL_HZ), 0]), name=name)
    power = of(made).power()
    return sum(n * float(np.log(p / n)) for (_, band), (p, n) in power.items() if band)


@pytest.mark.parametrize("pieces", [(), (200, 100)])
def test_what_turns_in_the_mean_takes_its_share_of_the_power(pieces: Sequence[int]) -> None:
    """A constant of 2 beside an oscillation of rms 1, and noise of rms 0.5."""
    t, noise = np.arange(300), 0.5 * np.random.default_rng(1).standard_normal(300)
    steady, moves = np.full(300, 2.0), np.sqrt(2) * np.sin(0.3 * t)
    left = channel(noise, np.column_stack([steady, moves]), pieces)
    shares = force_shares(of(left), ["rotor_cant", "rotor_drag"], np.array([1.0, 1.0]))
    assert [channel for _, channel in shares.values()] == ["acc_x", "acc_x"]
    assert shares["rotor_cant"][0] == pytest.approx(4 / 4.25, abs=0.02)
    assert shares["rotor_drag"][0] == pytest.approx(1 / 1.25, abs=0.04)


def test_what_a_log_does_not_sample_does_not_count() -> None:
    rows = np.arange(500)
    waves = np.cos(np.pi * np.outer([60, 99, 101, 240], rows + 0.5) / 500).sum(axis=0)
    counted = moving(of(replace(channel(waves), nyquist_hz=5.0)))
    assert counted == pytest.approx(2 * 500 / 2)  # 3 and 4.95 Hz, not 5.05 and 12 Hz


def test_following_noise_gains_as_much_in_a_slow_log() -> None:
    fast = channel(np.zeros(1000))
    noise = cast(BandNoise, SimpleNamespace(own=np.ones(1)))
    each = [
        gained_by_following("slung_load", [[c]], noise, load_vehicle("copter_default"))
        for c in (fast, replace(fast, nyquist_hz=12.5), replace(fast, nyquist_hz=5.0))
    ]
    assert each == pytest.approx([each[0], each[0] * 0.875 / 0.75, each[0] * 0.95 / 0.75])
    assert each[0] > 10


def test_a_piece_shorter_than_the_noise_model_has_no_innovation() -> None:
    noise, order = np.random.default_rng(2).standard_normal(240), 12
    for pieces in ((5, 235), (120, 5, 115), (235, 5)):
        whole = channel(noise, None, pieces)
        (weights,) = autoregression_of([whole], [100.0 * noise], order).weights
        short = np.flatnonzero(np.bincount(whole.piece) < order)
        assert (weights[whole.piece == short[0]] == 1.0).all()
        assert np.isfinite(weights).all()
