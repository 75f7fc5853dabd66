"""Wind, gust and density: variance and spectrum against the standard's formulas."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import welch

from twin.component import Run
from twin.component.along import accumulated, mapped
from twin.component.component import normal
from twin.effects.air import low_altitude_turbulence
from twin.errors import ModelError
from twin.physics.environment import environment
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]
AIR = environment(load_vehicle("copter_default"))
SPEED = 10.0


def gusts(
    period_s: float, count: int, seed: int = 1, parameters: Mapping[str, float] | None = None
) -> Array:
    """Gust along, across and down in wind from the south, shape (count, 3), start left out."""
    p = AIR.parameter_values(
        {
            "gust.enabled": 1.0,
            "wind.x": SPEED,
            "sample_period": period_s,
            **(parameters or {}),
        }
    )
    sampling = AIR.sampling
    assert sampling is not None
    u = AIR.input_values()
    w = normal(seed, sampling.stream, sampling.channels, 0, count)
    x0 = np.asarray(AIR.initial(u, p)).ravel()
    held = [np.broadcast_to(v, (count, len(v))) for v in (u, p)]
    (states,) = accumulated(sampling.update, x0, *held, w, np.empty((count, 0)))
    y = mapped(AIR.outputs, states, *held)
    return np.asarray(y[count // 20 :, :3] - [SPEED, 0.0, 0.0])


SCALES = {"gust.length_u": 2.0, "gust.length_v": 2.0, "gust.length_w": 1.0}
SIGMAS = {"gust.intensity_u": 1.5, "gust.intensity_v": 1.2, "gust.intensity_w": 0.7}


@pytest.mark.slow
@pytest.mark.parametrize("period_s", [1e-3, 1e-2, 0.1, 1.0])
def test_variance_is_right_at_any_sample_period(period_s: float) -> None:
    correlation_s = 0.2
    count = int(max(20_000, 500 * correlation_s / period_s))
    found = gusts(period_s, count, parameters={**SCALES, **SIGMAS}).std(axis=0)
    # About one independent draw per two correlation times; four standard deviations of the mean.
    tolerance = 4 * np.sqrt(1 / (2 * count * min(1.0, period_s / (2 * correlation_s))))
    np.testing.assert_allclose(found, list(SIGMAS.values()), rtol=tolerance)


@pytest.fixture(scope="module")
def long_record() -> Array:
    """2000 s at 100 Hz, correlation times of 0.2, 0.2 and 0.1 s."""
    return gusts(0.01, 200_000, parameters={**SCALES, **SIGMAS})


@pytest.mark.slow
def test_spectra_are_dryden(long_record: Array) -> None:
    """Density over frequency in time: along 2 L/V / (1 + W^2), across (1 + 3 W^2) / ()^2."""
    f, density = welch(long_record.T, 100.0, nperseg=8192)
    for i, (length, sigma) in enumerate(zip(SCALES.values(), SIGMAS.values(), strict=True)):
        tau = length / SPEED
        w2 = (2 * np.pi * f * tau) ** 2
        shape = 2 / (1 + w2) if i == 0 else (1 + 3 * w2) / (1 + w2) ** 2
        theory = 2 * sigma**2 * tau * shape  # one-sided, per Hz
        bands = np.geomspace(0.05, 10.0, 9)  # well below half the sample rate
        for low, high in pairwise(bands):
            inside = (f >= low) & (f < high)
            ratio = density[i, inside].mean() / theory[inside].mean()
            # Four standard deviations of a mean over that many bins and half-overlapped segments.
            draws = inside.sum() * len(long_record) / 8192
            assert abs(ratio - 1) < 4 / np.sqrt(draws) + 0.02, (i, low, high, ratio)


@pytest.mark.slow
def test_correlation_time_is_length_over_speed(long_record: Array) -> None:
    along, lag = long_record[:, 0], 20
    correlation = np.mean(along[:-lag] * along[lag:]) / np.mean(along**2)
    assert correlation == pytest.approx(np.exp(-1), abs=0.04)


def test_gust_follows_the_wind_direction() -> None:
    """Wind to the east: `along` is east, `across` is south."""
    only = {"wind.x": 0.0, "wind.y": SPEED, "gust.intensity_v": 0.0, "gust.intensity_w": 0.0}
    rows = gusts(0.1, 1000, parameters=only) + np.array([SPEED, -SPEED, 0.0])
    assert rows[:, 1].std() > 0.5
    np.testing.assert_allclose(rows[:, [0, 2]], 0.0, atol=1e-12)


def test_low_altitude_formulas() -> None:
    """MIL-F-8785C at 20 ft in 15 kn, by hand: 0.177 + 0.01646 = 0.19346."""
    air = low_altitude_turbulence(6.096, 7.7)
    assert air.length_m[2] == pytest.approx(6.096)
    assert air.length_m[0] == pytest.approx(6.096 / 0.19346**1.2, rel=1e-4)
    assert air.intensity_m_s[2] == pytest.approx(0.77)
    assert air.intensity_m_s[1] == pytest.approx(0.77 / 0.19346**0.4, rel=1e-4)
    top = low_altitude_turbulence(304.8, 7.7)  # at 1000 ft isotropic
    np.testing.assert_allclose(top.length_m, 304.8)
    np.testing.assert_allclose(top.intensity_m_s, 0.77)
    with pytest.raises(ModelError, match="ends at"):
        low_altitude_turbulence(400.0, 7.7)


def test_no_gust_by_default_and_a_seed_repeats() -> None:
    u, p = AIR.input_values({"pos_z": -3.0}), AIR.parameter_values({"wind.y": 4.0})
    run = Run(AIR, u, p)
    run.step(0.0, 1.0, u)
    np.testing.assert_array_equal(run.outputs(u)[:3], [0.0, 4.0, 0.0])
    one, same, other = (gusts(0.1, 100, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize(
    ("height_m", "density"),
    [(0.0, 1.2250), (1000.0, 1.1117), (5000.0, 0.73612), (10000.0, 0.41271)],
)
def test_density_of_the_standard_atmosphere(height_m: float, density: float) -> None:
    """Tables of the U.S. Standard Atmosphere 1976 at geopotential heights (0, 1, 5, 10 km)."""
    u = AIR.input_values({"pos_z": -height_m})
    y = np.asarray(AIR.outputs(np.zeros(len(AIR.states)), u, AIR.parameter_values())).ravel()
    assert y[3] == pytest.approx(density, rel=2e-4)


def test_hot_and_low_pressure_air_is_thin() -> None:
    """Ideal gas at the ground."""
    p = AIR.parameter_values({"ground.temperature": 308.15, "ground.pressure": 9e4})
    y = np.asarray(AIR.outputs(np.zeros(len(AIR.states)), AIR.input_values(), p)).ravel()
    assert y[3] == pytest.approx(9e4 / (287.05287 * 308.15), rel=1e-12)
