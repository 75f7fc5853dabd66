"""Residual statistics against planted signals with known rms, mean and spectrum."""

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import shift
from scipy.signal import butter, cont2discrete, lfilter

from twin.errors import ModelError
from twin.logs import Flight
from twin.physics.airframe import airframe
from twin.residuals.channels import BAND_HZ, GRID_HZ, sensed, sensor_lag, shifted
from twin.residuals.gap import Channel, FlightGap, pool, rank, slow_part, spectrum, summarise
from twin.residuals.teacher_forced import InputSignals
from twin.vehicle_file import load_vehicle
from uavtwin.gaps import gap_record

RATE_HZ = 200.0


def planted(
    amplitude: float = 0.6, offset: float = 0.1, f_hz: float = 5.0, seconds: float = 20.0
) -> Channel:
    """Measured 2 sin(2 pi 0.5 t); the twin lacks `offset + amplitude sin(2 pi f t)` of it."""
    t_s = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    measured = 2.0 * np.sin(2 * np.pi * 0.5 * t_s)
    lacking = offset + amplitude * np.sin(2 * np.pi * f_hz * t_s)
    phase = np.where(t_s < seconds / 2, "takeoff", "hover").astype(np.str_)
    return Channel("acc_z", "m/s2", 0.0, t_s, measured, measured - lacking, phase)


def gap(*channels: Channel, flight: str = "one") -> FlightGap:
    return FlightGap(flight, "crazyflie", channels, (("takeoff", 0.0, 10.0),), ("w",), {"k": "v"})


def test_planted_sine_has_its_rms_mean_and_share() -> None:
    total = summarise(planted()).total
    assert total.n == 4000
    assert total.mean == pytest.approx(0.1, abs=1e-12)
    assert total.rms == pytest.approx(math.hypot(0.1, 0.6 / math.sqrt(2)), rel=1e-12)
    assert total.share == pytest.approx(total.rms / math.sqrt(2.0), rel=1e-12)
    assert total.rms_ci95[0] <= total.rms <= total.rms_ci95[1]


def test_phase_is_scored_against_the_signal_of_the_whole_flight() -> None:
    channel = planted(offset=0.0)
    quiet = np.where(channel.phase == "hover", 0.0, 1.0)
    lacking = channel.residual
    measured = channel.measured * quiet + lacking
    summary = summarise(replace(channel, measured=measured, simulated=measured - lacking))
    hover, takeoff = summary.by_phase["hover"], summary.by_phase["takeoff"]
    assert list(summary.by_phase) == ["takeoff", "hover"]
    assert hover.n == takeoff.n == 2000
    assert hover.rms == pytest.approx(takeoff.rms, rel=1e-9)
    assert hover.share == pytest.approx(takeoff.share, rel=1e-9)
    assert hover.share < 0.5  # against its own quiet signal it would be 1


def test_pooling_takes_each_flight_about_its_own_mean() -> None:
    one = planted()
    two = replace(one, measured=one.measured + 100.0, simulated=one.simulated + 100.0)
    assert pool([one, two]).total.share == pytest.approx(summarise(one).total.share, rel=1e-9)
    assert pool([one, two]).total.n == 8000


def test_pooling_refuses_different_units() -> None:
    with pytest.raises(ModelError, match="2 kinds of channel"):
        pool([planted(), replace(planted(), unit="g")])


@pytest.mark.parametrize("f_hz", [2.0, 7.5, 31.0])
def test_spectrum_peaks_at_the_planted_frequency_and_keeps_the_power(f_hz: float) -> None:
    channel = planted(amplitude=0.6, offset=3.0, f_hz=f_hz)
    density = spectrum(channel.t_s, channel.residual)
    assert density.rate_hz == pytest.approx(RATE_HZ)
    assert density.f_hz[np.argmax(density.psd)] == pytest.approx(f_hz, abs=0.126)
    assert density.band_rms(0.0, math.inf) == pytest.approx(0.6 / math.sqrt(2), rel=1e-2)
    assert density.band_rms(f_hz + 2, math.inf) < 1e-3
    assert math.isnan(density.band_rms(150.0, math.inf))  # above half the rate


def test_spectrum_of_samples_that_arrive_irregularly() -> None:
    rng = np.random.default_rng(0)
    t_s = np.arange(8000) / 206.0
    t_s = t_s[rng.random(8000) < 0.8]
    density = spectrum(t_s, np.sin(2 * np.pi * 5.0 * t_s))
    assert density.rate_hz == pytest.approx(206.0)
    assert density.f_hz[np.argmax(density.psd)] == pytest.approx(5.0, abs=0.13)
    assert density.band_rms(4.0, 6.0) == pytest.approx(math.sqrt(0.5), rel=0.02)


def test_slow_part_keeps_motion_and_drops_vibration() -> None:
    t_s = np.arange(4000) / RATE_HZ
    motion, vibration = np.sin(2 * np.pi * t_s), np.sin(2 * np.pi * 60.0 * t_s)
    kept = slow_part(t_s, motion + vibration)
    assert np.sqrt(np.mean((kept - motion)[200:-200] ** 2)) < 2e-3
    assert slow_part(t_s[::20], motion[::20]) is not None
    np.testing.assert_array_equal(slow_part(t_s[::20], motion[::20]), motion[::20])


def test_ranking_puts_a_missing_force_before_louder_vibration() -> None:
    force = planted(amplitude=0.6, f_hz=1.0)
    vibration = replace(planted(amplitude=1.5, f_hz=70.0, offset=0.0), name="acc_x")
    pooled = {c.name: summarise(c) for c in (vibration, force)}
    assert pooled["acc_x"].total.rms > pooled["acc_z"].total.rms
    assert [r.channel for r in rank(pooled)][:2] == ["acc_z", "acc_z"]


def test_samples_without_a_number_are_dropped_and_counted() -> None:
    channel = planted()
    measured = channel.measured.copy()
    measured[:100] = np.nan
    simulated = channel.simulated.copy()
    simulated[-50:] = np.inf
    total = summarise(replace(channel, measured=measured, simulated=simulated)).total
    assert (total.n, total.dropped) == (3850, 150)
    assert math.isfinite(total.rms)


def test_flat_and_empty_signals_give_null_and_a_warning() -> None:
    channel = planted()
    flat = replace(channel, measured=np.full_like(channel.measured, -9.81), name="acc_x")
    none = np.empty(0)
    empty = Channel("acc_y", "m/s2", 0.0, none, none, none, np.empty(0, dtype=np.str_))
    report = gap_record([gap(flat, empty)]).json()
    assert report["channels"]["acc_x"]["share"] is None
    assert report["channels"]["acc_y"]["n"] == 0
    assert report["channels"]["acc_y"]["rms"] is None
    assert any("acc_x" in w and "flat" in w for w in report["warnings"])
    assert any("acc_y" in w for w in report["warnings"])


def test_gap_json_has_the_published_layout_and_is_strict() -> None:
    report = gap_record([gap(planted()), gap(planted(), flight="two")]).json()
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert {"flights", "channels", "warnings"} <= set(report)
    channel = report["channels"]["acc_z"]
    assert {"unit", "horizon_s", "n", "rms", "mean", "by_phase"} <= set(channel)
    assert channel["n"] == 8000
    assert set(channel["by_phase"]) == {"takeoff", "hover"}
    assert [f["name"] for f in report["flights"]] == ["one", "two"]
    assert report["warnings"] == ["one: w", "two: w"]
    slow = next(b for b in channel["bands"] if b["from_hz"] == 1.0)
    assert slow["residual_rms"] == pytest.approx(0.6 / math.sqrt(2), rel=1e-2)


def test_one_name_at_two_horizons_gives_two_channels() -> None:
    report = gap_record([gap(planted(), replace(planted(), horizon_s=0.5))]).json()
    assert set(report["channels"]) == {"acc_z@0s", "acc_z@0.5s"}


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    n=st.integers(0, 60),
    bad=st.lists(st.tuples(st.integers(0, 59), st.sampled_from([math.nan, math.inf])), max_size=9),
)
def test_any_record_however_short_gives_strict_json(n: int, bad: list[tuple[int, float]]) -> None:
    channel = planted()
    measured = channel.measured[:n].copy()
    for i, value in bad:
        if i < n:
            measured[i] = value
    cut = replace(
        channel,
        t_s=channel.t_s[:n],
        measured=measured,
        simulated=channel.simulated[:n],
        phase=channel.phase[:n],
    )
    report = json.loads(json.dumps(gap_record([gap(cut)]).json(), allow_nan=False))
    assert report["channels"]["acc_z"]["n"] == int(np.isfinite(measured).sum())


def test_rotors_accelerate_as_their_measured_speeds_say() -> None:
    """Reaction of rotors that swing at 1 Hz, from speeds that are measured at 200 Hz."""
    base = load_vehicle("copter_default")
    inertia = 2e-5
    vehicle = replace(base, rotors=replace(base.rotors, reaction_inertia_kg_m2=inertia))
    t_s = np.arange(400) / RATE_HZ
    speed = 600 + 50 * np.sin(2 * np.pi * t_s)
    flight = Flight(
        "swing", pd.DataFrame({"time": t_s} | {f"rotor_{i}": speed for i in (1, 2, 3, 4)})
    )
    body = airframe(vehicle, "rotor_speed")
    grid_s = np.linspace(0.2, 1.2, 1000, endpoint=False)
    found = InputSignals(flight, vehicle, body).at(grid_s)[:, body.input_names.index("spin_rate_3")]
    exact = 50 * 2 * np.pi * np.cos(2 * np.pi * grid_s)
    assert np.abs(found - exact).max() < 0.02 * np.abs(exact).max()


# -- shifts in time --------------------------------------------------------------------------


@pytest.mark.slow
@given(later_s=st.floats(-0.2, 0.2), seed=st.integers(0, 2**16))
def test_a_shift_is_that_of_a_second_implementation(later_s: float, seed: int) -> None:
    values = np.random.default_rng(seed).standard_normal((300, 2)).cumsum(axis=0)
    own = [shift(v, later_s * GRID_HZ, order=3, mode="nearest") for v in values.T]
    assert shifted(values, later_s) == pytest.approx(np.stack(own, axis=1), abs=1e-5)


def test_a_shift_bridges_what_is_unknown_and_leaves_what_nobody_knows() -> None:
    values = np.tile(np.arange(100.0)[:, None], (1, 2))
    values[40:50, 0], values[:, 1] = np.nan, np.nan
    moved = shifted(values, 2.5 / GRID_HZ)
    assert moved[20:80, 0] == pytest.approx(np.arange(20, 80) - 2.5)
    assert np.all(np.isnan(moved[:, 1]))


@pytest.mark.parametrize("cutoff_hz", [8.0, 30.0, 60.0, 94.0, 188.0])
def test_a_sensor_lags_as_its_analog_low_pass_does(cutoff_hz: float) -> None:
    """Against the analog filter in steps of 0.05 ms, by a signal of all frequencies below half the
    band of the channels, and by a ramp."""
    fine, seconds = 100, 10
    n = round(GRID_HZ) * fine * seconds
    hz = np.fft.rfftfreq(n, 1 / (GRID_HZ * fine))
    rng = np.random.default_rng(0)
    waves = np.where((hz > 0) & (hz < BAND_HZ / 2), 1.0, 0.0) * np.exp(
        2j * np.pi * rng.random(len(hz))
    )
    signal = np.fft.irfft(waves, n)
    analog = butter(2, 2 * np.pi * cutoff_hz, analog=True)
    numerator, denominator, _ = cont2discrete(analog, 1 / (GRID_HZ * fine), method="foh")
    read = lfilter(numerator[0], denominator, signal)[::fine]
    off = (sensed(signal[::fine], cutoff_hz) - read)[round(GRID_HZ) :]  # the filters have settled
    assert np.std(off) < 0.005 * np.std(read)
    ramp = np.arange(400.0)[:, None] / GRID_HZ
    lag_s = sensor_lag(cutoff_hz)
    np.testing.assert_allclose((ramp - sensed(ramp, cutoff_hz))[-1], lag_s)
    corrected = sensed(ramp, cutoff_hz, lag_s)[200:-20]  # of readings that a reader corrects
    np.testing.assert_allclose(corrected, ramp[200:-20], atol=1e-6)
