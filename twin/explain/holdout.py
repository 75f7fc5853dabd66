"""The gap of held-out flights before and after effects are added to a model.

Where no flight is held out, time blocks of each are: the search does not use sensor readings there.

Residuals are those of the search (`model.model`). The noise floor of a channel is the least rms of
any model: with every effect of the library at once, fitted to these very flights, or without. The
rms with the effects added is also given with the constants of these days, which cannot be
predicted. Residuals and effects are localised by channel, phase and frequency band.
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
from ..representation import ShortRepr
from ..residuals.channels import GRID_HZ, Array, ChannelData
from ..residuals.gap import spectrum
from ..vehicle import Vehicle
from .inference.fit import Problem
from .inference.priors import priors_of
from .inference.sparse_regression import quantities
from .inference.spectrum import FORCE_CHANNELS, Flights, Spectrum
from .model.model import FlightModel, Model, candidates, missing_imu_signals, model_of
from .model.numbers import Payloads
from .settings import DEFAULT, EvidenceSettings, HoldoutSettings

READINGS = tuple(c for s in SENSORS for c in s.columns)
"""Columns that are hidden. Pose and commands remain: they are inputs of the twin."""
POSE = (*POS, *VEL, *QUAT, *ACC_NED)
"""Columns that are hidden as well where the pose replaces a sensor."""
Span = tuple[float, float]


def held_out_spans(flight: Flight, settings: HoldoutSettings = DEFAULT.holdout) -> list[Span]:
    """Held-out time spans: every n-th block, beginning with the second."""
    time = flight.table["time"].to_numpy(dtype=np.float64)
    first, last = float(time[0]), float(time[-1])
    block_s = settings.spared_s
    starts = np.arange(first + block_s, last, settings.spared_every * block_s)
    return [(float(s), min(float(s) + block_s, last)) for s in starts]


def hidden(flight: Flight, spans: Sequence[Span], inside: bool) -> Flight:
    """The flight without the sensor readings inside some time spans, or outside all of them; where
    it lacks an IMU sensor that its pose replaces, without the pose too."""
    time = flight.table["time"].to_numpy(dtype=np.float64)
    within = np.zeros(len(time), dtype=np.bool_)
    for start, end in spans:
        within |= (time >= start) & (time < end)
    table = flight.table.copy()
    compared = READINGS + POSE if missing_imu_signals([flight]) else READINGS
    readings = [c for c in compared if c in table]
    table.loc[within == inside, readings] = np.nan
    return replace(flight, table=table)


# -- gap before and after ------------------------------------------------------------------


DRAWS = 1000
"""Number of bootstrap resamples."""


@dataclass(frozen=True, slots=True)
class ChannelGap:
    """Gap of one channel over all held-out flights.

    Attributes:
        name: Name of the channel, see `model.model`.
        unit: Unit of the rms.
        n: Number of samples.
        before: Rms residual of the nominal model.
        after: Rms residual with the effects added.
        on_its_day: Rms residual with the effects added, and with day-to-day numbers fitted to these
            flights.
        fit_mean: Rms residual of the nominal model about its mean in the fitted flights; None: they
            do not have the channel.
        noise_floor: Least known rms residual of any model of the library.
        shrink_ci95: 95 % interval of `shrink`; NaN where there are too few time blocks.
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
        """Relative reduction of the rms."""
        return 1 - self.after / self.before if self.before > 0 else 0.0

    @property
    def closed(self) -> float:
        """Relative reduction of the rms above the noise floor; NaN where none was above it."""
        above = self.before - self.noise_floor
        return (self.before - self.after) / above if above > 0.1 * self.noise_floor else math.nan

    @property
    def worse(self) -> bool:
        """Whether the gap grew significantly."""
        return self.shrink_ci95[1] < 0


@dataclass(frozen=True, slots=True)
class Comparison(ShortRepr):
    """Comparison of held-out flights before and after.

    Attributes:
        gaps: Gap of each channel; those that grew come first.
        model: Predictions of the held-out flights.
        before: Channels of each flight with the nominal model.
        after: Channels of each flight with the effects added.
        best: Channels of each flight with every effect of the library, fitted to these very
            flights.
    """

    gaps: tuple[ChannelGap, ...]
    model: Model
    before: Flights
    after: Flights
    best: Flights

    @property
    def floors(self) -> dict[str, float]:
        """Noise floor by channel."""
        return {g.name: g.noise_floor for g in self.gaps}

    @property
    def worse(self) -> bool:
        """Whether the model as a whole is worse, with each channel divided by its rms and without
        the constants of the day: some channels grew significantly, and by more than others
        shrank."""
        ratios = [g.on_its_day / g.before for g in self.gaps if min(g.before, g.on_its_day) > 0]
        return any(g.worse for g in self.gaps) and float(np.sum(np.log(ratios))) > 0

    @property
    def warnings(self) -> list[str]:
        """Warning for every channel that grew."""
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
        flights: Held-out flights.
        vehicle: Nominal model.
        effects: Added effects.
        values: Their numbers, "effect.number" -> value.
        means: Mean residual in the fitted flights, by channel.

    Raises:
        LogError: A flight cannot be compared with this vehicle.
    """
    seen = {e.name: e for e in candidates(flights)} | {e: EFFECTS[e] for e in effects}
    known = [e for e in EFFECTS.values() if e.name in seen]
    model = model_of(flights, vehicle, known, payloads=payloads)
    problem = Problem.of(model, priors_of(model), evidence)
    now = _numbers(problem, values)
    linear = problem.channels(now, range(len(problem.priors.now)))
    before, after = model.channels([]), model.channels([], values)
    daily = replace(model, days=_days(problem, now, linear)).channels([], values)
    best = _best(problem, now, linear)
    gaps = []
    for i, channel in enumerate(before[0]):
        own = [[f[i] for f in flights] for flights in (before, after, daily, best)]
        gaps.append(_gap(own, (means or {}).get(channel.name), seed, settings))
    gaps.sort(key=lambda g: not g.worse)
    return Comparison(tuple(gaps), model, before, after, best)


def _numbers(problem: Problem, values: Mapping[str, float]) -> Array:
    """Numbers of a model as `MapEstimate.x`."""
    priors = problem.priors
    x = np.zeros(len(priors.now) + problem.rest.days.size)
    for i, (name, now) in enumerate(zip(priors.names, priors.now, strict=True)):
        x[i] = values.get(name, now) - now
    return x


def _days(problem: Problem, x: Array, linear: Flights) -> tuple[dict[str, float], ...]:
    """Day-to-day deviations of the flights' numbers, all others fixed at `x`; `linear`: channels
    there, with slopes by every number."""
    b = problem.priors
    shared, none = problem.split(np.zeros_like(x))
    held = replace(
        problem, priors=replace(b, now=b.now + problem.split(x)[0], file=np.zeros_like(b.file))
    )
    laplace = held.laplace(Spectrum.of(linear, shared, none, b.days))
    return held.days(laplace.best((), 1.0).x)


def _best(problem: Problem, x: Array, linear: Flights) -> list[list[ChannelData]]:
    """Channels with all numbers fitted to the flights themselves, starting from `x`."""
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


def _gap(own: Flights, mean: float | None, seed: int, settings: HoldoutSettings) -> ChannelGap:
    """Gap of one channel, from its residuals in each flight: before, after, with its day, and with
    the best numbers."""
    before = own[0]
    sums = [_block_sums(b, a, settings.block_s) for b, a in zip(before, own[1], strict=True)]
    rms = [_rms(flights) for flights in own]
    about = [replace(c, residual=c.residual - (mean or 0.0)) for c in before]
    return ChannelGap(
        name=before[0].name,
        unit=before[0].unit,
        n=sum(len(b.t_s) for b in before),
        before=rms[0],
        after=rms[1],
        on_its_day=rms[2],
        fit_mean=None if mean is None else _rms(about),
        noise_floor=min(rms),
        shrink_ci95=_shrink_interval(np.concatenate(sums), seed, settings.fewest_blocks),
    )


def _block_sums(before: ChannelData, after: ChannelData, block_s: float) -> Array:
    """Sums of squares before and after, per time block, shape (blocks, 2)."""
    number = np.floor(before.t_s / block_s).astype(np.int64)
    _, number = np.unique(number, return_inverse=True)
    squares = [np.bincount(number, c.residual**2) for c in (before, after)]
    return np.stack(squares, axis=-1)


def _shrink_interval(sums: Array, seed: int, fewest: int) -> tuple[float, float]:
    """95 % interval of the shrink, by bootstrap over the time blocks."""
    n = len(sums)
    if n < fewest or not sums[:, 0].sum() > 0:
        return math.nan, math.nan
    draws = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=DRAWS) @ sums
    draws = draws[draws[:, 0] > 0]
    low, high = np.percentile(1 - np.sqrt(draws[:, 1] / draws[:, 0]), [2.5, 97.5])
    return float(low), float(high)


def _rms(flights: Sequence[ChannelData]) -> float:
    """Rms residual of one channel over all flights."""
    return float(np.sqrt(np.mean(np.concatenate([c.residual for c in flights]) ** 2)))


# -- where it acts ---------------------------------------------------------------------------


ABOVE_FLOOR = 1.2
"""Ratio of a residual to its noise floor below which it is noise. Made up."""
FEWEST_SAMPLES = 25
"""Least number of samples of a phase. Made up."""
BINS = 10
"""Number of bins of the curve of a residual over a quantity: deciles."""
LEAST_EXPLAINED = 0.2
"""Least share of a residual that a quantity must account for to be named. Made up."""
LEAST_SHARE, STRONG_SHARE = 0.1, 0.5
"""Least share of the residual's power that an effect explains in a channel on which it acts; and
share of its strongest phase in a phase in which it acts. Made up."""
MOST = 8
"""Maximum number of places listed."""
DEPENDS = {
    "time": "time",
    "command": "throttle",
    "height": "height",
    "v_x": "forward speed",
    "v_y": "speed to the right",
    "v_z": "sink rate",
    "omega_x": "roll rate",
    "omega_y": "pitch rate",
    "omega_z": "yaw rate",
    "voltage": "voltage",
}
"""Quantities on which a residual may depend, and their names in texts."""
BANDS_HZ = ((0.0, 0.5), (0.5, 2.0), (2.0, 6.0), (6.0, 18.0))
"""Frequency bands; the one with most of the residual's power is reported."""


@dataclass(frozen=True, slots=True)
class Place:
    """Residual of one channel in one phase of flight.

    Attributes:
        channel: Name of the channel, see `model.model`.
        phase: Phase of flight, "" where unknown.
        unit: Unit of the rms.
        n: Number of samples.
        rms: Rms residual of the nominal model.
        over_floor: Rms over the noise floor of the channel.
        explained: Share of its power that the named effects explain.
        band_hz: Frequency band with most of its power.
        goes_with: Quantity on which it depends most, and the share of its power that a curve over
            that quantity explains; None where it depends on none.
    """

    channel: str
    phase: str
    unit: str
    n: int
    rms: float
    over_floor: float
    explained: float
    band_hz: tuple[float, float]
    goes_with: tuple[str, float] | None


def localize(model: Model, values: Mapping[str, float], floors: Mapping[str, float]) -> list[Place]:
    """Places where residuals of the nominal model are highest above their noise floor, the worst
    first; channels without one are omitted. `values`: numbers of the named effects."""
    before, after = (zip(*model.channels([], v), strict=True) for v in ({}, values))
    known = [quantities(f) for f in model.flights]
    shared = [k for k in DEPENDS if all(k in own for own in known)]
    found = []
    for own, with_effects in zip(before, after, strict=True):
        if own[0].name not in floors:
            continue
        rows = [_rows(f, c) for f, c in zip(model.flights, own, strict=True)]
        phases = [f.aligned.phases[r] for f, r in zip(model.flights, rows, strict=True)]
        residual, left = (
            np.concatenate([c.residual for c in some]) for some in (own, with_effects)
        )
        goes = {
            DEPENDS[k]: np.concatenate([q[k].values[r] for q, r in zip(known, rows, strict=True)])
            for k in shared
        }
        every, floor = np.concatenate(phases), floors[own[0].name]
        for phase in np.unique(every).tolist():
            inside = every == phase
            if np.sum(inside) < FEWEST_SAMPLES:
                continue
            power = float(np.mean(residual[inside] ** 2))
            found.append(
                Place(
                    channel=own[0].name,
                    phase=phase,
                    unit=own[0].unit,
                    n=int(np.sum(inside)),
                    rms=power**0.5,
                    over_floor=power**0.5 / floor if floor > 0 else np.inf,
                    explained=1 - float(np.mean(left[inside] ** 2)) / power if power > 0 else 0.0,
                    band_hz=_band(own, [p == phase for p in phases]),
                    goes_with=_goes_with({k: v[inside] for k, v in goes.items()}, residual[inside]),
                )
            )
    found = [p for p in found if p.over_floor > ABOVE_FLOOR]
    return sorted(found, key=lambda p: -p.over_floor)[:MOST]


def _rows(flight: FlightModel, channel: ChannelData) -> NDArray[np.intp]:
    """Grid points of the samples of a channel."""
    at: NDArray[np.float64] = np.rint((channel.t_s - flight.aligned.inputs.t_s[0]) * GRID_HZ)
    return at.astype(np.intp)


def _band(
    flights: Sequence[ChannelData], masks: Sequence[NDArray[np.bool_]]
) -> tuple[float, float]:
    """Frequency band with most of the power; the mean belongs to the slowest."""
    power = np.zeros(len(BANDS_HZ))
    for channel, mask in zip(flights, masks, strict=True):
        values = channel.residual[mask]
        density = spectrum(channel.t_s[mask], values)
        rms = np.array([density.band_rms(low, high) for low, high in BANDS_HZ])
        power += len(values) * np.nan_to_num(rms) ** 2
        power[0] += len(values) * float(np.mean(values)) ** 2 if len(values) else 0.0
    return BANDS_HZ[int(np.argmax(power))]


def _goes_with(known: Mapping[str, Array], residual: Array) -> tuple[str, float] | None:
    """Quantity over which a curve explains most of the residual, about its mean."""
    about = residual - residual.mean()
    power, best = float(about @ about), ("", LEAST_EXPLAINED)
    for name, x in known.items():
        if not np.all(np.isfinite(x)) or np.ptp(x) == 0 or power == 0:
            continue
        edges = np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1])
        number = np.searchsorted(edges, x)
        count = np.bincount(number, minlength=BINS)
        total = np.bincount(number, about, minlength=BINS)
        share = float(np.sum(total**2 / np.maximum(count, 1))) / power - (BINS - 1) / len(x)
        if (share, name) > (best[1], best[0]):
            best = (name, share)
    return best if best[0] else None


# -- where an effect acts ------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Attribution(ShortRepr):
    """Where one of the added effects acts.

    Attributes:
        effect: Identifier of the effect.
        channels: Channels on which it acts, the clearest first.
        phases: Phases in which it acts on the clearest channel, the strongest first.
        without: Channels of each flight without the effect and with all others.
    """

    effect: str
    channels: tuple[str, ...]
    phases: tuple[str, ...]
    without: Flights


def attribute_effect(
    effect: str, model: Model, values: Mapping[str, float], with_all: Flights
) -> Attribution:
    """Channels and phases in which an effect acts, given the numbers of all added effects and the
    channels with them."""
    others = {k: v for k, v in values.items() if k.partition(".")[0] != effect}
    without = model.channels([], others)
    taken = {}
    for i, channel in enumerate(with_all[0]):
        lacking, complete = (
            np.concatenate([f[i].residual for f in flights]) for flights in (without, with_all)
        )
        power, left = float(lacking @ lacking), float(complete @ complete)
        taken[channel.name] = 1 - left / power if power > 0 else 0.0
    ranked = sorted(taken, key=lambda name: -taken[name])
    channels = tuple(name for name in ranked if taken[name] >= LEAST_SHARE) or tuple(ranked[:1])
    phases = _phases(channels[0], model, without, with_all)
    return Attribution(effect, channels, phases, without)


def farther_by(
    attribution: Attribution, after: Flights, seed: int, settings: HoldoutSettings
) -> list[str]:
    """Forces and moments in which the residual is significantly larger with an effect (`after`)
    than without; empty where it is smaller in total, with each channel divided by its rms."""
    each = zip(zip(*attribution.without, strict=True), zip(*after, strict=True), strict=True)
    own = [(b, a) for b, a in each if b[0].name.startswith(FORCE_CHANNELS)]
    gaps = [_gap([b, a, a, a], None, seed, settings) for b, a in own]
    farther = sum(np.log(g.after / g.before) for g in gaps if min(g.before, g.after) > 0)
    return [g.name for g in gaps if g.worse and farther > 0]


def _phases(name: str, model: Model, without: Flights, with_all: Flights) -> tuple[str, ...]:
    """Phases in which an effect changes a channel most."""
    i = next(i for i, c in enumerate(with_all[0]) if c.name == name)
    phase, change = [], []
    for flight, a, b in zip(model.flights, without, with_all, strict=True):
        phase.append(flight.aligned.phases[_rows(flight, a[i])])
        change.append(a[i].residual - b[i].residual)
    names, values = np.concatenate(phase), np.concatenate(change)
    size = {str(p): float(np.sqrt(np.mean(values[names == p] ** 2))) for p in np.unique(names)}
    least = STRONG_SHARE * max(size.values())
    return tuple(p for p in sorted(size, key=lambda p: -size[p]) if size[p] >= least)
