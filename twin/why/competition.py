"""What moved the body, and when: all hypotheses compete in one marginal likelihood at each onset.

Up to an onset the regression of `body` holds. From it on a hypothesis changes the share of thrust
that rotors have left, adds a constant force or moment, or a blow that passes. Gain before,
damping, products and offset are marginalised as Gaussian, the gain after the onset over a grid of
its logarithm, sizes over their prior. A share of the log evidence is believed (`TEMPER`): intervals
are neither Gaussian nor free of model error.

What begins first is looked for by recursion: the strongest onset, then what came before it, then
what came after it. No onset is tried after a loss of control; in the seconds before it the last
word is spoken, at a lower level.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.special import log_ndtr, logsumexp

from ..vehicle import GRAVITY_M_S2
from .body import GAIN_SD, LIFT_SPREAD, Body, ThrustLaw, expecting
from .flight import Array
from .noise import TEMPER, Places
from .sideways import Sideways, alongside

BEFORE_S, AFTER_S = 60.0, 6.0
"""What an onset is weighed on: before it and after it."""
BLOWS_S = (0.1, 0.3, 1.0)
"""Lengths of a blow, alike probable."""
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
COARSE_LOSSES = LOSSES[::4]
"""The same while an onset is looked for."""
LOSSES_OF_ALL = np.array([0.08, 0.15, 0.25, 0.4, 0.6, 0.8, 1.0])
"""Of the thrust of all rotors."""
MASSES = np.array([-0.5, *np.linspace(-0.4, -0.1, 7), -0.06, 0.06, *np.linspace(0.1, 0.4, 7), 0.5])
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
GAIN_SPREAD = 0.5
SURELY_POSITIVE = 5.0
"""Deviations from zero from which on a gain is positive."""
TIED = ((0.5, 0.7, 1.0, 1.4, 2.0), (0.25, 0.3, 0.3, 0.3, 0.3))
"""Means and deviations of the gain after an onset over that before it, where commands are logged
fast; the middle weighs most."""
FLOORED = np.array([[1.0], [0.3]]) * (0.8, 1.0, 1.6, 2.5, 4.0, 6.5, 10.0, 16.0)
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
DAMPING_SD = 30.0
"""Of damping, 1/s."""
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
AIR = (PUSH, BLOW)
"""Causes that act across the thrust as well."""
PRIOR = {NOTHING: 0.0, ROTOR: -1.5, ALL: -3.0, MASS: -3.0, PUSH: -5.0, BLOW: -2.0}
"""Log odds of a cause at an onset against nothing."""
STEADY_VOLTAGE, UNSEEN_NATS = 0.02, 3.0
"""All rotors lose thrust together where the voltage falls: where it is logged and falls by less
within `SAGS_S`, that is less probable by so much."""
SAGS_S = 2.0
"""In which a voltage that falls is seen."""
FALSE_NAMES_10_H = 1.0
"""Expected number of false names of all causes together in ten hours of normal flight."""
TAILS = {**dict.fromkeys((ROTOR, ALL, MASS, PUSH), (4.0, 6.5)), BLOW: (10.0, 18.0)}
"""Of the largest log odds over nothing in a normal flight: how often they pass zero, 1/h, and their
mean excess over it, nats. 0.8 h simulated with gusts, landings and throttle punches, 0.25 h
recorded (CrazyPAD, the excitations of crazyflie_motor_delay); none is scored for sudden events."""
LEVEL = {
    cause: nats * np.log(per_h * 10 * len(TAILS) / FALSE_NAMES_10_H)
    for cause, (per_h, nats) in TAILS.items()
}
"""Nats over nothing from which on there is an event, by an exponential tail."""
SCREENED = 12.0
"""Nats below its level from which on a name under one law of thrust is looked at under all."""
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


@dataclass(frozen=True, slots=True)
class Odds:
    """Of all names at onsets; those that are not of the air are judged on thrust and moments alone,
    so that a gust is not evidence of a rotor.

    Attributes:
        odds: Log odds against no change at all, shape (names, onsets).
        nothing: The same of nothing, on what each name is judged on, shape (names, onsets).
        across: What the axes across the thrust say more for a name than for nothing, where it is
            not judged on them, shape (names, onsets).
        sizes: Log evidence of the sizes of each name, shape (onsets, sizes).
    """

    odds: Array
    nothing: Array
    across: Array
    sizes: Mapping[Name, Array]


def drop(values: Array, over: int) -> Array:
    """Running mean before each instant less that after it, shape (n,); the ends are held.

    Args:
        values: Shape (n,).
        over: Samples of a mean.
    """
    mean, at = uniform_filter1d(values, over, mode="nearest"), np.arange(len(values))
    before, after = (mean[np.clip(at + k, 0, len(at) - 1)] for k in (-(over // 2), over // 2))
    return np.asarray(before - after)


class Competition:
    """All hypotheses about one part of a flight."""

    def __init__(self, body: Body) -> None:
        self.body, self._sideways = body, Sideways(body)
        self.names = (
            Name(NOTHING),
            *(Name(ROTOR, i + 1) for i in range(body.rotors)),
            *map(Name, (ALL, MASS, PUSH, BLOW)),
        )

    # -- evidence ---------------------------------------------------------------------------

    def evidence(
        self, onsets: Places, start: Places, end: Places, losses: Array
    ) -> dict[Name, Array]:
        """Log evidence of every size of every name by thrust and moments, shape (onsets, sizes),
        within windows; of rotors by some losses."""
        over = self._blow_ends(onsets, end)
        by_curve = [self._of_law(law, (start, onsets, end), over, losses) for law in self.body.laws]
        return {n: logsumexp([x[n] for x in by_curve], axis=0) for n in self.names}

    def _blow_ends(self, onsets: Places, end: Places) -> list[Places]:
        """Where blows of each length are over."""
        lengths = (max(self.body.places(s), 1) for s in BLOWS_S)
        return [np.minimum(onsets + m, end) for m in lengths]

    def _of_law(
        self,
        law: ThrustLaw,
        window: tuple[Places, Places, Places],
        over: Sequence[Places],
        losses: Array,
    ) -> dict[Name, Array]:
        """The same for one law of thrust."""
        (start, onsets, end), rotors, n = window, self.body.rotors, len(losses)
        one, constant = np.ones((1, rotors)), rotors + 3
        each_loss = (np.ones(rotors) - d * np.eye(rotors)[i] for i in range(rotors) for d in losses)
        left_over = np.array([one[0], *each_loss])
        joined = [c.joined(start, onsets, end) for c in law.channels]
        blown = [
            [
                c.passing(g, constant, onsets, places, end)
                for c, g in zip(law.channels, joined, strict=True)
            ]
            for places in over
        ]

        def channel(j: int, gram: Array, left: Array, step: bool = False) -> Array:
            shares = np.column_stack([left, np.full(len(left), -law.usual[j])])
            before = self.body.lift_gain(law.usual) if j == 0 else (0.0, GAIN_SD)
            return _over_gains(*self._reduced(j, gram, step, before), shares, *self._gains(j, law))

        scaled = [channel(j, joined[j], left_over) for j in range(4)]
        pushed = [channel(j, joined[j], one, step=True) for j in range(4)]
        base = [s[:, :1] for s in scaled]
        each = np.sum(scaled, axis=0)
        found = {Name(NOTHING): each[:, :1]}
        for i in range(rotors):
            found[Name(ROTOR, i + 1)] = each[:, 1 + i * n : 1 + (i + 1) * n]
        weak = [channel(j, joined[j], (1 - LOSSES_OF_ALL)[:, None] * one) for j in range(4)]
        found[Name(ALL)] = np.sum(weak, axis=0)
        heavy = channel(0, joined[0], one / (1 + MASSES)[:, None])
        found[Name(MASS)] = heavy + pushed[1] + pushed[2] + base[3]
        found[Name(PUSH)] = np.sum(pushed, axis=0)
        found[Name(BLOW)] = np.column_stack(
            [np.sum([channel(j, b[j], one) for j in range(4)], axis=0)[:, 0] for b in blown]
        )
        return found

    def _window(self, onsets: Places, low: int, high: int) -> tuple[Places, Places]:
        """First interval of what each onset is weighed on, and that behind the last."""
        start = np.maximum(onsets - self.body.places(BEFORE_S), low)
        return start, np.minimum(onsets + self.body.places(AFTER_S), high)

    def _reduced(
        self, j: int, gram: Array, step: bool, before: tuple[float, float]
    ) -> tuple[Array, Array]:
        """Per onset the Gram matrix of [S g after, 1 after, y] with gain before, damping, products,
        offset and its change, large where there is a step, and a blow marginalised; and the log of
        what that costs.

        Columns of the Gram matrix: n rotors, sum, damping, products, 1, y; all of them from the
        onset on; a blow.

        Args:
            j: Number of the channel.
            gram: Shape (onsets, k, k).
            step: Whether a force or a moment begins.
            before: Mean and deviation of the gain before.
        """
        n = self.body.rotors
        k = n + 5
        sd = [before[1], DAMPING_SD, PRODUCT_SD[j], OFFSET_SD[j]]
        sd += [self._steps[j] if step else self._trims[j]]
        sd += [self._steps[j]] * (gram.shape[1] - 2 * k)
        inner = len(sd)
        picked = np.zeros((gram.shape[1], inner + n + 2))
        picked[[n, n + 1, n + 2, n + 3], [0, 1, 2, 3]] = 1.0
        picked[[k + n, k + n + 3], [0, 4]] = -1.0, 1.0
        picked[2 * k :, 5:inner] = 1.0
        picked[[*range(k, k + n), k + n + 3, n + 4], range(inner, inner + n + 2)] = 1.0
        tempered = expecting(TEMPER * (picked.T @ gram @ picked), 0, *before)
        inside = tempered[:, :inner, :inner] + np.diag([0.0, *(1 / np.square(sd[1:]))])
        cross, outer = tempered[:, :inner, inner:], tempered[:, inner:, inner:]
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

    def _gains(self, j: int, law: ThrustLaw) -> tuple[Array, Array, Array]:
        """Prior of the gain after an onset as a mixture of normal distributions: log weights,
        means, deviations."""
        fit, lift = law.gain[j], GRAVITY_M_S2 / abs(law.usual[0])
        if j == 0 or fit < 2 * law.gain_sd[j]:
            means = lift * GAINS[j]
            spread = LIFT_SPREAD * lift if j == 0 else GAIN_SPREAD * means
            return _evenly(means), means, np.broadcast_to(spread, means.shape)
        means, spreads = fit * (np.array(TIED) if self.body.fast else FLOORED)
        spreads = np.hypot(spreads, law.gain_sd[j])
        weights = -0.5 * (np.log(means / fit) / 0.5) ** 2 * self.body.fast
        return weights - logsumexp(weights), means, spreads

    def unchanged(self, start: Places, end: Places) -> Array:
        """Log evidence that nothing changes at all, not even gain and offset, in windows: what
        different onsets are measured by, since it does not depend on them."""
        return np.asarray(
            logsumexp(
                [
                    sum(
                        self._regression(j, TEMPER * (c.gram[end] - c.gram[start]), law.usual)
                        for j, c in enumerate(law.channels)
                    )
                    for law in self.body.laws
                ],
                axis=0,
            )
        )

    def _regression(self, j: int, gram: Array, usual: Array) -> Array:
        """Log evidence of one gain, damping, products and offset."""
        lifted = self.body.lift_gain(usual) if j == 0 else (0.0, GAIN_SD)
        gram = expecting(gram[:, self.body.rotors :, self.body.rotors :], 0, *lifted)
        sd = np.array([lifted[1], DAMPING_SD, PRODUCT_SD[j], OFFSET_SD[j]])
        inside = gram[:, :4, :4] + np.diag([0.0, *(1 / sd[1:] ** 2)])
        cross = gram[:, :4, -1:]
        left = gram[:, -1, -1] - np.sum(cross * np.linalg.solve(inside, cross), axis=(1, 2))
        return np.asarray(-0.5 * left - 0.5 * np.linalg.slogdet(inside)[1] - np.log(sd).sum())

    # -- decision ---------------------------------------------------------------------------

    def odds(
        self,
        onsets: Places,
        low: int,
        high: int,
        window: tuple[int, int] | None = None,
        losses: Array = COARSE_LOSSES,
    ) -> "Odds":
        """Of all names at onsets.

        Args:
            onsets: Which are tried.
            low: First interval that counts.
            high: Behind the last.
            window: One for all of these onsets, so that they compare; None: each has its own.
            losses: Of rotors that are tried.
        """
        own = self._window(onsets, low, high)
        start, end = own if window is None else (np.full_like(onsets, w) for w in window)
        sizes, over = self.evidence(onsets, start, end, losses), self._blow_ends(onsets, end)
        still, lasting, passing = self._sideways.evidence(start, onsets, end, over)
        sizes[Name(BLOW)] = sizes[Name(BLOW)] + passing - still[:, None]
        sizes[Name(PUSH)] = sizes[Name(PUSH)] + (lasting - still)[:, None]
        count = {c: sum(n.cause == c for n in self.names) for c in PRIOR}
        each = np.array(
            [
                logsumexp(sizes[n], axis=1)
                - np.log(sizes[n].shape[1] * count[n.cause])
                + PRIOR[n.cause]
                for n in self.names
            ]
        )
        each[self.names.index(Name(ALL))] -= UNSEEN_NATS * self._steady_voltage[onsets]
        body, air = self.unchanged(start, end), self._sideways.unchanged(start, end)
        of_air = np.array([n.cause in AIR for n in self.names])[:, None]
        either = alongside(still, lasting, passing) - still
        return Odds(
            odds=each - body + of_air * (still - air),
            nothing=each[0] - body + of_air * (still - air),
            across=np.where(of_air | (np.arange(len(each)) == 0)[:, None], 0.0, either),
            sizes=sizes,
        )

    @cached_property
    def _steady_voltage(self) -> Array:
        """1 where a voltage is logged and does not fall at an interval, else 0, shape (n,)."""
        body, grid = self.body, self.body.frame.grid
        if "vbat" not in grid:
            return np.zeros(len(body))
        volts, back = grid["vbat"][:, 0], body.places(SAGS_S)
        fallen = drop(volts, back)[body.start : body.end] / max(float(np.median(volts)), 1e-9)
        return np.asarray((fallen < STEADY_VOLTAGE).astype(float))

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
        event = None if depth > DEPTH else self.strongest(low, high)
        if event is None:
            return
        yield from self._within(low, event.place - body.places(APART_S[0]), depth + 1)
        yield event
        if event.name.cause not in FINAL and body.last - event.place > body.places(AFTER_S):
            yield from self._within(event.place + body.places(APART_S[1]), high, depth + 1)

    def _earliest(self, tried: Places, best: int, low: int, high: int) -> int:
        """The best of the onsets about one, all on one window: of two onsets that each explain what
        follows, the window of the later one shows more of it."""
        reach = self.body.places(AFTER_S)
        near = tried[np.abs(tried - best) < reach]
        over, _ = self._compared(near, low, high)
        return int(near[np.argmax(over[1:].max(axis=0))])

    def _compared(
        self, near: Places, low: int, high: int, losses: Array = COARSE_LOSSES
    ) -> tuple[Array, Odds]:
        """Nats over what each name needs at onsets near each other."""
        found = self.odds(near, low, high, self._about(near, low, high), losses)
        return found.odds - found.nothing.max(axis=1)[:, None] - self.asked(near), found

    def _about(self, near: Places, low: int, high: int) -> tuple[int, int]:
        start, end = self._window(near, low, high)
        return int(start.min()), int(end.max())

    def strongest(self, low: int, high: int, since: int = 0) -> Onset | None:
        """The strongest onset within places, `since` one of them; None: none passes."""
        found = (self.onset_at(place, low, high, since) for place in self.peaks(low, high, since))
        return next((onset for onset in found if onset is not None), None)

    def peaks(self, low: int, high: int, since: int = 0) -> Iterator[int]:
        """Places of onsets that come within `SCREENED` of their level under a law of thrust, the
        strongest first, `AFTER_S` apart; where each is, all laws say."""
        tried = self._tried(max(low + self.body.places(FIRST_S), since), self._end(high))
        if len(tried) < 2:
            return
        screened = [Competition(b)._over(tried, low, high) for b in self.body.screening()]
        over = np.max(screened, axis=0)
        while over.max() >= -SCREENED:
            place = int(tried[np.argmax(over)])
            yield self._earliest(tried, place, low, high)
            over[np.abs(tried - place) < self.body.places(AFTER_S)] = -np.inf

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
        found = self.odds(tried, low, high)
        nothing = maximum_filter1d(found.nothing, 2 * round(AFTER_S / COARSE_S) + 1, axis=1)
        return np.asarray((found.odds - nothing - self.asked(tried))[1:].max(axis=0))

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
        over, found = self._compared(near, low, high, LOSSES)
        m = int(np.argmax(over[1:].max(axis=0)))
        if over[1:, m].max() < 0:
            return None
        nats = found.odds[:, m] - found.nothing.max(axis=1)
        weighed = np.where(over[:, m] >= 0, over[:, m] + found.across[:, m], over[:, m])
        weighed[0] = 0.0  # nothing: names are weighed by what they have over their levels
        p = np.exp(weighed - logsumexp(weighed))
        order = np.argsort(-p, kind="stable")
        name = self.names[order[0]]
        return Onset(
            int(near[m]),
            tuple((self.names[i], float(p[i])) for i in order),
            float(nats[order[0]]),
            _sizes(name, found.sizes[name][m]),
        )


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


def _sizes(name: Name, evidence: Array) -> tuple[tuple[float, float], ...]:
    """Sizes of a name with their posterior."""
    grid = {ROTOR: LOSSES, ALL: LOSSES_OF_ALL, MASS: MASSES}.get(name.cause)
    if grid is None:
        return ()
    p = np.exp(evidence - logsumexp(evidence))
    return tuple(zip(grid.tolist(), p.tolist(), strict=True))
