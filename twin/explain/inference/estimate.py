"""An effect's number with its interval, as it is reported."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from ..model.numbers import Number
from .evidence import tail_weights
from .fit import INTERVAL, Fit
from .priors import Priors, parameter_of

MOST_OF_PRIOR = 0.5
"""Largest posterior over prior standard deviation of a number in a headline: the flights must
contain more information than the prior."""
_CREDIBLE = 0.95  # probability that an interval holds its number


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimate of a number of an effect.

    Attributes:
        number: Number that is estimated.
        value: Value in its unit.
        no_effect: Value without the effect, or without a change; None for a shape parameter.
        ci95: 95 % interval; None: it has none.
        prior_share: Posterior over prior standard deviation: 1 where the flights contain no
            information; None: it has no prior.
        tension: Deviation of the value from its prior mean in prior standard deviations; None: it
            has no prior.
    """

    number: Number
    value: float
    no_effect: float | None
    ci95: tuple[float, float] | None
    prior_share: float | None = None
    tension: float | None = None

    @property
    def may_be_none(self) -> bool:
        """Whether the 95 % interval contains `no_effect`; false for a shape parameter, and without
        an interval."""
        if self.ci95 is None or self.no_effect is None:
            return False
        return self.ci95[0] <= self.no_effect <= self.ci95[1]

    @property
    def determined(self) -> bool:
        """Whether a headline may contain it: the 95 % interval excludes `no_effect`, and the
        flights contain more information than the prior."""
        known = self.ci95 is not None and self.no_effect is not None and not self.may_be_none
        return known and (self.prior_share or 0.0) <= MOST_OF_PRIOR

    @property
    def change(self) -> float:
        """Difference from `no_effect`; for a shape parameter, from 0."""
        return self.value - (self.no_effect or 0.0)


def credible_interval(
    number: Number, value: float, half_width: float, ridge: float = 1.0
) -> tuple[float, float]:
    """95 % interval of a number with a normal posterior in the search, inside its physical range.

    A factor (no effect: 1) is log-normal, with `value` as its median and the coefficient of
    variation of the search: doubling is as far away as halving. Any other non-negative quantity has
    the distribution of `normal_power`, truncated at its physical minimum, and the interval is that
    of highest density: it contains the minimum exactly where no effect is credible.

    Args:
        number: The number, with its physical range.
        value: Posterior mode, in the unit of the number.
        half_width: Half-width of the 95 % interval of a normal posterior.
        ridge: Ratio of standard deviations, as of `Fit.ridges`.

    Returns:
        Lower and upper end.
    """
    sd, about = half_width / INTERVAL, number.about
    if not sd > 0 or not math.isfinite(sd):
        return value - half_width, value + half_width
    if parameter_of(number)[0].bounds[0] < 0:
        return value - half_width, value + half_width
    if about.neutral and about.bounds[0] > 0 and value > 0:
        spread = math.exp(INTERVAL * math.sqrt(math.log1p((sd / value) ** 2)))
        return value / spread, value * spread
    least = min(about.bounds[0], value)
    mode, spread, exponent = normal_power(value - least, sd, ridge)
    inside = float(norm.cdf(mode / spread))
    half = spread * float(norm.ppf((1 + _CREDIBLE * inside) / 2))
    if mode < half:
        return least, least + (mode + spread * norm.ppf(1 - (1 - _CREDIBLE) * inside)) ** exponent
    return least + (mode - half) ** exponent, least + (mode + half) ** exponent


def normal_power(size: float, sd: float, ridge: float) -> tuple[float, float, float]:
    """Mode and standard deviation of the power 1 / ridge of a size that is normal, and the ridge.

    Where size and shape are correlated, the standard deviation of the size is along that ridge, on
    which it never vanishes: without an effect there is no shape, so the distance from no effect is
    that with the shape fixed. The power 1 / ridge reproduces both the standard deviation about the
    mode and that distance (Box & Cox, J. R. Stat. Soc. B 26, 1964).
    """
    if not size > 0:
        return size, sd, 1.0
    return size ** (1 / ridge), sd * size ** (1 / ridge - 1) / ridge, ridge


def share(sd: float, slab: float, weight: float) -> float:
    """Posterior over prior standard deviation, at most 1; a Student prior with a weight below 1, as
    of `tail_weights`, is wider."""
    return min(1.0, sd / slab * math.sqrt(min(weight, 1.0))) if slab > 0 else 1.0


def fitted_estimates(
    fitted: Fit, priors: Priors, effect: str, wider: float = 1.0
) -> list[Estimate]:
    """Estimates of an effect in one fit; a fixed number is described by its prior alone."""
    tension = priors.tension(fitted.values)
    place = {n: i for i, n in enumerate(priors.names)}
    values = [fitted.values.get(n, m) for n, m in zip(priors.names, priors.mean, strict=True)]
    weights = tail_weights(np.array(values) - priors.mean, priors.tailed)
    found = []
    for n, w in zip(fitted.numbers, fitted.half_widths, strict=True):
        if n.effect != effect:
            continue
        i, value = place[n.full], fitted.values[n.full]
        found.append(
            Estimate(
                n,
                value,
                None if n.shape else float(priors.now[i] + priors.held[i]),
                credible_interval(n, value, wider * float(w), fitted.ridges.get(n.full, 1.0)),
                share(float(w) / INTERVAL, float(priors.slab[i]), float(weights[i])),
                tension[n.full],
            )
        )
    return found
