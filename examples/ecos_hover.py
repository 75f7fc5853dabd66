"""The twin in ecos, a co-simulation engine of others: from its .ssp, no file of ours.

It hovers, as heavy as it is and a tenth heavier. You will see what its motors are asked for:
    python examples/ecos_hover.py
"""

import tempfile
from importlib.util import find_spec
from pathlib import Path

import uavtwin as ut

STEP_S = 0.001


def main(folder: Path) -> None:
    """Export with two masses, fly ten seconds each, print a line each."""
    from ecospy import EcosSimulation

    vehicle = ut.vehicle("crazyflie")
    for share in (1.0, 1.1):
        system = folder / f"twin_{share:g}.ssp"
        starts = {"airframe.mass": share * vehicle.mass_kg}
        ut.export(ut.twin(vehicle), system, starts=starts)
        with EcosSimulation(STEP_S, ssp_path=str(system)) as simulation:
            simulation.init(parameter_set="initialValues")
            simulation.step(round(10 / STEP_S))
            height_m = -simulation.get_real("airframe::pos_z")
            command = simulation.get_real("controller::cmd_1")
        print(f"{share:.0%} of its mass: motor command {command:.3f} at {height_m:.2f} m")


if __name__ == "__main__":
    if find_spec("ecospy") is None:
        print("skipped: needs ecospy, pip install ecospy, and libtbb12 of the system")
    else:
        with tempfile.TemporaryDirectory() as name:
            main(Path(name))
