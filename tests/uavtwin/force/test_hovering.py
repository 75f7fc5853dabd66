"""Spectra of hovers, and how alike they are."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from learning.force.model import ForceModel
from twin.component import Run
from twin.physics.residual_force import FEATURES, INPUTS, NOISE_HZ, OUTPUTS, ForceLaw
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.exports.parts import READ_S, LearnedForce, twin
from uavtwin.force.hover_noise import (
    READINGS,
    HoverLevel,
    flight_levels,
    levels,
    noise_claim,
    wanted_levels,
    white_noise,
)
from uavtwin.vehicles import load_vehicle

COPTER = load_vehicle("copter_default")
SENSORS = replace(COPTER.sensors, accel_noise_m_s2=0.1, gyro_noise_rad_s=0.02)
NOISY = replace(COPTER, sensors=SENSORS)
UP: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.5, (0.0, 0.0, -2.0)),
    ("hover", 6.0, (0.0, 0.0, -2.0)),
)


@pytest.mark.slow
def test_only_a_flight_that_hovers_has_levels() -> None:
    assert flight_levels(fly(COPTER, COPTER, 1, "up", UP), COPTER) is not None
    legs: Waypoints = (*UP[:2], ("tour", 3.0, (3.0, 0.0, -2.0)))
    assert flight_levels(fly(COPTER, COPTER, 1, "tour", legs), COPTER) is None


def test_white_noise_has_one_level_up_to_half_of_its_rate() -> None:
    rate_hz, sigma = 50.0, 0.2
    x = np.random.default_rng(0).normal(size=(20000, 2)) * [sigma, 2 * sigma]
    found = levels(x, rate_hz)
    known = np.array(NOISE_HZ) * 2 ** (1 / 6) < rate_hz / 2
    assert np.isnan(found[:, ~known]).all()
    white = np.array([[sigma**2], [4 * sigma**2]]) / (rate_hz / 2)
    np.testing.assert_allclose(found[:, known] / white, 1, atol=0.35)
    np.testing.assert_allclose((found[:, known] / white).mean(axis=1), 1, atol=0.1)


def test_what_a_sensor_has_at_all_frequencies_is_its_noise() -> None:
    """And not what its axes move at some."""
    sigma = np.repeat([0.3, 0.01], 3)
    x = np.random.default_rng(1).normal(size=(20000, 6)) * sigma
    t_s = np.arange(len(x)) * READ_S
    x[:, 0] += np.cumsum(x[:, 1]) / 10
    x[:, 4] += sum(0.05 * np.sin(2 * np.pi * f * t_s) for f in (1.0, 2.0, 4.0))
    found = white_noise(wanted_levels([levels(x, 1 / READ_S)]))
    np.testing.assert_allclose(found, sigma[::3], rtol=0.12)
    assert not white_noise(np.zeros((6, len(NOISE_HZ)))).any()


def test_a_line_is_no_noise() -> None:
    """And what no log tells is not drawn."""
    flat = np.ones((len(READINGS), len(NOISE_HZ)))
    lined = flat.copy()
    lined[0, 9:11] = 1e4
    lined[:, 20:] = np.nan
    wanted = wanted_levels([lined])
    np.testing.assert_allclose(wanted[:, :20], 1)
    assert not wanted[:, 20:].any()
    np.testing.assert_allclose(wanted_levels([lined, flat])[:, 20:], 1)


def test_hovers_are_alike_within_a_factor_of_two_of_rms() -> None:
    rows = [HoverLevel("one", "acc_x", 1.0, 1.0, 1e-4, power) for power in (0.3, 3.9, 4.1, 1.0)]
    rows.append(HoverLevel("one", "acc_x", 40.0, None, 1.0, 1.0))
    assert "in 75 % of 4 third-octaves" in noise_claim(rows)
    assert "without it in 0 %" in noise_claim(rows)


def _imu(*white: float) -> Run:
    """IMU at rest of a twin with the noise of a law whose flights have this white noise."""
    d = len(INPUTS)
    law = ForceLaw(
        linear=np.zeros((len(OUTPUTS), len(FEATURES))),
        centre=np.zeros(d),
        scale=np.ones(d),
        whitening=np.eye(d),
        reach=1.0,
        most=np.ones(len(OUTPUTS)),
        units=np.eye(len(OUTPUTS)),
        noise=np.ones((len(OUTPUTS), len(NOISE_HZ))),
    )
    sha256 = hashlib.sha256(NOISY.toml().encode()).hexdigest()
    model = ForceModel(law=law, vehicle=NOISY.name, vehicle_sha256=sha256, seed=0, flights=())
    model = replace(model, imu_noise=white) if white else model
    imu = twin(NOISY, force=LearnedForce(model), noise=True).assembly.parts["imu"]
    return Run(imu, imu.input_values(), imu.parameter_values())


def test_white_noise_that_no_flight_told_is_that_of_the_vehicle_file() -> None:
    for white in ((), (0.0, 0.0)):
        starts = {v.name: v.start for v in _imu(*white).component.parameters}
        assert starts["acc_noise"] == 0.1
        assert starts["gyro_noise"] == 0.02


def test_white_noise_has_its_density_however_often_it_is_read() -> None:
    sigma, step_s = 0.4, 1e-3
    run = _imu(sigma, 0.01)
    u, read = run.component.input_values(), []
    for k in range(12000):
        run.step(step_s * k, step_s, u)
        read.append(run.outputs(u)[:3])
    below = np.array(NOISE_HZ) > 1
    for every in (1, round(READ_S / step_s)):
        found = levels(np.array(read)[::every], 1 / (step_s * every))[:, below]
        assert found.mean() / (2 * READ_S * sigma**2) == pytest.approx(1, abs=0.15)
