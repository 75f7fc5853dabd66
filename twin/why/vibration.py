"""Vibration and its source: a rotor, once or several times per revolution, or the structure.

A line of the spectrum that follows the speed of a rotor is that rotor's; one that follows the
commands comes from the rotors; one that is constant while these change comes from the structure.
Frequencies above half the rate of the log are aliased, and searched for at the aliased frequency.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.signal import spectrogram
from scipy.stats import norm

from ..formatting import number
from ..logs.samples import interpolated
from ..residuals.measured import Signal
from .findings import Findings
from .flight import FlightFrame
from .records import Event, EvidenceSeries, Severity

Array = NDArray[np.float64]
ABOVE_HZ = 12.0
"""Upper frequency of a body's motion by its rotors: the bandwidth of the attitude loop is 5 to 10
Hz."""
LEAST_HZ = 60.0
"""Lowest rate of an accelerometer for the analysis of vibration."""
TOO_MUCH_M_S2, TOO_MUCH_SD = 15.0, 0.25
"""Level of an axis from which estimators are degraded, and width of that threshold, as a logarithm:
ArduPilot's documentation of VIBE asks for less than 15 m/s2."""
SEGMENT_S = 1.0
"""Length of the spectra in which lines are followed."""
OVER = 6.0
"""Power of a line over that of its surroundings."""
AROUND_HZ = 12.0
"""Width of the surroundings."""
HARMONICS = (1, 2, 3, 4)
"""Multiples of the rotor frequency: unbalance once, blades twice or three times."""
MOVED = 0.04
"""Smallest relative spread of the commands for which following them differs from a constant
frequency."""
ALIKE = 0.3
"""Difference of mean log power below which two sources are equal."""
STRUCTURE = "of the structure: it stays while the rotors change speed"
"""Text for a line that is constant."""
EVEN = "source not known: no rotor is known to change its speed enough"
"""Text where a constant and a following frequency are equal."""
MIDDLE = 1e-3
"""Weight by which the strongest of equal neighbours is the middle of a line."""


@dataclass(frozen=True, slots=True)
class Line:
    """A line of the spectrum.

    Attributes:
        hz: Mean frequency in the log.
        level: Root mean square, in the unit of the signal.
        source: Source in words.
        rotor: Number of the rotor; None: not a single one.
    """

    hz: float
    level: float
    source: str
    rotor: int | None


def vibration(flight: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Level of vibration and its strongest line."""
    if flight.rate_hz("acc") < LEAST_HZ or not flight.airborne:
        return Findings()
    part = max(flight.airborne, key=lambda p: p.flown - p.start)
    start, end = float(flight.t_s[part.start]), float(flight.t_s[part.flown - 1])
    shaken = _even(flight.signals["acc"], start, end)
    if shaken is None:
        return Findings()
    t, hz, power = _spectra(shaken)
    level = float(np.sqrt(power[hz > ABOVE_HZ].mean(axis=1).sum(axis=0) * hz[1]).max())
    line = strongest_line(t, hz, power.sum(axis=2), flight)
    note = f"vibration above {ABOVE_HZ:g} Hz: {number(level)} m/s2 rms"
    if line is not None:
        note += f"; a line of {number(line.level)} m/s2 at {number(line.hz)} Hz, {line.source}"
    probability = float(norm.cdf(np.log(level / TOO_MUCH_M_S2) / TOO_MUCH_SD))
    if probability < 0.5:
        return Findings(notes=(note,), nothing=1.0 - probability)
    rotor = (line.rotor,) if line is not None and line.rotor else None
    spread = np.exp(1.645 * TOO_MUCH_SD / np.sqrt(len(t)))
    event = Event(
        cause="vibration",
        rotor=rotor,
        severity=Severity(
            quantity="acceleration",
            value=level,
            low=level / spread,
            high=level * spread,
            unit="m/s^2",
        ),
        probability=probability,
        text=f"It shakes: {note}",
        bench_check="Balance the propellers, look for cuts, bent shafts and worn bearings; then "
        "look at the damping of the board.",
        evidence=(_drawn(hz, power),),
    )
    return Findings(events=(event,), nothing=1.0 - probability)


def strongest_line(t: Array, hz: Array, power: Array, flight: FlightFrame) -> Line | None:
    """The strongest line along the candidate frequencies; None where there is none.

    Each candidate is a frequency over time: that of a rotor, once or several times per revolution;
    one that follows the commands; a constant one. It is weighed by the mean logarithm of the power
    along it over that of the surroundings.

    Args:
        t: Midpoints of the segments, s, shape (m,).
        hz: Frequencies, shape (n,).
        power: Spectral density of each segment, shape (n, m).
        flight: Flight with the rotors.
    """
    step = float(hz[1])
    wide = max(round(2.0 * AROUND_HZ / step) | 1, 5)
    floor = median_filter(power, (wide, 1), mode="nearest") + 1e-30
    over = np.log(maximum_filter1d(power, 3, axis=0) / floor + 1e-30)
    over[hz <= ABOVE_HZ] = -np.inf

    def weighed(track: Array) -> float:
        place = np.clip(np.round(track / step).astype(int), 0, len(hz) - 1)
        return float(over[place, np.arange(len(t))].mean())

    stays = over.mean(axis=1)
    middle = int(np.argmax(stays + MIDDLE * np.log(power.mean(axis=1) + 1e-30)))
    followed = list(_tracks(t, hz, flight))
    moves = (np.log(np.maximum(x[2], step)).std() > MOVED for x in followed)
    words = STRUCTURE if any(moves) else EVEN
    tracks: list[tuple[float, str, int | None, Array]] = [
        (float(stays.max()), words, None, np.full(len(t), hz[middle]))
    ]
    tracks += [(weighed(track), words, rotor, track) for words, rotor, track in followed]
    best = max(tracks, key=lambda x: x[0])
    if not best[0] > np.log(OVER):
        return None
    rivals = [x for x in tracks if x[0] > best[0] - ALIKE]
    place = np.clip(np.round(best[3] / step).astype(int), 1, len(hz) - 2)
    own = sum(power[place + d, np.arange(len(t))] for d in (-1, 0, 1))
    level = float(np.sqrt(np.mean(own) * step))
    return Line(float(np.median(best[3])), level, *_named(best, rivals))


def _named(
    best: tuple[float, str, int | None, Array],
    rivals: Sequence[tuple[float, str, int | None, Array]],
) -> tuple[str, int | None]:
    """Source in words, and the rotor where only one has it."""
    others = {(words, rotor) for _, words, rotor, _ in rivals}
    rotors = sorted({r for _, r in others if r is not None})
    if best[2] is None and not rotors:
        return best[1], None
    if {STRUCTURE, EVEN} & {words for words, _ in others}:
        return EVEN, None
    if len(rotors) > 1:
        return f"of rotor {' or '.join(map(str, rotors))}", None
    return best[1], best[2]


def _tracks(t: Array, hz: Array, flight: FlightFrame) -> Iterator[tuple[str, int | None, Array]]:
    """Candidate frequencies of a line over time: words, rotor, Hz."""
    table, top = flight.flight.table, float(hz[-1])
    speeds = [str(c) for c in table if str(c).startswith("rotor_") and flight.flight.has(c)]
    for name in speeds:
        known, i = table[name].notna().to_numpy(), int(name.split("_")[1])
        own = table[name].to_numpy(np.float64)[known]
        turns = np.interp(t, flight.flight.time_s[known], own) / (2.0 * np.pi)
        for n in HARMONICS:
            folded = np.abs((n * turns + top) % (2.0 * top) - top)
            often = "once" if n == 1 else f"{n} times"
            yield f"of rotor {i}, {often} per turn", i, folded
    if speeds or flight.drive is None:
        return
    command = np.interp(t, flight.t_s, flight.grid[flight.drive].mean(axis=1))
    share = np.maximum(command, 1e-3) / np.median(command)
    if np.log(share).std() < MOVED:
        return
    for power in (0.5, 0.75, 1.0):
        for base in hz[hz > ABOVE_HZ]:
            yield (
                "of the rotors: it follows the commands",
                None,
                np.minimum(base * share**power, top),
            )


def _even(signal: Signal, start: float, end: float) -> tuple[float, float, Array] | None:
    """Start, rate and samples of a signal on a uniform grid; None where there are too few."""
    step = 1.0 / signal.rate_hz
    samples = signal.t_s[signal.t_s >= start]  # interpolation attenuates between them
    if not len(samples):
        return None
    first = float(samples[0])
    t = np.arange(first, end, step)
    if len(t) * step < 4 * SEGMENT_S:
        return None
    return first, 1.0 / step, interpolated(t, signal.t_s, signal.values)


def _spectra(shaken: tuple[float, float, Array]) -> tuple[Array, Array, Array]:
    """Midpoints of the segments, frequencies, densities (n, m, axes)."""
    start, rate, values = shaken
    size = round(SEGMENT_S * rate)
    hz, t, power = spectrogram(values, rate, nperseg=size, noverlap=size // 2, axis=0)
    return t + start, hz, np.moveaxis(power, 1, 2)


def _drawn(hz: Array, power: Array) -> EvidenceSeries:
    """Root of the spectral density of the three axes together, over frequency."""
    density = np.sqrt(power.mean(axis=1).sum(axis=1))
    every = max(1, len(hz) // 240)
    return EvidenceSeries(
        name="density by Hz",
        unit="m/s^2/sqrt(Hz)",
        t_s=tuple(hz[::every].tolist()),
        measured=tuple(density[::every].tolist()),
    )
