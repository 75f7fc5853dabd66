"""The way from rest to rest with the least jerk.

Source: Flash & Hogan, J. Neuroscience 5 (1985): 10 s^3 - 15 s^4 + 6 s^5.
"""

from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", ca.SX, NDArray[np.float64])
"""Arrays of any shape, or a symbol."""
FASTEST = 15 / 8
"""Largest speed of a way of length 1 in time 1."""
HARDEST = 10 / np.sqrt(3)
"""Largest acceleration of the same."""


def minimum_jerk(s: Number) -> Number:
    """Share of the way, 0..1, after a share of the time; at rest at both ends."""
    return s**3 * (10 + s * (-15 + 6 * s))


def minimum_jerk_speed(s: Number) -> Number:
    """Derivative of `minimum_jerk` by the share of the time."""
    return 30 * s**2 - 60 * s**3 + 30 * s**4


def minimum_jerk_acceleration(s: Number) -> Number:
    """Second derivative of `minimum_jerk` by the share of the time."""
    return 60 * s - 180 * s**2 + 120 * s**3


def ramped_way(t: Number, total: float | ca.SX, rate: float | ca.SX, ramp: float | ca.SX) -> Number:
    """Way covered when its rate rises, holds and falls by minimum-jerk ramps.

    Args:
        t: Time from the start; it takes `total / rate + ramp` in all.
        total: Whole way.
        rate: Held between the ramps.
        ramp: Time of each ramp.
    """
    way: Number = rate * ramp * (_covered(t / ramp) - _covered((t - total / rate) / ramp))
    return way


def _covered(s: Number) -> Any:
    """Integral from -infinity to s of `minimum_jerk`, held at 0 before and at 1 after the ramp."""
    of: Any = ca if isinstance(s, ca.SX) else np
    inside = of.fmin(of.fmax(s, 0.0), 1.0)
    return inside**4 * (2.5 + inside * (-3 + inside)) + of.fmax(s - 1, 0.0)
