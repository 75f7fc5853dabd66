"""Made-up linear problems for the evidence: rows, priors and noise written down, no flight."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.explain.inference.evidence import LaplaceEvidence
from twin.explain.inference.noise import BandNoise
from twin.explain.inference.priors import Bounds, Priors
from twin.explain.inference.spectrum import Rows, Spectrum
from twin.physics.sensors.table import SENSORS

Array = NDArray[np.float64]


@dataclass
class Linear:
    """Channels with slopes by one number per effect.

    Attributes:
        effects: One name per number.
        channels: Per channel and flight: band of each row, residual, slopes of shape (n, k).
        floor: Square of the noise level known before, by channel and band.
        mean: Expected numbers.
        slab: Their standard deviations.
        file: Covariance where no effect is there.
        day: Standard deviation between flights.
        odds: Log odds of each effect.
        own: Share of each channel's rows that counts.
        reach: Largest size of a number.
        ages: Numbers whose sum is the age of a signal, by that which has a day.
    """

    effects: Sequence[str]
    channels: Sequence[Sequence[tuple[NDArray[np.intp], Array, Array]]]
    floor: Mapping[tuple[int, int], float]
    mean: Array | None = None
    slab: Array | None = None
    file: Array | None = None
    day: Array | None = None
    odds: Mapping[str, float] = field(default_factory=dict)
    own: Array | None = None
    reach: float = 1e9
    ages: Mapping[int, NDArray[np.intp]] = field(default_factory=dict)

    @property
    def priors(self) -> Priors:
        k = len(self.effects)
        zero, one = np.zeros(k), np.ones(k)
        return Priors(
            columns=tuple(range(k)),
            names=tuple(f"{e}.number" for e in self.effects),
            cause=tuple(self.effects),
            shape=np.zeros(k, dtype=np.bool_),
            now=zero,
            mean=zero if self.mean is None else self.mean,
            slab=one if self.slab is None else self.slab,
            file=np.zeros((k, k)) if self.file is None else self.file,
            held=zero,
            low=-self.reach * one,
            high=self.reach * one,
            day=zero if self.day is None else self.day,
            odds={e: 0.0 for e in self.effects} | dict(self.odds),
            ages=self.ages,
        )

    @property
    def spectrum(self) -> Spectrum:
        k, priors = len(self.effects), self.priors
        rows = tuple(
            tuple(Rows(b, r, np.arange(k), s.reshape(len(r), k)) for b, r, s in flights)
            for flights in self.channels
        )
        days = np.zeros((len(self.channels[0]), len(priors.days)))
        names = tuple(c for s in SENSORS for c in s.channels)[: len(rows)]
        return Spectrum(names, rows, np.zeros(k), days, priors.days)

    @property
    def laplace(self) -> LaplaceEvidence:
        k, priors = len(self.effects), self.priors
        bounds = Bounds(priors.low, priors.high, np.zeros((0, k)), np.zeros(0))
        own = np.ones(len(self.channels)) if self.own is None else self.own
        noise = BandNoise(self.floor, own, {})
        return LaplaceEvidence(self.spectrum, noise, priors, bounds)
