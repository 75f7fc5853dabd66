"""What a model says about a flight; the compensator and every baseline say it alike."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin.representation import short_repr

from ..data.flights import ResidualFlight

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Corrected:
    """A flight with its correction; outside the spans nothing is corrected.

    Attributes:
        correction: To be added to what the twin reads, shape (n, 15), units of the channels.
        spread: Standard deviation expected of what is left, shape (n, 15).
        anomaly: How strange the newest readings are, or what is known in their place, above 1
            rarely, (n,); NaN where a model gives no alarm.
        inside: Whether the features are within the envelope of the training data, shape (n,).
    """

    correction: Array
    spread: Array
    anomaly: Array
    inside: BoolArray

    __repr__ = short_repr


def between(share: Array, corrected: Array, uncorrected: Array) -> Array:
    """Spread of what is left where a correction fades: the one at share 1, the other at 0."""
    return uncorrected + share * (corrected - uncorrected)


class Model(Protocol):
    """Whatever corrects a flight."""

    def run(self, flight: ResidualFlight) -> Corrected:
        """The whole flight; each span starts anew."""
        ...
