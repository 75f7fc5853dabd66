"""Swap the flight controller: LQR designed from the model, and a cascade with PX4's parameters.

Everything else stays. You will see how well each follows the tour in 5 m/s of wind:
    python examples/swap_controller.py [SECONDS]
"""

import sys
import tempfile
from pathlib import Path

from twin.flight.assembly import CONTROLLERS
from uavtwin.simulate import Scenario, run_scenario, scenario_system, summary


def main(stop_s: float | None = None) -> None:
    """Fly with each controller, print a line each."""
    for name in CONTROLLERS:
        scenario = Scenario(
            "tour", controller=name, wind_m_s=(3.0, 4.0, 0.0), effects=("rotor_drag",)
        )
        with tempfile.TemporaryDirectory() as folder:
            recording = run_scenario(scenario_system(scenario, Path(folder)), stop_s)
        flight = summary(recording)
        print(
            f"{name:4} {flight['tracking_rms_m']:.3f} m rms from the setpoint, "
            f"{flight['tracking_worst_m']:.3f} m at worst"
        )


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
