"""Log evidence of a set of effects: noise levels integrated out per channel and band, MAP numbers,
Laplace's approximation about them.

    r_cf = S_cf (theta - now + delta_f) + e_cf,     e_cf,k ~ N(0, v_ck I)
    v_ck ~ scaled-inverse-chi2(nu, s_ck^2);         v_c0 = (kappa d_c)^2, one sample per flight
    log p(r | theta) = -1/2 sum_ck (a_c n_ck + nu) log(s_ck^2 + a_c RSS_ck(theta) / nu)
    a_c = 1 / (1 + n_c / (N0 F))

Level and spectrum of the noise belong to the hypothesis: a channel that nothing explains yet is
noisy, and no reason against what explains another one. One factor a_c tempers all bands of a
channel (a coarsened posterior: Miller & Dunson, J. Am. Stat. Assoc. 114, 2019): in closed loop the
log spectrum of d / (1 + KGC), all bands counted alike, does not depend on the model of G, so that
disturbances alone carry no information on it; that is the prediction-error method with the noise
free (Ljung, System Identification, sec. 13.4).

d_c is the standard deviation between flights of a constant of channel c that no effect explains:
trim, levelling, temperature. kappa scales all day-to-day variation and is a number of the
hypothesis, too.

To each RSS the variance of rounding to the least count of the sensor is added: noise-free readings
of a simulation are known no better than that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import lsq_linear

from ...physics.sensors.table import BODY, Sensor, sensor_of
from ...representation import short_repr
from ...residuals.channels import CHANNEL_HZ, GRID_HZ
from ...vehicle import GRAVITY_M_S2, Vehicle
from ..settings import DEFAULT, EvidenceSettings
from .priors import Bounds, Priors
from .spectrum import BANDS_HZ, Rows, Spectrum

FAST_RAD_S = 0.4
"""Body rate of a brisk turn."""


def constants_of_days(
    channels: Sequence[str], vehicle: Vehicle, settings: EvidenceSettings
) -> list[float]:
    """Standard deviation of the constant of each channel between flights, in its unit."""
    return [_constant(name, vehicle, settings) for name in channels]


def sensor_read(channel: str) -> Sensor:
    """The sensor that a channel is of: that itself, or the one that the pose stands in for
    (`motion_`) or is compared with (`pose_`)."""
    sensor = sensor_of(_reading(channel))
    assert sensor is not None, channel
    return sensor


def _reading(channel: str) -> str:
    kind, _, read = channel.partition("_")
    if kind == "motion":
        return read.replace("rate_", "gyro_rate_")
    return read if kind == "pose" else channel


def _constant(name: str, vehicle: Vehicle, settings: EvidenceSettings) -> float:
    """Of one channel."""
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


Array = NDArray[np.float64]
STEPS, HALVINGS = 15, 5
"""Of the search for the best numbers: steps, of one step's length."""
SETTLED = 0.02
"""A step that gains less, in nats, is the last."""
LEAST_EIGENVALUE = 1e-12
"""Of a curvature whose diagonal is one: sums over 1e4 samples are rounded to about this."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What is known of the noise before a flight is looked at.

    Attributes:
        floor: Square of the level by channel and band, laws being inexact; of a constant, that of
            the days at kappa = 1.
        own: By channel, how much of its power rows count.
        rounding: By channel and band, variance of a row by rounding to the sensor's least count.
        silent: Channels and bands that do not vote.
    """

    floor: Mapping[tuple[int, int], float]
    own: Array
    rounding: Mapping[tuple[int, int], float]
    silent: frozenset[tuple[int, int]] = frozenset()

    __repr__ = short_repr

    @classmethod
    def of(
        cls,
        rest: Spectrum,
        constants: Sequence[float],
        settings: EvidenceSettings = DEFAULT.inference.evidence,
        silent: frozenset[tuple[int, int]] = frozenset(),
    ) -> "Noise":
        """From the residuals of the model as it stands.

        Args:
            rest: About the model as it stands.
            constants: Of each channel, the size of a constant that a day may bring.
            settings: How exact laws are, how much a flight tells.
            silent: Channels and bands that do not vote.
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
            for b in range(len(BANDS_HZ)):
                if b == 0:
                    floor[c, b] = constant**2
                elif (c, b) in power:
                    p, count = power[c, b]
                    floor[c, b] = settings.rough**2 * max(p / count, 1e-3 * mean) + least[b]
        return cls(floor, own, rounding, silent)


@dataclass(frozen=True, slots=True)
class MapEstimate:
    """A set of effects at its best in one linearisation.

    Attributes:
        evidence: Log of its probability, up to a constant that all sets share.
        kappa: By how much days differ more than is usual.
        x: Changes of all numbers, then of those of each flight's day, shape (k + flights d,).
        free: Positions in `x` that could move.
        covariance: Of these, shape (m, m).
    """

    evidence: float
    kappa: float
    x: Array
    free: NDArray[np.intp]
    covariance: Array

    __repr__ = short_repr

    def deviations(self) -> Array:
        """Posterior deviation of each entry of `x`; 0 where it could not move."""
        sd = np.zeros(len(self.x))
        sd[self.free] = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return sd


class LaplaceEvidence:
    """Sets of effects in one linearisation."""

    def __init__(
        self,
        spectrum: Spectrum,
        noise: Noise,
        priors: Priors,
        bounds: Bounds,
        settings: EvidenceSettings = DEFAULT.inference.evidence,
    ) -> None:
        """Sum up.

        Args:
            spectrum: Residuals and slopes.
            noise: What is known of the noise.
            priors: Priors.
            bounds: Of the numbers, as changes.
            settings: How much noise levels are known.
        """
        self.spectrum, self.priors, self._bounds = spectrum, priors, bounds
        self._noise, self._level = noise, settings.level
        k, f, d = len(priors.now), len(spectrum.days), len(spectrum.day_columns)
        self._k, self._f, self._d = k, f, d
        self._columns = {e: priors.of([e]) for e in priors.causes}
        self._sum()
        self._constant = np.array([b == 0 for _, b in self._labels])
        self._unsure = np.diag(priors.file) > 0
        days = priors.day[spectrum.day_columns]
        self._day = np.tile(days, f)
        self._low = np.concatenate([priors.low - priors.now, np.full(f * d, -np.inf)])
        self._high = np.concatenate([priors.high - priors.now, np.full(f * d, np.inf)])
        self._limited = {
            e for e, c in self._columns.items() if np.any(bounds.rows[:, c] if c.size else 0)
        }
        self._known: dict[tuple[tuple[str, ...], float], MapEstimate] = {}

    @property
    def here(self) -> Array:
        """Where the residuals were taken, as `MapEstimate.x`."""
        return np.concatenate([self.spectrum.theta, self.spectrum.days.ravel()])

    def _sum(self) -> None:
        """Gram matrix of residual and slopes by channel and band."""
        size = 1 + self._k + self._f * self._d
        grams, counts, floors, labels = [], [], [], []
        for c, own in enumerate(self.spectrum.rows):
            rows, at, band = self._side_by_side(own)
            corner = np.ix_(at, at)
            for b in np.unique(band):
                if (c, int(b)) in self._noise.silent:
                    continue
                inside = rows[band == b]
                weight = 1.0 if b == 0 else float(self._noise.own[c])
                n = sum(1 for r in own if len(r.band)) if b == 0 else len(inside)
                gram = np.zeros((size, size))
                gram[corner] = weight * (inside.T @ inside)
                gram[0, 0] += n * weight * self._noise.rounding.get((c, int(b)), 0.0)
                grams.append(gram)
                counts.append(n * weight)
                floors.append(self._noise.floor[c, int(b)])
                labels.append((c, int(b)))
        self._grams, self._labels = np.array(grams), labels
        self._n, self._floor = np.array(counts), np.array(floors)
        reach = np.einsum("bii->bi", self._grams)[:, 1 : 1 + self._k]
        self._reach: dict[str, set[int]] = {
            e: {labels[i][0] for i in np.flatnonzero(reach[:, self._columns[e]].any(axis=1))}
            for e in self.priors.causes
        }

    def _side_by_side(
        self, own: Sequence[Rows]
    ) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
        """A channel of all flights: residual with no number changed, slopes, those of each day.

        Returns:
            Rows, shape (n, m); position of each column in a gram matrix; band of each row.
        """
        spectrum = self.spectrum
        active = np.unique(np.concatenate([r.active for r in own]))
        place = {int(c): i for i, c in enumerate(spectrum.day_columns)}
        daily = [int(a) for a in active if int(a) in place]
        width, parts = 1 + len(active), []
        for f, r in enumerate(own):
            y = np.zeros((len(r.residual), width + self._f * len(daily)))
            y[:, 1 + np.searchsorted(active, r.active)] = r.slopes
            mine = y[:, 1 + np.searchsorted(active, daily)]
            first = width + f * len(daily)
            y[:, first : first + len(daily)] = mine
            days = spectrum.days[f, [place[a] for a in daily]]
            y[:, 0] = r.residual + y[:, 1:width] @ spectrum.theta[active] + mine @ days
            parts.append(y)
        days_at = [1 + self._k + f * self._d + place[a] for f in range(self._f) for a in daily]
        at = np.concatenate([[0], 1 + active, days_at]).astype(np.intp)
        return np.concatenate(parts), at, np.concatenate([r.band for r in own])

    def share_a_channel(self, a: str, b: str) -> bool:
        """Whether two effects act on one channel."""
        return bool(self._reach[a] & self._reach[b])

    def silent(self, effect: str) -> bool:
        """Whether no channel answers to an effect here."""
        return not self._reach[effect]

    # -- priors ------------------------------------------------------------------------------

    def _prior(
        self, on: Sequence[str], kappa: float
    ) -> tuple[NDArray[np.intp], Array, Array, float]:
        """Free entries of `x`, their means and precision matrix, and the log odds of the set."""
        b, k = self.priors, self._k
        there = np.zeros(k, dtype=np.bool_)
        for e in on:
            there[self._columns[e]] = True
        known = self._unsure & ~b.shape
        free = np.flatnonzero(there | known)
        inner = b.file[np.ix_(free, free)] * np.outer(known[free], known[free])
        inner[np.diag_indices(len(free))] = np.where(there[free], b.slab[free] ** 2, np.diag(inner))
        mean = np.where(there, b.mean - b.now, b.held)
        days = k + np.arange(self._f * self._d)
        index = np.concatenate([free, days]).astype(np.intp)
        means = np.concatenate([mean[free], np.zeros(len(days))])
        precision = np.diag(np.concatenate([np.zeros(len(free)), (kappa * self._day) ** -2.0]))
        precision[: len(free), : len(free)] = Factored.of(inner).inverse()
        return index, means, precision, float(sum(b.odds[e] for e in on))

    def _density(self, rss: Array, kappa: float) -> float:
        """Log likelihood, given sums of squares by channel and band."""
        given, free, nu = self._constant, ~self._constant, self._level
        s2 = kappa**2 * self._floor[given]
        known = self._n[given] * np.log(s2) + rss[given] / s2
        unknown = (self._n[free] + nu) * np.log(self._floor[free] + rss[free] / nu)
        return float(-0.5 * (known.sum() + unknown.sum()))

    def _weights(self, rss: Array, kappa: float) -> Array:
        """One over the noise level of each channel and band, given sums of squares."""
        nu = self._level
        unknown = (self._n + nu) / (nu * self._floor + rss)
        return np.where(self._constant, 1 / (kappa**2 * self._floor), unknown)

    # -- one set -----------------------------------------------------------------------------

    def at(self, on: Sequence[str], kappa: float, x: Array | None = None) -> float:
        """Log density of residuals and numbers where the residuals were taken."""
        x = self.here if x is None else x
        free, mean, precision, odds = self._prior(on, kappa)
        y = x[free]
        q, g = self._grams[:, 0, 1 + free], self._grams[:, 1 + free[:, None], 1 + free]
        rss = self._grams[:, 0, 0] - 2 * q @ y + np.einsum("bij,i,j->b", g, y, y, optimize=True)
        prior = -0.5 * (y - mean) @ precision @ (y - mean)
        return self._density(np.maximum(rss, 0), kappa) + float(prior) + odds

    def best(self, on: Sequence[str], kappa: float, reach: Array | None = None) -> MapEstimate:
        """The best numbers of a set, and its evidence.

        Args:
            on: Effects.
            kappa: By how much days differ more than is usual.
            reach: How far each entry of `x` may move at most; default: as far as it likes.
        """
        key = tuple(sorted(on)), kappa
        if reach is not None:
            return self._solve(key[0], kappa, self.here, STEPS, reach)
        if key not in self._known:
            self._known[key] = self._solve(key[0], kappa, self.here, STEPS)
        return self._known[key]

    def at_linearisation(self, on: Sequence[str], kappa: float) -> MapEstimate:
        """The evidence of a set with its numbers left where the residuals were taken."""
        return self._solve(tuple(sorted(on)), kappa, self.here, 0)

    def _solve(
        self,
        on: Sequence[str],
        kappa: float,
        start: Array,
        steps: int,
        reach: Array | None = None,
    ) -> MapEstimate:
        free, mean, precision, odds = self._prior(on, kappa)
        g = self._grams[:, 1 + free[:, None], 1 + free]
        q, power = self._grams[:, 0, 1 + free], self._grams[:, 0, 0]
        low, high = self._low[free], self._high[free]
        if reach is not None:
            near = np.clip(start[free], low, high)
            low, high = np.maximum(low, near - reach[free]), np.minimum(high, near + reach[free])
        flat = g.reshape(len(g), -1)
        m = len(free)

        def rss(x: Array) -> Array:
            bent = (flat @ np.outer(x, x).ravel()) if m else 0.0
            return np.maximum(power - 2 * q @ x + bent, 0)

        def density(left: Array, x: Array) -> float:
            return self._density(left, kappa) - float(0.5 * (x - mean) @ precision @ (x - mean))

        def curvature(left: Array) -> tuple[Array, Array]:
            weight = self._weights(left, kappa)
            return (weight @ flat).reshape(m, m) + precision, weight

        limited = any(e in self._limited for e in on)
        x = np.clip(start[free], low, high)
        left = rss(x)
        now = density(left, x)
        for _ in range(steps if m else 0):
            curved, weight = curvature(left)
            h = Factored.of(curved)
            y = best_inside(h, weight @ q + precision @ mean, low, high)
            if limited:
                y = self._allowed(y, free, h)
            length, gained = 1.0, False
            for _ in range(HALVINGS):
                z = x + length * (y - x)
                new_left = rss(z)
                new = density(new_left, z)
                if new >= now:
                    gained = True
                    break
                length *= 0.5
            if not gained:
                break
            done = new < now + SETTLED
            x, left, now = z, new_left, new
            if done:
                break
        h = Factored.of(curvature(left)[0])
        laplace = 0.5 * (Factored.of(precision).log_determinant - h.log_determinant)
        full = np.zeros(len(self._low))
        full[free] = x
        return MapEstimate(now + laplace + odds, kappa, full, free, h.inverse())

    def _allowed(self, x: Array, free: NDArray[np.intp], h: "Factored") -> Array:
        """Numbers with what nature rules out taken back."""
        own = free < self._k
        bounds = self._bounds.part(free[own].tolist())
        y = x.copy()
        y[own] = bounds.inside(x[own], h.inverse()[np.ix_(own, own)])
        return y


def rounding_variance(channel: str) -> Array:
    """Variance of a row of the spectrum, by band, of readings rounded to the sensor's least count.

    Rounding errors are white and uniform (Widrow, IRE Trans. Circuit Theory 3, 1956); of a channel
    that is a rate of change, they are differentiated. Zero for the constant.

    Args:
        channel: Of a sensor, or of the pose in its place or against it.
    """
    sensor = sensor_read(channel)
    variance = np.full(len(BANDS_HZ), sensor.least_count**2 / 12 * CHANNEL_HZ / GRID_HZ)
    if sensor.rate and not channel.startswith("pose_"):
        low, high = BANDS_HZ[:-1], BANDS_HZ[1:]
        variance[1:] *= (2 * np.pi) ** 2 * (low**2 + low * high + high**2) / 3
    variance[0] = 0.0
    return variance


@dataclass(frozen=True, slots=True)
class Factored:
    """Cholesky factor of a symmetric matrix whose rows and columns are scaled to a diagonal of one.

    Attributes:
        size: By which rows and columns are multiplied, shape (m,).
        root: Upper factor R of the scaled matrix R'R, shape (m, m).
    """

    size: Array
    root: Array

    @classmethod
    def of(cls, h: Array) -> "Factored":
        """Factor a positive definite matrix; one that is not, by rounding, with the eigenvalues of
        the scaled matrix raised to `LEAST_EIGENVALUE`.

        Args:
            h: Shape (m, m), its diagonal above zero.
        """
        size = 1 / np.sqrt(np.diag(h))
        scaled = h * np.outer(size, size)
        try:
            root = np.linalg.cholesky(scaled + LEAST_EIGENVALUE * np.eye(len(h))).T
        except np.linalg.LinAlgError:
            values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
            raised = np.sqrt(np.maximum(values, LEAST_EIGENVALUE * len(h)))
            root = np.linalg.qr(raised[:, None] * vectors.T).R
            root = np.sign(np.diag(root))[:, None] * root
        return cls(size, np.asarray(root, dtype=np.float64))

    def solve(self, pull: Array) -> Array:
        """x with h x = pull, shapes (m,) or (m, k)."""
        scaled = (self.size * pull.T).T
        return np.asarray((self.size * cho_solve((self.root, False), scaled).T).T)

    def inverse(self) -> Array:
        """Shape (m, m)."""
        return self.solve(np.eye(len(self.size)))

    @property
    def log_determinant(self) -> float:
        """Natural logarithm of the determinant."""
        return 2 * float(np.sum(np.log(np.diag(self.root))) - np.sum(np.log(self.size)))


def best_inside(h: Factored, pull: Array, low: Array, high: Array) -> Array:
    """Where a quadratic is best inside ranges: the least of x h x / 2 - pull x.

    Args:
        h: Positive definite, of shape (m, m).
        pull: Shape (m,).
        low: Lower ends, below the upper ones. Shape (m,).
        high: Upper ends. Shape (m,).
    """
    best = h.solve(pull)
    if np.all((best >= low) & (best <= high)):
        return best
    aim = solve_triangular(h.root, pull * h.size, trans="T")
    inside = lsq_linear(h.root, aim, (low / h.size, high / h.size), method="bvls").x
    return np.asarray(np.clip(inside * h.size, low, high), dtype=np.float64)
