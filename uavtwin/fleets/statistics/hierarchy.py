"""What estimates of several aircraft have in common, and what is each one's own.

Each estimate is a draw around the value of its aircraft, of known standard deviation; the values
are draws around that of the type, of a standard deviation to be found.

Sources: Paule, Mandel, J. Res. Natl. Bur. Stand. 87 (1982) 377-385, for the spread between
aircraft, as DerSimonian, Kacker, Contemp. Clin. Trials 28 (2007) 105-114 recommend; Hartung,
Knapp, Stat. Med. 20 (2001) 3875-3889, for how well the mean is known; Morris, J. Am. Stat. Assoc.
78 (1983) 47-55, for the values of the aircraft.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import t as student

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Common:
    """What several estimates say together.

    Attributes:
        mean: Of the values behind the estimates.
        sd: Standard deviation of the mean.
        between: Standard deviation of the values about it.
        low: Lower end of the 95 % interval of the mean.
        high: Upper end; infinite for a single estimate whose spread nobody knows.
        own: Value of each, drawn to the mean as far as its estimate is unsure, shape (n,).
        own_sd: Standard deviation of each, shape (n,).
    """

    mean: float
    sd: float
    between: float
    low: float
    high: float
    own: Array
    own_sd: Array


def common_of(value: Sequence[float] | Array, sd: Sequence[float] | Array) -> Common:
    """Random-effects estimate.

    Args:
        value: Estimates, shape (n,), n at least 1.
        sd: Of each, positive, shape (n,).
    """
    y, s = np.asarray(value, dtype=np.float64), np.asarray(sd, dtype=np.float64)
    if len(y) == 1:
        return Common(float(y[0]), float(s[0]), 0.0, -np.inf, np.inf, y, s)
    tau2 = _between(y, s)
    w = 1 / (s**2 + tau2)
    mean = float(w @ y / w.sum())
    q = float(w @ (y - mean) ** 2) / (len(y) - 1)
    sd_mean = float(np.sqrt(max(q, 1.0) / w.sum()))
    half = float(student.ppf(0.975, len(y) - 1)) * sd_mean
    kept = tau2 / (tau2 + s**2)
    own = mean + kept * (y - mean)
    own_sd = np.sqrt(kept * s**2 + (1 - kept) ** 2 * sd_mean**2)
    return Common(mean, sd_mean, float(np.sqrt(tau2)), mean - half, mean + half, own, own_sd)


def _between(y: Array, s: Array) -> float:
    """Variance between the values at which the weighted squares are what they should be."""

    def excess(tau2: float) -> float:
        w = 1 / (s**2 + tau2)
        return float(w @ (y - w @ y / w.sum()) ** 2) - (len(y) - 1)

    if excess(0.0) <= 0:
        return 0.0
    top = float(np.ptp(y)) ** 2 + float(s.max()) ** 2
    while excess(top) > 0:
        top *= 4
    return float(brentq(excess, 0.0, top, xtol=1e-15 * top, rtol=1e-12))
