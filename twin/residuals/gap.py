"""Residuals between a flight and its twin, their summary statistics, and their spectra.

`residual = measured - simulated`, always.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from ..logs.airframe import Place
from ..logs.columns import ACC
from ..representation import ShortRepr
from ..vehicle import GRAVITY_M_S2

if TYPE_CHECKING:
    from .flight_gap import HoverDiagnosis

Array = NDArray[np.float64]

SLOW_HZ = 10.0
"""Upper frequency of the vehicle's motion; above it a residual is mostly vibration and noise."""


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power spectral density.

    Attributes:
        f_hz: Frequencies, Hz, shape (n,); empty when the record is too short.
        psd: Power spectral density about the mean, unit^2/Hz, shape (n,).
        rate_hz: Rate of the resampled record, the median of its samples.
        filled: Share of the resampled record that lies in gaps of the original, 0..1.
    """

    f_hz: Array
    psd: Array
    rate_hz: float
    filled: float

    def band_rms(self, low_hz: float, high_hz: float) -> float:
        """Rms in the band `low_hz <= f < high_hz`; NaN where the sample rate is too low."""
        inside = (self.f_hz >= low_hz) & (self.f_hz < high_hz)
        if not inside.any():
            return math.nan
        return math.sqrt(float(self.psd[inside].sum()) * float(self.f_hz[1] - self.f_hz[0]))


def resample(t_s: Array, x: Array) -> tuple[Array, Array, float]:
    """Linear interpolation onto a uniform grid at the median rate of the samples.

    Interpolation attenuates frequencies near half that rate; a signal already uniform is unchanged.

    Args:
        t_s: Strictly increasing times, s, shape (n,), n >= 2.
        x: Values, finite, shape (n,).

    Returns:
        Uniform times, s; values there; share of the grid in gaps over 3 median steps, 0..1.
    """
    steps = np.diff(t_s)
    step_s = float(np.median(steps))
    grid = t_s[0] + step_s * np.arange(int((t_s[-1] - t_s[0]) / step_s + 0.5) + 1)
    gap_s = float(steps[steps > 3 * step_s].sum())
    return grid, np.interp(grid, t_s, x), gap_s / float(t_s[-1] - t_s[0])


def spectrum(t_s: Array, x: Array, segment_s: float = 4.0) -> Spectrum:
    """Welch power spectral density of samples that need not be uniform.

    They are first resampled at their median rate (see `resample`); segments of `segment_s` overlap
    by half, Hann window, each about its own mean. Non-finite samples are dropped.

    Args:
        t_s: Strictly increasing times, s, shape (n,).
        x: Values, shape (n,).
        segment_s: Length of a segment, s: sets the resolution to 1 / segment_s Hz.
    """
    from scipy import signal  # a second to import, not needed in reports of simulations

    ok = np.isfinite(x) & np.isfinite(t_s)
    t_s, x = t_s[ok], x[ok]
    if len(t_s) < 16:
        return Spectrum(np.empty(0), np.empty(0), math.nan, 0.0)
    grid, values, filled = resample(t_s, x)
    rate_hz = 1.0 / float(grid[1] - grid[0])
    n = min(len(values), max(16, round(segment_s * rate_hz)))
    f_hz, psd = signal.welch(values, fs=rate_hz, nperseg=n, detrend="constant")
    return Spectrum(np.asarray(f_hz), np.asarray(psd), rate_hz, filled)


def slow_part(t_s: Array, x: Array, cutoff_hz: float = SLOW_HZ) -> Array:
    """Residual below `cutoff_hz`: 2nd-order Butterworth, forward and backward.

    Args:
        t_s: Strictly increasing times, s, shape (n,).
        x: Values, finite, shape (n,).
        cutoff_hz: Cutoff of the low-pass, Hz.

    Returns:
        Filtered values at `t_s`; `x` unchanged where the rate is too low for content above the
        cutoff or the record is shorter than 32 samples.
    """
    from scipy import signal

    if len(x) < 32:
        return x
    grid, values, _ = resample(t_s, x)
    rate_hz = 1.0 / float(grid[1] - grid[0])
    if rate_hz <= 2.5 * cutoff_hz or len(values) < 32:
        return x
    sos = signal.butter(2, cutoff_hz, fs=rate_hz, output="sos")
    slow: Array = np.interp(t_s, grid, signal.sosfiltfilt(sos, values))
    return slow


BAND_EDGES_HZ = (0.0, 1.0, SLOW_HZ, 40.0, math.inf)
"""Edges of the frequency bands in which residuals are summarised, Hz: drift, manoeuvres, control,
vibration. Made up."""
UNKNOWN_PHASE = "unknown"  # name of rows without a phase


@dataclass(frozen=True, slots=True)
class Channel(ShortRepr):
    """One scalar quantity, measured and simulated at the same instants.

    Attributes:
        name: Flight-table column or derived name (`acc_x`, `gyro_rate_z`, `pos_z`, `att_x`).
        unit: SI unit, as printed.
        horizon_s: 0 for teacher-forced; else the time from the last restart at the measured state
            to the comparison.
        t_s: Times, s, shape (n,).
        measured: Measured values, shape (n,).
        simulated: Simulated values, shape (n,).
        phase: Flight phase of each sample, shape (n,), "" where unknown.
        unfiltered: The channel before the low-pass of both sides, for spectra; None: there is no
            low-pass.
    """

    name: str
    unit: str
    horizon_s: float
    t_s: Array
    measured: Array
    simulated: Array
    phase: NDArray[np.str_]
    unfiltered: "Channel | None" = None

    @property
    def residual(self) -> Array:
        """Measured minus simulated, shape (n,)."""
        return self.measured - self.simulated

    @property
    def wide(self) -> "Channel":
        """The channel with all sampled frequencies."""
        return self.unfiltered or self


MOST_OFF = 3.0
"""Factor between mean specific force in flight and gravity from which the accelerometer is wrong:
climbs cancel, turns add less than half. Made up."""


def weighs(acc_z: float) -> bool:
    """Whether a mean specific force along z, m/s^2, can be that of a flight."""
    return 1.0 / MOST_OFF < -acc_z / GRAVITY_M_S2 < MOST_OFF


@dataclass(frozen=True, slots=True)
class FlightGap(ShortRepr):
    """All channels of one flight.

    Attributes:
        flight: Name of the flight.
        vehicle: Name of the vehicle model it was compared with.
        channels: Channels in the order of the report.
        phases: Spans (name, start s, end s) in order of time.
        warnings: Warnings for readers of the numbers.
        facts: Printable facts of the log (rates, match of the rebuilt commands, ...).
        hover: Diagnosis of the twin in hover; None: it has none.
        origin: Origin of its positions; None: not known.
        driven_by: Input of the twin, and the reason for its choice; "": not known.
    """

    flight: str
    vehicle: str
    channels: tuple[Channel, ...]
    phases: tuple[tuple[str, float, float], ...]
    warnings: tuple[str, ...]
    facts: dict[str, str]
    hover: "HoverDiagnosis | None" = None
    origin: Place | None = None
    driven_by: str = ""

    @property
    def carried(self) -> float | None:
        """Share of its weight that the twin carries at the commands: in hover, else over the whole
        flight; None: not known."""
        if self.hover is not None:
            return self.hover.carried.value
        lift = self._lift
        if lift is None or not weighs(self.acc_z):
            return None
        return float(np.nanmean(lift.simulated)) / self.acc_z

    @property
    def acc_z(self) -> float:
        """Mean measured specific force along z, m/s^2; NaN: not measured."""
        lift = self._lift
        return math.nan if lift is None else float(np.nanmean(lift.measured))

    @property
    def _lift(self) -> Channel | None:
        """Channel of the specific force along z, with samples."""
        of_z = (c for c in self.channels if c.name == ACC[2] and not c.horizon_s)
        return next((c for c in of_z if np.isfinite(c.measured).any()), None)

    @property
    def duration_s(self) -> float:
        """Time from the first sample of any channel to the last."""
        spans = [(float(c.t_s[0]), float(c.t_s[-1])) for c in self.channels if len(c.t_s)]
        return max(e for _, e in spans) - min(s for s, _ in spans) if spans else 0.0


@dataclass(frozen=True, slots=True)
class Score:
    """Size of a residual over some samples; NaN where it is not defined.

    Attributes:
        n: Number of samples at which both sides are finite.
        rms: Root mean square of the residual, in the channel's unit.
        mean: Mean of the residual, which a constant would correct.
        share: `rms` over the rms of the measured signal about its mean. The signal is always
            that of the whole channel (each flight about its own mean), also for a phase: a
            quiet phase cannot turn a small residual into a large share. At 1 over a whole flight
            the twin is no better than a constant. NaN for a flat signal.
        slow_rms: Rms of the residual below `SLOW_HZ`; mean included.
        rms_ci95: 95 % interval of `rms`, bootstrap over blocks of time.
        dropped: Number of samples dropped because one side is not finite.
    """

    n: int
    rms: float
    mean: float
    share: float
    slow_rms: float
    rms_ci95: tuple[float, float]
    dropped: int = 0


@dataclass(frozen=True, slots=True)
class Summary:
    """Statistics of one channel over several flights: total and by phase (in order of
    appearance)."""

    name: str
    unit: str
    horizon_s: float
    total: Score
    by_phase: Mapping[str, Score]


@dataclass(frozen=True, slots=True)
class Ranked:
    """A residual in one channel and phase, for ranking.

    Attributes:
        weight: Residual below `SLOW_HZ`, rms, over the rms of the measured signal about its mean
            on the largest axis of the channel's vector.
    """

    channel: str
    phase: str
    unit: str
    horizon_s: float
    score: Score
    weight: float


@dataclass(frozen=True, slots=True)
class _Samples:
    """Finite samples of one channel in one flight."""

    t_s: Array
    about_mean: Array
    residual: Array
    slow: Array
    phase: NDArray[np.str_]
    dropped: NDArray[np.str_]  # phase of each dropped sample


def pool(channels: Sequence[Channel], seed: int = 0) -> Summary:
    """Statistics of one channel over several flights.

    Args:
        channels: The same channel (name, unit, horizon) of each flight.
        seed: Seed of the bootstrap for `Score.rms_ci95`.

    Raises:
        ModelError: The channels differ in name, unit or horizon, or there are none.
    """
    kinds = sorted({(c.name, c.unit, c.horizon_s) for c in channels})
    if len(kinds) != 1:
        raise ModelError(
            f"cannot pool {len(kinds)} kinds of channel: {kinds}. "
            "Pool one name, unit and horizon at a time."
        )
    parts = [_samples(c) for c in channels]
    n = sum(len(p.t_s) for p in parts)
    signal_rms = math.nan
    if n:
        signal_rms = math.sqrt(sum(float(p.about_mean @ p.about_mean) for p in parts) / n)
        largest = max(
            float(np.max(np.abs(c.measured[np.isfinite(c.measured)]), initial=0.0))
            for c in channels
        )
        if signal_rms <= 1e-9 * largest:  # constant within rounding: a share of it is not defined
            signal_rms = math.nan
    phases = dict.fromkeys(str(p) for part in parts for p in part.phase)
    name, unit, horizon_s = kinds[0]
    return Summary(
        name,
        unit,
        horizon_s,
        _score(parts, None, signal_rms, horizon_s, seed),
        {p or UNKNOWN_PHASE: _score(parts, p, signal_rms, horizon_s, seed) for p in phases},
    )


def summarise(channel: Channel) -> Summary:
    """Statistics of one channel of one flight."""
    return pool([channel])


def summaries(gaps: Sequence[FlightGap]) -> dict[str, Summary]:
    """Every channel over all flights, in the order of the report.

    The key is the channel's name, with `@HORIZONs` appended where one name comes with several
    horizons or units.
    """
    kinds = _kinds(gaps)
    names = [name for name, _, _ in kinds]
    units = [(name, h) for name, _, h in kinds]
    result = {}
    for (name, unit, horizon_s), channels in kinds.items():
        key = name if names.count(name) == 1 else f"{name}@{horizon_s:g}s"
        if units.count((name, horizon_s)) > 1:
            key += f" [{unit}]"
        result[key] = pool(channels)
    return result


def rank(pooled: Mapping[str, Summary], min_n: int = 20) -> list[Ranked]:
    """Channels and phases with the largest residuals first.

    Ordered by the residual *below `SLOW_HZ`* over the signal of the channel's vector (the largest
    of its axes): an unmodelled force appears there, while vibration would rank the noisiest sensor
    first, and an axis with little motion the one with the least signal. Teacher-forced channels
    come before short-horizon ones, which show the growth of an error in the former. A phase with
    fewer than `min_n` samples is omitted (short-horizon channels: fewer than 4), and so is a
    constant signal.
    """
    signal: dict[tuple[str, float], float] = {}
    for key, s in pooled.items():
        if math.isfinite(s.total.share) and s.total.share > 0:
            vector = (key.split("_")[0], s.horizon_s)
            signal[vector] = max(signal.get(vector, 0.0), s.total.rms / s.total.share)
    places = [
        Ranked(key, phase, s.unit, s.horizon_s, score, score.slow_rms / signal[vector])
        for key, s in pooled.items()
        if (vector := (key.split("_")[0], s.horizon_s)) in signal
        for phase, score in (s.by_phase or {"": s.total}).items()
        if score.n >= (min_n if s.horizon_s == 0 else 4) and math.isfinite(score.share)
    ]
    return sorted(places, key=lambda p: (p.horizon_s > 0, -p.weight))


def _kinds(gaps: Sequence[FlightGap]) -> dict[tuple[str, str, float], list[Channel]]:
    """The same channel of all flights, by name, unit and horizon."""
    kinds: dict[tuple[str, str, float], list[Channel]] = {}
    for channel in (c for gap in gaps for c in gap.channels):
        kinds.setdefault((channel.name, channel.unit, channel.horizon_s), []).append(channel)
    return kinds


def _samples(channel: Channel) -> _Samples:
    ok = np.isfinite(channel.t_s) & np.isfinite(channel.measured) & np.isfinite(channel.simulated)
    t_s, measured, residual = channel.t_s[ok], channel.measured[ok], channel.residual[ok]
    about_mean = measured - measured.mean() if len(measured) else measured
    slow = slow_part(t_s, residual)
    return _Samples(t_s, about_mean, residual, slow, channel.phase[ok], channel.phase[~ok])


def _score(
    parts: Sequence[_Samples], phase: str | None, signal_rms: float, horizon_s: float, seed: int
) -> Score:
    """Score of one phase, or of all samples when `phase` is None."""
    masks = [np.ones(len(p.t_s), bool) if phase is None else p.phase == phase for p in parts]
    residual = np.concatenate([p.residual[m] for p, m in zip(parts, masks, strict=True)])
    slow = np.concatenate([p.slow[m] for p, m in zip(parts, masks, strict=True)])
    dropped = sum(
        len(p.dropped) if phase is None else int((p.dropped == phase).sum()) for p in parts
    )
    if not len(residual):
        return Score(0, math.nan, math.nan, math.nan, math.nan, (math.nan, math.nan), dropped)
    blocks: list[tuple[float, int]] = []
    for part, mask in zip(parts, masks, strict=True):
        index = np.floor(part.t_s[mask] / max(1.0, 2 * horizon_s)).astype(np.int64)
        _, inverse = np.unique(index, return_inverse=True)
        squares = np.bincount(inverse, part.residual[mask] ** 2)
        blocks += list(zip(squares.tolist(), np.bincount(inverse).tolist(), strict=True))
    rms = math.sqrt(float(np.mean(residual**2)))
    return Score(
        n=len(residual),
        rms=rms,
        mean=float(residual.mean()),
        share=rms / signal_rms,
        slow_rms=math.sqrt(float(np.mean(slow**2))),
        rms_ci95=_bootstrap_rms(np.array(blocks, dtype=np.float64), seed),
        dropped=dropped,
    )


def _bootstrap_rms(blocks: Array, seed: int, draws: int = 500) -> tuple[float, float]:
    """95 % interval of the rms from blocks (sum of squares, count), shape (blocks, 2)."""
    if len(blocks) < 5:
        return math.nan, math.nan
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(len(blocks), np.full(len(blocks), 1 / len(blocks)), size=draws)
    squares, counts = (weights @ blocks).T  # (draws,)
    low, high = np.percentile(np.sqrt(squares / counts), [2.5, 97.5])
    return float(low), float(high)


def band_rows(
    gaps: Sequence[FlightGap],
) -> dict[tuple[str, str, float], list[dict[str, float]]]:
    """Rms of measured and residual per frequency band, about the mean, pooled by duration."""
    result = {}
    for key, channels in _kinds(gaps).items():
        spectra = [
            (len(c.t_s), spectrum(c.t_s, c.measured), spectrum(c.t_s, c.residual))
            for c in (channel.wide for channel in channels)
        ]
        rows = []
        for low, high in pairwise(BAND_EDGES_HZ):
            powers = [
                (n, m.band_rms(low, high) ** 2, r.band_rms(low, high) ** 2) for n, m, r in spectra
            ]
            powers = [p for p in powers if math.isfinite(p[1]) and math.isfinite(p[2])]
            if powers:
                n, m2, r2 = np.array(powers).T
                rows.append(
                    {
                        "from_hz": low,
                        "to_hz": high,  # null: up to half the sample rate
                        "measured_rms": math.sqrt(float(n @ m2 / n.sum())),
                        "residual_rms": math.sqrt(float(n @ r2 / n.sum())),
                    }
                )
        result[key] = rows
    return result
