"""Which bands of angular acceleration may vote: those in which command and motion go together.

In a flight in which nothing is commanded the commands answer to disturbances, and their gain to
the motion tends to nothing: such bands pull every gain down, of thrust, inertia and torque alike.

Source: direct identification in closed loop, Ljung, System Identification, ch. 13; the limit and
what it mends on slow flights were measured once on small quadrotors (docs/guide/calibrate.md).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, welch

from ...residuals.channels import CHANNEL_HZ, ChannelData
from .spectrum import BANDS_HZ, Flights

Array = NDArray[np.float64]
WINDOW = 128
"""Samples of a window: 2.6 s."""


def silent_bands(flights: Flights, least: float) -> frozenset[tuple[int, int]]:
    """Channels and bands of angular acceleration that do not vote, by their numbers.

    Args:
        flights: Channels of each flight.
        least: Coherence from which on a band votes.
    """
    found = set()
    for c, first in enumerate(flights[0]):
        if not first.name.startswith(("gyro_rate_", "motion_rate_")):
            continue
        hz, coherent = _coherence([f[c] for f in flights])
        for b in range(1, len(BANDS_HZ)):
            inside = (hz >= BANDS_HZ[b - 1]) & (hz < BANDS_HZ[b])
            if not inside.any() or float(np.mean(coherent[inside])) < least:
                found.add((c, b))
    return frozenset(found)


def _coherence(channels: Sequence[ChannelData]) -> tuple[Array, Array]:
    """Squared coherence of what was measured and what was predicted, all flights together."""
    hz, sums = np.zeros(0), None
    for c in channels:
        for k in np.unique(c.piece):
            measured = c.measured[c.piece == k]
            predicted = measured - c.residual[c.piece == k]
            if len(measured) < WINDOW:
                continue
            options = {"fs": CHANNEL_HZ, "nperseg": WINDOW}
            hz, both = csd(measured, predicted, **options)
            powers = [welch(v, **options)[1] for v in (measured, predicted)]
            part = len(measured) * np.array([both, *powers])
            sums = part if sums is None else sums + part
    if sums is None:
        return np.zeros(1), np.zeros(1)
    both, one, other = sums
    power = np.maximum(one.real * other.real, 1e-300)
    return hz, np.asarray(np.abs(both) ** 2 / power, dtype=np.float64)
