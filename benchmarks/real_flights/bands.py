"""Residuals by frequency: the bands that the page shows of angular acceleration."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from twin.residuals.channels import CHANNEL_HZ, ChannelData

Array = NDArray[np.float64]
EDGES_HZ = (0.8, 4.5, 13.0)
"""Between the bands; the constant is in the first one."""
NAMES = ("< 0.8 Hz", "0.8-4.5 Hz", "4.5-13 Hz", "> 13 Hz")


def band_rms(flights: Sequence[ChannelData]) -> list[float]:
    """Rms of one channel of some flights by band; the squares sum up to that of the whole.

    By the orthonormal discrete cosine transform of each uninterrupted piece.
    """
    powers, n = np.zeros(len(NAMES)), 0
    for c in flights:
        for k in np.unique(c.piece):
            values = dct(c.residual[c.piece == k], norm="ortho")
            hz = np.arange(len(values)) * CHANNEL_HZ / 2 / len(values)
            band = np.searchsorted(EDGES_HZ, hz, side="right")
            powers += np.bincount(band, values**2, minlength=len(NAMES))
            n += len(values)
    return [float(v) for v in np.sqrt(powers / max(n, 1))]


def above(bands: Sequence[float]) -> float:
    """Rms of all bands but the slowest."""
    return float(np.sqrt(sum(b * b for b in bands[1:])))


def about_mean(rms: float, mean: float) -> float:
    """Rms about the mean."""
    return float(np.sqrt(max(rms**2 - mean**2, 0.0)))
