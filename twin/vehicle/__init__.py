"""Numbers of one aircraft, its sensors and its site; `twin.vehicle_file` reads and writes them."""

from .vehicle import (
    GRAVITY_M_S2,
    Advance,
    Array,
    Battery,
    Calibration,
    Deviation,
    Known,
    RotorAir,
    Rotors,
    RunUp,
    Vehicle,
    relative_deviation,
)

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
