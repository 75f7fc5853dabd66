"""Thrust of a rotor from blade elements and momentum.

With the inflow x and climb c in units of the induced velocity of hover at the same rotor speed,
and h the speed along the disc in the same unit:

    blade element   T / T_hover = 1 + gain (1 - x),     gain = solidity lift_slope / (8 lambda)
    momentum        (x - c) sqrt(h^2 + x^2) = T / T_hover

Source: Leishman, Principles of Helicopter Aerodynamics, 2nd ed., eq. 3.22 (blade element at
constant pitch, uniform inflow) and 2.126 (Glauert's momentum theory at any advance ratio).
"""

import numpy as np

from .parameters import AIR_DENSITY_KG_M3, Array

_NEWTON_STEPS = 6


def induced_velocity(thrust: Array, radius: Array | float) -> Array:
    """Induced velocity in hover, m/s. Source: Leishman, eq. 2.14."""
    return np.asarray(np.sqrt(thrust / (2 * AIR_DENSITY_KG_M3 * np.pi * radius**2)))


def thrust_ratio(gain: Array | float, climb: Array, along: Array) -> Array:
    """Thrust over that in hover at the same rotor speed.

    Args:
        gain: Relative change of thrust per relative change of inflow.
        climb: Speed of the rotor along its thrust over the induced velocity in hover.
        along: Speed along the disc over the same.

    Valid for: climb > -1; slower than the vortex ring.
    """
    x = np.maximum(1 + climb / (2 + gain), 0.2)
    for _ in range(_NEWTON_STEPS):
        root = np.sqrt(along * along + x * x)
        value = (x - climb) * root - 1 - gain * (1 - x)
        slope = root + (x - climb) * x / root + gain
        x = np.maximum(x - value / slope, 0.05)
    return np.asarray(1 + gain * (1 - x))


def climb_slope(gain: float, hover_velocity: float) -> float:
    """Share of the thrust lost per climb speed about hover, s/m: the derivative of the above."""
    return gain / ((2 + gain) * hover_velocity)
