"""Posterior over sets: all that matter about the end of a search, weighed.

The chain of Gibbs (George & McCulloch, J. Am. Stat. Assoc. 88, 1993), with exchanges of one effect
for another (Metropolis), only finds the sets; each one that it meets counts by its evidence, so
that nothing of the draw is left in what is said but which sets were met. Those that differ from the
end by one exchange are all met. What the linearisation gets wrong about an effect of the end is put
right by fitting the set without it again.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Shift, prior_of
from ...representation import short_repr
from .evidence import LaplaceEvidence, MapEstimate
from .fit import Problem, State
from .priors import effect_of

Array = NDArray[np.float64]

Tried = dict[tuple[tuple[str, ...], float], float]
"""Worth of every set that was fitted, by its effects and its days."""


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The end of a search: where it ended, all sets about it, and the log posterior of every set
    that was fitted on the way."""

    state: State
    laplace: LaplaceEvidence
    tried: Tried

    __repr__ = short_repr


def log_prior_of_days(kappa: float) -> float:
    """Log of the weight of days that differ more or less than is usual: normal in the logarithm,
    a factor of e either way."""
    return -0.5 * float(np.log(kappa)) ** 2


def log_posterior(state: State) -> float:
    """Log of the probability of a state, that of its days included."""
    return state.evidence + log_prior_of_days(state.kappa)


def is_time(cause: str) -> bool:
    """Whether a cause moves signals in time: a delay, a clock, a lag."""
    effect = effect_of(cause)
    return isinstance(EFFECTS[effect].observable_as, Shift) or prior_of(EFFECTS[effect]).timed


Set = tuple[str, ...]
SWEEPS = 12
"""Of the chain."""
WINDOW = 12.0
"""Nats below the best set from which on a set does not matter."""
PRUNE_BELOW, PRUNE_ABOVE, PRUNE_AFTER = 7.0, 30.0, 2
"""Nats that an effect costs, or earns, from which on it is asked no more, once it said so twice."""
EXCHANGED = -0.3
"""Correlation of two inclusions from which on one stands for the other."""


@dataclass(frozen=True, slots=True)
class ScoredModel:
    """A set of effects, sorted, its probability among all that matter, and its numbers."""

    effects: Set
    probability: float
    best: MapEstimate

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Posterior:
    """All sets that matter.

    Attributes:
        sets: The most probable first; the first without each of its effects, and with each other
            in its place, is among them, however improbable.
        inclusion: Probability of each effect of the search.
        without: Of each effect of the best set, evidence that it adds, nats, fitted again.
    """

    sets: tuple[ScoredModel, ...]
    inclusion: Mapping[str, float]
    without: Mapping[str, float]

    __repr__ = short_repr

    def exchangeable(self, effect: str) -> tuple[str, ...]:
        """Other effects that are there where this one is not."""
        p = np.array([s.probability for s in self.sets])
        own = np.array([effect in s.effects for s in self.sets], dtype=np.float64)
        found = []
        for other in self.inclusion:
            there = np.array([other in s.effects for s in self.sets], dtype=np.float64)
            if other != effect and _correlation(own, there, p) < EXCHANGED:
                found.append(other)
        return tuple(found)

    def total(self, row: Array, effects: Collection[str]) -> tuple[float, float, float]:
        """What numbers of several effects make together.

        Args:
            row: What each of the numbers of the search counts in it, shape (k,).
            effects: Whose numbers count.

        Returns:
            Probability that one of the effects is there; mean and deviation of the change of the
            sum, over the sets with one of them.
        """
        own = [s for s in self.sets if set(map(effect_of, s.effects)) & set(effects)]
        p = np.array([s.probability for s in own])
        if not own:
            return 0.0, 0.0, 0.0
        change = np.array([row @ s.best.x[: len(row)] for s in own])
        variance = np.array([s.best.variance(row) for s in own])
        share = p / p.sum()
        mean = float(share @ change)
        sd = float(np.sqrt(share @ (variance + (change - mean) ** 2)))
        return float(p.sum()), mean, sd


def weigh(
    problem: Problem,
    found: SearchResult,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
) -> Posterior:
    """Probabilities about the end of a search."""
    laplace, kappa = found.laplace, found.state.kappa
    causes = problem.priors.causes
    met = met_sets(problem, found, np.random.default_rng(seed), progress)
    gained, weights = corrected(met, found)
    first = max(weights, key=lambda k: weights[k])
    near = {k for k in weights if len({*first} - {*k}) == 1 >= len({*k} - {*first})}
    matter = near | {k for k, v in weights.items() if v > weights[first] - WINDOW}
    retained = sorted(matter, key=lambda k: (-weights[k], k))
    share = np.exp([weights[k] - weights[first] for k in retained])
    share = share / share.sum()
    sets = tuple(
        ScoredModel(k, float(p), laplace.best(k, kappa))
        for k, p in zip(retained, share, strict=True)
    )
    inclusion = {e: float(sum(s.probability for s in sets if e in s.effects)) for e in causes}
    return Posterior(sets, inclusion, gained)


class VisitedSets:
    """Sets that were met about one, with their evidence."""

    def __init__(self, laplace: LaplaceEvidence, kappa: float) -> None:
        self._laplace, self._kappa = laplace, kappa
        self.sets: dict[Set, float] = {}

    def evidence(self, effects: Sequence[str]) -> float:
        """Log of the probability of a set, remembered."""
        key = tuple(sorted(effects))
        return self.sets.setdefault(key, self._laplace.best(key, self._kappa).evidence)


def met_sets(
    problem: Problem,
    found: SearchResult,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda _: None,
) -> VisitedSets:
    """Sets that matter about the end of a search: exchanges of one effect, then the chain."""
    laplace, met = found.laplace, VisitedSets(found.laplace, found.state.kappa)
    free = [e for e in problem.priors.causes if not laplace.silent(e) and not is_time(e)]
    on, evidence = list(found.state.effects), met.evidence
    evidence(on)
    for old in on:
        for new in _rivals(laplace, old, on, free):
            evidence([*(a for a in on if a != old), new])
    settled: dict[str, int] = {}
    for sweep in range(SWEEPS):
        open_ = [e for e in free if settled.get(e, 0) < PRUNE_AFTER]
        for e in (open_[i] for i in rng.permutation(len(open_))):
            without = [a for a in on if a != e]
            lead = evidence([*without, e]) - evidence(without)
            settled[e] = settled.get(e, 0) + 1 if lead < -PRUNE_BELOW or lead > PRUNE_ABOVE else 0
            there = rng.random() < 1 / (1 + np.exp(-np.clip(lead, -500, 500)))
            on = [*without, e] if there else without
        for old in list(on):
            rivals = _rivals(laplace, old, on, free)
            if rivals:
                new = rivals[int(rng.integers(len(rivals)))]
                other = [*(a for a in on if a != old), new]
                if np.log(rng.random()) < evidence(other) - evidence(on):
                    on = other
        progress((sweep + 1) / (SWEEPS + 2))
    return met


def corrected(met: VisitedSets, found: SearchResult) -> tuple[dict[str, float], dict[Set, float]]:
    """What each effect of the end adds as fitted, and the evidence of every set with what the
    linearisation gets wrong: about an exchange of effects that was fitted, as much as there; about
    absent effects, but for the share of their lead that others in their place take."""
    end, evidence = found.state.effects, met.evidence
    gained, shift = {}, {}
    for e in end:
        rest = tuple(a for a in end if a != e)
        linear = evidence(end) - evidence(rest)
        fitted = (rest, found.state.kappa) in found.tried
        gained[e] = _gained(found, e, rest) if fitted else linear
        shift[e] = linear - gained[e]
    whole, days = evidence(end), log_prior_of_days(found.state.kappa)
    fitted_sets = [
        (frozenset(k) - {*end}, frozenset(end) - {*k}, evidence(k) - (v - days))
        for (k, kappa), v in found.tried.items()
        if kappa == found.state.kappa and any(not is_time(e) for e in {*k} - {*end})
        if {e for e in k if is_time(e)} == {e for e in end if is_time(e)}
    ]
    fitted_sets.sort(key=lambda f: -len(f[0] | f[1]))

    def weight(effects: Set) -> float:
        """Of one set."""
        new, old = {*effects} - {*end}, {*end} - {*effects}
        for come, gone, wrong in fitted_sets:
            if come <= new and gone <= old:
                return evidence(effects) - wrong
        rest = evidence([e for e in effects if e in shift])
        taken = (evidence(effects) - rest) / (whole - rest) if whole > rest else 0.0
        wrong = sum(v for e, v in shift.items() if e not in effects)
        return evidence(effects) + (1 - min(max(taken, 0.0), 1.0)) * wrong

    return gained, {k: weight(k) for k in [*met.sets]}


def _gained(found: SearchResult, effect: str, rest: Set) -> float:
    """Nats that an effect of the end adds to the others, as fitted; of a delay or a lag, to them
    with any other in its place."""
    others = [found.tried[rest, found.state.kappa]]
    if is_time(effect):
        others += [
            v
            for (k, _), v in found.tried.items()
            if effect not in k and set(rest) <= set(k) and len(k) == len(found.state.effects)
        ]
    return log_posterior(found.state) - max(others)


def _rivals(
    laplace: LaplaceEvidence, old: str, on: Sequence[str], free: Sequence[str]
) -> list[str]:
    """Effects that may stand in the place of one; of clocks and lags, see `_gained`."""
    if old not in free:
        return []
    return [e for e in free if e not in on and laplace.share_a_channel(old, e)]


def _correlation(a: Array, b: Array, p: Array) -> float:
    """Weighted correlation; 0 where one of them is sure."""
    ma, mb = p @ a, p @ b
    va, vb = p @ (a - ma) ** 2, p @ (b - mb) ** 2
    if min(va, vb) < 0.02 * 0.98:
        return 0.0
    return float(p @ ((a - ma) * (b - mb)) / np.sqrt(va * vb))
