"""Fly the tour, waypoints, circle and figure eight, in still air and in a gusty wind of 5 m/s.

You will see how far from its setpoints the vehicle is, and how far it leans:
    python examples/fly_tour_in_wind.py [SECONDS]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from uavtwin.simulate import Scenario, run_scenario, scenario_system, summary

SCENARIOS = {
    "still air": Scenario("tour", effects=("rotor_drag",)),
    "5 m/s, gusts": Scenario(
        "tour", effects=("rotor_drag",), wind_m_s=(3.0, 4.0, 0.0), gusts=True, seed=3
    ),
}


def main(stop_s: float | None = None) -> None:
    """Fly both, print a line each."""
    for name, scenario in SCENARIOS.items():
        with tempfile.TemporaryDirectory() as folder:
            system = scenario_system(scenario, Path(folder))
            recording = run_scenario(system, stop_s)
        flight = summary(recording)
        print(
            f"{name:12}  {recording.time_s[-1]:.0f} s, {flight['tracking_rms_m']:.3f} m rms from "
            f"the setpoint, {flight['tracking_worst_m']:.3f} m at worst, "
            f"leaning {np.degrees(flight['tilt_worst_rad']):.0f} degrees at most"
        )


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
