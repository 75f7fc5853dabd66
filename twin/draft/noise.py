"""Noise of the sensors by their own readings."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..logs import Flight
from ..logs.columns import ACC, GYRO, MAG
from .hover import Hover, common_samples, drives, phases_at

Array = NDArray[np.float64]
Choice = Callable[[Flight, Array], NDArray[np.bool_]]

SENSORS = {
    "imu.accel_noise": (ACC, "m/s^2"),
    "imu.gyro_noise": (GYRO, "rad/s"),
    "magnetometer.noise": (MAG, "T"),
    "barometer.noise": (("baro_pa",), "Pa"),
}
"""Columns of each sensor by the key of its noise, and the unit."""
_LEAST = 20
_IDLE = 0.02
_APART = 2.5


@dataclass(frozen=True, slots=True)
class Noise:
    """White noise of a reading.

    Attributes:
        sd: Standard deviation, in the unit of the signal.
        samples: From how many.
        where: Which part of the flights.
    """

    sd: float
    samples: int
    where: str


def noise_of(flights: Sequence[Flight], hovers: Sequence[Hover], columns: Sequence[str]) -> Noise:
    """White noise of a sensor: at rest with the motors idle, else in hover with what shakes it.

    Second differences of neighbouring samples: sqrt(6) times white noise, and next to nothing of
    what moves slowly. Median over the samples, mean over the axes.

    Returns:
        `samples` 0 where no flight has enough of them.
    """
    rest = [_second(f, columns, _resting) for f in flights]
    air = [_second(f, columns, _within(h)) for f, h in zip(flights, hovers, strict=True)]
    for found, where in ((rest, "at rest"), (air, "in hover, vibration included")):
        values = np.concatenate(found)
        if len(values) >= _LEAST:
            sd = np.median(np.abs(values), axis=0) / 0.6745 / np.sqrt(6.0)
            if not np.all(sd > 0):  # more than half of the steps are none
                sd = values.std(axis=0) / np.sqrt(6.0)
            return Noise(float(sd.mean()), len(values), where)
    return Noise(0.0, 0, "")


def _second(flight: Flight, columns: Sequence[str], chosen: Choice) -> Array:
    found = common_samples(flight, columns)
    if found is None or len(found[0]) < 3:
        return np.zeros((0, len(columns)))
    t_s, values = found
    step = np.diff(t_s)
    near = step < _APART * np.median(step)
    good = chosen(flight, t_s)[1:-1] & near[1:] & near[:-1]
    return np.diff(values, 2, axis=0)[good]


def _resting(flight: Flight, t_s: Array) -> NDArray[np.bool_]:
    """On the ground, or before any motor turns, and told nothing."""
    ground = np.isin(phases_at(flight, t_s), ("ground", ""))
    columns = drives(flight)
    if not columns:
        return ground
    t, drive = flight.signal(columns)
    scale = 1.0 if columns[0].startswith("cmd") else float(drive.max())
    row = np.clip(np.searchsorted(t, t_s, side="right") - 1, 0, len(t) - 1)
    return np.asarray(ground & (drive.max(axis=1)[row] <= _IDLE * scale) & (t_s >= t[0]))


def _within(hover: Hover) -> Choice:
    def chosen(_: Flight, t_s: Array) -> NDArray[np.bool_]:
        row = np.clip(np.searchsorted(hover.t_s, t_s), 0, len(hover.t_s) - 1)
        return np.asarray(np.abs(hover.t_s[row] - t_s) < 0.1)

    return chosen
