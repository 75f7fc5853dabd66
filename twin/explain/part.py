"""The part of a long flight that a search reads: where it moves most.

Time and memory of a search grow with the flight, what it learns hardly: a manoeuvre that is flown
again tells little more. A part in one piece, as cells discharge and motors warm from where it
begins.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..logs import AnyFlight, Flight
from ..logs.columns import QUAT, VEL, motor_columns
from .settings import DEFAULT, UsableSettings

Array = NDArray[np.float64]
READ = "{}: {:.0f} to {:.0f} s of {:.0f} s are read, where it moves most; cut the log for others"


def part_read(
    flight: AnyFlight, settings: UsableSettings = DEFAULT.usable
) -> tuple[Flight, str | None]:
    """The flight as far as it is read, and which part that is; None: it is read whole."""
    time = flight.time_s
    whole_s = float(time[-1] - time[0]) if len(time) else 0.0
    if whole_s <= settings.longest_s:
        return flight if isinstance(flight, Flight) else flight.between(-np.inf, np.inf), None
    edges = np.arange(time[0], time[-1], settings.block_s)
    moves = np.sum([*_movement(flight, edges)], axis=0)  # (blocks,)
    length = round(settings.longest_s / settings.block_s)
    together = np.convolve(moves, np.ones(length), mode="valid")
    start = float(edges[int(np.argmax(together))])
    end = min(start + settings.longest_s, float(time[-1]))
    return flight.between(start, end), READ.format(flight.name, start, end, whole_s)


def _movement(flight: AnyFlight, edges: Array) -> Iterator[Array]:
    """How much each signal changes within each block of time, its mean over the blocks 1."""
    yield np.zeros(len(edges))
    rotors = sum(c.startswith("cmd_") for c in flight.columns)
    for columns in (VEL, QUAT, motor_columns("cmd", rotors)):
        if not columns or not flight.has(*columns):
            continue
        t_s, values = flight.signal(columns)
        block = np.searchsorted(edges, t_s, side="right") - 1
        count = np.maximum(np.bincount(block, minlength=len(edges)), 1)
        spread = np.zeros(len(edges))
        for column in values.T:
            mean = np.bincount(block, column, len(edges)) / count
            spread += np.bincount(block, (column - mean[block]) ** 2, len(edges)) / count
        if spread.any():
            yield spread / spread.mean()
