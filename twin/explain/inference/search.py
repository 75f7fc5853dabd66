"""Look for the set of effects that flights make most probable, from several starts.

Gains of sets are told by one linearisation; each move is fitted again before it is accepted. A move
adds an effect, drops one or two, or puts one in the place of another; days may turn out to differ
more or less than is usual. Where several moves in a row promise more, they are tried together
first.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, prior_of
from ...effects.parameters import LAST, UNMEASURED
from .evidence import LaplaceEvidence
from .fit import Problem, State, gained_by_following
from .posterior import (
    SearchResult,
    Tried,
    corrected,
    is_time,
    log_posterior,
    log_prior_of_days,
    met_sets,
)
from .priors import Priors, effect_of
from .valley import hidden_starts

Array = NDArray[np.float64]

Exchange = tuple[frozenset[str], frozenset[str], float]
"""Effects that come in, those that go, and the days."""
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
    """A neighbour: effects, sorted, kappa of the days, and nats that the linearisation promises."""

    effects: tuple[str, ...]
    kappa: float
    gain: float


@dataclass(slots=True)
class SearchPoint:
    """Where a search stands between two moves.

    Attributes:
        state: The set that it has come to.
        tried: Log posterior of every set that was fitted.
        begun: Sets that were fitted from their expected numbers on.
        again: Sets that were fitted twice.
        short: By how much exchanges fell short of what they promised, nats.
        sought: Sets about which hidden effects were sought.
        moves: That were accepted.
        ended: Whether no other set is better.
    """

    state: State
    tried: Tried
    begun: set[tuple[str, ...]] = field(default_factory=set)
    again: set[tuple[tuple[str, ...], float]] = field(default_factory=set)
    short: dict[Exchange, float] = field(default_factory=dict)
    sought: set[tuple[str, ...]] = field(default_factory=set)
    moves: int = 0
    ended: bool = False

    @classmethod
    def at(cls, state: State) -> "SearchPoint":
        """The start of a search."""
        return cls(state, {(state.effects, state.kappa): log_posterior(state)})


class Checkpoint:
    """Keeps where each search of a run stands, one search after the other. This one keeps nothing;
    one that does lets a run that was killed go on from there."""

    def resumed(self) -> SearchPoint | None:
        """Where the next search of the run stood; None: it had not begun."""
        return None

    def keep(self, point: SearchPoint) -> SearchPoint:
        """Keep where the search stands; the point to go on from."""
        return point


NO_CHECKPOINT = Checkpoint()
"""A run that is killed begins anew."""


def search(
    problem: Problem,
    start: Sequence[str] | State,
    progress: Callable[[float], None] = lambda _: None,
    last: bool = True,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> SearchResult:
    """Climb from a set of effects, or from one that is fitted already.

    Args:
        problem: What is fitted.
        start: Effects that are there at first, or the set.
        progress: Called with the share done, roughly.
        last: Whether its end is what is told: else another search goes on from it, and does what
            asks each effect of the end by itself.
        checkpoint: Keeps where it stands.
    """
    at = checkpoint.resumed()
    if at is None:
        begun = start if isinstance(start, State) else problem.start(start, 1.0)
        at = checkpoint.keep(SearchPoint.at(begun))
    laplace = problem.linearised(at.state)
    while at.moves < MOVES and not at.ended:
        progress(1 - 0.9**at.moves)
        better = _move(problem, laplace, at, last)
        if better is None:
            at.ended = True
        else:
            at.state, at.moves = better, at.moves + 1
            laplace = problem.linearised(better)
        at = checkpoint.keep(at)
    return SearchResult(at.state, laplace, at.tried)


def _move(problem: Problem, laplace: LaplaceEvidence, at: SearchPoint, last: bool) -> State | None:
    """A set that is better; None where none is; `last` as of `search`."""
    state, tried, begun = at.state, at.tried, at.begun
    effects = state.effects  # where a clock is not missed, no other is sought for it
    no_clock = [(tuple(a for a in effects if a != e), None) for e in effects if is_time(e)]
    better = (
        _better(problem, laplace, state, tried, at.again, at.short)
        or _followed(problem, laplace, state, tried, begun, MIN_GAIN)
        or _verified(problem, laplace, state, tried, no_clock)
        or _verified(problem, laplace, state, tried, _clocks(problem, laplace, state))
    )
    if better is not None or not last:
        return better
    return (
        _uncovered(problem, laplace, state, at.sought)
        or _verified(problem, laplace, state, tried, _weak(laplace, state))
        or _verified(problem, laplace, state, tried, _alone(state))
        or _verified(problem, laplace, state, tried, _mistaken(problem, state))
        or _verified(problem, laplace, state, {}, _mounted(problem, laplace, state))
        or _verified(problem, laplace, state, tried, _likelier(problem, laplace, state, tried))
        or _restarted(problem, state, tried, begun)
        or _followed(problem, laplace, state, tried, begun, -np.inf)
    )


def with_instruments_of_end(
    problem: Problem,
    found: SearchResult,
    progress: Callable[[float], None] = lambda _: None,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> tuple[Problem, SearchResult]:
    """A search, gone on with where its instruments are trusted otherwise with its effects in."""
    renewed = problem.with_instruments_at(found.state)
    if renewed.noise.trusts_as(problem.noise):
        return problem, found
    end = found.state
    state = renewed.settle(end.effects, end.kappa, found.laplace.spectrum, end.best.x)
    return renewed, search(renewed, state, progress, checkpoint=checkpoint)


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
    short: dict[Exchange, float],
) -> State | None:
    """A neighbour that is better once it is fitted; None where there is none.

    One that was fitted already, and ended lower than is promised now, is fitted once again: what a
    fit reaches depends on where it begins. An exchange of effects that fell short of what it
    promised, from whatever set, is not tried again where it promises no more than that: `short`.
    """
    candidates = neighbours(problem, laplace, state.effects, state.kappa)
    ahead = _ahead(problem, laplace, state.effects, candidates)
    queue = [*([ahead] if ahead else []), *_different(candidates, state.effects)]
    fitted = 0
    on = frozenset(state.effects)
    for move in queue:
        key, there = (move.effects, move.kappa), frozenset(move.effects)
        exchange = there - on, on - there, move.kappa
        if move.gain < short.get(exchange, 0.0) + MIN_GAIN:
            continue
        if key in tried:
            if key in again or tried[key] > log_posterior(state) + move.gain - SHORT:
                continue
            again.add(key)
        now = log_posterior(state)
        found = problem.settle(move.effects, move.kappa, laplace.spectrum, state.best.x, now)
        tried[key] = max(log_posterior(found), tried.get(key, -np.inf))
        gained = log_posterior(found) - now
        if gained > MIN_GAIN:
            return found
        short[exchange] = move.gain - gained
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
    there = problem.start(state.effects, state.kappa, log_posterior(state))
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
        noise = gained_by_following(c, problem.rest, problem.noise.bands, problem.model.vehicle)
        if c not in state.effects and promised + noise <= least:
            continue
        apart = tuple(e for e in on if e == c or not laplace.share_a_channel(e, c))
        for trial in dict.fromkeys((on, apart) if c in state.effects else (on,)):
            if trial in begun:
                continue
            begun.add(trial)
            there = problem.start(trial, state.kappa, log_posterior(best))
            key = trial, state.kappa
            tried[key] = max(log_posterior(there), tried.get(key, -np.inf))
            best = there if log_posterior(there) > log_posterior(best) + MIN_GAIN else best
    return None if best is state else best


def _uncovered(
    problem: Problem, laplace: LaplaceEvidence, state: State, sought: set[tuple[str, ...]]
) -> State | None:
    """The set with an effect that another hides, see `valley`: sought once while it is not there,
    and once about each set with it, which may stand elsewhere in its valley."""
    observed = {c for c in problem.priors.causes if EFFECTS[effect_of(c)].observer is not None}
    key = state.effects if observed & {*state.effects} else ()
    if key in sought:
        return None
    sought.add(key)
    return _verified(problem, laplace, state, {}, [*hidden_starts(problem, laplace, state)])


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


def _likelier(
    problem: Problem, laplace: LaplaceEvidence, state: State, tried: Tried
) -> list[Trial]:
    """Sets that the posterior about one holds to be more probable, and that nobody has fitted."""
    found = SearchResult(state, laplace, tried)
    met = met_sets(problem, found, np.random.default_rng(0))
    weights = corrected(met, found)[1]
    least = weights[state.effects] + MIN_GAIN
    better = [k for k, v in weights.items() if v > least and (k, state.kappa) not in tried]
    better = sorted(better, key=lambda k: (-weights[k], k))[:TRIED]
    return [(k, laplace.best(k, state.kappa).x) for k in better]


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
