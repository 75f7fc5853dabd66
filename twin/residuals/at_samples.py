"""What is known at samples alone, between them: by cubic splines, and compared with what was known
all the time as if that, too, were known there alone.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ..frames import multiply
from .measured import LONGEST_GAP_S, AnySignal, Signal

Array = NDArray[np.float64]
SAME_S = 1e-9
"""Times of a grid and of a log that are apart by less are the same."""


def smooth_at(signal: AnySignal, t_s: Array, derivative: int = 0) -> Array:
    """A signal or its derivative in time by cubic splines, NaN outside and in gaps.

    Straight lines between samples h apart, and differences over h, would be averages over time,
    each with a variance of h^2/6 and h^2/12 on average.

    Args:
        signal: Of any rate.
        t_s: Times, s, shape (n,).
        derivative: How often it is differentiated.

    Returns:
        Shape (n, k).
    """
    there = signal.between(float(np.min(t_s)) - LONGEST_GAP_S, float(np.max(t_s)) + LONGEST_GAP_S)
    if len(there.t_s) < 4:
        return np.full((len(t_s), signal.values.shape[1]), np.nan)
    found = CubicSpline(there.t_s, there.values, bc_type="natural")(t_s, derivative)
    found[~np.isfinite(signal.at(t_s))] = np.nan
    return np.asarray(found)


def resample_like(values: Array, t_s: Array, signal: AnySignal, derivative: int = 0) -> Array:
    """What `smooth_at` makes of something where it is known at the samples of a signal alone.

    Two signals are compared without what sampling does to one of them when the other passes it,
    too: near half the rate of the samples that is much.

    Args:
        values: The derivative of that something, shape (n, k).
        t_s: Its times, s, shape (n,).
        signal: Whose samples.
        derivative: How often it is differentiated.

    Returns:
        Shape (n, k), NaN where either is unknown.
    """
    known = np.all(np.isfinite(values), axis=1)
    if np.count_nonzero(known) < 4:
        return np.full_like(values, np.nan)
    whole = CubicSpline(t_s[known], values[known])
    if derivative:
        whole = whole.antiderivative(derivative)
    there = signal.between(float(t_s[known][0]) - SAME_S, float(t_s[known][-1]) + SAME_S)
    found = smooth_at(Signal(there.t_s, whole(there.t_s)), t_s, derivative)
    found[~known] = np.nan
    return found


def turning_at(attitude: AnySignal, t_s: Array) -> Array:
    """Body rates of an attitude, rad/s, by cubic splines, NaN outside and in gaps, shape (n, 3)."""
    q, rate = (list(smooth_at(attitude, t_s, k).T) for k in (0, 1))
    back = [q[0], -q[1], -q[2], -q[3]]
    half = np.stack(multiply(back, rate)[1:], axis=-1)
    return np.asarray(2.0 * half / sum(x * x for x in q)[:, None])
