"""What a signal holds at which frequency, of samples that need not be uniform."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLOW_HZ = 10.0
"""Motion of the vehicle lies below this; above it a residual is mostly vibration and noise."""


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power spectral density.

    Attributes:
        f_hz: Frequencies, Hz, shape (n,); empty when the record is too short.
        psd: Power spectral density about the mean, unit^2/Hz, shape (n,).
        rate_hz: Rate the samples were resampled on, the median of their own.
        filled: Share of the resampled record that lies in gaps of the original, 0..1.
    """

    f_hz: Array
    psd: Array
    rate_hz: float
    filled: float

    def band_rms(self, low_hz: float, high_hz: float) -> float:
        """Rms of what lies in `low_hz <= f < high_hz`; NaN where the rate does not reach."""
        inside = (self.f_hz >= low_hz) & (self.f_hz < high_hz)
        if not inside.any():
            return math.nan
        return math.sqrt(float(self.psd[inside].sum()) * float(self.f_hz[1] - self.f_hz[0]))


def resample(t_s: Array, x: Array) -> tuple[Array, Array, float]:
    """Linear interpolation onto a uniform grid at the median rate of the samples.

    Interpolation damps what lies near half that rate; a signal already uniform is unchanged.

    Args:
        t_s: Strictly increasing times, s, shape (n,), n >= 2.
        x: Values, finite, shape (n,).

    Returns:
        Uniform times, s; values there; share of the grid in gaps over 3 median steps, 0..1.
    """
    steps = np.diff(t_s)
    step_s = float(np.median(steps))
    grid = t_s[0] + step_s * np.arange(int((t_s[-1] - t_s[0]) / step_s + 0.5) + 1)
    gap_s = float(steps[steps > 3 * step_s].sum())
    return grid, np.interp(grid, t_s, x), gap_s / float(t_s[-1] - t_s[0])


def spectrum(t_s: Array, x: Array, segment_s: float = 4.0) -> Spectrum:
    """Welch power spectral density of samples that need not be uniform.

    They are resampled on their median rate first (see `resample`); segments of `segment_s`
    overlap by half, Hann window, each about its own mean. Non-finite samples are left out.

    Args:
        t_s: Strictly increasing times, s, shape (n,).
        x: Values, shape (n,).
        segment_s: Length of a segment, s: sets the resolution to 1 / segment_s Hz.
    """
    from scipy import signal  # a second to load, of which reports of simulations need nothing

    ok = np.isfinite(x) & np.isfinite(t_s)
    t_s, x = t_s[ok], x[ok]
    if len(t_s) < 16:
        return Spectrum(np.empty(0), np.empty(0), math.nan, 0.0)
    grid, values, filled = resample(t_s, x)
    rate_hz = 1.0 / float(grid[1] - grid[0])
    n = min(len(values), max(16, round(segment_s * rate_hz)))
    f_hz, psd = signal.welch(values, fs=rate_hz, nperseg=n, detrend="constant")
    return Spectrum(np.asarray(f_hz), np.asarray(psd), rate_hz, filled)


def slow_part(t_s: Array, x: Array, cutoff_hz: float = SLOW_HZ) -> Array:
    """What a residual holds below `cutoff_hz`: 2nd-order Butterworth, forward and backward.

    Args:
        t_s: Strictly increasing times, s, shape (n,).
        x: Values, finite, shape (n,).
        cutoff_hz: Cutoff of the low-pass, Hz.

    Returns:
        Filtered values at `t_s`; `x` itself where the rate is too low to hold anything above
        the cutoff or the record is shorter than 32 samples.
    """
    from scipy import signal

    if len(x) < 32:
        return x
    grid, values, _ = resample(t_s, x)
    rate_hz = 1.0 / float(grid[1] - grid[0])
    if rate_hz <= 2.5 * cutoff_hz or len(values) < 32:
        return x
    sos = signal.butter(2, cutoff_hz, fs=rate_hz, output="sos")
    slow: Array = np.interp(t_s, grid, signal.sosfiltfilt(sos, values))
    return slow
