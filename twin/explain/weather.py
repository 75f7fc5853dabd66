"""Wind of a flight: whether it is stronger than on the days of the calibration, and its effect,
with that of a slung load, on the balance of forces and moments.

A search attributes most of a wind to day-to-day variation: a change is decided by the total wind.

The search estimates wind and slung load from readings that the balance does not use. The balance is
then evaluated in that wind and with that load, which are not known exactly, nor is the response of
the aircraft to wind:

    W = S_b P S_b' + (S_a - S_a0) Q (S_a - S_a0)'

S_b: slopes of the means by the numbers that the search estimated, P: their covariance; S_a: slopes
by the numbers of the aerodynamic effects, S_a0: the same without wind and load, Q: covariance of
these numbers by the calibration, or by their priors where it does not contain them: for common
effects given that they are present, for rare ones weighted by their odds.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit
from scipy.stats import norm

from ..effects import EFFECTS, prior_of
from ..effects.parameters import COMMON
from ..residuals.channels import Array
from .balance import ROPE, Hypothesis
from .inference.fit import INTERVAL, Fit, Problem
from .inference.posterior import Posterior
from .inference.selection import Naming
from .model.model import Model
from .model.numbers import Number

WIND = frozenset(e.name for e in EFFECTS.values() if e.of_weather and e.component == "airframe")
"""Effects that are a constant wind throughout the flight."""
ACTING = frozenset(
    e.name for e in EFFECTS.values() if e.in_the_air and "vel" in e.needs and e.change is not None
)
"""Effects that change the balance and that a search estimates without it, from their dependence on
velocity: a wind, a slung load."""
OF_AIR = frozenset(
    e.name
    for e in EFFECTS.values()
    if e.in_the_air and not e.of_weather and "vel" in e.needs and e.change is None
)
"""Effects of an undamaged aircraft by which a wind may change thrust and moments: those that depend
on velocity."""
ROPES = np.geomspace(0.2, 3.0, 16)
"""Initial lengths of a rope over the expected one: the likelihood has several maxima, as the load
leaves the ground at one height."""
STRONG = 2.0
"""Number of standard deviations between the days of the calibration from which on a wind is
stronger than usual."""


@dataclass(frozen=True, slots=True)
class Wind:
    """Wind of some flights: change since a calibration plus day-to-day variation.

    Attributes:
        change: Mean over all flights and its standard deviation, by "effect.number".
        values: Mean and standard deviation of the wind itself, including the vehicle's.
        stronger: Probability that it is stronger than usual, see `STRONG`.
    """

    change: Mapping[str, tuple[float, float]]
    values: Mapping[str, tuple[float, float]]
    stronger: float


def wind_of(problem: Problem, posterior: Posterior) -> Wind | None:
    """Wind estimated by a search since a calibration; None where wind is not in the search, or no
    day-to-day variation is known."""
    b, known = problem.priors, problem.model.vehicle.calibration
    names = [n for n in b.names if n.partition(".")[0] in WIND]
    usual = [known.days[n] for n in names if known is not None and n in known.days]
    if not usual:
        return None
    flights, days = len(problem.model.flights), len(b.days)
    rows = np.zeros((len(names), len(b.names) + flights * days))
    for row, name in zip(rows, names, strict=True):
        own = b.names.index(name)
        row[own] = 1.0
        for j in np.flatnonzero(b.days == own):
            row[len(b.names) + j :: days] = 1 / flights
    p = np.array([s.probability for s in posterior.sets])
    each = np.array([rows @ s.best.x for s in posterior.sets])
    doubt = np.array([[s.best.variance(row) for row in rows] for s in posterior.sets])
    mean = p @ each
    sd = np.sqrt(p @ (doubt + (each - mean) ** 2))
    speed = np.maximum(np.linalg.norm(each, axis=1), 1e-9)
    along = np.sqrt(np.sum((each / speed[:, None]) ** 2 * doubt, axis=1))
    least = STRONG * math.sqrt(sum(v**2 for v in usual) / len(usual))
    stronger = float(p @ norm.cdf((speed - least) / np.maximum(along, 1e-9)))
    change, values = (
        dict(zip(names, zip(v.tolist(), sd.tolist(), strict=True), strict=True))
        for v in (mean, b.now[[b.names.index(n) for n in names]] + mean)
    )
    return Wind(change, values, stronger)


def acting_of(shown: Fit, named: Collection[str]) -> dict[str, tuple[float, float]]:
    """Wind and named slung load found by a search: "effect.number" -> value and standard deviation;
    empty: calm. A load that is not named is left to the balance, which observes its weight."""
    pairs = zip(shown.numbers, shown.half_widths, strict=True)
    return {
        n.full: (shown.values[n.full], float(half) / INTERVAL)
        for n, half in pairs
        if n.effect in WIND or (n.effect in ACTING and n.effect in named)
    }


def hanging_of(naming: Naming, load: Hypothesis) -> Hypothesis:
    """The balance's load as a slung load, with its probability given a load: by the evidence for a
    load of this mass on a rope over a fixed one, where these flights contain any."""
    (effect,) = ACTING - WIND
    own = {f"{effect}.{p.name}" for p in EFFECTS[effect].parameters}
    names = {new: n for n in load.values if (new := f"{effect}.{n.partition('.')[2]}") in own}
    held = {new: (load.values[n], load.deviations[n]) for new, n in names.items()}
    problem, b, log_odds = naming.problem, naming.problem.priors, ROPE
    at = {n: i for i, n in enumerate(b.names)}
    if {*held, *load.values} <= {*at}:
        first, mean, slab = naming.posterior.sets[0], b.mean.copy(), b.slab.copy()
        for new, n in names.items():
            mean[[at[n], at[new]]], slab[[at[n], at[new]]] = held[new]
        odds = {**b.odds, load.cause: 0.0, effect: -problem.gained[effect]}
        problem = replace(problem, priors=replace(b, mean=mean, slab=slab, odds=odds))
        columns, rest, kappa = b.of([effect]), {*first.effects} - {effect}, first.best.kappa
        starts = np.tile(first.best.x, (len(ROPES), 1))
        lengths = np.where(b.shape[columns], ROPES[:, None], 1.0)
        starts[:, columns] = lengths * mean[columns] - b.now[columns]

        def evidence(x: Array) -> float:
            there = problem.rest.moved(problem.channels(x), *problem.split(x))
            return problem.laplace(there).at(sorted({*rest, effect}), kappa, x)

        on_rope = problem.settle([*rest, effect], kappa, problem.rest, max(starts, key=evidence))
        fixed = [*rest, load.cause]
        again = problem.settle(fixed, kappa, problem.rest, first.best.x)
        log_odds += on_rope.evidence - max(again.evidence, problem.start(fixed, kappa).evidence)
        for i in columns[b.shape[columns]]:
            sd = math.sqrt(on_rope.best.variance(np.eye(1, len(at), i)[0]))
            held[b.names[i]] = float(b.now[i] + on_rope.best.x[i]), sd
    values, deviations = ({n: pair[k] for n, pair in held.items()} for k in (0, 1))
    return Hypothesis(effect, (), float(expit(log_odds)), values, deviations)


def uncertain(
    model: Model, channels: Sequence[str], found: Mapping[str, tuple[float, float]]
) -> Array:
    """W for the flights of a model.

    Args:
        model: Flights with the calibrated vehicle.
        channels: Channels of the balance.
        found: Wind and load, as of `acting_of`.

    Returns:
        Covariance in the units of the channels, shape (channels, channels).
    """
    there = {n.partition(".")[0] for n in found}
    wanted = OF_AIR | there
    columns = [i for i, n in enumerate(model.numbers) if n.effect in wanted and not n.shape]
    numbers = [model.numbers[i] for i in columns]
    now = _slopes(model, columns, channels, {n: value for n, (value, _) in found.items()})
    without = _slopes(model, columns, channels, {})
    without[:, [n.effect in there for n in numbers]] = 0.0
    deviations = [found[n.full][1] if n.full in found else _usual(n, model) for n in numbers]
    moved = (now - without) * np.array(deviations)
    return np.asarray(moved @ moved.T)


def _slopes(
    model: Model, columns: Sequence[int], channels: Sequence[str], values: Mapping[str, float]
) -> Array:
    """Mean slopes over all flights, shape (channels, columns)."""
    flights = [{c.name: c for c in f} for f in model.channels(columns, values)]
    means = [[f[c].slopes.mean(axis=0) for c in channels] for f in flights]
    return np.asarray(np.mean(means, axis=0), dtype=np.float64)


def _usual(number: Number, model: Model) -> float:
    """Standard deviation of a number by the calibration, or by its prior, about the vehicle's
    value."""
    known = model.vehicle.calibration
    if known is not None and number.full in known.numbers:
        i = known.numbers.index(number.full)
        return math.sqrt(known.covariance[i, i])
    effect = EFFECTS[number.effect]
    about = next(p for p in effect.parameters if p.name == number.about.name)
    prior = prior_of(effect)
    expected = prior.of(number.name, False).sized(about, model.vehicle)
    chance = 1.0 if prior.odds >= COMMON else 1 / (1 + math.exp(-prior.odds))
    return math.sqrt(chance) * math.hypot(expected.mean, expected.sd)
