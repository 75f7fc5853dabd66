"""A foreign FMU in the loop: a gust written as a Python slave blows at the twin, once.

It takes the place of the environment's north wind. You will see how far it pushes:
    python examples/foreign_fmu.py
"""

import tempfile
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from cosim.system import Connection
from uavtwin.simulation import Scenario, run_scenario, scenario_system, summary

SLAVE = '''
from math import cos, pi
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Gust(Fmi2Slave):
    """One gust of the shape (1 - cos) / 2, 2 s long, from 6 s on."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.peak, self.wind_x = 8.0, 0.0
        self.register_variable(
            Real("peak", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
        )
        self.register_variable(Real("wind_x", causality=Fmi2Causality.output))

    def do_step(self, time, step):
        since = min(max(time + step - 6.0, 0.0), 2.0)
        self.wind_x = self.peak * (1 - cos(pi * since)) / 2
        return True
'''


def main(folder: Path) -> None:
    """Build the slave, fly with peaks of 0 and 8 m/s, print a line each."""
    from pythonfmu.builder import FmuBuilder

    (folder / "gust.py").write_text(SLAVE)
    gust = Path(FmuBuilder.build_FMU(str(folder / "gust.py"), dest=str(folder)))
    twin = scenario_system(Scenario("hover", effects=("rotor_drag",)), folder)
    twin = replace(twin, fmus={**twin.fmus, "gust": gust})
    wires = [c for c in twin.connections if c.source != "environment.wind_x"]
    wires += [Connection("gust.wind_x", f"{part}.wind_x") for part in ("airframe", "barometer")]
    system = replace(twin, connections=tuple(wires), periods={"gust": 10}, foreign=True)
    for peak in (0.0, 8.0):
        blown = replace(system, starts={**twin.starts, "gust.peak": peak})
        flight = summary(run_scenario(blown, 12.0))
        print(f"gust of {peak:g} m/s: {flight['tracking_worst_m']:.3f} m off at worst")


if __name__ == "__main__":
    if find_spec("pythonfmu") is None:
        print("skipped: needs pythonfmu, pip install pythonfmu")
    else:
        with tempfile.TemporaryDirectory() as name:
            main(Path(name))
