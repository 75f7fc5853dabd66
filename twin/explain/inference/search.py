"""Look for the set of effects that flights make most probable, from several starts.

Gains of sets are told by one linearisation; each move is fitted again before it is accepted. A move
adds an effect, drops one or two, or puts one in the place of another; days may turn out to differ
more or less than is usual. Where several moves in a row promise more, they are tried together
first.

*Posterior*: all sets that matter about the end of a search, weighed. The chain of Gibbs (George &
McCulloch, J. Am. Stat. Assoc. 88, 1993), with exchanges of one effect for another (Metropolis),
only finds the sets; each one that it meets counts by its evidence, so that nothing of the draw is
left in what is said but which sets were met. Those that differ from the end by one exchange are all
met. What the linearisation gets wrong about an effect of the end is put right by fitting the set
without it again.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Shift, prior_of
from ...effects.parameters import LAST, UNMEASURED
from ...representation import short_repr
from .evidence import LaplaceEvidence, MapEstimate
from .fit import Problem, State, gained_by_following
from .priors import Priors, effect_of

Array = NDArray[np.float64]

Tried = dict[tuple[tuple[str, ...], float], float]
"""Worth of every set that was fitted, by its effects and its days."""
MOVES, TRIED, AHEAD, RIVALS = 60, 4, 8, 4
"""Accepted moves at most; of each state so many are fitted; looked ahead; swapped in."""
FEW = 8
"""Effects of a set up to which two are dropped at once: they may stand for a third together."""
CLEAR = 15.0
"""Nats that the linearisation gives an effect from which on it is not fitted without it again."""
MIN_GAIN = 0.3
"""Nats that a move has to gain."""
SHORT = 3.0
"""Nats that a fit has to have ended below what is promised, or beside another end of the same set,
to be done again."""


@dataclass(frozen=True, slots=True)
class Move:
    """A neighbour.

    Attributes:
        effects: Identifiers, sorted.
        kappa: Of the days.
        gain: That the linearisation promises, nats.
    """

    effects: tuple[str, ...]
    kappa: float
    gain: float


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The end of a search.

    Attributes:
        state: Where it ended.
        laplace: All sets about it.
        tried: Evidence of every set that was fitted on the way.
    """

    state: State
    laplace: LaplaceEvidence
    tried: Tried

    __repr__ = short_repr


def log_prior_of_days(kappa: float) -> float:
    """Log of the weight of days that differ more or less than is usual: normal in the logarithm,
    a factor of e either way."""
    return -0.5 * float(np.log(kappa)) ** 2


def search(
    problem: Problem,
    start: Sequence[str],
    kappa: float = 1.0,
    progress: Callable[[float], None] = lambda _: None,
) -> SearchResult:
    """Climb from a set.

    Args:
        problem: What is fitted.
        start: Effects that are there at first.
        kappa: Of the days at first.
        progress: Called with the share done, roughly.
    """
    return search_on(problem, problem.start(start, kappa), progress)


def search_on(
    problem: Problem, state: State, progress: Callable[[float], None] = lambda _: None
) -> SearchResult:
    """The same from a set that is fitted already."""
    tried = {(state.effects, state.kappa): log_posterior(state)}
    begun: set[tuple[str, ...]] = set()
    again: set[tuple[tuple[str, ...], float]] = set()
    laplace = problem.linearised(state)
    for n in range(MOVES):
        progress(1 - 0.9**n)
        better = (
            _better(problem, laplace, state, tried, again)
            or _followed(problem, laplace, state, tried, begun, MIN_GAIN)
            or _verified(problem, laplace, state, tried, _without_clocks(state))
            or _verified(problem, laplace, state, tried, _clocks(problem, laplace, state))
            or _verified(problem, laplace, state, tried, _weak(laplace, state))
            or _verified(problem, laplace, state, tried, _alone(state))
            or _verified(problem, laplace, state, tried, _mistaken(problem, state))
            or _verified(problem, laplace, state, {}, _mounted(problem, laplace, state))
            or _restarted(problem, state, tried, begun)
            or _followed(problem, laplace, state, tried, begun, -np.inf)
        )
        if better is None:
            break
        state = better
        laplace = problem.linearised(state)
    return SearchResult(state, laplace, tried)


def with_instruments_of_end(
    problem: Problem,
    found: SearchResult,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[Problem, SearchResult]:
    """A search, gone on with where its instruments are trusted otherwise once its effects are in.

    Args:
        problem: What was fitted.
        found: Its end.
        progress: Called with the share done.
    """
    renewed = problem.with_instruments_at(found.state)
    if renewed.noise.trusts_as(problem.noise):
        return problem, found
    end = found.state
    state = renewed.settle(end.effects, end.kappa, found.laplace.spectrum, end.best.x)
    return renewed, search_on(renewed, state, progress)


def log_posterior(state: State) -> float:
    """Log of the probability of a state, that of its days included."""
    return state.evidence + log_prior_of_days(state.kappa)


def score_test_candidates(problem: Problem) -> tuple[str, ...]:
    """Effects that the model as it stands asks for, each the best by its linearisation."""
    laplace = problem.laplace(problem.rest)
    first = neighbours(problem, laplace, (), 1.0)
    ahead = _ahead(problem, laplace, (), first)
    return first[0].effects if ahead is None and first else () if ahead is None else ahead.effects


def calibration_start(priors: Priors) -> list[str]:
    """Effects whose numbers nobody measures, the delay that no aircraft is without, and the average
    that most estimates of a pose are."""
    return [
        c
        for c in priors.causes
        if priors.odds[c] >= UNMEASURED or prior_of(EFFECTS[effect_of(c)]).start
    ]


def _better(
    problem: Problem,
    laplace: LaplaceEvidence,
    state: State,
    tried: Tried,
    again: set[tuple[tuple[str, ...], float]],
) -> State | None:
    """A neighbour that is better once it is fitted; None where there is none.

    One that was fitted already, and ended lower than is promised now, is fitted once again: what a
    fit reaches depends on where it begins.
    """
    candidates = neighbours(problem, laplace, state.effects, state.kappa)
    ahead = _ahead(problem, laplace, state.effects, candidates)
    queue = [*([ahead] if ahead else []), *_different(candidates, state.effects)]
    fitted = 0
    for move in queue:
        key = move.effects, move.kappa
        if key in tried:
            if key in again or tried[key] > log_posterior(state) + move.gain - SHORT:
                continue
            again.add(key)
        there = problem.settle(move.effects, move.kappa, laplace.spectrum, state.best.x)
        tried[key] = max(log_posterior(there), tried.get(key, -np.inf))
        if log_posterior(there) > log_posterior(state) + MIN_GAIN:
            return there
        fitted += 1
        if fitted == TRIED:
            break
    return None


def _restarted(
    problem: Problem, state: State, tried: Tried, begun: set[tuple[str, ...]]
) -> State | None:
    """The set itself from what is expected of its numbers, once: on the way numbers of days may
    have stood in for what was not there yet, and stay where they are."""
    if state.effects in begun:
        return None
    begun.add(state.effects)
    there = problem.start(state.effects, state.kappa)
    if log_posterior(there) <= log_posterior(state) + SHORT:
        return None
    tried[state.effects, state.kappa] = log_posterior(there)
    return there


def _different(moves: Sequence[Move], on: Sequence[str]) -> Iterator[Move]:
    """The best move of each effect that comes in, and those by which none does."""
    seen = set()
    for m in moves:
        new = frozenset(m.effects) - frozenset(on)
        if not new or new not in seen:
            yield m
        seen.add(new)


Trial = tuple[tuple[str, ...], Array | None]
"""A set, and the numbers to begin with; None: those of the state."""


def _without_clocks(state: State) -> list[Trial]:
    """The set without each delay or lag: where it is not missed, no other is sought for it."""
    return [(tuple(a for a in state.effects if a != e), None) for e in state.effects if is_time(e)]


def _clocks(problem: Problem, laplace: LaplaceEvidence, state: State) -> list[Trial]:
    """The set with any other delay or lag in the place of each.

    What moves signals in time is not linear over a few milliseconds, so that no linearisation tells
    which is meant. A record of several clocks is thought of last: they come in as other effects do.
    """
    present = [e for e in state.effects if is_time(e)]
    every = [e for e in problem.priors.causes if is_time(e)]
    odds = problem.priors.odds
    absent = [e for e in every if e not in state.effects and odds[e] > LAST]
    sets: list[Trial] = []
    for old in present:
        rest = tuple(e for e in state.effects if e != old)
        known = [e for e in absent if laplace.share_a_channel(old, e) and not laplace.silent(e)]
        x = state.best.x
        sets += [(tuple(sorted((*rest, c))), _with_expected(problem, x, c)) for c in known]
    return sets


def _weak(laplace: LaplaceEvidence, state: State) -> list[Trial]:
    """The set without each effect that adds little by the linearisation."""
    whole = laplace.best(state.effects, state.kappa).evidence
    sets: list[Trial] = []
    for old in (e for e in state.effects if not is_time(e)):
        rest = tuple(e for e in state.effects if e != old)
        if whole - laplace.best(rest, state.kappa).evidence < CLEAR:
            sets.append((rest, None))
    return sets


def _alone(state: State) -> list[Trial]:
    """The set with one rotor in the place of several: opposite ones share what one of them does,
    together with the place of the centre of mass."""
    sets: list[Trial] = []
    for effect in dict.fromkeys(effect_of(c) for c in state.effects):
        own = [c for c in state.effects if effect_of(c) == effect and not is_time(c)]
        if len(own) > 1:
            rest = [c for c in state.effects if c not in own]
            sets += [(tuple(sorted((*rest, c))), None) for c in own]
    return sets


def _mistaken(problem: Problem, state: State) -> list[Trial]:
    """The set with each part of an effect by itself, as it is expected, in the place of one effect
    that it is mistaken for.

    A weak rotor lifts less and turns the aircraft, as a smaller thrust and another place of the
    centre of mass do together, were it that of the day. How much torque it loses with its thrust is
    no linear number while it loses none: where both stand in for it, the linearisation rules it out
    by its torque. Either may be there as well.
    """
    on = {effect_of(c) for c in state.effects}
    sets: list[Trial] = []
    for c in problem.priors.causes:
        if effect_of(c) in on:
            continue
        for other in EFFECTS[effect_of(c)].mistaken_for:
            if other in on:
                rest = [e for e in state.effects if e != other]
                x = _with_expected(problem, state.best.x, c)
                sets.append((tuple(sorted((*rest, c))), x))
    return sets


def _followed(
    problem: Problem,
    laplace: LaplaceEvidence,
    state: State,
    tried: Tried,
    begun: set[tuple[str, ...]],
    least: float,
) -> State | None:
    """The set with an effect whose states an observer follows, if it promises at least so many nats
    beside what it gains by following noise; None where none is better.

    Its states are far from linear in its shape, so that the linearisation, held against that, would
    rule it out too soon. They follow what no other effect explains, so that they follow little
    where others stand in for this one already: all numbers begin as they are expected, beside all
    other effects; where it is there already, too, beside those alone that are not felt where it is.
    `begun` holds the sets that began so.
    """
    best = state
    for c in problem.priors.causes:
        if EFFECTS[effect_of(c)].observer is None:
            continue
        on = tuple(sorted({*state.effects, c}))
        promised = laplace.best(on, state.kappa).evidence - state.evidence
        noise = gained_by_following(c, problem.rest, problem.noise.bands)
        if c not in state.effects and promised + noise <= least:
            continue
        apart = tuple(e for e in on if e == c or not laplace.share_a_channel(e, c))
        for trial in dict.fromkeys((on, apart) if c in state.effects else (on,)):
            if trial in begun:
                continue
            begun.add(trial)
            there = problem.start(trial, state.kappa)
            key = trial, state.kappa
            tried[key] = max(log_posterior(there), tried.get(key, -np.inf))
            best = there if log_posterior(there) > log_posterior(best) + MIN_GAIN else best
    return None if best is state else best


def _mounted(problem: Problem, laplace: LaplaceEvidence, state: State) -> list[Trial]:
    """The set with a number at each of its modes: no slope leads to a compass that is mounted
    backwards."""
    b = problem.priors
    sets: list[Trial] = []
    for i, c in ((i, c) for i, c in enumerate(b.cause) if c in b.causes and not laplace.silent(c)):
        for mode in problem.model.numbers[b.columns[i]].about.modes:
            x = state.best.x.copy()
            x[i] = mode - b.now[i]
            sets.append((tuple(sorted({*state.effects, c})), x))
    return sets


def _verified(
    problem: Problem, laplace: LaplaceEvidence, state: State, tried: Tried, sets: Sequence[Trial]
) -> State | None:
    """The best of some sets, each fitted; None where none is better."""
    best = state
    for on, start in sets:
        if (on, state.kappa) in tried:
            continue
        x = state.best.x if start is None else start
        there = problem.settle(on, state.kappa, laplace.spectrum, x, log_posterior(best))
        tried[on, state.kappa] = log_posterior(there)
        best = there if log_posterior(there) > log_posterior(best) + MIN_GAIN else best
    return None if best is state else best


def is_time(cause: str) -> bool:
    """Whether a cause moves signals in time: a delay, a clock, a lag."""
    effect = effect_of(cause)
    return isinstance(EFFECTS[effect].observable_as, Shift) or prior_of(EFFECTS[effect]).timed


def _with_expected(problem: Problem, x: Array, effect: str) -> Array:
    """Numbers with those of an effect as expected, or half a deviation off."""
    b, own = problem.priors, problem.priors.of([effect])
    x = x.copy()
    x[own] = np.where(b.mean[own] != b.now[own], b.mean[own], b.now[own] + b.slab[own] / 2)
    x[own] = np.clip(x[own], b.low[own], b.high[own]) - b.now[own]
    return x


def neighbours(
    problem: Problem, laplace: LaplaceEvidence, on: Sequence[str], kappa: float
) -> list[Move]:
    """Moves that promise a gain, best first."""
    base = laplace.best(on, kappa).evidence + log_prior_of_days(kappa)
    found = [
        Move(m.effects, m.kappa, m.gain - base)
        for m in _around(problem, laplace, on, kappa)
        if m.gain > base + MIN_GAIN
    ]
    return sorted(found, key=lambda m: -m.gain)


def _around(
    problem: Problem, laplace: LaplaceEvidence, on: Sequence[str], kappa: float
) -> Iterator[Move]:
    """Every neighbour with its worth; none with a clock in the place of something else, see
    `_clocks`."""

    def move(effects: Sequence[str], days: float) -> Move:
        made = laplace.best(effects, days)
        return Move(tuple(sorted(effects)), days, made.evidence + log_prior_of_days(days))

    i = problem.kappas.index(kappa)
    for j in (i - 1, i + 1):
        if 0 <= j < len(problem.kappas):
            yield move(on, problem.kappas[j])
    absent = [e for e in laplace.priors.causes if e not in on and not laplace.silent(e)]
    more = [(e, move([*on, e], kappa)) for e in absent]
    yield from (m for _, m in more)
    for e in (e for e in on if not is_time(e)):
        yield move([a for a in on if a != e], kappa)
    if len(on) <= FEW:
        for pair in combinations([e for e in on if not is_time(e)], 2):
            yield move([a for a in on if a not in pair], kappa)
    strongest = sorted(more, key=lambda m: -m[1].gain)[:RIVALS]
    for new, _ in strongest:
        for old in on:
            if not (is_time(old) or is_time(new)) and laplace.share_a_channel(old, new):
                yield move([*(a for a in on if a != old), new], kappa)


def _ahead(
    problem: Problem, laplace: LaplaceEvidence, on: Sequence[str], first: Sequence[Move]
) -> Move | None:
    """Several moves in a row, each the best by the linearisation; None where one is all.

    Where there is a delay or a lag already, no other comes in on the way: a linearisation cannot
    tell them apart.
    """

    def best(moves: Sequence[Move], known: Sequence[str]) -> Move | None:
        """The first that may follow."""
        timed = any(is_time(e) for e in known)
        return next(
            (m for m in moves if not timed or not any(map(is_time, {*m.effects} - {*known}))), None
        )

    here = start = best(first, on)
    for _ in range(AHEAD):
        if here is None:
            break
        following = neighbours(problem, laplace, here.effects, here.kappa)
        then = best(following, here.effects)
        if then is None:
            break
        here = Move(then.effects, then.kappa, here.gain + then.gain)
    return None if here is start else here


# -- posterior over sets ---------------------------------------------------------------------


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
    """A set of effects.

    Attributes:
        effects: Sorted.
        probability: Among all sets that matter.
        best: Its numbers in the linearisation.
    """

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


def weigh(
    problem: Problem,
    found: SearchResult,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
) -> Posterior:
    """Probabilities about the end of a search.

    Args:
        problem: What was fitted.
        found: The end.
        seed: Of the chain.
        progress: Called with the share done.
    """
    laplace, kappa = found.laplace, found.state.kappa
    causes = problem.priors.causes
    free = [e for e in causes if not laplace.silent(e) and not is_time(e)]
    met = _VisitedSets(laplace, kappa)
    _walk(met, found.state.effects, free, np.random.default_rng(seed), progress)
    gained, weights = _corrected(met, found)
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


class _VisitedSets:
    """Sets that were met about one, with their evidence."""

    def __init__(self, laplace: LaplaceEvidence, kappa: float) -> None:
        self.laplace, self._kappa = laplace, kappa
        self.sets: dict[Set, float] = {}

    def evidence(self, effects: Sequence[str]) -> float:
        """Log of the probability of a set, remembered."""
        key = tuple(sorted(effects))
        if key not in self.sets:
            self.sets[key] = self.laplace.best(key, self._kappa).evidence
        return self.sets[key]


def _walk(
    met: _VisitedSets,
    start: Set,
    free: Sequence[str],
    rng: np.random.Generator,
    progress: Callable[[float], None],
) -> None:
    """Meet the sets that matter: every exchange of one effect first, then the chain's."""
    on, evidence = list(start), met.evidence
    evidence(on)
    for old in on:
        for new in _rivals(met.laplace, old, on, free):
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
            rivals = _rivals(met.laplace, old, on, free)
            if rivals:
                new = rivals[int(rng.integers(len(rivals)))]
                other = [*(a for a in on if a != old), new]
                if np.log(rng.random()) < evidence(other) - evidence(on):
                    on = other
        progress((sweep + 1) / (SWEEPS + 2))


def _corrected(met: _VisitedSets, found: SearchResult) -> tuple[dict[str, float], dict[Set, float]]:
    """What each effect of the end adds as fitted, and the evidence of every set with what the
    linearisation gets wrong about absent effects, but for the share of their lead that others in
    their place take."""
    end, evidence = found.state.effects, met.evidence
    gained, shift = {}, {}
    for e in end:
        rest = tuple(a for a in end if a != e)
        linear = evidence(end) - evidence(rest)
        fitted = (rest, found.state.kappa) in found.tried
        gained[e] = _gained(found, e, rest) if fitted else linear
        shift[e] = linear - gained[e]
    whole = evidence(end)

    def weight(effects: Set) -> float:
        """Of one set."""
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
