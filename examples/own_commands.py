"""Motor commands of your own fly the twin for ten seconds, by FMPy and numpy alone.

You will see it climb on equal commands, and turn when motors of one sense get more. FMPy warns of
inputs that stay open; they may:
    uavtwin export corrected-twin --drive commands --out plant
    python examples/own_commands.py plant/corrected_twin.fmu
"""

import sys
import tempfile
from pathlib import Path

import fmpy
import numpy as np

STOP_S, STEP_S = 10.0, 0.01
HOVER, MORE = 0.609, 0.005  # the command that carries copter_default, and a little beyond it
MOTORS = [f"airframe.cmd_{i}" for i in range(1, 5)]  # here 1 and 2 have one sense


def main(fmu: Path) -> None:
    """Fly, print a line each two seconds."""
    time_s = np.arange(0.0, STOP_S + STEP_S, STEP_S)
    given = np.zeros(len(time_s), [("time", float), *((motor, float) for motor in MOTORS)])
    given["time"] = time_s
    for k, motor in enumerate(MOTORS):  # put your own series here, 0 to 1
        given[motor] = HOVER + MORE + np.where((time_s > 5.0) & (k < 2), MORE, 0.0)
    flight = fmpy.simulate_fmu(
        str(fmu),
        stop_time=STOP_S,
        output_interval=STEP_S,
        input=given,
        output=["airframe.pos_z", "airframe.omega_z", "imu.acc_z"],
    )
    for row in flight[::200]:
        height_m, turn_deg_s = -row["airframe.pos_z"], np.degrees(row["airframe.omega_z"])
        print(f"{row['time']:4.1f} s  {height_m:6.3f} m  {turn_deg_s:5.1f} degrees a second")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        import uavtwin as ut

        with tempfile.TemporaryDirectory() as name:
            plant = ut.twin(ut.vehicle("copter_default"), drive="command")
            main(ut.export(plant, Path(name) / "plant.fmu").paths[0])
