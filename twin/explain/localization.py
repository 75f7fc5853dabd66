"""Where twin and flights disagree, and where an effect acts: channels, phases, bands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..frames import to_body
from ..representation import short_repr
from ..residuals.channels import GRID_HZ, ChannelData
from ..residuals.gap import spectrum
from .model.model import FlightModel, Model

Array = NDArray[np.float64]
ABOVE_FLOOR = 1.2
"""A residual over its noise floor by less than this factor is noise. Made up."""
FEWEST_SAMPLES = 25
"""Of a phase at least. Made up."""
BINS = 10
"""Of the curve of a residual over a quantity: deciles."""
LEAST_EXPLAINED = 0.2
"""Share of a residual that a quantity must account for to be named. Made up."""
LEAST_SHARE, STRONG_SHARE = 0.1, 0.5
"""Share of the power of a residual that an effect explains in a channel on which it acts; of its
strongest phase in a phase in which it acts. Made up."""
MOST = 8
"""Places that are listed."""
BANDS_HZ = ((0.0, 0.5), (0.5, 2.0), (2.0, 6.0), (6.0, 18.0))
"""One of which is said to hold most of a residual."""


@dataclass(frozen=True, slots=True)
class Place:
    """A channel in a phase of flight.

    Attributes:
        channel: See `model.model`.
        phase: Of flight, "" where unknown.
        unit: Of the rms.
        n: Samples.
        rms: Of the residual with the model as it stands.
        over_floor: The same over the noise floor of the channel.
        explained: Share of its power that the named effects take.
        band_hz: Where most of its power lies.
        goes_with: Quantity that it depends on most, and the share of its power that a curve over
            that quantity takes; None where no quantity tells.
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


def localize(
    model: Model,
    values: Mapping[str, float],
    floors: Mapping[str, float],
) -> list[Place]:
    """The places where residuals stand out most above their noise floor, the worst first.

    Args:
        model: Flights, against the model as it stands.
        values: Numbers of the named effects, "effect.number" -> value.
        floors: Noise floor by channel; channels without one are left out.
    """
    before, after = model.channels([]), model.channels([], values)
    found = []
    for i, channel in enumerate(before[0]):
        if channel.name not in floors:
            continue
        parts = [
            _rows(flight, b[i], a[i])
            for flight, b, a in zip(model.flights, before, after, strict=True)
        ]
        phase = np.concatenate([p.phase for p in parts])
        for name in np.unique(phase):
            if np.sum(phase == name) >= FEWEST_SAMPLES:
                found.append(_place(channel, str(name), parts, floors[channel.name]))
    found = [p for p in found if p.over_floor > ABOVE_FLOOR]
    return sorted(found, key=lambda p: -p.over_floor)[:MOST]


@dataclass(frozen=True, slots=True)
class _Rows:
    """Samples of one channel of one flight."""

    t_s: Array
    phase: NDArray[np.str_]
    before: Array
    after: Array
    quantities: Mapping[str, Array]


def _rows(flight: FlightModel, before: ChannelData, after: ChannelData) -> _Rows:
    grid = flight.aligned.inputs.t_s
    rows = np.rint((before.t_s - grid[0]) * GRID_HZ).astype(np.intp)
    quantities = {name: values[rows] for name, values in _quantities(flight).items()}
    return _Rows(
        before.t_s, flight.aligned.phases[rows], before.residual, after.residual, quantities
    )


def _place(
    channel: ChannelData,
    phase: str,
    parts: list[_Rows],
    floor: float,
) -> Place:
    masks = [p.phase == phase for p in parts]
    before = np.concatenate([p.before[m] for p, m in zip(parts, masks, strict=True)])
    after = np.concatenate([p.after[m] for p, m in zip(parts, masks, strict=True)])
    power = float(np.mean(before**2))
    return Place(
        channel=channel.name,
        phase=phase,
        unit=channel.unit,
        n=len(before),
        rms=power**0.5,
        over_floor=power**0.5 / floor if floor > 0 else np.inf,
        explained=1 - float(np.mean(after**2)) / power if power > 0 else 0.0,
        band_hz=_band(parts, masks),
        goes_with=_goes_with(parts, masks, before),
    )


def _band(parts: list[_Rows], masks: list[NDArray[np.bool_]]) -> tuple[float, float]:
    """Band with most of the power; the mean counts as the slowest."""
    power = np.zeros(len(BANDS_HZ))
    for part, mask in zip(parts, masks, strict=True):
        values = part.before[mask]
        density = spectrum(part.t_s[mask], values)
        rms = np.array([density.band_rms(low, high) for low, high in BANDS_HZ])
        power += len(values) * np.nan_to_num(rms) ** 2
        power[0] += len(values) * float(np.mean(values)) ** 2 if len(values) else 0.0
    return BANDS_HZ[int(np.argmax(power))]


def _goes_with(
    parts: list[_Rows],
    masks: list[NDArray[np.bool_]],
    residual: Array,
) -> tuple[str, float] | None:
    """Quantity over which a curve takes most of the residual, about its mean."""
    about = residual - residual.mean()
    power, best = float(about @ about), ("", LEAST_EXPLAINED)
    for name in set.intersection(*(set(p.quantities) for p in parts)):
        x = np.concatenate([p.quantities[name][m] for p, m in zip(parts, masks, strict=True)])
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


def _quantities(flight: FlightModel) -> dict[str, Array]:
    """What a residual may depend on, on the grid."""
    aligned = flight.aligned
    t, motion = aligned.inputs.t_s, aligned.motion
    found = {"time": t}
    drives = [
        i for i, n in enumerate(aligned.airframe.input_names) if n.startswith(("cmd_", "rotor_"))
    ]
    found["throttle"] = aligned.inputs.u[:, drives].mean(axis=1)
    if motion.position is not None:
        found["height"] = -motion.position.at(t)[:, 2]
    if motion.velocity is not None and motion.attitude is not None:
        speed = to_body(list(motion.attitude.at(t).T), list(motion.velocity.at(t).T))
        names = ("forward speed", "speed to the right", "sink rate")
        found |= dict(zip(names, map(np.asarray, speed), strict=True))
    if motion.rates is not None:
        rates = motion.rates.at(t).T
        found |= dict(zip(("roll rate", "pitch rate", "yaw rate"), rates, strict=True))
    if "vbat_v" in aligned.airframe.input_names and flight.flight.has("vbat_v"):
        found["voltage"] = aligned.inputs.u[:, aligned.airframe.input_names.index("vbat_v")]
    return found


# -- where an effect acts ------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Attribution:
    """One effect among those added.

    Attributes:
        effect: Identifier.
        channels: On which it acts, the clearest first.
        phases: In which it acts on the clearest one, the strongest first.
        without: Channels of each flight without the effect, all others on.
    """

    effect: str
    channels: tuple[str, ...]
    phases: tuple[str, ...]
    without: Sequence[Sequence[ChannelData]]

    __repr__ = short_repr


def attribute_effect(
    effect: str,
    model: Model,
    values: Mapping[str, float],
    with_all: Sequence[Sequence[ChannelData]],
) -> Attribution:
    """Where an effect acts.

    Args:
        effect: Identifier.
        model: Flights, against the model as it stood.
        values: Numbers of all added effects, "effect.number" -> value.
        with_all: Channels of each flight with all of them.
    """
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
    phases = _phases(channels[0], model, without, with_all, STRONG_SHARE)
    return Attribution(effect, channels, phases, without)


def _phases(
    name: str,
    model: Model,
    without: Sequence[Sequence[ChannelData]],
    with_all: Sequence[Sequence[ChannelData]],
    strong: float,
) -> tuple[str, ...]:
    """Phases in which an effect changes a channel most."""
    i = next(i for i, c in enumerate(with_all[0]) if c.name == name)
    phase, change = [], []
    for flight, a, b in zip(model.flights, without, with_all, strict=True):
        t0 = flight.aligned.inputs.t_s[0]
        phase.append(flight.aligned.phases[np.rint((a[i].t_s - t0) * GRID_HZ).astype(np.intp)])
        change.append(a[i].residual - b[i].residual)
    names, values = np.concatenate(phase), np.concatenate(change)
    size = {str(p): float(np.sqrt(np.mean(values[names == p] ** 2))) for p in np.unique(names)}
    strongest = max(size.values())
    return tuple(p for p in sorted(size, key=lambda p: -size[p]) if size[p] >= strong * strongest)
