"""What the wind of a flight, and a load on a rope, do to the balance of forces and moments.

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
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS, prior_of
from ..effects.parameters import COMMON
from .inference.fit import INTERVAL, Fit
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


def acting_of(shown: Fit) -> dict[str, tuple[float, float]]:
    """Wind and load on a rope that a search found: "effect.number" -> value and standard deviation;
    none: calm."""
    pairs = zip(shown.numbers, shown.half_widths, strict=True)
    return {
        n.full: (shown.values[n.full], float(half) / INTERVAL)
        for n, half in pairs
        if n.effect in ACTING
    }


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
