"""Which law is used: that which flies better on flights it has not seen, and does no harm."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from learning.force.model import Flown

Array = NDArray[np.float64]
BETTER = 0.01
"""Share by which a law must lower the error, in the geometric mean over flights, quantities and
horizons."""
WORSE = 1.02
"""No quantity may grow by more, in the geometric mean over flights and horizons."""
_TINY = 1e-30


class Steps:
    """Progress by counted steps."""

    def __init__(self, total: int, progress: Callable[[float], None]) -> None:
        self._total, self._done, self._progress = total, 0, progress

    def one(self) -> None:
        """Another one is done."""
        self._done += 1
        self._progress(self._done / self._total)


def as_flown(law: str, gain: float, squares: Array, without: Array) -> Flown:
    """What a law does.

    Args:
        law: Its name.
        gain: Nats.
        squares: Mean squares with it, shape (flights, horizons, 4, 3).
        without: The same without it.
    """
    logs = np.log((squares + _TINY) / (without + _TINY)) / 2
    worst = logs.mean(axis=(0, 1)).max()
    return Flown(law, gain, float(np.exp(logs.mean())), float(np.exp(worst)))


def best_law(flown: Sequence[Flown]) -> str:
    """The simplest law within `BETTER` of the best of those that help and do no harm."""
    good = [
        (f.law, f.ratio)
        for f in flown
        if f.ratio is not None and f.worst is not None and f.ratio < 1 - BETTER and f.worst <= WORSE
    ]
    if not good:
        return "none"
    least = min(ratio for _, ratio in good)
    return next(law for law, ratio in good if ratio <= least + BETTER)

