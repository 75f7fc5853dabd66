"""Residuals that look real, drawn without a network: autoregressions, and flights played back.

Each channel is an AR(8) process about the mean of its phase. What drives it is drawn, per sensor
and phase, from a hard codebook: k-means over the innovation vectors of the training flights, drawn
as often as they occurred. So the channels of a sensor move together as they did, and what is rare
and large stays rare and large. A codebook is coarser than what it was made from; a linear map
gives its draws the covariance of the innovations back.

Sensors are taken at their own sample instants: every so many rows of the grid as in training.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from learning.data.channels import CHANNELS, GROUPS, N_PHASES
from learning.data.flights import ResidualFlight
from learning.model.baselines import by_phase, phase_means
from learning.model.family import Corrected

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
Drive = Literal["codebook", "gaussian"]
ORDER = 8
CODES = 256
SAMPLES_PER_CODE = 4
SAMPLES_PER_LAG = 20
"""Fewer samples per coefficient or code than that, and there are fewer coefficients or codes."""
SETTLE = 500
"""Samples drawn before the first one that counts, so that a span starts in the steady state."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """Channels that are sampled together.

    Attributes:
        channels: Their numbers.
        every: Rows of the grid per sample.
        coefficients: Of each channel's autoregression, shape (c, k).
        codes: Innovations by phase, each shape (codes, c); row N_PHASES: of all phases together.
        counts: How often each occurred, by phase, each shape (codes,).
        covariance: Of the innovations by phase, each shape (c, c).
    """

    channels: tuple[int, ...]
    every: int
    coefficients: Array
    codes: tuple[Array, ...]
    counts: tuple[Array, ...]
    covariance: tuple[Array, ...]


@dataclass(frozen=True, slots=True)
class Generator:
    """Draws residuals; sees phases and span limits, never a measurement.

    Attributes:
        mean: Of the residual by phase, shape (phases, 15), units of the channels.
        scale: Spread about it, shape (phases, 15); 0 for a channel never measured.
        sensors: What drives the channels, in units of `scale`.
        drive: Innovations from the codebook, or Gaussian of the same covariance.
        seed: Of all draws; each flight has its own by its name.
    """

    mean: Array
    scale: Array
    sensors: tuple[Sensor, ...]
    drive: Drive = "codebook"
    seed: int = 0

    def with_seed(self, seed: int) -> "Generator":
        """The same generator with other draws."""
        return replace(self, seed=seed)

    def run(self, flight: ResidualFlight) -> Corrected:
        """A residual as it might have been; the spread is that of a draw."""
        rng = np.random.default_rng([self.seed, zlib.crc32(flight.name.encode())])
        unit = np.zeros(flight.virtual.shape)
        for a, b in flight.spans:
            for sensor in self.sensors:
                rows = np.arange(a, b, sensor.every)
                drawn = self._drawn(sensor, flight.phase[rows], rng)
                unit[a:b, sensor.channels] = np.repeat(drawn, sensor.every, axis=0)[: b - a]
        n = len(flight.t_s)
        return Corrected(
            self.mean[flight.phase] + self.scale[flight.phase] * unit,
            self.scale[flight.phase],
            np.full(n, np.nan),
            np.ones(n, dtype=np.bool_),
        )

    def _drawn(self, sensor: Sensor, phase: IntArray, rng: np.random.Generator) -> Array:
        """Samples in the phases given, shape (len(phase), c)."""
        phases = np.concatenate([np.full(SETTLE, phase[0]), phase])
        drive = np.empty((len(phases), len(sensor.channels)))
        for p in np.unique(phases):
            here = phases == p
            drive[here] = _draw(sensor, int(p), int(here.sum()), self.drive, rng)
        columns = zip(drive.T, sensor.coefficients, strict=True)
        return np.stack([synthesis(d, a) for d, a in columns], axis=-1)[SETTLE:]


def fit_generator(
    train: Sequence[ResidualFlight],
    seed: int = 0,
    order: int = ORDER,
    codes: int = CODES,
    sensors: Sequence[Sequence[int]] | None = None,
) -> Generator:
    """Learn from flights.

    Args:
        train: Flights.
        seed: Of k-means, and of the draws until `with_seed`.
        order: Of the autoregression; 0 makes white noise.
        codes: Of each codebook, at most; 0: none, innovations are Gaussian.
        sensors: Numbers of channels that are drawn together; default: each sensor. Those of one
            are sampled at the same instants.
    """
    mean = phase_means(train)
    scale = np.sqrt(by_phase(train, [(f.residual - mean[f.phase]) ** 2 for f in train]))
    groups = sensors or [range(len(CHANNELS))[columns] for columns in GROUPS.values()]
    fitted = [_fit_sensor(train, tuple(g), mean, scale, order, codes, seed) for g in groups]
    return Generator(mean, scale, tuple(s for s in fitted if s is not None), seed=seed)


@dataclass(frozen=True, slots=True)
class InnovationsPreset:
    """Hyper-parameters of a generator.

    Attributes:
        name: As printed.
        order: Of the autoregression; 0: white noise.
        codes: Of each codebook, at most.
        drive: What drives it.
    """

    name: str
    order: int = ORDER
    codes: int = CODES
    drive: Drive = "codebook"

    def fit(self, train: Sequence[ResidualFlight], seed: int = 0) -> Generator:
        """The generator of these flights."""
        return replace(fit_generator(train, seed, self.order, self.codes), drive=self.drive)


INNOVATIONS = MappingProxyType(
    {
        "white noise": InnovationsPreset("white-noise", order=0, codes=0, drive="gaussian"),
        "autoregression, Gaussian innovations": InnovationsPreset(
            "ar-gaussian", codes=0, drive="gaussian"
        ),
        "autoregression, codebook of innovations": InnovationsPreset("ar-codebook"),
    }
)
"""Generators without a network, by the names of their rows."""


def _fit_sensor(
    train: Sequence[ResidualFlight],
    channels: tuple[int, ...],
    mean: Array,
    scale: Array,
    order: int,
    codes_at_most: int,
    seed: int,
) -> Sensor | None:
    """None where no flight has the sensor."""
    stretches: list[Array] = []
    phases: list[IntArray] = []
    gaps: list[IntArray] = []
    for flight in train:
        for a, b in flight.spans:
            rows = a + np.flatnonzero(flight.fresh[a:b, channels].all(axis=1))
            phase = flight.phase[rows]
            size = np.where(scale[phase] > 0, scale[phase], 1.0)
            unit = (flight.residual[rows] - mean[phase]) / size
            stretches.append(unit[:, channels])
            phases.append(phase)
            gaps.append(np.diff(rows))
    samples = sum(len(s) for s in stretches)
    if samples < 2:
        return None
    lags = min(order, samples // SAMPLES_PER_LAG)
    coefficients = np.stack(
        [burg([s[:, i] for s in stretches], lags) for i in range(len(channels))]
    )
    drive = np.concatenate(
        [
            np.stack([innovations(s[:, i], a) for i, a in enumerate(coefficients)], axis=-1)
            for s in stretches
        ]
    )
    phase = np.concatenate([p[lags:] for p in phases])
    parts = [drive[phase == p] for p in range(N_PHASES)] + [drive]
    codes, counts = zip(*(_codebook(p, codes_at_most, seed) for p in parts), strict=True)
    covariance = tuple(p.T @ p / max(len(p), 1) for p in parts)
    between = np.concatenate(gaps)
    every = max(round(float(np.median(between))), 1) if len(between) else 1
    return Sensor(channels, every, coefficients, codes, counts, covariance)


def _codebook(drive: Array, at_most: int, seed: int) -> tuple[Array, Array]:
    """Codes and how often each is nearest, none of too few samples."""
    k = min(at_most, len(drive) // SAMPLES_PER_CODE, len(np.unique(drive, axis=0)))
    if k < 2:
        return np.zeros((0, drive.shape[1])), np.zeros(0)
    with threadpool_limits(1):  # for so few samples several threads only wait for each other
        fitted = KMeans(n_clusters=k, n_init=1, random_state=seed).fit(drive)
    counts = np.bincount(fitted.labels_, minlength=k).astype(np.float64)
    return np.asarray(fitted.cluster_centers_, dtype=np.float64), counts


def _draw(sensor: Sensor, phase: int, n: int, drive: Drive, rng: np.random.Generator) -> Array:
    """Innovations in a phase, of all phases where there is no codebook; shape (n, c)."""
    p = phase if len(sensor.codes[phase]) else N_PHASES
    codes, counts, covariance = sensor.codes[p], sensor.counts[p], sensor.covariance[p]
    root = _root(covariance)
    if drive == "gaussian" or not len(codes):
        return np.asarray(rng.standard_normal((n, len(covariance))) @ root.T)
    share = counts / counts.sum()
    centred = codes - share @ codes
    coarse = _root((share[:, None] * centred).T @ centred)
    widened = centred @ np.linalg.pinv(coarse).T @ root.T
    return np.asarray(widened[rng.choice(len(codes), size=n, p=share)])


def _root(covariance: Array) -> Array:
    """R with R R^T = covariance, symmetric."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T)


# ----------------------------------------------------------------------------------------
# Autoregressive models that never blow up: Burg's method over several stretches of one signal.


def burg(stretches: Sequence[Array], order: int) -> Array:
    """Coefficients of x_t = a_1 x_{t-1} + ... + a_k x_{t-k} + e_t; all poles inside the circle.

    Args:
        stretches: Uninterrupted pieces, each shape (n_i,), about their common mean.
        order: k; less where the pieces hold fewer samples or no power is left.

    Returns:
        Shape (order,).

    Source: Burg, Maximum Entropy Spectral Analysis (1975), sums taken over all pieces.
    """
    forward, backward = ([s.astype(np.float64) for s in stretches] for _ in range(2))
    power = sum(float(s @ s) for s in stretches)
    found: Array = np.zeros(0)
    for _ in range(order):
        forward = [f[1:] for f in forward]
        backward = [b[:-1] for b in backward]
        both = sum(float(f @ f + b @ b) for f, b in zip(forward, backward, strict=True))
        if both <= 1e-12 * power:
            break
        cross = sum(float(f @ b) for f, b in zip(forward, backward, strict=True))
        reflection = 2 * cross / both
        found = np.append(found - reflection * found[::-1], reflection)
        forward, backward = (
            [f - reflection * b for f, b in zip(forward, backward, strict=True)],
            [b - reflection * f for f, b in zip(forward, backward, strict=True)],
        )
    return np.concatenate([found, np.zeros(order - len(found))])


def innovations(values: Array, coefficients: Array) -> Array:
    """e_t of each sample that has enough before it, shape (n - k,)."""
    whitened = lfilter(np.append(1.0, -coefficients), [1.0], values)
    return np.asarray(whitened[len(coefficients) :], dtype=np.float64)


def synthesis(drive: Array, coefficients: Array) -> Array:
    """Signal that innovations give, starting from zero, shape as `drive`."""
    return np.asarray(lfilter([1.0], np.append(1.0, -coefficients), drive), dtype=np.float64)


# ----------------------------------------------------------------------------------------
# Residuals of a training flight played back: how alike two real flights are, and no more.


@dataclass(frozen=True, slots=True)
class Recording:
    """Plays pieces of training flights in the same phase.

    Attributes:
        mean: Of the residual by phase, shape (phases, 15); said where no flight had the phase.
        scale: Spread about it, shape (phases, 15).
        pieces: By phase, the residual of each training flight in it, shape (n_i, 15).
        seed: Of which piece is played, and from where.
    """

    mean: Array
    scale: Array
    pieces: tuple[tuple[Array, ...], ...]
    seed: int = 0

    def with_seed(self, seed: int) -> "Recording":
        """The same recordings, played from elsewhere."""
        return replace(self, seed=seed)

    def run(self, flight: ResidualFlight) -> Corrected:
        """Each stretch of one phase from a piece drawn again, begun again where it ends."""
        rng = np.random.default_rng([self.seed, zlib.crc32(flight.name.encode())])
        correction = self.mean[flight.phase]
        for a, b in flight.spans:
            edges = a + 1 + np.flatnonzero(np.diff(flight.phase[a:b]))
            for rows in np.split(np.arange(a, b), edges - a):
                pieces = self.pieces[flight.phase[rows[0]]]
                if pieces:
                    piece = pieces[int(rng.integers(len(pieces)))]
                    start = int(rng.integers(len(piece)))
                    correction[rows] = piece[(start + np.arange(len(rows))) % len(piece)]
        n = len(flight.t_s)
        return Corrected(
            correction, self.scale[flight.phase], np.full(n, np.nan), np.ones(n, dtype=np.bool_)
        )


def fit_recording(train: Sequence[ResidualFlight]) -> Recording:
    """Cut training flights into phases."""
    mean = phase_means(train)
    scale = np.sqrt(by_phase(train, [(f.residual - mean[f.phase]) ** 2 for f in train]))
    pieces: list[list[Array]] = [[] for _ in range(N_PHASES)]
    for flight in train:
        rows = np.concatenate([np.arange(a, b) for a, b in flight.spans])
        residual = np.where(np.isfinite(flight.residual), flight.residual, mean[flight.phase])[rows]
        for p in range(N_PHASES):
            part = residual[flight.phase[rows] == p]
            if len(part):
                pieces[p].append(part)
    return Recording(mean, scale, tuple(tuple(p) for p in pieces))
