"""Minimum-jerk ways against calculus, and what a simulated flight records of them."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from twin.flight.closed_loop import STEP_S
from twin.flight.mission import (
    FASTEST,
    HARDEST,
    minimum_jerk,
    minimum_jerk_acceleration,
    minimum_jerk_speed,
    ramped_way,
)
from twin.flight.simulate_flight import Recorder, Stream, simulate_flight
from twin.logs import Flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle

Array = np.ndarray
FEISI = load_vehicle("feisi_x150")
TAKEOFF_S, HOVER_S = 2.0, 1.0


def test_a_minimum_jerk_way_is_its_polynomial_with_its_derivatives_and_peaks() -> None:
    way = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    s = np.linspace(0, 1, 1001)
    forms = (minimum_jerk, minimum_jerk_speed, minimum_jerk_acceleration)
    for order, form in enumerate(forms):
        exact = way.deriv(order)(s) if order else way(s)
        np.testing.assert_allclose(form(s), exact, rtol=0, atol=5e-13)
    assert minimum_jerk_speed(s).max() == pytest.approx(FASTEST)
    assert minimum_jerk_acceleration(s).max() == pytest.approx(HARDEST, rel=1e-5)
    assert [float(form(s)[i]) for form in forms[1:] for i in (0, -1)] == [0.0] * 4


def test_a_ramped_way_has_minimum_jerk_ramps_of_its_rate() -> None:
    """Rate by central differences: up, held, down; the whole way at the end; also as a symbol."""
    total, rate, ramp = 7.0, 2.0, 1.5
    h, t = 1e-4, np.linspace(0.1, total / rate + ramp - 0.1, 997)

    def way(t_s: Array) -> Array:
        return ramped_way(t_s, total, rate, ramp)

    slope = (way(t + h) - way(t - h)) / (2 * h)
    up, down = (np.clip(x / ramp, 0, 1) for x in (t, t - total / rate))
    np.testing.assert_allclose(slope, rate * (minimum_jerk(up) - minimum_jerk(down)), atol=1e-6)
    np.testing.assert_allclose(way(np.array([0.0, total / rate + ramp])), [0.0, total], atol=1e-12)
    symbol = ca.SX.sym("t")
    function = ca.Function("way", [symbol], [ramped_way(symbol, total, rate, ramp)])
    np.testing.assert_allclose(np.array(function(t[None])).ravel(), way(t), rtol=1e-13)


def setpoints() -> tuple[Array, list[str]]:
    """Up by 1.5 m, and hover."""
    n, m = round(TAKEOFF_S / STEP_S), round(HOVER_S / STEP_S)
    rows = np.zeros((n + m, 11))
    s = np.minimum(np.arange(n + m) / n, 1.0)
    rows[:, 2] = -FEISI.leg_height_m - 1.5 * minimum_jerk(s)
    rows[:, 10] = 1.0
    return rows, ["takeoff"] * n + ["hover"] * m


def flown(recorder: Recorder, plant: Vehicle = FEISI) -> Flight:
    return simulate_flight(*setpoints(), FEISI, plant, recorder, "one")


def recorder(*streams: Stream, **changes: object) -> Recorder:
    return replace(Recorder(streams, rate_hz=200.0, sampled_hz=1000.0), **changes)  # type: ignore[arg-type]


@pytest.mark.slow
def test_streams_are_recorded_at_their_own_rates_with_their_own_noise() -> None:
    clean = [
        Stream(("cmd_1",), 0.005),
        Stream(("acc_x", "acc_y", "acc_z"), 0.01),
        Stream(("q_w", "q_x", "q_y", "q_z"), 0.02),
        Stream(("mag_y",), 0.05),
        Stream(("baro_pa",), 0.001),
        Stream(("ibat_a",), 0.005),
    ]
    noisy = [replace(clean[1], noise=0.2), replace(clean[2], noise=0.01)]
    still, loud = flown(recorder(*clean)), flown(recorder(*noisy, seed=3))
    t = still.table["time"].to_numpy()
    np.testing.assert_array_equal(t, np.arange(len(t)) / 200)
    assert len(t) == (TAKEOFF_S + HOVER_S) * 200
    counts = {c: int(still.table[c].notna().sum()) for c in still.table if c != "phase"}
    assert counts == {
        "time": 600,
        "cmd_1": 600,
        **dict.fromkeys(("acc_x", "acc_y", "acc_z"), 300),
        **dict.fromkeys(("q_w", "q_x", "q_y", "q_z"), 150),
        "mag_y": 60,
        "baro_pa": 600,
    }  # the twin has no current
    noise = (loud.table["acc_y"] - still.table["acc_y"]).dropna()
    assert noise.std() == pytest.approx(0.2, rel=4 / np.sqrt(2 * len(noise)))
    q = loud.table[["q_w", "q_x", "q_y", "q_z"]].dropna().to_numpy()
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=1e-12)
    again = flown(recorder(*noisy, seed=3)).table
    assert again.equals(loud.table)


@pytest.mark.slow
def test_an_old_pose_is_recorded_late_and_flown_as_it_is() -> None:
    streams = Stream(("cmd_1",), 0.005), Stream(("pos_z",), 0.005), Stream(("q_w",), 0.005)
    old = FEISI.with_effects({"position_delay": {"delay_s": 0.05, "attitude_s": 0.0}})
    now, late = (flown(recorder(*streams), plant).table for plant in (FEISI, old))
    np.testing.assert_allclose(late["pos_z"][10:], now["pos_z"][:-10], rtol=1e-12)
    for column in ("cmd_1", "q_w"):
        np.testing.assert_array_equal(late[column], now[column])


@pytest.mark.slow
def test_late_commands_are_recorded_early_or_answered_late() -> None:
    """Recorded early, the flight is the same; answered late, the loop moves differently."""
    streams = Stream(("cmd_1",), 0.005), Stream(("pos_z",), 0.005)
    late = FEISI.with_effects({"command_delay": {"delay_s": 0.05}})
    now = flown(recorder(*streams)).table
    early = flown(recorder(*streams, early_commands=True), late).table
    np.testing.assert_allclose(early["cmd_1"][:-10], now["cmd_1"][10:], rtol=1e-12)
    np.testing.assert_array_equal(early["pos_z"], now["pos_z"])
    answered = flown(recorder(*streams), late).table
    assert np.abs(answered["pos_z"] - now["pos_z"]).max() > 1e-3


@pytest.mark.slow
def test_a_record_ends_where_the_vehicle_is_lost() -> None:
    crossed = 0.005 - FEISI.rotors.position_m * [1, 1, 0]
    torn = replace(FEISI, rotors=replace(FEISI.rotors, position_m=crossed))
    stream = Stream(("pos_z",), 0.005)
    whole = flown(recorder(stream, until_lost=True)).table
    lost = flown(recorder(stream, until_lost=True), torn).table
    assert len(whole) == 600
    assert len(lost) < 300
