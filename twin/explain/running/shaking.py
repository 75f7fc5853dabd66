"""What no equation predicts: readings that stand still, and noise above the band of motion."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...effects.sensors import IMU_CHANNELS
from ...residuals.channels import GRID_HZ

Array = NDArray[np.float64]
SUB_BANDS_HZ = (25.0, 45.0, 65.0, 85.0, 100.0)
"""Edges: above the band of motion, below the limit of the grid."""


def high_power(readings: Array) -> Array:
    """Power of readings by sub-band, in their unit squared, shape (k, s).

    Args:
        readings: A frame on the grid, shape (n, k).
    """
    n = len(readings)
    window = np.hanning(n)[:, None]
    slope = np.linspace(-1, 1, n)[:, None]
    still = readings - readings.mean(axis=0)
    still = still - slope * (slope * still).sum(axis=0) / (slope * slope).sum()
    power = np.abs(np.fft.rfft(window * still, axis=0)) ** 2
    power *= 2 / (GRID_HZ * (window**2).sum()) * (GRID_HZ / n)
    hz = np.fft.rfftfreq(n, 1 / GRID_HZ)
    edges = np.searchsorted(hz, SUB_BANDS_HZ)
    return np.stack([power[a:b].sum(axis=0) for a, b in pairwise(edges)], axis=1)


def longest_repeats(samples: Mapping[str, tuple[Array, Array]]) -> dict[str, int]:
    """Most samples in a row that are all the same, by column of the IMU."""
    found = {}
    for name, (_, values) in samples.items():
        columns = [c for c in IMU_CHANNELS if c.startswith(name)]
        for column, x in zip(columns, values.T, strict=True):
            if len(x):
                edges = np.flatnonzero(np.concatenate([[True], np.diff(x) != 0, [True]]))
                found[column] = int(np.max(np.diff(edges)))
    return found
