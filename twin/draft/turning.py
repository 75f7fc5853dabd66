"""Whether a flight turned as rotors of some layout turn it: a check of order and sense."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from ..logs import Flight
from ..logs.columns import GYRO
from ..vehicle.layouts import Layout, frame, frames_of
from .hover import common_samples, drives, flown

Array = NDArray[np.float64]

AXES = ("roll", "pitch", "yaw")
CLEAR = 0.3
"""Correlation from which on a flight says how its rotors turn it."""
_GRID_S = 0.01
_BAND_HZ = (0.5, 8.0)
_LAG_S = 0.03
_LEAST_S = 3.0


@dataclass(frozen=True, slots=True)
class Turning:
    """How a flight agrees with a layout.

    Attributes:
        roll: Correlation of angular acceleration with the moment of the rotors, about x.
        pitch: About y.
        yaw: About z.
    """

    roll: float
    pitch: float
    yaw: float

    @property
    def worst(self) -> float:
        """Of roll and pitch."""
        return min(self.roll, self.pitch)

    def __str__(self) -> str:
        return f"roll {self.roll:+.2f}, pitch {self.pitch:+.2f}, yaw {self.yaw:+.2f}"


def turning(flight: Flight, layout: Layout) -> Turning | None:
    """Angular acceleration against the moments that the commands make, 0.5 to 8 Hz, in the air.

    Returns:
        None: no body rates, another number of motors, or too short.
    """
    columns = drives(flight)
    driven, rotated = common_samples(flight, columns), common_samples(flight, GYRO)
    if len(columns) != layout.count or driven is None or rotated is None:
        return None
    (t_s, commands), (t_gyro, rates) = driven, rotated
    air = flown(flight)
    grid = np.arange(max(t_s[0], t_gyro[0]), min(t_s[-1], t_gyro[-1]), _GRID_S)
    if len(grid) < _LEAST_S / _GRID_S:
        return None
    thrust = np.column_stack(
        [np.interp(grid - _LAG_S, t_s, commands[:, k]) for k in range(layout.count)]
    )
    x, y = layout.position[:, 0], layout.position[:, 1]
    moments = thrust @ np.column_stack([-y, x, -layout.direction])
    turned = np.column_stack([np.interp(grid, t_gyro, rates[:, k]) for k in range(3)])
    band = butter(2, np.array(_BAND_HZ) * 2.0 * _GRID_S, "bandpass", output="sos")
    inside = np.interp(grid, t_s, air.astype(np.float64)) > 0.5
    if inside.sum() < _LEAST_S / _GRID_S:
        return None
    pushed = sosfiltfilt(band, moments, axis=0)[inside]
    rose = np.gradient(sosfiltfilt(band, turned, axis=0), _GRID_S, axis=0)[inside]
    return Turning(*(_correlation(pushed[:, k], rose[:, k]) for k in range(3)))


def best_frame(flight: Flight, motors: int) -> tuple[str, Turning] | None:
    """The frame of a number of motors that a flight agrees with best; None: with none clearly."""
    found = [(name, t) for name in frames_of(motors) if (t := turning(flight, frame(name)))]
    clear = [(name, t) for name, t in found if t.worst > CLEAR]
    return max(clear, key=lambda each: each[1].worst + each[1].yaw, default=None)


def _correlation(a: Array, b: Array) -> float:
    size = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / size if size > 0 else 0.0
