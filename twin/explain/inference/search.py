"""Hypotheses: which effects, together, explain the residuals of all flights."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..model.numbers import Number, columns_of
from ..settings import DEFAULT, LikelihoodSettings, PoolSettings
from .bounds import Bounds
from .likelihood import Scores, believed

Array = NDArray[np.float64]
DRAWS = 4000
"""Of the Bayesian bootstrap."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Some effects and nothing else.

    Attributes:
        effects: Identifiers, sorted; none: nothing is missing.
        gains: Log likelihood over that of nothing, out of sample, shape (blocks, channels).
    """

    effects: tuple[str, ...]
    gains: Array

    @property
    def gain(self) -> float:
        """Over all blocks."""
        return float(self.gains.sum())


def score(
    scores: Scores, numbers: Sequence[Number], bounds: Bounds, effects: Iterable[str]
) -> Hypothesis:
    """One hypothesis, the changes of its numbers held inside their room."""
    effects = tuple(sorted(effects))
    columns = columns_of(numbers, effects)
    return Hypothesis(effects, scores.gains(columns, bounds.part(columns)))


def search(
    scores: Scores,
    numbers: Sequence[Number],
    bounds: Bounds,
    settings: PoolSettings = DEFAULT.inference.pool,
) -> list[Hypothesis]:
    """Hypotheses of up to `most` effects, best first, `nothing` among them.

    All single effects and pairs are scored; larger sets grow from the best `width` of one less.
    """
    names = list(dict.fromkeys(n.effect for n in numbers))
    found: dict[tuple[str, ...], Hypothesis] = {(): score(scores, numbers, bounds, ())}
    for name in names:
        found[(name,)] = score(scores, numbers, bounds, (name,))
    for pair in combinations(sorted(names), 2):
        found[pair] = score(scores, numbers, bounds, pair)
    for size in range(3, settings.most + 1):
        best = sorted((h for k, h in found.items() if len(k) == size - 1), key=lambda h: -h.gain)
        for h in best[: settings.width]:
            for name in names:
                key = tuple(sorted({*h.effects, name}))
                if len(key) == size and key not in found:
                    found[key] = score(scores, numbers, bounds, key)
    return sorted(found.values(), key=lambda h: -h.gain)


def weights(
    hypotheses: Sequence[Hypothesis],
    prior: Array,
    seed: int = 0,
    settings: LikelihoodSettings = DEFAULT.inference.likelihood,
) -> Array:
    """Probability of each hypothesis, shape (k,).

    Bayesian bootstrap over the blocks of time: a lead that rests on a few blocks is worth little.
    No law is exact, so a lead also counts by its ratio to what is explained, channel by channel.

    Args:
        hypotheses: Scored over the same blocks.
        prior: Log of the prior weight of each, shape (k,).
        seed: Of the draws.
        settings: How exact a law is.
    """
    blocks = len(hypotheses[0].gains)
    draws = np.random.default_rng(seed).dirichlet(np.ones(blocks), DRAWS) * blocks
    each = [believed(draws @ h.gains, settings).sum(axis=1) for h in hypotheses]
    total = np.stack(each, axis=-1) + prior
    total -= total.max(axis=1, keepdims=True)
    share = np.exp(total)
    return np.asarray((share / share.sum(axis=1, keepdims=True)).mean(axis=0))
