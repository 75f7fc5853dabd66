"""What is found about an effect that changes no mean."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..settings import DEFAULT, StochasticSettings

SURE = 1.96
"""Standard deviations of a 95 % interval."""


def prior_log_odds(settings: StochasticSettings = DEFAULT.stochastic) -> float:
    """Log odds for an effect before anything is seen."""
    return -float(np.log(settings.one_of))


@dataclass(frozen=True, slots=True)
class StochasticEffect:
    """An effect that changes no mean.

    Attributes:
        effect: Identifier.
        log_odds: Evidence for it, natural log, prior included.
        values: "effect.number" -> value.
        intervals: 95 % of each.
        channels: On which it was found.
        share: Of their power in the band where it acts.
    """

    effect: str
    log_odds: float
    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    channels: tuple[str, ...]
    share: float

    @property
    def probability(self) -> float:
        """That it acts."""
        return float(1 / (1 + np.exp(-self.log_odds)))
