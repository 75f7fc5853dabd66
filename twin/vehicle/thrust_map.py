"""The thrust map of a vehicle's rotors: its value, and where it carries the weight."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .vehicle import Vehicle


def polynomial(coefficients: Sequence[Any], argument: Any) -> Any:
    """Value of a polynomial with ascending coefficients (Horner)."""
    value = coefficients[-1]
    for c in coefficients[-2::-1]:
        value = c + argument * value
    return value


def hover_level(vehicle: Vehicle) -> float:
    """Argument of the thrust map, rad/s or command, at which equal rotors carry the weight.

    Nearly so: the next value of a grid of 2001. The end of the grid where none carries it.
    """
    rotors, high = vehicle.rotors, 1.0
    if rotors.from_speed:
        high = 10.0
        while polynomial(rotors.thrust_n, high) < vehicle.hover_thrust_n and high < 1e6:
            high *= 2
    return first_reaching(rotors.thrust_n, vehicle.hover_thrust_n, high)


def first_reaching(coefficients: Sequence[float], value: float, high: float) -> float:
    """First argument from 0 to `high`, on a grid of 2001, where a polynomial reaches a value."""
    grid = np.linspace(0.0, high, 2001)
    reached = np.polynomial.polynomial.polyval(grid, coefficients) >= value
    return float(grid[int(np.argmax(reached))] if reached.any() else high)


def most_thrust_n(vehicle: Vehicle) -> float:
    """Largest thrust of one rotor that a command gives, N; on a grid of 201."""
    rotors, command = vehicle.rotors, np.linspace(0.0, 1.0, 201)
    level = polynomial(rotors.speed_rad_s, command) if rotors.speed_rad_s else command
    return float(np.max(polynomial(rotors.thrust_n, level)))
