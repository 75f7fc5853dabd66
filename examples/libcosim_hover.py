"""The twin in libcosim, the engine of the Open Simulation Platform: from its .ssp, no file of ours.

It hovers, without wind and with one from the north. You will see how far its nose goes down:
    python examples/libcosim_hover.py
"""

import tempfile
from importlib.util import find_spec
from math import asin, degrees
from pathlib import Path

import uavtwin as ut


def main(folder: Path) -> None:
    """Export, fly ten seconds in still air and in wind, print a line each."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.ERROR)
    twin, system = ut.twin(ut.vehicle("crazyflie")), folder / "twin.ssp"
    ut.export(twin, system, starts={"airframe.rotor_drag.enabled": 1.0})
    for wind_m_s in (0.0, 3.0):
        execution = CosimExecution.from_ssp_file(str(system))
        observer = CosimObserver.create_last_value()
        execution.add_observer(observer)
        parts = "environment", "airframe"
        index = {name: execution.slave_index_from_instance_name(name) for name in parts}
        reference = {
            f"{slave}.{v.name.decode()}": v.reference
            for slave, number in index.items()
            for v in execution.slave_variables(number)
        }
        north = reference["environment.wind.x"]  # where to the air moves
        execution.real_initial_value(index["environment"], north, -wind_m_s)
        execution.simulate_until(10_000_000_000)  # ns
        (q_y,) = observer.last_real_values(index["airframe"], [reference["airframe.q_y"]])
        print(f"wind of {wind_m_s:g} m/s: nose {-degrees(2 * asin(q_y)):.1f} degrees down")


if __name__ == "__main__":
    if find_spec("libcosimpy") is None:
        print("skipped: needs libcosimpy, pip install libcosimpy")
    else:
        with tempfile.TemporaryDirectory() as name:
            main(Path(name))
