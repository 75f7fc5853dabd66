"""Search for the candidate model with the largest posterior, from several starts.

Gains are predicted by one linearisation; each move is fitted before it is accepted. A move adds an
effect, removes one or two, or exchanges one for another; the factor on day-to-day variation may
change. Where several moves in a row promise more, they are tried together first.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from ...effects import EFFECTS, prior_of
from ...effects.parameters import LAST, UNMEASURED
from ...residuals.channels import Array
from .evidence import LaplaceEvidence
from .fit import Problem, State
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

Exchange = tuple[frozenset[str], frozenset[str], float]
"""Added effects, removed effects, and the factor on day-to-day variation."""
MOVES, TRIED, AHEAD, RIVALS = 60, 4, 8, 4
"""Maximum number of accepted moves; fits tried per state; moves of look-ahead; exchange
candidates."""
FEW = 8
"""Largest number of effects of a model from which two are removed at once: they may represent a
third one together."""
CLEAR = 15.0
"""Predicted loss without an effect, nats, from which on the model without it is not fitted
again."""
MIN_GAIN = 0.3
"""Least gain of a move, nats."""
SHORT = 3.0
"""Shortfall of a fit against its prediction, or against another fit of the same model, nats, from
which on it is repeated."""


@dataclass(frozen=True, slots=True)
class Move:
    """A move: sorted effects, kappa of the days, and the predicted gain, nats."""

    effects: tuple[str, ...]
    kappa: float
    gain: float


@dataclass(slots=True)
class SearchPoint:
    """State of a search between two moves.

    Attributes:
        state: Current candidate model.
        tried: Log posterior of every candidate model that was fitted.
        begun: Candidate models fitted from their prior means.
        again: Candidate models fitted twice.
        short: Shortfall of exchanges against their predicted gains, nats.
        sought: Candidate models near which hidden effects were sought.
        late: Delays and lags that were tried from their prior means.
        moves: Number of accepted moves.
        ended: Whether no other candidate model is better.
    """

    state: State
    tried: Tried
    begun: set[tuple[str, ...]] = field(default_factory=set)
    again: set[tuple[tuple[str, ...], float]] = field(default_factory=set)
    short: dict[Exchange, float] = field(default_factory=dict)
    sought: set[tuple[str, ...]] = field(default_factory=set)
    late: set[str] = field(default_factory=set)
    moves: int = 0
    ended: bool = False

    @classmethod
    def at(cls, state: State) -> "SearchPoint":
        """Starting point of a search."""
        return cls(state, {(state.effects, state.kappa): log_posterior(state)})


class Checkpoint:
    """Interface that stores the state of each search of a run, one search after the other. This
    class stores nothing; a subclass makes an interrupted run resumable."""

    def resumed(self) -> SearchPoint | None:
        """Stored state of the next search of the run; None: it had not begun."""
        return None

    def keep(self, point: SearchPoint) -> SearchPoint:
        """Store the state of the search; returns the state from which to continue."""
        return point


NO_CHECKPOINT = Checkpoint()
"""Checkpoint that stores nothing: an interrupted run starts again."""


def search(
    problem: Problem,
    start: Sequence[str] | State,
    progress: Callable[[float], None] = lambda _: None,
    last: bool = True,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> SearchResult:
    """Climb from a candidate model, or from a fitted state.

    Args:
        problem: Estimation problem.
        start: Initial effects, or the fitted state.
        progress: Called with the approximate share done, 0..1.
        last: Whether this search gives the result; otherwise another search continues from it, and
            repeats the tests of single effects.
        checkpoint: Stores the state of the search.
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
    """A better state; None where there is none; `last` as of `search`."""
    state, tried = at.state, at.tried
    effects = state.effects  # no second clock is sought where one is present
    no_clock = [(tuple(a for a in effects if a != e), None) for e in effects if is_time(e)]
    better = (
        _better(problem, laplace, at)
        or _followed(problem, laplace, at, MIN_GAIN)
        or _verified(problem, laplace, state, tried, no_clock)
        or _verified(problem, laplace, state, tried, _clocks(problem, laplace, state))
    )
    if better is not None or not last:
        return better
    return (
        _verified(problem, laplace, state, {}, _unsettled(laplace, state))
        or _verified(problem, laplace, state, {}, _late(problem, laplace, state, at.late))
        or _uncovered(problem, laplace, at)
        or _verified(problem, laplace, state, tried, _weak(laplace, state))
        or _verified(problem, laplace, state, tried, _alone(state))
        or _verified(problem, laplace, state, tried, _mistaken(problem, state))
        or _verified(problem, laplace, state, {}, _mounted(problem, laplace, state))
        or _verified(problem, laplace, state, tried, _likelier(problem, laplace, state, tried))
        or _restarted(problem, at)
        or _followed(problem, laplace, at, -np.inf)
    )


def with_instruments_of_end(
    problem: Problem,
    found: SearchResult,
    progress: Callable[[float], None] = lambda _: None,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> tuple[Problem, SearchResult]:
    """A search continued with instruments that are tested with its effects in the model."""
    renewed = problem.with_instruments_at(found.state)
    if renewed.noise.trusts_as(problem.noise):
        return problem, found
    end = found.state
    state = renewed.settle(end.effects, end.kappa, found.laplace.spectrum, end.best.x)
    return renewed, search(renewed, state, progress, checkpoint=checkpoint)


def score_test_candidates(problem: Problem) -> tuple[str, ...]:
    """Effects that the nominal model lacks by score tests: those of the best move, or sequence of
    moves, in its linearisation."""
    laplace = problem.laplace(problem.rest)
    first = neighbours(problem, laplace, (), 1.0)
    ahead = _ahead(problem, laplace, (), first)
    return first[0].effects if ahead is None and first else () if ahead is None else ahead.effects


def calibration_start(priors: Priors) -> list[str]:
    """Effects whose numbers are not measured on any aircraft: the delay that every aircraft has,
    and the averaging of most pose estimates."""
    return [
        c
        for c in priors.causes
        if priors.odds[c] >= UNMEASURED or prior_of(EFFECTS[effect_of(c)]).start
    ]


def _better(problem: Problem, laplace: LaplaceEvidence, at: SearchPoint) -> State | None:
    """A better neighbour after fitting; None where there is none.

    A model already fitted, with less evidence than predicted now, is fitted once again: the result
    of a fit depends on its start. An exchange of effects that fell short of its predicted gain,
    from whatever model, is not tried again unless it predicts more than that.
    """
    state, now = at.state, log_posterior(at.state)
    candidates = neighbours(problem, laplace, state.effects, state.kappa)
    ahead = _ahead(problem, laplace, state.effects, candidates)
    queue = [*([ahead] if ahead else []), *_different(candidates, state.effects)]
    fitted = 0
    on = frozenset(state.effects)
    for move in queue:
        key, there = (move.effects, move.kappa), frozenset(move.effects)
        exchange = there - on, on - there, move.kappa
        if move.gain < at.short.get(exchange, 0.0) + MIN_GAIN:
            continue
        if key in at.tried:
            if key in at.again or at.tried[key] > now + move.gain - SHORT:
                continue
            at.again.add(key)
        found = problem.settle(move.effects, move.kappa, laplace.spectrum, state.best.x, now)
        at.tried[key] = max(log_posterior(found), at.tried.get(key, -np.inf))
        gained = log_posterior(found) - now
        if gained > MIN_GAIN:
            return found
        at.short[exchange] = move.gain - gained
        fitted += 1
        if fitted == TRIED:
            break
    return None


def _restarted(problem: Problem, at: SearchPoint) -> State | None:
    """The model fitted again from its prior means, once: during the search day-to-day deviations
    may have represented effects that were not present yet, and stay there."""
    state = at.state
    if state.effects in at.begun:
        return None
    at.begun.add(state.effects)
    there = problem.start(state.effects, state.kappa, log_posterior(state))
    if log_posterior(there) <= log_posterior(state) + SHORT:
        return None
    at.tried[state.effects, state.kappa] = log_posterior(there)
    return there


def _different(moves: Sequence[Move], on: Sequence[str]) -> Iterator[Move]:
    """The best move for each added effect, and the moves that add none."""
    seen = set()
    for m in moves:
        new = frozenset(m.effects) - frozenset(on)
        if not new or new not in seen:
            yield m
        seen.add(new)


Trial = tuple[tuple[str, ...], Array | None]
"""A candidate model, and its initial numbers; None: those of the state."""


def _clocks(problem: Problem, laplace: LaplaceEvidence, state: State) -> list[Trial]:
    """The model with any other delay or lag in place of each.

    Time shifts are nonlinear over a few milliseconds, so that no linearisation can distinguish
    between them. A record with several clocks is considered last: clocks are added like other
    effects.
    """
    present = [e for e in state.effects if is_time(e)]
    every = [e for e in problem.priors.causes if is_time(e)]
    odds = problem.priors.odds
    absent = [e for e in every if e not in state.effects and odds[e] > LAST]
    sets: list[Trial] = []
    for old in present:
        rest = tuple(e for e in state.effects if e != old)
        known = [e for e in absent if laplace.share_a_channel(old, e) and not laplace.silent(e)]
        sets += [_with_expected(problem, state, rest, c) for c in known]
    return sets


def _unsettled(laplace: LaplaceEvidence, state: State) -> list[Trial]:
    """The same model, where slopes at its numbers promise more: its fit ended along slopes of an
    earlier point."""
    promised = laplace.best(state.effects, state.kappa).evidence - state.evidence
    return [(state.effects, None)] if promised > MIN_GAIN else []


def _late(problem: Problem, laplace: LaplaceEvidence, state: State, begun: set[str]) -> list[Trial]:
    """The model with each absent delay or lag, from its prior mean, once: beyond a quarter of a
    period of the motion, no slope at zero delay leads there."""
    odds, known = problem.priors.odds, {*state.effects, *begun}
    absent = [c for c in problem.priors.causes if is_time(c) and c not in known]
    late = [c for c in absent if odds[c] > LAST and not laplace.silent(c)]
    begun |= {*late}
    return [_with_expected(problem, state, state.effects, c) for c in late]


def _weak(laplace: LaplaceEvidence, state: State) -> list[Trial]:
    """The model without each effect that adds little by the linearisation."""
    least = laplace.best(state.effects, state.kappa).evidence - CLEAR
    own = [e for e in state.effects if not is_time(e)]
    rests = [tuple(e for e in state.effects if e != old) for old in own]
    return [(r, None) for r in rests if laplace.best(r, state.kappa).evidence > least]


def _alone(state: State) -> list[Trial]:
    """The model with one rotor in place of several: losses of opposite rotors, together with the
    position of the centre of mass, can represent the loss of one."""
    sets: list[Trial] = []
    for effect in dict.fromkeys(effect_of(c) for c in state.effects):
        own = [c for c in state.effects if effect_of(c) == effect and not is_time(c)]
        if len(own) > 1:
            rest = [c for c in state.effects if c not in own]
            sets += [(tuple(sorted((*rest, c))), None) for c in own]
    return sets


def _mistaken(problem: Problem, state: State) -> list[Trial]:
    """The model with each part of an effect, at its prior mean, in place of one effect that may be
    mistaken for it.

    A weak rotor reduces thrust and rotates the aircraft, like a smaller thrust and a shifted centre
    of mass of that day together. The torque lost with its thrust is nonlinear at zero loss: where
    both represent it, the linearisation rejects it because of its torque. Either of them may be
    present as well.
    """
    on = {effect_of(c) for c in state.effects}
    sets: list[Trial] = []
    for c in problem.priors.causes:
        if effect_of(c) in on:
            continue
        for other in EFFECTS[effect_of(c)].mistaken_for:
            if other in on:
                rest = [e for e in state.effects if e != other]
                sets.append(_with_expected(problem, state, rest, c))
    return sets


def _followed(
    problem: Problem, laplace: LaplaceEvidence, at: SearchPoint, least: float
) -> State | None:
    """The model with an effect whose states an observer estimates, if it promises at least so many
    nats more than it gains by following noise; None where none is better.

    Its states are strongly nonlinear in its shape parameters, so that the linearisation would
    reject it too early. They follow what no other effect explains, so they stay small where others
    represent this effect already: all numbers start at their prior means, beside all other effects;
    where the effect is present already, also beside only those that do not act on the same
    readings.
    """
    best = state = at.state
    for c in problem.priors.causes:
        if EFFECTS[effect_of(c)].observer is None:
            continue
        on = tuple(sorted({*state.effects, c}))
        promised = laplace.best(on, state.kappa).evidence - state.evidence
        if c not in state.effects and promised + problem.gained[c] <= least:
            continue
        apart = tuple(e for e in on if e == c or not laplace.share_a_channel(e, c))
        for trial in dict.fromkeys((on, apart) if c in state.effects else (on,)):
            if trial in at.begun:
                continue
            at.begun.add(trial)
            there = problem.start(trial, state.kappa, log_posterior(best))
            key = trial, state.kappa
            at.tried[key] = max(log_posterior(there), at.tried.get(key, -np.inf))
            best = there if log_posterior(there) > log_posterior(best) + MIN_GAIN else best
    return None if best is state else best


def _uncovered(problem: Problem, laplace: LaplaceEvidence, at: SearchPoint) -> State | None:
    """The model with an effect that another one masks, see `valley`: sought once while it is
    absent, and once near each model with it, which may be elsewhere in its valley."""
    state = at.state
    observed = {c for c in problem.priors.causes if EFFECTS[effect_of(c)].observer is not None}
    key = state.effects if observed & {*state.effects} else ()
    if key in at.sought:
        return None
    at.sought.add(key)
    least = log_posterior(state)
    starts = hidden_starts(problem, laplace, state)
    fits = (problem.loosened(on, state.kappa, laplace.spectrum, x, least) for on, x in starts)
    return next((fit for fit in fits if log_posterior(fit) > least + MIN_GAIN), None)


def _mounted(problem: Problem, laplace: LaplaceEvidence, state: State) -> list[Trial]:
    """The model with a number at each of its modes: no gradient leads to a compass mounted
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
    """Models that are more probable by the posterior near this state, and not fitted yet."""
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
    """The best of some models, each fitted; None where none is better."""
    best = state
    for on, start in sets:
        if (on, state.kappa) in tried:
            continue
        x = state.best.x if start is None else start
        there = problem.settle(on, state.kappa, laplace.spectrum, x, log_posterior(best))
        tried[on, state.kappa] = log_posterior(there)
        best = there if log_posterior(there) > log_posterior(best) + MIN_GAIN else best
    return None if best is state else best


def _with_expected(problem: Problem, state: State, rest: Sequence[str], effect: str) -> Trial:
    """A model with one more effect, its numbers at their prior means, or half a standard deviation
    off."""
    b, own, x = problem.priors, problem.priors.of([effect]), state.best.x.copy()
    x[own] = np.where(b.mean[own] != b.now[own], b.mean[own], b.now[own] + b.slab[own] / 2)
    x[own] = np.clip(x[own], b.low[own], b.high[own]) - b.now[own]
    return tuple(sorted((*rest, effect))), x


def neighbours(
    problem: Problem, laplace: LaplaceEvidence, on: Sequence[str], kappa: float
) -> list[Move]:
    """Moves with a predicted gain, the best first."""
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
    """Every neighbour with its predicted log posterior; without exchanges that add a clock, see
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
    """Several moves in a row, each the best by the linearisation; None where a single one is best.

    Where a delay or a lag is present already, no other is added on the way: a linearisation cannot
    distinguish between them.
    """

    def best(moves: Sequence[Move], known: Sequence[str]) -> Move | None:
        """The first move that may follow."""
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
