"""Replay a flight through the fused FMU, in FMPy: again and again it is set to the measured motion.

You will see how far the twin is off half a second after each of these restarts:
    python examples/replay_through_corrected_twin.py [LOG VEHICLE]
Without a log, a built-in flight in which an effect is hidden.
"""

import sys
import tempfile
from pathlib import Path

import fmpy
import numpy as np

import uavtwin as ut
from twin.frames import rotation_vector
from twin.residuals.aligned import align_flight
from twin.residuals.short_horizon import whole_windows
from twin.residuals.teacher_forced import GRID_S, RIGID, choose_drive
from uavtwin.demo.flights import fly, hide
from uavtwin.driving import driving_inputs

ALONE = 500
"""Steps of 1 ms between a restart and the moment at which the twin is looked at."""


def main(flight: ut.Flight, vehicle: ut.Vehicle) -> None:
    """Replay, print a line per quantity."""
    aligned = align_flight(flight, vehicle)
    restarts = whole_windows(aligned, ALONE + 1)
    ends, given = restarts + ALONE, driving_inputs(aligned, restarts)
    twin = ut.twin(vehicle, drive=choose_drive(flight, vehicle))
    with tempfile.TemporaryDirectory() as folder:
        run = fmpy.simulate_fmu(
            str(ut.export(twin, Path(folder, "twin.fmu")).paths[0]),
            stop_time=given["time"][-1],
            output_interval=GRID_S,
            input=given,
            output=[f"airframe.{s}" for s in RIGID],
        )
    names = [s.name for s in aligned.airframe.states]
    print(f"{flight.name}: {len(ends)} restarts; {ALONE} ms later, root mean square")
    for stem, unit in (("pos", "m"), ("vel", "m/s"), ("q", "rad"), ("omega", "rad/s")):
        parts = [s for s in RIGID if s.startswith(f"{stem}_")]
        there = aligned.states[ends][:, [names.index(s) for s in parts]]
        here = np.column_stack([run[f"airframe.{s}"][ends] for s in parts])
        off = rotation_vector(here, there) if stem == "q" else here - there
        print(f"{stem:6} {np.sqrt(np.mean(np.sum(off**2, axis=1))):8.4f} {unit}")


if __name__ == "__main__":
    if len(sys.argv) == 3:
        main(ut.read_flight(sys.argv[1]), ut.load_vehicle(sys.argv[2]))
    else:
        copter = ut.vehicle("copter_default")
        main(fly(copter, hide(copter, seed=1).plant, seed=1), copter)
