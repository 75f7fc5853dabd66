"""Name what a model lacks: one effect, some, none, or a tie that the flights cannot break."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..flightlog import Flight
from ..vehicle import Vehicle
from .evidence import Scores, believed
from .misfit import credible, misfits
from .model import candidates, model_of
from .numbers import columns_of
from .payload import Payloads
from .refine import Fitted, Ground
from .room import Room
from .search import Hypothesis, search, weights

Array = NDArray[np.float64]
Verdict = Literal["named", "nothing", "unnamed", "cannot_tell", "unusable"]
PER_EFFECT = 6.0
"""Log prior odds against one more effect: one of forty, and seldom more than one at once."""
PER_NUMBER = 1.5
"""Log prior odds against one more number that the flights tell."""
SMALLEST_SHARE = 0.03
"""An effect that takes less than this share of the power of every channel is none to speak of."""
IMPOSSIBLE = 1e6
SURE = 0.8
"""Probability from which on a name is given."""
CREDIBLE = 0.5
"""Probability that its cause is of the library at all, from which on a name is given."""
LEAST = 0.05
"""Probability below which a hypothesis or an effect is no candidate."""
SPOILT = 1.5
"""Times the power that a channel has without any effect."""
MOST, GROWN = 3, 3
"""Effects together; sets of one more that are tried after each of the best."""
ALIKE, EXCHANGED = 10.0, 2
"""Log likelihood, given that no law is exact, up to which an effect resembles another; how many
such are tried in the place of each."""
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
        credible: Of the effects of likely hypotheses, the probability that their cause is of the
            library at all, see `misfit`.
        ground: What they were fitted against.
    """

    verdict: Verdict
    fitted: tuple[Fitted, ...]
    probabilities: tuple[float, ...]
    shares: tuple[float, ...]
    credible: Mapping[str, float]
    ground: Ground

    @property
    def best(self) -> Fitted:
        """The most probable hypothesis."""
        return self.fitted[0]

    def probability_of(self, effect: str) -> float:
        """That an effect is missing, alone or with others."""
        among = sum(
            p for f, p in zip(self.fitted, self.probabilities, strict=True) if effect in f.effects
        )
        return float(among) * self.credible.get(effect, 1.0)

    @property
    def outside(self) -> float:
        """That a cause is none of the library, though the best hypothesis gives it a name."""
        return 1 - math.prod(self.credible[e] for e in self.best.effects)


def name_effects(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
    payloads: Payloads | None = None,
) -> Naming:
    """Fit every effect that the flights can show, alone and together.

    Args:
        flights: To fit on.
        vehicle: The model as it stands.
        seed: Of the bootstrap.
        progress: Called with the share done.
        payloads: Known masses aboard.
    """
    model = model_of(
        flights, vehicle, candidates(flights), lambda done: progress(0.2 * done), payloads
    )
    ground = Ground.of(model)
    numbers = [model.numbers[i] for i in ground.columns]
    scores = Scores(ground.rest, np.array([n.sd for n in numbers]))
    room = Room.of(numbers, vehicle).around(np.array([n.now for n in numbers]))
    chosen = _shortlist(search(scores, numbers, room, most=MOST))
    fitted = []
    for i, hypothesis in enumerate(chosen):
        fitted.append(ground.fit(hypothesis.effects))
        progress(0.3 + 0.5 * (i + 1) / len(chosen))
    for size in range(1, MOST):
        fitted += _grown(ground, fitted, size)
        progress(0.8 + 0.2 * size / (MOST - 1))
    by_effects = {f.effects: f for f in fitted}
    fitted += _exchanged(ground, fitted, by_effects)
    by_effects |= {f.effects: f for f in fitted}
    shares = [share(f, ground.nothing()) for f in fitted]
    prior = np.array([-_price(f) for f in fitted])
    prior[[not _material(ground, f, by_effects) for f in fitted]] -= IMPOSSIBLE
    prior[[_spoils(f, ground) for f in fitted]] -= IMPOSSIBLE
    prior[[_needless(f, fitted) for f in fitted]] -= IMPOSSIBLE
    chance = _weighed(ground, fitted, prior, by_effects, seed)
    order = np.argsort(-chance)
    ranked = tuple(fitted[i] for i in order)
    probabilities = tuple(float(chance[i]) for i in order)
    likely = [f for f, p in zip(ranked, probabilities, strict=True) if p >= LEAST]
    believable = _credible(ground, likely, by_effects)
    return Naming(
        _verdict(ranked, probabilities, believable),
        ranked,
        probabilities,
        tuple(shares[i] for i in order),
        believable,
        ground,
    )


def _weighed(
    ground: Ground, fitted: Sequence[Fitted], prior: Array,
    others: dict[tuple[str, ...], Fitted], seed: int,
) -> Array:  # fmt: skip
    """Probabilities; several effects lead only if each is credible: a name must not hang on one
    beside it that leaves what it should explain."""
    hypotheses = [Hypothesis(f.effects, f.gains) for f in fitted]
    while True:
        chance = weights(hypotheses, prior, seed)
        first = int(np.argmax(chance))
        believable = _credible(ground, [fitted[first]], others)
        if len(believable) < 2 or min(believable.values()) >= CREDIBLE:
            return chance
        prior[first] -= IMPOSSIBLE


def _credible(
    ground: Ground, likely: Sequence[Fitted], others: dict[tuple[str, ...], Fitted]
) -> dict[str, float]:
    """Of each effect, in the most probable hypothesis with it, what `misfit.credible` says."""
    found: dict[str, float] = {}
    for fitted in likely:
        without = {e: _without(ground, fitted, e, others) for e in fitted.effects}
        left = misfits(ground.model, fitted, without)
        found = {e: credible(m) for e, m in left.items()} | found
    return found


def _without(
    ground: Ground, fitted: Fitted, effect: str, others: dict[tuple[str, ...], Fitted]
) -> Fitted:
    """A hypothesis without one of its effects, from among others or added to them."""
    rest = tuple(e for e in fitted.effects if e != effect)
    if rest not in others:
        others[rest] = ground.fit(rest)
    return others[rest]


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
    gains_of, known = _about(ground, best), {f.effects for f in fitted}
    gains = {s: float(gains_of(s).sum()) for s in _larger(ground, best) if s not in known}
    wanted = sorted((s for s in gains if gains[s] > PER_EFFECT), key=lambda s: -gains[s])
    return [ground.fit(s) for s in wanted[:GROWN]]


def _exchanged(
    ground: Ground, fitted: Sequence[Fitted], others: dict[tuple[str, ...], Fitted]
) -> list[Fitted]:
    """Look-alikes of the effects of the best hypothesis, each in the place of what it resembles."""
    best = max(fitted, key=lambda f: _inexact(f) - _price(f))
    made: dict[tuple[str, ...], Fitted] = {}
    if len(best.effects) < 2:
        return []  # single effects have all been compared
    for effect in best.effects:
        rest = _without(ground, best, effect, others)
        gains_of, so_far = _about(ground, rest), rest.gains.sum(axis=0)
        sets = [s for s in _larger(ground, rest) if s not in others or s == best.effects]
        gain = {s: float(believed(so_far + gains_of(s)).sum()) for s in sets}
        alike = [s for s in sets if s != best.effects and gain[s] > gain[best.effects] - ALIKE]
        made |= {s: ground.fit(s) for s in sorted(alike, key=lambda s: -gain[s])[:EXCHANGED]}
    return list(made.values())


def _larger(ground: Ground, fitted: Fitted) -> list[tuple[str, ...]]:
    """Effects of a hypothesis with one more."""
    more = (e for e in ground.model.effects if e not in fitted.effects)
    return [tuple(sorted((*fitted.effects, e))) for e in more]


def _about(ground: Ground, fitted: Fitted) -> Callable[[Sequence[str]], Array]:
    """What effects gain by channel, beyond a hypothesis, by numbers near its own."""
    scores, model = ground.around(fitted), ground.model
    numbers = [model.numbers[i] for i in ground.columns]
    now = np.array([fitted.values.get(n.full, n.now) for n in numbers])
    room = Room.of(numbers, model.vehicle).around(now)

    def gains(effects: Sequence[str]) -> Array:
        """Shape (channels,)."""
        columns = columns_of(numbers, effects)
        return np.asarray(scores.gains(columns, room.part(columns)).sum(axis=0))

    return gains


def _worth(fitted: Fitted) -> float:
    return fitted.gain - _price(fitted)


def _spoils(fitted: Fitted, ground: Ground) -> bool:
    """Whether a channel is left clearly worse than without any effect.

    White noise hardly counts what is slow: an offset that a hypothesis brings in.
    """
    return bool(np.any(fitted.raw > SPOILT * ground.raw))


def _price(fitted: Fitted) -> float:
    """Log prior odds against a hypothesis."""
    return PER_EFFECT * len(fitted.effects) + PER_NUMBER * fitted.told


def _needless(fitted: Fitted, others: Sequence[Fitted]) -> bool:
    """Whether fewer effects do as well, given that no law is exact."""
    return any(
        _inexact(fitted) - _inexact(f) < _price(fitted) - _price(f)
        for f in others
        if len(f.effects) < len(fitted.effects)
    )


def _inexact(fitted: Fitted) -> float:
    return float(believed(fitted.gains.sum(axis=0)).sum())


def _material(ground: Ground, fitted: Fitted, others: dict[tuple[str, ...], Fitted]) -> bool:
    """Whether each effect of a hypothesis is large enough to speak of, and adds to the others."""
    for effect, size in fitted.sizes().items():
        if size < 1:
            return False
        if share(fitted, _without(ground, fitted, effect, others)) < SMALLEST_SHARE:
            return False
    return True


def share(fitted: Fitted, beyond: Fitted) -> float:
    """Largest share of the power of a channel, as the noise model weighs it, that is explained.

    Args:
        fitted: What explains.
        beyond: What has explained some of it already.
    """
    return float(np.max(1 - fitted.left / np.maximum(beyond.left, 1e-300)))


def _verdict(
    ranked: Sequence[Fitted], probabilities: Sequence[float], believable: Mapping[str, float]
) -> Verdict:
    if probabilities[0] < SURE or any(believable[e] < CREDIBLE for e in ranked[0].effects):
        return "cannot_tell"
    return "named" if ranked[0].effects else "nothing"
