"""Fit of one candidate model: Gauss-Newton on the exact residuals.

The predicted gain of a linearised step is verified with the exact model; a step that falls short is
halved, and slopes are recomputed where the model is nonlinear.

No scale factor is fitted to a mean: a mean moment, such as that of a canted rotor or a shifted
centre of mass, must not enlarge the inertia or reduce the rotors' torque.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Equation, prior_of
from ...representation import ShortRepr
from ...residuals.channels import CHANNEL_HZ, GRID_HZ, ChannelData
from ...vehicle import Vehicle
from ..model.model import Model
from ..model.numbers import DRIVES, Number
from ..settings import DEFAULT, EvidenceSettings
from .evidence import LaplaceEvidence, MapEstimate
from .instruments import InstrumentNoise
from .noise import BandNoise, constants_of_days
from .priors import Bounds, Priors, effect_of
from .setpoints import turns
from .spectrum import Flights, Spectrum

Array = NDArray[np.float64]

# -- Gauss-Newton --------------------------------------------------------------------------


ROUNDS, SHORTEST_STEP = 15, 0.04
"""Maximum number of Gauss-Newton rounds; a step halved below the second value, as a share, ends the
fit."""
ARMIJO = 0.1
"""Share of the predicted gain that a step must reach: Armijo, Pacific J. Math. 16 (1966)."""
MARGIN, INEXACT = 10.0, 0.5
"""A fit is abandoned where its linearised optimum is below a goal by more than so many nats, plus
that share of the predicted gain. Slopes from before a step are not used for this."""
FARTHEST_S = 0.005
"""Largest step of a delay of commands or a lag, s: a tenth of a period of the fastest band."""
FARTHEST_POSE_S = 0.02
"""Largest step of an age of a sensor or of the pose, s, whose band is lower."""
FARTHER = 2.0
"""Growth of the step limit after a step with small nonlinearity; after a shortened one, the limit
is its length: Conn, Gould & Toint, Trust-Region Methods, 2000, sec. 6.1."""
SETTLED = 0.2
"""Gain of a round, nats, below which the fit has converged."""
STRAIGHT = 0.02
"""Largest relative nonlinearity of a step, in power, for which slopes are reused."""
LONG = 1.0
"""Length of a step, nats, beyond which slopes are recomputed after a nonlinear step."""

BEFORE = 2.0
"""Number of days that the prior on day-to-day variation counts for."""
ACQUAINTED = 3
"""Steps of expectation maximisation that estimate the day-to-day variation of a start."""


KAPPAS = tuple(float(2.0**k) for k in range(-6, 1))
"""Factors on the standard deviation of day-to-day variation that are tried; a larger one than 1
cannot be learned from few flights."""


@dataclass(frozen=True, slots=True)
class State(ShortRepr):
    """MAP estimate of one candidate model.

    Attributes:
        effects: Effects, sorted.
        best: Numbers and evidence.
        spectrum: Spectrum of the residuals there, with slopes of the numbers that could change.
    """

    effects: tuple[str, ...]
    best: MapEstimate
    spectrum: Spectrum

    @property
    def evidence(self) -> float:
        """Log evidence, up to a constant."""
        return self.best.evidence

    @property
    def kappa(self) -> float:
        """Factor on the standard deviation of day-to-day variation."""
        return self.best.kappa


@dataclass(frozen=True, slots=True)
class Problem(ShortRepr):
    """Estimation problem: flights, priors and noise.

    Attributes:
        model: Predictions of the flights.
        priors: Priors of their numbers.
        bounds: Bounds of the numbers, as changes.
        noise: Noise model.
        rest: Spectrum of the nominal model's residuals, with slopes by every number.
        gained: Log likelihood gained by following mere noise, nats, of each cause; in its odds.
        usual: Between-flight standard deviation of each number, not learned from these flights.
        kappas: Allowed factors on day-to-day variation; for one flight it is not observable.
    """

    model: Model
    priors: Priors
    bounds: Bounds
    noise: InstrumentNoise
    rest: Spectrum
    gained: Mapping[str, float]
    usual: Array
    kappas: tuple[float, ...] = (1.0,)

    @classmethod
    def of(
        cls,
        model: Model,
        priors: Priors,
        settings: EvidenceSettings = DEFAULT.inference.evidence,
        constants: Mapping[str, float] | None = None,
    ) -> "Problem":
        """Problem with every number of the model; `constants`: between-flight standard deviations
        of the channels' constants, where known."""
        numbers = [model.numbers[i] for i in priors.columns]
        bounds = Bounds.of(numbers, model.vehicle).around(priors.now)
        theta, days = np.zeros(len(numbers)), np.zeros((len(model.flights), len(priors.days)))
        now = dict(zip(priors.names, priors.now.tolist(), strict=True))
        flights = _without_means(model.channels(priors.columns), priors.names, {}, now)
        rest = Spectrum.of(flights, theta, days, priors.days)
        usual = constants_of_days(rest.channels, model.vehicle, settings)
        sizes = [(constants or {}).get(n, u) for n, u in zip(rest.channels, usual, strict=True)]
        bands = BandNoise.of(rest, sizes, settings)
        logs = [f.flight for f in model.flights]
        noise = InstrumentNoise.of(logs, flights, bands, settings.rough)
        gained = {c: gained_by_following(c, flights, bands, model.vehicle) for c in priors.cause}
        odds = {c: v - gained[c] for c, v in priors.odds.items()}
        kappas = KAPPAS if len(model.flights) > 1 else (1.0,)
        priors = replace(priors, odds=odds)
        return cls(model, priors, bounds, noise, rest, gained, priors.day, kappas)

    def laplace(self, spectrum: Spectrum) -> LaplaceEvidence:
        """Linearisation of all candidate models at these residuals."""
        return LaplaceEvidence(spectrum, self.noise, self.priors, self.bounds)

    def values(self, x: Array) -> dict[str, float]:
        """Shared numbers that differ from the nominal model, "effect.number" -> value, given
        `MapEstimate.x`."""
        shared = self.split(x)[0]
        theta, moved = self.priors.now + shared, shared != 0
        acting = {effect_of(self.priors.cause[i]) for i in np.flatnonzero(moved)}
        moved |= self.priors.shape & np.isin(np.array(self.priors.cause), [*acting])
        return {self.priors.names[i]: float(theta[i]) for i in np.flatnonzero(moved)}

    def channels(self, x: Array, columns: Sequence[int] = ()) -> list[list[ChannelData]]:
        """Channels of each flight with its day-to-day deviations at some numbers, with slopes by
        some of them."""
        values, b = self.values(x), self.priors
        torque = [i for i, n in enumerate(b.names) if n in values and _scale(n) == "torque"]
        asked = [*columns, *(i for i in torque if i not in columns)]
        model = replace(self.model, days=self.days(x))
        flights = model.channels([b.columns[i] for i in asked], values)
        now = dict(zip(b.names, b.now.tolist(), strict=True))
        made = _without_means(flights, [b.names[i] for i in asked], values, now)
        return [[replace(c, slopes=c.slopes[:, : len(columns)]) for c in f] for f in made]

    def split(self, x: Array) -> tuple[Array, Array]:
        """Shared numbers, and day-to-day deviations."""
        k = len(self.priors.now)
        return x[:k], x[k:].reshape(len(self.model.flights), len(self.priors.days))

    def days(self, x: Array) -> tuple[dict[str, float], ...]:
        """Day-to-day deviations of each flight, as `Model.days`."""
        names = [self.priors.names[i] for i in self.priors.days]
        return tuple(
            {n: float(v) for n, v in zip(names, own, strict=True) if v} for own in self.split(x)[1]
        )

    def between_days(self, state: State) -> dict[str, float]:
        """Between-flight standard deviation of each number with day-to-day variation: prior
        combined with these flights."""
        b = self.priors
        days, doubts = (self.split(v)[1] for v in (state.best.x, state.best.deviations()))
        pairs = zip(b.days, (days**2 + doubts**2).T, strict=True)
        return {b.names[i]: _deviation(state.kappa * b.day[i], shown) for i, shown in pairs}

    def constants_between_days(self, state: State, prior: Sequence[float]) -> dict[str, float]:
        """Between-flight standard deviation of the unexplained constant, by channel; `prior`: its
        variance at kappa = 1 by channel, combined with these flights."""
        usual = state.kappa * np.sqrt(prior)
        every = zip(self.rest.channels, usual, state.spectrum.rows, strict=True)
        left = ((n, v, [np.sum(r.residual[r.band == 0] ** 2) for r in own]) for n, v, own in every)
        return {name: _deviation(sd, np.array(shown)) for name, sd, shown in left}

    def with_instruments_at(self, state: State) -> "Problem":
        """The problem with instruments tested against the model at the numbers of a state: effects
        missing in the nominal model make valid instruments look correlated with disturbances.
        """
        logs = [f.flight for f in self.model.flights]
        flights, bands = self.channels(state.best.x), self.noise.bands.with_means_of(state.spectrum)
        noise = InstrumentNoise.of(logs, flights, bands, self.noise.rough)
        return replace(self, noise=noise)

    def acquainted(self, effects: Sequence[str]) -> "Problem":
        """The problem with day-to-day variation estimated from its flights, as far as some effects
        explain it, before any other effect is included.

        A propeller changed between two flights changes the yaw moment more than usual; with the
        usual variation, any effect that differs between these flights would be selected for it.
        """
        problem, state = self, self.start(effects, 1.0)
        own = np.isin(np.array(self.priors.cause), effects) & (self.priors.day > 0)
        for _ in range(ACQUAINTED):
            shown = self.between_days(state)
            pairs = zip(self.priors.names, self.priors.day, own, strict=True)
            day = np.array([shown[n] if there else usual for n, usual, there in pairs])
            problem = replace(self, priors=replace(self.priors, day=day))
            state = problem.settle(effects, 1.0, state.spectrum, state.best.x)
        return problem

    def accustomed(self, state: State) -> "Problem":
        """The problem with day-to-day variation estimated from its flights, number by number.

        Its size is known then, and no common factor is estimated again.
        """
        means = [self.noise.bands.floor[c, 0] for c in range(len(self.rest.channels))]
        shown, left = self.between_days(state), self.constants_between_days(state, means)
        pairs = zip(self.priors.names, self.priors.day, strict=True)
        day = np.array([shown.get(n, usual) for n, usual in pairs])
        clocks = [*self.priors.ages]  # about a mean, ages that are never negative vary less
        day[clocks] = np.maximum(day[clocks], self.priors.day[clocks])
        constants = {(c, 0): left[name] ** 2 for c, name in enumerate(self.rest.channels)}
        bands = replace(self.noise.bands, floor={**self.noise.bands.floor, **constants})
        priors, noise = replace(self.priors, day=day), replace(self.noise, bands=bands)
        return replace(self, priors=priors, noise=noise, kappas=(1.0,))

    def linearised(self, state: State) -> LaplaceEvidence:
        """Linearisation of all candidate models near a state, with slopes by every number there."""
        flights = self.channels(state.best.x, range(len(self.priors.now)))
        return self.laplace(Spectrum.of(flights, *self.split(state.best.x), self.priors.days))

    def start(self, effects: Sequence[str], kappa: float, least: float = -np.inf) -> State:
        """Fit of a candidate model from its prior means; arguments as of `settle`."""
        x = np.zeros(len(self.priors.now) + self.rest.days.size)
        b, own = self.priors, self.priors.of(effects)
        x[own] = np.clip(b.mean[own], b.low[own], b.high[own]) - b.now[own]
        return self.loosened(effects, kappa, self.rest, x, least)

    def loosened(
        self,
        effects: Sequence[str],
        kappa: float,
        spectrum: Spectrum,
        start: Array,
        least: float = -np.inf,
    ) -> State:
        """Fit with the largest day-to-day variation first, arguments as of `settle`: constants that
        may hardly vary are a narrow valley, and where it is curved no long step stays inside."""
        if kappa < 1:
            loose = self.settle(effects, 1.0, spectrum, start)
            spectrum, start = loose.spectrum, loose.best.x
        return self.settle(effects, kappa, spectrum, start, least)

    def settle(
        self,
        effects: Sequence[str],
        kappa: float,
        spectrum: Spectrum,
        start: Array,
        least: float = -np.inf,
    ) -> State:
        """MAP estimate of a candidate model.

        Args:
            effects: Identifiers of the effects.
            kappa: Factor on the standard deviation of day-to-day variation.
            spectrum: Spectrum with initial slopes.
            start: Initial numbers, as `MapEstimate.x`.
            least: Evidence below which the model is irrelevant: a fit that will not reach it is
                abandoned, with the evidence of its linearised optimum.
        """
        on = tuple(sorted(effects))
        columns = self.moving(on)
        x = self._begun(on, columns, start)
        spectrum, own = self._begin(spectrum, x, columns)
        laplace = self.laplace(spectrum)
        now = laplace.at(on, kappa)
        shaped = bool(np.any(self.priors.shape[columns]))
        fresh, reach = own, self._reach()
        for n in range(ROUNDS):
            first = shaped and n == 0  # a shape has no slope while its size is 0
            wanted = laplace.best(on, kappa, reach).x
            promised = laplace.at(on, kappa, wanted) - now
            end = laplace.best(on, kappa)
            known = not first and np.allclose(end.x, wanted)
            if known and end.evidence + MARGIN + INEXACT * promised < least:
                if fresh:
                    return State(on, end, spectrum)
                spectrum, fresh = self._renewed(spectrum, x, columns), True
                laplace = self.laplace(spectrum)
                continue
            step, better = 1.0, None
            while step > SHORTEST_STEP:
                y = x + step * (wanted - x)
                there = spectrum.moved(self.channels(y), *self.split(y))
                over = self.laplace(there)
                value = over.at(on, kappa)
                if np.isfinite(value) and value > now + ARMIJO * step * promised:
                    better = y, there, over, value
                    break
                step *= 0.5
            if better is None and fresh:
                break
            if better is None:
                spectrum, fresh = self._renewed(spectrum, x, columns), True
                laplace = self.laplace(spectrum)
                continue
            bent = _bend(spectrum, better[1])
            gain = better[3] - now
            reach = reach * (FARTHER if step == 1 and bent < STRAIGHT else step)
            x, spectrum, laplace, now = better
            fresh = False
            again = first or (n == 0 and not own)
            if gain < SETTLED and not again:
                break
            if (bent > STRAIGHT and gain > LONG) or again:
                spectrum, fresh = self._renewed(spectrum, x, columns), True
                laplace = self.laplace(spectrum)
        return State(on, laplace.at_linearisation(on, kappa), spectrum)

    def _begin(
        self, spectrum: Spectrum, x: Array, columns: NDArray[np.intp]
    ) -> tuple[Spectrum, bool]:
        """Residuals at some numbers with slopes by some columns, and whether these slopes were
        computed there: where effects were removed and all other numbers stay, the old slopes are
        used."""
        here = np.concatenate([spectrum.theta, spectrum.days.ravel()])
        own = np.concatenate([columns, np.arange(len(self.priors.now), len(x))])
        if not np.array_equal(x[own], here[own]):
            return self._renewed(spectrum, x, columns).only(columns), True
        if np.array_equal(x, here):
            return spectrum.only(columns), True
        return spectrum.only(columns).moved(self.channels(x), *self.split(x)), False

    def _reach(self) -> Array:
        """Largest step of each number: numbers that shift signals in time are strongly
        nonlinear."""
        shared = np.array([_farthest(self.model.numbers[i]) for i in self.priors.columns])
        return np.concatenate([shared, np.tile(shared[self.priors.days], len(self.model.flights))])

    def _begun(self, on: Sequence[str], columns: NDArray[np.intp], start: Array) -> Array:
        """Initial numbers of a candidate model inside their ranges: those of other effects neutral,
        new shape parameters at their prior mean."""
        b, k = self.priors, len(self.priors.now)
        x = start.copy()
        x[np.setdiff1d(np.arange(k), columns)] = 0.0
        own = b.of(on)
        new = [e for e in on if not np.any(start[b.of([e])])]
        enter = np.intersect1d(b.of(new), np.flatnonzero(b.shape))
        x[enter] = b.mean[enter] - b.now[enter]
        x[own] = np.clip(x[own], b.low[own] - b.now[own], b.high[own] - b.now[own])
        return x

    def moving(self, on: Sequence[str]) -> NDArray[np.intp]:
        """Columns that a candidate model can change."""
        spiked = np.flatnonzero((self.priors.spike > 0) & ~self.priors.shape)
        return np.unique(np.concatenate([self.priors.of(on), self.priors.days, spiked]))

    def _renewed(self, spectrum: Spectrum, x: Array, columns: NDArray[np.intp]) -> Spectrum:
        """Residuals and slopes of some columns, recomputed."""
        flights = self.channels(x, columns.tolist())
        return spectrum.moved(flights, *self.split(x)).renewed(flights, columns)


def _scale(number: str) -> str:
    """Kind of a scale factor, for a number "effect.number", see `Equation.scales`; "": none."""
    observable_as = EFFECTS[number.partition(".")[0]].observable_as
    return observable_as.scales if isinstance(observable_as, Equation) else ""


def _without_means(
    flights: Flights, names: Sequence[str], values: Mapping[str, float], now: Mapping[str, float]
) -> list[list[ChannelData]]:
    """Channels in which no scale factor changes the constants of angular acceleration: these are
    computed as moments, inertia times the measured acceleration, with the reaction torque of the
    nominal model.

    Args:
        flights: Channels of each flight.
        names: Names of the slopes' numbers, among them scale factors of the torque that differ from
            the model's.
        values: Their values, as of `Model.channels`.
        now: Values of all numbers in the nominal model.
    """
    scales = {n: values.get(n, now[n]) for n in now if _scale(n)}
    own = [i for i, n in enumerate(names) if n in scales]
    torque = [i for i in own if _scale(names[i]) == "torque"]

    def made(c: ChannelData) -> ChannelData:
        """The same for one channel."""
        if not turns(c.name):
            return c
        inertia = (n for n in scales if n.endswith(f".scale_{c.name[-1]}"))
        more = math.prod(scales[n] / now[n] for n in inertia) - 1.0
        residual, slopes = c.residual.copy(), c.slopes.copy()
        for k in np.unique(c.piece):
            part = c.piece == k
            mean = slopes[part].mean(axis=0)
            back = sum((scales[names[i]] - now[names[i]]) * mean[i] for i in torque)
            residual[part] += more * (residual[part].mean() + back) + back
            change = more * mean
            change[own] = -mean[own]
            slopes[part] += change
        return replace(c, residual=residual, slopes=slopes)

    return [[made(c) for c in row] for row in flights]


def _deviation(usual: float, shown: Array) -> float:
    """Standard deviation of a zero-mean normal variable: prior value combined with observed
    squares."""
    return float(np.sqrt((BEFORE * usual**2 + shown.sum()) / (BEFORE + len(shown))))


def gained_by_following(cause: str, flights: Flights, noise: BandNoise, vehicle: Vehicle) -> float:
    """Log likelihood gained by an observer that follows mere noise, nats.

    The observer predicts a reading from its past. The innovation is S(f) times the reading, so its
    density is multiplied by |S|, frequency by frequency. ln |S| integrated over all angular
    frequencies gives -pi/2 times the gain: Bode's integral of a loop with relative degree one. On a
    grid the same is lost again, uniformly up to the Nyquist frequency (the discrete integral is
    zero), and the channels contain the part of it up to that of their logs.
    """
    observer = EFFECTS[effect_of(cause)].observer
    if observer is None:
        return 0.0
    gained = 0.0
    for own in flights:
        for c, channel in enumerate(own):
            if channel.name in observer.channels:
                part = 2 * min(channel.nyquist_hz, CHANNEL_HZ / 2) / GRID_HZ
                gained += noise.own[c] * len(channel.t_s) / CHANNEL_HZ * (1 - part)
    return 0.5 * observer.gain_1_s(vehicle) * gained


def _farthest(number: Number) -> float:
    """Largest step of a number."""
    if number.moves:
        return FARTHEST_S if {*number.moves} & {*DRIVES} else FARTHEST_POSE_S
    timed = prior_of(EFFECTS[number.effect]).timed and not number.shape
    return FARTHEST_S if timed else float("inf")


def _bend(before: Spectrum, after: Spectrum) -> float:
    """Relative nonlinearity of a step: power of the residuals' deviation from linearity over that
    of their change."""
    bend, moved = 0.0, 1e-300
    step = after.theta - before.theta
    for own, then in zip(before.rows, after.rows, strict=True):
        scale = sum(float(r.residual @ r.residual) for r in own) + 1e-300
        for f, (a, b) in enumerate(zip(own, then, strict=True)):
            full = step.copy()
            full[before.day_columns] += after.days[f] - before.days[f]
            change = a.slopes @ full[a.active]
            miss = b.residual - (a.residual - change)
            bend += float(miss @ miss) / scale
            moved += float(change @ change) / scale
    return bend / moved


# -- result --------------------------------------------------------------------------------


INTERVAL = 1.96
"""Half-width of a 95 % interval over the standard deviation of a normal distribution."""
COVERED = 3.0
"""Standard deviations of the file within which a deviation is no effect: of a dozen numbers one is
beyond 2 in 43 of 100 files, beyond 3 in 3."""


@dataclass(frozen=True, slots=True)
class Fit(ShortRepr):
    """Fitted candidate model, as reported.

    Attributes:
        effects: Identifiers of the effects, sorted.
        values: Numbers and shape parameters, "effect.number" -> value.
        numbers: Numbers with an interval.
        half_widths: Half-widths of the 95 % intervals of `numbers`, shape (k,).
        gain: Log evidence over that of the model without effects.
        days: Day-to-day deviations at these numbers, as `Model.days`.
        ridges: Standard deviation of a number of an effect with shape parameters, over that with
            the shape parameters fixed, by number.
        covered: Change that the file's uncertainty allows, by uncertain number.
    """

    effects: tuple[str, ...]
    values: Mapping[str, float]
    numbers: tuple[Number, ...]
    half_widths: Array
    gain: float
    days: tuple[Mapping[str, float], ...] = ()
    ridges: Mapping[str, float] = field(default_factory=dict)
    covered: Mapping[str, float] = field(default_factory=dict)

    def on_its_days(self, model: Model) -> Model:
        """Predictions of the flights, each with its day-to-day deviations."""
        return replace(model, days=self.days)

    def sizes(self) -> dict[str, float]:
        """Largest change of a number of each effect, over the least size that is named."""
        changes = dict.fromkeys(self.effects, 0.0)
        for n in self.numbers:
            if not n.shape:
                least = max(n.about.smallest, self.covered.get(n.full, 0.0))
                change = abs(self.values[n.full] - n.now) / least
                changes[n.effect] = max(changes[n.effect], change)
        return changes


def fit_of(
    problem: Problem, causes: Sequence[str], x: Array, deviations: Array, gain: float
) -> Fit:
    """Fit of some causes from `MapEstimate.x`, including days, and its standard deviations."""
    on = tuple(sorted({effect_of(c) for c in causes}))
    own = problem.priors.of(causes)
    numbers = tuple(problem.model.numbers[problem.priors.columns[i]] for i in own)
    values = {n.full: n.now + float(x[i]) for n, i in zip(numbers, own, strict=True)}
    allowed = COVERED * problem.priors.spike[own]
    covered = {n.full: float(c) for n, c in zip(numbers, allowed, strict=True) if c > 0}
    widths = INTERVAL * deviations[own]
    return Fit(on, values, numbers, widths, gain, problem.days(x), covered=covered)


def fit_of_best(problem: Problem, causes: Sequence[str], best: MapEstimate, nothing: float) -> Fit:
    """Fit of a candidate model at a linearisation."""
    return fit_of(problem, causes, best.x, best.deviations(), best.evidence - nothing)


def substantial_effects(fitted: Fit) -> tuple[str, ...]:
    """Effects of a candidate model that are large enough to be named."""
    sizes, same = fitted.sizes(), _same_in_sum(fitted)
    return tuple(e for e in fitted.effects if sizes[e] >= 1 and e not in same)


def _same_in_sum(fitted: Fit) -> frozenset[str]:
    """Effects that delay the motors' response, where others that advance it compensate them
    completely: lag and delay of a response that is not exactly first order, as a file assumes."""
    late = {
        n.effect: fitted.values[n.full] - n.now
        for n in fitted.numbers
        if n.acts or (prior_of(EFFECTS[n.effect]).timed and not n.shape)
    }
    smallest = [n.about.smallest for n in fitted.numbers if n.effect in late and not n.shape]
    back = min(late.values(), default=0.0) < 0 < max(late.values(), default=0.0)
    return frozenset(late) if back and abs(sum(late.values())) < max(smallest) else frozenset()
