"""How far a name can be believed: what of its own it leaves, where it explains most.

Noise is forgotten within a few samples; what a residual still knows of itself later is something
that moves it. An effect of the right name takes nearly all of that, as its law is about right. One
that merely resembles the cause leaves a part of it, and the cause may be none of the library.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from ...physics.sensors.table import BODY, sensor_of
from ...residuals.channels import BAND_HZ, CHANNEL_HZ, POSE_BAND_HZ, ChannelData
from ..model.model import Model
from ..settings import DEFAULT, AdequacySettings
from .fit import Fit


def credible(misfit: float, settings: AdequacySettings = DEFAULT.inference.adequacy) -> float:
    """Probability that a cause is of the library, given the share of amplitude that is left.

    By Bayes: what a right name leaves is normal about zero, with the deviation `law`. A wrong name
    may leave anything, or as little as a right one: that little is left speaks for no name, that
    much is speaks against it. (In the half of the benchmark that tunes all four wrong names of 24
    left less than `law`.)
    """
    law, outside = settings.law, settings.outside
    right = 2 / (law * np.sqrt(2 * np.pi)) * np.exp(-0.5 * (misfit / law) ** 2)
    return float((1 - outside) * right / ((1 - outside) * right + outside * max(right, 1.0)))


def misfits(
    model: Model,
    fitted: Fit,
    without: Mapping[str, Fit],
    settings: AdequacySettings = DEFAULT.inference.adequacy,
) -> dict[str, float]:
    """Of each effect the share of amplitude that it leaves in the channel that it explains most.

    Args:
        model: Flights.
        fitted: A hypothesis.
        without: The same without one of its effects, by that effect.
        settings: What counts as left.
    """
    model = fitted.on_its_days(model)  # a constant of the day may stand in for an effect
    after, found = model.channels([], fitted.values), {}
    for effect, rest in without.items():
        before = model.channels([], rest.values)
        i = int(
            np.argmax(
                [
                    _taken(b, a)
                    for b, a in zip(
                        zip(*before, strict=True), zip(*after, strict=True), strict=True
                    )
                ]
            )
        )
        (there, _), (left, chance) = (
            coherent([f[i] for f in flights], settings) for flights in (before, after)
        )
        share = max(left - settings.chance * chance, 0.0) / there if there > 0 else 0.0
        found[effect] = float(np.sqrt(min(share, 1.0)))
    return found


def _taken(before: Sequence[ChannelData], after: Sequence[ChannelData]) -> float:
    """Log of the power of a channel before over that after, times its samples."""
    n = sum(len(c.residual) for c in before)
    old, new = (sum(float(c.residual @ c.residual) for c in own) for own in (before, after))
    return n * float(np.log(max(old, 1e-300) / max(new, 1e-300)))


def coherent(
    flights: Sequence[ChannelData], settings: AdequacySettings = DEFAULT.inference.adequacy
) -> tuple[float, float]:
    """Mean power of a channel that is not forgotten, and the deviation of that by mere noise."""
    sensor = sensor_of(flights[0].name)
    band = BAND_HZ if sensor is not None and sensor.group == BODY else POSE_BAND_HZ
    lag = round(settings.memory * CHANNEL_HZ / band)
    total, power, n = 0.0, 0.0, 0
    for c in flights:
        for k in np.unique(c.piece):
            values = c.residual[c.piece == k]
            total += float(values[lag:] @ values[:-lag])
            power += float(values[lag:] @ values[lag:])
            n += max(len(values) - lag, 0)
    return max(total, 0.0) / max(n, 1), power / max(n, 1) / float(np.sqrt(max(n, 1) / lag))
