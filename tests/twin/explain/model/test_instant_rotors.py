"""Rotors that follow at once by the vehicle file: what they lack still shows."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rig import fitted, rows_of

from twin.effects import EFFECTS
from twin.explain.model.model import Model, model_of
from twin.flight.manoeuvres import Manoeuvre, plan, rehearse
from twin.logs import Flight
from twin.physics.rotors import SHORTEST_LAG_S
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import WAYPOINTS, fly

VEHICLE = load_vehicle("feisi_x150")
NAMES = ("rotor_inertia_torque", "motor_lag", "yaw_torque_scale")


def nodding(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nose left and right, and some of the other axes."""
    w = 2 * np.pi * np.clip(t, 0, 8)
    ramp = np.sin(np.pi * np.clip(t / 8.0, 0, 1)) ** 2
    yaw = 0.6 * np.sin(0.5 * w) + 0.15 * np.sin(1.3 * w)
    return np.column_stack([ramp * 0.3 * np.sin(0.6 * w), 0 * t, 0 * t, ramp * yaw])


def flown(plant: Vehicle) -> Flight:
    like = fly(VEHICLE, VEHICLE, 0, waypoints=WAYPOINTS[:2])
    return rehearse(plan(VEHICLE, [Manoeuvre("nod", "", 8.0, nodding)]), VEHICLE, plant, [like])


def seen(plant: Vehicle, vehicle: Vehicle = VEHICLE) -> Model:
    return model_of([flown(plant)], vehicle, [EFFECTS[e] for e in NAMES])


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [0.0, 0.03])
def test_the_torque_of_rotors_that_speed_up_is_seen_with_its_number(lag_s: float) -> None:
    number = "rotor_inertia_torque.momentum_n_m_s"
    planted = EFFECTS[NAMES[0]].starts(VEHICLE)
    lag = {"motor_lag": {"tau_s": lag_s}} if lag_s else {}
    model = seen(VEHICLE.with_effects({NAMES[0]: planted} | lag))
    column = [n.full for n in model.numbers].index(number)
    _, slopes = rows_of(model.channels([column]), ["gyro_rate_z"])
    assert np.sqrt(np.mean(slopes**2)) * planted["momentum_n_m_s"] > 0.1
    names = [number, "yaw_torque_scale.scale"] + ["motor_lag.tau_s"] * bool(lag_s)
    found = fitted(model, names, ["gyro_rate"])
    # Commands that are recorded every 5 ms and held come 2.5 ms late: on a ramp the state of a
    # rotor is farther behind by that, and its rate seems larger.
    seems = 1 + 0.0025 / (lag_s or SHORTEST_LAG_S)
    assert found[number] * seems == pytest.approx(planted["momentum_n_m_s"], rel=0.05)
    assert found["yaw_torque_scale.scale"] == pytest.approx(1.0, abs=0.05)
    if lag_s:
        assert found["motor_lag.tau_s"] == pytest.approx(lag_s, rel=0.1)


@pytest.mark.slow
def test_a_lag_of_the_file_that_is_too_long_is_found() -> None:
    plant = VEHICLE.with_effects({"motor_lag": {"tau_s": 0.02}})
    rotors = replace(VEHICLE.rotors, lag_up_s=0.05, lag_down_s=0.05)
    found = fitted(seen(plant, replace(VEHICLE, rotors=rotors)), ["motor_lag.tau_s"], ["gyro_rate"])
    assert found["motor_lag.tau_s"] == pytest.approx(-0.03, rel=0.1)
