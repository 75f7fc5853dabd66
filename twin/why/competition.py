"""Cause and time of an event of the body: all causes compete by their `evidence` at each onset.

The first event is found by recursion: the strongest onset, then earlier ones, then later ones.
Losses of two rotors, and growing losses, compete where another cause has passed its level. No onset
is considered after a loss of control; in the seconds before it a lower level applies.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.special import expit, logsumexp
from scipy.stats import norm

from .body import Body
from .causes import (
    AIR,
    ALL,
    BLOW,
    BLOWS,
    CAUSES,
    FINAL,
    FORCES,
    GROWS_S,
    LOADS,
    LOSSES_OF_ALL,
    MASS,
    NOTHING,
    PUSH,
    ROTOR,
    SHARE,
    Name,
)
from .evidence import BLOWS_S, Evidence, Names, Window
from .flight import Array
from .noise import Places
from .sideways import COINCIDENT, WITH_ROTOR, Sideways, alongside

BEFORE_S, AFTER_S = 60.0, 6.0
"""Length of data for weighing an onset: before it and after it."""
FIRST_S = 3.0
"""Start of a part without onsets."""
APART_S = (0.3, 1.0)
"""Times before and after an event within which there is no other onset."""
LAST_WORD_S = 4.0
"""Seconds before a loss of control in which the lower level applies."""
COARSE_S, FINELY_S = 0.1, 1.5
"""Step between candidate onsets; length of the last seconds before a loss of control in which every
interval is one."""
DEPTH = 4
"""Largest depth of the recursion."""
GREW_S = 3.0
"""Time before the strongest onset in which a growing loss may have begun."""
UNSEEN = 0.05
"""Probability that all rotors lose thrust without the corresponding drop of voltage, by half as
much as the thrust, which is proportional to its square; and that voltage drops without such a
loss."""
VOLTAGE_SD, VOLTAGE_SPREAD = 0.01, 0.2
"""Standard deviation of such a drop over the voltage, and over its expected value."""
SAGS_S = 2.0
"""Time in which a drop of voltage is measured."""
FALSE_NAMES_10_H = 1.0
"""Expected number of false names of all causes together in ten hours of normal flight."""
_TAILS = {name: cause.tail for name, cause in CAUSES.items() if cause.tail is not None}
LEVEL = {
    cause: nats * np.log(per_h * 10 * len(_TAILS) / FALSE_NAMES_10_H)
    for cause, (per_h, nats) in _TAILS.items()
}
"""Nats over no event from which there is an event, by an exponential tail."""
SHOWN_GUST_S = BLOWS_S[3]
"""Length of the gust whose smallest detectable size is reported."""
SCREENED = 12.0
"""Nats below its level from which a name under one law of thrust is evaluated under all laws."""
LAST_WORD_NATS = 3.0
"""Lower level for all causes but a gust in the last seconds before a loss of control, which must
have a cause: odds of 20 to 1. The competition decides which one: a rotor whose command is lower
than that of others would be named otherwise."""

LEVEL_BY_SLOPE = 0.08
"""Standard deviation of a loss of a rotor over the loss. A rotor loses a share of its thrust, but
its gain is estimated from changes of the command: the ratio of thrust and slope depends on the
curvature of the thrust map, by a factor of 1.2 to 1.3 between `CURVATURES`, which is 0.07 of a
uniform distribution. In 40 flights with a known loss (seeds 700 to 703, two plants) the most
probable value is 0.083."""
NORMAL = norm.ppf((np.arange(21) + 0.5) / 21)
"""Values of a standard normal distribution, equally probable."""


@dataclass(frozen=True, slots=True)
class Onset:
    """An event of the body.

    Attributes:
        place: Interval of the onset in the `Body`.
        probabilities: Probability of each name at this onset, the most probable first.
        nats: Log odds over no event, nats.
        sizes: Sizes of the most probable name, with the posterior of each, ascending; empty: it has
            none.
        grows_s: Time in which it grows, s; 0: sudden.
    """

    place: int
    probabilities: tuple[tuple[Name, float], ...]
    nats: float
    sizes: tuple[tuple[float, float], ...]
    grows_s: float = 0.0

    @property
    def name(self) -> Name:
        """The most probable name."""
        return self.probabilities[0][0]

    def quantile(self, share: float) -> float:
        """Quantile of the size, by its posterior."""
        sizes, p = np.array(self.sizes).T
        return float(np.interp(share, (np.cumsum(p) - p / 2) / p.sum(), sizes))


@dataclass(frozen=True, slots=True)
class Odds:
    """Log odds of all names at onsets; names without an effect of the air are judged on thrust and
    moments only, so that a gust is no evidence for a rotor.

    Attributes:
        names: Competing names, `NOTHING` first.
        odds: Log odds against no change at all, shape (names, onsets).
        nothing: Log odds of no event, on the channels on which each name is judged, shape (names,
            onsets).
        across: Additional log odds of the axes across the thrust for a name over no event, where it
            is not judged on them, shape (names, onsets).
        sizes: Log evidence of the sizes of each name, shape (onsets, sizes).
    """

    names: tuple[Name, ...]
    odds: Array
    nothing: Array
    across: Array
    sizes: Mapping[Name, Array]


def drop(values: Array, over: int) -> Array:
    """Running mean before each instant less that after it, shape (n,); the ends are held.

    Args:
        values: Values, shape (n,).
        over: Number of samples of a mean.
    """
    mean, at = uniform_filter1d(values, over, mode="nearest"), np.arange(len(values))
    before, after = (mean[np.clip(at + k, 0, len(at) - 1)] for k in (-(over // 2), over // 2))
    return np.asarray(before - after)


class Competition:
    """Competition of all hypotheses about one part of a flight."""

    def __init__(self, body: Body) -> None:
        self.body, self.evidence, self._sideways = body, Evidence(body), Sideways(body)

    def odds(
        self,
        onsets: Places,
        low: int,
        high: int,
        window: tuple[int, int] | None = None,
        *,
        which: Names = "coarse",
        air: tuple[Array, Array, Array] | None = None,
    ) -> "Odds":
        """Log odds of all names at onsets.

        Args:
            onsets: Candidate onsets.
            low: First interval in use.
            high: End of the intervals in use.
            window: Common window of all these onsets, for comparison; None: each has its own.
            which: Set of competing names.
            air: Evidence of the axes across the thrust, if it is known.
        """
        own = self._window(onsets, low, high)
        start, end = own if window is None else (np.full_like(onsets, w) for w in window)
        w, names = Window(start, onsets, end), self.evidence.names(which)
        sizes = self.evidence.by_size(w, which)
        if air is None:
            air = self._sideways.evidence(start, onsets, end, BLOWS_S)
        still, lasting, passing = air
        if which != "growing":
            gusts = np.tile(passing, (1, len(BLOWS)))
            sizes[Name(BLOW)] = sizes[Name(BLOW)] + gusts - still[:, None]
            sizes[Name(PUSH)] = sizes[Name(PUSH)] + np.outer(lasting - still, FORCES[:, 4])
            sizes[Name(ALL)] = sizes[Name(ALL)] + self._by_voltage[onsets]
        each = np.array([logsumexp(sizes[n], axis=1) - np.log(sizes[n].shape[1]) for n in names])
        each += _log_odds(names)[:, None]
        body, calm = self.evidence.unchanged(w), self._sideways.unchanged(start, end)
        of_air = np.array([n.cause in AIR for n in names])[:, None]
        none, rotor, other = 0 * still, *(alongside(air, x) for x in (WITH_ROTOR, COINCIDENT))
        across = {c: none for c in (NOTHING, *AIR)} | {ROTOR: rotor}
        return Odds(
            names=names,
            odds=each - body + of_air * (still - calm),
            nothing=each[0] - body + of_air * (still - calm),
            across=np.array([across.get(n.cause, other) for n in names]),
            sizes=sizes,
        )

    def _window(self, onsets: Places, low: int, high: int) -> tuple[Places, Places]:
        """First interval and end of the data for weighing each onset."""
        start = np.maximum(onsets - self.body.places(BEFORE_S), low)
        return start, np.minimum(onsets + self.body.places(AFTER_S), high)

    @cached_property
    def _by_voltage(self) -> Array:
        """Log odds of each loss of all rotors by the voltage about each interval, shape (n, sizes);
        zero where none is logged."""
        body, grid = self.body, self.body.frame.grid
        if "vbat" not in grid:
            return np.zeros((len(body), len(LOSSES_OF_ALL)))
        volts, back = grid["vbat"][:, 0], body.places(SAGS_S)
        fallen = drop(volts, back)[body.start : body.end] / max(float(np.median(volts)), 1e-9)
        expected = 1 - np.sqrt(1 - np.array([0.0, *LOSSES_OF_ALL]))
        off = np.maximum(fallen, 0.0)[:, None] - expected
        off /= VOLTAGE_SD + VOLTAGE_SPREAD * expected
        log_p = np.log(UNSEEN + (1 - UNSEEN) * np.exp(-0.5 * off**2))
        return np.asarray(log_p[:, 1:] - log_p[:, :1])

    def asked(self, names: Sequence[Name], onsets: Places) -> Array:
        """Level of each name at each onset, nats over no event, shape (names, onsets): lower in the
        last seconds before a loss of control."""
        body = self.body
        last = (onsets > body.last - body.places(LAST_WORD_S)) & body.lost
        soon = np.array([n.cause != BLOW for n in names])[:, None] & last
        levels = np.array([LEVEL.get(n.cause, np.inf) for n in names])
        return np.where(soon, LAST_WORD_NATS, levels[:, None])

    def shown(self) -> tuple[Array, Array]:
        """Detectability at onsets `FIRST_S` apart: nats over its level for the loss of the least
        observable rotor, for each of `LOSSES`, shape (onsets, losses); and the least gust of
        `SHOWN_GUST_S`, m/s^2, shape (onsets,)."""
        body, step = self.body, self.body.places(FIRST_S)
        onsets = np.arange(step, body.last - step, step)
        onsets = onsets[~(body.limited | body.low)[onsets]]
        start, end = self._window(onsets, 0, len(body))
        names = [Name(NOTHING), *(Name(ROTOR, (i + 1,)) for i in range(body.rotors))]
        asked = LEVEL[ROTOR] - _log_odds(names)[1:, None]
        lost = (self.evidence.planted(Window(start, onsets, end)) - asked).min(axis=1)
        trials = np.log(len(BLOWS_S) * len(BLOWS)) - CAUSES[BLOW].log_odds
        gust = self._sideways.least_gust(start, onsets, end, SHOWN_GUST_S, LEVEL[BLOW] + trials)
        return np.asarray(lost), gust

    def onsets(self) -> list[Onset]:
        """All events, in order of time."""
        return list(self._within(0, len(self.body), 0))

    def _within(self, low: int, high: int, depth: int) -> Iterator[Onset]:
        body = self.body
        event = None if depth > DEPTH else self.strongest(low, high)
        if event is None:
            return
        yield from self._within(low, event.place - body.places(APART_S[0]), depth + 1)
        yield event
        if event.name.cause not in FINAL and body.last - event.place > body.places(AFTER_S):
            yield from self._within(event.place + body.places(APART_S[1]), high, depth + 1)

    def _earliest(
        self, screening: Sequence["Competition"], tried: Places, best: int, low: int, high: int
    ) -> int:
        """The best of the onsets near one, all on a common window: of two onsets that each explain
        the following data, the window of the later one contains more of it."""
        near = tried[np.abs(tried - best) < self.body.places(AFTER_S)]
        window = self._about(near, low, high)
        nats = [_over_nothing(c.odds(near, low, high, window))[1:] for c in screening]
        return int(near[np.argmax(np.max(nats, axis=(0, 1)))])

    def _unusual(self, near: Places, low: int, high: int) -> tuple[float, float]:
        """Nats over their levels of gusts and of all other causes, at the best of neighbouring
        onsets, as a sign of an unusual event; all names and sizes then compete. Gusts are separate,
        since they are usual."""
        found = self.odds(near, low, high, self._about(near, low, high))
        over = (_over_nothing(found) - self.asked(found.names, near)).max(axis=1)
        gust = np.array([n.cause == BLOW for n in found.names])
        return float(over[gust].max()), float(over[1:][~gust[1:]].max())

    def _about(self, near: Places, low: int, high: int) -> tuple[int, int]:
        start, end = self._window(near, low, high)
        return int(start.min()), int(end.max())

    def strongest(self, low: int, high: int, since: int = 0) -> Onset | None:
        """The strongest onset in a range of places that contains `since`; None: none passes its
        level."""
        found = (self.onset_at(place, low, high, since) for place in self.peaks(low, high, since))
        return next((onset for onset in found if onset is not None), None)

    def peaks(self, low: int, high: int, since: int = 0) -> Iterator[int]:
        """Places of onsets within `SCREENED` of their level under a law of thrust, the strongest
        first, `AFTER_S` apart; all laws together refine each."""
        tried = self._tried(max(low + self.body.places(FIRST_S), since), self._end(high))
        if len(tried) < 2:
            return
        start, end = self._window(tried, low, high)
        air = self._sideways.evidence(start, tried, end, BLOWS_S)
        screening = [Competition(b) for b in self.body.screening()]
        over = np.max([c._over(tried, low, high, air) for c in screening], axis=0)
        while over.max() >= -SCREENED:
            place = int(tried[np.argmax(over)])
            yield self._earliest(screening, tried, place, low, high)
            over[np.abs(tried - place) < self.body.places(AFTER_S)] = -np.inf

    def onset_at(self, place: int, low: int, high: int, since: int = 0) -> Onset | None:
        """The best onset near a place; None: none passes its level on refinement."""
        first, step = max(low + self.body.places(FIRST_S), since), self._stride
        near = np.arange(max(first, place - step), min(place + step + 1, self._end(high)))
        grows = np.arange(place - step, max(first, place - self.body.places(GREW_S)) - 1, -step)
        return self._onset(np.concatenate([grows[::-1], near]), place - step, low, high)

    def _end(self, high: int) -> int:
        """Place behind the last possible onset."""
        return min(high - 2, self.body.last)

    def _over(self, tried: Places, low: int, high: int, air: tuple[Array, Array, Array]) -> Array:
        """Nats of the best name at each onset over its level, and over no event near it."""
        found = self.odds(tried, low, high, air=air)
        nothing = maximum_filter1d(found.nothing, 2 * round(AFTER_S / COARSE_S) + 1, axis=1)
        asked = self.asked(found.names, tried)
        return np.asarray((found.odds - nothing - asked)[1:].max(axis=0))

    @property
    def _stride(self) -> int:
        return max(self.body.places(COARSE_S), 1)

    def _tried(self, first: int, last: int) -> Places:
        """Candidate onsets in a range of places: none where a command has just been at its limit,
        or where the ground may carry the aircraft."""
        tried = np.arange(first, last, self._stride)
        if self.body.lost:
            fine = max(self.body.last - self.body.places(FINELY_S), first)
            tried = np.unique(np.concatenate([tried, np.arange(fine, last)]))
        return tried[~(self.body.limited | self.body.low)[tried]]

    def _onset(self, near: Places, at_once: int, low: int, high: int) -> Onset | None:
        """The best of some onsets, before `at_once` of growing causes only; None: none passes its
        level on refinement."""
        gust, other = self._unusual(near[near >= at_once], low, high)
        if max(gust, other) < 0:
            return None
        window = self._about(near, low, high)
        at_all: tuple[tuple[Places, Names], ...]
        at_all = (near[near >= at_once], "fine"), (near, "growing")
        best = [
            b
            for onsets, which in at_all
            for b in _Best.each(self.odds(onsets, low, high, window, which=which), onsets)
        ]
        weighed = np.array([b.nats + b.across for b in best])
        unusual = expit([gust if b.name.cause == BLOW else other for b in best])
        p = np.exp(weighed - logsumexp(weighed)) * unusual
        order = np.argsort(-p, kind="stable")
        first = best[int(order[0])]
        if p[order[0]] < 1.0 - p.sum() or first.nats < 0:
            return None
        at = Window(*(np.array([x]) for x in (window[0], first.place, window[1])))
        sizes, grows_s = self._sizes(first.name, first.sizes, at)
        named = [(best[i].name, float(p[i])) for i in order]
        named.append((Name(NOTHING), float(1.0 - p.sum())))
        return Onset(first.place, _joined(named), first.nats, sizes, grows_s)

    def _sizes(
        self, name: Name, evidence: Array, window: Window
    ) -> tuple[tuple[tuple[float, float], ...], float]:
        """Sizes of a name with their posterior, and the time in which it grows."""
        if name.cause == MASS:
            return _posterior(LOADS, evidence), 0.0
        if name.cause not in FINAL:
            return (), 0.0
        lost, log_p = self.evidence.lost(name), self.evidence.sizes_apart(name, window)
        sizes = lost.sum(axis=1) / np.count_nonzero(lost[0])
        spread = LEVEL_BY_SLOPE if name.cause == ROTOR else 0.0
        if not name.grows:
            return _posterior(sizes, log_p, spread), 0.0
        by_time = logsumexp(log_p.reshape(len(GROWS_S), -1), axis=1)
        between = float(np.log(GROWS_S[1] / GROWS_S[0]) / np.sqrt(12))
        found = _posterior(sizes, log_p, float(np.hypot(spread, between)))
        return found, GROWS_S[int(np.argmax(by_time))]


def _over_nothing(found: Odds) -> Array:
    """Nats of each name over no event at neighbouring onsets, shape (names, onsets)."""
    return np.asarray(found.odds - found.nothing.max(axis=1)[:, None])


@dataclass(frozen=True, slots=True)
class _Best:
    """A name at the best of its onsets.

    Attributes:
        name: Name of the cause with its rotors.
        place: Interval of the onset.
        nats: Log odds over no event, nats.
        across: Additional log odds across the thrust, as in `Odds`.
        sizes: Log evidence of its sizes.
    """

    name: Name
    place: int
    nats: float
    across: float
    sizes: Array

    @classmethod
    def each(cls, found: Odds, onsets: Places) -> list["_Best"]:
        """The best onset of each name except no event."""
        nats = _over_nothing(found)
        return [
            cls(n, int(onsets[m]), float(x[m]), float(a[m]), found.sizes[n][m])
            for n, x, a in zip(found.names[1:], nats[1:], found.across[1:], strict=True)
            for m in [int(np.argmax(x))]
        ]


def _log_odds(names: Sequence[Name]) -> Array:
    """Prior log odds of each name against no event: those of its cause, shared among its rotors."""
    kinds = [(n.cause, len(n.rotors), n.grows) for n in names]
    share = {k: SHARE.get(k[1:], 1.0) / kinds.count(k) for k in kinds}
    return np.array(
        [
            CAUSES[n.cause].log_odds + np.log(share[k]) if n.cause in CAUSES else 0.0
            for n, k in zip(names, kinds, strict=True)
        ]
    )


def _joined(each: Iterable[tuple[Name, float]]) -> tuple[tuple[Name, float], ...]:
    """Names with their probability; for each cause and rotors the most probable name represents
    all."""
    found: dict[tuple[str, tuple[int, ...]], tuple[Name, float]] = {}
    for name, p in each:
        first, known = found.get((name.cause, name.rotors), (name, 0.0))
        found[name.cause, name.rotors] = first, known + p
    return tuple(sorted(found.values(), key=lambda x: -x[1]))


def _posterior(sizes: Array, log_p: Array, spread: float = 0.0) -> tuple[tuple[float, float], ...]:
    """Sizes, each once and ascending, with their probability.

    Args:
        sizes: Shape (n,).
        log_p: Their log posterior, up to a constant, shape (n,).
        spread: Standard deviation of the logarithm of a size that the posterior does not include; a
            size is at most 1.
    """
    if spread:
        sizes = np.minimum(np.outer(sizes, np.exp(spread * NORMAL)), 1.0).ravel()
        log_p = np.repeat(log_p, len(NORMAL))
    values, which = np.unique(np.round(sizes, 6), return_inverse=True)
    p = np.bincount(which, np.exp(log_p - logsumexp(log_p)))
    return tuple(zip(values.tolist(), p.tolist(), strict=True))
