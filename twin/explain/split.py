"""A flight as its own hold-out: blocks of time in which the search does not see the sensors."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..logs import Flight
from ..logs.columns import ACC_NED, POS, QUAT, VEL
from ..physics.sensors.table import SENSORS
from .model.flight import missing_imu_signals
from .settings import DEFAULT, HoldoutSettings

READINGS = tuple(c for s in SENSORS for c in s.columns)
"""What is hidden. Pose and commands stay: they are inputs of the twin."""
POSE = (*POS, *VEL, *QUAT, *ACC_NED)
"""What is hidden as well where it stands in for a sensor."""
Span = tuple[float, float]


def held_out_spans(flight: Flight, settings: HoldoutSettings = DEFAULT.holdout) -> list[Span]:
    """One block of time in so many, the second one first."""
    time = flight.table["time"].to_numpy(dtype=np.float64)
    first, last = float(time[0]), float(time[-1])
    block_s = settings.spared_s
    starts = np.arange(first + block_s, last, settings.spared_every * block_s)
    return [(float(s), min(float(s) + block_s, last)) for s in starts]


def hidden(flight: Flight, spans: Sequence[Span], inside: bool) -> Flight:
    """The flight without the sensor readings inside some spans of time, or outside all of them.

    Where it lacks a sensor of the IMU, for which its pose is compared, that is hidden too.
    """
    time = flight.table["time"].to_numpy(dtype=np.float64)
    within = np.zeros(len(time), dtype=np.bool_)
    for start, end in spans:
        within |= (time >= start) & (time < end)
    table = flight.table.copy()
    compared = READINGS + POSE if missing_imu_signals([flight]) else READINGS
    readings = [c for c in compared if c in table]
    table.loc[within == inside, readings] = np.nan
    return replace(flight, table=table)
