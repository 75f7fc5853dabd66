"""Running evidence: which effect has begun, since when, by how much, second by second."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...component.along import BUILDING
from ...effects import EFFECTS, STANDING, Repeats
from ...errors import LogError
from ...representation import short_repr
from ...residuals.stream import LONGEST_WAIT_S, Rows, Stream
from ...vehicle import Vehicle
from .alarms import Alarm, EstimatedChange, Shaking, SilentSign, StandStill, Verdict
from .detector import AdaptiveNoise, ChangeDetector, ChangeEvidence, information
from .frames import FRAME_S, Frame, FrameFilter
from .hypotheses import MONITORED_EFFECTS, RUNNING, RunningSettings, library_of

Array = NDArray[np.float64]
LEAST_SHARE = 0.05
"""Least probability with which another effect is listed. Made up."""


@dataclass(frozen=True, slots=True)
class ScoredHypothesis:
    """A cause as it stands now.

    Attributes:
        effect: Identifier.
        log_odds: Against nothing, all beginnings together.
        change: The hypothesis.
        best: Position of the likeliest beginning.
    """

    effect: str
    log_odds: float
    change: ChangeEvidence
    best: int

    __repr__ = short_repr

    @property
    def start(self) -> int:
        """Frame of the likeliest beginning."""
        return int(self.change.starts[self.best])


@dataclass(frozen=True, slots=True)
class _PendingAlarm:
    """An alarm that competes with other effects still; `ends`: it ends an older alarm."""

    alarm: Alarm
    start: int
    ends: bool


class RunningEvidence:
    """Evidence that effects have begun in flight, on top of a calibrated model.

    It takes rows of a flight table as they come, in portions of any size, and keeps of the past a
    bounded number of sums: neither time nor memory grow with the flight.

    Attributes:
        learning: Whether the quiet start is not over yet.
        effects: To be built into the airframe of a stream that is followed.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        effects: Sequence[str] = MONITORED_EFFECTS,
        settings: RunningSettings = RUNNING,
        standing_effects: Sequence[str] = STANDING,
    ) -> None:
        """Begin a flight.

        Args:
            vehicle: The calibrated model.
            effects: What may begin, identifiers of the effect library.
            settings: When an alarm is raised.
            standing_effects: By which the standing model may be a little off as well.

        Raises:
            ModelError: There is no such effect, or nothing is known of how it begins.
        """
        self._vehicle, self._settings = vehicle, settings
        self._library = library_of(vehicle, effects, standing_effects, settings)
        self.effects = self._library.effects
        self._own: Stream | None = None
        self._filter: FrameFilter | None = None
        self._noise: AdaptiveNoise | None = None
        self._detector: ChangeDetector | None = None
        self._constant_at: dict[tuple[int, int], int] = {}
        self._quiet: list[Frame] = []
        self._settling = 0
        self.learning = True
        self._still, self._shaking = StandStill(settings), Shaking(settings)
        self._pending: _PendingAlarm | None = None
        self._settled: list[Alarm] = []
        self._silent: dict[str, Alarm] = {}
        self._over_since: float | None = None
        self._opened: list[Alarm] = []
        self._closed: list[Alarm] = []
        self._signs: dict[str, float] = {}
        self._last: tuple[float, bool] = (0.0, False)
        self._shares: dict[str, float] = {}
        self._nothing = 1.0

    def update(self, rows: Rows) -> Verdict:
        """Follow a flight on a grid of its own.

        Args:
            rows: Of a flight table by column, later than those before; a second of them, or any
                other portion.

        Returns:
            The verdict after the last frame that they complete.

        Raises:
            LogError: Times do not rise, or nothing drives the vehicle.
        """
        if self._own is None:
            self._own = Stream(self._vehicle, self.effects)
        stream = self._own
        stream.push(rows)
        if not stream.advance() and stream.waited_s > LONGEST_WAIT_S:
            raise LogError(f"live flight: {stream.waits_for}")
        return self.follow(stream)

    def follow(self, stream: Stream) -> Verdict:
        """Take what has come onto the grid of a stream since the last call.

        Args:
            stream: Of this vehicle, with `effects` built into its airframe.
        """
        self._opened, self._closed = [], []
        if self._filter is None and stream.equations is not None:
            with BUILDING:
                body = stream.equations.airframe
                self._begin(FrameFilter(self._vehicle, self._library, body))
        if self._filter is not None:
            for frame in self._filter.frames(stream):
                self._add_frame(frame)
        return self._verdict()

    # -- frame by frame ------------------------------------------------------------------------

    def _begin(self, framing: FrameFilter) -> None:
        s = self._settings
        self._filter = framing
        self._noise = AdaptiveNoise(framing.groups, self._vehicle, s)
        k = len(self._library.columns)
        keys = list(self._noise.constant)
        self._constant_at = {key: k + i for i, key in enumerate(keys)}
        constants = [2 * self._noise.constant[key] for key in keys]
        self._detector = ChangeDetector(
            self._library.hypotheses,
            np.concatenate([self._library.standing, constants]),
            float(np.exp(-FRAME_S / s.forget_s)),
            round(s.oldest_s / FRAME_S),
            s.least_frames,
        )

    def _add_frame(self, frame: Frame) -> None:
        """One frame."""
        s = self._settings
        self._last = frame.end_s, frame.flying
        if not frame.flying:
            self._settling = 0
            return
        self._settling += 1
        if self._settling * FRAME_S <= s.settle_s:
            return
        if self.learning:
            self._quiet.append(frame)
            if len(self._quiet) * FRAME_S >= s.quiet_s:
                self._learn()
            return
        self._take(frame)
        self._decide(frame)

    def _learn(self) -> None:
        """Noise and standing offset of the quiet start."""
        assert self._noise is not None
        self.learning = False
        self._noise.begin(self._quiet)
        self._still.begin(self._quiet)
        self._shaking.begin(self._quiet)
        for frame in self._quiet:
            self._take(frame)
        self._quiet = []

    def _take(self, frame: Frame) -> None:
        """Add a frame to the sums."""
        assert self._detector is not None and self._noise is not None and self._filter is not None
        suspect = self._still.follow(frame)
        self._shaking.follow(frame)
        standing = self._standing_model()
        rows = []
        for (g, c), values in frame.rows.items():
            group = self._filter.groups[g]
            if group.sensor in suspect:
                continue
            at = np.append(group.columns, self._constant_at[g, c])
            n = len(values)
            constant = np.zeros((n, 1))
            constant[0] = np.sqrt(n)
            whole = np.hstack([values[:, 1:], constant])
            law, band = self._noise.law((g, c), values), self._noise.band[g, c]
            rows.append((at, information(law, whole, band, standing[at])))
            self._noise.follow((g, c), values, whole[:, 0] - whole[:, 1:] @ standing[at])
        self._detector.add(frame.number, rows)

    def _standing_model(self) -> Array:
        """Standing numbers and constants, and what a young alarm adds."""
        assert self._detector is not None
        mean = self._detector.standing_mean()
        if self._pending is not None:
            for change in self._pending.alarm.numbers:
                k = self._column(self._pending.alarm.effect, change.name)
                mean[k] += change.value
        return mean

    def _column(self, effect: str, name: str) -> int:
        columns = range(len(self._library.columns))
        full = f"{effect}.{name}"
        return next(k for k in columns if self._library.name(k).full == full)

    # -- alarms --------------------------------------------------------------------------------

    def _decide(self, frame: Frame) -> None:
        """Raise, change and close alarms."""
        assert self._detector is not None
        now = frame.end_s
        scored = self._score()
        whole = _log_of_sum([w.log_odds for w in scored]) if scored else -np.inf
        self._nothing = float(1 / (1 + np.exp(min(whole, 700.0))))
        self._shares = _shares(scored)
        self._update_silent(frame)
        # With its first frame alone behind it, a beginning may be half a frame off.
        newest = max((int(w.change.starts[-1]) for w in scored), default=0)
        best = max(scored, key=lambda w: w.log_odds, default=None)
        over = best is not None and best.start < newest and whole >= self._settings.bar
        if self._pending is not None:
            self._update_pending(scored, whole, now)
        elif not over:
            self._over_since = None
        else:
            self._over_since = now if self._over_since is None else self._over_since
            waited = now - self._over_since >= self._settings.patience_s
            if waited or max(self._shares.values()) >= self._settings.clear:
                self._raise(scored, now)

    def _score(self) -> list[ScoredHypothesis]:
        """Every cause, all its beginnings together."""
        assert self._detector is not None
        chance = np.log(FRAME_S / self._settings.every_s)
        shared = _log_of_sum([h.odds for h in self._library.hypotheses])
        found = []
        for change in self._detector.changes():
            best = int(np.argmax(change.evidence))
            if np.isfinite(change.evidence[best]):
                steps = np.diff(change.starts, append=change.starts[-1] + 1)
                odds = chance + change.hypothesis.odds - shared
                log_odds = _log_of_sum(change.evidence + np.log(np.maximum(steps, 1))) + odds
                found.append(ScoredHypothesis(change.hypothesis.effect, log_odds, change, best))
        return found

    def _raise(self, scored: Sequence[ScoredHypothesis], now: float) -> None:
        """A new alarm, or the end of an older one."""
        best = max(scored, key=lambda w: w.log_odds)
        alarm = self._alarm(best, now)
        ended = next((a for a in self._settled if self._reverses(alarm, a)), None)
        if ended is not None:
            self._settled.remove(ended)
            self._closed.append(replace(ended, closed_s=alarm.since_s))
        else:
            self._opened.append(alarm)
        self._pending = _PendingAlarm(alarm, best.start, ended is not None)

    def _reverses(self, new: Alarm, old: Alarm) -> bool:
        """Whether a change takes back most of an older one."""
        if new.effect != old.effect:
            return False
        was, now = ({n.name: n.value for n in a.numbers} for a in (old, new))
        keys = was.keys() & now.keys()
        before = sum(was[k] ** 2 for k in keys)
        return before > 0 and sum((was[k] + now[k]) ** 2 for k in keys) < 0.25 * before

    def _update_pending(self, scored: Sequence[ScoredHypothesis], whole: float, now: float) -> None:
        """Name, number and probability of a young alarm as they are now; it may be over."""
        young, s = self._pending, self._settings
        assert young is not None and self._detector is not None
        if whole < 0:  # as likely as not
            if not young.ends:
                self._closed.append(replace(young.alarm, closed_s=now))
            self._pending, self._over_since = None, None
            return
        best = max(scored, key=lambda w: w.log_odds)
        alarm = self._alarm(best, young.alarm.raised_s)
        self._pending = _PendingAlarm(alarm, best.start, young.ends)
        if now - alarm.since_s >= s.settled_s:
            self._detector.settle(best.change, best.start)
            if not young.ends:
                self._settled.append(alarm)
            self._pending, self._over_since = None, None

    def _alarm(self, scored: ScoredHypothesis, raised_s: float) -> Alarm:
        """What is to be said of a cause."""
        change, t = scored.change, scored.best
        estimates = []
        for i, k in enumerate(change.hypothesis.columns):
            number = self._library.name(k)
            sd = float(np.sqrt(change.covariance[t, i, i]))
            estimates.append(
                EstimatedChange(number.name, float(change.numbers[t, i]), sd, number.about.unit)
            )
        there = 1 - self._nothing
        own = there * self._shares[scored.effect]
        others = {
            e: there * p
            for e, p in sorted(self._shares.items(), key=lambda kv: -kv[1])
            if e != scored.effect and p >= LEAST_SHARE
        }
        since_s = scored.start * FRAME_S
        return Alarm(scored.effect, tuple(estimates), since_s, raised_s, own, self._nothing, others)

    def _update_silent(self, frame: Frame) -> None:
        """Alarms of what changes no mean, each by itself."""
        signs: list[SilentSign] = []
        if any(isinstance(EFFECTS[e].observable_as, Repeats) for e in self._library.silent):
            signs += self._still.signs(frame)
        signs += self._shaking.signs(self._library.silent)
        price = np.log(self._settings.every_s / FRAME_S)
        by = {s.effect: s for s in signs if s.evidence - price >= self._settings.bar}
        for effect in self._silent.keys() - by.keys():
            self._closed.append(replace(self._silent.pop(effect), closed_s=frame.end_s))
        for effect, sign in by.items():
            nothing = float(np.exp(-min(sign.evidence - price, 700.0)))
            old = self._silent.get(effect)
            raised = frame.end_s if old is None else old.raised_s
            since = sign.start * FRAME_S if old is None else old.since_s
            alarm = Alarm(effect, sign.numbers, since, raised, 1 - nothing, nothing, {})
            if old is None:
                self._opened.append(alarm)
            self._silent[effect] = alarm

    def _verdict(self) -> Verdict:
        young = [] if self._pending is None or self._pending.ends else [self._pending.alarm]
        alarms = (*self._settled, *young, *self._silent.values())
        t_s, flying = self._last
        effects = {e: (1 - self._nothing) * p for e, p in self._shares.items()}
        return Verdict(
            t_s,
            self.learning,
            flying,
            alarms,
            tuple(self._opened),
            tuple(self._closed),
            self._nothing,
            effects,
        )


def _log_of_sum(logs: Sequence[float] | Array) -> float:
    """Logarithm of a sum of what some numbers are logarithms of."""
    return float(np.logaddexp.reduce(logs))


def _shares(scored: Sequence[ScoredHypothesis]) -> dict[str, float]:
    """Probability of each effect, given that one has begun."""
    if not scored:
        return {}
    odds = np.array([w.log_odds for w in scored])
    share = np.exp(odds - _log_of_sum(odds))
    found: dict[str, float] = {}
    for w, p in zip(scored, share, strict=True):
        found[w.effect] = found.get(w.effect, 0.0) + float(p)
    return found
