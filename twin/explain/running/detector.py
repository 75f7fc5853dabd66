"""Evidence that numbers have changed since a time: a generalised likelihood ratio, and its noise.

    r_k = N_k eta + S_k theta [k >= t0] + e_k,    eta ~ N(m0, P0),    theta ~ N(m, P)

eta: error of the standing model, every number and a constant per channel; theta: change that begins
at t0. All is linear and Gaussian, so that sums of products up to a frame, G, are sufficient: those
since t0 are G - G(t0). Of these follow, for all t0 and hypotheses at once, the Bayes factor against
no change with eta integrated out, and the numbers. Willsky & Jones, IEEE Trans. Automatic Control
21 (1976), in information form and with a proper prior in the place of their maximum.

e_k: the law of `twin.explain.inference.noise`, frame by frame. Of a frame's cosine transform the
first coefficient is its mean; the others fall into bands. `AdaptiveNoise` says what their levels
are expected to be: as on the quiet start, followed from there. Means of neighbouring frames are
correlated: their variance is that of means over two seconds, so that many frames do not count as
more than they are. A level follows innovations, the residual of the standing model, and counts a
burst in part.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ...representation import short_repr
from ...vehicle import Vehicle
from ..inference.noise import BandNoise, NoiseLaw, constants_of_days
from ..settings import DEFAULT
from .frames import FRAME_S, FRAME_SAMPLES, Frame, Group
from .hypotheses import Hypothesis, RunningSettings

Array = NDArray[np.float64]
EDGES = (0, 1, 3, 7, 18)
"""First coefficient of each band, and the end of the last; the k-th is at k / (2 * 0.5 s) Hz."""
_RESOLVED = 1e-8
"""Least power of any band over the least of the mean's: a reading that is frozen, or a flight
without noise, has no power."""
LONG = 4
"""Frames of a mean over two seconds."""
Key = tuple[int, int]


class AdaptiveNoise:
    """Noise levels of all channels, followed frame by frame: the law of each frame of a channel.

    Attributes:
        constant: By channel, deviation of the constant that a day may bring.
        band: By channel, band of each coefficient of a frame, shape (25,); -1: beyond its low-pass.
    """

    def __init__(
        self, groups: Sequence[Group], vehicle: Vehicle, settings: RunningSettings
    ) -> None:
        """Know nothing yet.

        Args:
            groups: All channels.
            vehicle: Its size.
            settings: How fast levels follow, and the least that they are.
        """
        self._settings = settings
        self.constant: dict[Key, float] = {}
        self.band: dict[Key, NDArray[np.intp]] = {}
        self._bands: dict[Key, tuple[NDArray[np.intp], NDArray[np.intp]]] = {}
        for g, group in enumerate(groups):
            sizes = constants_of_days(group.names, vehicle, DEFAULT.inference.evidence)
            for c, size in enumerate(sizes):
                self.constant[g, c] = size
                band = self.band[g, c] = _bands(group)
                self._bands[g, c] = np.unique(
                    band[band >= 0], return_index=True, return_counts=True
                )[1:]
        self._level: dict[Key, Array] = {}
        self._means: dict[Key, list[float]] = {}
        self._long: dict[Key, float] = {}

    def begin(self, frames: Iterable[Frame]) -> None:
        """Learn the levels of a quiet start."""
        rows: dict[Key, list[Array]] = {}
        for frame in frames:
            for key, values in frame.rows.items():
                rows.setdefault(key, []).append(values)
        for key, several in rows.items():
            self._start(key, np.array(several))

    def _start(self, key: Key, values: Array) -> None:
        residual = values[:, :, 1]
        power = self._powers(key, residual.T)
        means = residual[:, 0]
        if len(means) > 1:
            power[0] = float(np.mean(np.diff(means) ** 2)) / 2
        long = float(power[0])
        if len(means) >= 2 * LONG:
            blocks = means[: len(means) // LONG * LONG].reshape(-1, LONG).mean(axis=1)
            long = float(np.mean(np.diff(blocks) ** 2)) / 2 * LONG
        self._level[key] = np.maximum(power, self._least(key, values[-1]))
        self._long[key] = max(long, self._settings.together * float(self._level[key][0]))
        self._means[key] = [*means[-2 * LONG :]]

    def _powers(self, key: Key, coefficients: Array) -> Array:
        """Mean square by band, coefficients along axis 0."""
        first, size = self._bands[key]
        power = np.add.reduceat(coefficients[: first[-1] + size[-1]] ** 2, first, axis=0)
        return np.asarray(power.reshape(len(first), -1).mean(axis=1) / size)

    def _least(self, key: Key, rows: Array) -> Array:
        """Least level of each band, laws being inexact."""
        s = self._settings
        least = s.rough**2 * self._powers(key, rows[:, 0])
        least[0] = FRAME_SAMPLES * (s.floor * self.constant[key]) ** 2
        return np.asarray(np.maximum(least, _RESOLVED * least[0]))

    def law(self, key: Key, rows: Array) -> BandNoise:
        """Law of the next frame of a channel, which has the number 0 in it.

        Args:
            key: Which channel.
            rows: Its transform.
        """
        s = self._settings
        if key not in self._level:
            self._start(key, rows[None])
        floor = np.maximum(self._level[key], self._least(key, rows))
        floor[0] = max(s.together * floor[0], self._long[key])
        floors = {(0, b): float(v) for b, v in enumerate(floor)}
        return BandNoise(floors, np.array([s.tempered]), {}, level=s.level, capped=True)

    def follow(self, key: Key, rows: Array, innovation: Array) -> None:
        """Let the levels follow a frame.

        Args:
            key: Which channel.
            rows: Its transform.
            innovation: Of the residual, what the standing model leaves, shape (25,).
        """
        s, share = self._settings, FRAME_S / self._settings.noise_s
        level = self._level[key]
        most = s.burst * np.maximum(level, self._least(key, rows))
        power = np.minimum(self._powers(key, innovation), most)
        level[1:] += share * (power[1:] - level[1:])
        self._follow_mean(key, float(innovation[0]), share)

    def _follow_mean(self, key: Key, mean: float, share: float) -> None:
        """Levels of the mean of a frame and of two seconds, by differences of neighbours."""
        means, level = self._means[key], self._level[key]
        means.append(mean)
        if len(means) > 1:
            power = (means[-1] - means[-2]) ** 2 / 2
            level[0] += share * (min(power, self._settings.burst * level[0]) - level[0])
        if len(means) >= 2 * LONG:
            late, early = means[-LONG:], means[-2 * LONG : -LONG]
            power = (sum(late) / LONG - sum(early) / LONG) ** 2 / 2 * LONG
            long = self._long[key]
            self._long[key] = long + share * (min(power, self._settings.burst * long) - long)
        del means[: -2 * LONG]


def _bands(group: Group) -> NDArray[np.intp]:
    """Band of each coefficient, -1 beyond the low-pass of a group."""
    coefficient = np.arange(FRAME_SAMPLES)
    band = np.searchsorted(EDGES, coefficient, side="right") - 1
    end = min(int(group.filters_hz[-1] * 2 * FRAME_S) + 1, EDGES[-1])
    return np.where(coefficient < end, band, -1).astype(np.intp)


def information(law: NoiseLaw, rows: Array, band: NDArray[np.intp], standing: Array) -> Array:
    """Products of residual and slopes of a frame over its noise, shape (1 + m, 1 + m).

    Args:
        law: Of the noise; the channel is its first.
        rows: Residual and slopes, shape (n, 1 + m).
        band: Of each row, shape (n,).
        standing: Numbers of the standing model, shape (m,).
    """
    terms = law.terms(0, rows, band, np.zeros(len(rows), dtype=np.intp))
    grams = np.array([t.gram for t in terms])
    left = np.concatenate([[1.0], -standing])
    rss = np.maximum(grams @ left @ left, 0.0)
    _, weights = law.likelihood(terms).weights(rss)
    return np.asarray(np.einsum("t,tij->ij", weights, grams))


RECENT = 16
"""Frames back to which every one may be the beginning; twice as far, every second, and so on."""


@dataclass(frozen=True, slots=True)
class ChangeEvidence:
    """A hypothesis against the frames so far.

    Attributes:
        hypothesis: What has begun.
        starts: Frames with which it may have begun, shape (t,).
        evidence: Log Bayes factor against nothing of each, shape (t,).
        numbers: Most probable numbers of each, shape (t, m).
        covariance: Of these, shape (t, m, m).
    """

    hypothesis: Hypothesis
    starts: NDArray[np.intp]
    evidence: Array
    numbers: Array
    covariance: Array

    __repr__ = short_repr


class ChangeDetector:
    """Sums of products of residuals and slopes, and what follows from them."""

    def __init__(
        self,
        hypotheses: Sequence[Hypothesis],
        standing: Array,
        forget: float,
        oldest: int,
        least: int,
    ) -> None:
        """Know nothing yet.

        Args:
            hypotheses: What may begin.
            standing: Deviation of each standing number, then of each constant, shape (k,).
            forget: What a frame counts one frame later, at most 1.
            oldest: Frames back to which a change may have begun.
            least: Frames that a jump has to last to be one.
        """
        self._hypotheses, self._unit = list(hypotheses), np.array(standing)
        self._forget, self._oldest, self._least = forget, oldest, least
        k = len(standing)
        self._sum = np.zeros((1 + k, 1 + k))
        self._mean = np.zeros(k)
        self._past: list[tuple[int, Array]] = []
        self._now = -1

    @property
    def candidate_starts(self) -> int:
        """Number of frames that are candidates for the beginning."""
        return len(self._past)

    def add(self, number: int, rows: Sequence[tuple[NDArray[np.intp], Array]]) -> None:
        """The next frame.

        Args:
            number: Of the frame.
            rows: By channel, the positions of its columns, and `information` about them.
        """
        steps = number - self._now if self._now >= 0 else 0
        self._now = number
        self._sum *= self._forget**steps
        self._past.append((number, self._sum.copy()))
        for columns, gram in rows:
            unit = np.concatenate([[1.0], self._unit[columns]])
            at = np.concatenate([[0], 1 + columns])
            self._sum[np.ix_(at, at)] += gram * np.outer(unit, unit)
        self._past = [(n, g) for n, g in self._past if self._may_begin(n)]

    def _may_begin(self, number: int) -> bool:
        """Whether a frame is still a candidate for the beginning: the older, the fewer."""
        age = self._now - number
        step = 1 << max(0, (age // RECENT).bit_length())
        return age <= self._oldest and number % step == 0 if age >= RECENT else True

    def standing_mean(self) -> Array:
        """Most probable standing numbers and constants, shape (k,)."""
        return self._solved()[1] * self._unit

    def standing(self) -> tuple[Array, Array]:
        """Most probable standing numbers and constants, and their covariance."""
        factor, mean = self._solved()
        inverse = cho_solve(factor, np.eye(len(mean)))
        return mean * self._unit, inverse * np.outer(self._unit, self._unit)

    def _solved(self) -> tuple[tuple[Array, bool], Array]:
        information = self._sum[1:, 1:] + np.eye(len(self._unit))
        factor = cho_factor(information, lower=True)
        return factor, cho_solve(factor, self._sum[1:, 0] + self._mean)

    def changes(self) -> list[ChangeEvidence]:
        """Every hypothesis; nothing where no frame is old enough."""
        past = [(n, g) for n, g in self._past if self._now - n + 1 >= self._least]
        if not past:
            return []
        starts = np.array([n for n, _ in past], dtype=np.intp)
        decay = self._forget ** (self._now - starts).astype(np.float64)
        since = self._sum - decay[:, None, None] * np.array([g for _, g in past])
        every = sorted({c for h in self._hypotheses for c in h.columns})
        place = {c: i for i, c in enumerate(every)}
        at = 1 + np.array(every, dtype=np.intp)
        factor, mean = self._solved()
        across = since[:, 1:, at]  # (t, k, j)
        flat = across.transpose(1, 0, 2).reshape(len(mean), -1)
        solved = cho_solve(factor, flat).reshape(len(mean), len(past), -1).transpose(1, 0, 2)
        inner = since[:, at[:, None], at] - across.transpose(0, 2, 1) @ solved
        pull = since[:, at, 0] - across.transpose(0, 2, 1) @ mean
        found = []
        for h in self._hypotheses:
            own = [place[c] for c in h.columns]
            unit = self._unit[list(h.columns)]
            m = inner[:, np.array(own)[:, None], own]
            found.append(_change(h, starts, m, pull[:, own], unit))
        return found

    def settle(self, change: ChangeEvidence, start: int) -> None:
        """Let what began with a frame belong to the standing model from now on.

        Numbers and constants are as they are given all frames so far and the jump; the sums begin
        again from there.

        Args:
            change: Of this moment.
            start: With which frame it began.
        """
        k, h = len(self._unit), change.hypothesis
        t = int(np.flatnonzero(change.starts == start)[0])
        before = next(g for n, g in self._past if n == start)
        since = self._sum - self._forget ** float(self._now - start) * before
        columns = 1 + np.array(h.columns, dtype=np.intp)
        unit = self._unit[list(h.columns)]
        factor, mean = self._solved()
        covariance = cho_solve(factor, np.eye(k))
        theta, spread = change.numbers[t] / unit, change.covariance[t] / np.outer(unit, unit)
        gain = -covariance @ since[1:, columns]  # of eta by theta
        moved = gain.copy()
        moved[columns - 1, np.arange(len(columns))] += 1.0
        prior = np.zeros(k)
        prior[columns - 1] = theta
        new_mean = mean + moved @ theta
        new_covariance = covariance + moved @ spread @ moved.T
        information = np.linalg.inv(new_covariance)
        self._mean = self._mean + prior
        self._sum[1:, 1:] = information - np.eye(k)
        self._sum[1:, 0] = information @ new_mean - self._mean
        self._sum[0, 1:] = self._sum[1:, 0]
        self._past = []


def _change(
    h: Hypothesis, starts: NDArray[np.intp], inner: Array, pull: Array, unit: Array
) -> ChangeEvidence:
    """One hypothesis.

    Args:
        h: Hypothesis.
        starts: Beginnings, shape (t,).
        inner: Information about its numbers over `unit`, the standing model unknown, (t, m, m).
        pull: What residuals say of them, shape (t, m).
        unit: Of each number.
    """
    mean, precision = h.mean / unit, (unit / h.sd) ** 2
    whole = inner + np.diag(precision)
    gradient = pull + precision * mean
    covariance = np.linalg.inv(whole)
    numbers = (covariance @ gradient[:, :, None])[:, :, 0]
    evidence = 0.5 * (
        np.sum(gradient * numbers, axis=1)
        - float(np.sum(precision * mean * mean))
        - np.linalg.slogdet(whole)[1]
        + float(np.sum(np.log(precision)))
    )
    if h.only_more:
        evidence = np.where(np.all(numbers > 0, axis=1), evidence, -np.inf)
    return ChangeEvidence(h, starts, evidence, numbers * unit, covariance * np.outer(unit, unit))
