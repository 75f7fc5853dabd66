"""Effects that change no mean, found by repeated readings and by spectra.

| observable as | in | distinguished by |
|---|---|---|
| Repeats | a reading that repeats exactly | the other axes go on meanwhile |
| NoiseFloor | flat part of the spectrum, all axes | same level in every part of the band |
| Lines | lines that follow the rotors, or stand | level over the neighbouring frequencies |
| RandomForce | slow part of the accelerometer | no curve explains it, it falls with frequency |

Every claim rests on a ratio and on the scatter of such ratios without the effect: noise given in a
vehicle file, smoothness of a spectrum, motion that no model has quite right.

Noise alone changes the last bit of a reading at nearly every sample. A reading that repeats exactly
for a long time is stuck, unless there is another reason for it: nothing moves, the sensor is slower
than the table, its last bit is coarse, or the column was never measured. Each of these also shows
in the other axes of the sensor, or in the reading at other times.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Effect, Lines, NoiseFloor, RandomForce, Repeats
from ...logs import Flight
from ...physics.sensors.table import BODY, SENSORS
from ...vehicle import GRAVITY_M_S2
from ..model.model import Model
from ..settings import DEFAULT, StochasticSettings, StuckSettings
from .gust import find_gust
from .imu_noise import find_noise_level, find_vibration
from .spectral import StochasticEffect, prior_log_odds

Array = NDArray[np.float64]
PLACEHOLDERS = (0.0, GRAVITY_M_S2, 9.81, 9.8)
"""Magnitudes that fill columns of what was never measured."""


@dataclass(frozen=True, slots=True)
class Stuck:
    """One channel that stands still.

    Attributes:
        flight: Its name.
        channel: Column of the flight table.
        from_s: Time of the first sample that is repeated, s.
        to_s: Time of the last one, s.
        value: At which it stands.
        to_the_end: Whether it never moves again.
    """

    flight: str
    channel: str
    from_s: float
    to_s: float
    value: float
    to_the_end: bool


@dataclass(frozen=True, slots=True)
class _Runs:
    """Exact repetitions of a reading: samples `first[k]` to `last[k]` are all the same."""

    first: NDArray[np.intp]
    last: NDArray[np.intp]

    @property
    def steps(self) -> NDArray[np.intp]:
        """Repetitions in each."""
        return self.last - self.first


def stuck_channels(
    flight: Flight, settings: StuckSettings = DEFAULT.stochastic.stuck
) -> list[Stuck]:
    """Every long stand-still of a reading that nothing but a fault explains, in order of time."""
    found = [
        stuck
        for sensor in SENSORS
        for channel in sensor.columns
        if flight.has(channel)
        for stuck in _of_channel(
            flight, channel, [c for c in sensor.columns if c != channel], settings
        )
    ]
    return sorted(found, key=lambda s: (s.from_s, s.channel))


def without_stuck(flight: Flight, stuck: Sequence[Stuck]) -> Flight:
    """The flight with the sensor unknown (NaN) while one of its axes is stuck.

    All axes, since the flight table samples a vector whole. A sensor that is stuck from the start
    is gone for good.

    Args:
        flight: As read.
        stuck: Of this and perhaps other flights.
    """
    own = [s for s in stuck if s.flight == flight.name]
    if not own:
        return flight
    table = flight.table.copy()
    time = table["time"].to_numpy(dtype=np.float64)
    for s in own:
        sensor = next(r.columns for r in SENSORS if s.channel in r.columns)
        rows = (time >= s.from_s) & (time <= s.to_s)
        table.loc[rows, [c for c in sensor if c in table]] = np.nan
    return replace(flight, table=table)


def stuck_numbers(stuck: Sequence[Stuck], effect: Effect) -> Mapping[str, float]:
    """Numbers of an effect, "effect.number" -> value; empty where none of its channels is stuck.

    The effect has one channel, stuck to the end: the one stuck so for longest.

    Args:
        stuck: Of all flights.
        effect: Seen as repeats.
    """
    observable_as = effect.observable_as
    assert isinstance(observable_as, Repeats)
    own = [s for s in stuck if s.channel in observable_as.channels and s.to_the_end]
    if not own:
        return {}
    worst = max(own, key=lambda s: s.to_s - s.from_s).channel
    times = [s.from_s for s in own if s.channel == worst]
    return {
        f"{effect.name}.{observable_as.channel}": 1.0 + observable_as.channels.index(worst),
        f"{effect.name}.{observable_as.since}": float(np.median(times)),
    }


def _of_channel(
    flight: Flight, channel: str, others: Sequence[str], settings: StuckSettings
) -> list[Stuck]:
    """Faults of one channel."""
    t, x = _samples(flight, channel)
    runs = _runs(x)
    bit = _last_bit(x)
    if not others:  # nothing of its kind beside it: the IMU has to go on, and noise to move it
        others = [c for s in SENSORS if s.group == BODY for c in s.columns]
        bit = 0.0 if float(np.std(np.diff(x))) > settings.moving_bits * bit else np.inf
    neighbours = [_samples(flight, c) for c in others if flight.has(c)]
    found = []
    for k in np.flatnonzero(t[runs.last] - t[runs.first] >= settings.shortest_s):
        first, last = int(runs.first[k]), int(runs.last[k])
        elsewhere = np.delete(runs.steps, k).max(initial=1)
        if runs.steps[k] < settings.longer * elsewhere:
            continue
        if _never_measured(x, first, last) or _comes_to_rest(x, first, settings.smooth):
            continue
        inside = [y[(ty >= t[first]) & (ty <= t[last])] for ty, y in neighbours]
        if not any(_goes_on(y, bit, runs.steps[k], settings) for y in inside):
            continue
        found.append(
            Stuck(
                flight.name,
                channel,
                float(t[first]),
                float(t[last]),
                float(x[first]),
                last == len(x) - 1,
            )
        )
    return found


def _samples(flight: Flight, channel: str) -> tuple[Array, Array]:
    """Times and finite readings of one column, shape (n,) each."""
    t, x = flight.signal([channel])
    return t, x[:, 0]


def _runs(x: Array) -> _Runs:
    """Runs of equal samples, single samples included."""
    edges = np.flatnonzero(np.diff(x) != 0)
    return _Runs(np.concatenate([[0], edges + 1]), np.concatenate([edges, [len(x) - 1]]))


def _last_bit(x: Array) -> float:
    """Smallest step between two different readings; 0 for a constant."""
    steps = np.abs(np.diff(x))
    return float(steps[steps > 0].min(initial=np.inf)) if np.any(steps > 0) else 0.0


def _never_measured(x: Array, first: int, last: int) -> bool:
    """Whether it rests at a value that stands for no measurement."""
    return bool(np.isclose(abs(x[first]), PLACEHOLDERS, rtol=0, atol=1e-9).any()) and (
        last - first + 1 == len(x) or x[first] == 0.0
    )


def _comes_to_rest(x: Array, first: int, smooth: float) -> bool:
    """Whether a reading without noise glides into its rest, or begins there."""
    moving = x[np.flatnonzero(np.diff(x))]
    if len(moving) < 8:
        return first == 0 and len(np.unique(x)) > 1
    steps, bends = np.diff(moving), np.diff(moving, 2)
    size = float(np.sqrt(np.mean(steps**2)))
    if float(np.median(np.abs(bends))) > smooth * float(np.median(np.abs(steps))):
        return False
    return first == 0 or abs(x[first] - x[first - 1]) < smooth * size


def _goes_on(y: Array, bit: float, steps: int, settings: StuckSettings) -> bool:
    """Whether a neighbour changes meanwhile as a living sensor does.

    Args:
        y: Its readings meanwhile, shape (n,).
        bit: Last bit of the reading that stands still.
        steps: Repetitions of the latter.
        settings: What counts as going on.
    """
    if len(y) < 8:
        return False
    runs = _runs(y)
    lively = np.std(y) > settings.moving_bits * bit
    return bool(settings.longer * runs.steps.max() <= steps and lively)


# -- search --------------------------------------------------------------------------------


def find_stochastic(
    model: Model, values: Mapping[str, float], settings: StochasticSettings = DEFAULT.stochastic
) -> list[StochasticEffect]:
    """Effects without a mean that the flights show, the surest first.

    Args:
        model: Flights, stuck readings taken out.
        values: Numbers of the effects that have been named, "effect.number" -> value.
        settings: Of each kind.
    """
    found = []
    for effect in EFFECTS.values():
        match effect.observable_as:
            case NoiseFloor():
                found.append(find_noise_level(model, effect, settings))
            case Lines():
                found.append(find_vibration(model, effect, settings))
            case RandomForce():
                found.append(find_gust(model, values, effect, settings))
    return sorted((u for u in found if u is not None), key=lambda u: -u.log_odds)


def find_stuck(
    stuck: Sequence[Stuck], settings: StochasticSettings = DEFAULT.stochastic
) -> list[StochasticEffect]:
    """The effects of readings that stand still; none where all go on."""
    if not stuck:
        return []
    channels = tuple(dict.fromkeys(s.channel for s in stuck))
    odds = -prior_log_odds(settings)
    return [
        StochasticEffect(e.name, odds, stuck_numbers(stuck, e), {}, channels, 1.0)
        for e in EFFECTS.values()
        if isinstance(e.observable_as, Repeats)
    ]
