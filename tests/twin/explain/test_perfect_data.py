"""Readings without noise: a wrong number of the vehicle file is named, a right file stays as it is,
and no matrix is singular."""

from dataclasses import replace

import numpy as np
import pytest

from twin.effects import EFFECTS, prior_of
from twin.explain.explanation import explain
from twin.explain.inference.priors import priors_of
from twin.explain.model.model import model_of
from twin.logs import Flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

COPTER = load_vehicle("copter_default")
PERFECT = replace(
    COPTER,
    sensors=replace(
        COPTER.sensors,
        accel_noise_m_s2=0.0,
        gyro_noise_rad_s=0.0,
        mag_noise_t=0.0,
        baro_noise_pa=0.0,
    ),
)
TOUR: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("tour", 2.0, (1.5, 0.0, -1.5)),
    ("tour", 2.0, (1.5, 1.5, -2.0)),
    ("tour", 2.0, (0.0, 0.0, -1.5)),
    ("tour", 2.0, (-1.5, 0.5, -1.0)),
)


@pytest.fixture(scope="module")
def perfect() -> Flight:
    return fly(PERFECT, PERFECT, seed=4, name="perfect", waypoints=TOUR)


def with_lag(vehicle: Vehicle, lag_s: float) -> Vehicle:
    return replace(vehicle, rotors=replace(vehicle.rotors, lag_up_s=lag_s, lag_down_s=lag_s))


def named(flight: Flight, vehicle: Vehicle) -> dict[str, float]:
    """What is said of a flight, number by number."""
    found = explain([flight], [], vehicle, missions=[], suggest=False, indoors=True)
    assert found.verdict in ("named", "nothing"), found.verdict
    assert all(np.isfinite(v) for v in found.values.values())
    return dict(found.values) if found.verdict == "named" else {}


@pytest.mark.slow
def test_a_lag_is_named_from_readings_without_noise(perfect: Flight) -> None:
    found = named(perfect, with_lag(COPTER, 0.005))
    assert found["motor_lag.tau_s"] == pytest.approx(0.045, abs=0.003)


@pytest.mark.slow
def test_nothing_is_named_where_file_and_readings_are_perfect(perfect: Flight) -> None:
    assert named(perfect, COPTER) == {}


@pytest.mark.slow
def test_a_channel_without_noise_among_noisy_ones_does_not_end_the_search(
    perfect: Flight,
) -> None:
    noisy = fly(COPTER, COPTER, seed=4, name="noisy", waypoints=TOUR)
    table = noisy.table.copy()
    rows = min(len(table), len(perfect.table))
    table = table.iloc[:rows].copy()
    table["acc_z"] = perfect.table["acc_z"].to_numpy()[:rows]
    found = named(replace(noisy, table=table), with_lag(COPTER, 0.005))
    assert found["motor_lag.tau_s"] == pytest.approx(0.045, abs=0.005)


@pytest.mark.slow
def test_the_prior_of_a_lag_is_about_the_whole(perfect: Flight) -> None:
    """Two files of one aircraft expect the same whole lag, and none below zero."""
    whole = prior_of(EFFECTS["motor_lag"]).of("tau_s", False).mean
    for lag_s in (0.005, 0.05, 0.12):
        vehicle = with_lag(COPTER, lag_s)
        model = model_of([perfect], vehicle, [EFFECTS["motor_lag"]])
        priors = priors_of(model)
        (i,) = [k for k, n in enumerate(priors.names) if n == "motor_lag.tau_s"]
        assert priors.mean[i] + lag_s == pytest.approx(whole)
        assert priors.low[i] + lag_s > 0
        assert priors.slab[i] > prior_of(EFFECTS["motor_lag"]).of("tau_s", False).sd
