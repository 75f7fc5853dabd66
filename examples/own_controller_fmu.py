"""A controller that is an FMU of your own flies the parts of the twin, connected by a script.

It takes the place of `controller`; here it is a Python slave, yours may be any FMU with such inputs
and outputs. You will see how it climbs to the setpoint of the mission (pip install pythonfmu):
    python examples/own_controller_fmu.py
"""

import tempfile
from dataclasses import replace
from pathlib import Path

from pythonfmu.builder import FmuBuilder

from cosim.master import Master
from uavtwin.simulation import Scenario, scenario_system

INPUTS = [*("setpoint_pos_z", "pos_z", "vel_z", "q_x", "q_y"), *(f"omega_{a}" for a in "xyz")]
SLAVE = f"""
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

class Own(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for name in {INPUTS}:
            setattr(self, name, 0.0)
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in ["cmd_1", "cmd_2", "cmd_3", "cmd_4"]:
            setattr(self, name, 0.0)
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, time, step):
        lift = min(max(0.609 + 0.12 * (self.pos_z - self.setpoint_pos_z + self.vel_z), 0.2), 0.8)
        x, y = -0.4 * self.q_x - 0.04 * self.omega_x, -0.4 * self.q_y - 0.04 * self.omega_y
        z = -0.04 * self.omega_z
        for k, turn in zip("1234", (-x + y + z, x - y + z, x + y - z, -x - y - z)):
            setattr(self, "cmd_" + k, min(max(lift + turn, 0.0), 1.0))
        return True
"""


def main(folder: Path) -> None:
    """Build the slave, connect the parts, fly, print a line each second."""
    (folder / "own.py").write_text(SLAVE)
    own = Path(FmuBuilder.build_FMU(str(folder / "own.py"), dest=str(folder)))
    parts = scenario_system(Scenario("hover"), folder)  # connected by `controller.pos_z` and so on
    known, every = {f"controller.{name}" for name in INPUTS}, parts.connections
    wires = tuple(c for c in every if c.target in known or not c.target.startswith("controller."))
    system = replace(parts, fmus={**parts.fmus, "controller": own}, connections=wires, foreign=True)
    with Master(replace(system, periods={"controller": 4}), ["airframe.pos_z"]) as master:
        master.initialize()
        flight = master.run(8.0, 1e-3, every=1000)
    for time_s, down_m in zip(flight.time_s, flight["airframe.pos_z"], strict=True):
        print(f"{time_s:4.1f} s  {-down_m:.3f} m")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        main(Path(name))
