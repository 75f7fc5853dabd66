"""A flight as long as wanted: squares of the demonstration, again and again, nothing wrong."""

import numpy as np
import pandas as pd

from twin.logs import Flight
from twin.vehicle import Vehicle
from uavtwin.demo.in_flight import damaged_flight

_ONCE_S, _FIRST_S, _SQUARE_S = 50.0, 8.0, 14.0
"""Of the flight that is simulated; where its squares begin; how long one is, with its hover."""


def long_flight(vehicle: Vehicle, seconds: float) -> Flight:
    """Take-off, then squares; from one to the next the state jumps by what the controller leaves.

    Args:
        vehicle: That flies.
        seconds: How long, at least.
    """
    once = damaged_flight(vehicle, begins_s=_ONCE_S + 60.0, loss=0.0, seconds=_ONCE_S).table
    t = once["time"].to_numpy()
    whole = _SQUARE_S * np.floor((t[-1] - _FIRST_S) / _SQUARE_S)
    squares = once[(t >= _FIRST_S) & (t < _FIRST_S + whole - 1e-9)]
    parts = [once[t < _FIRST_S]]
    for k in range(int(np.ceil((seconds - _FIRST_S) / whole))):
        parts.append(squares.assign(time=squares["time"] + k * whole))
    return Flight("long", pd.concat(parts, ignore_index=True))
