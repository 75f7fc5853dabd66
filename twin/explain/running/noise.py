"""How loud each channel is, band by band, learned on the quiet start and followed from there.

Of a frame's cosine transform the first coefficient is its mean; the others fall into bands. Means
of neighbouring frames go together: their level is that of means over two seconds, so that many
frames tell no more than they do. A level follows innovations, what the standing model leaves, and
counts a burst in part; a frame that is louder than its level weighs less, as in the likelihood of
Student's t. So does the noise belong to the flight as it is, and not to how it began.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...vehicle import Vehicle
from ..inference.evidence import constants_of_days
from ..settings import DEFAULT
from .channels import FRAME_S, FRAME_SAMPLES, Frame, Group
from .settings import RunningSettings

Array = NDArray[np.float64]
EDGES = (0, 1, 3, 7, 18)
"""First coefficient of each band, and the end of the last; the k-th is at k / (2 * 0.5 s) Hz."""
_RESOLVED = 1e-8
"""Least power of any band over the least of the mean's: a reading that is frozen, or a flight
without noise, has no power."""
LONG = 4
"""Frames of a mean over two seconds."""
Key = tuple[int, int]


def band_ends(group: Group) -> list[tuple[int, int]]:
    """First and last coefficient + 1 of each band that a group's low-pass lets through."""
    end = min(int(group.filters_hz[-1] * 2 * FRAME_S) + 1, EDGES[-1], FRAME_SAMPLES)
    return [(a, min(b, end)) for a, b in pairwise(EDGES) if a < end]


class AdaptiveNoise:
    """Noise levels of all channels.

    Attributes:
        constant: By channel, deviation of the constant that a day may bring.
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
        self._bands: dict[Key, list[tuple[int, int]]] = {}
        for g, group in enumerate(groups):
            sizes = constants_of_days(group.names, vehicle, DEFAULT.inference.evidence)
            for c, size in enumerate(sizes):
                self.constant[g, c] = size
                self._bands[g, c] = band_ends(group)
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
        power = [float(np.mean(residual[:, a:b] ** 2)) for a, b in self._bands[key]]
        means = residual[:, 0]
        if len(means) > 1:
            power[0] = float(np.mean(np.diff(means) ** 2)) / 2
        long = power[0]
        if len(means) >= 2 * LONG:
            blocks = means[: len(means) // LONG * LONG].reshape(-1, LONG).mean(axis=1)
            long = float(np.mean(np.diff(blocks) ** 2)) / 2 * LONG
        self._level[key] = np.maximum(power, self._least(key, values[-1]))
        self._long[key] = max(long, self._settings.together * float(self._level[key][0]))
        self._means[key] = [*means[-2 * LONG :]]

    def _least(self, key: Key, rows: Array) -> Array:
        """Least level of each band, laws being inexact."""
        s = self._settings
        first = FRAME_SAMPLES * (s.floor * self.constant[key]) ** 2
        others = [s.rough**2 * _power(rows[a:b, 0]) for a, b in self._bands[key][1:]]
        return np.maximum([first, *others], _RESOLVED * first)

    def weights(self, key: Key, rows: Array, innovation: Array) -> Array:
        """One over the variance of each coefficient of a frame, shape (25,); levels follow it.

        Args:
            key: Which channel.
            rows: Its transform.
            innovation: Of the residual, what the standing model leaves, shape (25,).
        """
        s, share = self._settings, FRAME_S / self._settings.noise_s
        if key not in self._level:
            self._start(key, rows[None])
        level, least = self._level[key], self._least(key, rows)
        weights = np.zeros(FRAME_SAMPLES)
        for b, (low, high) in enumerate(self._bands[key]):
            now = max(float(level[b]), float(least[b]))
            if b == 0:
                variance = max(s.together * now, self._long[key])
                weights[0] = 1 / variance
                continue
            n, power = (high - low) * s.tempered, _power(innovation[low:high])
            louder = (s.level + n * power / now) / (s.level + n)
            weights[low:high] = s.tempered / (now * max(louder, 1.0))
            level[b] += share * (min(power, s.burst * now) - level[b])
        self._follow_mean(key, float(innovation[0]), share)
        return weights

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

    def known(self) -> Mapping[Key, Array]:
        """Level by channel and band."""
        return self._level


def _power(values: Array) -> float:
    """Mean square."""
    return float(values @ values) / len(values)
