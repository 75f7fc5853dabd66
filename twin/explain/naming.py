"""Name what a model lacks: one effect, some, none, or a tie that the flights cannot break."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..flightlog import Flight
from ..vehicle import Vehicle
from .evidence import Scores
from .model import candidates, model_of
from .numbers import columns_of
from .refine import Fitted, Ground
from .search import Hypothesis, search, weights

Array = NDArray[np.float64]
Verdict = Literal["named", "nothing", "unnamed", "cannot_tell", "unusable"]
PER_EFFECT = 6.0
"""Log prior odds against one more effect: one of forty, and seldom more than one at once."""
PER_NUMBER = 1.5
"""Log prior odds against one more number in an effect."""
SMALLEST_SHARE = 0.03
"""An effect that takes less than this share of the power of every channel is none to speak of."""
SMALLEST_SIZE = 0.01
"""An effect whose numbers all move by less than this share of their prior ranges is none to speak
of either: a percent of the mass."""
SMALLEST_DELAY = 0.025
"""The same for a delay: 5 ms, what the sampling of a log at 200 Hz may feign."""
EXACT = 100.0
"""Log likelihood in a channel from which on the law of an effect shows that it is not exact: two
percent more of it are worth two, as if the law were right to about a seventh."""
IMPOSSIBLE = 1e6
SURE = 0.8
"""Probability from which on a name is given."""
SPOILT = 1.5
"""Times the power that a channel has without any effect."""
MOST, GROWN = 3, 3
"""Effects together; sets of one more that are tried after each of the best."""
SINGLES, PAIRS, TRIPLES = 8, 6, 3
"""Hypotheses of each size that are fitted at their own best."""


@dataclass(frozen=True, slots=True)
class Naming:
    """What the flights say about a model.

    Attributes:
        verdict: In a word.
        fitted: Hypotheses at their best, most probable first, `nothing` among them.
        probabilities: Of each.
        shares: Largest share of the power of a channel that each explains.
        ground: What they were fitted against.
    """

    verdict: Verdict
    fitted: tuple[Fitted, ...]
    probabilities: tuple[float, ...]
    shares: tuple[float, ...]
    ground: Ground

    @property
    def best(self) -> Fitted:
        """The most probable hypothesis."""
        return self.fitted[0]

    def probability_of(self, effect: str) -> float:
        """That an effect is missing, alone or with others."""
        return float(sum(p for f, p in zip(self.fitted, self.probabilities, strict=True)
                         if effect in f.effects))  # fmt: skip


def name_effects(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
) -> Naming:
    """Fit every effect that the flights can show, alone and together.

    Args:
        flights: To fit on.
        vehicle: The model as it stands.
        seed: Of the bootstrap.
        progress: Called with the share done.
    """
    model = model_of(flights, vehicle, candidates(flights), lambda done: progress(0.2 * done))
    ground = Ground.of(model)
    numbers = [model.numbers[i] for i in ground.columns]
    scores = Scores(ground.rest, np.array([n.sd for n in numbers]))
    chosen = _shortlist(search(scores, numbers, most=MOST))
    fitted = []
    for i, hypothesis in enumerate(chosen):
        fitted.append(ground.fit(hypothesis.effects))
        progress(0.3 + 0.5 * (i + 1) / len(chosen))
    for size in range(1, MOST):
        fitted += _grown(ground, fitted, size)
        progress(0.8 + 0.2 * size / (MOST - 1))
    shares = [share(f, ground.nothing()) for f in fitted]
    by_effects = {f.effects: f for f in fitted}
    prior = np.array([-_price(f) for f in fitted])
    prior[[not _material(ground, f, by_effects) for f in fitted]] -= IMPOSSIBLE
    prior[[_spoils(f, ground) for f in fitted]] -= IMPOSSIBLE
    prior[[_needless(f, fitted) for f in fitted]] -= IMPOSSIBLE
    chance = weights([Hypothesis(f.effects, f.gains) for f in fitted], prior, seed)
    order = np.argsort(-chance)
    ranked = tuple(fitted[i] for i in order)
    probabilities = tuple(float(chance[i]) for i in order)
    return Naming(
        _verdict(ranked, probabilities),
        ranked,
        probabilities,
        tuple(shares[i] for i in order),
        ground,
    )


def _shortlist(found: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The best of each size; a larger one only where it beats what it is made of."""
    chosen = [h for h in found if not h.effects]
    best = {h.effects: h.gain for h in found}
    for size, count in ((1, SINGLES), (2, PAIRS), (3, TRIPLES)):
        taken = 0
        for h in found:
            if len(h.effects) != size or h.gain <= 0:
                continue
            parts = [tuple(e for e in h.effects if e != left) for left in h.effects]
            if size > 1 and h.gain < max(best.get(p, 0.0) for p in parts) + PER_EFFECT:
                continue
            chosen.append(h)
            taken += 1
            if taken == count:
                break
    return chosen


def _grown(ground: Ground, fitted: Sequence[Fitted], size: int) -> list[Fitted]:
    """The best hypothesis of a size with one more effect, those that its own surroundings ask for.

    The first search is linear about the model as it stands. About a hypothesis at its best, what
    one more effect would gain looks different.
    """
    best = max((f for f in fitted if len(f.effects) == size), key=_worth, default=None)
    if best is None or best.gain < PER_EFFECT:
        return []
    scores, model = ground.around(best), ground.model
    numbers = [model.numbers[i] for i in ground.columns]
    low, high = (
        np.array([n.about.prior[i] - best.values.get(n.full, n.now) for n in numbers])
        for i in (0, 1)
    )

    def gain(effects: Iterable[str]) -> float:
        """Of numbers near the fit."""
        columns = columns_of(numbers, effects)
        return float(scores.gains(columns, low[columns], high[columns]).sum())

    known = {f.effects for f in fitted}
    sets = [tuple(sorted((*best.effects, e))) for e in model.effects if e not in best.effects]
    gains = {s: gain(s) for s in sets if s not in known}
    wanted = sorted((s for s in gains if gains[s] > PER_EFFECT), key=lambda s: -gains[s])
    return [ground.fit(s) for s in wanted[:GROWN]]


def _worth(fitted: Fitted) -> float:
    return fitted.gain - _price(fitted)


def _spoils(fitted: Fitted, ground: Ground) -> bool:
    """Whether a channel is left clearly worse than without any effect.

    White noise hardly counts what is slow: an offset that a hypothesis brings in.
    """
    return bool(np.any(fitted.raw > SPOILT * ground.raw))


def _price(fitted: Fitted) -> float:
    """Log prior odds against a hypothesis."""
    return PER_EFFECT * len(fitted.effects) + PER_NUMBER * len(fitted.values)


def _needless(fitted: Fitted, others: Sequence[Fitted]) -> bool:
    """Whether fewer effects do as well, given that no law is exact.

    What a law gets wrong grows with what it explains. Channel by channel, the log likelihood that
    a hypothesis gains counts in full up to `EXACT`, and by its ratio above.
    """
    return any(
        _inexact(fitted) - _inexact(f) < _price(fitted) - _price(f)
        for f in others
        if len(f.effects) < len(fitted.effects)
    )


def _inexact(fitted: Fitted) -> float:
    gains = fitted.gains.sum(axis=0)
    return float(np.sum(np.where(gains > 0, EXACT * np.log1p(np.maximum(gains, 0) / EXACT), gains)))


def _material(ground: Ground, fitted: Fitted, others: dict[tuple[str, ...], Fitted]) -> bool:
    """Whether each effect of a hypothesis is large enough to speak of, and adds to the others."""
    for effect, size in fitted.sizes().items():
        if size < (SMALLEST_DELAY if effect.endswith("_delay") else SMALLEST_SIZE):
            return False
        rest = tuple(e for e in fitted.effects if e != effect)
        if rest not in others:
            others[rest] = ground.fit(rest)
        if share(fitted, others[rest]) < SMALLEST_SHARE:
            return False
    return True


def share(fitted: Fitted, beyond: Fitted) -> float:
    """Largest share of the power of a channel, as the noise model weighs it, that is explained.

    Args:
        fitted: What explains.
        beyond: What has explained some of it already.
    """
    return float(np.max(1 - fitted.left / np.maximum(beyond.left, 1e-300)))


def _verdict(ranked: Sequence[Fitted], probabilities: Sequence[float]) -> Verdict:
    if probabilities[0] < SURE:
        return "cannot_tell"
    return "named" if ranked[0].effects else "nothing"
