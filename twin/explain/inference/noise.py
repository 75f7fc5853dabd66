"""Noise model: likelihood of the rows of a channel, given the residual under a candidate model.

    e_k ~ N(0, v_k I),    v_k ~ scaled-inverse-chi2(nu, s_k^2)
    log L = -1/2 sum_k (a n_k + nu) log(s_k^2 + a RSS_k / nu)
    -2 d log L / d (a RSS_k) = (a n_k + nu) / (nu s_k^2 + a RSS_k)

k: the rows of a channel and band, whose level v_k is integrated out: Student's t for a band. A
constant is a row of known variance, v = kappa^2 (d^2 + S / n), one sample per flight; S: power of
disturbances at 0 Hz, see `BandNoise.with_means_of`. a: weight of a row, as rows are not
independent. The variance of rounding to the sensor's least count is added to each RSS: noise-free
readings of a simulation have no better accuracy.

A noise model (`BandNoise`; `instruments.InstrumentNoise`) takes the rows of a channel, residual and
slopes, and forms sums of products of them, its terms. Its likelihood (`BandLikelihood`;
`instruments.InstrumentLikelihood`) takes the resulting sums of squares at some numbers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...physics.sensors.table import BODY, Sensor, sensor_of
from ...representation import ShortRepr
from ...residuals.channels import CHANNEL_HZ, GRID_HZ, Array
from ...vehicle import GRAVITY_M_S2, Vehicle
from ..settings import DEFAULT, EvidenceSettings
from .spectrum import BANDS_HZ, Spectrum


@dataclass(frozen=True, slots=True)
class Term(ShortRepr):
    """Sums over rows that share a noise level.

    Attributes:
        channel: Index of the channel.
        gram: Weighted products of residual and slopes, residual first, shape (m, m).
        count: Effective number of samples.
        floor: Prior variance; for a constant, its variance.
        constant: Whether the variance is known.
    """

    channel: int
    gram: Array
    count: float
    floor: float
    constant: bool


@dataclass(frozen=True, slots=True)
class BandNoise(ShortRepr):
    """One noise level per channel and band, shared by all flights.

    Attributes:
        floor: Prior variance by channel and band; for a constant, its variance at kappa = 1.
        own: Weight a of the rows of each channel, at most 1.
        rounding: Rounding variance of a row, by channel and band.
        level: Degrees of freedom of the prior variance.
        days: Variance between days of the constant of each channel at kappa = 1.
    """

    floor: Mapping[tuple[int, int], float]
    own: Array
    rounding: Mapping[tuple[int, int], float]
    level: float = DEFAULT.inference.evidence.level
    days: Sequence[float] = ()

    @classmethod
    def of(
        cls,
        rest: Spectrum,
        constants: Sequence[float],
        settings: EvidenceSettings = DEFAULT.inference.evidence,
    ) -> "BandNoise":
        """Noise model from the residuals of the nominal model.

        Args:
            rest: Spectrum of the nominal model's residuals.
            constants: Between-flight standard deviation of the constant of each channel.
            settings: Accuracy of laws, and information in a flight.
        """
        power, flights = rest.power(), len(rest.rows[0])
        floor, own = {}, np.ones(len(rest.channels))
        rounding: dict[tuple[int, int], float] = {}
        for c, (name, constant) in enumerate(zip(rest.channels, constants, strict=True)):
            least = rounding_variance(name)
            rounding |= {(c, b): float(least[b]) for b in range(1, len(BANDS_HZ))}
            moving = [v for (k, b), v in power.items() if k == c and b]
            n = sum(count for _, count in moving)
            mean = sum(p for p, _ in moving) / max(n, 1)
            own[c] = 1 / (1 + n / (settings.samples * flights))
            floor[c, 0] = constant**2
            for b in range(1, len(BANDS_HZ)):
                if (c, b) in power:
                    p, count = power[c, b]
                    floor[c, b] = settings.rough**2 * max(p / count, 1e-3 * mean) + least[b]
        return cls(floor, own, rounding, settings.level, [d**2 for d in constants])

    def with_means_of(self, left: Spectrum) -> "BandNoise":
        """The noise model with the mean of a flight as uncertain as disturbances leave it: their
        power at 0 Hz over the number of samples. They are taken as of first order, as gusts are (H.
        L. Dryden), S(f) = S(0) / (1 + (f / corner)^2), with the powers of the two slowest bands."""
        edges, power, means = BANDS_HZ[:3, None], left.power(), {}
        share = CORNERS_HZ * np.diff(np.arctan(edges / CORNERS_HZ), axis=0) / np.diff(edges, axis=0)
        for c, own in enumerate(left.rows):
            (slow, n), (fast, m) = (power.get((c, b), (0.0, 1)) for b in (1, 2))
            samples = (n + m) * CHANNEL_HZ / 2 / BANDS_HZ[2] / len(own)  # of a flight
            known = np.interp(fast / m / max(slow / n, 1e-300), share[1] / share[0], share[0])
            means[c, 0] = self.days[c] + float(slow / n / known / samples)
        return replace(self, floor={**self.floor, **means})

    def terms(
        self, channel: int, rows: Array, band: NDArray[np.intp], flight: NDArray[np.intp]
    ) -> list[Term]:
        """Sums of products of the rows of a channel.

        Args:
            channel: Index of the channel.
            rows: Residual, then slopes, shape (n, m).
            band: Band of each row, shape (n,); 0: a constant; negative: the row is ignored.
            flight: Flight of each row, shape (n,).
        """
        found = []
        for b in np.unique(band[band >= 0]).tolist():
            inside = rows[band == b]
            weight = 1.0 if b == 0 else float(self.own[channel])
            n = len(np.unique(flight[band == b])) if b == 0 else len(inside)
            gram = weight * (inside.T @ inside)
            gram[0, 0] += n * weight * self.rounding.get((channel, b), 0.0)
            found.append(Term(channel, gram, n * weight, self.floor[channel, b], b == 0))
        return found

    def likelihood(self, terms: Sequence[Term]) -> "BandLikelihood":
        """Likelihood of terms of this noise model."""
        return BandLikelihood(
            np.array([t.count for t in terms]),
            np.array([t.floor for t in terms]),
            np.array([t.constant for t in terms], dtype=np.bool_),
            self.level,
        )


@dataclass(frozen=True, slots=True)
class BandLikelihood(ShortRepr):
    """Likelihood of terms whose levels are integrated out one by one.

    Attributes:
        count: Effective number of samples of each term, shape (t,).
        floor: Prior variance of each term, shape (t,).
        constant: Whether each term is a constant, shape (t,).
        level: Degrees of freedom, as of `BandNoise`.
    """

    count: Array
    floor: Array
    constant: NDArray[np.bool_]
    level: float

    def log(self, rss: Array, kappa: float = 1.0) -> float:
        """Log likelihood, up to a constant.

        Args:
            rss: Sum of squares of each term at some numbers, shape (t,).
            kappa: Factor on the standard deviation of constants.
        """
        given, free, nu = self.constant, ~self.constant, self.level
        s2 = kappa**2 * self.floor[given]
        known = self.count[given] * np.log(s2) + rss[given] / s2
        unknown = (self.count[free] + nu) * np.log(self.floor[free] + rss[free] / nu)
        return float(-0.5 * (known.sum() + unknown.sum()))

    def weights(self, rss: Array, kappa: float = 1.0) -> tuple[Array, Array]:
        """Gradient of -2 log L by each sum of squares, and the weight of each Gram matrix in the
        Gauss-Newton curvature, not negative; shapes (t,). The same array where they are equal.
        """
        nu = self.level
        unknown = (self.count + nu) / (nu * self.floor + rss)
        both = np.where(self.constant, 1 / (kappa**2 * self.floor), unknown)
        return both, both


# -- what is known of a channel beforehand --------------------------------------------------


CORNERS_HZ = np.geomspace(0.03, 3.0, 100)
"""Possible corner frequencies of a disturbance; below, it is a constant of the flight. Made up."""
FAST_RAD_S = 0.4
"""Body rate of a fast turn, rad/s."""


def constants_of_days(
    channels: Sequence[str], vehicle: Vehicle, settings: EvidenceSettings
) -> list[float]:
    """Between-flight standard deviation of the constant of each channel, in its unit."""
    return [_constant(name, vehicle, settings) for name in channels]


def sensor_read(channel: str) -> Sensor:
    """The sensor of a channel: that itself, or the one that the pose replaces (`motion_`) or is
    compared with (`pose_`)."""
    sensor = sensor_of(_reading(channel))
    assert sensor is not None, channel
    return sensor


def _reading(channel: str) -> str:
    kind, _, read = channel.partition("_")
    if kind == "motion":
        return read.replace("rate_", "gyro_rate_")
    return read if kind == "pose" else channel


def _constant(name: str, vehicle: Vehicle, settings: EvidenceSettings) -> float:
    """Between-flight standard deviation of one channel's constant."""
    sensor, read = sensor_read(name), _reading(name)
    if name.startswith("pose_"):
        return settings.trim_pose * (FAST_RAD_S if sensor.rate else GRAVITY_M_S2)
    columns = sensor.channels if read in sensor.channels else sensor.columns
    axis = columns.index(read)
    size = sensor.size(vehicle)[axis]
    if sensor.group != BODY:
        return settings.trim_other * size
    if sensor.rate is None:
        return settings.trim_force * size
    return settings.trim_turn * size * (settings.trim_yaw if axis == 2 else 1.0)


def rounding_variance(channel: str) -> Array:
    """Variance of a row of the spectrum, by band, due to rounding to the sensor's least count.

    Rounding errors are white and uniform (Widrow, IRE Trans. Circuit Theory 3, 1956); in a channel
    that is a derivative, they are differentiated. Zero for the constant.

    Args:
        channel: Channel of a sensor, or of the pose that replaces it or is compared with it.
    """
    sensor = sensor_read(channel)
    variance = np.full(len(BANDS_HZ), sensor.least_count**2 / 12 * CHANNEL_HZ / GRID_HZ)
    if sensor.rate and not channel.startswith("pose_"):
        low, high = BANDS_HZ[:-1], BANDS_HZ[1:]
        variance[1:] *= (2 * np.pi) ** 2 * (low**2 + low * high + high**2) / 3
    variance[0] = 0.0
    return variance
