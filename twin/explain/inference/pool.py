"""Hypotheses that compete, and where more of them are looked for."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS
from ...physics.sensors.table import BODY, SENSORS
from ..model.numbers import columns_of
from ..settings import DEFAULT, InferenceSettings, LikelihoodSettings, PriorSettings
from .bounds import Bounds
from .fit import Fit, Problem
from .likelihood import Scores, believed
from .search import Hypothesis, search

Array = NDArray[np.float64]
GROUP_OF = {s.component: s.group for s in SENSORS}
"""Group of each component; the others are of the body. Groups share no channel with each other:
each has room for as many effects of its own."""


def pool_of(
    problem: Problem,
    progress: Callable[[float], None] = lambda _: None,
    settings: InferenceSettings = DEFAULT.inference,
) -> "Pool":
    """The hypotheses worth a fit: the best of all combinations of a few effects, what those ask for
    in addition, and look-alikes.

    Args:
        problem: What they are fitted against.
        progress: Called with the share done.
        settings: How many of each kind, and their prices.
    """
    model, counts = problem.model, settings.pool
    numbers = [model.numbers[i] for i in problem.columns]
    scores = Scores(problem.rest, np.array([n.sd for n in numbers]))
    bounds = Bounds.of(numbers, model.vehicle).around(np.array([n.now for n in numbers]))
    chosen = _shortlist(search(scores, numbers, bounds, counts), settings)
    pool = Pool(problem, settings)
    for i, hypothesis in enumerate(chosen):
        pool.add(hypothesis.effects)
        progress(0.1 + 0.5 * (i + 1) / len(chosen))
    for size in range(1, counts.most):
        _grow_size(pool, size)
        progress(0.6 + 0.1 * size / (counts.most - 1))
    for round_ in range(counts.rounds):
        before = pool.best
        if len(worth_a_name(before)) >= counts.most:
            grow(pool, before)
        _exchange(pool)
        progress(0.7 + 0.3 * (round_ + 1) / counts.rounds)
        if pool.best is before:
            break
    return pool


class Pool:
    """Hypotheses at their best, each fitted once.

    Attributes:
        problem: What they are fitted against.
        settings: Prices, and how many are tried.
    """

    def __init__(self, problem: Problem, settings: InferenceSettings = DEFAULT.inference) -> None:
        """Begin with none."""
        self.problem, self.settings = problem, settings
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
        return max(self._competing.values(), key=self.log_posterior)

    def log_posterior(self, fitted: Fit) -> float:
        """Log of the weight of a hypothesis, given that no law is exact."""
        return log_posterior(fitted, self.settings)


def _shortlist(found: Sequence[Hypothesis], settings: InferenceSettings) -> list[Hypothesis]:
    """The best of each size; a larger one only where it beats what it is made of."""
    chosen = [h for h in found if not h.effects]
    best = {h.effects: h.gain for h in found}
    counts = (settings.pool.singles, settings.pool.pairs, settings.pool.triples)
    for size, count in enumerate(counts, start=1):
        taken = 0
        for h in found:
            if len(h.effects) != size or h.gain <= 0:
                continue
            parts = [tuple(e for e in h.effects if e != left) for left in h.effects]
            least = max(best.get(p, 0.0) for p in parts) + settings.prior.per_effect
            if size > 1 and h.gain < least:
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
    prior = pool.settings.prior

    def raw(fitted: Fit) -> float:
        """Log of the weight, every law taken for exact."""
        return fitted.gain + log_prior(fitted, prior)

    best = max((f for f in pool.fitted if len(f.effects) == size), key=raw, default=None)
    if best is None or best.gain < prior.per_effect:
        return
    gains_of, known = _about(pool.problem, best), {f.effects for f in pool.fitted}
    gains = {s: float(gains_of(s).sum()) for s in _larger(pool, best) if s not in known}
    wanted = sorted((s for s in gains if gains[s] > prior.per_effect), key=lambda s: -gains[s])
    for effects in wanted[: pool.settings.pool.grown]:
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
        gain = _with_one_more(pool, best)
        least = _inexact(best, pool.settings.likelihood) + pool.settings.prior.per_effect
        wanted = [s for s in gain if gain[s] > least and without not in s]
        wanted.sort(key=lambda s: -gain[s])
        tried = [pool.add(s) for s in wanted[: pool.settings.pool.exchanged]]
        larger = max(tried, key=pool.log_posterior, default=best)
        if pool.log_posterior(larger) <= pool.log_posterior(best):
            return
        best = larger


def _exchange(pool: Pool) -> None:
    """Look-alikes of the effects of the best hypothesis, each in the place of what it resembles;
    of a large one, what is left without each."""
    best, settings = pool.best, pool.settings
    if len(best.effects) < 2:
        return  # single effects have all been compared
    for effect in best.effects:
        rest = pool.without(best, effect)
        gain = _with_one_more(pool, rest)
        own = gain.pop(best.effects, _inexact(best, settings.likelihood))
        alike = [s for s in gain if gain[s] > own - settings.pool.alike]
        for effects in sorted(alike, key=lambda s: -gain[s])[: settings.pool.exchanged]:
            pool.add(effects)
        pool.add(rest.effects)


def _with_one_more(pool: Pool, fitted: Fit) -> dict[tuple[str, ...], float]:
    """What a hypothesis would gain with each other effect, given that no law is exact."""
    gains_of, so_far = _about(pool.problem, fitted), fitted.gains.sum(axis=0)
    exact = pool.settings.likelihood
    return {s: float(believed(so_far + gains_of(s), exact).sum()) for s in _larger(pool, fitted)}


def _larger(pool: Pool, fitted: Fit) -> list[tuple[str, ...]]:
    """Effects of a hypothesis with one more; trifles take no place."""
    places = dict.fromkeys((*GROUP_OF.values(), BODY), pool.settings.pool.most)
    for effect in worth_a_name(fitted):
        places[_part(effect)] -= 1
    known = pool.problem.model.effects
    more = (e for e in known if e not in fitted.effects and places[_part(e)] > 0)
    return [tuple(sorted((*fitted.effects, e))) for e in more]


def _part(effect: str) -> str:
    return GROUP_OF.get(EFFECTS[effect].component, BODY)


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


def log_prior(fitted: Fit, settings: PriorSettings = DEFAULT.inference.prior) -> float:
    """Log prior odds of a hypothesis against `nothing`, which has none."""
    at_edge = {effect for effect, _ in fitted.edges}
    own = settings.per_effect * len(fitted.effects) + settings.per_number * fitted.told
    return -(own + settings.per_edge * len(at_edge))


def log_posterior(fitted: Fit, settings: InferenceSettings = DEFAULT.inference) -> float:
    """Log of the weight of a hypothesis, given that no law is exact."""
    return _inexact(fitted, settings.likelihood) + log_prior(fitted, settings.prior)


def dominated(
    fitted: Fit, others: Sequence[Fit], settings: InferenceSettings = DEFAULT.inference
) -> bool:
    """Whether fewer effects do as well, given that no law is exact."""
    return any(
        log_posterior(fitted, settings) < log_posterior(f, settings)
        for f in others
        if len(f.effects) < len(fitted.effects)
    )


def _inexact(fitted: Fit, settings: LikelihoodSettings) -> float:
    return float(believed(fitted.gains.sum(axis=0), settings).sum())
