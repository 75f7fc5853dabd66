"""Name what a model lacks: one effect, some, none, or a tie that the flights cannot break."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..flightlog import Flight
from ..vehicle import Vehicle
from .evidence import Scores, believed
from .flight_model import in_equations
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
PER_EDGE = 100.0
"""Log prior odds against an effect at the edge of its range: as much as one channel tells that a
law which is not exact explains (`evidence.EXACT`)."""
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
"""Effects together that are searched for in all their combinations; sets of one more that are tried
after each of the best."""
ROUNDS = 3
"""Times at most that the best set is grown and its effects are exchanged."""
APART = ("magnetometer", "barometer")
"""Components that share no channel with the others: each has room for `MOST` effects of its own."""
BODY = "body"
CHECKED = 0.02
"""Probability from which on a hypothesis is held against the rules."""
ALIKE, EXCHANGED = 10.0, 2
"""Log likelihood, given that no law is exact, up to which an effect resembles another; how many
such are tried in the place of each."""
SINGLES, PAIRS, TRIPLES = 8, 6, 3
"""Hypotheses of each size that are fitted at their own best."""


@dataclass(frozen=True, slots=True)
class Naming:
    """What the flights say about a model.

    Attributes:
        fitted: Hypotheses at their best, most probable first, `nothing` among them.
        probabilities: Of each.
        shares: Largest share of the power of a channel that each explains.
        credible: Of the effects of likely hypotheses, the probability that their cause is of the
            library at all, see `misfit`.
        ground: What they were fitted against.
    """

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
        return self.together([effect])

    @property
    def verdict(self) -> Verdict:
        """In a word: something is named where one effect is sure, whatever else is not."""
        if not self.best.effects:
            return "nothing" if self.probabilities[0] >= SURE else "cannot_tell"
        return "cannot_tell" if self.undecided == self.best.effects else "named"

    @property
    def undecided(self) -> tuple[str, ...]:
        """Effects of the most probable hypothesis that are not sure."""
        return tuple(e for e in self.best.effects if not self._is_sure(e))

    def _is_sure(self, effect: str) -> bool:
        believable = self.credible[effect]
        return believable >= CREDIBLE and self.together([effect]) >= SURE * believable

    @property
    def sure(self) -> bool:
        """Whether there is nothing left to tell apart."""
        return self.verdict != "cannot_tell" and not self.undecided

    def together(self, effects: Collection[str]) -> float:
        """That some effects are missing, all of them, and each cause is of the library."""
        pairs = zip(self.fitted, self.probabilities, strict=True)
        among = float(sum(p for f, p in pairs if set(effects) <= set(f.effects)))
        return among * math.prod(self.credible.get(e, 1.0) for e in effects)

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
    pool = Pool(ground)
    for i, hypothesis in enumerate(chosen):
        pool.add(hypothesis.effects)
        progress(0.3 + 0.4 * (i + 1) / len(chosen))
    for size in range(1, MOST):
        _grow_size(pool, size)
        progress(0.7 + 0.1 * size / (MOST - 1))
    for round_ in range(ROUNDS):
        before = pool.best
        if len(worth_a_name(before)) >= MOST:
            _grow(pool, before)
        _exchange(pool)
        progress(0.8 + 0.2 * (round_ + 1) / ROUNDS)
        if pool.best is before:
            break
    chance = _weighed(pool, seed)
    fitted = pool.fitted
    order = np.argsort(-chance)
    ranked = tuple(fitted[i] for i in order)
    probabilities = tuple(float(chance[i]) for i in order)
    likely = [f for f, p in zip(ranked, probabilities, strict=True) if p >= LEAST]
    return Naming(
        ranked,
        probabilities,
        tuple(share(f, ground.nothing()) for f in ranked),
        _credible(pool, likely),
        ground,
    )


class Pool:
    """Hypotheses at their best, each fitted once.

    Attributes:
        ground: What they are fitted against.
        fitted: Those that compete.
    """

    def __init__(self, ground: Ground) -> None:
        """Begin with none."""
        self.ground = ground
        self.fitted: list[Fitted] = []
        self._known: dict[tuple[str, ...], Fitted] = {}

    def fit(self, effects: Sequence[str]) -> Fitted:
        """A hypothesis, whether it competes or not."""
        key = tuple(sorted(effects))
        if key not in self._known:
            self._known[key] = self.ground.fit(key)
        return self._known[key]

    def add(self, effects: Sequence[str]) -> Fitted:
        """Let a hypothesis compete."""
        made = self.fit(effects)
        if made not in self:
            self.fitted.append(made)
        return made

    def without(self, fitted: Fitted, effect: str) -> Fitted:
        """A hypothesis without one of its effects."""
        return self.fit([e for e in fitted.effects if e != effect])

    def __contains__(self, hypothesis: object) -> bool:
        """Whether a hypothesis competes."""
        return any(f is hypothesis for f in self.fitted)

    @property
    def best(self) -> Fitted:
        """The one worth most."""
        return max(self.fitted, key=_worth)


def _weighed(pool: Pool, seed: int) -> Array:
    """Probabilities of what competes; what is likely is held against the rules first."""
    out: dict[tuple[str, ...], bool] = {}
    while True:
        fitted = [*pool.fitted]
        allowed = [f for f in fitted if not out.get(f.effects)]
        ruled_out = [out.get(f.effects, False) or _needless(f, allowed) for f in fitted]
        prior = -np.array([_price(f) for f in fitted]) - IMPOSSIBLE * np.array(ruled_out)
        chance = weights([Hypothesis(f.effects, f.gains) for f in fitted], prior, seed)
        likely = [fitted[i] for i in np.argsort(-chance) if chance[i] >= CHECKED]
        new = next((f for f in likely if f.effects not in out), None)
        if new is None:
            return _without_trifles(fitted, chance)
        pool.add(worth_a_name(new))
        out[new.effects] = (
            _spoils(new, pool.ground) or not _material(pool, new) or _hangs(pool, new)
        )


def worth_a_name(fitted: Fitted) -> tuple[str, ...]:
    """Effects of a hypothesis that are large enough to speak of."""
    sizes = fitted.sizes()
    return tuple(e for e in fitted.effects if sizes[e] >= 1)


def _without_trifles(fitted: Sequence[Fitted], chance: Array) -> Array:
    """Probabilities given to the names alone: a delay below a sample may stand in a hypothesis, so
    that nothing else has to stand in for it."""
    place = {f.effects: i for i, f in enumerate(fitted)}
    given = np.zeros_like(chance)
    for f, p in zip(fitted, chance, strict=True):
        given[place.get(worth_a_name(f), place[f.effects])] += p
    return given


def _hangs(pool: Pool, fitted: Fitted) -> bool:
    """Whether one of several effects is not credible; then the others compete without it.

    A name must not hang on one beside it that leaves what it should explain.
    """
    believable = {e: p for e, p in _credible(pool, [fitted]).items() if e in worth_a_name(fitted)}
    if len(believable) < 2 or min(believable.values()) >= CREDIBLE:
        return False
    worst = min(believable, key=lambda e: believable[e])
    rest = pool.add(pool.without(fitted, worst).effects)
    if len(fitted.effects) > MOST:
        _grow(pool, rest, worst)
    return True


def _credible(pool: Pool, likely: Sequence[Fitted]) -> dict[str, float]:
    """Of each effect, in the most probable hypothesis with it, what `misfit.credible` says."""
    found: dict[str, float] = {}
    for fitted in likely:
        left = misfits(
            pool.ground.model, fitted, {e: pool.without(fitted, e) for e in fitted.effects}
        )
        found = {e: credible(m) for e, m in left.items()} | found
    return found


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


def _grow_size(pool: Pool, size: int) -> None:
    """Add to the best hypothesis of a size what its own surroundings ask for.

    The first search is linear about the model as it stands. About a hypothesis at its best, what
    one more effect would gain looks different.
    """
    best = max((f for f in pool.fitted if len(f.effects) == size), key=_raw, default=None)
    if best is None or best.gain < PER_EFFECT:
        return
    gains_of, known = _about(pool.ground, best), {f.effects for f in pool.fitted}
    gains = {s: float(gains_of(s).sum()) for s in _larger(pool.ground, best) if s not in known}
    wanted = sorted((s for s in gains if gains[s] > PER_EFFECT), key=lambda s: -gains[s])
    for effects in wanted[:GROWN]:
        pool.add(effects)


def _grow(pool: Pool, best: Fitted, without: str | None = None) -> None:
    """Add effects to a hypothesis one by one, while that pays.

    An aircraft that nobody has calibrated lacks more than three effects, most of them in sensors
    that have nothing to do with each other.

    Args:
        pool: What competes.
        best: To grow from.
        without: An effect not to add.
    """
    while True:
        gain = _with_one_more(pool.ground, best)
        least = _inexact(best) + PER_EFFECT
        wanted = [s for s in gain if gain[s] > least and without not in s]
        wanted.sort(key=lambda s: -gain[s])
        larger = max((pool.add(s) for s in wanted[:EXCHANGED]), key=_worth, default=best)
        if _worth(larger) <= _worth(best):
            return
        best = larger


def _exchange(pool: Pool) -> None:
    """Look-alikes of the effects of the best hypothesis, each in the place of what it resembles;
    of a large one, what is left without each."""
    best = pool.best
    if len(best.effects) < 2:
        return  # single effects have all been compared
    for effect in best.effects:
        rest = pool.without(best, effect)
        gain = _with_one_more(pool.ground, rest)
        alike = [s for s in gain if s != best.effects and gain[s] > gain[best.effects] - ALIKE]
        for effects in sorted(alike, key=lambda s: -gain[s])[:EXCHANGED]:
            pool.add(effects)
        pool.add(rest.effects)


def _with_one_more(ground: Ground, fitted: Fitted) -> dict[tuple[str, ...], float]:
    """What a hypothesis would gain with each other effect, given that no law is exact."""
    gains_of, so_far = _about(ground, fitted), fitted.gains.sum(axis=0)
    return {s: float(believed(so_far + gains_of(s)).sum()) for s in _larger(ground, fitted)}


def _larger(ground: Ground, fitted: Fitted) -> list[tuple[str, ...]]:
    """Effects of a hypothesis with one more; trifles take no place."""
    room = {c: MOST for c in (*APART, BODY)}
    for effect in worth_a_name(fitted):
        room[_part(effect)] -= 1
    more = (e for e in ground.model.effects if e not in fitted.effects and room[_part(e)] > 0)
    return [tuple(sorted((*fitted.effects, e))) for e in more]


def _part(effect: str) -> str:
    component = EFFECTS[effect].component
    return component if component in APART else BODY


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


def _spoils(fitted: Fitted, ground: Ground) -> bool:
    """Whether a channel is left clearly worse than without any effect.

    White noise hardly counts what is slow: an offset that a hypothesis brings in.
    """
    return bool(np.any(fitted.raw > SPOILT * ground.raw))


def _raw(fitted: Fitted) -> float:
    return fitted.gain - _price(fitted)


def _price(fitted: Fitted) -> float:
    """Log prior odds against a hypothesis."""
    at_edge = {effect for effect, _ in fitted.edges}
    own = PER_EFFECT * len(fitted.effects) + PER_NUMBER * fitted.told
    return own + PER_EDGE * len(at_edge)


def _worth(fitted: Fitted) -> float:
    """Log of the weight of a hypothesis, given that no law is exact."""
    return _inexact(fitted) - _price(fitted)


def _needless(fitted: Fitted, others: Sequence[Fitted]) -> bool:
    """Whether fewer effects do as well, given that no law is exact."""
    return any(_worth(fitted) < _worth(f) for f in others if len(f.effects) < len(fitted.effects))


def _inexact(fitted: Fitted) -> float:
    return float(believed(fitted.gains.sum(axis=0)).sum())


def _material(pool: Pool, fitted: Fitted) -> bool:
    """Whether each effect of a hypothesis is large enough to speak of, and adds to the others.

    Every log has its delays below a sample: they are allowed, but no names.
    """
    names = worth_a_name(fitted)
    if any(in_equations(EFFECTS[e]) for e in fitted.effects if e not in names):
        return False
    return all(share(fitted, pool.without(fitted, e)) >= SMALLEST_SHARE for e in names)


def share(fitted: Fitted, beyond: Fitted) -> float:
    """Largest share of the power of a channel, as the noise model weighs it, that is explained.

    Args:
        fitted: What explains.
        beyond: What has explained some of it already.
    """
    return float(np.max(1 - fitted.left / np.maximum(beyond.left, 1e-300)))
