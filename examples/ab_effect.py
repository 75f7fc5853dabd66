"""Switch an effect on by one parameter of the FMU: rotor drag, in hover against 5 m/s of wind.

The whole twin is one FMU, built once, run twice. You will see how far it has to lean:
    python examples/ab_effect.py [SECONDS]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from cosim.master import Master
from uavtwin.simulation import Scenario, scenario_system

LEAN = "twin.airframe.q_y"


def main(stop_s: float = 15.0) -> None:
    """Fly without and with rotor drag, print a line each."""
    scenario = Scenario("hover", wind_m_s=(5.0, 0.0, 0.0), fused=True)
    with tempfile.TemporaryDirectory() as folder:
        system = scenario_system(scenario, Path(folder))
        with Master(system, record=[LEAN, "twin.airframe.pos_x"]) as master:
            for enabled in (False, True):
                master.initialize(starts={"twin.airframe.rotor_drag.enabled": enabled})
                recording = master.run(stop_s, step_s=0.01)
                lean_deg = 2 * np.degrees(np.arcsin(recording[LEAN][-1]))
                off_m = np.abs(recording["twin.airframe.pos_x"]).max()
                print(
                    f"rotor_drag.enabled = {enabled!s:5}: nose {lean_deg:z.2f} degrees up, "
                    f"blown off by {off_m:.3f} m at most"
                )


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
