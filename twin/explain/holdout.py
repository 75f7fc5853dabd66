"""The gap of flights that took no part in a fit, before and after effects are added to a model.

Where no flight is held out, blocks of time of each are: the search does not read the sensors there.

Residuals are those of the search (`model.model`). The noise floor of a channel is the rms of the
residual with every effect of the library at once, fitted to these very flights; where a model
leaves less than that joint fit of all channels, what it leaves.

Day-to-day variation cannot be known beforehand: the rms with the effects added is also given with
the constants of these days, which alone are fitted to these very flights.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..logs import Flight
from ..logs.columns import ACC_NED, POS, QUAT, VEL
from ..physics.sensors.table import SENSORS
from ..representation import short_repr
from ..residuals.channels import ChannelData
from ..vehicle import Vehicle
from .inference.fit import Problem
from .inference.priors import priors_of
from .inference.spectrum import Spectrum
from .model.model import Model, candidates, missing_imu_signals, model_of
from .model.numbers import Payloads
from .settings import DEFAULT, EvidenceSettings, HoldoutSettings

READINGS = tuple(c for s in SENSORS for c in s.columns)
"""What is hidden. Pose and commands stay: they are inputs of the twin."""
POSE = (*POS, *VEL, *QUAT, *ACC_NED)
"""What is hidden as well where it stands in for a sensor."""
Span = tuple[float, float]


def held_out_spans(flight: Flight, settings: HoldoutSettings = DEFAULT.holdout) -> list[Span]:
    """One block of time in so many, the second one first."""
    time = flight.table["time"].to_numpy(dtype=np.float64)
    first, last = float(time[0]), float(time[-1])
    block_s = settings.spared_s
    starts = np.arange(first + block_s, last, settings.spared_every * block_s)
    return [(float(s), min(float(s) + block_s, last)) for s in starts]


def hidden(flight: Flight, spans: Sequence[Span], inside: bool) -> Flight:
    """The flight without the sensor readings inside some spans of time, or outside all of them.

    Where it lacks a sensor of the IMU, for which its pose is compared, that is hidden too.
    """
    time = flight.table["time"].to_numpy(dtype=np.float64)
    within = np.zeros(len(time), dtype=np.bool_)
    for start, end in spans:
        within |= (time >= start) & (time < end)
    table = flight.table.copy()
    compared = READINGS + POSE if missing_imu_signals([flight]) else READINGS
    readings = [c for c in compared if c in table]
    table.loc[within == inside, readings] = np.nan
    return replace(flight, table=table)


Array = NDArray[np.float64]
Flights = Sequence[Sequence[ChannelData]]
# -- gap before and after ------------------------------------------------------------------


DRAWS = 1000
"""Of the bootstrap."""


@dataclass(frozen=True, slots=True)
class ChannelGap:
    """One channel of all held-out flights.

    Attributes:
        name: See `model.model`.
        unit: Of the rms.
        n: Samples.
        before: Rms of the residual with the model as it stood.
        after: Rms with the effects added.
        on_its_day: Rms with the effects added, and with what differs between days as it was on
            these days.
        fit_mean: Rms of the residual with the model as it stood about the mean that the same has in
            the flights that were fitted; None: they do not have the channel.
        noise_floor: Least rms that any model of the library leaves, as far as known.
        shrink_ci95: 95 % interval of `shrink`; NaN where there are too few blocks of time.
    """

    name: str
    unit: str
    n: int
    before: float
    after: float
    on_its_day: float
    fit_mean: float | None
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
        on_its_day: These with the constants of the flights' own days.
        best: The same with every effect of the library, fitted to these very flights.
    """

    gaps: tuple[ChannelGap, ...]
    model: Model
    before: Flights
    after: Flights
    on_its_day: Flights
    best: Flights

    __repr__ = short_repr

    @property
    def floors(self) -> dict[str, float]:
        """Noise floor by channel."""
        return {g.name: g.noise_floor for g in self.gaps}

    @property
    def worse(self) -> bool:
        """Whether the flights are farther from the model as a whole, every channel by its own rms
        and with the constants of the day set apart: some grew beyond doubt, and more than others
        shrank."""
        ratios = [g.on_its_day / g.before for g in self.gaps if min(g.before, g.on_its_day) > 0]
        return any(g.worse for g in self.gaps) and float(np.sum(np.log(ratios))) > 0

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
    means: Mapping[str, float] | None = None,
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
        means: By channel, of the residual in the flights that were fitted.
        settings: Of the bootstrap.
        evidence: Of the fit of all numbers.

    Raises:
        LogError: A flight cannot be compared with this vehicle.
    """
    seen = {e.name: e for e in candidates(flights)} | {e: EFFECTS[e] for e in effects}
    known = [e for e in EFFECTS.values() if e.name in seen]
    model = model_of(flights, vehicle, known, payloads=payloads)
    problem = Problem.of(model, priors_of(model), evidence)
    now = _numbers(problem, values)
    linear = problem.channels(now, range(len(problem.priors.now)))
    before, rows = model.channels([]), model.channels([], values)
    after = [[replace(c, slopes=c.slopes[:, :0]) for c in flight] for flight in rows]
    daily = replace(model, days=_days(problem, now, linear)).channels([], values)
    best = _best(problem, now, linear)
    gaps = []
    for i, channel in enumerate(before[0]):
        own = (tuple(f[i] for f in flights) for flights in (before, after, daily, best))
        gaps.append(_gap(_Four(*own), (means or {}).get(channel.name), seed, settings))
    gaps.sort(key=lambda g: not g.worse)
    return Comparison(tuple(gaps), model, before, after, daily, best)


def _numbers(problem: Problem, values: Mapping[str, float]) -> Array:
    """Numbers of a model as `MapEstimate.x`."""
    priors = problem.priors
    x = np.zeros(len(priors.now) + problem.rest.days.size)
    for i, (name, now) in enumerate(zip(priors.names, priors.now, strict=True)):
        x[i] = values.get(name, now) - now
    return x


def _days(problem: Problem, x: Array, linear: Flights) -> tuple[dict[str, float], ...]:
    """What the days of the flights add to numbers that differ between days, all others at `x`;
    `linear`: channels there, with slopes by every number."""
    b = problem.priors
    shared, none = problem.split(np.zeros_like(x))
    held = replace(
        problem, priors=replace(b, now=b.now + problem.split(x)[0], file=np.zeros_like(b.file))
    )
    laplace = held.laplace(Spectrum.of(linear, shared, none, b.days))
    return held.days(laplace.best((), 1.0).x)


def _best(problem: Problem, x: Array, linear: Flights) -> list[list[ChannelData]]:
    """What all numbers leave of each channel, fitted to the flights themselves from `x` on."""
    priors = problem.priors
    laplace = problem.laplace(Spectrum.of(linear, *problem.split(x), priors.days))
    shared, days = problem.split(laplace.best(priors.causes, 1.0).x - x)
    left = []
    for flight, day in zip(linear, days, strict=True):
        step = shared.copy()
        step[priors.days] += day
        left.append(
            [
                replace(c, residual=c.residual - c.slopes @ step, slopes=c.slopes[:, :0])
                for c in flight
            ]
        )
    return left


@dataclass(frozen=True, slots=True)
class _Four:
    """One channel of each flight, as `Comparison` has it."""

    before: Sequence[ChannelData]
    after: Sequence[ChannelData]
    on_its_day: Sequence[ChannelData]
    best: Sequence[ChannelData]


def _gap(own: _Four, mean: float | None, seed: int, settings: HoldoutSettings) -> ChannelGap:
    pairs = zip(own.before, own.after, strict=True)
    sums = [_block_sums(b, a, settings.block_s) for b, a in pairs]
    rms_before, rms_after = _rms(own.before), _rms(own.after)
    rms_daily, rms_best = _rms(own.on_its_day), _rms(own.best)
    about = [replace(c, residual=c.residual - (mean or 0.0)) for c in own.before]
    return ChannelGap(
        name=own.before[0].name,
        unit=own.before[0].unit,
        n=sum(len(b.t_s) for b in own.before),
        before=rms_before,
        after=rms_after,
        on_its_day=rms_daily,
        fit_mean=None if mean is None else _rms(about),
        noise_floor=min(rms_best, rms_before, rms_after, rms_daily),
        shrink_ci95=_shrink_interval(np.concatenate(sums), seed, settings.fewest_blocks),
    )


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


def _rms(flights: Sequence[ChannelData]) -> float:
    """Of one channel over all flights."""
    return float(np.sqrt(np.mean(np.concatenate([c.residual for c in flights]) ** 2)))
