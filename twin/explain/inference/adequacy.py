"""Credibility of a named effect: the residual that it leaves, and the exponent that its law
requires.

The noise of a residual decorrelates within a few samples; correlation over longer lags indicates a
cause. The right effect explains nearly all of it, as its law is approximately right. One that only
resembles the cause leaves a part, and the cause may be outside the library.

Or it leaves little, but the flights require another exponent: the effect's contribution to a
channel at its MAP estimate is c, and with another exponent c |c / c_0|^p. The exponent p is
estimated like other numbers, with the slope c ln|c / c_0|, |c| over the axes of a sensor. It is 0
for the right effect, and 1/2 for a quadratic drag fitted to a cubic one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import norm

from ...physics.sensors.table import BODY, sensor_of
from ...residuals.channels import BAND_HZ, CHANNEL_HZ, POSE_BAND_HZ, Array, ChannelData
from ..model.model import Model
from ..settings import DEFAULT, AdequacySettings
from .evidence import LaplaceEvidence
from .fit import Fit, Problem, State
from .priors import effect_of

LEAST = 1e-3
"""Contribution of an effect over its rms, below which its logarithm is clipped."""
UNKNOWN_POWER = 0.0, 1e6
"""Mean and standard deviation of an exponent without information."""


def credible(
    misfit: float,
    power: tuple[float, float] = UNKNOWN_POWER,
    settings: AdequacySettings = DEFAULT.inference.adequacy,
) -> float:
    """Probability that a cause is inside the library, given the share of amplitude that remains,
    and the exponent with its standard deviation.

    By Bayes: for the right effect both are normal about zero, with the standard deviations `law`
    and `power`. A wrong effect may leave any share, and have an exponent as far from zero as
    `powers`, or as that of a right one: a small remainder is no evidence for the effect, a large
    one is evidence against it.
    """
    outside, (p, sd) = settings.outside, power
    against = 1 / max(2 * norm.pdf(misfit, scale=settings.law), 1e-300)
    right, wrong = norm.logpdf(p, scale=np.hypot(sd, (settings.power, settings.powers)))
    odds = (1 - outside) / outside / (max(against, 1.0) * max(np.exp(wrong - right), 1.0))
    return float(odds / (1 + odds))


def misfits(
    model: Model,
    fitted: Fit,
    without: Mapping[str, Fit],
    settings: AdequacySettings = DEFAULT.inference.adequacy,
    usual: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Share of amplitude that each effect leaves in the channel that it explains most.

    Args:
        without: The candidate model without one of its effects, by that effect.
        usual: Rms that remains in flights without the effect, by channel: no fault of its law.
    """
    model = fitted.on_its_days(model)  # a constant of the day may compensate for an effect
    after, found = model.channels([], fitted.values), {}
    for effect, rest in without.items():
        before = model.channels([], rest.values)
        pairs = zip(zip(*before, strict=True), zip(*after, strict=True), strict=True)
        i = int(np.argmax([_taken(b, a) for b, a in pairs]))
        (there, _), (left, chance) = (
            coherent([f[i] for f in flights], settings) for flights in (before, after)
        )
        left -= (usual or {}).get(after[0][i].name, 0.0) ** 2
        share = max(left - settings.chance * chance, 0.0) / there if there > 0 else 0.0
        found[effect] = float(np.sqrt(min(share, 1.0)))
    return found


def _taken(before: Sequence[ChannelData], after: Sequence[ChannelData]) -> float:
    """Log ratio of the power of a channel before and after, times its number of samples."""
    n = sum(len(c.residual) for c in before)
    old, new = (sum(float(c.residual @ c.residual) for c in own) for own in (before, after))
    return n * float(np.log(max(old, 1e-300) / max(new, 1e-300)))


def coherent(
    flights: Sequence[ChannelData], settings: AdequacySettings = DEFAULT.inference.adequacy
) -> tuple[float, float]:
    """Mean power of a channel that stays correlated, and its standard deviation due to noise."""
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


# -- powers --------------------------------------------------------------------------------


def powers(
    problem: Problem,
    laplace: LaplaceEvidence,
    state: State,
    settings: AdequacySettings = DEFAULT.inference.adequacy,
) -> dict[str, tuple[float, float]]:
    """Exponent p of each effect of a MAP estimate, with its standard deviation, each estimated
    separately together with all numbers of the model; infinite where it is not determined."""
    best, b = laplace.best(state.effects, state.kappa), problem.priors
    effects = tuple(dict.fromkeys(map(effect_of, state.effects)))
    if not effects:
        return {}
    with_all = problem.channels(best.x)
    each = []
    for effect in effects:
        x = best.x.copy()
        x[b.of([c for c in b.causes if effect_of(c) == effect])] = 0.0
        each.append([_bent(*own) for own in zip(problem.channels(x), with_all, strict=True)])
    names = [f"{e}^" for e in effects]
    flights = [
        [replace(c, slopes=np.stack([e[f][i] for e in each], axis=-1)) for i, c in enumerate(own)]
        for f, own in enumerate(with_all)
    ]
    wider = replace(
        problem,
        priors=b.extended(names, settings.powers),
        bounds=problem.bounds.extended(len(names)),
    ).laplace(laplace.spectrum.only(problem.moving(state.effects)).extended(flights))
    found = {}
    for effect, name in zip(effects, names, strict=True):
        made = wider.best([*state.effects, name], state.kappa)
        i = wider.priors.names.index(name)
        variance = made.deviations()[i] ** 2
        alone = 1 / max(1 / variance - 1 / settings.powers**2, 1e-12)  # without prior
        found[effect] = float(made.x[i] * alone / variance), float(np.sqrt(alone))
    return found


def _bent(without: Sequence[ChannelData], with_all: Sequence[ChannelData]) -> list[Array]:
    """Slope of each channel of a flight by the exponent of an effect."""
    taken = {c.name: c.residual - a.residual for c, a in zip(without, with_all, strict=True)}
    found = []
    for name, own in taken.items():
        axes = [v for n, v in taken.items() if n[:-1] == name[:-1] and len(v) == len(own)]
        size = np.sqrt(np.sum(np.square(axes), axis=0))
        usual = max(float(np.sqrt(np.mean(size**2))), 1e-300)
        found.append(own * np.log(np.maximum(size / usual, LEAST)))
    return found
