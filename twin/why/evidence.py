"""Log evidence of every cause that moves the body, at every onset, with its gains marginalised.

Up to an onset the regression of `body` applies. From then on a cause changes the remaining share of
the rotors' thrust, suddenly or gradually, adds a constant force or moment, or a blow that passes.
Gain before, damping, products, offset, and a small change of the slope of each rotor are
marginalised as Gaussian, the gain after the onset over a mixture of them, sizes over their prior.
The log evidence is tempered (`TEMPER`): intervals are neither Gaussian nor free of model error.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np
from scipy.special import log_ndtr, logsumexp

from ..vehicle import GRAVITY_M_S2
from .body import GAIN_SD, LIFT_SPREAD, Body, ThrustLaw, expecting
from .causes import (
    ALL,
    BLOW,
    BLOWS,
    COARSE_LOSSES,
    FORCES,
    GROWS_S,
    LOADS,
    LOSSES,
    LOSSES_OF_ALL,
    MASS,
    MASSES,
    NOTHING,
    PUSH,
    Losses,
    Name,
    losses_of_one,
    losses_of_two,
)
from .flight import Array
from .noise import TEMPER, Places

BLOWS_S = (0.1, 0.3, 0.6, 1.0, 1.8)
"""Durations of a blow, equally probable."""
GAINS = (
    np.array([1.0]),
    np.geomspace(0.5, 200, 8),
    np.geomspace(0.5, 200, 8),
    np.geomspace(0.05, 10, 7),
)
"""Gain after an onset of each channel over that of gravity at full thrust, where nothing is known
of it, 1/m: arm times mass over inertia for roll and pitch, torque per thrust for yaw. Means of a
mixture of normal distributions, with standard deviations of `GAIN_SPREAD` times the mean. That of z
is known: total thrust carries the weight; `LIFT_SPREAD` is for the battery."""
GAIN_SPREAD = 0.5
SURELY_POSITIVE = 5.0
"""Standard deviations above zero from which a gain is positive."""
TIED = ((1.0, 0.75, 0.87, 1.0, 1.15, 1.33), (0.05, 0.1, 0.1, 0.1, 0.1, 0.1))
"""Means and standard deviations of the gain after an onset over that before it, where commands are
logged fast: mostly unchanged; of the others the middle has the largest weight."""
STAYS = 2.5
"""Log odds of an unchanged gain against the middle of the others: a judgement."""
FLOORED = np.array([[1.0], [0.3]]) * (0.8, 1.0, 1.6, 2.5, 4.0, 6.5, 10.0, 16.0)
"""Means and standard deviations with slowly logged commands: unlogged jitter biases the gain before
the onset downward, so it is a lower bound."""
SLOPE_SPREAD = 0.15
"""Standard deviation of the slope of each rotor after an onset over its gain: the curve of thrust
by command differs from all `CURVATURES` where the command of a rotor exceeds that before."""
LEAST_STEP = np.array([0.15 * GRAVITY_M_S2, 2.0, 2.0, 0.5])
"""Standard deviation of a sudden force or moment per mass or inertia, m/s^2 and rad/s^2; at least
`STEP_SHARE` of the effect of all rotors."""
STEP_SHARE = np.array([0.0, 0.1, 0.1, 0.05])
LOADED = 0.5
"""Standard deviation of the moment of an added or lost mass over that of its weight at a rotor of
an X: it is mostly located between the rotors."""
MOMENTS_OF = np.array([0.06, 0.15, 0.35])
"""Changes of the mass at which that is computed."""
TRIM_SHARE, TRIM_SHARE_SLOW = 0.007, 0.011
"""Largest change of an offset at any onset under every hypothesis, as a share of the effect of all
rotors on the channel. Wind, battery and an imperfect thrust map cause it; more where commands are
logged slowly, since they are unknown between samples."""
OFFSET_SD = np.array([3.0 * GRAVITY_M_S2, 30.0, 30.0, 30.0])
"""Standard deviation of a channel's offset, m/s^2 and rad/s^2."""
PRODUCT_SD = np.array([0.1, 1.0, 1.0, 1.0])
"""Standard deviation of the gyroscopic products: 1 for bodies, the lever arm of the accelerometer
for z, m."""
DAMPING_SD = np.array([0.5, 30.0, 30.0, 30.0])
"""Standard deviation of damping, 1/s: along z by the speed along the rotors' axis."""
DISAGREES = (0.02, 0.1, 0.2, 0.4)
"""Relative standard deviation of the difference between sizes by two channels, equally probable."""


Names = Literal["coarse", "fine", "growing"]
"""Sets of names: with few losses of one rotor, for the search of an onset; with all losses, two
rotors too; growing losses only."""


@dataclass(frozen=True, slots=True)
class Window:
    """Data for weighing onsets, as places; shape (onsets,) each.

    Attributes:
        start: First interval.
        onset: First interval after the onset.
        end: End of the intervals.
    """

    start: Places
    onset: Places
    end: Places


class Evidence:
    """Evidence of all causes about one part of a flight, by thrust and moments."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self._coarse = losses_of_one(body.rotors, COARSE_LOSSES)
        self._fine = losses_of_one(body.rotors, LOSSES) + losses_of_two(body.rotors)
        self._growing = losses_of_one(body.rotors, COARSE_LOSSES, grows=True)
        self._single = (NOTHING, ALL, MASS, PUSH, BLOW)

    def names(self, which: Names) -> tuple[Name, ...]:
        """Names of a set, `NOTHING` first."""
        first, *rest = map(Name, self._single)
        if which == "growing":
            return (first, *(x.name for x in self._growing))
        rotors = self._fine if which == "fine" else self._coarse
        return (first, *(x.name for x in rotors), *rest)

    def lost(self, name: Name) -> Array:
        """Lost thrust of each rotor, by size of a name, shape (sizes, rotors)."""
        if name.cause == ALL:
            return LOSSES_OF_ALL[:, None] * np.ones(self.body.rotors)
        known = self._growing if name.grows else self._fine
        lost = next(x.lost for x in known if x.name == name)
        return np.tile(lost, (len(GROWS_S), 1)) if name.grows else lost

    def blow_ends(self, window: Window) -> list[Places]:
        """Ends of blows of each duration."""
        lengths = (max(self.body.places(s), 1) for s in BLOWS_S)
        return [np.minimum(window.onset + m, window.end) for m in lengths]

    def by_size(self, window: Window, which: Names) -> dict[Name, Array]:
        """Log evidence of every size of every name of a set, shape (onsets, sizes)."""
        by_law = [
            {n: sum(each[1:], each[0]) for n, each in self._by_channel(law, window, which).items()}
            for law in self.body.laws
        ]
        return {n: logsumexp([x[n] for x in by_law], axis=0) for n in by_law[0]}

    def sizes_apart(self, name: Name, window: Window) -> Array:
        """Log posterior of the sizes of a name at one onset, where the size may differ by channel:
        their model errors differ. Shape (sizes,)."""
        lost = self.lost(name)
        which: Names = "growing" if name.grows else "fine"
        apart = np.linalg.norm(lost[:, None] - lost, axis=2) / np.linalg.norm(lost, axis=1)[:, None]
        if name.grows:
            group = np.repeat(np.arange(len(GROWS_S)), len(lost) // len(GROWS_S))
            apart[group[:, None] != group] = np.inf
        total = []
        for law in self.body.laws:
            each = np.array(self._by_channel(law, window, which)[name])[:, 0]
            for spread in DISAGREES:
                near = -0.5 * (apart / spread) ** 2
                near -= logsumexp(near, axis=1)[:, None]
                total.append(logsumexp(near + each[:, None], axis=2).sum(axis=0))
        return np.asarray(logsumexp(total, axis=0))

    def planted(self, window: Window) -> Array:
        """Log evidence over no event for each rotor, if it had lost each of `LOSSES` at the onset,
        by the most probable law, shape (onsets, rotors, losses)."""
        law, n = self.body.laws[0], self.body.rotors
        channels = [_Channel(self, law, j, window, True) for j in range(4)]
        found = np.empty((len(window.onset), n, len(LOSSES)))
        for (i, losses), (k, lost) in product(enumerate(self._coarse), enumerate(LOSSES)):
            left = 1 - np.concatenate([np.zeros((1, n)), losses.lost])
            each = np.sum([c.planted(i, lost, left) for c in channels], axis=0)
            found[:, i, k] = logsumexp(each[:, 1:], axis=1) - np.log(len(losses.lost)) - each[:, 0]
        return found

    def unchanged(self, window: Window) -> Array:
        """Log evidence of no change at all, not even of gain and offset: the common reference of
        different onsets, since it does not depend on them."""

        def of(law: ThrustLaw, j: int) -> Array:
            gram = law.channels[j].gram
            return self._regression(j, TEMPER * (gram[window.end] - gram[window.start]), law.usual)

        laws = [sum(of(law, j) for j in range(4)) for law in self.body.laws]
        return np.asarray(logsumexp(laws, axis=0))

    def _by_channel(self, law: ThrustLaw, w: Window, which: Names) -> dict[Name, list[Array]]:
        """Log evidence of each size of each name by one law, by channel, shape (onsets, sizes)."""
        channels = [_Channel(self, law, j, w, which != "coarse") for j in range(4)]
        one = np.ones((1, self.body.rotors))
        if which == "growing":
            grown = [c.growing(self._growing) for c in channels]
            found = {x.name: [g[i] for g in grown] for i, x in enumerate(self._growing)}
            return {Name(NOTHING): [c.scaled(one) for c in channels]} | found
        losses = self._fine if which == "fine" else self._coarse
        edges = np.cumsum([1, *(len(x.lost) for x in losses)])
        left = np.concatenate([one, *(1 - x.lost for x in losses)])
        scaled = [c.scaled(left) for c in channels]
        pushed = [c.pushed() for c in channels]
        base = [s[:, :1] for s in scaled]
        found = {Name(NOTHING): base}
        for x, a, b in zip(losses, edges[:-1], edges[1:], strict=True):
            found[x.name] = [s[:, a:b] for s in scaled]
        heavy = channels[0].scaled(one / (1 + LOADS)[:, None])
        found[Name(ALL)] = [c.scaled((1 - LOSSES_OF_ALL)[:, None] * one) for c in channels]
        found[Name(MASS)] = [heavy, *(c.loaded() for c in channels[1:3]), base[3]]
        kinds = zip(pushed, base, FORCES.T[:4], strict=True)
        found[Name(PUSH)] = [np.where(acts, p, b) for p, b, acts in kinds]
        blown = [c.blown(self.blow_ends(w)) for c in channels]
        found[Name(BLOW)] = [
            np.hstack([p if acts else np.broadcast_to(b, p.shape) for acts in where])
            for p, b, where in zip(blown, base, BLOWS.T, strict=True)
        ]
        return found

    @cached_property
    def trims(self) -> Array:
        """Standard deviation of the change of an offset under every hypothesis."""
        share = TRIM_SHARE if self.body.fast else TRIM_SHARE_SLOW
        return np.asarray(np.maximum(share * self.authority, 1e-3))

    @cached_property
    def steps(self) -> Array:
        """Standard deviation of the change of an offset under a force or a moment."""
        return np.asarray(np.maximum(LEAST_STEP, STEP_SHARE * self.authority))

    @cached_property
    def authority(self) -> Array:
        """Effect of all rotors on each channel, shape (4,)."""
        return np.array([GRAVITY_M_S2, *self.body.authority[1:]])

    def gains(self, j: int, law: ThrustLaw) -> tuple[Array, Array, Array]:
        """Prior of the gain after an onset as a mixture of normal distributions: log weights,
        means, standard deviations."""
        fit, lift = law.gain[j], GRAVITY_M_S2 / abs(law.usual[0])
        if j == 0 or fit < 2 * law.gain_sd[j]:
            means = lift * GAINS[j]
            spread = LIFT_SPREAD * lift if j == 0 else GAIN_SPREAD * means
            return _evenly(means), means, np.broadcast_to(spread, means.shape)
        means, spreads = fit * (np.array(TIED) if self.body.fast else FLOORED)
        spreads = np.hypot(spreads, law.gain_sd[j])
        weights = -0.5 * (np.log(means / fit) / 0.5) ** 2 * self.body.fast
        weights[0] += STAYS * self.body.fast
        return weights - logsumexp(weights), means, spreads

    def _regression(self, j: int, gram: Array, usual: Array) -> Array:
        """Log evidence of one gain, damping, products and offset."""
        lifted = self.body.lift_gain(usual) if j == 0 else (0.0, GAIN_SD)
        gram = expecting(gram[:, self.body.rotors :, self.body.rotors :], 0, *lifted)
        sd = np.array([lifted[1], DAMPING_SD[j], PRODUCT_SD[j], OFFSET_SD[j]])
        inside = gram[:, :4, :4] + np.diag([0.0, *(1 / sd[1:] ** 2)])
        cross = gram[:, :4, -1:]
        left = gram[:, -1, -1] - np.sum(cross * np.linalg.solve(inside, cross), axis=(1, 2))
        return np.asarray(-0.5 * left - 0.5 * np.linalg.slogdet(inside)[1] - np.log(sd).sum())


class _Channel:
    """One channel under one law of thrust: log evidence of each kind of cause, (onsets, sizes)."""

    def __init__(
        self, evidence: Evidence, law: ThrustLaw, j: int, window: Window, bends: bool
    ) -> None:
        self._evidence, self._law, self._j, self._window = evidence, law, j, window
        self._bends = bends
        self._rows = law.channels[j]
        self._joined = self._rows.joined(window.start, window.onset, window.end)
        self._prior = evidence.gains(j, law)

    def scaled(self, left: Array) -> Array:
        """Log evidence by remaining shares of the rotors' thrust, shape (sizes, rotors)."""
        return self._over_gains(self._base, left)

    def planted(self, rotor: int, lost: float, left: Array) -> Array:
        """Log evidence as in `scaled`, if a rotor had lost a share of its thrust at the onset."""
        gram, cost = self._base
        shift = np.eye(gram.shape[1])
        shift[rotor, -1] = -lost * max(self._law.gain[self._j], 0.0)
        return self._over_gains((shift.T @ gram @ shift, cost), left)

    def pushed(self) -> Array:
        """Log evidence of a permanent force or moment."""
        return self._stepped(self._evidence.steps[self._j])

    def loaded(self) -> Array:
        """Log evidence of an added or lost mass, see `LOADS`."""
        sd, least = LOADED * self._evidence.authority[self._j], self._evidence.trims[self._j]
        near = np.argmin(np.abs(np.log(np.abs(MASSES)[:, None] / MOMENTS_OF)), axis=1)
        turned = np.hstack([self._stepped(x) for x in np.maximum(sd * MOMENTS_OF, least)])
        return np.hstack(
            [np.repeat(self.scaled(self._sound), len(MASSES), axis=1), turned[:, near]]
        )

    def _stepped(self, sd: float) -> Array:
        return self._over_gains(self._reduced(self._joined, step=sd), self._sound)

    def blown(self, ends: Sequence[Places]) -> Array:
        """Log evidence of a force or moment that passes, by its duration."""
        w, one = self._window, self._evidence.body.rotors + 3
        grams = (self._rows.passing(self._joined, one, w.onset, over, w.end) for over in ends)
        each = [self._over_gains(self._reduced(g, passing=1), self._sound) for g in grams]
        return np.concatenate(each, axis=1)

    def growing(self, losses: Sequence[Losses]) -> list[Array]:
        """Log evidence of growing losses, their sizes for each time of growth."""
        body, w = self._evidence.body, self._window
        thrust = self._law.thrust * body.signs[self._j]
        found: list[list[Array]] = [[] for _ in losses]
        for seconds in GROWS_S:
            over = max(seconds / body.frame.dt_s, 1.0)
            gram = self._rows.growing(self._joined, thrust, over, w.onset, w.end)
            reduced = self._reduced(gram, growing=body.rotors)
            lost = np.concatenate([x.lost for x in losses])
            each = self._over_gains(reduced, np.ones_like(lost), -lost)
            for mine, part in zip(found, np.split(each, len(losses), axis=1), strict=True):
                mine.append(part)
        return [np.concatenate(mine, axis=1) for mine in found]

    @property
    def _sound(self) -> Array:
        return np.ones((1, self._evidence.body.rotors))

    @cached_property
    def _base(self) -> tuple[Array, Array]:
        return self._reduced(self._joined)

    def _reduced(
        self, gram: Array, *, step: float | None = None, passing: int = 0, growing: int = 0
    ) -> tuple[Array, Array]:
        """Gram matrix per onset of [S g after, 1 after, growing columns, y] with gain before,
        damping, products, offset and its change, slopes, and a blow marginalised; and the log of
        the marginalisation's cost.

        Columns of the Gram matrix: n rotors, sum, damping, products, 1, y; all of them from the
        onset on; a blow or growing columns.

        Args:
            gram: Gram matrices, shape (onsets, m, m).
            step: Standard deviation of a force or a moment that begins; None: none does.
            passing: Number of columns of a blow.
            growing: Number of growing columns.
        """
        body, j = self._evidence.body, self._j
        n, usual = body.rotors, self._law.usual
        before = body.lift_gain(usual) if j == 0 else (0.0, GAIN_SD)
        changes = self._evidence.trims[j] if step is None else step
        k = n + 5
        sd = [before[1], DAMPING_SD[j], PRODUCT_SD[j], OFFSET_SD[j], changes]
        sd += [self._evidence.steps[j]] * passing
        inner = len(sd)
        picked = np.zeros((gram.shape[1], inner + n + 2 + growing))
        picked[[n, n + 1, n + 2, n + 3], [0, 1, 2, 3]] = 1.0
        picked[[k + n, k + n + 3], [0, 4]] = -1.0, 1.0
        picked[2 * k : 2 * k + passing, 5:inner] = 1.0
        grown = [*range(2 * k, 2 * k + growing)]
        outer = [*range(k, k + n), k + n + 3, *grown, n + 4]
        picked[outer, range(inner, picked.shape[1])] = 1.0
        tempered = expecting(TEMPER * (picked.T @ gram @ picked), 0, *before)
        reduced = _marginal(tempered, np.array(sd))
        return self._with_slopes(*reduced) if self._bends else reduced

    def _with_slopes(self, left: Array, cost: Array) -> tuple[Array, Array]:
        """Gram matrices with a small change of the slope of each rotor about its mean thrust after
        the onset marginalised."""
        n, w = self._evidence.body.rotors, self._window
        mean = self._law.mean_thrust(w.onset, w.end) * self._evidence.body.signs[self._j]
        sd = SLOPE_SPREAD * self._prior[1][0]
        slopes = np.zeros((len(left), left.shape[1], n))
        slopes[:, range(n), range(n)] = 1.0
        slopes[:, n] = -mean
        crossed = left @ slopes
        inside = slopes.transpose(0, 2, 1) @ crossed + np.eye(n) / sd**2
        out = left - crossed @ np.linalg.solve(inside, crossed.transpose(0, 2, 1))
        return out, cost - 0.5 * np.linalg.slogdet(inside)[1] - n * np.log(sd)

    def _over_gains(
        self, reduced: tuple[Array, Array], left: Array, growing: Array | None = None
    ) -> Array:
        """Log evidence with the gain after the onset integrated over its prior.

        Args:
            reduced: Result of `_reduced`.
            left: Remaining share of each rotor's thrust, shape (sizes, rotors).
            growing: Growing share, shape (sizes, rotors); None: none.
        """
        usual = np.full((len(left), 1), -self._law.usual[self._j])
        shares = [left, usual] if growing is None else [left, usual, growing]
        return _over_gains(*reduced, np.hstack(shares), *self._prior)


def _marginal(gram: Array, sd: Array) -> tuple[Array, Array]:
    """Gram matrices without their first columns, which are marginalised, and the log of its cost.

    Args:
        gram: Gram matrices with the prior on the number of the first column, shape (onsets, m, m).
        sd: Standard deviation of the numbers of these columns, normal about zero except for the
            first.
    """
    inner = len(sd)
    inside = gram[:, :inner, :inner] + np.diag([0.0, *(1 / np.square(sd[1:]))])
    cross, outer = gram[:, :inner, inner:], gram[:, inner:, inner:]
    left = outer - cross.transpose(0, 2, 1) @ np.linalg.solve(inside, cross)
    return left, -0.5 * np.linalg.slogdet(inside)[1] - np.log(sd).sum()


def _evenly(means: Array) -> Array:
    return np.full(len(means), -np.log(len(means)))


def _over_gains(
    left: Array, cost: Array, shares: Array, weights: Array, means: Array, spreads: Array
) -> Array:
    """Log evidence with the gain s after the onset integrated over its prior, shape (onsets,
    shares): the integral of exp(-(yy - 2 s py + s^2 pp) / 2) N(s; m, v), s positive."""
    yy, py = left[:, -1, -1], left[:, :-1, -1] @ shares.T
    pp = np.sum((left[:, :-1, :-1] @ shares.T) * shares.T, axis=1)
    parts = np.empty((len(means), *py.shape))
    for part, weight, m, sd in zip(parts, weights, means, spreads, strict=True):
        precision = pp + 1 / sd**2
        mean, root = (py + m / sd**2) / precision, np.sqrt(precision)
        part[:] = weight + 0.5 * ((mean * root) ** 2 - (m / sd) ** 2) - np.log(sd * root)
        near = mean * root < SURELY_POSITIVE
        part[near] += log_ndtr((mean * root)[near])
    top = parts.max(axis=0)
    total: Array = top + np.log(np.exp(parts - top).sum(axis=0)) + (cost - 0.5 * yy)[:, None]
    return total
