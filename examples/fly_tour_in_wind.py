"""Fly the tour, waypoints, circle and figure eight, in still air and in a gusty wind of 5 m/s.

You will see how far from its setpoints the vehicle is, and how far it leans:
    python examples/fly_tour_in_wind.py [SECONDS]
"""

import sys

import numpy as np

import uavtwin as ut


def main(duration_s: float | None = None) -> None:
    """Fly both, print a line each."""
    vehicle = ut.vehicle("copter_default")
    for air, wind, gusts in (
        ("still air", (0.0, 0.0, 0.0), False),
        ("5 m/s, gusts", (3.0, 4.0, 0.0), True),
    ):
        run = ut.simulate(
            "tour",
            vehicle,
            wind=wind,
            gusts=gusts,
            seed=3,
            effects=["rotor_drag"],
            duration=duration_s,
        )
        flight = run.json()
        print(
            f"{air:12}  {run.recording.time_s[-1]:.0f} s, {flight['tracking_rms_m']:.3f} m rms "
            f"from the setpoint, {flight['tracking_worst_m']:.3f} m at worst, "
            f"leaning {np.degrees(flight['tilt_worst_rad']):.0f} degrees at most"
        )


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
