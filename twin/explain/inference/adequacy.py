"""How far a name can be believed, and how large an absent effect would have to be to show.

*Adequacy*. The noise of a residual decorrelates within a few samples; what remains correlated over
longer lags is a cause. An effect of the right name explains nearly all of that, as its law is about
right. One that merely resembles the cause leaves a part of it, and the cause may be none of the
library.

*Detection limit*, which stands behind the verdict "nothing". A flight in which an effect of size a
is present gives an estimate that is normal about a, with the variance s^2 that the noise leaves,
all other free numbers integrated out. Its log Bayes factor against no effect, in the linearisation
at the end of the search, is that of two normal distributions about 0 and about the prior mean m,

    ln B(a) = (1/2) ln(v0 / v1) + a^2 / (2 v0) - (a - m)^2 / (2 v1),

v0 = s^2 + (standard deviation by the file)^2, v1 = s^2 + (prior standard deviation)^2. The critical
size is where ln B plus the log prior odds reaches the odds from which on a name is given; the
smallest detectable one lies 1.645 s beyond it, where 95 of 100 flights are named.

Source: Currie, Anal. Chem. 40 (1968) 586-593.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...physics.sensors.table import BODY, sensor_of
from ...residuals.channels import BAND_HZ, CHANNEL_HZ, POSE_BAND_HZ, ChannelData
from ..model.model import Model
from ..settings import DEFAULT, AdequacySettings
from .evidence import LaplaceEvidence
from .fit import Fit, State
from .priors import effect_of


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


# -- detection limit -----------------------------------------------------------------------


POWER_95 = 1.645
"""One-sided 95 % quantile of the normal distribution."""


@dataclass(frozen=True, slots=True)
class Detectable:
    """The smallest change of a number of an effect that flights would show.

    Attributes:
        number: "effect.number": of several of the effect the one that shows least.
        value: Change from no effect, positive, in `unit`; None: not within the range of the number.
        unit: SI unit.
    """

    number: str
    value: float | None
    unit: str


def critical_size(
    noise_var: float, none_var: float, mean: float, there_var: float, needed: float
) -> float:
    """Smallest positive estimate whose log Bayes factor reaches a threshold.

    Args:
        noise_var: Variance of the estimate by noise alone.
        none_var: Prior variance where no effect is there.
        mean: Prior mean of the change where the effect is there.
        there_var: Prior variance about it.
        needed: Log Bayes factor, nats.
    """
    v0, v1 = noise_var + none_var, noise_var + there_var
    a = 0.5 / v0 - 0.5 / v1
    b = mean / v1
    c = 0.5 * math.log(v0 / v1) - 0.5 * mean**2 / v1 - needed
    if c >= 0:
        return 0.0
    if a <= 0:
        return math.inf
    return (-b + math.sqrt(b * b - 4 * a * c)) / (2 * a)


def smallest_detectable(
    model: Model, laplace: LaplaceEvidence, state: State, sure: float
) -> Mapping[str, Detectable]:
    """By effect that is not in the final set, the smallest one that flights would show.

    Of an effect with several numbers, or several rotors, that of the number that shows least,
    relative to what is worth a name. An effect to which no channel answers is not in it.

    Args:
        model: Numbers in the order of the search.
        laplace: The linearisation at the end of a search.
        state: The final set of effects.
        sure: Probability from which on an effect is named.
    """
    b = laplace.priors
    present = {effect_of(c) for c in state.effects}
    found: dict[str, tuple[float, Detectable]] = {}
    for cause in (c for c in b.causes if effect_of(c) not in present and not laplace.silent(c)):
        own = [int(i) for i in b.of([cause]) if b.cause[i] == cause and not b.shape[i]]
        sd = laplace.best((*state.effects, cause), state.kappa).deviations()
        informed = np.array([sd[i] < (1 - 1e-6) * b.slab[i] for i in own])
        noise = {i: 1 / (sd[i] ** -2.0 - b.slab[i] ** -2.0) for i in np.array(own)[informed]}
        penalty = {
            i: 0.5 * math.log((v + b.file[i, i]) / (v + b.slab[i] ** 2)) for i, v in noise.items()
        }
        for i in own:
            number = model.numbers[b.columns[i]]
            size = math.inf
            if i in noise:
                needed = math.log(sure / (1 - sure)) - b.odds[cause]
                needed -= sum(v for k, v in penalty.items() if k != i)
                shift = float(b.mean[i] - b.now[i] - b.held[i])
                both = b.low[i] < b.now[i] + b.held[i]
                size = max(
                    critical_size(noise[i], b.file[i, i], m, b.slab[i] ** 2, needed)
                    for m in ((shift, -shift) if both else (shift,))
                )
                size = max(size, number.about.smallest) + POWER_95 * math.sqrt(noise[i])
            room = float(b.high[i] - b.now[i] - b.held[i])
            value = size if size <= max(room, 0.0) else None
            detected = Detectable(number.full, value, number.about.unit)
            effect, rank = number.effect, size / number.about.smallest
            if effect not in found or rank > found[effect][0]:
                found[effect] = rank, detected
    return {effect: detected for effect, (_, detected) in found.items()}
