"""A hundred flights in one call: how far does gusty wind blow the vehicle off, at each speed?

You will see a line per speed, and every flight is there to look at:
    python examples/fly_many.py [SECONDS]
"""

import sys

import uavtwin as ut


def main(duration_s: float = 10.0) -> None:
    """Fly four speeds, 25 gusts each, print a line per speed."""
    runs = [
        {"wind": (speed, 0.0, 0.0), "seed": seed}
        for speed in (0.0, 3.0, 6.0, 9.0)
        for seed in range(25)
    ]
    flown = ut.simulate_many(
        runs,
        scenario="hover",
        vehicle=ut.vehicle("copter_default"),
        gusts=True,
        effects=["rotor_drag"],
        duration=duration_s,
    )
    for speed, rows in flown.table.groupby("wind.north"):
        worst = flown[rows["tracking_worst_m"].idxmax()]
        print(
            f"{speed:.0f} m/s: {rows['tracking_worst_m'].median():.2f} m off in the median flight, "
            f"{rows['tracking_worst_m'].max():.2f} m in the worst, "
            f"of seed {worst.facts.get('seed', 0)}"
        )


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
