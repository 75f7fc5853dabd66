"""A controller of your own flies the twin: motor commands in, sensors and motion out, by FMPy.

You will see how it climbs to 2 m and stays there, in 3 m/s of wind:
    python examples/own_controller.py
"""

import tempfile
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from numpy.typing import NDArray

import uavtwin as ut

STEP_S, STOP_S, HEIGHT_M, HOVER = 0.004, 8.0, 2.0, 0.609  # HOVER: command that carries it
OUTPUTS = ["pos_z", "vel_z", "q_w", "q_x", "q_y", "q_z", "omega_x", "omega_y", "omega_z"]
MIX = np.array([[1, -1, 1, 1], [1, 1, -1, 1], [1, 1, 1, -1], [1, -1, -1, -1]])
"""Thrust, roll, pitch, yaw to motors 1 to 4: front right, rear left, front left, rear right."""


def commands(motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Motor commands, 0..1: height by PD, level attitude by PD. Put your own here."""
    height, climb = -motion[0], -motion[1]
    q, rates = motion[2:6], motion[6:9]
    thrust = HOVER + 0.12 * (HEIGHT_M - height) - 0.12 * climb
    turn = -0.4 * q[0] * q[1:] - 0.04 * rates
    return np.asarray(np.clip(MIX @ np.array([np.clip(thrust, 0.2, 0.8), *turn]), 0.0, 1.0))


def main(folder: Path) -> float:
    """Export the plant, close the loop, print and return the height at the end, m."""
    plant = ut.twin(ut.vehicle("copter_default"), drive="command")
    (path,) = ut.export(plant, folder / "plant.fmu").paths
    about = fmpy.read_model_description(str(path))
    refs = {v.name: v.valueReference for v in about.modelVariables}
    inputs = [refs[f"airframe.cmd_{i}"] for i in range(1, 5)]
    outputs = [refs[f"airframe.{name}"] for name in OUTPUTS]
    where, model = fmpy.extract(str(path)), about.coSimulation.modelIdentifier
    fmu = FMU2Slave(guid=about.guid, unzipDirectory=where, modelIdentifier=model)
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.setReal([refs["environment.wind.x"]], [3.0])
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    for time_s in np.arange(0.0, STOP_S, STEP_S):
        motion = np.array(fmu.getReal(outputs))
        fmu.setReal(inputs, commands(motion).tolist())
        fmu.doStep(currentCommunicationPoint=time_s, communicationStepSize=STEP_S)
        if round(time_s / STEP_S) % 250 == 0:
            print(f"{time_s:4.1f} s  {-motion[0]:6.3f} m")
    return -float(fmu.getReal(outputs)[0])


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        print(f"height at the end: {main(Path(name)):.3f} m")
