"""Model exchange: CVode integrates the airframe, in place of the steps inside its FMU.

You will see how far apart the two ways are after two seconds, by the tolerance of CVode:
    python examples/integrate_outside.py
"""

import tempfile
from pathlib import Path

import fmpy

import uavtwin as ut

OUTPUTS = ["pos_x", "pos_y", "pos_z"]
STOP_S = 2.0


def main(folder: Path) -> None:
    """Export, fly each way from the same push, print a line per tolerance."""
    airframe = ut.component("airframe", ut.vehicle("crazyflie"))
    (path,) = ut.export(airframe, folder / "airframe.fmu").paths

    def flown(kind: str, tolerance: float | None = None) -> list[float]:
        """Where it is at the end, NED, m."""
        result = fmpy.simulate_fmu(
            str(path),
            fmi_type=kind,
            stop_time=STOP_S,
            output_interval=0.01,
            relative_tolerance=tolerance,
            start_values={"initial.omega_x": 0.2, "initial.omega_z": 0.5, "wind_y": 1.0},
            output=OUTPUTS,
        )
        return [float(result[name][-1]) for name in OUTPUTS]

    inside = flown("CoSimulation")
    for tolerance in (1e-5, 1e-8, 1e-10):
        outside = flown("ModelExchange", tolerance)
        apart = max(abs(a - b) for a, b in zip(inside, outside, strict=True))
        print(f"relative tolerance {tolerance:g}: {apart:.1e} m apart")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        main(Path(name))
