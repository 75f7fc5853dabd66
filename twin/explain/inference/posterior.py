"""Posterior over candidate models: all relevant ones near the end of a search, weighted by
evidence.

The Gibbs chain (George & McCulloch, J. Am. Stat. Assoc. 88, 1993), with Metropolis exchanges of one
effect for another, only generates candidate models; each visited one is weighted by its evidence,
so sampling influences only which ones were visited. All models that differ from the final one by
one exchange are visited. Linearisation errors about an effect of the final model are corrected by
refitting without it.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...effects import EFFECTS, Shift, prior_of
from ...representation import ShortRepr
from ...residuals.channels import Array
from .evidence import LaplaceEvidence, MapEstimate
from .fit import Problem, State
from .priors import effect_of

Tried = dict[tuple[tuple[str, ...], float], float]
"""Log posterior of every candidate model that was fitted, by its effects and the factor on
day-to-day variation."""


@dataclass(frozen=True, slots=True)
class SearchResult(ShortRepr):
    """Result of a search: the final state, the linearisation about it, and the log posterior of
    every candidate model that was fitted."""

    state: State
    laplace: LaplaceEvidence
    tried: Tried


def log_prior_of_days(kappa: float) -> float:
    """Log prior of the factor on day-to-day variation: log-normal with standard deviation 1."""
    return -0.5 * float(np.log(kappa)) ** 2


def log_posterior(state: State) -> float:
    """Log posterior, including the prior on between-flight variance."""
    return state.evidence + log_prior_of_days(state.kappa)


def is_time(cause: str) -> bool:
    """Whether a cause shifts signals in time: a delay, a clock, a lag."""
    effect = effect_of(cause)
    return isinstance(EFFECTS[effect].observable_as, Shift) or prior_of(EFFECTS[effect]).timed


Set = tuple[str, ...]
SWEEPS = 12
"""Number of sweeps of the Gibbs chain."""
WINDOW = 12.0
"""Difference in log posterior from the best candidate model, nats, beyond which one is
neglected."""
PRUNE_BELOW, PRUNE_ABOVE, PRUNE_AFTER = 7.0, 30.0, 2
"""Loss or gain by an effect, nats, beyond which it is not sampled any more, after so many such
samples."""
EXCHANGED = -0.3
"""Correlation of two inclusions below which one effect replaces the other."""


@dataclass(frozen=True, slots=True)
class ScoredModel(ShortRepr):
    """A candidate model, with sorted effects, its posterior probability, and its numbers."""

    effects: Set
    probability: float
    best: MapEstimate


@dataclass(frozen=True, slots=True)
class Posterior(ShortRepr):
    """Posterior over candidate models.

    Attributes:
        sets: Candidate models, the most probable first; they include the first one without each of
            its effects, and with each possible replacement, however improbable.
        inclusion: Posterior probability of each effect of the search.
        without: Log evidence gained by each effect of the most probable model, nats, after
            refitting without it.
    """

    sets: tuple[ScoredModel, ...]
    inclusion: Mapping[str, float]
    without: Mapping[str, float]

    def exchangeable(self, effect: str) -> tuple[str, ...]:
        """Effects that are alternatives to this one."""
        p = np.array([s.probability for s in self.sets])
        others = (effect, *(e for e in self.inclusion if e != effect))
        own, *rest = (np.array([float(e in s.effects) for s in self.sets]) for e in others)
        pairs = zip(others[1:], rest, strict=True)
        return tuple(e for e, there in pairs if _correlation(own, there, p) < EXCHANGED)

    def total(self, row: Array, effects: Collection[str]) -> tuple[float, float, float]:
        """Posterior of the sum of several effects' numbers.

        Args:
            row: Weight of each number of the search in the sum, shape (k,).
            effects: Effects whose numbers are summed.

        Returns:
            Probability that at least one of the effects is present; mean and standard deviation of
            the change of the sum, over the models with one of them.
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
    """Posterior about the final state of a search."""
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
    """Visited candidate models near the final one, with their evidence."""

    def __init__(self, laplace: LaplaceEvidence, kappa: float) -> None:
        self._laplace, self._kappa = laplace, kappa
        self.sets: dict[Set, float] = {}

    def evidence(self, effects: Sequence[str]) -> float:
        """Log posterior of a candidate model, cached."""
        key = tuple(sorted(effects))
        return self.sets.setdefault(key, self._laplace.best(key, self._kappa).evidence)


def met_sets(
    problem: Problem,
    found: SearchResult,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda _: None,
) -> VisitedSets:
    """Relevant candidate models near the final state: exchanges of one effect, then the Gibbs
    chain."""
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
    """Gain by each effect of the final model as fitted, and the evidence of every model corrected
    for linearisation errors: about a fitted exchange, by the error there; about absent effects,
    except for the share of their lead that replacements take."""
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
        """Corrected log posterior of one candidate model."""
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
    """Gain of an effect of the final model beside the others, as fitted, nats; for a delay or a
    lag, the least over the models with a replacement."""
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
    """Possible replacements of an effect; for clocks and lags, see `_gained`."""
    if old not in free:
        return []
    return [e for e in free if e not in on and laplace.share_a_channel(old, e)]


def _correlation(a: Array, b: Array, p: Array) -> float:
    """Weighted correlation; 0 where one of them is constant."""
    ma, mb = p @ a, p @ b
    va, vb = p @ (a - ma) ** 2, p @ (b - mb) ** 2
    if min(va, vb) < 0.02 * 0.98:
        return 0.0
    return float(p @ ((a - ma) * (b - mb)) / np.sqrt(va * vb))
