"""A flight as its own hold-out: blocks of time in which the search does not see the sensors."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..logs import Flight
from ..physics.sensors.table import SENSORS

READINGS = tuple(c for s in SENSORS for c in s.columns)
"""What is hidden. Pose and commands stay: they are inputs of the twin."""
BLOCK_S = 4.0
EVERY = 3
"""One block in so many is held out."""
Span = tuple[float, float]


def held_out_spans(flight: Flight) -> list[Span]:
    """Every third block of time, the second one first."""
    time = flight.table["time"].to_numpy(dtype=np.float64)
    first, last = float(time[0]), float(time[-1])
    starts = np.arange(first + BLOCK_S, last, EVERY * BLOCK_S)
    return [(float(s), min(float(s) + BLOCK_S, last)) for s in starts]


def hidden(flight: Flight, spans: Sequence[Span], inside: bool) -> Flight:
    """The flight without the sensor readings inside some spans of time, or outside all of them."""
    time = flight.table["time"].to_numpy(dtype=np.float64)
    within = np.zeros(len(time), dtype=np.bool_)
    for start, end in spans:
        within |= (time >= start) & (time < end)
    table = flight.table.copy()
    readings = [c for c in READINGS if c in table]
    table.loc[within == inside, readings] = np.nan
    return replace(flight, table=table)
