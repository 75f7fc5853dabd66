"""What is left of force and moment, half a second ahead: an observer of each output.

The observer is that of `twin.physics.airframe`: a first-order lag learns a disturbance while the
motion is given, and it fades with a time constant of its own afterwards. A gust that stays for
seconds wants another one than the shake of a propeller, so each output has its own two numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from twin.residuals.channels import CHANNEL_HZ

Array = NDArray[np.float64]
AHEAD_S = (0.2, 0.5, 1.0)
"""Horizons over which it is judged."""
LAGS_S = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Tried lags, s: from what an IMU can tell to the drift of a battery. Made up."""
FADES_S = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Tried time constants of the fade, s; in steps as of the lags."""
TIE = 0.02
"""Shares missed that differ by less are the same. Not chosen on flights."""
NEVER_S = 1e6
"""Lag of an observer that learns nothing."""


@dataclass(frozen=True, slots=True)
class Observer:
    """Of one output.

    Attributes:
        lag_s: In which it is learned.
        fade_s: In which it fades.
    """

    lag_s: float
    fade_s: float


NO_OBSERVER = Observer(NEVER_S, 1.0)
"""Learns nothing, so that it gives nothing."""


def missed(left: Array, pieces: Sequence[slice], observer: Observer) -> Array:
    """What an observer misses of the impulse over each of `AHEAD_S`, one squared mean each.

    Args:
        left: Force or moment that is left, at `CHANNEL_HZ`, shape (n,).
        pieces: Rows of uninterrupted flight.
        observer: Which has seen all before.

    Returns:
        Shape (len(AHEAD_S),), of the square of the unit times seconds; NaN where no piece is as
        long.
    """
    share = -np.expm1(-1 / (CHANNEL_HZ * observer.lag_s))
    decay = np.exp(-1 / (CHANNEL_HZ * observer.fade_s))
    squares: list[list[Array]] = [[] for _ in AHEAD_S]
    for rows in pieces:
        part = left[rows]
        known = lfilter([share], [1, share - 1], part)
        path = np.concatenate([[0.0], np.cumsum(part)])
        for errors, ahead_s in zip(squares, AHEAD_S, strict=True):
            n = round(ahead_s * CHANNEL_HZ)
            if len(part) <= n:
                continue
            comes = path[n + 1 :] - path[1:-n]
            said = known[:-n] * decay * (1 - decay**n) / (1 - decay)
            errors.append(((comes - said) / CHANNEL_HZ) ** 2)
    return np.array([np.mean(np.concatenate(e)) if e else np.nan for e in squares])


def observer_of(flights: Sequence[tuple[Array, Sequence[slice]]]) -> Observer:
    """The observer of which the worst flight has most.

    Judged by what it misses relative to none, over all horizons together. Of those that are as good
    within `TIE` it is the slowest to learn, and of these the first to fade: what is done little of
    does little harm on a flight that is not like these.

    Args:
        flights: Of each, what is left at `CHANNEL_HZ`, shape (n,), and rows of uninterrupted
            flight.
    """
    alone = [missed(left, pieces, NO_OBSERVER) for left, pieces in flights]

    def worst(observer: Observer) -> float:
        """Share that it misses in the flight in which it is worst."""
        return max(
            float(np.nanmean(missed(left, pieces, observer) / none))
            for (left, pieces), none in zip(flights, alone, strict=True)
        )

    tried = {Observer(lag, fade): 0.0 for lag in sorted(LAGS_S, reverse=True) for fade in FADES_S}
    tried = {observer: worst(observer) for observer in tried}
    least = min(tried.values())
    if least >= 1:
        return NO_OBSERVER
    return next(observer for observer, share in tried.items() if share <= least + TIE)
