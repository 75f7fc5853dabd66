"""Changes of the balance of forces and moments since a calibration: a rotor, a load, either of
them, or nothing.

The mean of an angular acceleration, and of the specific force along the thrust, is independent of
the control loop: whatever the controller does, the moments of a flight average to zero. A change y
of these means since the calibration flights is compared with the change by each cause,

    y = S_h x_h + e,    x_h ~ sum_k w_k N(m_k, P_k),    e ~ N(0, f^2 D (1/n + 1/n0) + T + W)

S_h: slopes at the numbers of the calibration; x_h: numbers of the cause, small, medium or large; D:
prior day-to-day covariance, f its common factor, integrated over its posterior given the n0 flights
of the calibration; T: covariance between sessions, in which batteries and propellers are changed;
W: covariance by wind. n: flights.

Damaged propellers cause vibration: the power above the motion of the body, where an acceleration is
logged fast enough, is a fifth reading, which a load does not increase. Causes that these readings
do not separate are reported as "this or that".
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import brentq
from scipy.signal import welch
from scipy.special import logsumexp
from scipy.stats import norm

from ..effects import EFFECTS
from ..logs.columns import ACC, ACC_NED
from ..representation import ShortRepr
from ..residuals.channels import Array
from ..vehicle import Vehicle
from .inference.detection import POWER_95, Detectable
from .inference.fit import INTERVAL
from .inference.spectrum import Flights
from .model.model import FlightModel, Model
from .model.numbers import numbers_of
from .stochastic.spectral import StochasticEffect, pieces_of, rate_of

NOTHING, ROTORS, LOAD, VIBRATION = "nothing", "rotor_efficiency_loss", "payload_cg", "vibration"
CAUSES = (ROTORS, LOAD, "mass_offset", "cog_offset", "inertia_error")
"""Effects that change the balance; the search for all other changes omits them."""
BALANCED = ("acc_z", "gyro_rate_x", "gyro_rate_y", "gyro_rate_z")
"""Channels whose means are the balance; for a flight without an IMU, those of its pose."""
DAY = np.array([0.015, 0.003, 0.003, 0.02])
"""Between-flight standard deviation within one session: thrust over the weight; moments about x and
y over weight times arm; about z over the reaction torque of all rotors. Chosen on CrazyPAD's E9."""
SESSION = np.array([0.03, 0.002, 0.002, 0.07])
"""The same between sessions, in which propellers are changed. Chosen on CrazyPAD's E9."""
FACTORS = 2.0 ** np.arange(-3.0, 3.25, 0.5)
"""Grid of f, the factor on the days of an aircraft, log-normal with standard deviation 1."""
SIZES = ((0.04, 0.02, 0.3), (0.1, 0.05, 0.3), (0.25, 0.12, 0.3), (0.6, 0.3, 0.1))
"""Mean, standard deviation and probability of a thrust loss over the rotor's thrust, and of a load
over the aircraft's mass: a nick, a cut, a stump, and one that few aircraft can fly with."""
LOG_ODDS = -1.0
"""Prior log odds of one cause, a single rotor or a load, against nothing: all changes together are
as probable as none."""
SECOND_ROTOR = -1.0
"""Log odds of a second damaged rotor, given the first. Chosen on CrazyPAD's E9."""
REACH = 0.5
"""Standard deviation of a load's position along each axis, in arms, where it is at no hub."""
SHAKES_ABOVE_HZ = 12.0
"""Frequency, Hz, above which accelerations are vibration: attitude loops end at 5 to 10 Hz."""
SHAKEN_LEAST_HZ = 40.0
"""Least sample rate of an acceleration, Hz, for the estimate of vibration."""
ALONE = 0.95
"""Probability, given a change, from which on a rotor, or a load, is named alone. Chosen on
CrazyPAD's E9."""
ROPE = -0.7
"""Log odds of a slung load, given a load: made up."""
SUSPECT = 0.1
"""Probability from which on a set of rotors is listed among those one of which is damaged."""
STEADY_SD, SHAKEN, SHAKEN_SD, SHAKES = 0.3, 0.7, 0.6, 0.4
"""Change of the log amplitude of vibration: between-flight standard deviation; mean and standard
deviation for a damaged propeller that vibrates, and the share of those that do. Chosen on
CrazyPAD's E9."""


@dataclass(frozen=True, slots=True)
class Trim(ShortRepr):
    """Means of the balance's channels in some flights, and their vibration.

    Attributes:
        channels: Names of the available channels of thrust and of moments about x, y, z.
        means: Mean residual of each flight, in the units of the channels, shape (n, channels).
        slopes: Slopes of the means by the numbers of `CAUSES` and of the wind, shape (channels, k).
        numbers: Name "effect.number" of each column.
        vibration: Log amplitude above `SHAKES_ABOVE_HZ`, of each flight that contains it.
    """

    channels: tuple[str, ...]
    means: Array
    slopes: Array
    numbers: tuple[str, ...]
    vibration: Array

    def by_name(self) -> tuple[dict[str, float], dict[str, float]]:
        """Mean over the flights and sample standard deviation between them, by channel and
        `VIBRATION`."""
        every = {c: v for c, v in zip(self.channels, self.means.T, strict=True)}
        every |= {VIBRATION: self.vibration} if len(self.vibration) else {}
        spread = {c: float(np.std(v, ddof=1)) for c, v in every.items() if len(v) > 1}
        return {c: float(np.mean(v)) for c, v in every.items()}, spread


def channels_of_balance(names: Collection[str]) -> tuple[str, ...] | None:
    """Channels of thrust and of the moments about x, y, z in a flight, as far as it has them; None
    where that about x or y is missing, without which no position can be estimated."""
    either = (c if c in names else f"motion_{c.replace('gyro_', '')}" for c in BALANCED)
    found = tuple(c for c in either if c in names)
    return found if {1, 2} <= {*rows_of_balance(found)} else None


def rows_of_balance(channels: Sequence[str]) -> list[int]:
    """Indices of some channels among thrust and the moments about x, y, z."""
    return [0 if "acc" in c else 1 + "xyz".index(c[-1]) for c in channels]


def trim_of(
    model: Model, values: Mapping[str, float] | None = None, slopes: bool = True
) -> Trim | None:
    """Balance of a model's flights, without day-to-day deviations; None where they do not contain
    it.

    Args:
        model: Flights with the calibrated vehicle.
        values: Numbers that differ from the vehicle's, "effect.number" -> value.
        slopes: Whether slopes are computed.
    """
    wanted = (*CAUSES, "steady_wind")
    columns = [
        i for i, n in enumerate(model.numbers) if slopes and n.effect in wanted and not n.shape
    ]
    flights = model.channels(columns, values or {})
    names = [c.name for c in flights[0]]
    known = model.vehicle.calibration
    before = known.means if slopes and known is not None and known.means else names
    channels = channels_of_balance([c for c in names if c in before])
    if channels is None:
        return None
    own = [[f[names.index(c)] for c in channels] for f in flights]
    means = np.array([[c.residual.mean() for c in f] for f in own])
    by_number = np.mean([[c.slopes.mean(axis=0) for c in f] for f in own], axis=0)
    if rows_of_balance(channels[:1]) == [0]:
        by_number[:, [model.numbers[i].effect == LOAD for i in columns]] *= _carried(own)
    shaken = [v for f in model.flights if (v := vibration_of(f)) is not None]
    return Trim(
        channels, means, by_number, tuple(model.numbers[i].full for i in columns), np.array(shaken)
    )


def _carried(flights: Flights) -> float:
    """Measured over predicted specific force along the thrust, M / (M + m) for an aircraft that
    carries m: slopes of T / (M + m) by m at m = 0 times this ratio give m exactly."""
    measured, left = (
        sum(float(np.sum(v)) for v in values)
        for values in ([f[0].measured for f in flights], [f[0].residual for f in flights])
    )
    return measured / (measured - left)


def vibration_of(flight: FlightModel) -> float | None:
    """Log rms of the acceleration above the motion of the body, m/s^2, over all axes; None where
    none is logged fast enough."""
    for columns in (ACC, ACC_NED):
        pieces = pieces_of(flight, columns, 0.5)
        rate = rate_of(pieces)
        if rate < SHAKEN_LEAST_HZ:
            continue
        power, weight = 0.0, 0
        for p in pieces:
            f, density = welch(p.values, rate, nperseg=min(len(p.t_s), 128), axis=0)
            inside = density[f >= SHAKES_ABOVE_HZ]
            power += len(p.t_s) * float(np.sum(inside) * (f[1] - f[0]))
            weight += len(p.t_s)
        if power > 0:
            return 0.5 * math.log(power / weight)
    return None


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Hypothesis on the cause of a change.

    Attributes:
        cause: Effect, or `NOTHING`.
        rotors: Numbers of the affected rotors, from 1, for `ROTORS`.
        probability: Posterior probability among all hypotheses.
        values: Posterior mean of the change, by "effect.number".
        deviations: Posterior standard deviations.
    """

    cause: str
    rotors: tuple[int, ...]
    probability: float
    values: Mapping[str, float]
    deviations: Mapping[str, float]

    @property
    def clear(self) -> bool:
        """Whether the 95 % interval of one of its numbers excludes no change; true without
        numbers."""
        pairs = [(v, self.deviations[n]) for n, v in self.values.items()]
        return not pairs or any(abs(v) > INTERVAL * sd for v, sd in pairs)


@dataclass(frozen=True, slots=True)
class Balance(ShortRepr):
    """Change of the balance: posterior over hypotheses.

    Attributes:
        hypotheses: All hypotheses, the most probable first.
        detectable: Smallest change by each cause that would have been noticed, with 95 % power.
        more: Relative increase of thrust of each rotor, from 1, since the calibration, by the
            change of the means alone.
        sure: Probability from which on a cause is named.
        hanging: Slung load, with its probability given a load, by its swing; None: not evaluated.
    """

    hypotheses: tuple[Hypothesis, ...]
    detectable: Mapping[str, Detectable]
    more: tuple[float, ...]
    sure: float
    hanging: Hypothesis | None = None

    def probability_of(self, cause: str) -> float:
        """Probability of a cause, for any rotors."""
        return sum(h.probability for h in self.hypotheses if h.cause == cause)

    def best(self, cause: str) -> Hypothesis:
        """The most probable hypothesis of a cause."""
        return next(h for h in self.hypotheses if h.cause == cause)

    @property
    def damaged(self) -> float:
        """Probability of damaged propellers: loss of thrust, or vibration."""
        return self.probability_of(ROTORS) + self.probability_of(VIBRATION)

    def lost_by(self, rotor: int) -> float:
        """Probability that a rotor, from 1, has lost thrust, alone or with another."""
        return sum(h.probability for h in self.hypotheses if rotor in h.rotors)

    @property
    def changed(self) -> float:
        """Probability that something has changed."""
        return self.damaged + self.probability_of(LOAD)

    @property
    def named(self) -> Hypothesis | None:
        """The certain cause, with a number that excludes no change; None: there is none."""
        alone = self._alone
        if alone is not None and alone.cause == LOAD:
            alone = None if len(ways := self._ways(alone)) > 1 else ways[0]
        return alone if alone is not None and alone.clear else None

    def _ways(self, load: Hypothesis) -> tuple[Hypothesis, ...]:
        """Plausible forms of a load, fixed or slung, the more probable first."""
        if self.hanging is None:
            return (load,)
        p = self.hanging.probability
        ways = [(p, self.hanging), (1 - p, load)]
        possible = [replace(h, probability=p * load.probability) for p, h in ways if p > 1 - ALONE]
        return tuple(sorted(possible, key=lambda h: -h.probability))

    def _parted(self, chance: float) -> bool:
        """Whether a cause of some probability is certain, and every other cause of the change is
        not."""
        return chance >= max(self.sure, ALONE * self.changed)

    @property
    def _alone(self) -> Hypothesis | None:
        """The cause without alternative; None: there is none. Damage is that of the rotors that
        have certainly lost thrust, each with its total probability."""
        if self._parted(self.damaged):
            sure = [i + 1 for i in range(len(self.more)) if self.lost_by(i + 1) >= self.sure]
            damage = [h for h in self.hypotheses if h.rotors and set(h.rotors) == set(sure)]
            return replace(damage[0], probability=min(map(self.lost_by, sure))) if damage else None
        return self.best(LOAD) if self._parted(self.probability_of(LOAD)) else None

    @property
    def one_of(self) -> tuple[Hypothesis, ...]:
        """Causes that cannot be separated, the most probable first: a rotor and a load, a load
        fixed or slung, sets of damaged propellers, each with the probability of exactly that set;
        empty: another result is reported."""
        alone = self._alone
        if alone is not None and alone.cause == LOAD and len(ways := self._ways(alone)) > 1:
            return ways
        if alone is not None or self.changed < self.sure:
            return ()
        if not self._parted(self.damaged):
            rotors = replace(self.best(ROTORS), probability=self.damaged)
            return rotors, replace(self.best(LOAD), probability=self.probability_of(LOAD))
        damage = [h for h in self.hypotheses if h.cause in (ROTORS, VIBRATION)]
        return tuple(h for h in damage if h.probability >= SUSPECT) or (damage[0],)

    @property
    def nothing(self) -> float:
        """Probability that nothing has changed; from `sure` on it is the result."""
        return self.probability_of(NOTHING)


@dataclass(frozen=True, slots=True)
class Normal:
    """Calibration flights, and the aircraft.

    Attributes:
        flights: Number of flights.
        means: Means by channel of the balance, and of `VIBRATION`.
        scatter: Sample standard deviation of these between the flights.
        mass_kg: Mass of the aircraft, kg; 1 where masses are relative to it.
        arm_m: Longest arm of the aircraft, m; 1 where lengths are relative to it.
        hubs_m: Positions of the rotors, in the unit of the arm, shape (n, 3).
        disturbed: Covariance of other influences on the means, shape (channels, channels).
    """

    flights: int
    means: Mapping[str, float]
    scatter: Mapping[str, float]
    mass_kg: float
    arm_m: float
    hubs_m: Array
    disturbed: Array

    @classmethod
    def of(cls, trim: Trim, vehicle: Vehicle, indoors: bool) -> "Normal":
        """The flights of a calibration; indoors there is no wind."""
        known = vehicle.calibration
        assert known is not None
        return cls(
            max(len(known.flights), 1),
            known.means,
            known.scatter,
            vehicle.mass_kg,
            vehicle.arm_m,
            vehicle.rotors.position_m,
            _blown(trim, indoors),
        )


def _blown(trim: Trim, indoors: bool) -> Array:
    """Covariance of the means by the change of a steady wind."""
    wind = EFFECTS["steady_wind"].change
    assert wind is not None
    blown = np.zeros((len(trim.channels), len(trim.channels)))
    for i, name in enumerate(trim.numbers):
        if name.startswith("steady_wind."):
            sd = wind.of(name.partition(".")[2], indoors).sd
            blown += sd**2 * np.outer(trim.slopes[:, i], trim.slopes[:, i])
    return blown


def balance_of(trim: Trim, normal: Normal, sure: float) -> Balance:
    """Posterior on the change between calibration flights and others."""
    before = np.array([normal.means.get(c, 0.0) for c in trim.channels])
    made = _Competition(trim, normal)
    shaken = None
    if VIBRATION in normal.means and len(trim.vibration):
        shaken = float(np.mean(trim.vibration)) - normal.means[VIBRATION]
    change = trim.means.mean(axis=0) - before
    weighed = made.weigh(change, shaken)
    return Balance(
        tuple(sorted(weighed, key=lambda h: -h.probability)),
        {cause: made.smallest(cause, sure) for cause in (ROTORS, LOAD)},
        made.more(change),
        sure,
    )


Key = tuple[str, tuple[int, ...]]
"""A cause, and the affected rotors, from 1."""
Part = tuple[float, Array, Array]
"""A size class of a cause: log prior, mean, (k,), and covariance of its k numbers, (k, k)."""


class _Competition:
    """All possible causes of a change of one aircraft's balance.

    Each of m size classes is a normal prior of all numbers of the trim, 0 where its cause has none,
    and is combined with each of f noises.
    """

    def __init__(self, trim: Trim, normal: Normal) -> None:
        self._slopes, self._names = trim.slopes, trim.numbers
        self._at = {n: i for i, n in enumerate(trim.numbers)}
        self._normal, self._rotors = normal, len(normal.hubs_m)
        self._rows = rows_of_balance(trim.channels)
        self._unit = self._units()
        causes = [*self._causes()]
        self._columns = {key: columns for key, columns, _ in causes}
        parts = [(k, columns, *p) for k, (_, columns, own) in enumerate(causes) for p in own]
        self._prior = np.zeros((len(parts), len(trim.numbers)))
        spread = np.zeros((*self._prior.shape, len(trim.numbers)))
        for row, square, (_, columns, _, mean, covariance) in zip(
            self._prior, spread, parts, strict=True
        ):
            row[[*columns]], square[np.ix_(columns, columns)] = mean, covariance
        weights, self._noises = self._noise(trim.channels, len(trim.means), normal.flights)
        self._likeliest = int(np.argmax(weights))
        carried = self._slopes @ spread
        total = (carried @ self._slopes.T)[:, None] + self._noises
        self._owner = np.array([k for k, *_ in parts])
        self._means = self._prior @ self._slopes.T
        self._roots = np.linalg.inv(np.linalg.cholesky(total))  # whitening, shape (m, f, c, c)
        determinants = np.log(np.diagonal(self._roots, axis1=2, axis2=3)).sum(axis=2)
        self._logs = np.array([p[2] for p in parts])[:, None] + weights + determinants
        precision = np.swapaxes(self._roots, 2, 3) @ self._roots
        self._gains = np.swapaxes(carried, 1, 2)[:, None] @ precision  # Kalman, (m, f, k, c)
        prior = np.diagonal(spread, axis1=1, axis2=2)[:, None]
        self._left = prior - np.einsum("mfkc,mck->mfk", self._gains, carried)

    def _units(self) -> Array:
        """Weight, weight times arm about x and y, and total reaction torque, in the units of the
        channels."""
        at, v = self._at, self._normal
        turn = v.mass_kg * v.arm_m
        sizes = (
            (v.mass_kg, [at[f"{LOAD}.mass_kg"]]),
            (turn, [at[f"{LOAD}.moment_y_kg_m"]]),
            (turn, [at[f"{LOAD}.moment_x_kg_m"]]),
            (1.0, self._losses),
        )
        found = []
        for k, row in enumerate(self._rows):
            size, columns = sizes[row]
            found.append(size * sum(abs(self._slopes[k, i]) for i in columns))
        return np.array(found)

    @property
    def _losses(self) -> tuple[int, ...]:
        """Column of each rotor's loss."""
        return tuple(self._at[f"{ROTORS}.loss_{i + 1}"] for i in range(self._rotors))

    def _noise(self, channels: Sequence[str], n: int, before: int) -> tuple[Array, Array]:
        """Log weight, shape (f,), and covariance of the noise of a change, shape (f, c, c), for
        each factor on days."""
        day, session = DAY[self._rows] * self._unit, SESSION[self._rows] * self._unit
        spread = np.array([self._normal.scatter.get(c, np.nan) for c in channels])
        seen = np.isfinite(spread) & (before > 1)
        logs = []
        for f in FACTORS:
            ratio = spread[seen] / (f * day[seen])
            logs.append(
                -0.5 * math.log(f) ** 2 - (before - 1) * float(np.sum(math.log(f) + 0.5 * ratio**2))
            )
        share, fixed = 1 / n + 1 / before, np.diag(session**2) + self._normal.disturbed
        noises = [np.diag((f * day) ** 2 * share) + fixed for f in FACTORS]
        return np.array(logs) - logsumexp(logs), np.array(noises)

    def _causes(self) -> Iterator[tuple[Key, tuple[int, ...], list[Part]]]:
        """Causes, columns of their numbers, and their size classes."""
        n = self._rotors
        yield (NOTHING, ()), (), [(0.0, np.zeros(0), np.zeros((0, 0)))]
        for count in (1, 2):
            odds = LOG_ODDS + (count - 1) * SECOND_ROTOR - math.log(math.comb(n, count))
            sizes = [
                (odds + math.log(p), np.full(count, m), s**2 * np.eye(count)) for m, s, p in SIZES
            ]
            for rotors in combinations(range(n), count):
                columns = tuple(self._losses[i] for i in rotors)
                yield (ROTORS, tuple(i + 1 for i in rotors)), columns, sizes
        names = ("mass_kg", *(f"moment_{a}_kg_m" for a in "xyz"))
        yield (LOAD, ()), tuple(self._at[f"{LOAD}.{name}"] for name in names), [*self._loads()]

    def _loads(self) -> Iterator[Part]:
        """A load in the centre, at a hub, or anywhere, with equal probability; at a hub half as
        heavy as a loss of the same share: one rotor carries a fraction of the weight."""
        v = self._normal
        for m, s, p in SIZES:
            odds = LOG_ODDS + math.log(p / 3)
            mass, sd, away = m * v.mass_kg, s * v.mass_kg, m * v.mass_kg * REACH * v.arm_m
            for spread in (0.0, away):
                deviations = np.array([sd, *[spread] * 3])
                yield odds, np.array([mass, 0, 0, 0]), np.diag(deviations**2)
            for x, y, _ in v.hubs_m:
                way = np.array([0.5, 0.5 * x, 0.5 * y, 0.0])
                yield odds - math.log(len(v.hubs_m)), mass * way, sd**2 * np.outer(way, way)

    def _log_evidence(self, change: Array) -> tuple[Array, Array]:
        """Log evidence of each cause, and of each size of it and noise, shape (m, f), up to a
        common constant."""
        white = np.einsum("mfij,mj->mfi", self._roots, change - self._means)
        each = self._logs - 0.5 * np.sum(white**2, axis=2)
        count = len(self._columns)
        return np.array([logsumexp(each[self._owner == k]) for k in range(count)]), each

    def weigh(self, change: Array, shaken: float | None = None) -> list[Hypothesis]:
        """Posterior of all causes, given the change of the means, shape (channels,), and of the log
        amplitude of vibration, where known."""
        evidence, each = self._log_evidence(change)
        made = [
            (key, log + _log_shaking(key[0], shaken), *self._numbers(change, k, columns, each))
            for k, ((key, columns), log) in enumerate(
                zip(self._columns.items(), evidence, strict=True)
            )
        ]
        if shaken is not None:
            log = float(evidence[0]) + LOG_ODDS + SECOND_ROTOR + _log_shaking(VIBRATION, shaken)
            made.append(((VIBRATION, ()), log, {}, {}))
        total = logsumexp([log for _, log, *_ in made])
        return [
            Hypothesis(*key, float(np.exp(log - total)), mean, sd) for key, log, mean, sd in made
        ]

    def _numbers(
        self, change: Array, k: int, columns: Sequence[int], each: Array
    ) -> tuple[dict[str, float], dict[str, float]]:
        """Posterior mean and standard deviation of the numbers of a cause, given the log evidence
        of each of its parts."""
        own = self._owner == k
        left = change - self._means[own]
        means = self._prior[own, None] + np.einsum("mfkc,mc->mfk", self._gains[own], left)
        share = np.exp(each[own] - logsumexp(each[own]))
        mean = np.einsum("mf,mfk->k", share, means)
        square = np.einsum("mf,mfk->k", share, self._left[own] + means**2)
        sd = np.sqrt(np.maximum(square - mean**2, 0.0))
        at_mean, at_sd = ({self._names[i]: float(v[i]) for i in columns} for v in (mean, sd))
        return at_mean, at_sd

    def smallest(self, cause: str, sure: float) -> Detectable:
        """The smallest change, at the least visible rotor or position (a hub or the centre of
        mass), that 95 of 100 flights would report as a change."""
        hubs, v = self._normal.hubs_m, self._normal
        if cause == ROTORS:
            ways = [self._slopes[:, i] for i in self._losses]
            name, unit, most = f"{ROTORS}.loss_1", "1", 1.0
        else:
            at = [self._at[f"{LOAD}.{n}"] for n in ("mass_kg", "moment_x_kg_m", "moment_y_kg_m")]
            places = [(0.0, 0.0), *hubs[:, :2].tolist()]
            ways = [self._slopes[:, at] @ np.array([1.0, x, y]) for x, y in places]
            name, unit, most = f"{LOAD}.mass_kg", "kg", v.mass_kg
        noise = self._noises[self._likeliest]

        def quiet(size: float, way: Array) -> float:
            """Log odds of no change at a noise-free one, over those where a change is reported."""
            logs = self._log_evidence(size * way)[0]
            return float(logs[0] - logsumexp(logs[1:])) - math.log((1 - sure) / sure)

        def least(way: Array) -> float:
            """Smallest change along one direction."""
            if quiet(most, way) > 0:
                return math.inf
            sd = 1 / math.sqrt(float(way @ np.linalg.solve(noise, way)))
            return float(brentq(quiet, 0.0, most, (way,), xtol=1e-3 * most)) + POWER_95 * sd

        value = max(least(way) for way in ways)
        return Detectable(name, value if value <= most else None, unit)

    def more(self, change: Array) -> tuple[float, ...]:
        """Relative increase of thrust of each rotor, by least squares in the means."""
        ways = self._slopes[:, self._losses]
        scaled = (ways / self._unit[:, None], change / self._unit)
        return tuple(np.linalg.lstsq(*scaled, rcond=None)[0].tolist())


def _log_shaking(cause: str, shaken: float | None) -> float:
    """Log density of a change of vibration under a cause; a decrease counts as no change."""
    if shaken is None:
        return 0.0
    rise = max(shaken, 0.0)
    still, shaking = norm.logpdf(rise, 0.0, STEADY_SD), norm.logpdf(rise, SHAKEN, SHAKEN_SD)
    if cause == VIBRATION:
        return float(shaking)
    if cause == ROTORS:
        return float(np.logaddexp(math.log(1 - SHAKES) + still, math.log(SHAKES) + shaking))
    return float(still)


# -- as a result --------------------------------------------------------------------------------


def changed_by(
    effect: str,
    change: Mapping[str, tuple[float, float]],
    probability: float,
    vehicle: Vehicle,
    channels: tuple[str, ...],
) -> StochasticEffect:
    """A change in the form of the zero-mean effects: "effect.number" -> change and its standard
    deviation."""
    before = {n.full: n.now for n in numbers_of([EFFECTS[effect]], vehicle)}
    values = {n: v + change.get(n, (0.0, 0.0))[0] for n, v in before.items()}
    intervals = {
        n: (values[n] - INTERVAL * sd, values[n] + INTERVAL * sd) for n, (_, sd) in change.items()
    }
    chance = min(probability, 1 - 1e-9)
    log_odds = math.log(chance / (1 - chance))
    return StochasticEffect(effect, log_odds, values, intervals, channels, 1.0, before)
