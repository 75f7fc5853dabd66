"""A flight of a built-in aircraft, simulated in closed loop, logged as Betaflight logs it and read
back: the table is the flight's, and the motors turn the aircraft as their places say."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from log_rigs.blackbox_rig import Part, blackbox, flown_main
from scipy.signal import savgol_filter

from twin.logs import Flight, read_flight
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import WAYPOINTS, fly

_STEP_S = 0.005
_BETAFLIGHT_ORDER = (4, 1, 2, 3)
"""Rear right, front right, rear left, front left among the motors of PX4."""

pytestmark = pytest.mark.slow


@cache
def _flown() -> pd.DataFrame:
    """Every signal in every row, motors in Betaflight's order, a barometer and voltage made up."""
    vehicle = load_vehicle("copter_default")
    table = fly(vehicle, vehicle, seed=3, waypoints=WAYPOINTS[:6], imu_s=_STEP_S).table
    order = {f"cmd_{k}": table[f"cmd_{p}"] for k, p in enumerate(_BETAFLIGHT_ORDER, start=1)}
    table = table.assign(**order).drop(columns="phase").interpolate(limit_direction="both")
    pressure = 101325.0 * (1.0 + table["pos_z"] / 44330.0) ** 5.255
    return table.assign(baro_pa=pressure.to_numpy())


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    path = tmp_path_factory.mktemp("blackbox") / "LOG00001.BFL"
    part = Part(flown_main(_flown(), high_resolution=True), {"blackbox_high_resolution": "1"})
    path.write_bytes(blackbox(part))
    return read_flight(path)


def test_the_table_is_that_of_the_flight(flight: Flight) -> None:
    truth = _flown()
    for columns, within in (
        ([f"gyro_{a}" for a in "xyz"], 0.051 * np.pi / 180),
        ([f"q_{a}" for a in "wxyz"], 2e-4),
        ([f"cmd_{k}" for k in range(1, 5)], 0.51 / 1999),
    ):
        t, values = flight.signal(columns)
        np.testing.assert_allclose(t, truth["time"] - truth["time"].iloc[0], atol=2e-6)
        sign = np.sign(np.sum(values * truth[columns].to_numpy(), axis=1))[:, None]
        meant = truth[columns].to_numpy() * (sign if len(columns) == 4 else 1.0)
        np.testing.assert_allclose(values, meant, atol=within)
    t, acc = flight.signal(["acc_z"])
    shifted = np.interp(t + 9.003e-3, truth["time"] - truth["time"].iloc[0], truth["acc_z"])
    np.testing.assert_allclose(acc[:, 0], shifted, atol=0.06)
    assert [f for f in flight.findings if f.severity != "info"] == []


def test_motors_turn_the_aircraft_as_their_places_say(flight: Flight) -> None:
    """Roll, pitch and yaw of thrust at the places of the layout against the change of the rates."""
    assert flight.airframe is not None and flight.airframe.layout is not None
    layout = flight.airframe.layout
    _, commands = flight.signal([f"cmd_{k}" for k in range(1, 5)])
    t, rates = flight.signal([f"gyro_{a}" for a in "xyz"])
    airborne = (t > 2.0) & (t < t[-1] - 0.5)
    thrust = commands**2
    x, y = layout.position[:, 0], layout.position[:, 1]
    moments = thrust @ np.column_stack([-y, x, -layout.direction])
    slow = savgol_filter(moments, 41, 2, axis=0)
    turning = savgol_filter(rates, 41, 2, deriv=1, delta=_STEP_S, axis=0)
    for axis in range(2):
        r = np.corrcoef(slow[airborne, axis], turning[airborne, axis])[0, 1]
        assert r > 0.5, (axis, r)
