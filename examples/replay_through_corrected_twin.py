"""Replay a flight through the fused FMU, in FMPy: it follows the aircraft, then flies alone.

You will see how far it is off half a second later, without what it learned meanwhile and with:
    python examples/replay_through_corrected_twin.py [LOG VEHICLE [MODEL]]
MODEL: of `uavtwin train --protocol force`. Without a log, a built-in flight with a hidden effect.
"""

import sys
import tempfile
from pathlib import Path

import fmpy
import numpy as np

import uavtwin as ut
from learning.force.windows import true_motion
from twin.frames import rotation_vector
from twin.residuals.aligned import align_flight
from twin.residuals.short_horizon import whole_windows
from twin.residuals.teacher_forced import GRID_S, RIGID, choose_drive
from uavtwin.demo.flights import fly, hide
from uavtwin.force.open_loop import driving_inputs

FOLLOW, ALONE = 1000, 500  # steps of 1 ms, again and again


def main(flight: ut.Flight, vehicle: ut.Vehicle, model: str = "") -> None:
    """Replay twice, print a line per quantity."""
    aligned = align_flight(flight, vehicle)
    starts = whole_windows(aligned, FOLLOW + ALONE)
    followed, ends = starts[:, None] + np.arange(1, FOLLOW + 1), starts + FOLLOW + ALONE
    force = ut.learned_force(model) if model else None
    twin = ut.twin(vehicle, drive=choose_drive(flight, vehicle), force=force)
    runs = []
    with tempfile.TemporaryDirectory() as folder:
        fmu = ut.export(twin, Path(folder, "twin.fmu")).paths[0]
        for learns in (False, True):
            run = fmpy.simulate_fmu(
                str(fmu),
                stop_time=GRID_S * ends[-1],
                output_interval=GRID_S,
                start_values={"airframe.disturbance.enabled": learns},
                input=driving_inputs(flight, vehicle, aligned, followed),
                output=[f"airframe.{s}" for s in RIGID],
            )
            runs.append(np.column_stack([run[f"airframe.{s}"][ends] for s in RIGID]))
    there = true_motion(vehicle, aligned)[ends]
    print(f"{flight.name}, {len(ends)} times; {ALONE} ms later, rms without and with it")
    for stem, unit in (("pos", "m"), ("vel", "m/s"), ("q", "rad"), ("omega", "rad/s")):
        at = [i for i, s in enumerate(RIGID) if s.startswith(f"{stem}_")]
        minus = rotation_vector if stem == "q" else np.subtract
        rms = [np.sqrt(np.mean(np.sum(minus(r[:, at], there[:, at]) ** 2, axis=1))) for r in runs]
        print(f"{stem:6} {rms[0]:8.4f} {rms[1]:8.4f} {unit}")


if __name__ == "__main__":
    log, name, *model = sys.argv[1:] or ("", "copter_default")
    vehicle = ut.load_vehicle(name)
    main(ut.read_flight(log) if log else fly(vehicle, hide(vehicle, 1).plant, 1), vehicle, *model)
