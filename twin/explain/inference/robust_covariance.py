"""How far the truth may lie from fitted numbers, though no law is exact and no noise model true.

Two kinds of witnesses tell the same number again and again: blocks of time, and channels. What
they say apart from each other is the spread of a number beyond what the noise model says: a law
that is a little off asks for one number here and another there. Few witnesses are worth little,
which the quantile of Student's t with Satterthwaite's degrees of freedom allows for.

Source: White, Econometrica 48 (1980); clusters of two kinds: Cameron, Gelbach & Miller, J. Business
& Economic Statistics 29 (2011); Satterthwaite, Biometrics Bulletin 2 (1946).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

Array = NDArray[np.float64]
INSIDE = 0.95
FEWEST = 1.0
"""Degrees of freedom at least: two witnesses."""


def half_widths(inverse: Array, grams: Array, scores: Array) -> Array:
    """Half of the 95 % interval of each number.

    Args:
        inverse: Covariance by the noise model, shape (k, k).
        grams: Information of each channel in each block, shape (blocks, channels, k, k).
        scores: Gradient of the log likelihood at the fit there, shape (blocks, channels, k).

    Returns:
        Shape (k,).
    """
    blocks, _, k = scores.shape
    free = max(1, blocks - k)
    in_time = _spread(inverse, scores.sum(axis=1)) * blocks / free
    by_channel = _spread(inverse, scores.sum(axis=0))
    assumed = np.diag(inverse)
    seen = np.maximum(assumed, in_time)
    total = seen + by_channel
    doubt = np.where(in_time > assumed, in_time**2 / free, 0.0)
    doubt += by_channel**2 / _degrees(grams)
    degrees = np.maximum(total**2 / np.maximum(doubt, 1e-300), FEWEST)
    quantile = student.ppf((1 + INSIDE) / 2, np.minimum(degrees, 1e6))
    return np.asarray(quantile * np.sqrt(total))


def _spread(inverse: Array, scores: Array) -> Array:
    """Variance of each number that clusters show; scores have shape (clusters, k)."""
    return np.asarray(np.sum((scores @ inverse) ** 2, axis=0))


def _degrees(grams: Array) -> Array:
    """Effective number of channels that tell a number, less one; shape (k,)."""
    told = np.einsum("bckk->ck", grams)
    share = told / np.maximum(told.sum(axis=0), 1e-300)
    witnesses = 1 / np.maximum(np.sum(share**2, axis=0), 1e-300)
    return np.asarray(np.maximum(witnesses - 1, FEWEST / 2))
