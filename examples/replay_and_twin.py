"""Replay a flight beside the twin: from the measured state, both on the motor commands of the log.

You will see how far the two are apart after half a second, and what the accelerometer says of lift:
    python examples/replay_and_twin.py [LOG VEHICLE SECOND]
Without a log, a built-in flight in which an effect is hidden.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from cosim.master import Master
from cosim.system import System, connect
from fmus import build, component_model, replay_model
from twin.logs import Flight, read_flight
from twin.physics.airframe import airframe
from twin.physics.sensors.imu import imu
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly, hide

HORIZON_S = 0.5
STATE = ("pos_x", "pos_y", "pos_z", "vel_x", "vel_y", "vel_z", "q_w", "q_x", "q_y", "q_z")


def state(flight: Flight, time_s: float) -> dict[str, float]:
    """Measured position, velocity and attitude at a time."""
    t, values = flight.signal(STATE)
    return {n: float(np.interp(time_s, t, v)) for n, v in zip(STATE, values.T, strict=True)}


def main(flight: Flight, vehicle: Vehicle, start_s: float) -> None:
    """Fly that long, print three lines."""
    body, sensor = airframe(vehicle), imu(vehicle)
    commands = [n for n in body.input_names if n.startswith("cmd_")]
    log = replay_model(flight, (*commands, "acc_z"))
    models = {"log": log, "airframe": component_model(body), "imu": component_model(sensor)}
    wires = connect("log", "airframe", commands) + connect("airframe", "imu", sensor.input_names)
    starts = {f"airframe.initial.{n}": v for n, v in state(flight, start_s).items()}
    with tempfile.TemporaryDirectory() as folder:
        fmus = {n: build(m, Path(folder, f"{n}.fmu")) for n, m in models.items()}
        with Master(System(fmus, wires, starts)) as master:
            master.initialize(start_s)
            run = master.run(start_s + HORIZON_S, 1e-3, "settled")
    there = state(flight, start_s + HORIZON_S)
    miss_m = np.linalg.norm([run[f"airframe.pos_{a}"][-1] - there[f"pos_{a}"] for a in "xyz"])
    print(f"{flight.name}: after {HORIZON_S} s from {start_s:g} s the twin is {miss_m:.3f} m off")
    for name, who in (("log.acc_z", "measured"), ("imu.acc_z", "in the twin")):
        print(f"specific force, down: {run[name].mean():6.2f} m/s2 {who}")


if __name__ == "__main__":
    if len(sys.argv) == 4:
        main(read_flight(Path(sys.argv[1])), load_vehicle(sys.argv[2]), float(sys.argv[3]))
    else:
        twin = load_vehicle("copter_default")
        main(fly(twin, hide(twin, seed=1).plant, seed=1), twin, 6.0)
