"""Alarms and their numbers; rules for what changes no mean: frozen readings, a shaken IMU."""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Repeats
from ...effects.definition import Lines, NoiseFloor
from ...effects.sensors import IMU_CHANNELS
from ...representation import short_repr
from ..settings import DEFAULT
from .frames import FRAME_S, Frame
from .hypotheses import RunningSettings


@dataclass(frozen=True, slots=True)
class EstimatedChange:
    """One number of an alarm.

    Attributes:
        name: Within the effect.
        value: Change since the alarm's beginning.
        sd: Standard deviation.
        unit: SI unit.
    """

    name: str
    value: float
    sd: float
    unit: str

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} {self.value:+.3g} ± {self.sd:.2g}{unit}"


@dataclass(frozen=True, slots=True)
class Alarm:
    """Something that has begun in flight.

    Attributes:
        effect: Identifier of the effect library.
        numbers: By how much.
        since_s: When it began, on the clock of the flight.
        raised_s: When the alarm was raised.
        probability: Of this effect, against every other and against nothing.
        nothing: Probability that nothing has begun.
        others: Other effects that it may be as well, and the probability of each.
        closed_s: When it ended; None: it goes on.
    """

    effect: str
    numbers: tuple[EstimatedChange, ...]
    since_s: float
    raised_s: float
    probability: float
    nothing: float
    others: Mapping[str, float]
    closed_s: float | None = None

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is known after a second of flight.

    Attributes:
        t_s: Up to when, on the clock of the flight.
        learning: Whether noise and standing offset are still being learned.
        flying: Whether the aircraft is in the air.
        alarms: Those that are open.
        opened: Those raised since the verdict before.
        closed: Those closed since the verdict before.
        nothing: Probability that nothing has begun beyond what is alarmed for good.
        effects: Probability of each effect that some number of it has jumped.
    """

    t_s: float
    learning: bool
    flying: bool
    alarms: tuple[Alarm, ...]
    opened: tuple[Alarm, ...]
    closed: tuple[Alarm, ...]
    nothing: float
    effects: Mapping[str, float]

    __repr__ = short_repr


Array = NDArray[np.float64]
_LEAST_POWER = 1e-12
"""Of a reading in a sub-band, (m/s^2)^2 or (rad/s)^2: one that is frozen has none."""
CELL = 6.0
"""Degrees of freedom of the power of a reading in a sub-band of a frame: ten bins under a Hann
window."""


def _effect_observed_as(kind: type[object]) -> str:
    """The effect of the library that is seen so."""
    return next(name for name, effect in EFFECTS.items() if isinstance(effect.observable_as, kind))


@dataclass(frozen=True, slots=True)
class SilentSign:
    """Of an effect that changes no mean.

    Attributes:
        effect: Identifier.
        start: Frame with which it began.
        evidence: Nats against nothing.
        numbers: By how much.
    """

    effect: str
    start: int
    evidence: float
    numbers: tuple[EstimatedChange, ...]

    __repr__ = short_repr


class StandStill:
    """Readings of the IMU that repeat themselves while their neighbours go on."""

    def __init__(self, settings: RunningSettings) -> None:
        self._settings = settings
        self._usual: dict[str, int] = {}
        self._frames: dict[str, int] = {}  # since when, first frame

    def begin(self, frames: Iterable[Frame]) -> None:
        """Learn how long readings stand still anyway."""
        for frame in frames:
            for column, n in frame.repeats.items():
                self._usual[column] = max(n, self._usual.get(column, 1))

    def follow(self, frame: Frame) -> frozenset[str]:
        """Take the next frame; returns signals of which a reading stands still."""
        suspect = set()
        for column, n in frame.repeats.items():
            signal = column.partition("_")[0]
            whole = frame.samples[signal]
            other_axes = [
                m for c, m in frame.repeats.items() if c != column and c.startswith(signal)
            ]
            limit = DEFAULT.stochastic.stuck.longer
            goes_on = any(limit * m <= n for m in other_axes)
            usual = self._usual.get(column, 1)
            if n >= max(self._settings.repeats, 3 * usual) and n > 2 * min(other_axes, default=n):
                suspect.add(signal)
            if n == whole and goes_on and n >= 3 * usual and n > 1:
                self._frames.setdefault(column, frame.number)
                suspect.add(signal)
            else:
                self._frames.pop(column, None)
        return frozenset(suspect)

    def signs(self, frame: Frame) -> list[SilentSign]:
        """Readings that stand still now, the one that does so for longest."""
        effect = EFFECTS[_effect_observed_as(Repeats)]
        assert isinstance(effect.observable_as, Repeats)
        found = []
        for column, start in sorted(self._frames.items(), key=lambda kv: kv[1])[:1]:
            rate = frame.samples[column.partition("_")[0]]
            evidence = self._settings.repeat_nats * rate * (frame.number + 1 - start)
            number = 1.0 + IMU_CHANNELS.index(column)
            estimates = (
                EstimatedChange(effect.observable_as.channel, number, 0.0, "1"),
                EstimatedChange(effect.observable_as.since, start * FRAME_S, FRAME_S / 2, "s"),
            )
            found.append(SilentSign(effect.name, start, evidence, estimates))
        return found


class Shaking:
    """Power above the band of motion against that of the quiet start."""

    def __init__(self, settings: RunningSettings) -> None:
        self._settings = settings
        self._usual: Array | None = None
        self._past: deque[tuple[int, Array, Array]] = deque(maxlen=round(10.0 / FRAME_S))

    def begin(self, frames: Iterable[Frame]) -> None:
        """Learn the power of the quiet start."""
        loud = [f.loud for f in frames if f.loud.size]
        if len(loud) > 3:
            self._usual = np.maximum(np.mean(loud, axis=0), _LEAST_POWER)

    def follow(self, frame: Frame) -> None:
        """Take the next frame."""
        if self._usual is None or not frame.loud.size:
            self._past.clear()
            return
        over = np.minimum(frame.loud / self._usual, self._settings.loudest)
        self._past.append((frame.number, over, frame.loud - self._usual))
        if float(np.median(over)) < self._settings.louder:
            share = FRAME_S / self._settings.forget_s
            usual = self._usual * (1 + share * (np.minimum(over, 4.0) - 1))
            self._usual = np.maximum(usual, _LEAST_POWER)

    def signs(self, wanted: Iterable[str]) -> list[SilentSign]:
        """What shakes now, of some effects: the likeliest beginning."""
        if self._usual is None or len(self._past) < 4:
            return []
        numbers = [n for n, _, _ in self._past]
        over = np.array([o for _, o, _ in self._past])  # (t, 6, s)
        counts = np.arange(len(over), 0, -1)[:, None, None]
        mean = np.cumsum(over[::-1], axis=0)[::-1] / counts
        least = np.minimum.accumulate(over[::-1], axis=0)[::-1]
        n = self._settings.tempered * CELL * counts
        more = np.maximum(mean, 1.0)  # what is quieter is not heard
        gain = 0.5 * n * (more - 1 - np.log(more)) - self._settings.level_nats
        heard = (least > self._settings.louder) & (gain > 0)
        evidence = np.where(heard, gain, 0.0).sum(axis=(1, 2))[:-2]
        best = int(np.argmax(evidence))
        if evidence[best] <= 0:
            return []
        effect = _effect_observed_as(Lines if _uneven(mean[best]) else NoiseFloor)
        if effect not in wanted:
            return []
        added = np.mean([a for _, _, a in self._past][best + 1 :], axis=0)
        estimates = self._amplitudes(effect, np.maximum(added, 0.0))
        return [SilentSign(effect, numbers[best], float(evidence[best]), estimates)]

    def _amplitudes(self, effect: str, added: Array) -> tuple[EstimatedChange, ...]:
        """How strong, from what is added to the power of the quiet start."""
        found = []
        for name, unit, rows in (("accel_m_s2", "m/s2", 0), ("gyro_rad_s", "rad/s", 3)):
            across = float(added[rows : rows + 2].sum(axis=1).mean())
            # Four rotors, each a circle in the plane of the rotors: 2 A^2 along each axis, while
            # their phases are by chance.
            lines = isinstance(EFFECTS[effect].observable_as, Lines)
            size = np.sqrt(across / 2) if lines else np.sqrt(2.7 * across)
            found.append(EstimatedChange(name, float(size), 0.5 * float(size), unit))
        return tuple(found)


def _uneven(over: Array) -> bool:
    """Whether what is added stands in some sub-bands, and not in all alike."""
    added = np.maximum(over - 1, 0.0)
    loudest = added[int(np.argmax(added.sum(axis=1)))]
    return bool(loudest.max() > 4.0 * (loudest.min() + 0.1))
