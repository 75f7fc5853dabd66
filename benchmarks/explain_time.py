"""How long `uavtwin explain` takes: `python -m benchmarks.explain_time --out DIR`.

Four flights of 35 s at 200 Hz, one of them held out, with rotor drag that the twin lacks; the whole
library, missions, report and FMUs included.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

VEHICLE = "copter_default"
HIDDEN = {"rotor_drag": {"k_xy_1_s": 0.35, "k_z_1_s": 0.2}}
LEGS, FARTHEST_M = 8, (4.0, 4.0, 1.0)


def waypoints(seed: int) -> Waypoints:
    """A second on the ground, takeoff, and legs to places drawn by a seed."""
    places = np.random.default_rng(seed).uniform(-1, 1, (LEGS, 3)) * FARTHEST_M - (0, 0, 2)
    legs = [("tour", 4.0, (float(x), float(y), float(z))) for x, y, z in places]
    return (("ground", 1.0, (0.0, 0.0, 0.0)), ("takeoff", 2.0, (0.0, 0.0, -2.0)), *legs)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="new folder to write to")
    out = parser.parse_args().out
    if out.exists():
        parser.error(f"{out} is there already; give a new folder")
    out.mkdir(parents=True)
    vehicle = load_vehicle(VEHICLE)
    flights = [out / f"flight_{k}.parquet" for k in range(4)]
    for k, path in enumerate(flights):
        flown = fly(vehicle, vehicle.with_effects(HIDDEN), k, path.stem, waypoints(k))
        flown.table.to_parquet(path)
    *fit, held = map(str, flights)
    verb = ["explain", *fit, "--holdout", held, "--vehicle", VEHICLE, "--out", str(out / "result")]
    began = time.perf_counter()
    code = subprocess.run(
        [str(Path(sys.executable).with_name("uavtwin")), *verb], check=False
    ).returncode
    used = os.times()  # a shared machine says by the clock how busy others are
    processor_s = used.children_user + used.children_system
    print(f"{time.perf_counter() - began:.0f} s, {processor_s:.0f} s of processor time")
    return 0 if code == 1 else 1  # an effect is found


if __name__ == "__main__":
    raise SystemExit(main())
