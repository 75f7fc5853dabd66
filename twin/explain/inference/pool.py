"""Hypotheses that compete, and where more of them are looked for."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS
from ..model.numbers import columns_of
from .bounds import Bounds
from .fit import Fit, Problem
from .likelihood import Scores, believed
from .search import Hypothesis, search

Array = NDArray[np.float64]
PER_EFFECT = 6.0
"""Log prior odds against one more effect: one of forty, and seldom more than one at once."""
PER_NUMBER = 1.5
"""Log prior odds against one more number that the flights tell."""
PER_EDGE = 100.0
"""Log prior odds against an effect at the edge of its range: as much as one channel tells that a
law which is not exact explains (`evidence.EXACT`)."""
MOST, GROWN = 3, 3
"""Effects together that are searched for in all their combinations; sets of one more that are tried
after each of the best."""
ROUNDS = 3
"""Times at most that the best set is grown and its effects are exchanged."""
APART = ("magnetometer", "barometer")
"""Components that share no channel with the others: each has room for `MOST` effects of its own."""
BODY = "body"
ALIKE, EXCHANGED = 10.0, 2
"""Log likelihood, given that no law is exact, up to which an effect resembles another; how many
such are tried in the place of each."""
SINGLES, PAIRS, TRIPLES = 8, 6, 3
"""Hypotheses of each size that are fitted at their own best."""


def pool_of(problem: Problem, progress: Callable[[float], None] = lambda _: None) -> "Pool":
    """The hypotheses worth a fit: the best of all combinations of a few effects, what those ask for
    in addition, and look-alikes.

    Args:
        problem: What they are fitted against.
        progress: Called with the share done.
    """
    model = problem.model
    numbers = [model.numbers[i] for i in problem.columns]
    scores = Scores(problem.rest, np.array([n.sd for n in numbers]))
    bounds = Bounds.of(numbers, model.vehicle).around(np.array([n.now for n in numbers]))
    chosen = _shortlist(search(scores, numbers, bounds, most=MOST))
    pool = Pool(problem)
    for i, hypothesis in enumerate(chosen):
        pool.add(hypothesis.effects)
        progress(0.1 + 0.5 * (i + 1) / len(chosen))
    for size in range(1, MOST):
        _grow_size(pool, size)
        progress(0.6 + 0.1 * size / (MOST - 1))
    for round_ in range(ROUNDS):
        before = pool.best
        if len(worth_a_name(before)) >= MOST:
            grow(pool, before)
        _exchange(pool)
        progress(0.7 + 0.3 * (round_ + 1) / ROUNDS)
        if pool.best is before:
            break
    return pool


class Pool:
    """Hypotheses at their best, each fitted once.

    Attributes:
        problem: What they are fitted against.
    """

    def __init__(self, problem: Problem) -> None:
        """Begin with none."""
        self.problem = problem
        self._known: dict[tuple[str, ...], Fit] = {}
        self._competing: dict[tuple[str, ...], Fit] = {}

    @property
    def fitted(self) -> list[Fit]:
        """Those that compete, in the order in which they were added."""
        return list(self._competing.values())

    def fit(self, effects: Sequence[str]) -> Fit:
        """A hypothesis, whether it competes or not."""
        key = tuple(sorted(effects))
        if key not in self._known:
            self._known[key] = self.problem.fit(key)
        return self._known[key]

    def add(self, effects: Sequence[str]) -> Fit:
        """Let a hypothesis compete."""
        made = self.fit(effects)
        return self._competing.setdefault(made.effects, made)

    def without(self, fitted: Fit, effect: str) -> Fit:
        """A hypothesis without one of its effects."""
        return self.fit([e for e in fitted.effects if e != effect])

    @property
    def best(self) -> Fit:
        """The one worth most."""
        return max(self._competing.values(), key=log_posterior)


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
    gains_of, known = _about(pool.problem, best), {f.effects for f in pool.fitted}
    gains = {s: float(gains_of(s).sum()) for s in _larger(pool.problem, best) if s not in known}
    wanted = sorted((s for s in gains if gains[s] > PER_EFFECT), key=lambda s: -gains[s])
    for effects in wanted[:GROWN]:
        pool.add(effects)


def grow(pool: Pool, best: Fit, without: str | None = None) -> None:
    """Add effects to a hypothesis one by one, while that pays.

    An aircraft that nobody has calibrated lacks more than three effects, most of them in sensors
    that have nothing to do with each other.

    Args:
        pool: What competes.
        best: To grow from.
        without: An effect not to add.
    """
    while True:
        gain = _with_one_more(pool.problem, best)
        least = _inexact(best) + PER_EFFECT
        wanted = [s for s in gain if gain[s] > least and without not in s]
        wanted.sort(key=lambda s: -gain[s])
        larger = max((pool.add(s) for s in wanted[:EXCHANGED]), key=log_posterior, default=best)
        if log_posterior(larger) <= log_posterior(best):
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
        gain = _with_one_more(pool.problem, rest)
        own = gain.pop(best.effects, _inexact(best))
        alike = [s for s in gain if gain[s] > own - ALIKE]
        for effects in sorted(alike, key=lambda s: -gain[s])[:EXCHANGED]:
            pool.add(effects)
        pool.add(rest.effects)


def _with_one_more(problem: Problem, fitted: Fit) -> dict[tuple[str, ...], float]:
    """What a hypothesis would gain with each other effect, given that no law is exact."""
    gains_of, so_far = _about(problem, fitted), fitted.gains.sum(axis=0)
    return {s: float(believed(so_far + gains_of(s)).sum()) for s in _larger(problem, fitted)}


def _larger(problem: Problem, fitted: Fit) -> list[tuple[str, ...]]:
    """Effects of a hypothesis with one more; trifles take no place."""
    places = {c: MOST for c in (*APART, BODY)}
    for effect in worth_a_name(fitted):
        places[_part(effect)] -= 1
    more = (e for e in problem.model.effects if e not in fitted.effects and places[_part(e)] > 0)
    return [tuple(sorted((*fitted.effects, e))) for e in more]


def _part(effect: str) -> str:
    component = EFFECTS[effect].component
    return component if component in APART else BODY


def _about(problem: Problem, fitted: Fit) -> Callable[[Sequence[str]], Array]:
    """What effects gain by channel, beyond a hypothesis, by numbers near its own."""
    scores, model = problem.around(fitted), problem.model
    numbers = [model.numbers[i] for i in problem.columns]
    now = np.array([fitted.values.get(n.full, n.now) for n in numbers])
    bounds = Bounds.of(numbers, model.vehicle).around(now)

    def gains(effects: Sequence[str]) -> Array:
        """Shape (channels,)."""
        columns = columns_of(numbers, effects)
        return np.asarray(scores.gains(columns, bounds.part(columns)).sum(axis=0))

    return gains


def worth_a_name(fitted: Fit) -> tuple[str, ...]:
    """Effects of a hypothesis that are large enough to speak of."""
    sizes = fitted.sizes()
    return tuple(e for e in fitted.effects if sizes[e] >= 1)


def _raw(fitted: Fit) -> float:
    return fitted.gain + log_prior(fitted)


def log_prior(fitted: Fit) -> float:
    """Log prior odds of a hypothesis against `nothing`, which has none."""
    at_edge = {effect for effect, _ in fitted.edges}
    own = PER_EFFECT * len(fitted.effects) + PER_NUMBER * fitted.told
    return -(own + PER_EDGE * len(at_edge))


def log_posterior(fitted: Fit) -> float:
    """Log of the weight of a hypothesis, given that no law is exact."""
    return _inexact(fitted) + log_prior(fitted)


def dominated(fitted: Fit, others: Sequence[Fit]) -> bool:
    """Whether fewer effects do as well, given that no law is exact."""
    return any(
        log_posterior(fitted) < log_posterior(f)
        for f in others
        if len(f.effects) < len(fitted.effects)
    )


def _inexact(fitted: Fit) -> float:
    return float(believed(fitted.gains.sum(axis=0)).sum())
