"""How thrust follows from command and voltage: planted numbers come back."""

import numpy as np
import pandas as pd
import pytest

from twin.draft import rotors
from twin.draft.hover import Hover, hover_of
from twin.logs import Flight
from twin.logs.airframe import ThrustCurve

WEIGHT_N = 13.0


def hovering(e: float, k: float, seconds: float = 40.0, volts: float = 0.08) -> Flight:
    """An exact hover by the law of `thrust`, up and down a little; its battery sinks."""
    t = 0.01 * np.arange(round(100 * seconds))
    voltage = 12.0 * (1.0 + volts * (0.5 - t / seconds))
    felt = 1.0 + 0.02 * np.sin(2.0 * t) * np.sin(0.31 * t)
    s = _solved(felt / (1.0 + k * (voltage / 12.0 - 1.0)), e)
    table = pd.DataFrame({"time": t, "vbat_v": voltage, "acc_x": 0.0, "acc_y": 0.0})
    table["acc_z"] = -9.80665 * np.interp(t - 0.03, t, felt)
    for i in range(1, 5):
        table[f"cmd_{i}"] = 0.4 * s
    table["phase"] = "hover"
    return Flight("made", table)


def _solved(share: np.ndarray, e: float) -> np.ndarray:
    """Command over that of hover for a thrust over that of hover."""
    grid = np.linspace(0.5, 1.5, 4001)
    return np.asarray(np.interp(share, rotors.thrust_shape(e, grid), grid))


def hover(flight: Flight) -> Hover:
    found = hover_of(flight)
    assert found is not None
    return found


@pytest.mark.parametrize("e", [1.1, 1.5, 2.2])
def test_the_curve_comes_from_a_hover(e: float) -> None:
    flight = hovering(e, 0.0, volts=0.0)
    told = rotors.thrust_elasticity([flight], [hover(flight)], 0.4)
    assert abs(told.value - e) < 2 * told.sd
    assert abs(told.value - e) < abs(rotors.usual_elasticity(0.4).value - e) + 0.05
    assert "accelerometer" in told.source


def test_a_still_hover_says_nothing_of_the_curve() -> None:
    flight = hovering(2.0, 0.0, volts=0.0)
    noise = 0.3 * np.random.default_rng(0).standard_normal(len(flight.table))
    still = Flight("still", flight.table.assign(acc_z=-9.8 + noise))
    assert rotors.thrust_elasticity([still], [hover(still)], 0.4) == rotors.usual_elasticity(0.4)


@pytest.mark.parametrize("k", [0.0, 1.0, 2.0])
def test_the_sag_comes_from_a_hover(k: float) -> None:
    told = rotors.voltage_sag([hover(hovering(1.4, k))], 1.4, 12.0, 0.4)
    assert told.value == pytest.approx(k, abs=2 * told.sd)
    assert told.sd < 0.2


def test_a_fresh_battery_says_nothing_of_the_sag() -> None:
    told = rotors.voltage_sag([hover(hovering(1.4, 2.0, volts=0.005))], 1.4, 12.0, 0.4)
    assert told.source.startswith("usual")


@pytest.mark.parametrize("k", [0.0, 1.5])
def test_the_map_carries_the_weight(k: float) -> None:
    each = rotors.hover_thrust_n(hover(hovering(1.4, k)), WEIGHT_N, 1.4, k, 12.0, 0.4)
    assert 4 * each == pytest.approx(WEIGHT_N, rel=0.005)


def test_rotor_speeds_give_the_coefficient_and_the_line() -> None:
    flight = hovering(1.4, 0.0, volts=0.0)
    speeds = {f"rotor_{i}": 500.0 for i in range(1, 5)}
    found = hover(Flight("made", flight.table.assign(**speeds)))
    assert rotors.speed_coefficient(found, WEIGHT_N) == pytest.approx(WEIGHT_N / 4 / 500.0**2)
    a, b = rotors.speed_line([found], 1.4)
    assert a + b * found.cmd.mean() == pytest.approx(500.0)  # type: ignore[union-attr]
    assert 2 * b * found.cmd.mean() / 500.0 == pytest.approx(1.4)  # type: ignore[union-attr]


def test_the_factor_of_px4_is_the_same_parabola() -> None:
    """f u^2 + (1 - f) u: its relative slope, and its value along the command."""
    f, u_h = 0.3, 0.45
    e = ThrustCurve(f).elasticity(u_h)
    u = np.linspace(0.0, 1.0, 11)
    px4 = (f * u**2 + (1 - f) * u) / (f * u_h**2 + (1 - f) * u_h)
    assert rotors.thrust_shape(e, u / u_h) == pytest.approx(px4)
