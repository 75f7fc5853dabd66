"""A vehicle, its flights, the gap, what the model lacks, and the better model as an FMU.

You will see the gap of a flight, the name of what is missing, the gap before and after on a flight
that was held out, and how the better model takes off in wind. The flights are simulated, by a
plant that has more drag than the vehicle says; yours come from `ut.read_flights("logs/*.ulg")`:
    python examples/five_minutes.py [FOLDER]
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import uavtwin as ut
from uavtwin.demo.flights import Waypoints, fly

ACROSS, BACK = (2.0, 1.0, -1.0), (-1.0, 2.0, -1.2)


def legs(*places: tuple[float, float, float]) -> Waypoints:
    """Take off, fly to each place in 2 s."""
    start: Waypoints = (("ground", 0.5, (0.0, 0.0, 0.0)), ("takeoff", 3.0, (0.0, 0.0, -1.0)))
    return (*start, *(("forward", 2.0, place) for place in places))


def main(folder: str | None = None) -> None:
    """From flights to a better FMU; files go to a folder, or nowhere."""
    vehicle = ut.vehicle("copter_default")
    drag = vehicle.drag_linear_n_s_m + 0.5 * vehicle.mass_kg * np.array([1.0, 1.0, 0.0])
    plant = replace(vehicle, drag_linear_n_s_m=drag)
    flight = fly(vehicle, plant, 1, "flight", legs(ACROSS, BACK))
    held = fly(vehicle, plant, 2, "held", legs(BACK, ACROSS))

    print(ut.gap(flight, vehicle))
    found = ut.explain(flight, held, vehicle, missions=("takeoff",))
    print(found)
    print(ut.simulate("takeoff", found.vehicle, wind=(5.0, 0.0, 0.0), fused=True))

    with tempfile.TemporaryDirectory() as scratch:
        out = Path(folder or scratch)
        found.report(out / "report.html")
        found.vehicle.save(out / "better.toml")
        print(ut.export(ut.twin(found.vehicle, "takeoff"), out / "twin.fmu"))


if __name__ == "__main__":
    main(*sys.argv[1:])
