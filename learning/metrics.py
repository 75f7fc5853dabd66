"""Numbers that say how far a correction is from the residual, or how alike two signals are."""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wasserstein_distance

from twin.residuals.gap import BAND_EDGES_HZ, spectrum

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
BANDS = tuple(
    f"{low:g}-{high:g}" if math.isfinite(high) else f"{low:g}+"
    for low, high in pairwise(BAND_EDGES_HZ)
)
"""Names of the frequency bands, Hz."""


def mse(left: Array) -> float:
    """Mean square of what is left, shape (n,); NaN of nothing."""
    return float(np.mean(left**2)) if len(left) else math.nan


def rmse(left: Array) -> float:
    """Root of `mse`."""
    return math.sqrt(mse(left))


def mae(left: Array) -> float:
    """Mean absolute value of what is left, shape (n,); NaN of nothing."""
    return float(np.mean(np.abs(left))) if len(left) else math.nan


def spread_of(left: Array) -> float:
    """Rms about the mean, shape (n,): what the best constant leaves."""
    return float(np.std(left)) if len(left) else math.nan


def wasserstein(measured: Array, simulated: Array) -> float:
    """Distance of two distributions, unit of the samples: how far they must be moved on average.

    Source: earth mover's distance of order 1, Villani, Optimal Transport (2009), ch. 6.
    """
    if not len(measured) or not len(simulated):
        return math.nan
    return float(wasserstein_distance(measured, simulated))


def share_removed(left: float, before: float) -> float:
    """Share of an rms that is gone: 1 all, 0 nothing, negative where it grew; NaN of nothing."""
    return 1 - left / before if before > 0 else math.nan


def coverage(left: Array, spread: Array, times: float) -> float:
    """Share of samples at most so many spreads away, 0..1; a Gaussian has 0.683 and 0.954.

    Args:
        left: What is left, shape (n,).
        spread: Predicted standard deviation, shape (n,), same unit.
        times: How many spreads.
    """
    return float(np.mean(np.abs(left) <= times * spread)) if len(left) else math.nan


def band_powers(t_s: Array, values: Array) -> Array:
    """Power about the mean in each of `BANDS`, unit^2, shape (4,).

    Args:
        t_s: Times, s, shape (n,).
        values: Shape (n,); NaN in all bands of a record that is too short, and in those that the
            sample rate does not reach.
    """
    found = spectrum(t_s, values)
    return np.array([found.band_rms(a, b) ** 2 for a, b in pairwise(BAND_EDGES_HZ)])


def band_distance(measured: Array, simulated: Array) -> float:
    """Mean absolute difference of powers in bands, dB; bands without power in either left out."""
    known = (measured > 0) & (simulated > 0)
    if not known.any():
        return math.nan
    return mae(10 * np.log10(simulated[known] / measured[known]))


def log_spectral_distance(t_s: Array, measured: Array, simulated: Array) -> float:
    """Root mean square difference of two power spectra, dB; NaN for less than 16 samples.

    Frequencies at which either has no power to rounding are left out.

    Source: Gray & Markel, IEEE Trans. ASSP 24 (1976), 380.
    """
    a, b = (spectrum(t_s, v).psd[1:] for v in (measured, simulated))
    if not len(a):
        return math.nan
    known = (a > 1e-12 * a.max()) & (b > 1e-12 * b.max()) if a.max() > 0 and b.max() > 0 else a < 0
    if not known.any():
        return math.nan
    return rmse(10 * np.log10(a[known] / b[known]))
