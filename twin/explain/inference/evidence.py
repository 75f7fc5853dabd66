"""Log evidence of a candidate model: noise levels integrated out, MAP estimate, Laplace
approximation.

    r_cf = S_cf (theta - now + delta_f) + e_cf,    e_cf: see `noise`

Level and spectrum of the noise are part of the candidate model: an unexplained channel is noisy,
which is no evidence against the explanation of another channel. One factor tempers all bands of a
channel (a coarsened posterior: Miller & Dunson, J. Am. Stat. Assoc. 114, 2019), a = 1 / (1 + n /
(N0 F)): in closed loop the log spectrum of d / (1 + KGC), with equal weight of all bands, does not
depend on the model of G, so that disturbances alone contain no information on it; that is the
prediction-error method with free noise (Ljung, System Identification, sec. 13.4).

The variance of a constant is that of its channel's unexplained constant: between days by trim,
levelling, temperature, and by disturbances. kappa scales all day-to-day variation, and this
variance, and is a number of the candidate model, too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import lsq_linear
from scipy.special import log_ndtr

from ...representation import ShortRepr
from ...residuals.channels import Array
from .instruments import InstrumentNoise
from .noise import BandNoise
from .priors import Bounds, Priors
from .spectrum import Rows, Spectrum

STEPS, HALVINGS = 15, 5
"""Maximum number of steps to the optimum, and of halvings of a step."""
GYRO_S = 0.005
"""Usual age of the gyroscope, s, against which ages are told: a sample at 200 Hz."""
SETTLED = 0.02
"""Gain of a step, nats, below which the optimum is reached."""
PIVOTS = 12
"""Maximum number of exchanges of the active constraints."""
LEAST_EIGENVALUE = 1e-12
"""Smallest eigenvalue of a curvature whose diagonal is one: sums over 1e4 samples have about this
rounding error."""


@dataclass(frozen=True, slots=True)
class MapEstimate(ShortRepr):
    """MAP estimate of one candidate model at this linearisation point.

    Attributes:
        evidence: Log evidence, up to a constant that all candidate models share.
        kappa: Factor on the standard deviation of day-to-day variation.
        x: Changes of all numbers, then day-to-day deviations of each flight, shape (k + flights
            d,).
        free: Indices in `x` that could change.
        curvature: Curvature of the negative log density by these.
    """

    evidence: float
    kappa: float
    x: Array
    free: NDArray[np.intp]
    curvature: "Factored"

    @property
    def covariance(self) -> Array:
        """Covariance of the free entries, shape (m, m)."""
        return self.curvature.inverse()

    def deviations(self) -> Array:
        """Posterior standard deviation of each entry of `x`; 0 where it is fixed."""
        sd = np.zeros(len(self.x))
        sd[self.free] = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return sd

    def ridge(self, entry: int, held: Sequence[int]) -> float:
        """Posterior standard deviation of one entry of `x` over that with some others fixed."""
        place = {int(i): k for k, i in enumerate(self.free)}
        at = [place[i] for i in (entry, *held) if i in place]
        if entry not in place or len(at) == 1:
            return 1.0
        c = self.covariance[np.ix_(at, at)]
        return float(np.sqrt(c[0, 0] * np.linalg.inv(c)[0, 0]))

    def variance(self, row: Array) -> float:
        """Variance of a weighted sum of the first entries of `x`; weights of shape (n,)."""
        weights = np.zeros(len(self.x))
        weights[: len(row)] = row
        return float(weights[self.free] @ self.covariance @ weights[self.free])


TAIL_DEGREES = 3.0
"""Degrees of freedom of the Student prior of an effect's numbers: the fewest with finite
variance."""


def tail_weights(away: Array, deviation: Array) -> Array:
    """Factor on the precision of a Student prior at a difference from its mean: (nu + 1) / (nu +
    z^2), z = away / deviation (Lange, Little & Taylor, J. Am. Stat. Assoc. 84, 1989); 1 where the
    prior is normal: its `deviation` is 0."""
    tailed = deviation > 0
    z = np.divide(away, deviation, where=tailed, out=np.ones(len(away)))
    return np.where(tailed, (TAIL_DEGREES + 1) / (TAIL_DEGREES + z**2), 1.0)


@dataclass(frozen=True, slots=True)
class _Prior:
    """Prior of the free entries of `MapEstimate.x` for one candidate model.

    Numbers of effects have a Student distribution, as a scale mixture of normal ones, see
    `tail_weights`.

    Attributes:
        free: Indices in `x`, shape (m,).
        mean: Prior means, shape (m,).
        precision: Precision at the mean, with weights of one, shape (m, m).
        log_determinant: Log determinant of `precision`.
        deviation: Standard deviation of the entries with a Student distribution, 0 for others,
            shape (m,).
        odds: Log prior odds of the candidate model.
    """

    free: NDArray[np.intp]
    mean: Array
    precision: Array
    log_determinant: float
    deviation: Array
    odds: float

    def precision_at(self, x: Array, most: float = np.inf) -> Array:
        """Precision with the weights of the scales, at most so large; with 1, what only the prior
        knows has its deviation."""
        root = np.sqrt(np.minimum(tail_weights(x - self.mean, self.deviation), most))
        return np.asarray(self.precision * np.outer(root, root))

    def log_density(self, x: Array) -> float:
        """Log prior density, without the contribution of the determinant of `precision`."""
        away = x - self.mean
        weight = tail_weights(away, self.deviation)
        scaled = np.sqrt(weight) * away
        w, nu = weight[self.deviation > 0], TAIL_DEGREES
        at_mean = math.lgamma((nu + 1) / 2) - math.lgamma(nu / 2) + 0.5 * math.log(2 / nu)
        tail = at_mean - (nu + 1) / 2 * np.log((nu + 1) / (nu * w)) + (nu + 1 - nu * w) / 2
        return float(tail.sum() - 0.5 * scaled @ self.precision @ scaled)


class LaplaceEvidence:
    """Log evidence of all candidate models at one linearisation point."""

    def __init__(
        self, spectrum: Spectrum, noise: BandNoise | InstrumentNoise, priors: Priors, bounds: Bounds
    ) -> None:
        self.spectrum, self.priors, self._bounds = spectrum, priors, bounds
        k, f, d = len(priors.now), len(spectrum.days), len(spectrum.day_columns)
        self._k, self._f, self._d = k, f, d
        self._columns = {e: priors.of([e]) for e in priors.causes}
        self._sum(noise)
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
        """Linearisation point, as `MapEstimate.x`."""
        return np.concatenate([self.spectrum.theta, self.spectrum.days.ravel()])

    def _sum(self, noise: BandNoise | InstrumentNoise) -> None:
        """Compute products of residuals and slopes, and the likelihood of their sums."""
        size = 1 + self._k + self._f * self._d
        parts, terms = [], []
        for c, own in enumerate(self.spectrum.rows):
            rows, at, band, flight = self._side_by_side(own)
            found = noise.terms(c, rows, band, flight)
            i, j = np.triu_indices(len(at))
            parts.append((_place(at[i], at[j]), np.array([t.gram[i, j] for t in found])))
            terms += found
        self._products, first = np.zeros((_place(0, size), len(terms))), 0
        for place, values in parts:
            self._products[place, first : first + len(values)] = values.T
            first += len(values)
        self._likelihood = noise.likelihood(terms)
        numbers = 1 + np.arange(self._k)
        reach = self._products[_place(numbers, numbers)]
        self._reach: dict[str, set[int]] = {
            e: {terms[i].channel for i in np.flatnonzero(reach[self._columns[e]].any(axis=0))}
            for e in self.priors.causes
        }

    def _side_by_side(
        self, own: Sequence[Rows]
    ) -> tuple[Array, NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """A channel of all flights: residual with no number changed, slopes, and slopes of each
        day.

        Returns:
            Rows, shape (n, m); index of each column in the Gram matrix; band of each row, and its
            flight.
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
        flight = np.repeat(np.arange(len(own)), [len(r.band) for r in own])
        return np.concatenate(parts), at, np.concatenate([r.band for r in own]), flight

    def share_a_channel(self, a: str, b: str) -> bool:
        """Whether two effects influence a common channel."""
        return bool(self._reach[a] & self._reach[b])

    def silent(self, effect: str) -> bool:
        """Whether an effect influences no channel here."""
        return not self._reach[effect]

    # -- priors ------------------------------------------------------------------------------

    def _prior(self, on: Sequence[str], kappa: float) -> "_Prior":
        """Prior of a candidate model; `kappa`: factor on the standard deviation of day-to-day
        variation."""
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
        spread, known_to = Factored.of(inner), (kappa * self._day) ** -2.0
        precision = np.diag(np.concatenate([np.zeros(len(free)), known_to]))
        precision[: len(free), : len(free)] = spread.inverse()
        log_determinant = float(np.sum(np.log(known_to))) - spread.log_determinant
        deviation = np.concatenate([there[free] * b.tailed[free], np.zeros(len(days))])
        return _Prior(index, means, precision, log_determinant, deviation, b.log_odds(on))

    # -- one set -----------------------------------------------------------------------------

    def at(self, on: Sequence[str], kappa: float, x: Array | None = None) -> float:
        """Log density of residuals and numbers at the linearisation point."""
        prior = self._prior(on, kappa)
        y = (self.here if x is None else x)[prior.free]
        left = _Squares.of(self._products, prior.free).left(y)
        return self._likelihood.log(left, kappa) + prior.log_density(y) + prior.odds

    def best(self, on: Sequence[str], kappa: float, reach: Array | None = None) -> MapEstimate:
        """MAP estimate of a candidate model, and its evidence; `reach`: largest step of entries of
        `x`."""
        key = tuple(sorted(on)), kappa
        if reach is not None:
            return self._solve(key[0], kappa, self.here, STEPS, reach)
        if key not in self._known:
            self._known[key] = self._solve(key[0], kappa, self.here, STEPS)
        return self._known[key]

    def at_linearisation(self, on: Sequence[str], kappa: float) -> MapEstimate:
        """Evidence of a candidate model with its numbers fixed at the linearisation point."""
        return self._solve(tuple(sorted(on)), kappa, self.here, 0)

    def _solve(
        self, on: Sequence[str], kappa: float, start: Array, steps: int, reach: Array | None = None
    ) -> MapEstimate:
        prior = self._prior(on, kappa)
        free, mean = prior.free, prior.mean
        squares = _Squares.of(self._products, free)
        low, high = self._low[free], self._high[free]
        if reach is not None:
            near = np.clip(start[free], low, high)
            low, high = np.maximum(low, near - reach[free]), np.minimum(high, near + reach[free])

        def density(left: Array, x: Array) -> float:
            return self._likelihood.log(left, kappa) + prior.log_density(x)

        def curvature(left: Array, precision: Array) -> Array:
            return squares.matrix(self._likelihood.weights(left, kappa)[1]) + precision

        def pull(left: Array, x: Array, precision: Array) -> Array:
            """Right-hand side of the normal equations for the next step."""
            slope, weight = self._likelihood.weights(left, kappa)
            more = slope - weight
            turned = squares.mixed @ more - squares.matrix(more) @ x if np.any(more) else 0.0
            return np.asarray(squares.mixed @ weight + precision @ mean + turned)

        limited = any(e in self._limited for e in on)
        x = np.clip(start[free], low, high)
        left = squares.left(x)
        now = density(left, x)
        for _ in range(steps if len(free) else 0):
            precision = prior.precision_at(x)
            h = Factored.of(curvature(left, precision))
            y = best_inside(h, pull(left, x, precision), low, high)
            if limited:
                y = self._allowed(y, free, h)
            length, gained = 1.0, False
            for _ in range(HALVINGS):
                z = x + length * (y - x)
                new_left = squares.left(z)
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
        h = Factored.of(curvature(left, prior.precision_at(x, most=1.0)))
        laplace = 0.5 * (prior.log_determinant - h.log_determinant)
        full = np.zeros(len(self._low))
        full[free] = x
        late = self._never_early(on, full, free, h, kappa)
        return MapEstimate(float(now + laplace + prior.odds + late), kappa, full, free, h)

    def _never_early(
        self, on: Sequence[str], x: Array, free: NDArray[np.intp], h: "Factored", kappa: float
    ) -> float:
        """Log factor on the evidence as no signal with the clock of the others is early: for its
        age a in each flight, P(a > 0) of the posterior over that of the normal prior. Ages are
        those against the gyroscope, whose own is not known."""
        b, each, total = self.priors, np.arange(self._f), 0.0
        for i, own in ((i, own) for i, own in b.ages.items() if b.cause[i] not in on):
            rows = np.zeros((self._f, len(x)))
            rows[:, own] = 1.0
            shared, usual = float(np.sum(b.now[own]) + rows[0] @ x), kappa * b.day[i]
            day = self._k + np.searchsorted(self.spectrum.day_columns, i) + self._d * each
            rows[each, day] = 1.0
            sd = np.sqrt(np.sum(rows[:, free].T * h.solve(rows[:, free].T), axis=0) + GYRO_S**2)
            late = log_ndtr((shared + x[day]) / sd) - log_ndtr(max(shared, 0.0) / usual)
            apart = b.odds[b.cause[i]]  # of a clock of its own
            total += float(np.logaddexp(apart, late.sum()) - np.log1p(np.exp(apart)))
        return total

    def _allowed(self, x: Array, free: NDArray[np.intp], h: "Factored") -> Array:
        """Numbers projected into the physical limits."""
        own = free < self._k
        bounds = self._bounds.part(free[own].tolist())
        if np.all(bounds.rows @ x[own] >= bounds.least):
            return x
        y = x.copy()
        y[own] = bounds.inside(x[own], h.inverse()[np.ix_(own, own)])
        return y


_Index = TypeVar("_Index", int, NDArray[np.intp])


def _place(i: _Index, j: _Index) -> _Index:
    """Index of the product of columns i <= j where products are stored column by column."""
    return j * (j + 1) // 2 + i


@dataclass(frozen=True, slots=True)
class _Squares:
    """Sum of squares of each term as a quadratic form of some numbers.

    Attributes:
        power: Sum of squares at zero, shape (t,).
        mixed: Products of residual and slopes, shape (m, t).
        flat: Products of two slopes, shape (m (m + 1) / 2, t).
        i, j: Indices of these slopes, i <= j.
    """

    power: Array
    mixed: Array
    flat: Array
    i: NDArray[np.intp]
    j: NDArray[np.intp]

    @classmethod
    def of(cls, products: Array, free: NDArray[np.intp]) -> "_Squares":
        """Products of some numbers from those of all, in ascending order."""
        i, j = np.triu_indices(len(free))
        at = 1 + free
        mixed, flat = products[_place(np.zeros_like(at), at)], products[_place(at[i], at[j])]
        return cls(products[0], mixed, flat, i, j)

    def left(self, x: Array) -> Array:
        """Sum of squares of each term at some numbers, shape (t,)."""
        pairs = np.where(self.i == self.j, 1.0, 2.0) * x[self.i] * x[self.j]
        return np.maximum(self.power - 2 * x @ self.mixed + pairs @ self.flat, 0)

    def matrix(self, weight: Array) -> Array:
        """Weighted sum over terms of the products of slopes, shape (m, m)."""
        m = np.zeros((len(self.mixed), len(self.mixed)))
        m[self.i, self.j] = m[self.j, self.i] = self.flat @ weight
        return m


@dataclass(frozen=True, slots=True)
class Factored(ShortRepr):
    """Cholesky factor of a symmetric matrix whose rows and columns are scaled to a diagonal of one.

    Attributes:
        size: Scale of rows and columns, shape (m,).
        root: Upper Cholesky factor R of the scaled matrix R'R, shape (m, m).
    """

    size: Array
    root: Array

    @classmethod
    def of(cls, h: Array) -> "Factored":
        """Factor a positive definite matrix; if rounding makes it indefinite, eigenvalues of the
        scaled matrix are raised to `LEAST_EIGENVALUE`.
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
        """Solution x of h x = pull, shapes (m,) or (m, k)."""
        scaled = (self.size * pull.T).T
        return np.asarray((self.size * cho_solve((self.root, False), scaled).T).T)

    def inverse(self) -> Array:
        """Inverse matrix, shape (m, m)."""
        if not len(self.size):
            return np.zeros((0, 0))
        upper = dpotri(self.root)[0]  # zeros below its diagonal, as in the root
        both = upper + upper.T
        both[np.diag_indices_from(both)] *= 0.5
        return np.asarray(both * np.outer(self.size, self.size))

    @property
    def log_determinant(self) -> float:
        """Natural logarithm of the determinant."""
        return 2 * float(np.sum(np.log(np.diag(self.root))) - np.sum(np.log(self.size)))


def best_inside(h: Factored, pull: Array, low: Array, high: Array) -> Array:
    """Minimum of the quadratic x h x / 2 - pull x inside ranges.

    By block pivoting (Portugal, Judice & Vicente, Math. Comp. 63, 1994); where that does not
    converge, by bounded least squares.

    Args:
        h: Positive definite matrix, shape (m, m).
        pull: Linear term, shape (m,).
        low: Lower bounds, less than the upper ones, shape (m,).
        high: Upper bounds, shape (m,).
    """
    square, aim = h.root.T @ h.root, h.size * pull
    least, most = low / h.size, high / h.size
    at = h.solve(pull) / h.size
    below, above = at < least, at > most
    for _ in range(PIVOTS):
        if not np.any(below | above):
            break
        free = ~(below | above)
        at = np.where(below, least, np.where(above, most, 0.0))
        rest = aim[free] - square[np.ix_(free, ~free)] @ at[~free]
        at[free] = np.linalg.solve(square[np.ix_(free, free)], rest)
        slope = square @ at - aim
        held = below & (slope >= 0), above & (slope <= 0)
        now = held[0] | (free & (at < least)), held[1] | (free & (at > most))
        if np.array_equal(now[0], below) and np.array_equal(now[1], above):
            break
        below, above = now
    else:
        aim = solve_triangular(h.root, aim, trans="T")
        at = lsq_linear(h.root, aim, (least, most), method="bvls").x
    return np.asarray(np.clip(at * h.size, low, high), dtype=np.float64)
