"""The numbers of one aircraft, its sensors and its site; `file` reads and writes them."""

from .calibration import Calibration
from .deviation import Deviation, Known, relative_deviation
from .vehicle import GRAVITY_M_S2, Advance, Array, Battery, RotorAir, Rotors, RunUp, Vehicle

__all__ = [
    "GRAVITY_M_S2",
    "Advance",
    "Array",
    "Battery",
    "Calibration",
    "Deviation",
    "Known",
    "RotorAir",
    "Rotors",
    "RunUp",
    "Vehicle",
    "relative_deviation",
]
