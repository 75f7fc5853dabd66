"""Effects that change no mean, found by spectra: sensor noise, vibration, gusts.

| effect | seen in | told from others by |
|---|---|---|
| sensor_noise_level | flat part of the spectrum, all axes | same level in every part of the band |
| vibration | lines that follow the rotors, or stand | level over the neighbouring frequencies |
| gust | slow part of the accelerometer residual | no curve explains it, falls with frequency |

Cells of a spectrogram of white noise are exponential; their quantiles measure its level whatever
few cells hold besides (Percival & Walden, Spectral Analysis for Physical Applications, ch. 6).
Every claim rests on a ratio and on how far such ratios go astray without the effect: noise given
in a vehicle file, smoothness of a spectrum, motion that no model has quite right.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt, spectrogram

from ..effects.inertial import VIBRATION
from ..flightlog.columns import ACC, GYRO
from ..frames import to_body
from ..measured import Signal
from ..prepared import Twin
from ..vehicle import Vehicle
from .channels import CHANNEL_HZ, GRID_HZ, ChannelData
from .flight_model import FlightModel
from .model import Model
from .numbers import columns_of
from .stuck import Stuck, stuck_numbers

Array = NDArray[np.float64]
PRIOR_ODDS = -float(np.log(40.0))
"""One of forty effects."""
SURE = 1.96
"""Standard deviations of a 95 % interval."""

# -- noise -------------------------------------------------------------------------------------
SLOWEST_HZ = 80.0
"""Sample rate from which on the upper half of the band is free of motion."""
NOISE_BANDS = ((0.25, 0.33), (0.33, 0.41), (0.41, 0.49))
"""Parts of the band that have to agree, over the sample rate."""
LOW = 0.2
"""Quantile of the cells that lines which wander about leave alone."""
FLAT = 1.3
"""Largest ratio of the noise in two parts of the band: force of the air falls by more than that."""
KNOWN_NOISE = 0.08
"""Log deviation of the noise that a vehicle file gives from that of a reading, where it holds."""
NOISE_RANGE = (0.1, 30.0)
"""A ratio beyond is no noise level: readings without noise, or another unit."""

# -- vibration ---------------------------------------------------------------------------------
LINE_WINDOW_S = 0.5
"""Long enough to tell a line from its neighbours, short enough for a rotor to keep its speed."""
LINE_FROM_HZ = 25.0
"""Below it the body moves and controllers oscillate."""
NEIGHBOURS = 0.12
"""Half width of what counts as neighbourhood of a line, over the sample rate."""
LOG_MEAN, LOG_SD = -0.5772156649 - np.log(np.log(2.0)), np.pi / np.sqrt(6.0)
"""Of the logarithm of an exponential variate over its median."""
OVERLAP = 0.6
"""Independent windows per window at an overlap of a half, Hann: Welch, IEEE Trans. AU-15 (1967)."""
LINE_BINS = 6
"""Bins on either side that belong to a line that wanders."""
MOTION_SHARE = 0.25
"""A line of which the twin predicts this share of the power is motion."""
SMALLEST_SHAKE = {"acc": 0.02, "gyro": 0.002}
"""Rms of a line that is worth a name, m/s2 and rad/s."""
LINE_SHARE = 0.05
"""Share of the power above `LINE_FROM_HZ` that it has at least."""

# -- gust --------------------------------------------------------------------------------------
GUST_BAND_HZ = (0.1, 3.0)
GUST_HZ = 10.0
"""Rate of the slow part."""
GUST_WINDOW_S = 8.0
"""Resolves 0.25 Hz: tells a swinging load from turbulence. Shorter pieces are left out."""
FOLD_S, FOLDS = 4.0, 5
"""Blocks of time that a regression predicts from the others."""
RIDGES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Variance of a coefficient's prior in units of noise over one sample, tried in turn."""
FLOOR_HZ = (5.0, 12.0)
"""Where the white floor of the 50 Hz channels is read."""
NO_NOISE = 1e-8
"""Smallest density that counts, (m/s2)^2/Hz: 0.5 mm/s2 at 50 Hz, the rounding of a simulator."""
SLOPE_BANDS_HZ = ((0.15, 0.35), (0.4, 0.8), (0.8, 1.5), (1.5, 3.0))
"""The density of turbulence falls from each to the next; that of a line or a load does not."""
SMALLEST_FALL = 0.7
"""Density of each of these bands over the next, at least; equal ones differ so by chance."""
LASTING_S, LASTING = 2.0, 0.25
"""Median over mean of the power in blocks of time: turbulence goes on, bumps do not."""
UNEXPLAINED = 0.5
"""Share of the slow power that no curve explains, at least."""
SMALLEST_GUST_M_S2 = 0.03
UNEVEN = 6.0
"""Largest ratio of the power along x and y: turbulence has no preferred direction to speak of."""
KNOWN_MODEL = 0.35
"""Log deviation of the slow power of a complete model from its noise floor."""
LAG_S = 0.2
"""Over which the force is correlated with itself to find its time constant."""
SMALLEST_DRAG_1_S = 0.02
"""Below it the model has no drag to speak of, through which a gust could act."""
TYPICAL_DRAG_1_S = 0.25
"""Drag over mass and speed where the model has none: Faessler et al. 2018 measure 0.2 to 0.4."""


@dataclass(frozen=True, slots=True)
class Unsteady:
    """An effect that changes no mean.

    Attributes:
        effect: Identifier.
        log_odds: Evidence for it, natural log, prior included.
        values: "effect.number" -> value.
        intervals: 95 % of each.
        channels: On which it was found.
        share: Of their power in the band where it acts.
    """

    effect: str
    log_odds: float
    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    channels: tuple[str, ...]
    share: float

    @property
    def probability(self) -> float:
        """That it acts."""
        return float(1 / (1 + np.exp(-self.log_odds)))


@dataclass(frozen=True, slots=True)
class Piece:
    """Uninterrupted readings of one sensor in the air, each a new one.

    Attributes:
        t_s: Times, shape (n,), nearly even.
        values: Shape (n, 3).
    """

    t_s: Array
    values: Array


@dataclass(frozen=True, slots=True)
class Cells:
    """Spectrogram of one piece.

    Attributes:
        t_s: Middle of each window, shape (m,).
        f_hz: Shape (n,).
        power: Density per window, axis and frequency, unit^2/Hz, shape (m, 3, n).
    """

    t_s: Array
    f_hz: Array
    power: Array


def unsteady(model: Model, values: Mapping[str, float]) -> list[Unsteady]:
    """Effects without a mean that the flights show, the surest first.

    Args:
        model: Flights, stuck readings taken out.
        values: Numbers of the effects that have been named, "effect.number" -> value.
    """
    found = [noise_level(model), vibration(model), gust(model, values)]
    return sorted((u for u in found if u is not None), key=lambda u: -u.log_odds)


# -- readings at their own rate ------------------------------------------------------------------


def stuck_effect(stuck: Sequence[Stuck]) -> list[Unsteady]:
    """The effect of readings that stand still; none where all go on."""
    if not stuck:
        return []
    channels = tuple(dict.fromkeys(s.channel for s in stuck))
    return [Unsteady("stuck_sensor", -PRIOR_ODDS, stuck_numbers(stuck), {}, channels, 1.0)]


def pieces_of(flight: FlightModel, columns: Sequence[str]) -> list[Piece]:
    """Readings in the air at the sensor's own rate; repeats of a slower sensor are left out."""
    if not flight.flight.has(*columns):
        return []
    t, x = flight.flight.signal(columns)
    grid = flight.twin.inputs.t_s
    near = np.clip(np.rint((t - grid[0]) * GRID_HZ).astype(np.intp), 0, len(grid) - 1)
    t, x = t[flight.twin.airborne[near]], x[flight.twin.airborne[near]]
    if len(t) < 2:
        return []
    repeated = np.all(x[1:] == x[:-1], axis=1)
    if np.mean(repeated) > 0.2:
        fresh = np.concatenate([[True], ~repeated])
        t, x = t[fresh], x[fresh]
    if len(t) < 2:
        return []
    gaps = np.flatnonzero(np.diff(t) > 2.5 * np.median(np.diff(t))) + 1
    whole = (Piece(a, b) for a, b in zip(np.split(t, gaps), np.split(x, gaps), strict=True))
    return [p for p in whole if len(p.t_s) > 16 and p.t_s[-1] - p.t_s[0] >= 4 * LINE_WINDOW_S]


def rate_of(pieces: Sequence[Piece]) -> float:
    """Samples per second; 0 without a piece."""
    steps = [np.diff(p.t_s) for p in pieces]
    return 1.0 / float(np.median(np.concatenate(steps))) if steps else 0.0


def cells_of(piece: Piece, rate_hz: float, window_s: float, window: str) -> Cells:
    """Spectrogram with half-overlapping windows, each about its own straight line."""
    n = min(len(piece.t_s), round(window_s * rate_hz))
    f, t, power = spectrogram(
        piece.values, rate_hz, window, n, n // 2, detrend="linear", axis=0, mode="psd"
    )
    return Cells(piece.t_s[0] + t, f, np.moveaxis(power, 2, 0).transpose(0, 2, 1))


# -- noise level ---------------------------------------------------------------------------------


def noise_level(model: Model) -> Unsteady | None:
    """White noise of accelerometer and gyroscope against that of the vehicle file.

    A noise level is the standard deviation of one reading, at the rate of the log: what a sensor
    averages before, the file has to know.
    """
    sensors = model.vehicle.sensors
    stated = {ACC: sensors.accel_noise_m_s2, GYRO: sensors.gyro_noise_rad_s}
    ratios = {c: r for c, s in stated.items() if s > 0 and (r := _ratio(model, c, s)) is not None}
    off = {c: r for c, r in ratios.items() if r != 1.0}
    if not off:
        return None
    both = len(off) == len(ratios) and max(off.values()) < 1.25 * min(off.values())
    if not both and min(off.values()) < 1:
        return None  # the effect can only add to one sensor alone
    size = float(np.exp(np.mean(np.log(list(off.values())))))
    log_odds = 0.5 * (np.log(size) / KNOWN_NOISE) ** 2 + PRIOR_ODDS
    if log_odds <= 0:
        return None
    values = {f"sensor_noise_level.{n}": v
              for n, v in (("scale", 1.0), ("accel_m_s2", 0.0), ("gyro_rad_s", 0.0))}  # fmt: skip
    intervals = {}
    spread = np.exp(SURE * KNOWN_NOISE / 2)
    if both:
        values["sensor_noise_level.scale"] = size
        intervals["sensor_noise_level.scale"] = (size / spread, size * spread)
    else:
        for columns, ratio in off.items():
            name = f"sensor_noise_level.{'accel_m_s2' if columns == ACC else 'gyro_rad_s'}"
            low, values[name], high = (
                stated[columns] * float(np.sqrt(max(r * r - 1, 0.0)))
                for r in (ratio / spread, ratio, ratio * spread)
            )
            intervals[name] = (low, high)
    return Unsteady("sensor_noise_level", float(log_odds), values, intervals,
                    tuple(c for columns in off for c in columns),
                    float(abs(1 - 1 / size**2)) if size > 1 else 1 - size**2)  # fmt: skip


def _ratio(model: Model, columns: Sequence[str], stated: float) -> float | None:
    """Noise over the stated one; 1 where estimates differ about it, None where unknown."""
    estimates = noise_estimates([pieces_of(f, columns) for f in model.flights])
    if estimates is None:
        return None
    ratios = estimates / stated
    low, high = float(ratios.min()), float(ratios.max())
    if low < NOISE_RANGE[0] or high > NOISE_RANGE[1]:
        return None
    if low <= 1 <= high or ratios[:, -1].max() > FLAT * ratios[:, -1].min():
        return 1.0
    return float(ratios[:, -1].min()) if low > 1 else float(ratios[:, -1].max())


def noise_estimates(flights: Sequence[Sequence[Piece]]) -> Array | None:
    """Standard deviation of a reading, by part of the band, and by axis and for all axes together.

    White noise of standard deviation s has the one-sided density 2 s^2 / rate. The noise of the
    last bit, bit^2 / 12, is taken off.

    Args:
        flights: Pieces of each.

    Returns:
        Shape (bands, 4); None where the sensor is too slow.
    """
    by_band: list[list[Array]] = [[] for _ in NOISE_BANDS]
    bits = []
    for pieces in flights:
        rate = rate_of(pieces)
        if rate < SLOWEST_HZ:
            continue
        bits += [_bit(p.values[:, i]) for p in pieces for i in range(3)]
        for piece in pieces:
            c = cells_of(piece, rate, LINE_WINDOW_S, "blackmanharris")
            for found, (low, high) in zip(by_band, NOISE_BANDS, strict=True):
                inside = (c.f_hz >= low * rate) & (c.f_hz < high * rate)
                cells = c.power[:, :, inside].transpose(0, 2, 1).reshape(-1, 3)
                found.append(0.5 * rate * cells)
    if not bits:
        return None
    levels = []
    for found in by_band:
        cells = np.concatenate(found)
        each = np.median(cells, axis=0) / np.log(2.0)
        levels.append([*each, float(np.quantile(cells, LOW)) / -np.log1p(-LOW)])
    return np.sqrt(np.maximum(np.array(levels) - np.median(bits) ** 2 / 12, 0.0))


def _bit(x: Array) -> float:
    """Last bit of quantised readings; 0 where there is none to see."""
    levels = np.unique(x)
    return float(np.diff(levels).min()) if 1 < len(levels) < 0.5 * len(x) else 0.0


# -- vibration -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Shaken:
    """One sensor in all flights.

    Attributes:
        kind: Sensor.
        rate_hz: Samples per second.
        cells: Of every piece.
        logs: Log level of each cell over its neighbourhood, mean 0 in noise, like the power.
        spins: Speed of each rotor over that in hover at each window, shape (m, r).
        predicted: Density that the twin predicts, shape (3, n_f); NaN where it cannot say.
    """

    kind: Literal["acc", "gyro"]
    rate_hz: float
    cells: tuple[Cells, ...]
    logs: tuple[Array, ...]
    spins: tuple[Array, ...]
    predicted: Array


def vibration(model: Model) -> Unsteady | None:
    """Lines above the body's motion, which follow the rotors or stand still."""
    sensors = [s for s in (_shaken(model, "acc", ACC), _shaken(model, "gyro", GYRO)) if s]
    hover_hz = next(p for p in VIBRATION.parameters if p.name == "frequency_hz").sized(
        model.vehicle
    )
    if not sensors:
        return None
    rel = np.exp(np.arange(np.log(hover_hz.prior[0]), np.log(hover_hz.prior[1]), 0.005))
    tracks = [(f, True) for f in rel.tolist()]
    top = max(s.rate_hz for s in sensors) / 2
    tracks += [(f, False) for f in np.arange(LINE_FROM_HZ, 0.97 * top, 1.0).tolist()]
    best: tuple[float, float, bool, _Shaken] | None = None
    for sensor in sensors:
        scores = np.array([_score(sensor, f, moves) for f, moves in tracks])
        if not np.isfinite(scores).any():
            continue
        k = int(np.nanargmax(scores))
        if best is None or scores[k] > best[0]:
            best = (float(scores[k]), *tracks[k], sensor)
    if best is None:
        return None
    z, frequency, moves, sensor = best
    log_odds = 0.5 * z * z - np.log(len(tracks)) + PRIOR_ODDS if z > 0 else PRIOR_ODDS
    if log_odds <= 0:
        return None
    return _named_vibration(model, sensors, float(log_odds), frequency, moves)


def _shaken(model: Model, kind: Literal["acc", "gyro"], columns: Sequence[str]) -> _Shaken | None:
    """Spectrograms of one sensor."""
    cells, spins, predicted = [], [], []
    pieces = [(f, p) for f in model.flights for p in pieces_of(f, columns)]
    rate = rate_of([p for _, p in pieces])
    if rate / 2 < 1.2 * LINE_FROM_HZ:
        return None
    answers = {id(f): _answers(f.twin) for f in model.flights}
    for flight, piece in pieces:
        c = cells_of(piece, rate, LINE_WINDOW_S, "hann")
        spin, force, alpha = answers[id(flight)]
        grid = flight.twin.inputs.t_s
        cells.append(c)
        spins.append(Signal(grid, _smooth(spin)).at(c.t_s))
        motion = np.nan_to_num(force if kind == "acc" else alpha)
        m = cells_of(Piece(grid, motion), GRID_HZ, LINE_WINDOW_S, "hann")
        level = np.median(m.power, axis=0) / np.log(2.0)
        if kind == "gyro":
            level = level / np.maximum(2 * np.pi * m.f_hz, 1.0) ** 2
        predicted.append([np.interp(c.f_hz, m.f_hz, v, right=0.0) for v in level])
    return _Shaken(kind, rate, tuple(cells), tuple(_logs(c, rate) for c in cells), tuple(spins),
                   np.mean(predicted, axis=0))  # fmt: skip


def _answers(twin: Twin) -> tuple[Array, Array, Array]:
    """Rotor speeds over that in hover, specific force and angular acceleration on the grid.

    Shapes (n, r), (n, 3), (n, 3).
    """
    body = twin.airframe
    p = np.tile(body.parameter_values()[:, None], (1, len(twin.states)))
    y = np.asarray(body.outputs(twin.states.T, twin.inputs.u.T, p), dtype=np.float64).T
    at = {name: i for i, name in enumerate(body.output_names)}
    stems = ("spin_", "specific_force_", "angular_acceleration_")
    spin, force, alpha = (y[:, [i for n, i in at.items() if n.startswith(s)]] for s in stems)
    return spin, force, alpha


def _smooth(spin: Array) -> Array:
    """Mean over a window."""
    n = round(LINE_WINDOW_S / 2 * GRID_HZ)
    kernel = np.ones(n) / n
    return np.stack([np.convolve(s, kernel, mode="same") for s in spin.T], axis=-1)


def _logs(cells: Cells, rate_hz: float) -> Array:
    """Log level of each cell over the higher of its two neighbourhoods, shape as the power.

    Both sides count: a spectrum that falls steeply is no line. Beyond zero and half the rate a
    spectrum is its own mirror image.
    """
    f = cells.f_hz
    half = max(4, round(NEIGHBOURS * rate_hz / (f[1] - f[0])))
    mirrored = np.pad(cells.power, ((0, 0), (0, 0), (half, half)), mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(mirrored, half, axis=2), axis=3)
    below, above = middle[:, :, : len(f)], middle[:, :, half + 1 :][:, :, : len(f)]
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(cells.power / np.maximum(below, above)) - LOG_MEAN
    logs[:, :, (f < LINE_FROM_HZ) | (f > 0.485 * rate_hz)] = np.nan
    return np.asarray(logs, dtype=np.float64)


def _bins(sensor: _Shaken, k: int, frequency_hz: float, moves: bool) -> NDArray[np.intp]:
    """Bin of each rotor's line in each window of a piece, folded at half the rate, shape (m, r)."""
    c, rate = sensor.cells[k], sensor.rate_hz
    f = frequency_hz * (sensor.spins[k] if moves else np.ones((len(c.t_s), 1)))
    folded = np.abs((np.nan_to_num(f) + rate / 2) % rate - rate / 2)
    return np.asarray(np.rint(folded / (c.f_hz[1] - c.f_hz[0])), dtype=np.intp)


def _score(sensor: _Shaken, frequency_hz: float, moves: bool) -> float:
    """Mean log level along lines of a frequency, in standard deviations of that of noise."""
    sums, counts = np.zeros(3), np.zeros(3)
    for k, logs in enumerate(sensor.logs):
        at = _bins(sensor, k, frequency_hz, moves)
        level = logs[np.arange(len(logs))[:, None], :, at]  # (windows, rotors, 3)
        known = np.isfinite(level)
        several = np.maximum(known.sum(axis=1), 1)
        sums += (np.where(known, level, 0.0).sum(axis=1) / several).sum(axis=0)
        counts += known.any(axis=1).sum(axis=0)
    if counts.min() < 8:
        return float("nan")
    together = sums[:2].sum() / (LOG_SD * np.sqrt(counts[:2].sum() / OVERLAP))
    across = sums[2] / (LOG_SD * np.sqrt(counts[2] / OVERLAP))
    return float(max(together, across))


def _named_vibration(
    model: Model, sensors: Sequence[_Shaken], log_odds: float, frequency_hz: float, moves: bool
) -> Unsteady | None:
    """The line with its sizes, or None where it is too small or predicted as motion."""
    values = {"vibration.frequency_hz": frequency_hz}
    doubt = 0.02 * frequency_hz if moves else 0.5 / LINE_WINDOW_S
    intervals = {"vibration.frequency_hz": (frequency_hz - doubt, frequency_hz + doubt)}
    channels: list[str] = []
    shares: list[float] = []
    cutoffs = {"acc": model.vehicle.accel_cutoff_hz, "gyro": model.vehicle.gyro_cutoff_hz}
    names = {"acc": "vibration.accel_m_s2", "gyro": "vibration.gyro_rad_s"}
    for sensor in sensors:
        power, share, motion, lift = _line_power(sensor, frequency_hz, moves)
        cutoff = cutoffs[sensor.kind]
        passed = 1.0 if cutoff is None else 1 / np.sqrt(1 + (frequency_hz / cutoff) ** 4)
        plane = power[:, :2].mean(axis=1)  # (pieces,)
        sizes = np.sqrt(2 * np.maximum(plane, 0.0) / lift) / passed
        values[names[sensor.kind]] = float(np.mean(sizes))
        spread = SURE * max(float(np.std(sizes)), 0.1 * float(np.mean(sizes)))
        intervals[names[sensor.kind]] = (
            max(0.0, float(np.mean(sizes)) - spread), float(np.mean(sizes)) + spread,
        )  # fmt: skip
        mean = power.mean(axis=0)
        large = (np.sqrt(np.maximum(mean, 0.0)) > SMALLEST_SHAKE[sensor.kind]) & (
            share > LINE_SHARE
        )
        for axis in np.flatnonzero(large & (motion < MOTION_SHARE)):
            channels.append(f"{sensor.kind}_{'xyz'[axis]}")
            shares.append(float(share[axis]))
    if not channels:
        return None
    return Unsteady("vibration", log_odds, values, intervals, tuple(channels), max(shares))


def _line_power(
    sensor: _Shaken, frequency_hz: float, moves: bool
) -> tuple[Array, Array, Array, Array]:
    """Power of the lines over their neighbourhood.

    Returns:
        Power per piece and axis, unit^2, shape (p, 3); share of all above `LINE_FROM_HZ`, and
        what the twin predicts over it, shape (3,); sum over rotors of spin^4, shape (p,).
    """
    powers, totals, motions, lifts = [], [], [], []
    for k, c in enumerate(sensor.cells):
        usable = np.isfinite(sensor.logs[k][0, 0])
        at = _bins(sensor, k, frequency_hz, moves)
        mine = np.min(np.abs(np.arange(len(c.f_hz))[None, None] - at[:, :, None]), axis=1)
        line = (mine <= LINE_BINS) & usable
        floor = np.stack([
            np.median(p[:, usable & ~m] if np.any(usable & ~m) else p[:, usable], axis=1)
            for p, m in zip(c.power, line, strict=True)
        ]) / np.log(2.0)  # (m, 3)  # fmt: skip
        width = c.f_hz[1] - c.f_hz[0]
        excess = (c.power - floor[:, :, None]) * line[:, None, :] * width
        powers.append(excess.sum(axis=2).mean(axis=0))
        totals.append((c.power * usable).sum(axis=2).mean(axis=0) * width)
        motions.append((sensor.predicted[None] * line[:, None, :]).sum(axis=2).mean(axis=0) * width)
        spin = sensor.spins[k]
        lifts.append(max(float(np.mean(np.nansum(spin**4, axis=1))), 1e-3))
    power, total = np.stack(powers), np.stack(totals)
    mean = np.maximum(power.mean(axis=0), 1e-300)
    return power, mean / total.mean(axis=0), np.mean(motions, axis=0) / mean, np.array(lifts)


# -- gust ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Slow:
    """Slow part of the accelerometer residuals of one piece of flight.

    Attributes:
        t_s: Shape (n,), at `GUST_HZ`.
        residual: m/s2, shape (n, 3).
        features: What may explain it, per axis, shape (n, 3, k).
        drag: Answer to north, east and down wind, 1/s, shape (n, 3, 3); empty without any.
        speed_m_s: Of the vehicle, shape (n,).
        floor: Density of the white floor per axis, (m/s2)^2/Hz, shape (3,).
    """

    t_s: Array
    residual: Array
    features: Array
    drag: Array
    speed_m_s: Array
    floor: Array


def gust(model: Model, values: Mapping[str, float]) -> Unsteady | None:
    """A slow random force that no curve over the motion and no effect explains.

    Args:
        model: Flights.
        values: Numbers of the effects that have been named.
    """
    columns = columns_of(model.numbers, model.effects)
    flights = model.channels(columns, values)
    winds = [k for k, i in enumerate(columns) if model.numbers[i].effect == "steady_wind"]
    pieces = [
        piece
        for flight, channels in zip(model.flights, flights, strict=True)
        for piece in slow_parts(flight.twin, channels, winds)
    ]
    return gust_in(pieces, model.vehicle) if pieces else None


def slow_parts(twin: Twin, channels: Sequence[ChannelData], winds: Sequence[int]) -> list[Slow]:
    """Slow parts of one flight.

    Args:
        twin: The flight on its grid.
        channels: Its channels, with slopes.
        winds: Columns of the slopes that answer to the steady wind: north, east, down.
    """
    acc = [c for c in channels if c.name in ACC]
    motion = twin.motion
    if len(acc) < 3 or motion.velocity is None or motion.attitude is None:
        return []
    found = []
    every = round(CHANNEL_HZ / GUST_HZ)
    sos = butter(2, GUST_BAND_HZ, "bandpass", fs=CHANNEL_HZ, output="sos")
    spin, force, _ = _answers(twin)
    for k in np.unique(acc[0].piece):
        rows = np.flatnonzero(acc[0].piece == k)
        if len(rows) < (GUST_WINDOW_S + 1) * CHANNEL_HZ:
            continue
        t = acc[0].t_s[rows]
        residual = np.stack([c.residual[rows] for c in acc], axis=-1)
        slopes = np.stack([c.slopes[rows] for c in acc], axis=1)  # (n, 3, k)
        at = np.rint((t - twin.inputs.t_s[0]) * GRID_HZ).astype(np.intp)
        curves = _curves(twin, at, spin, force)  # (n, c)
        features = np.concatenate([slopes, np.repeat(curves[:, None, :], 3, axis=1)], axis=2)
        speed = np.linalg.norm(motion.velocity.at(t), axis=1)
        found.append(Slow(
            t[::every], sosfiltfilt(sos, residual, axis=0)[::every],
            sosfiltfilt(sos, features, axis=0)[::every],
            slopes[::every][:, :, list(winds)], speed[::every], _floor(t, residual),
        ))  # fmt: skip
    return found


def _curves(twin: Twin, at: NDArray[np.intp], spin: Array, force: Array) -> Array:
    """Speed, thrust and turning, and products of them, shape (n, c)."""
    assert twin.motion.velocity is not None
    column = {s.name: i for i, s in enumerate(twin.airframe.states)}
    q, v, w = (
        twin.states[at][:, [column[n] for n in names]]
        for names in (
            [f"q_{a}" for a in "wxyz"], [f"vel_{a}" for a in "xyz"], [f"omega_{a}" for a in "xyz"],
        )
    )  # fmt: skip
    body = np.stack(to_body(list(q.T), list(v.T)), axis=-1)
    size = np.linalg.norm(body, axis=1, keepdims=True)
    thrust = force[at][:, 2:]
    load = spin[at] ** 2
    height = np.exp(twin.states[at][:, [column["pos_z"]]])
    return np.concatenate(
        [body, np.abs(body), size * body, size**2 * body, thrust * body, load, w, np.abs(w),
         body * np.roll(w, 1, axis=1), body * np.roll(w, 2, axis=1), height], axis=1,
    )  # fmt: skip


def _floor(t_s: Array, residual: Array) -> Array:
    """White floor of the channels per axis, from where nothing else is, shape (3,)."""
    c = cells_of(Piece(t_s, residual), CHANNEL_HZ, GUST_WINDOW_S, "hann")
    inside = (c.f_hz >= FLOOR_HZ[0]) & (c.f_hz <= FLOOR_HZ[1])
    return np.asarray(np.median(c.power[:, :, inside], axis=(0, 2)) / np.log(2.0))


def left_over(pieces: Sequence[Slow]) -> list[Array]:
    """What a ridge regression, fitted on other blocks of time, leaves of each piece, (n, 3)."""
    fold = [(np.floor(p.t_s / FOLD_S).astype(int) + i) % FOLDS for i, p in enumerate(pieces)]
    folds = np.concatenate(fold)
    left = []
    for axis in range(3):
        y = np.concatenate([p.residual[:, axis] for p in pieces])
        x = np.nan_to_num(np.concatenate([p.features[:, axis] for p in pieces]))
        size = np.sqrt(np.mean(x * x, axis=0))
        x = x[:, size > 1e-9 * max(float(size.max(initial=0.0)), 1e-9)]
        x = x / np.maximum(np.sqrt(np.mean(x * x, axis=0)), 1e-300)
        tries = [y]
        for ridge in RIDGES:
            out = np.array(y)
            for k in range(FOLDS):
                test, train = folds == k, folds != k
                gram = x[train].T @ x[train] + ridge * train.sum() * 1e-2 * np.eye(x.shape[1])
                out[test] -= x[test] @ np.linalg.solve(gram, x[train].T @ y[train])
            tries.append(out)
        left.append(min(tries, key=lambda e: float(np.median(e * e))))
    rest = np.stack(left, axis=-1)
    return np.split(rest, np.cumsum([len(p.t_s) for p in pieces])[:-1])


def gust_in(pieces: Sequence[Slow], vehicle: Vehicle) -> Unsteady | None:
    """Judge the slow parts of all flights."""
    left = left_over(pieces)
    facts = gust_facts(pieces, left)
    log_odds = 0.5 * (np.log(max(facts["over_floor"], 1.0)) / KNOWN_MODEL) ** 2 + PRIOR_ODDS
    if (
        log_odds <= 0
        or facts["unexplained"] < UNEXPLAINED
        or facts["rms"] < SMALLEST_GUST_M_S2
        or facts["uneven"] > UNEVEN
        or facts["fall"] < SMALLEST_FALL
        or facts["lasting"] < LASTING
    ):
        return None
    values, intervals = _gust_numbers(pieces, left)
    channels = ("acc_x", "acc_y")
    return Unsteady("gust", float(log_odds), values, intervals, channels, facts["unexplained"])


def gust_facts(pieces: Sequence[Slow], left: Sequence[Array]) -> dict[str, float]:
    """Figures by which a gust is told, of the horizontal axes."""
    cells = [cells_of(Piece(p.t_s, e), GUST_HZ, GUST_WINDOW_S, "hann")
             for p, e in zip(pieces, left, strict=True)]  # fmt: skip
    f = cells[0].f_hz
    power = np.concatenate([c.power for c in cells])  # (windows, 3, f)
    floor = np.maximum(np.mean([p.floor for p in pieces], axis=0), NO_NOISE)
    bands = [(f >= low) & (f < high) for low, high in SLOPE_BANDS_HZ]
    typical = np.median(power, axis=0) / np.log(2.0)  # robust to single bumps
    density = np.stack([typical[:, b].mean(axis=1) for b in bands])  # (bands, 3)
    before = np.concatenate([p.residual for p in pieces])
    after = np.concatenate(list(left))
    rms = np.sqrt(np.mean(after**2, axis=0))
    xy = np.sum(density[:, :2] - floor[:2], axis=1)
    tiny = 0.1 * float(floor[:2].sum())
    n = round(LASTING_S * GUST_HZ)
    blocks = np.concatenate([
        (e[: len(e) // n * n, :2] ** 2).reshape(-1, n * 2).mean(axis=1) for e in left
    ])  # fmt: skip
    return {
        "over_floor": float(np.min(np.mean(density[:3, :2], axis=0) / floor[:2])),
        "unexplained": float(np.sum(after[:, :2] ** 2) / max(np.sum(before[:, :2] ** 2), NO_NOISE)),
        "rms": float(np.min(rms[:2])),
        "uneven": float(np.max(rms[:2]) ** 2 / max(np.min(rms[:2]) ** 2, NO_NOISE)),
        "lasting": float(np.median(blocks) / max(np.mean(blocks), NO_NOISE)),
        "fall": float(np.min(xy[:-1] / np.maximum(xy[1:], tiny))),
    }


def _gust_numbers(
    pieces: Sequence[Slow], left: Sequence[Array]
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Intensities and lengths from the force that is left and the model's answer to wind."""
    rest = np.concatenate(list(left))
    low, high = GUST_BAND_HZ
    floor = np.mean([p.floor for p in pieces], axis=0) * (high - low)
    power = np.maximum(np.mean(rest**2, axis=0) - floor, 0.0)
    drag = np.concatenate([p.drag for p in pieces])
    known = drag.shape[2] == 3 and float(np.sqrt(np.mean(drag[:, 0] ** 2))) > SMALLEST_DRAG_1_S
    per_speed = (
        np.sqrt(np.mean(np.sum(drag**2, axis=2), axis=0)) if known else np.full(3, TYPICAL_DRAG_1_S)
    )
    lag = round(LAG_S * GUST_HZ)
    same = sum(float(np.mean(e[lag:, :2] * e[:-lag, :2])) for e in left) / len(left)
    time_s, seen = _time_constant(same / max(float(np.mean(power[:2])), 1e-300))
    sigma = np.sqrt(power / seen) / np.maximum(per_speed, SMALLEST_DRAG_1_S)
    through = np.concatenate([p.speed_m_s for p in pieces])
    length = max(float(np.mean(through)), 1.0) * time_s
    doubt = 1.5 if known else 3.0
    values, intervals = {}, {}
    for way, size in (("u", sigma[:2].mean()), ("v", sigma[:2].mean()), ("w", sigma[2])):
        values[f"gust.intensity_{way}"] = float(size)
        intervals[f"gust.intensity_{way}"] = (float(size) / doubt, float(size) * doubt)
        values[f"gust.length_{way}"] = length
        intervals[f"gust.length_{way}"] = (length / 3, length * 3)
    return values, intervals


def _time_constant(correlation: float) -> tuple[float, float]:
    """Time constant of a first-order process and the share of its power inside `GUST_BAND_HZ`.

    Args:
        correlation: Of its part inside the band, over `LAG_S`.
    """
    f = np.linspace(*GUST_BAND_HZ, 200)
    times = np.geomspace(0.05, 5.0, 60)[:, None]
    density = 4 * times / (1 + (2 * np.pi * f * times) ** 2)
    inside = density.mean(axis=1) * (f[-1] - f[0])
    expected = (density * np.cos(2 * np.pi * f * LAG_S)).mean(axis=1) * (f[-1] - f[0]) / inside
    k = int(np.argmin(np.abs(expected - correlation)))
    return float(times[k, 0]), float(inside[k])
