"""Instrumental variables: setpoints, which are independent of the disturbances in the loop.

    y = G(theta) u + d,    u = -C y + r

A controller responds to a disturbance d, so that command u and motion y are correlated without one
causing the other: their ratio is -1/C, the inverse of the controller, and no noise model
distinguishes it from G (Ljung, System Identification, sec. 13.4). A setpoint r does not depend on
d: at the right numbers e = y - G(theta) u is not coherent with z, the setpoint as an acceleration,
nor with its Hilbert quadrature; the two span any gain and lag. For a channel and band k, with Q an
orthonormal basis of z in the n rows of each flight, and T the trust in it,

    log L(theta) = -1/2 sum_k n_k log(1 + T |Q'e|^2 / |e - QQ'e|^2),    by Anderson & Rubin (1949)
    J = min over gain and lag of sum_k n_k log(1 + |Q'e|^2 / |e - QQ'e|^2) / (sum_k rank Q_k - 3)
    T = (1 - 1 / F) / max(1.2, J) / (1 + c n_k / rank Q);  0 where such a J is improbable, and where
    F of the first stage is small: 1 / F of its power along z is noise; c: share of a disturbance
    that may follow z (Conley, Hansen & Rossi, Rev. Econ. Stat. 94, 2012): more rows tell no more

J is computed for the nominal model, and again with the effects at the end of a search: what the
model lacks is no disturbance. For a mission, a moment proportional to the flown speed, by the air,
is free as well.

A weak setpoint has a flat likelihood: the prior remains. One that is correlated with disturbances
cannot fit all bands with one gain and lag, and J rejects it (Sargan, Econometrica 26 (1958);
Hansen, Econometrica 50 (1982)).

In order of trust: the velocity setpoint of a mission or pilot; the attitude setpoint; the
prediction of other flights of the same mission, aligned in time; below 0.3 Hz, for a flight with
deliberate travel, the flown speed, which determines the aerodynamic moment and no gain. The rate
setpoint is none. Constants are not affected by the loop. Noise is the part across the instruments,
and laws are inexact by a share of the part along them.

Bands of angular acceleration enter the likelihood only in this way. For specific force along the
thrust, where the height loop responds likewise, rows enter across the prediction by commands: in
each band the prediction, its quadrature and their derivatives span any gain and lag, and the rest
of a row depends on neither. All other rows enter unchanged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf, dormqr
from scipy.signal import hilbert, lfilter
from scipy.stats import chi2

from ...logs import Flight
from ...representation import ShortRepr
from ...residuals.channels import CHANNEL_HZ, Array, ChannelData
from ...residuals.measured import signal_of
from .noise import BandLikelihood, BandNoise, Term
from .setpoints import SOURCES, flown_across, lifts, turns
from .spectrum import BANDS_HZ, Flights, transformed

F_LEAST = {"mission": 3.0, "attitude setpoint": 15.0, "other flights": 10.0, "flown speed": 0.0}
"""Least F statistic of the first stage: Staiger & Stock, Econometrica 65 (1997)."""
SLOWEST = 2
"""First band in which a setpoint rotates the aircraft, from 0.3 Hz: below, wind dominates."""
IN_STEP = "flown speed"
"""Instrument that is used in the lowest band only, for a moment in phase with it: the rotation
common to a disturbance and the speed that it causes is in quadrature."""
MOVED = frozenset({"mission", IN_STEP})
"""Instruments whose last column is a speed; their test leaves a moment proportional to the flown
speed free."""
LOOP_HZ = 10.0
"""Upper end of control loop bandwidths, Hz. Made up."""
GAINS = np.exp(np.linspace(np.log(0.3), np.log(4.0), 41))
DELAYS_S = np.arange(-0.1, 0.061, 0.01)
LAGS_S = 0.0, -0.06, -0.03, -0.015, 0.015, 0.03, 0.06
"""Possible lag errors of a prediction before anything is fitted, s. Made up."""
CHANCE = {"mission": 0.005, "attitude setpoint": 0.05, "other flights": 0.05, "flown speed": 0.005}
"""Least p-value of the overidentification test."""
TESTED = {"mission": 1, "attitude setpoint": 4, "other flights": 4, "flown speed": 0}
"""Degrees of freedom of the test over all flights, below which it cannot reject."""
ANSWERED = 3
"""First band in which a lag of commands outweighs gusts in specific force: from 0.8 Hz."""
FOLLOWED = {"mission": 0.0, "attitude setpoint": 0.15, "other flights": 0.0, "flown speed": 0.15}
"""Share of the power of a disturbance with which an instrument may be correlated. Measured in
simulated loops: 0.06 to 0.33 in hover, 0.01 on a tour."""
UNEVEN = 1.2
"""Power of a disturbance along a mission over that across it. Measured in simulated tours, 0.3 to
10 Hz: 1.0 to 1.4."""
BLOCK = 32
"""Block size of LAPACK's reflectors, columns."""
ALIKE = 1.25
"""Factor up to which two values of trust count as equal. Made up."""
INEXACT = 0.1
"""Relative amplitude error of laws before anything is fitted. Made up."""


@dataclass(frozen=True, slots=True)
class Instrument(ShortRepr):
    """Instrument of one axis in one flight.

    Attributes:
        source: Kind of setpoint, see `SOURCES`.
        bases: Orthonormal basis in the rows of each band, shape (n, rank).
        power: Mean square of the measurement along it, by band.
        misfit: J of the flight or of all flights, whichever is less likely.
        chance: p-value of J for a valid instrument; 0: it was not tested.
        strength: F statistic of the first stage.
    """

    source: str
    bases: Mapping[int, Array]
    power: Mapping[int, float]
    misfit: float
    chance: float
    strength: float

    @property
    def trust(self) -> float:
        """Trust T: weight of the likelihood along it; 0: it is no instrument."""
        least = F_LEAST[self.source]
        if self.chance < CHANCE[self.source] or self.strength < least:
            return 0.0
        return (1 - 1 / self.strength if least else 1.0) / max(UNEVEN, self.misfit)

    def trust_in(self, band: int) -> float:
        """Trust in one band, limited by the possible correlation of a disturbance with it."""
        n, rank = self.bases[band].shape
        return self.trust / float(1 + FOLLOWED[self.source] * n / rank)


def instruments_of(
    flights: Sequence[Flight], channels: Flights
) -> dict[tuple[int, int], Instrument]:
    """First valid instrument in the order of trust, by channel of angular acceleration and flight,
    by their indices; where none is valid, the last one.

    Args:
        flights: Flights as read.
        channels: Channels of each flight, against the nominal model.
    """
    found: dict[tuple[int, int], Instrument] = {}
    for c in (c for c, first in enumerate(channels[0]) if turns(first.name)):
        own = [f[c] for f in channels]
        for source, asked in SOURCES.items():
            left = [f for f in range(len(own)) if (c, f) not in found or not found[c, f].trust]
            wanted = {f: asked(flights, own, f) for f in left}
            bases = {
                f: _bases(flights[f], own[f], z, source) for f, z in wanted.items() if z is not None
            }
            moved = {f: flown_across(flights[f], own[f]) for f in bases if source in MOVED}
            found |= {(c, f): i for f, i in _judged(source, own, bases, moved).items()}
    return found


def _judged(
    source: str,
    own: Sequence[ChannelData],
    bases: Mapping[int, dict[int, Array]],
    moved: Mapping[int, Array | None],
) -> dict[int, Instrument]:
    """Instruments of the flights in which a setpoint exists, by index."""
    tests = {f: _test(own[f], b, moved.get(f)) for f, b in bases.items() if b}
    found = {f: Instrument(source, {}, {}, 0.0, 1.0, 0.0) for f in bases}
    if not tests:
        return found
    ranks = {f: sum(q.shape[1] for q in bases[f].values()) for f in tests}
    free = {
        f: max(min(_fitted(bases[f]), ranks[f] - 2), 0) + (moved.get(f) is not None) for f in tests
    }
    fitted = max(free.values())
    degrees = sum(ranks.values()) - fitted
    together = _misfit(np.sum([t[0] for t in tests.values()], axis=0), degrees)
    for f, (misfit, power, strength) in tests.items():
        alone = _misfit(misfit, ranks[f] - free[f])
        chance, j = min(alone, together)
        chance = chance if degrees >= TESTED[source] else 0.0
        found[f] = Instrument(source, bases[f], power, j, chance, strength)
    return found


def _fitted(bases: Mapping[int, Array]) -> int:
    """Number of parameters that a test fits: gain, delay, and a lag, which two bands do not
    separate from it."""
    return 2 if len(bases) <= 2 else 3


def _misfit(likelihood: Array, degrees: int) -> tuple[float, float]:
    """p-value of the least J, and that J."""
    least, degrees = float(np.min(likelihood)), max(degrees, 1)
    return float(chi2.sf(least, degrees)), least / degrees


# -- tests of an instrument ----------------------------------------------------------------------


def _bases(flight: Flight, channel: ChannelData, asked: Array, source: str) -> dict[int, Array]:
    """For each usable band, an orthonormal basis of the setpoint and its quadrature; below
    `SLOWEST` of a speed alone."""
    asked = asked[:, np.std(asked, axis=0) > 1e-6]
    if not asked.size:
        return {}
    rows, band = transformed(channel, np.column_stack([asked, np.imag(hilbert(asked, axis=0))]))
    commands = signal_of(flight, ("cmd_1" if flight.has("cmd_1") else "rotor_1",))
    fastest = min(LOOP_HZ, 1.05 * commands.rate_hz / 5)
    last = int(np.searchsorted(BANDS_HZ, fastest, side="right")) - 1
    bands = range(SLOWEST, last + 1) if source != IN_STEP else range(0)
    parts = {b: rows[band == b] for b in bands}
    if source in MOVED:
        speed = asked.shape[1] - 1
        parts[SLOWEST - 1] = rows[band == SLOWEST - 1, speed : speed + 1]
    return {b: np.linalg.qr(p).Q for b, p in sorted(parts.items()) if len(p) > 2 * p.shape[1]}


def _test(
    channel: ChannelData, bases: Mapping[int, Array], moved: Array | None
) -> tuple[Array, dict[int, float], float]:
    """-2 log L by lag and gain of the prediction, shape (lags, gains), with the moment proportional
    to the speed `moved` that minimises the residual along the instrument; the measurement along it,
    see `Instrument`; F of the first stage."""
    t_s, predicted = channel.t_s, channel.measured - channel.residual
    lags = LAGS_S if _fitted(bases) > 2 else LAGS_S[:1]
    late = [_lagged(predicted, v) for v in lags]
    late = [np.interp(t_s - delay, t_s, v) for v in late for delay in DELAYS_S]
    speed = np.zeros(len(t_s)) if moved is None else moved
    rows, band = transformed(channel, np.column_stack([channel.measured, speed, *late]))
    still = 2 + int(np.argmin(np.abs(DELAYS_S)))
    power, forms = {}, []
    taken = left = n = ranks = 0.0
    moment, weighed = np.zeros((2, len(late), len(GAINS)))
    for b, q in bases.items():
        inside = rows[band == b]
        part = q.T @ inside
        along = _left(part)
        across = _left(inside) - along
        power[b] = float(np.mean(part[:, 0] ** 2))
        known = [0] if moved is None else [0, still]
        larger = float(np.mean(part[:, known] ** 2, axis=0).max())
        floor = len(inside) * INEXACT**2 * larger + 1e-12 * float(np.sum(inside[:, 0] ** 2))
        weight = len(inside) / (across[0] + floor)
        moment, weighed = moment + weight * along[1], weighed + weight * along[2]
        forms.append((len(inside), along, across, floor))
        share = np.sum(part[:, still] ** 2) / max(np.sum(inside[:, still] ** 2), 1e-300)
        taken, left = taken + len(inside) * share, left + len(inside) * (1 - share)
        n, ranks = n + len(inside), ranks + len(part)
    moment = moment / np.maximum(weighed, 1e-300)
    misfit = sum(
        size * np.log1p(_with_speed(along, moment) / (_with_speed(across, moment) + floor))
        for size, along, across, floor in forms
    )
    return np.asarray(misfit), power, float(taken / ranks / max(left / (n - ranks), 1e-300))


def _left(rows: Array) -> Array:
    """Quadratic forms of the residual of rows after a gain times a prediction and a coefficient
    times a speed: first column measured, second the speed, each other one a prediction. Square
    without the speed, product of residual and speed, square of the speed; shape (3, predictions,
    gains)."""
    y, v, x = rows[:, 0], rows[:, 1], rows[:, 2:]
    square = y @ y - 2 * np.outer(y @ x, GAINS) + np.outer(np.sum(x * x, axis=0), GAINS**2)
    return np.array([square, y @ v - np.outer(v @ x, GAINS), np.full_like(square, v @ v)])


def _with_speed(left: Array, number: Array) -> Array:
    """The squares with a coefficient of the speed for each prediction and gain."""
    return np.asarray(np.maximum(left[0] - 2 * number * left[1] + number**2 * left[2], 0.0))


def _lagged(values: Array, lag_s: float) -> Array:
    """Values after a first-order lag; after its inverse where it is negative."""
    if lag_s <= 0:
        return np.asarray(values - lag_s * CHANNEL_HZ * np.gradient(values))
    decay = np.exp(-1 / (CHANNEL_HZ * lag_s))
    return np.asarray(lfilter([1 - decay], [1.0, -decay], values))


# -- what commands may answer for --------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Answers(ShortRepr):
    """Subspace of the commands' prediction in one band, as reflectors that rotate it into the first
    rows.

    Attributes:
        reflectors: Reflectors of LAPACK's dgeqrf, shape (n, rank).
        scale: Scale of each, shape (rank,).
    """

    reflectors: Array
    scale: Array

    @classmethod
    def of(cls, part: Array) -> "Answers":
        """Subspace of rows of a band, shape (n, rank)."""
        return cls(*dgeqrf(part)[:2])

    def taken_out(self, rows: Array) -> tuple[Array, int]:
        """Rotated rows, shape (n, m), and how many of the first contain the commands' prediction:
        all of them in a band with hardly more rows than numbers."""
        n, rank = self.reflectors.shape
        if n <= 2 * rank:
            return rows, n
        room = rows.shape[1] * BLOCK
        return dormqr("L", "T", self.reflectors, self.scale, rows, room)[0], rank


def answers_of(channel: ChannelData) -> dict[int, Answers]:
    """Subspace of the commands' prediction with any gain and lag, by band of the loop."""
    predicted = channel.measured - channel.residual
    own = np.zeros((len(predicted), 4))
    for inside in (channel.piece == p for p in np.unique(channel.piece)):
        moving = predicted[inside] - np.mean(predicted[inside])
        own[inside, :2] = np.column_stack([moving, np.imag(hilbert(moving))])
        own[inside, 2:] = np.gradient(own[inside, :2], axis=0)
    rows, band = transformed(channel, own)
    bands = np.unique(band[band >= ANSWERED]).tolist()
    return {b: Answers.of(rows[band == b]) for b in bands}


# -- the law of the noise -----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Along(Term):
    """Rows along instruments, by their trust; the next term holds those across."""


@dataclass(frozen=True, slots=True)
class InstrumentNoise(ShortRepr):
    """`BandNoise`, with bands inside the control loop evaluated along instruments alone.

    Attributes:
        bands: Noise model of all other rows.
        turning: Channels of angular acceleration.
        instruments: Instruments by channel and flight.
        answers: Subspaces for specific force along the thrust, by channel and flight.
        rough: Relative amplitude error of laws.
    """

    bands: BandNoise
    turning: frozenset[int]
    instruments: Mapping[tuple[int, int], Instrument]
    answers: Mapping[tuple[int, int], Mapping[int, Answers]]
    rough: float

    @classmethod
    def of(
        cls, flights: Sequence[Flight], channels: Flights, bands: BandNoise, rough: float
    ) -> "InstrumentNoise":
        """Noise model from the residuals of the nominal model; arguments as of `instruments_of`."""
        turning = frozenset(i for i, c in enumerate(channels[0]) if turns(c.name))
        answers = {
            (c, f): answers_of(channel)
            for f, own in enumerate(channels)
            for c, channel in enumerate(own)
            if lifts(channel.name)
        }
        return cls(bands, turning, instruments_of(flights, channels), answers, rough)

    @property
    def mute(self) -> frozenset[int]:
        """Channels of angular acceleration without a trusted instrument in any flight: correlation
        of commands and motion there may be due to the controller."""
        heard = {c for (c, _), i in self.instruments.items() if i.trust}
        return self.turning - heard

    def trusts_as(self, other: "InstrumentNoise") -> bool:
        """Whether the same instruments are trusted, with about equal trust, and means alike."""
        own, others = ({k: i for k, i in n.instruments.items() if i.trust} for n in (self, other))
        pairs = [(i.trust, others[k].trust) for k, i in own.items() if k in others]
        pairs += [(v, other.bands.floor[k]) for k, v in self.bands.floor.items() if k[1] == 0]
        sources = [{k: i.source for k, i in used.items()} for used in (own, others)]
        return sources[0] == sources[1] and all(1 / ALIKE < a / b < ALIKE for a, b in pairs)

    def terms(
        self, channel: int, rows: Array, band: NDArray[np.intp], flight: NDArray[np.intp]
    ) -> list[Term]:
        """See `BandNoise`."""
        if channel not in self.turning:
            rows, band = self._unanswered(channel, rows, band, flight)
            return self.bands.terms(channel, rows, band, flight)
        found = self.bands.terms(channel, rows, np.minimum(band, -band), flight)
        own = {f: i for (c, f), i in self.instruments.items() if c == channel and i.trust}
        for b in sorted({b for i in own.values() for b in i.bases}):
            rounding, floor = self.bands.rounding[channel, b], self.bands.floor[channel, b]
            along, across = np.zeros((2, rows.shape[1], rows.shape[1]))
            n = 0
            for f, i in ((f, i) for f, i in own.items() if b in i.bases):
                inside = rows[(band == b) & (flight == f)]
                part = i.bases[b].T @ inside
                products = part.T @ part
                trust = i.trust_in(b)
                along, across = along + trust * products, across + inside.T @ inside - products
                along[0, 0] += trust * len(part) * rounding
                across[0, 0] += len(inside) * (rounding + self.rough**2 * i.power[b])
                n += len(inside)
            found.append(Along(channel, along, n, floor, False))
            found.append(Term(channel, across, n, floor, False))
        return found

    def _unanswered(
        self, channel: int, rows: Array, band: NDArray[np.intp], flight: NDArray[np.intp]
    ) -> tuple[Array, NDArray[np.intp]]:
        """Rows and their bands, without those that contain the commands' prediction."""
        own = {f: a for (c, f), a in self.answers.items() if c == channel}
        if own:
            rows, band = rows.copy(), band.copy()
        for f, b, answers in ((f, b, a) for f, bands in own.items() for b, a in bands.items()):
            inside = np.flatnonzero((band == b) & (flight == f))
            rows[inside], rank = answers.taken_out(rows[inside])
            band[inside[:rank]] = -1
        return rows, band

    def likelihood(self, terms: Sequence[Term]) -> "InstrumentLikelihood":
        """See `BandNoise`."""
        along = np.array([i for i, t in enumerate(terms) if isinstance(t, Along)], dtype=np.intp)
        alone = np.setdiff1d(np.arange(len(terms)), [along, along + 1])
        usual, level = self.bands.likelihood([terms[i] for i in alone]), self.bands.level
        count = level + np.array([terms[i].count for i in along])
        floor = level * np.array([terms[i].floor for i in along])
        return InstrumentLikelihood(usual, alone, along, count, floor)


@dataclass(frozen=True, slots=True)
class InstrumentLikelihood(ShortRepr):
    """Likelihood of single terms and of pairs along and across instruments.

    Attributes:
        usual: Likelihood of the single terms.
        alone: Indices of these.
        along: Indices of the terms along instruments, each before that across.
        count: Number of rows of each pair, and equivalent number of its floor.
        floor: Sum of squares of the floor of each pair.
    """

    usual: BandLikelihood
    alone: NDArray[np.intp]
    along: NDArray[np.intp]
    count: Array
    floor: Array

    def log(self, rss: Array, kappa: float = 1.0) -> float:
        """See `BandLikelihood`."""
        across = self.floor + rss[self.along + 1]
        pairs = self.count * np.log1p(rss[self.along] / across)
        return self.usual.log(rss[self.alone], kappa) - 0.5 * float(np.sum(pairs))

    def weights(self, rss: Array, kappa: float = 1.0) -> tuple[Array, Array]:
        """See `BandLikelihood`; the noise level's increase by numbers is no curvature."""
        gradient, weight = np.zeros((2, len(rss)))
        gradient[self.alone], weight[self.alone] = self.usual.weights(rss[self.alone], kappa)
        across = self.floor + rss[self.along + 1]
        weight[self.along] = self.count / (across + rss[self.along])
        gradient[self.along] = weight[self.along]
        gradient[self.along + 1] = weight[self.along] - self.count / across
        return gradient, weight
