"""Flights of other people's simulators, where their packages are installed."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import needs_package

from benchmarks.hidden_effects.plants.jsbsim import JsbsimFlights
from benchmarks.hidden_effects.plants.kinds import EFFECTS, PLANTS
from benchmarks.hidden_effects.plants.own.parameters import GRAVITY_M_S2, Batch, Parameters
from benchmarks.hidden_effects.plants.own.physics import Layout

CHECK = """
import json, sys
import numpy as np
from benchmarks.hidden_effects.plants import missions
missions.DURATION_S = 5.0
from benchmarks.hidden_effects.plants.aircraft import vehicle_toml
from benchmarks.hidden_effects.plants.aircraft import NOISE
from benchmarks.hidden_effects.plants.missions import Order
from benchmarks.hidden_effects.plants.own.flight import fly
from benchmarks.hidden_effects.plants.kinds import PLANTS
from benchmarks.hidden_effects.plants.sensing import flight_table
from twin.residuals.aligned import align_flight
from twin.logs.flight import Flight
from twin.residuals.channels import GRID_HZ
from twin.residuals.channels import imu_channels
from twin.vehicle_file import parse_vehicle

rms = {}
for name in PLANTS[sys.argv[1]].aircraft:
    a, dynamics = PLANTS[sys.argv[1]].load(name)
    tour = missions.mission("tour", a.nominal.leg, a.pace, np.random.default_rng(5))
    order = Order(a, a.nominal, tour, NOISE["none"], (7,))
    flight = Flight(name, flight_table(order, fly([order], dynamics), 0))
    vehicle = parse_vehicle(vehicle_toml(a, order.noise), "v.toml")
    for c in imu_channels(flight, vehicle, align_flight(flight, vehicle, 1 / GRID_HZ)):
        rms[f"{name} {c.name}"] = float(np.sqrt(np.mean(c.residual**2)))
print(json.dumps(rms))
"""


def residual_rms(plant: str) -> dict[str, float]:
    """Teacher-forced residuals of the twin over a noise-free flight of each aircraft of a plant."""
    run = subprocess.run(
        [sys.executable, "-c", CHECK, plant],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "SCIPY_ARRAY_API": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    rms: dict[str, float] = json.loads(run.stdout)
    assert len(rms) == 6 * len(PLANTS[plant].aircraft)
    return rms


@pytest.mark.slow
@needs_package("drone_models")
def test_twin_matches_a_quiet_flight_of_drone_models() -> None:
    """The dynamics of drone-models and the twin's, two implementations, one aircraft."""
    rms = residual_rms("drone_models")
    assert max(v for k, v in rms.items() if " acc_" in k) < 0.004  # low noise is 0.02
    assert max(v for k, v in rms.items() if " gyro_rate_" in k) < 0.004  # low noise is 0.05


@pytest.mark.slow
@needs_package("jsbsim")
def test_twin_matches_a_quiet_flight_of_jsbsim() -> None:
    """Motors of JSBSim follow no first-order lag: a residual stays, but below low noise."""
    rms = residual_rms("jsbsim")
    assert max(v for k, v in rms.items() if " acc_" in k) < 0.01  # low noise is 0.02
    assert max(v for k, v in rms.items() if " gyro_rate_" in k) < 0.025  # low noise is 0.05


@needs_package("jsbsim")
def test_propeller_of_jsbsim_loses_thrust_in_a_climb_as_the_truth_says() -> None:
    aircraft, _ = PLANTS["jsbsim"].load("F450")
    hidden, truth = EFFECTS["induced_inflow"].hide(
        aircraft.nominal, aircraft, 0.7, np.random.default_rng(1)
    )
    thrust = [thrust_in_hover(hidden, climb_m_s) for climb_m_s in (0.0, 1.0, -1.0)]
    slope = (thrust[2] - thrust[1]) / (2 * thrust[0])
    assert slope == pytest.approx(truth["k_s_m"].value, rel=0.2)  # its table is a curve
    assert thrust[0] == pytest.approx(aircraft.nominal.mass * GRAVITY_M_S2 / 4, rel=0.01)


def thrust_in_hover(p: Parameters, climb_m_s: float) -> float:
    """Of one rotor at the speed of hover, at rest in air that sinks, N."""
    flights = JsbsimFlights()
    batch, layout = Batch([replace(p, mass=1e6, inertia=1e6 * p.inertia)]), Layout(4)
    x = np.zeros((layout.size, 1))
    x[layout.q][0] = 1.0
    x[layout.rotor] = p.hover_speed
    flights.begin(batch, np.zeros((3, 1)))
    flights.hold(np.array([[0.0], [0.0], [-1e6 * GRAVITY_M_S2]]))
    command = np.full((4, 1), (p.hover_speed - p.speed_0) / p.speed_1)
    for _ in range(1000):
        flights.step(layout, x, command, np.array([[0.0], [0.0], [climb_m_s]]))
    return float(flights.thrust()[0, 0] * (p.hover_speed / x[layout.rotor][0, 0]) ** 2)
