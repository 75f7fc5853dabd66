"""Step an airframe FMU and an IMU FMU together and A/B one parameter.

Prints how far a gust-free 5 m/s wind carries a quadrotor in two seconds of hover trim, without and
with rotor drag: the same FMU twice, one start value changed.
"""

import tempfile
from pathlib import Path

from cosim.master import Master
from cosim.system import System, connect
from fmus import build, component_model
from twin.airframe import airframe
from twin.imu import imu
from twin.vehicle_file import load_vehicle


def main() -> None:
    """Build two FMUs, run the system twice, print the drift."""
    vehicle = load_vehicle("copter_default")
    sensor = imu(vehicle)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fmus = {
            "airframe": build(component_model(airframe(vehicle)), folder / "airframe.fmu"),
            "imu": build(component_model(sensor), folder / "imu.fmu", fmi=3),
        }
        system = System(fmus, connect("airframe", "imu", sensor.input_names))
        with Master(system) as master:
            for drag in (0.0, 0.6):
                starts = {"airframe.wind_x": 5.0, "airframe.drag.linear_x": drag}
                master.initialize(starts=starts)
                recording = master.run(2.0, 1e-3, "settled")
                drift, reading = recording["airframe.pos_x"][-1], recording["imu.acc_x"][-1]
                print(f"drag {drag:.1f} N s/m: drift {drift:.3f} m, acc_x {reading:.3f} m/s2")


if __name__ == "__main__":
    main()
