"""PX4 rate controller and mixer: exact solutions, and a second version sample by sample."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twin.logs.flight import Array
from twin.logs.px4.control import (
    Gyro,
    Mixer,
    RateGains,
    integrals,
    low_pass,
    mix,
    mixer_names,
    mixer_scale,
    notch,
    raw_times,
    resample,
)

RATE_HZ = 2000.0


def amplitude(filtered: Array) -> float:
    """Amplitude of a sine after the filter has settled."""
    return float(np.sqrt(2.0) * filtered[len(filtered) // 2 :].std())


def test_low_pass_is_butterworth() -> None:
    """|H|^2 = 1 / (1 + (f / fc)^4), in the prewarped frequency."""
    t = np.arange(8000) / RATE_HZ
    for f in (5.0, 35.0, 120.0):
        warped = np.tan(np.pi * f / RATE_HZ) / np.tan(np.pi * 35.0 / RATE_HZ)
        got = amplitude(low_pass(np.sin(2 * np.pi * f * t)[:, None], RATE_HZ, 35.0))
        assert got == pytest.approx(1.0 / np.sqrt(1.0 + warped**4), rel=2e-3)


def test_notch_removes_its_centre_and_keeps_the_rest() -> None:
    t = np.arange(8000) / RATE_HZ
    assert amplitude(notch(np.sin(2 * np.pi * 60 * t)[:, None], RATE_HZ, 60.0, 20.0)) < 1e-3
    assert amplitude(notch(np.sin(2 * np.pi * 5 * t)[:, None], RATE_HZ, 60.0, 20.0)) > 0.99


def test_filters_start_at_rest() -> None:
    constant = np.full((50, 3), 0.7)
    np.testing.assert_allclose(low_pass(constant, RATE_HZ, 35.0), constant, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(low_pass(constant, RATE_HZ, 0.0), constant)


def means(end: Array, window: Array, hz: float) -> Array:
    """Means of a sine over windows, exact, shape (n, 3)."""
    w = 2 * np.pi * hz
    return np.repeat((np.cos(w * (end - window)) - np.cos(w * end))[:, None], 3, 1) / (
        w * window[:, None]
    )


def test_resampling_of_window_means_is_third_order_or_better() -> None:
    """Every second sample is missing now and then, as in the recorded flights."""
    errors = []
    for step in (0.006, 0.003, 0.0015):
        count = int(3.0 / step)
        keep = np.arange(count) % 7 != 3
        end = (1 + np.arange(count))[keep] * step
        window = np.full(len(end), step)
        gyro = Gyro(end, window, means(end, window, 8.0), RATE_HZ, RATE_HZ, 0.0)
        t = np.linspace(0.5, 2.5, 2001)
        errors.append(np.abs(resample(gyro, t)[:, 0] - np.sin(2 * np.pi * 8.0 * t)).max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 2.7), (errors, orders)


def test_raw_times_pass_through_every_window_end() -> None:
    end = np.cumsum([0.0045, 0.006, 0.0045, 0.0105])
    gyro = Gyro(end, np.full(4, 0.0045), np.zeros((4, 3)), RATE_HZ, RATE_HZ / 3, 0.0)
    t = raw_times(gyro)
    np.testing.assert_allclose(np.diff(t), 1.0 / RATE_HZ, rtol=1e-9)
    assert np.all(np.min(np.abs(t[:, None] - end), axis=0) < 1e-12)


def test_integral_of_a_constant_error_and_its_anchor() -> None:
    """i * (1 - (e / 400 deg/s)^2) * e * t, restarted at the logged value, then at its limit."""
    t = np.arange(0.001, 3.0005, 0.001)
    p, i, none, limit = (np.full(3, x) for x in (0.1, 0.2, 0.0, 0.3))
    gains = RateGains(p, i, none, none, limit)
    error = np.full((len(t), 3), 0.5)
    free = (np.zeros((len(t), 3), bool), np.zeros((len(t), 3), bool))
    run = np.ones(len(t), bool)
    slope = 0.2 * (1 - (0.5 / np.radians(400)) ** 2) * 0.5
    plain = integrals(t, error, gains, run, free, np.zeros(0), np.zeros((0, 3)))
    np.testing.assert_allclose(plain[1000, 0] - plain[0, 0], slope * 1.0, rtol=1e-3)
    again = integrals(t, error, gains, run, free, np.array([1.0]), np.full((1, 3), -0.1))
    np.testing.assert_allclose(again[1500, 0], -0.1 + slope * 0.5, atol=3e-4)
    assert plain.max() <= 0.3
    still = integrals(t, error, gains, ~run, free, np.array([1.0]), np.full((1, 3), -0.1))
    np.testing.assert_allclose(still, -0.1)


def one_by_one(control: Array, scale: Array, airmode: int) -> Array:
    """The mixer for one sample, written as loops; for comparison."""
    roll, pitch, yaw = np.clip(control[:3], -1, 1)
    thrust = min(max(control[3], 0.0), 1.0)

    def gain(out: Array, way: Array, high: float) -> float:
        low_k = high_k = 0.0
        for o, w in zip(out, way, strict=True):
            if abs(w) < 1e-7:
                continue
            for k in ([-o / w] if o < 0 else []) + ([(high - o) / w] if o > high else []):
                low_k, high_k = min(low_k, k), max(high_k, k)
        return low_k + high_k

    def fit(out: Array, way: Array, high: float = 1.0, reduce: bool = False) -> Array:
        k = gain(out, way, high)
        if reduce and k > 0:
            return out
        out = out + k * way
        return out + 0.5 * gain(out, way, high) * way

    r, p, y, z = scale.T
    if airmode == 2:
        out = fit(fit(roll * r + pitch * p + yaw * y + thrust * z, z), y)
    else:
        out = fit(roll * r + pitch * p + thrust * z, z, reduce=airmode == 0)
        if airmode == 0:
            out = fit(fit(out, r), p)
        out = fit(fit(out + yaw * y, y, high=1.15), z, reduce=True)
    return np.clip(out, 0, 1)


@pytest.mark.slow
@given(
    arrays(np.float64, (5, 4), elements=st.floats(-1.2, 1.2)),
    st.sampled_from(["quad_x", "quad_wide", "quad_plus", "hex_x"]),
    st.integers(0, 2),
)
def test_mixer_equals_the_loop(controls: Array, name: str, airmode: int) -> None:
    scale = mixer_scale(name)
    got = mix(controls, Mixer(scale, airmode, 0.0))
    want = np.array([one_by_one(c, scale, airmode) for c in controls])
    np.testing.assert_allclose(got, want, atol=1e-9)


def test_thrust_model_is_inverted() -> None:
    """thrust = (1 - f) cmd + f cmd^2."""
    scale = mixer_scale("quad_x")
    thrust = np.linspace(0, 1, 21)
    cmd = mix(np.column_stack([np.zeros((21, 3)), thrust]), Mixer(scale, 0, 0.3))[:, 0]
    np.testing.assert_allclose(0.7 * cmd + 0.3 * cmd**2, thrust, atol=1e-12)


def test_mixers_are_balanced() -> None:
    """Roll, pitch and yaw leave the thrust alone."""
    assert set(mixer_names(4)) == {"quad_x", "quad_wide", "quad_plus"}
    for name in (*mixer_names(4), *mixer_names(6)):
        np.testing.assert_allclose(mixer_scale(name)[:, :3].sum(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(mixer_scale(name)[:, 3], 1.0)
