"""Detection limit: smallest size at which an absent effect would have been named.

A flight with an effect of size a gives an estimate that is normal about a, with the variance s^2
due to noise, with all other free numbers integrated out. Its log Bayes factor against no effect, in
the linearisation at the end of the search, is that of two normal distributions about 0 and about
the prior mean m,

    ln B(a) = (1/2) ln(v0 / v1) + a^2 / (2 v0) - (a - m)^2 / (2 v1),

v0 = s^2 + (standard deviation by the file)^2, v1 = s^2 + (prior standard deviation)^2. The critical
size is where ln B plus the log prior odds reaches the odds from which on an effect is named; the
smallest detectable one is 1.645 s larger, so that 95 of 100 flights name it.

Source: Currie, Anal. Chem. 40 (1968) 586-593.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from ..model.model import Model
from .evidence import LaplaceEvidence
from .fit import COVERED, State
from .priors import effect_of

POWER_95 = 1.645
"""One-sided 95 % quantile of the normal distribution."""


@dataclass(frozen=True, slots=True)
class Detectable:
    """Smallest change of a number of an effect that the flights would show.

    Attributes:
        number: Name "effect.number"; of several numbers of the effect, the least visible one.
        value: Change from no effect, positive, in `unit`; None: outside the range of the number.
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
        noise_var: Variance of the estimate due to noise alone.
        none_var: Prior variance without the effect.
        mean: Prior mean of the change with the effect.
        there_var: Prior variance about this mean.
        needed: Required log Bayes factor, nats.
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
    model: Model, laplace: LaplaceEvidence, state: State, named: Collection[str], sure: float
) -> Mapping[str, Detectable]:
    """The smallest visible change of each effect that is not named.

    For an effect with several numbers, or several rotors, the least visible number counts, relative
    to the least size of a named one. An effect that influences no channel is omitted.

    Args:
        model: Predictions of the flights.
        laplace: Linearisation of all candidate models about the final one.
        state: Final state. Effects in it without a name are within the uncertainty of the file.
        named: Named effects of the final state.
        sure: Probability from which on an effect is named.
    """
    b = laplace.priors
    found: dict[str, tuple[float, Detectable]] = {}
    for cause in (c for c in b.causes if effect_of(c) not in named and not laplace.silent(c)):
        own = [int(i) for i in b.of([cause]) if b.cause[i] == cause and not b.shape[i]]
        sd = laplace.best(sorted({*state.effects, cause}), state.kappa).deviations()
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
                size = max(size, number.about.smallest, COVERED * float(b.spike[i]))
                size += POWER_95 * math.sqrt(noise[i])
            room = float(b.high[i] - b.now[i] - b.held[i])
            value = size if size <= max(room, 0.0) else None
            detected = Detectable(number.full, value, number.about.unit)
            effect, rank = number.effect, size / number.about.smallest
            if effect not in found or rank > found[effect][0]:
                found[effect] = rank, detected
    return {effect: detected for effect, (_, detected) in found.items()}
