"""Causes outside the library: equations for the remaining residual of each channel.

Sparse regression on products of physical quantities, on residuals whitened by the noise model;
validated on time blocks used neither for selection nor for fitting the terms.

Source: Brunton, Proctor & Kutz, PNAS 113 (2016).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..physics.sensors.table import BODY, SENSORS, sensor_of
from ..residuals.channels import CHANNEL_HZ, Array, ChannelData
from .inference.fit import Fit
from .inference.sparse_regression import (
    Quantity,
    Sparse,
    Term,
    fold_of,
    longest,
    over,
    powers_of,
    quantities,
    sparse,
    terms,
)
from .inference.whitening import (
    Autoregression,
    Block,
    Key,
    WhitenedFlights,
    autoregression_of,
    blocks_of,
)
from .settings import DEFAULT, LikelihoodSettings, UnnamedSettings

DIGITS = 3
"""Significant digits of a coefficient."""
SMALLEST = 0.005
"""Least rms of an equation, as a share of the size of the channel (`Sensor.size`); smaller errors
occur in every model."""
FINER = 4
"""Number of trial frequencies per frequency resolution of the flight."""


@dataclass(frozen=True, slots=True)
class Equation:
    """Equation for the residual of one channel.

    Attributes:
        channel: Name of the channel, see `model.model`.
        unit: Unit of the channel.
        terms: Product of quantities, coefficient, and unit of the coefficient, for each term; the
            largest first.
        expression: The equation as readable text.
        share: Share of the residual power under `fitted` that it explains out of sample, in the
            frequency band that contains the equation's own power: noise above the band is
            unexplainable.
        band_hz: Upper end of that band, Hz.
        rms: Rms of its contribution, in the unit of the channel.
        gain: Out-of-sample log likelihood over that of `fitted` alone, nats.
    """

    channel: str
    unit: str
    terms: tuple[tuple[str, float, str], ...]
    expression: str
    share: float
    band_hz: float
    rms: float
    gain: float


@dataclass(frozen=True, slots=True)
class Unnamed:
    """Equations added to a candidate model.

    Attributes:
        equations: At most one equation per channel, the largest share first.
        gains: Out-of-sample log likelihood over that of the candidate model alone, per time block,
            under the noise with the equations, nats, shape (n,).
        terms: Number of coefficients in all equations, including frequencies.
        noise: Noise with the equations, by channel with an equation.
    """

    equations: tuple[Equation, ...]
    gains: Array
    terms: int
    noise: Mapping[str, Autoregression]

    @property
    def gain(self) -> float:
        """Sum of the gains over all blocks, nats."""
        return float(self.gains.sum())


@dataclass(frozen=True, slots=True)
class _Search:
    """Data shared by all channels: cross-validation fold of each block, and settings."""

    folds: Mapping[Key, int]
    settings: UnnamedSettings
    noise: LikelihoodSettings


@dataclass(frozen=True, slots=True)
class _Channel:
    """One channel of all flights, with the candidate columns as slopes."""

    name: str
    unit: str
    columns: tuple[Term, ...]
    flights: tuple[ChannelData, ...]


def find_equations(
    whitened: WhitenedFlights,
    fitted: Fit,
    seed: int = 0,
    settings: UnnamedSettings = DEFAULT.unnamed,
    mute: Collection[str] = (),
    means: bool = True,
) -> Unnamed | None:
    """Equations for the residual of a candidate model, except in `mute` channels; None: none is
    large enough.

    Channels that depend on weather or place have their mean removed, which no law explains; where
    `means` is false all channels have, because day-to-day constants of forces and moments are
    judged elsewhere.
    """
    days = fitted.on_its_days(whitened.model).channels([], fitted.values)
    left = [
        [
            c if means and _of_body(c.name) else replace(c, residual=c.residual - c.residual.mean())
            for c in f
        ]
        for f in days
    ]
    keys = list(blocks_of(left, whitened.noise, whitened.settings))
    search = _Search(fold_of(keys, seed, settings), settings, whitened.settings)
    known = _shared([quantities(f) for f in whitened.model.flights])
    tones = _tones(left, settings)
    equations, gains, noises = [], dict.fromkeys(keys, 0.0), {}
    for i, first in enumerate(left[0]):
        if sensor_of(first.name) is None or first.name in mute:
            continue  # the noise of the pose's prediction is in every regressor
        made = _channel(whitened, [f[i] for f in left], known, tones, settings)
        found = _found(made, search)
        if found is None:
            continue
        equation, best, noise = found
        if equation.share < settings.least_share or equation.rms < smallest(first.name, whitened):
            continue
        equations.append(equation)
        noises[first.name] = noise
        for key, gain in best.gains.items():
            gains[key] += gain
    if not equations:
        return None
    equations.sort(key=lambda e: -e.share)
    waves = {t for e in equations for t, _, _ in e.terms if t.startswith(("sin", "cos"))}
    count = sum(len(e.terms) for e in equations) + len({w[3:] for w in waves})
    return Unnamed(tuple(equations), np.array([gains[k] for k in keys]), count, noises)


def _found(channel: _Channel, search: _Search) -> tuple[Equation, Sparse, Autoregression] | None:
    """Equation of a channel, and the noise with it.

    The noise is assumed white at first: an autoregression would take a persistent oscillation, or
    an offset, for noise.
    """
    unexplained = [c.residual for c in channel.flights]
    whiten = autoregression_of(channel.flights, unexplained, 0, search.noise)
    most = longest(_blocks(channel, whiten, search.noise), search.settings)
    unexplained = [c.residual - c.slopes @ most for c in channel.flights]
    noise = autoregression_of(channel.flights, unexplained, search.noise.order, search.noise)
    best = sparse(_blocks(channel, noise, search.noise), search.folds, search.settings)
    return None if best is None else (_equation(channel, best, search), best, noise)


def _blocks(
    channel: _Channel, noise: Autoregression, settings: LikelihoodSettings
) -> dict[Key, Block]:
    return blocks_of([[c] for c in channel.flights], [noise], settings)


def _equation(channel: _Channel, best: Sparse, search: _Search) -> Equation:
    before, after, said = [], [], []
    for f, c in enumerate(channel.flights):
        blocks = np.floor(c.t_s / search.noise.block_s)
        fold = np.array([search.folds[(f, int(k))] for k in blocks], dtype=np.intp)
        value = np.einsum("np,np->n", c.slopes, best.by_fold[fold])
        for k in np.unique(c.piece):
            rows = c.piece == k
            before.append(c.residual[rows])
            after.append((c.residual - value)[rows])
            said.append(value[rows])
    band = _band(said, search.settings.in_band)
    power = _power(before, band)
    unit = powers_of(channel.unit)
    made = tuple(
        (channel.columns[i].text, float(f"{c:.{DIGITS}g}"), over(unit, channel.columns[i].unit))
        for i, c in zip(best.picked, best.coefficients, strict=True)
    )
    return Equation(
        channel=channel.name,
        unit=channel.unit,
        terms=made,
        expression=f"{channel.name} = {_sum_of(made, channel.unit)}",
        share=1 - _power(after, band) / power if power > 0 else 0.0,
        band_hz=band,
        rms=float(np.sqrt(np.mean(np.concatenate(said) ** 2))),
        gain=best.gain,
    )


def _band(pieces: Sequence[Array], share: float) -> float:
    """Frequency below which a share of the power lies, Hz."""
    hz, power = (np.concatenate(v) for v in zip(*map(_spectrum, pieces), strict=True))
    order = np.argsort(hz, kind="stable")
    below = np.cumsum(power[order])
    return float(hz[order][min(int(np.searchsorted(below, share * below[-1])), len(hz) - 1)])


def _power(pieces: Sequence[Array], below_hz: float) -> float:
    """Power up to a frequency."""
    return float(sum(p[f <= below_hz].sum() for f, p in map(_spectrum, pieces)))


def _spectrum(values: Array) -> tuple[Array, Array]:
    """Frequencies, Hz, and the power at each; its sum is that of the values (Parseval)."""
    power: Array = np.abs(np.fft.rfft(values)).astype(np.float64) ** 2 / len(values)
    power[1 : (len(values) + 1) // 2] *= 2
    hz: Array = np.fft.rfftfreq(len(values), 1 / CHANNEL_HZ).astype(np.float64)
    return hz, power


def _sum_of(made: Sequence[tuple[str, float, str]], unit: str) -> str:
    text = ""
    for term, value, of in made:
        sign = (" - " if value < 0 else " + ") if text else ("-" if value < 0 else "")
        size = f"{abs(value):g}" + ("" if of == "1" else f" {of}")
        text += sign + (f"{size} * {term}" if term != "1" else f"{abs(value):g} {unit}")
    return text


# -- regressors -------------------------------------------------------------------------------


def _shared(each: Sequence[dict[str, Quantity]]) -> list[dict[str, Quantity]]:
    """Quantities that every flight has, known wherever a residual is, and not zero in all."""
    names = [k for k in each[0] if all(k in e for e in each)]
    retained = []
    for k in names:
        values = np.concatenate([e[k].values for e in each])
        if np.ptp(values[np.isfinite(values)], axis=0) > 0:
            retained.append(k)
    return [{k: _bridged(e[k]) for k in retained} for e in each]


def _bridged(quantity: Quantity) -> Quantity:
    """The quantity with unknown values replaced: no residual is known there, so any value will
    do."""
    values, known = quantity.values, np.isfinite(quantity.values)
    rows = np.arange(len(values))
    return replace(quantity, values=np.interp(rows, rows[known], values[known]))


def _channel(
    whitened: WhitenedFlights,
    flights: Sequence[ChannelData],
    known: Sequence[dict[str, Quantity]],
    tones_hz: tuple[float, ...],
    settings: UnnamedSettings,
) -> _Channel:
    """The channel with every candidate, filtered by the channel's low-pass."""
    name = flights[0].name
    made, columns = [], []
    for channel, own, flight in zip(flights, known, whitened.model.flights, strict=True):
        columns = terms(own, name, tones_hz if _of_body(name) else (), settings)
        readings = next(p.readings for p in flight.factors if name in p.readings.names)
        values = np.stack([t.values for t in columns], axis=-1)
        made.append(replace(channel, slopes=readings.filtered(values, readings.filters_hz)))
    return _Channel(name, flights[0].unit, tuple(columns), tuple(made))


def _tones(left: Sequence[Sequence[ChannelData]], settings: UnnamedSettings) -> tuple[float, ...]:
    """The frequency with most power in force, and that in rotation, Hz."""
    found = []
    for sensor in (s for s in SENSORS if s.group == BODY):
        rows = [i for i, c in enumerate(left[0]) if c.name in sensor.channels]
        if rows:
            found.append(_tone([[f[i] for f in left] for i in rows], settings.tones_hz))
    return tuple(found)


def _tone(channels: Sequence[Sequence[ChannelData]], between_hz: tuple[float, float]) -> float:
    """Frequency whose sine and cosine, from the start of each flight, explain most, Hz.

    Residuals are differenced, so that drift does not hide an oscillation, and divided by their rms.
    """
    longest = max(float(np.ptp(c.t_s)) for c in channels[0])
    low, high = between_hz
    trial = np.arange(low, high, 1 / (FINER * longest))
    power = np.zeros(len(trial))
    for flights in channels:
        steps = [(c, np.diff(c.piece) == 0) for c in flights]
        parts = [((c.t_s[1:] + c.t_s[:-1])[s] / 2, np.diff(c.residual)[s]) for c, s in steps]
        rms = max(float(np.sqrt(np.mean(np.concatenate([v for _, v in parts]) ** 2))), 1e-300)
        for k, hz in enumerate(trial):  # one at a time, to limit memory
            wave = sum(v @ np.exp(-2j * np.pi * hz * t) for t, v in parts)
            power[k] += np.abs(wave / rms) ** 2
    return float(trial[int(np.argmax(power))])


# -- decision ---------------------------------------------------------------------------------


def smallest(channel: str, whitened: WhitenedFlights) -> float:
    """Rms below which a contribution is negligible, in the unit of a channel."""
    sensor = sensor_of(channel)
    assert sensor is not None, channel
    return SMALLEST * sensor.size(whitened.model.vehicle)[sensor.channels.index(channel)]


def _of_body(channel: str) -> bool:
    """Whether a channel measures forces or moments on the body."""
    sensor = sensor_of(channel)
    return sensor is not None and sensor.group == BODY


def explains_better(
    whitened: WhitenedFlights,
    named: Sequence[Fit],
    alone: Unnamed | None,
    settings: UnnamedSettings = DEFAULT.unnamed,
    stands: Fit | None = None,
) -> bool:
    """Whether a cause outside the library explains the flights better: equations for the residual
    of the model as it `stands` gain enough, and no probable candidate model covers what they
    explain."""
    return (
        alone is not None
        and alone.gain > settings.enough
        and all(covered(whitened, f, alone, stands) < settings.covers for f in named)
    )


def covered(
    whitened: WhitenedFlights, named: Fit, alone: Unnamed, stands: Fit | None = None
) -> float:
    """Share of the gain of equations, in their channels, that a candidate model reaches as well.

    Both are log likelihoods under the noise with the equations: the noise without them would
    already contain what the library cannot explain.
    """
    now = stands or replace(named, values={}, days=())
    before = now.on_its_days(whitened.model).channels([], now.values)
    after = named.on_its_days(whitened.model).channels([], {**now.values, **named.values})
    taken = 0.0
    for i, channel in enumerate(before[0]):
        if channel.name in alone.noise:
            noise = [alone.noise[channel.name]]
            power, left = (
                sum(b.power for b in blocks_of(own, noise, whitened.settings).values())
                for own in ([[f[i]] for f in flights] for flights in (before, after))
            )
            taken += 0.5 * (power - left)
    return taken / alone.gain
