"""The wind of a flight: whether it is stronger than on the days of the calibration, and what it and
a load on a rope do to the balance of forces and moments.

Every day has its wind, so that a search takes most of it for the day's: that it has changed is told
by how strong it is, whichever of the two it was taken for.

The search tells them by readings that the balance leaves alone. The balance is then judged in that
wind and with that load, and less sharply: neither is known exactly, and a calibration in calm air
does not tell how the aircraft answers to the air,

    W = S_b P S_b' + (S_a - S_a0) Q (S_a - S_a0)'

S_b: slopes of the means by the numbers that the search told, P: their variance; S_a: slopes by the
numbers of the air's effects, S_a0: the same without wind and load, Q: variance of these numbers by
the calibration, and what is expected before any flight where that does not hold them: of what many
aircraft have as if this one had it, of what is rare by its odds.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit
from scipy.stats import norm

from ..effects import EFFECTS, prior_of
from ..effects.parameters import COMMON
from .balance import ROPE, Hypothesis
from .inference.fit import INTERVAL, Fit, Problem
from .inference.posterior import Posterior
from .inference.selection import Naming
from .model.model import Model
from .model.numbers import Number

Array = NDArray[np.float64]
WIND = frozenset(e.name for e in EFFECTS.values() if e.of_weather and e.component == "airframe")
"""Effects that are a wind, the same all flight."""
ACTING = frozenset(
    e.name for e in EFFECTS.values() if e.in_the_air and "vel" in e.needs and e.change is not None
)
"""Effects that change the balance and that a search tells without it, by what depends on the
velocity: a wind, a load on a rope."""
OF_AIR = frozenset(
    e.name
    for e in EFFECTS.values()
    if e.in_the_air and not e.of_weather and "vel" in e.needs and e.change is None
)
"""Effects of a sound aircraft by which a wind may change thrust and moments: those of the velocity.
What comes with a change, as a slung load, is no doubt about the air."""


STRONG = 2.0
"""Deviations between the days of the calibration by which a wind is stronger than usual."""


@dataclass(frozen=True, slots=True)
class Wind:
    """The wind of some flights, of the change since a calibration and of their days together.

    Attributes:
        change: "effect.number" -> mean over all flights, and standard deviation.
        values: The same of the wind itself, with that of the vehicle.
        stronger: Probability that it is stronger than usual, see `STRONG`.
    """

    change: Mapping[str, tuple[float, float]]
    values: Mapping[str, tuple[float, float]]
    stronger: float


def wind_of(problem: Problem, posterior: Posterior) -> Wind | None:
    """Wind by a search since a calibration; None where it looks for none, or knows no days."""
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
    now = b.now[[b.names.index(n) for n in names]]
    change, values = (
        dict(zip(names, zip(v.tolist(), sd.tolist(), strict=True), strict=True))
        for v in (mean, now + mean)
    )
    return Wind(change, values, stronger)


def acting_of(shown: Fit, named: Collection[str]) -> dict[str, tuple[float, float]]:
    """Wind and named load on a rope that a search found: "effect.number" -> value and standard
    deviation; none: calm. One that is not named is left to the balance, which knows its weight."""
    pairs = zip(shown.numbers, shown.half_widths, strict=True)
    return {
        n.full: (shown.values[n.full], float(half) / INTERVAL)
        for n, half in pairs
        if n.effect in WIND or (n.effect in ACTING and n.effect in named)
    }


def hanging_of(naming: Naming, load: Hypothesis) -> Hypothesis:
    """A load of the balance as one that hangs on a rope, with the probability of that given a load:
    as far as its swing speaks for it, where these flights show any."""
    (effect,) = ACTING - WIND
    change, posterior, b = EFFECTS[effect].change, naming.posterior, naming.problem.priors
    assert change is not None
    log_odds = ROPE
    if effect in naming.inclusion:
        log_odds += float(logit(np.clip(naming.inclusion[effect], 1e-9, 1 - 1e-9))) - change.odds
    own = {p.name for p in EFFECTS[effect].parameters}
    names = {n: n.partition(".")[2] for n in load.values}
    held = {
        f"{effect}.{name}": (load.values[n], load.deviations[n])
        for n, name in names.items()
        if name in own
    }
    for i in np.flatnonzero(b.shape & (np.array(b.cause) == effect)):
        row = np.zeros(len(b.names))
        row[i] = 1.0
        there, moved, sd = posterior.total(row, [effect])
        held |= {b.names[i]: (moved, sd)} if there > 0 else {}
    return Hypothesis(
        effect,
        (),
        float(expit(log_odds)),
        {n: v for n, (v, _) in held.items()},
        {n: sd for n, (_, sd) in held.items()},
    )


def uncertain(
    model: Model, channels: Sequence[str], found: Mapping[str, tuple[float, float]]
) -> Array:
    """W of a model's flights.

    Args:
        model: Flights with the calibrated vehicle.
        channels: Of the balance.
        found: As of `acting_of`.

    Returns:
        In the units of the channels, shape (channels, channels).
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
    """Mean slopes of all flights, shape (channels, columns)."""
    flights = [{c.name: c for c in f} for f in model.channels(columns, values)]
    means = [[f[c].slopes.mean(axis=0) for c in channels] for f in flights]
    return np.asarray(np.mean(means, axis=0), dtype=np.float64)


def _usual(number: Number, model: Model) -> float:
    """Standard deviation of a number after the calibration, or before any flight, about what the
    vehicle has."""
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
