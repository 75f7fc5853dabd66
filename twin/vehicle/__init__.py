"""The numbers of one aircraft, its sensors and its site; `file` reads and writes them."""

from .vehicle import GRAVITY_M_S2, Array, Battery, Rotors, Vehicle

__all__ = ["GRAVITY_M_S2", "Array", "Battery", "Rotors", "Vehicle"]
