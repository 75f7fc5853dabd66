"""Swap the flight controller: LQR designed from the model, and a cascade with PX4's parameters.

Everything else stays. You will see how well each follows the tour in 5 m/s of wind:
    python examples/swap_controller.py [SECONDS]
"""

import sys

import uavtwin as ut


def main(duration_s: float | None = None) -> None:
    """Fly with each controller, print a line each."""
    for controller in ("lqr", "px4"):
        flight = ut.simulate(
            "tour",
            ut.vehicle("copter_default"),
            controller=controller,
            wind=(3.0, 4.0, 0.0),
            effects=["rotor_drag"],
            duration=duration_s,
        ).json()
        print(
            f"{controller:4} {flight['tracking_rms_m']:.3f} m rms from the setpoint, "
            f"{flight['tracking_worst_m']:.3f} m at worst"
        )


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
