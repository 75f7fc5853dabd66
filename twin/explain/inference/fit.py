"""A set of effects with its numbers, as everybody beyond the inference sees it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS
from ...effects.priors import prior_of
from ...representation import short_repr
from ..model.model import Model
from ..model.numbers import Number
from .evidence import MapEstimate
from .priors import effect_of
from .refit import Problem

Array = NDArray[np.float64]
INTERVAL = 1.96
"""Half of a 95 % interval over the deviation of a normal distribution."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A set of effects at its best.

    Attributes:
        effects: Identifiers, sorted.
        values: Numbers and shapes, "effect.number" -> value.
        numbers: Those with an interval.
        half_widths: Of the 95 % intervals of `numbers`, shape (k,).
        gain: Log of its probability over that of nothing, numbers and noise integrated out.
        days: What the day of each flight adds then, as `Model.days`.
    """

    effects: tuple[str, ...]
    values: Mapping[str, float]
    numbers: tuple[Number, ...]
    half_widths: Array
    gain: float
    days: tuple[Mapping[str, float], ...] = ()

    __repr__ = short_repr

    def on_its_days(self, model: Model) -> Model:
        """Flights, each on its day."""
        return replace(model, days=self.days)

    def sizes(self) -> dict[str, float]:
        """Of each effect the largest change of one of its numbers, over one worth a name."""
        changes = dict.fromkeys(self.effects, 0.0)
        for n in self.numbers:
            if not n.shape:
                change = abs(self.values[n.full] - n.now) / n.about.smallest
                changes[n.effect] = max(changes[n.effect], change)
        return changes


def fit_of(
    problem: Problem,
    causes: Sequence[str],
    x: Array,
    deviations: Array,
    gain: float,
) -> Fit:
    """Fit of some causes from `MapEstimate.x`, days included, and its standard deviations."""
    on = tuple(sorted({effect_of(c) for c in causes}))
    own = problem.priors.of(causes)
    numbers = tuple(problem.model.numbers[problem.priors.columns[i]] for i in own)
    values = {n.full: n.now + float(x[i]) for n, i in zip(numbers, own, strict=True)}
    return Fit(on, values, numbers, INTERVAL * deviations[own], gain, problem.days(x))


def fit_of_best(problem: Problem, causes: Sequence[str], best: MapEstimate, nothing: float) -> Fit:
    """A set in a linearisation."""
    return fit_of(problem, causes, best.x, best.deviations(), best.evidence - nothing)


def substantial_effects(fitted: Fit) -> tuple[str, ...]:
    """Effects of a set that are large enough to speak of."""
    sizes, same = fitted.sizes(), _same_in_sum(fitted)
    return tuple(e for e in fitted.effects if sizes[e] >= 1 and e not in same)


def _same_in_sum(fitted: Fit) -> frozenset[str]:
    """Effects by which motors answer later, where others by which they answer sooner take all of it
    back: lag and delay of a response that is not quite of first order, as a file has it."""
    late = {
        n.effect: fitted.values[n.full] - n.now
        for n in fitted.numbers
        if n.acts or (prior_of(EFFECTS[n.effect]).timed and not n.shape)
    }
    smallest = [n.about.smallest for n in fitted.numbers if n.effect in late and not n.shape]
    back = min(late.values(), default=0.0) < 0 < max(late.values(), default=0.0)
    return frozenset(late) if back and abs(sum(late.values())) < max(smallest) else frozenset()
