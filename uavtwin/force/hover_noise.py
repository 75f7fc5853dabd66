"""Disturbance spectrum of a hover by third-octave, and the noise that gives the twin the same one.

A twin in still air is calmer than any real aircraft. What a reading has at all frequencies, its
lowest density, is white noise of the sensor: aliased vibration of the rotors. The rest is motion.
Its disturbance is drawn inside the equations (`twin.physics.residual_force`), with one level of
force and of moment for each third-octave. Because the controller responds to it, levels are found
by equalisation as on a shaker: the exported twin hovers, and each level is scaled by the ratio of
the flights' spectrum to the twin's. A lateral force causes a tilt: where that rotates the twin more
than the flights rotate, the errors of both readings are balanced by the same factor, one too low
and the other too high.

Source: equalisation of random vibration, Piersol & Paez, Harris' Shock and Vibration Handbook;
power density, Welch, IEEE Trans. Audio Electroacoust. 15, 1967.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import welch

from twin.formatting import percent
from twin.frames import AXES
from twin.logs import Flight
from twin.physics.residual_force import NOISE_HZ, OUTPUTS, noise_values
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.teacher_forced import GRID_S

from ..exports.parts import NOISE, READ_S, LearnedForce, imu_starts, twin
from ..exports.write import temporary_fmu
from ..vehicles import Vehicle
from .closed_loop import HOVER, flown, uncontrollable

Array = NDArray[np.float64]
READINGS = tuple(f"{stem}_{a}" for stem in ("acc", "gyro") for a in AXES)
"""Readings whose spectra are matched, in the order of the six noise outputs that excite them."""
WINDOW_S = 10.0
"""Length of the window of a spectrum, s: two periods of the lowest third-octave; a shorter hover is
one window."""
NEIGHBOURS = 5
"""Number of third-octaves over which a spectrum is smoothed by its median: the fewest that reject a
line at the edge of two of them."""
ROUNDS, MOST = 4, 100.0
"""Number of iterations of the equalisation, and largest change of a power in one. Not chosen on
flights."""
SEEDS = (1, 2)
"""Random seeds of the simulated hovers in each iteration."""
FLOWN_S, MEASURED_S = 45.0, 30.0
"""Duration of a simulated hover, s, and of its end, from which the spectrum is taken; the transient
of the take-off has decayed by then."""
SETTLED_S = 1.0
"""Time at either end of a hover that is ignored, s. Not chosen on flights."""
SHORTEST_S = 3.0
"""Shortest hover, after the ends are removed, that is used, s."""
_GYRO_X, _GYRO_Y = READINGS.index("gyro_x"), READINGS.index("gyro_y")
_EDGE = 2 ** (1 / 6)  # ratio of a third-octave's edge to its centre frequency
_PART = "residual_force."  # prefix of the parameters


@dataclass(frozen=True, slots=True)
class HoverLevel:
    """Power spectral density in one third-octave of a hover, (unit of the reading)^2/Hz.

    Attributes:
        flight: Name of the flight.
        reading: Column of the flight table.
        hz: Centre frequency of the third-octave, Hz.
        aircraft: Density of the flight; missing where its log is too slow.
        calm: Density of the twin in hover in still air, with the noise of its vehicle file alone.
        drawn: Density of the twin in hover with its noise.
    """

    flight: str
    reading: str
    hz: float
    aircraft: float | None
    calm: float
    drawn: float


def levels(x: Array, rate_hz: float) -> Array:
    """Power spectral density by third-octave; NaN above the Nyquist frequency.

    Args:
        x: Readings, shape (n, k).
        rate_hz: Sample rate of the readings, Hz.

    Returns:
        Densities at each of `NOISE_HZ`, shape (k, len(NOISE_HZ)).
    """
    window = min(len(x), round(WINDOW_S * rate_hz))
    f, power = welch(x, rate_hz, nperseg=window, detrend="linear", axis=0)
    found = np.full((x.shape[1], len(NOISE_HZ)), np.nan)
    for k, middle in enumerate(NOISE_HZ):
        inside = (f >= middle / _EDGE) & (f < middle * _EDGE)
        if middle * _EDGE < rate_hz / 2:
            there = [np.interp(middle, f, p) for p in power.T]
            found[:, k] = power[inside].mean(axis=0) if inside.any() else there
    return found


def hover_rows(aligned: AlignedFlight) -> list[NDArray[np.intp]]:
    """Rows of each hover in the air, without its ends."""
    there = (aligned.phases == HOVER) & aligned.airborne
    pieces = np.split(np.arange(len(there)), np.flatnonzero(np.diff(there)) + 1)
    settled = round(SETTLED_S / GRID_S)
    inner = [p[settled : len(p) - settled] for p in pieces if there[p[0]]]
    return [p for p in inner if len(p) >= SHORTEST_S / GRID_S]


def flight_levels(flight: Flight, vehicle: Vehicle) -> Array | None:
    """Densities of a flight's hovers, resampled evenly at the rate of its log, shape (k,
    len(NOISE_HZ)); None: it has no hover."""
    if not flight.has(*READINGS):
        return None
    aligned = align_flight(flight, vehicle)
    t_s, x = flight.signal(list(READINGS))
    rate_hz, found, lengths = 1 / float(np.median(np.diff(t_s))), [], []
    for rows in hover_rows(aligned):
        begin_s, end_s = aligned.inputs.t_s[rows[[0, -1]]]
        even_s = np.arange(begin_s, end_s, 1 / rate_hz)
        even = np.column_stack([np.interp(even_s, t_s, column) for column in x.T])
        found.append(levels(even, rate_hz))
        lengths.append(len(even_s))
    return np.average(found, axis=0, weights=lengths) if found else None


def wanted_levels(found: Sequence[Array]) -> Array:
    """Mean density over flights without spectral lines, which come from rotors and are no noise; 0
    where no log has the frequency.

    Args:
        found: Densities of each flight, as of `flight_levels`.

    Returns:
        The median over `NEIGHBOURS` third-octaves is used: with some seconds of data each density
        is uncertain by a factor of two.
    """
    known = np.isfinite(found).any(axis=0)
    mean = np.where(
        known, np.nansum(found, axis=0) / np.maximum(np.isfinite(found).sum(axis=0), 1), 0
    )
    last = np.maximum.accumulate(np.where(known, np.arange(known.shape[1]), 0), axis=1)
    filled = np.take_along_axis(mean, last, axis=1)
    return np.where(known, median_filter(filled, (1, NEIGHBOURS), mode="nearest"), 0.0)


@contextmanager
def _hovering(
    vehicle: Vehicle, force: LearnedForce
) -> Iterator[Callable[[Mapping[str, float]], Array | None]]:
    """Function from start values to the densities of the exported twin in hover, or to None where
    it does not stay there."""
    reads = [f"imu.{r}" for r in READINGS]
    with temporary_fmu(twin(vehicle, HOVER, force=force, noise=True)) as fmu:

        def hovered(starts: Mapping[str, float]) -> Array | None:
            """Mean density over `SEEDS`."""
            found = []
            for seed in SEEDS:
                seeds = {f"{_PART}seed": float(seed), "imu.seed": float(seed)}
                rows = flown(fmu, FLOWN_S, {**starts, **seeds}, reads, READ_S)
                if not np.isfinite(rows).all():
                    return None
                found.append(levels(rows[-round(MEASURED_S / READ_S) :], 1 / READ_S))
            return np.asarray(np.mean(found, axis=0))

        yield hovered


def white_noise(wanted: Array) -> Array:
    """Standard deviation of the white noise of accelerometer, m/s2, and gyroscope, rad/s, in
    readings `READ_S` apart, shape (2,): density where it is lowest.

    Args:
        wanted: Densities, as of `wanted_levels`.
    """
    sensors = wanted.reshape(len(READINGS) // len(AXES), -1)
    lowest = [min(row[row > 0], default=0.0) for row in sensors]
    return np.sqrt(np.array(lowest) / (2 * READ_S))


def hover_noise(flights: Sequence[Flight], vehicle: Vehicle, force: LearnedForce) -> Array:
    """Noise with which the twin hovers as the flights do.

    Args:
        flights: Flights; only those with a hover count.
        vehicle: Vehicle of the twin.
        force: Force law learned for it.

    Returns:
        By reading and the output that excites it, shape (6, 1 + len(NOISE_HZ)): `white_noise`, then
        `ForceLaw.noise`; zero where no flight hovers, or the twin does not.
    """
    found = [own for f in flights if (own := flight_levels(f, vehicle)) is not None]
    nothing = np.zeros((len(OUTPUTS), 1 + len(NOISE_HZ)))
    if not found or uncontrollable(vehicle):
        return nothing
    wanted, middle = wanted_levels(found), np.array(NOISE_HZ)
    white = np.repeat(white_noise(wanted), len(AXES))[:, None]
    above = np.maximum(wanted - white**2 * 2 * READ_S, 0.0)
    noise = np.sqrt(above * middle * (_EDGE - 1 / _EDGE))
    noise[len(AXES) :] *= 2 * np.pi * middle  # a moment acts on the rates through an integrator
    with _hovering(vehicle, _with(force, noise + _LEAST)) as hovered:
        for _ in range(ROUNDS):
            own = hovered(_starts(noise) | imu_starts(white[:: len(AXES), 0].tolist()))
            if own is None:
                return nothing
            lacks = np.clip(wanted / own, 1 / MOST, MOST)
            turned = np.minimum(lacks[[_GYRO_Y, _GYRO_X]], 1.0)
            lacks[:2] = np.where(turned < 1, np.sqrt(lacks[:2] * turned), lacks[:2])
            noise = noise * np.sqrt(lacks)
    return np.hstack([white, noise])


def hover_levels(
    flights: Sequence[Flight], vehicle: Vehicle, force: LearnedForce
) -> tuple[HoverLevel, ...]:
    """Densities of the flights' and of the twin's hovers; empty where its law has no noise.

    Args:
        flights: Flights; only those with a hover count.
        vehicle: Vehicle of the twin.
        force: Force law learned for it.
    """
    if not force.model.law.noise.any():
        return ()
    sensors = vehicle.sensors
    file = {"imu.acc_noise": sensors.accel_noise_m_s2, "imu.gyro_noise": sensors.gyro_noise_rad_s}
    with _hovering(vehicle, force) as hovered:
        calm, drawn = hovered({NOISE: 0.0} | file), hovered({})
    if calm is None or drawn is None:
        return ()
    rows = []
    for flight in flights:
        if (own := flight_levels(flight, vehicle)) is None:
            continue
        for i, k in np.ndindex(own.shape):
            there = float(own[i, k]) if np.isfinite(own[i, k]) else None
            both = float(calm[i, k]), float(drawn[i, k])
            rows.append(HoverLevel(flight.name, READINGS[i], NOISE_HZ[k], there, *both))
    return tuple(rows)


TWICE = 2.0
"""Ratio of rms values up to which two hovers count as alike."""


def noise_claim(rows: Sequence[HoverLevel]) -> str:
    """How often the twin's hover is alike to the aircraft's, with its noise and without, in one
    sentence."""
    known = [row for row in rows if row.aircraft]

    def share(powers: Sequence[float]) -> str:
        """Share of the densities that are within the square of `TWICE` of the aircraft's, as
        text."""
        over = np.array(powers) / [r.aircraft for r in known]
        return percent(float(np.mean(np.abs(np.log(over)) < 2 * np.log(TWICE))))

    drawn, calm = share([r.drawn for r in known]), share([r.calm for r in known])
    return (
        f"hovering by itself with its noise drawn, the twin's accelerometer and gyroscope are "
        f"within a factor of {TWICE:g} of the flights' (rms) in {drawn} of {len(known)} "
        f"third-octaves from {NOISE_HZ[0]:g} to {NOISE_HZ[-1]:.0f} Hz, without it in {calm}."
    )


_LEAST = 1e-12
"""Smallest level, so that the exported twin has a parameter for each third-octave."""


def _with(force: LearnedForce, noise: Array) -> LearnedForce:
    """The same law with other noise levels."""
    return replace(force, model=replace(force.model, law=replace(force.model.law, noise=noise)))


def _starts(noise: Array) -> dict[str, float]:
    """Start values of the exported twin for these noise levels."""
    return {_PART + name: level for name, level in noise_values(noise).items()}
