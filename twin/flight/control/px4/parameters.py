"""PX4's multicopter parameters: names, defaults, units, and the way from a log.

PX4 keeps angles in degrees; here they are rad. `from_px4` is the only place that converts.

Source: PX4 v1.12, parameter reference.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyulog import ULog

from ....errors import LogError


@dataclass(frozen=True, slots=True)
class Px4Parameter:
    """One parameter of PX4.

    Attributes:
        default: PX4's own, in PX4's unit.
        unit: SI unit of its value here.
        meaning: One line.
        degrees: PX4's unit has degrees where this one has radians.
        positive: Zero and below make no sense.
    """

    default: float
    unit: str
    meaning: str
    degrees: bool = False
    positive: bool = False


def _rates() -> dict[str, Px4Parameter]:
    table: dict[str, Px4Parameter] = {}
    for axis, p, i, d, most in (
        ("ROLL", 0.15, 0.2, 0.003, 220.0),
        ("PITCH", 0.15, 0.2, 0.003, 220.0),
        ("YAW", 0.2, 0.1, 0.0, 200.0),
    ):
        name = axis.lower()
        table |= {
            f"MC_{axis}RATE_P": Px4Parameter(p, "s", f"Rate of {name}, proportional"),
            f"MC_{axis}RATE_I": Px4Parameter(i, "1", f"Rate of {name}, integral"),
            f"MC_{axis}RATE_D": Px4Parameter(d, "s2", f"Rate of {name}, derivative"),
            f"MC_{axis}RATE_FF": Px4Parameter(0.0, "s", f"Rate of {name}, feed-forward"),
            f"MC_{axis}RATE_K": Px4Parameter(1.0, "1", f"Rate of {name}, common factor"),
            f"MC_{axis}RATE_MAX": Px4Parameter(
                most, "rad/s", f"Largest rate of {name} (deg/s in PX4)", degrees=True
            ),
            f"MC_{axis[0]}R_INT_LIM": Px4Parameter(0.3, "1", f"Largest integral of {name}"),
        }
    return table


PARAMETERS: dict[str, Px4Parameter] = {
    "MPC_XY_P": Px4Parameter(0.95, "1/s", "Horizontal position, proportional"),
    "MPC_Z_P": Px4Parameter(1.0, "1/s", "Vertical position, proportional"),
    "MPC_XY_VEL_P_ACC": Px4Parameter(
        1.8, "1/s", "Horizontal velocity, proportional", positive=True
    ),
    "MPC_XY_VEL_I_ACC": Px4Parameter(0.4, "1/s2", "Horizontal velocity, integral"),
    "MPC_XY_VEL_D_ACC": Px4Parameter(0.2, "1", "Horizontal velocity, derivative"),
    "MPC_Z_VEL_P_ACC": Px4Parameter(4.0, "1/s", "Vertical velocity, proportional"),
    "MPC_Z_VEL_I_ACC": Px4Parameter(2.0, "1/s2", "Vertical velocity, integral"),
    "MPC_Z_VEL_D_ACC": Px4Parameter(0.0, "1", "Vertical velocity, derivative"),
    "MPC_VELD_LP": Px4Parameter(5.0, "Hz", "Low-pass of the derivative of velocity", positive=True),
    "MPC_XY_VEL_MAX": Px4Parameter(12.0, "m/s", "Largest horizontal velocity"),
    "MPC_Z_VEL_MAX_UP": Px4Parameter(3.0, "m/s", "Largest climb rate"),
    "MPC_Z_VEL_MAX_DN": Px4Parameter(1.0, "m/s", "Largest sink rate"),
    "MPC_TILTMAX_AIR": Px4Parameter(45.0, "rad", "Largest tilt (deg in PX4)", degrees=True),
    "MPC_THR_HOVER": Px4Parameter(0.5, "1", "Thrust in hover", positive=True),
    "MPC_THR_MIN": Px4Parameter(0.12, "1", "Smallest thrust", positive=True),
    "MPC_THR_MAX": Px4Parameter(1.0, "1", "Largest thrust", positive=True),
    "MC_ROLL_P": Px4Parameter(6.5, "1/s", "Roll, proportional"),
    "MC_PITCH_P": Px4Parameter(6.5, "1/s", "Pitch, proportional"),
    "MC_YAW_P": Px4Parameter(2.8, "1/s", "Yaw, proportional"),
    "MC_YAW_WEIGHT": Px4Parameter(0.4, "1", "Weight of yaw against tilt", positive=True),
    **_rates(),
    "IMU_GYRO_CUTOFF": Px4Parameter(30.0, "Hz", "Low-pass of the gyroscope", positive=True),
    "IMU_DGYRO_CUTOFF": Px4Parameter(
        30.0, "Hz", "Low-pass of the angular acceleration", positive=True
    ),
    "THR_MDL_FAC": Px4Parameter(0.0, "1", "Curvature of thrust over command, 0 linear"),
}


def from_px4(values: Mapping[str, float]) -> dict[str, float]:
    """Parameters in PX4's units -> those of the controller, in SI; others are left out."""
    return {
        name: float(np.radians(value)) if PARAMETERS[name].degrees else float(value)
        for name, value in values.items()
        if name in PARAMETERS
    }


def log_parameters(path: Path) -> dict[str, float]:
    """Parameters with which a PX4 log was started, in PX4's units.

    Raises:
        LogError: The log holds no parameters.
    """
    with path.open("rb") as file:
        values = ULog(file, ["none"]).initial_parameters
    if not any(name in PARAMETERS for name in values):
        raise LogError(f"{path.name}: no multicopter parameters in the log; was it cut short?")
    return {name: float(value) for name, value in values.items()}
