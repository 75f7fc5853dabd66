"""The numbers of one aircraft, its sensors and its site; `file` reads and writes them."""

from .vehicle import GRAVITY_M_S2, Advance, Array, Battery, RotorAir, Rotors, RunUp, Vehicle

__all__ = ["GRAVITY_M_S2", "Advance", "Array", "Battery", "RotorAir", "Rotors", "RunUp", "Vehicle"]
