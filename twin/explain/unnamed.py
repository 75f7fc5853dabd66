"""Causes outside the library: equations for the remaining residual of each channel, by
`inference.sparse_regression`."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import periodogram

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
from .inference.spectrum import Flights
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
        noise: Noise with the equations, by channel with an equation.
    """

    equations: tuple[Equation, ...]
    noise: Mapping[str, Autoregression]

    @property
    def gain(self) -> float:
        """Out-of-sample log likelihood over that of the candidate model alone, under the noise with
        the equations, nats."""
        return sum(e.gain for e in self.equations)


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
    folds = fold_of(list(blocks_of(left, whitened.noise, whitened.settings)), seed, settings)
    known = _shared([quantities(f) for f in whitened.model.flights])
    tones, block_s = _tones(left, settings), whitened.settings.block_s
    found = []
    for i, first in enumerate(left[0]):
        if sensor_of(first.name) is None or first.name in mute:
            continue  # the noise of the pose's prediction is in every regressor
        columns, own = _with_columns(whitened, [f[i] for f in left], known, tones, settings)
        best, noise = _best(own, folds, whitened.settings, settings)
        if best is None:
            continue
        equation = _equation(own, columns, best, folds, block_s, settings.in_band)
        if equation.share >= settings.least_share and equation.rms >= smallest(
            first.name, whitened
        ):
            found.append((equation, noise))
    found.sort(key=lambda f: -f[0].share)
    noises = {e.channel: noise for e, noise in found}
    return Unnamed(tuple(e for e, _ in found), noises) if found else None


def _best(
    own: Sequence[ChannelData],
    folds: Mapping[Key, int],
    likelihood: LikelihoodSettings,
    settings: UnnamedSettings,
) -> tuple[Sparse | None, Autoregression]:
    """Regression of a channel, with every candidate column as slopes, and the noise with it.

    The noise is assumed white at first: an autoregression would take a persistent oscillation, or
    an offset, for noise.
    """

    def noise_and_blocks(
        unexplained: Sequence[Array], order: int
    ) -> tuple[Autoregression, Mapping[Key, Block]]:
        noise = autoregression_of(own, unexplained, order, likelihood)
        return noise, blocks_of([[c] for c in own], [noise], likelihood)

    _, blocks = noise_and_blocks([c.residual for c in own], 0)
    most = longest(blocks, settings)
    noise, blocks = noise_and_blocks([c.residual - c.slopes @ most for c in own], likelihood.order)
    return sparse(blocks, folds, settings), noise


def _equation(
    own: Sequence[ChannelData],
    columns: Sequence[Term],
    best: Sparse,
    folds: Mapping[Key, int],
    block_s: float,
    in_band: float,
) -> Equation:
    """Equation of a channel by its regression."""
    before, after, said = [], [], []
    for f, c in enumerate(own):
        fold = np.array([folds[f, int(k)] for k in np.floor(c.t_s / block_s)], dtype=np.intp)
        value = np.einsum("np,np->n", c.slopes, best.by_fold[fold])
        for k in np.unique(c.piece):
            rows = c.piece == k
            before.append(c.residual[rows])
            after.append((c.residual - value)[rows])
            said.append(value[rows])
    band = _band(said, in_band)
    power, unit = _power(before, band), own[0].unit
    terms = tuple(
        (columns[i].text, float(f"{c:.{DIGITS}g}"), over(powers_of(unit), columns[i].unit))
        for i, c in zip(best.picked, best.coefficients, strict=True)
    )
    return Equation(
        channel=own[0].name,
        unit=unit,
        terms=terms,
        expression=f"{own[0].name} = {_sum_of(terms, unit)}",
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
    hz, power = periodogram(values, CHANNEL_HZ, detrend=False, scaling="spectrum")
    return hz, power * len(values)


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


def _with_columns(
    whitened: WhitenedFlights,
    own: Sequence[ChannelData],
    known: Sequence[dict[str, Quantity]],
    tones_hz: tuple[float, ...],
    settings: UnnamedSettings,
) -> tuple[list[Term], list[ChannelData]]:
    """Every candidate of a channel, and the channel of each flight with them as slopes, filtered by
    its low-pass."""
    name, made, columns = own[0].name, [], list[Term]()
    for channel, quantity, flight in zip(own, known, whitened.model.flights, strict=True):
        columns = terms(quantity, name, tones_hz if _of_body(name) else (), settings)
        readings = next(p.readings for p in flight.factors if name in p.readings.names)
        values = np.stack([t.values for t in columns], axis=-1)
        made.append(replace(channel, slopes=readings.predicted(values)))
    return columns, made


def _tones(left: Flights, settings: UnnamedSettings) -> tuple[float, ...]:
    """The frequency with most power in force, and that in rotation, Hz."""
    found = []
    for sensor in (s for s in SENSORS if s.group == BODY):
        rows = [i for i, c in enumerate(left[0]) if c.name in sensor.channels]
        if rows:
            found.append(_tone([[f[i] for f in left] for i in rows], settings.tones_hz))
    return tuple(found)


def _tone(channels: Flights, between_hz: tuple[float, float]) -> float:
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
