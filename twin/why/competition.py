"""What moved the body, and when: all hypotheses compete in one marginal likelihood at each onset.

Up to an onset the regression of `body` holds. From it on a hypothesis changes the share of thrust
that rotors have left, adds a constant force or moment, or leaves out a short blow. Gain before,
damping, products and offset are marginalised as Gaussian, the gain after the onset over a grid of
its logarithm, sizes over their prior. A share of the log evidence is believed (`TEMPER`): intervals
are neither Gaussian nor free of model error.

What begins first is looked for by recursion: the strongest onset, then what came before it, then
what came after it. No onset is tried after a loss of control; in the seconds before it the last
word is spoken, at a lower level.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.special import log_ndtr, logsumexp

from ..vehicle import GRAVITY_M_S2
from .body import USUAL_CURVATURE, Body
from .flight import Array

Places = NDArray[np.int64]
"""Onsets as places of the grid of a `Body`."""

TEMPER = 0.5
"""Share of the log evidence that is believed."""
BEFORE_S, AFTER_S, BLOW_S = 60.0, 6.0, 0.15
"""What an onset is weighed on: before it and after it. Length of a blow."""
FIRST_S = 3.0
"""No onset is tried before so much of a part."""
APART_S = (0.3, 1.0)
"""Before and after an event: there another may have its onset."""
LAST_WORD_S = 4.0
"""Seconds before a loss of control in which the last word is spoken."""
COARSE_S, FINELY_S = 0.1, 1.5
"""Onsets are tried so often; at every interval in the last seconds before a loss of control."""
DEPTH = 4
"""Of the recursion."""
LOSSES = np.linspace(0.1, 1.0, 37)
"""Of the thrust of one rotor, alike probable: up to the full stop."""
LOSSES_OF_ALL = np.array([0.08, 0.15, 0.25, 0.4, 0.6, 0.8, 1.0])
"""Of the thrust of all rotors; along z alone, since the gains of the moments are free anyhow."""
MASSES = np.array([-0.5, -0.3, -0.2, -0.12, -0.06, 0.06, 0.12, 0.2, 0.3])
"""Change of the mass over the mass."""
GAINS = (
    np.array([1.0]),
    np.geomspace(0.5, 200, 8),
    np.geomspace(0.5, 200, 8),
    np.geomspace(0.05, 10, 7),
)
"""Gain after an onset of each channel over that of gravity at all thrust, where nothing is known of
it, 1/m: arm times mass over inertia for roll and pitch, torque per thrust for yaw. Means of a
mixture of normal distributions, whose deviations are `GAIN_SPREAD` of them. That of z is known:
all thrust carries the weight; `LIFT_SPREAD` is for the battery."""
GAIN_SPREAD, LIFT_SPREAD = 0.5, 0.1
TIED = ((0.5, 0.7, 1.0, 1.4, 2.0), (0.25, 0.3, 0.3, 0.3, 0.3))
"""Means and deviations of the gain after an onset over that before it, where commands are logged
fast; the middle weighs most."""
FLOORED = ((0.8, 1.0, 1.6, 2.5, 4.0, 6.5, 10.0, 16.0), 0.3)
"""The same where they are logged slowly: jitter that is not logged lets the gain before the onset
come out too small, so that it is a floor."""
LEAST_STEP = np.array([0.15 * GRAVITY_M_S2, 2.0, 2.0, 0.5])
"""Deviation of a sudden force or moment per mass or inertia, m/s^2 and rad/s^2; at least
`STEP_SHARE` of what all rotors do."""
STEP_SHARE = np.array([0.0, 0.05, 0.05, 0.05])
TRIM_SHARE, TRIM_SHARE_SLOW = 0.007, 0.011
"""Of what all rotors do to a channel: by so much its offset may change at any onset, whatever the
hypothesis. Wind, battery and an imperfect map of thrust do that; more where commands are logged
slowly, since what they did in between is not known."""
OFFSET_SD = np.array([3.0 * GRAVITY_M_S2, 30.0, 30.0, 30.0])
"""Of an offset of a channel, m/s^2 and rad/s^2."""
PRODUCT_SD = np.array([0.1, 1.0, 1.0, 1.0])
"""Of the gyroscopic products: 1 for bodies, the lever of the accelerometer for z, m."""
DAMPING_SD, GAIN_SD = 30.0, 1e3
"""Of damping, 1/s, and of the gain before an onset."""
SPIKE = np.log(6.0)
"""Cost of each reading that a blow leaves out, nats: it may be anything within its range."""

ROTOR, ALL, MASS, PUSH, BLOW = (
    "rotor_failure",
    "thrust_loss_all_rotors",
    "mass_change",
    "force_or_moment",
    "gust",
)
NOTHING = "nothing"
FINAL = (ROTOR, ALL)
"""Causes after which the body is another one: what follows is no event of its own."""
PRIOR = {NOTHING: 0.0, ROTOR: -1.5, ALL: -3.0, MASS: -3.0, PUSH: -3.0, BLOW: -2.0}
"""Log odds of a cause at an onset against nothing."""
FALSE_NAMES_10_H = 1.0
"""Expected number of false names of all causes together in ten hours of normal flight."""
TAILS = {ROTOR: (2.7, 6.4), ALL: (2.7, 6.4), MASS: (5.3, 8.0), PUSH: (5.3, 8.0), BLOW: (13.4, 10.5)}
"""Of the largest log odds over nothing in a normal flight: how often they pass zero, 1/h, and their
mean excess over it, nats; the larger of what grids of 0.05 and 0.1 s show. 0.37 h recorded (clean
flights of four aircraft, PX4's withdrawn failures, CrazyPAD); in 1.6 h simulated none passes."""
LEVEL = {
    cause: nats * np.log(per_h * 10 * len(TAILS) / FALSE_NAMES_10_H)
    for cause, (per_h, nats) in TAILS.items()
}
"""Nats over nothing from which on there is an event, by an exponential tail."""
SCREENED = 12.0
"""Nats below its level from which on a name under one curve of thrust is looked at under all."""
LAST_WORD_NATS = 3.0
"""The same of a rotor in the last seconds before control is lost, since something must have taken
it: odds of 20 to 1."""


@dataclass(frozen=True, slots=True)
class Name:
    """A cause and its rotor, from 1; 0: of none."""

    cause: str
    rotor: int = 0


@dataclass(frozen=True, slots=True)
class Onset:
    """An event of the body.

    Attributes:
        place: Interval of the onset, of the `Body`.
        probabilities: Of all names at this onset, the most probable first.
        nats: Over nothing.
        sizes: Of the most probable name, with the posterior of each; empty: it has none.
    """

    place: int
    probabilities: tuple[tuple[Name, float], ...]
    nats: float
    sizes: tuple[tuple[float, float], ...]

    @property
    def name(self) -> Name:
        """The most probable."""
        return self.probabilities[0][0]

    def quantile(self, share: float) -> float:
        """Of the size, by its posterior."""
        sizes, p = np.array(self.sizes).T
        return float(np.interp(share, (np.cumsum(p) - p / 2) / p.sum(), sizes))


class Competition:
    """All hypotheses about one part of a flight."""

    def __init__(self, body: Body) -> None:
        self.body = body
        n = body.rotors
        whole = np.ones(n)
        self._losses = [(i, d) for i in range(n) for d in LOSSES]
        self._left = np.array([whole, *(whole - d * np.eye(n)[i] for i, d in self._losses)])
        self.names = (
            Name(NOTHING),
            *(Name(ROTOR, i + 1) for i in range(n)),
            *map(Name, (ALL, MASS, PUSH, BLOW)),
        )

    # -- evidence ---------------------------------------------------------------------------

    def evidence(self, onsets: Places, low: int, high: int) -> dict[Name, Array]:
        """Log evidence of every size of every name, shape (onsets, sizes), within intervals."""
        by_curve = [
            self._of_curve(curvature, gram, usual, onsets, low, high)
            for (curvature, _), (gram, usual) in self.body.grams.items()
        ]
        return {n: logsumexp([found[n] for found in by_curve], axis=0) for n in self.names}

    def _of_curve(
        self, curvature: float, gram: Array, usual: Array, onsets: Places, low: int, high: int
    ) -> dict[Name, Array]:
        """The same for one curvature and lag."""
        body, one = self.body, self._left[:1]
        before = np.maximum(onsets - body.places(BEFORE_S), low), onsets
        after = onsets, np.minimum(onsets + body.places(AFTER_S), high)
        later = np.minimum(onsets + max(body.places(BLOW_S), 2), high)
        skipping = later, np.maximum(after[1], later)

        def channel(j: int, left: Array, step: bool = False, blow: bool = False) -> Array:
            reduced = self._reduced(j, gram[j], before, skipping if blow else after, step)
            shares = np.column_stack([left, np.full(len(left), -usual[j])])
            return _over_gains(*reduced, shares, *self._gains(j, abs(usual[0]), curvature))

        scaled = [channel(j, self._left) for j in range(4)]
        pushed = [channel(j, one, step=True) for j in range(4)]
        base = [s[:, :1] for s in scaled]
        each = np.sum(scaled, axis=0)
        n = len(LOSSES)
        found = {Name(NOTHING): each[:, :1]}
        for i in range(body.rotors):
            found[Name(ROTOR, i + 1)] = each[:, 1 + i * n : 1 + (i + 1) * n]
        weak = channel(0, (1 - LOSSES_OF_ALL)[:, None] * one)
        found[Name(ALL)] = weak + base[1] + base[2] + base[3]
        heavy = channel(0, one / (1 + MASSES)[:, None])
        found[Name(MASS)] = heavy + pushed[1] + pushed[2] + base[3]
        found[Name(PUSH)] = np.sum(pushed, axis=0)
        spikes = ((later - onsets) * 4 * SPIKE)[:, None]
        blown = [channel(j, one, blow=True) for j in range(4)]
        found[Name(BLOW)] = np.sum(blown, axis=0) - spikes
        return found

    def _reduced(
        self,
        j: int,
        gram: Array,
        before: tuple[Places, Places],
        after: tuple[Places, Places],
        step: bool,
    ) -> tuple[Array, Array]:
        """Per onset the Gram matrix of [S g after, 1 after, y] with gain before, damping, products,
        offset and its change, large where there is a step, marginalised; and the log of what that
        costs.

        Columns of the cumulated Gram matrix: n rotors, sum, damping, products, 1, y.
        """
        n = self.body.rotors
        prior, following = (TEMPER * (gram[b] - gram[a]) for a, b in (before, after))
        sd = [GAIN_SD, DAMPING_SD, PRODUCT_SD[j], OFFSET_SD[j]]
        sd += [self._steps[j] if step else self._trims[j]]
        inner = len(sd)
        size = inner + n + 2
        joined = np.zeros((len(prior), size, size))
        _add(joined, prior, [0, 1, 2, 3, size - 1], [n, n + 1, n + 2, n + 3, n + 4])
        columns = [n + 1, n + 2, n + 3, n + 3, *range(n), n + 3, n + 4]
        _add(joined, following, list(range(1, size)), columns)
        inside = joined[:, :inner, :inner] + np.diag(1 / np.square(sd))
        cross, outer = joined[:, :inner, inner:], joined[:, inner:, inner:]
        left = outer - cross.transpose(0, 2, 1) @ np.linalg.solve(inside, cross)
        return left, -0.5 * np.linalg.slogdet(inside)[1] - np.log(sd).sum()

    @cached_property
    def _trims(self) -> Array:
        """Deviation of the change of an offset under every hypothesis."""
        share = TRIM_SHARE if self.body.fast else TRIM_SHARE_SLOW
        return np.asarray(np.maximum(share * self._authority, 1e-3))

    @cached_property
    def _steps(self) -> Array:
        """The same under a force or a moment."""
        return np.asarray(np.maximum(LEAST_STEP, STEP_SHARE * self._authority))

    @cached_property
    def _authority(self) -> Array:
        return np.array([GRAVITY_M_S2, *self.body.authority[1:]])

    def _gains(self, j: int, total: float, curvature: float) -> tuple[Array, Array, Array]:
        """Prior of the gain after an onset as a mixture of normal distributions: log weights,
        means, deviations."""
        body = self.body
        usual, now = (1 + e * (2 * body.hover_command - 1) for e in (USUAL_CURVATURE, curvature))
        fit = body.noise.gain[j] * usual / now  # the same change of thrust at the usual command
        if j == 0 or fit <= 0:
            means = GRAVITY_M_S2 / total * GAINS[j]
            spread = LIFT_SPREAD * GRAVITY_M_S2 / total if j == 0 else GAIN_SPREAD * means
            return _evenly(means), means, np.broadcast_to(spread, means.shape)
        if not body.fast:
            means = fit * np.array(FLOORED[0])
            return _evenly(means), means, FLOORED[1] * means
        means, spreads = fit * np.array(TIED)
        weights = -0.5 * (np.log(means / fit) / 0.5) ** 2
        return weights - logsumexp(weights), means, spreads

    def unchanged(self, onsets: Places, low: int, high: int) -> Array:
        """Log evidence that nothing changes at all, not even gain and offset, in the window of
        each onset: what different onsets are measured by, since it does not depend on them."""
        body = self.body
        start = np.maximum(onsets - body.places(BEFORE_S), low)
        end = np.minimum(onsets + body.places(AFTER_S), high)
        return np.asarray(
            logsumexp(
                [
                    sum(
                        self._regression(j, TEMPER * (g[end] - g[start]))
                        for j, g in enumerate(gram)
                    )
                    for gram, _ in self.body.grams.values()
                ],
                axis=0,
            )
        )

    def _regression(self, j: int, gram: Array) -> Array:
        """Log evidence of one gain, damping, products and offset."""
        n = self.body.rotors
        sd = np.array([GAIN_SD, DAMPING_SD, PRODUCT_SD[j], OFFSET_SD[j]])
        inside = gram[:, n : n + 4, n : n + 4] + np.diag(1 / sd**2)
        cross = gram[:, n : n + 4, -1:]
        left = gram[:, -1, -1] - np.sum(cross * np.linalg.solve(inside, cross), axis=(1, 2))
        return np.asarray(-0.5 * left - 0.5 * np.linalg.slogdet(inside)[1] - np.log(sd).sum())

    # -- decision ---------------------------------------------------------------------------

    def odds(self, onsets: Places, low: int, high: int) -> tuple[Array, dict[Name, Array]]:
        """Log odds of each name against no change at all, shape (names, onsets), and the evidence
        of its sizes."""
        evidence = self.evidence(onsets, low, high)
        count = {c: sum(n.cause == c for n in self.names) for c in PRIOR}
        each = [
            logsumexp(evidence[n], axis=1)
            - np.log(evidence[n].shape[1] * count[n.cause])
            + PRIOR[n.cause]
            for n in self.names
        ]
        return np.array(each) - self.unchanged(onsets, low, high), evidence

    @cached_property
    def levels(self) -> Array:
        """Nats over nothing that make an event, of each name."""
        return np.array([LEVEL.get(n.cause, np.inf) for n in self.names])

    def asked(self, onsets: Places) -> Array:
        """Nats over nothing that each name needs at each onset: fewer of a rotor in the last
        seconds before control is lost, since something must have taken it."""
        body = self.body
        last = (onsets > body.last - body.places(LAST_WORD_S)) & body.lost
        soon = np.array([n.cause in FINAL for n in self.names])[:, None] & last
        return np.where(soon, LAST_WORD_NATS, self.levels[:, None])

    def onsets(self) -> list[Onset]:
        """All events, in order of time."""
        return list(self._within(0, len(self.body), 0))

    def _within(self, low: int, high: int, depth: int) -> Iterator[Onset]:
        body = self.body
        found = None if depth > DEPTH else self.strongest(low, high)
        if found is None:
            return
        yield from self._within(low, found.place - body.places(APART_S[0]), depth + 1)
        yield found
        if found.name.cause not in FINAL and body.last - found.place > body.places(AFTER_S):
            yield from self._within(found.place + body.places(APART_S[1]), high, depth + 1)

    def strongest(self, low: int, high: int, since: int = 0) -> Onset | None:
        """The strongest onset within places, `since` one of them; None: none passes."""
        place = self.best(low, high, since)
        return None if place is None else self.onset_at(place, low, high, since)

    def best(self, low: int, high: int, since: int = 0, short: float = 0.0) -> int | None:
        """Place of the strongest onset; None: none comes within `short` nats of its level."""
        tried = self._tried(max(low + self.body.places(FIRST_S), since), self._end(high))
        if len(tried) < 2:
            return None
        over = self._over(tried, low, high)
        return int(tried[np.argmax(over)]) if over.max() >= -short else None

    def onset_at(self, place: int, low: int, high: int, since: int = 0) -> Onset | None:
        """The best onset near a place; None: at a closer look none passes."""
        first = max(low + self.body.places(FIRST_S), since, place - self._stride)
        return self._onset(
            np.arange(first, min(place + self._stride + 1, self._end(high))), low, high
        )

    def _end(self, high: int) -> int:
        """Place behind the last possible onset."""
        return min(high - 2, self.body.last)

    def _over(self, tried: Places, low: int, high: int) -> Array:
        """Nats of the best name at each onset over its level, and over nothing near it."""
        odds, _ = self.odds(tried, low, high)
        nothing = maximum_filter1d(odds[0], 2 * round(AFTER_S / COARSE_S) + 1)
        return np.asarray((odds - nothing - self.asked(tried))[1:].max(axis=0))

    @property
    def _stride(self) -> int:
        return max(self.body.places(COARSE_S), 1)

    def _tried(self, first: int, last: int) -> Places:
        """Onsets that are tried within places: none where a command has just been at its stop."""
        tried = np.arange(first, last, self._stride)
        if self.body.lost:
            fine = max(self.body.last - self.body.places(FINELY_S), first)
            tried = np.unique(np.concatenate([tried, np.arange(fine, last)]))
        return tried[~self.body.limited[tried]]

    def _onset(self, near: Places, low: int, high: int) -> Onset | None:
        """The best of some onsets; None: at a closer look none passes."""
        odds, evidence = self.odds(near, low, high)
        over = odds - odds[0].max() - self.asked(near)
        m = int(np.argmax(over[1:].max(axis=0)))
        if over[1:, m].max() < 0:
            return None
        over[0] = 0.0  # nothing: names are weighed by what they have over their levels
        p = np.exp(over[:, m] - logsumexp(over[:, m]))
        order = np.argsort(-p, kind="stable")
        name = self.names[order[0]]
        return Onset(
            int(near[m]),
            tuple((self.names[i], float(p[i])) for i in order),
            float(odds[order[0], m] - odds[0].max()),
            _sizes(name, evidence[name][m]),
        )


def _add(to: Array, gram: Array, at: list[int], columns: list[int]) -> None:
    """Add columns of Gram matrices, shape (onsets, k, k), at places."""
    to[:, np.array(at)[:, None], at] += gram[:, np.array(columns)[:, None], columns]


def _evenly(means: Array) -> Array:
    return np.full(len(means), -np.log(len(means)))


def _over_gains(
    left: Array, cost: Array, shares: Array, weights: Array, means: Array, spreads: Array
) -> Array:
    """Log evidence with the gain s after the onset integrated over its prior, shape (onsets,
    shares): the integral of exp(-(yy - 2 s py + s^2 pp) / 2) N(s; m, v), s positive."""
    yy, py = left[:, -1, -1], left[:, :-1, -1] @ shares.T
    pp = np.sum((left[:, :-1, :-1] @ shares.T) * shares.T, axis=1)
    parts = []
    for weight, m, sd in zip(weights, means, spreads, strict=True):
        precision = pp + 1 / sd**2
        mean = (py + m / sd**2) / precision
        parts.append(
            weight
            + 0.5 * (mean**2 * precision - (m / sd) ** 2)
            - 0.5 * np.log(sd**2 * precision)
            + log_ndtr(mean * np.sqrt(precision))
        )
    return np.asarray(logsumexp(parts, axis=0) + (cost - 0.5 * yy)[:, None])


def _sizes(name: Name, evidence: Array) -> tuple[tuple[float, float], ...]:
    """Sizes of a name with their posterior."""
    grid = {ROTOR: LOSSES, ALL: LOSSES_OF_ALL, MASS: MASSES}.get(name.cause)
    if grid is None:
        return ()
    p = np.exp(evidence - logsumexp(evidence))
    return tuple(zip(grid.tolist(), p.tolist(), strict=True))
