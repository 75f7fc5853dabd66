"""Flights of other people's simulators, where their packages are installed."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

CHECK = """
import json, sys
import numpy as np
from benchmarks.hidden_effects import missions
missions.DURATION_S = 5.0
from benchmarks.hidden_effects.aircraft import vehicle_toml
from benchmarks.hidden_effects.noise import NOISE
from benchmarks.hidden_effects.orders import Order
from benchmarks.hidden_effects.own import fly
from benchmarks.hidden_effects.plants import PLANTS
from benchmarks.hidden_effects.sensing import flight_table
from cosim.gap import prepare
from twin.flightlog.flight import Flight
from twin.teacher_forced import predicted_readings, teacher_forced_channels
from twin.vehicle_file import parse_vehicle

rms = {}
for name in PLANTS["drone_models"].aircraft:
    a, dynamics = PLANTS["drone_models"].load(name)
    tour = missions.mission("tour", a.nominal.leg, a.pace, np.random.default_rng(5))
    order = Order(a, a.nominal, tour, NOISE["none"], (7,))
    flight = Flight(name, flight_table(order, fly([order], dynamics), 0))
    twin = prepare(flight, parse_vehicle(vehicle_toml(a, order.noise), "v.toml"))
    readings, names = predicted_readings(twin.airframe, twin.imu, twin.states, twin.inputs.u)
    for c in teacher_forced_channels(
        flight, twin.motion, twin.inputs.t_s, readings, names, twin.airborne, twin.phases
    ):
        rms[f"{name} {c.name}"] = float(np.sqrt(np.mean(c.residual[c.t_s < 4.7] ** 2)))
print(json.dumps(rms))
"""


@pytest.mark.skipif(
    not find_spec("drone_models") and not os.environ.get("CI"),
    reason="drone-models is not installed",
)
def test_twin_matches_a_quiet_flight_of_drone_models() -> None:
    """The dynamics of drone-models and the twin's, two implementations, one aircraft."""
    run = subprocess.run(
        [sys.executable, "-c", CHECK],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "SCIPY_ARRAY_API": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    rms = json.loads(run.stdout)
    assert len(rms) == 12
    assert max(v for k, v in rms.items() if " acc_" in k) < 0.004  # low noise is 0.02
    assert max(v for k, v in rms.items() if " angacc_" in k) < 0.004  # low noise is 0.05
