"""The gap of flights that took no part in a fit, before and after effects are added to a model.

Residuals are those of the search (`model.flight`). The noise floor of a channel is the rms of what
is left of it when every effect of the library at once, with numbers fitted to these very flights,
has taken what it can; where a model leaves less than that fit of all channels together, what it
leaves.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..logs import Flight
from ..representation import short_repr
from ..residuals.channels import ChannelData
from ..vehicle import Vehicle
from .inference.beliefs import beliefs_of
from .inference.refit import Problem
from .inference.spectrum import Spectrum
from .model.model import Model, candidates, model_of
from .model.payload import Payloads
from .settings import DEFAULT, EvidenceSettings, HoldoutSettings

Array = NDArray[np.float64]
Flights = Sequence[Sequence[ChannelData]]
DRAWS = 1000
"""Of the bootstrap."""


@dataclass(frozen=True, slots=True)
class ChannelGap:
    """One channel of all held-out flights.

    Attributes:
        name: See `model.flight`.
        unit: Of the rms.
        n: Samples.
        before: Rms of the residual with the model as it stood.
        after: Rms with the effects added.
        noise_floor: Least rms that any model of the library leaves, as far as known.
        shrink_ci95: 95 % interval of `shrink`; NaN where there are too few blocks of time.
    """

    name: str
    unit: str
    n: int
    before: float
    after: float
    noise_floor: float
    shrink_ci95: tuple[float, float]

    @property
    def shrink(self) -> float:
        """Share of the rms that is gone."""
        return 1 - self.after / self.before if self.before > 0 else 0.0

    @property
    def closed(self) -> float:
        """Share of what stood above the noise floor that is gone; NaN where nothing did."""
        above = self.before - self.noise_floor
        return (self.before - self.after) / above if above > 0.1 * self.noise_floor else math.nan

    @property
    def worse(self) -> bool:
        """Whether the gap grew, beyond doubt."""
        return self.shrink_ci95[1] < 0


@dataclass(frozen=True, slots=True)
class Comparison:
    """Held-out flights, before and after.

    Attributes:
        gaps: Per channel; those that got worse come first.
        model: The held-out flights.
        before: Channels of each flight with the model as it stood.
        after: The same channels with the effects added.
        best: The same with every effect of the library, fitted to these very flights.
    """

    gaps: tuple[ChannelGap, ...]
    model: Model
    before: Flights
    after: Flights
    best: Flights

    __repr__ = short_repr

    @property
    def floors(self) -> dict[str, float]:
        """Noise floor by channel."""
        return {g.name: g.noise_floor for g in self.gaps}

    @property
    def warnings(self) -> list[str]:
        """A line for every channel that got worse."""
        return [
            f"{g.name} got worse on the held-out flights: {g.before:.3g} to {g.after:.3g} {g.unit}"
            for g in self.gaps
            if g.worse
        ]


def compare_holdout(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    effects: Sequence[str],
    values: Mapping[str, float],
    seed: int = 0,
    payloads: Payloads | None = None,
    settings: HoldoutSettings = DEFAULT.holdout,
    evidence: EvidenceSettings = DEFAULT.inference.evidence,
) -> Comparison:
    """Compare held-out flights with a model before and after effects are added.

    Args:
        flights: Held out.
        vehicle: The model as it stood.
        effects: Added.
        values: Their numbers, "effect.number" -> value.
        seed: Of the bootstrap.
        payloads: Known masses aboard.
        settings: Of the bootstrap.
        evidence: Of the fit of all numbers.

    Raises:
        LogError: A flight cannot be compared with this vehicle.
    """
    seen = {e.name: e for e in candidates(flights)} | {e: EFFECTS[e] for e in effects}
    known = [e for e in EFFECTS.values() if e.name in seen]
    model = model_of(flights, vehicle, known, payloads=payloads)
    before, rows = model.channels([]), model.channels([], values)
    best = _best(model, values, evidence)
    after = [[replace(c, slopes=c.slopes[:, :0]) for c in flight] for flight in rows]
    gaps = [
        _gap([f[i] for f in before], [f[i] for f in after], [f[i] for f in best], seed, settings)
        for i in range(len(before[0]))
    ]
    return Comparison(tuple(sorted(gaps, key=lambda g: not g.worse)), model, before, after, best)


def _best(
    model: Model, values: Mapping[str, float], settings: EvidenceSettings
) -> list[list[ChannelData]]:
    """What all numbers leave of each channel, fitted to the flights themselves."""
    problem = Problem.of(model, beliefs_of(model), settings)
    beliefs = problem.beliefs
    place = {n: i for i, n in enumerate(beliefs.names)}
    x = np.zeros(len(beliefs.now) + problem.rest.days.size)
    for name, value in values.items():
        if name in place:
            x[place[name]] = value - beliefs.now[place[name]]
    flights = problem.channels(x, range(len(beliefs.now)))
    judge = problem.judge(Spectrum.of(flights, *problem.split(x), beliefs.days))
    shared, days = problem.split(judge.best(beliefs.causes, 1.0).x - x)
    left = []
    for flight, day in zip(flights, days, strict=True):
        step = shared.copy()
        step[beliefs.days] += day
        left.append(
            [
                replace(c, residual=c.residual - c.slopes @ step, slopes=c.slopes[:, :0])
                for c in flight
            ]
        )
    return left


def _gap(
    before: Sequence[ChannelData],
    after: Sequence[ChannelData],
    best: Sequence[ChannelData],
    seed: int,
    settings: HoldoutSettings,
) -> ChannelGap:
    sums = [_block_sums(b, a, settings.block_s) for b, a in zip(before, after, strict=True)]
    rms_before, rms_after, rms_best = (
        _rms(np.concatenate([c.residual for c in channels])) for channels in (before, after, best)
    )
    interval = _shrink_interval(np.concatenate(sums), seed, settings.fewest_blocks)
    floor = min(rms_best, rms_before, rms_after)
    name, unit, n = before[0].name, before[0].unit, sum(len(b.t_s) for b in before)
    return ChannelGap(name, unit, n, rms_before, rms_after, floor, interval)


def _block_sums(before: ChannelData, after: ChannelData, block_s: float) -> Array:
    """Sums of squares before and after, per block of time, shape (blocks, 2)."""
    number = np.floor(before.t_s / block_s).astype(np.int64)
    _, number = np.unique(number, return_inverse=True)
    squares = [np.bincount(number, c.residual**2) for c in (before, after)]
    return np.stack(squares, axis=-1)


def _shrink_interval(sums: Array, seed: int, fewest: int) -> tuple[float, float]:
    """95 % interval of the shrink, by bootstrap over the blocks."""
    n = len(sums)
    if n < fewest or not sums[:, 0].sum() > 0:
        return math.nan, math.nan
    draws = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=DRAWS) @ sums
    draws = draws[draws[:, 0] > 0]
    low, high = np.percentile(1 - np.sqrt(draws[:, 1] / draws[:, 0]), [2.5, 97.5])
    return float(low), float(high)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
