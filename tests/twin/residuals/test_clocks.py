"""Age of an attitude over the gyroscope: with its sign, and where it changes in the flight."""

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin.logs import Flight
from twin.residuals.measured import attitude_ages, measured_motion

Array = NDArray[np.float64]
RATE_HZ = 100.0


def turning(age_s: Array, seed: int = 0) -> Flight:
    """Half a minute of roll and pitch below 4 Hz; the attitude is older by so much at each time."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(len(age_s)) / RATE_HZ
    hz, phase = rng.uniform(0.6, 4.0, (2, 8)), rng.uniform(0, 2 * np.pi, (2, 8))

    def tilt(at_s: Array, slope: bool) -> Array:
        way = 2 * np.pi * hz[:, :, None] * at_s + phase[:, :, None]
        wave = 2 * np.pi * hz[:, :, None] * np.cos(way) if slope else np.sin(way)
        return np.asarray(0.01 * wave.sum(axis=1))

    angles, rates = tilt(t_s - age_s, slope=False), tilt(t_s, slope=True)
    q = Rotation.from_rotvec(np.column_stack([*angles, 0 * t_s])).as_quat()
    gyro = {f"gyro_{a}": v for a, v in zip("xyz", (*rates, 0 * t_s), strict=True)}
    pose = {f"q_{a}": v for a, v in zip("xyzw", q.T, strict=True)}
    return Flight("made", pd.DataFrame({"time": t_s} | gyro | pose))


def ages(flight: Flight) -> Array:
    motion = measured_motion(flight)
    assert motion.attitude is not None
    assert motion.rates is not None
    return attitude_ages(motion.attitude, motion.rates)


@pytest.mark.parametrize("age_s", [-0.06, 0.0, 0.045])
def test_an_age_is_found_with_its_sign_and_is_no_drift(age_s: float) -> None:
    flight = turning(np.full(3000, age_s))
    found = ages(flight)
    assert len(found) >= 8
    np.testing.assert_allclose(found, age_s, atol=0.005)
    assert not any("drift" in note for note in measured_motion(flight).notes)


def test_clocks_that_drift_are_told() -> None:
    flight = turning(np.linspace(-0.08, 0.08, 3000))
    found = ages(flight)
    assert found.min() < -0.05
    assert found.max() > 0.05
    assert any("drift" in note for note in measured_motion(flight).notes)
