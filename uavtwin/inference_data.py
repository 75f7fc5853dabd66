"""The posterior of an explanation as `arviz.InferenceData`, for users of ArviZ.

A draw selects one of the candidate models by its probability, then its numbers from the Laplace
approximation about the MAP estimate of that model, with correlations by a Gaussian copula: each
number has the distribution whose 95 % interval is `credible_interval` of
`twin.explain.inference.estimate`.

ArviZ: Kumar et al., J. Open Source Softw. 4 (2019) 1143. Needs the package `arviz`, which is
imported on demand.
"""

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from twin.errors import TwinError, install_command
from twin.explain.estimates import reported_count
from twin.explain.explanation import Explanation
from twin.explain.inference.estimate import normal_power
from twin.explain.inference.posterior import ScoredModel
from twin.explain.inference.priors import Priors, effect_of, parameter_of
from twin.explain.inference.selection import Naming
from twin.explain.model.numbers import Number

if TYPE_CHECKING:
    import arviz

Array = NDArray[np.float64]
CHAINS = 4
"""Number of chains of the result: draws are independent, and ArviZ's diagnostics expect several."""


def inference_data(found: Explanation, draws: int, seed: int) -> "arviz.InferenceData":
    """Draws of the numbers of effects that may be missing.

    Args:
        found: Result of `explain`.
        draws: Draws of each chain.
        seed: Seed of the draws.

    Returns:
        Groups `posterior` and `prior`: a variable per number, "effect.number", where an effect is
        absent at its value in the model, and `included`, 1 where an effect is in the candidate
        model drawn, however small; `constant_data`: `inclusion_probability` by effect, that it is
        present and large enough to be named. Effects without a mean are in none of them.

    Raises:
        TwinError: ArviZ is not installed, or nothing was fitted.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # in its next version
            import arviz
    except ImportError as error:
        raise TwinError(
            f"to_arviz: {error.name} is not installed; it needs it: {install_command('arviz')}."
        ) from error
    naming = found.naming
    if naming is None:
        raise TwinError(f"to_arviz: nothing was fitted, {'; '.join(found.reasons)}.")
    columns = _columns(naming)
    rng = np.random.default_rng(seed)
    groups = {
        "posterior": _posterior(naming, columns, CHAINS * draws, _widening(found, naming), rng),
        "prior": _prior(naming, columns, CHAINS * draws, rng),
    }
    made: arviz.InferenceData = arviz.from_dict(
        **{
            k: {n: v.reshape(CHAINS, draws, *v.shape[1:]) for n, v in g.items()}
            for k, g in groups.items()
        },
        constant_data={"inclusion_probability": np.array([*naming.inclusion.values()])},
        coords={"effect": [*naming.inclusion]},
        dims={"included": ["effect"], "inclusion_probability": ["effect"]},
        attrs={
            "observed_data": ", ".join(found.flights),
            "vehicle": found.vehicle.name,
            "verdict": found.verdict,
            "settings": found.settings.hash,
            "seed": seed,
        },
    )
    for group in groups:
        for i in columns:
            n = _number(naming, i)
            made[group][n.full].attrs |= {"units": n.about.unit, "long_name": n.about.description}
    return made


def _number(naming: Naming, column: int) -> Number:
    return naming.problem.model.numbers[naming.problem.priors.columns[column]]


def _columns(naming: Naming) -> list[int]:
    """Numbers of the possible causes, and uncertain ones of the file."""
    b, least = naming.problem.priors, naming.settings.least
    likely = [c for c, p in naming.posterior.inclusion.items() if p >= least]
    return sorted({*b.of(likely).tolist(), *np.flatnonzero(b.spike > 0).tolist()})


def _widening(found: Explanation, naming: Naming) -> float:
    """Factor on standard deviations, as in the reported intervals."""
    return math.sqrt(1 + naming.settings.variance_per_effect * reported_count(found))


def _included(naming: Naming, causes: list[frozenset[str]]) -> Array:
    """Whether each effect is in the model of each draw, shape (draws, effects)."""
    effects = [{effect_of(c) for c in own} for own in causes]
    return np.array([[float(e in own) for e in naming.inclusion] for own in effects])


def _posterior(
    naming: Naming, columns: list[int], draws: int, wider: float, rng: np.random.Generator
) -> dict[str, Array]:
    """Draws by number, shape (draws,), and `included`."""
    sets = naming.posterior.sets
    p = np.array([s.probability for s in sets])
    chosen = rng.choice(len(sets), draws, p=p / p.sum())
    values = np.empty((draws, len(columns)))
    for k in np.unique(chosen):
        rows = chosen == k
        values[rows] = _of_set(naming, sets[k], columns, int(rows.sum()), wider, rng)
    own = [frozenset(sets[k].effects) for k in chosen]
    return _named(naming, columns, values) | {"included": _included(naming, own)}


def _of_set(
    naming: Naming,
    one: ScoredModel,
    columns: list[int],
    draws: int,
    wider: float,
    rng: np.random.Generator,
) -> Array:
    """Draws from one candidate model, shape (draws, columns)."""
    b, best = naming.problem.priors, one.best
    place = {int(i): j for j, i in enumerate(best.free)}
    moving = [c for c in columns if c in place and best.deviations()[c] > 0]
    at = [place[c] for c in moving]
    sd = best.deviations()[moving]
    correlation = best.covariance[np.ix_(at, at)] / np.outer(sd, sd)
    z = rng.multivariate_normal(np.zeros(len(at)), correlation, draws, "ignore", method="eigh")
    values = np.tile(b.now[columns] + best.x[columns], (draws, 1))
    for j, c in enumerate(moving):
        mean = float(b.now[c] + best.x[c])
        number = _number(naming, c)
        ridge = naming.conditional.ridges.get(number.full, 1.0)
        values[:, columns.index(c)] = _drawn(number, mean, wider * sd[j], ridge, z[:, j])
    return values


def _drawn(number: Number, value: float, sd: float, ridge: float, z: Array) -> Array:
    """Conversion of standard normal draws to draws of a number: log-normal for a factor, truncated
    at the physical minimum for a non-negative number, else normal, as in `credible_interval`."""
    about = number.about
    if parameter_of(number)[0].bounds[0] < 0:
        return value + sd * z
    if about.neutral and about.bounds[0] > 0 and value > 0:
        return np.asarray(value * np.exp(math.sqrt(math.log1p((sd / value) ** 2)) * z))
    least = min(about.bounds[0], value)
    mode, spread, exponent = normal_power(value - least, sd, ridge)
    outside = norm.cdf(-mode / spread)
    drawn = mode + spread * norm.ppf(outside + (1 - outside) * norm.cdf(z))
    return np.asarray(least + np.maximum(drawn, 0.0) ** exponent)


def _prior(
    naming: Naming, columns: list[int], draws: int, rng: np.random.Generator
) -> dict[str, Array]:
    """Prior draws: causes by their odds, numbers independent, within bounds."""
    b: Priors = naming.problem.priors
    there = {c: rng.random(draws) < 1 / (1 + math.exp(-b.odds[c])) for c in b.causes}
    values = np.empty((draws, len(columns)))
    for j, c in enumerate(columns):
        z, cause = rng.standard_normal(draws), b.cause[c]
        rest = b.now[c] + b.held[c] + b.spike[c] * z
        own = [there[o] for o in b.causes if o == cause or effect_of(o) == cause]
        on = np.any(own, axis=0) if own else np.zeros(draws, dtype=np.bool_)
        values[:, j] = np.where(on, np.clip(b.mean[c] + b.slab[c] * z, b.low[c], b.high[c]), rest)
    causes = [frozenset(c for c in b.causes if there[c][d]) for d in range(draws)]
    return _named(naming, columns, values) | {"included": _included(naming, causes)}


def _named(naming: Naming, columns: list[int], values: Array) -> dict[str, Array]:
    return {_number(naming, c).full: values[:, j] for j, c in enumerate(columns)}
