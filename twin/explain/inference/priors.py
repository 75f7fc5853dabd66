"""Priors and bounds of the numbers of a model, before its flights are used.

A number that a vehicle file gives with a standard deviation has this uncertainty without any
effect: its spike. A present effect adds its own variance: its slab. Day-to-day variation is added
to both. Bounds are prior ranges and physical limits.

Spike and slab: Mitchell & Beauchamp, J. Am. Stat. Assoc. 83 (1988); George & McCulloch, J. Am.
Stat. Assoc. 88 (1993).
"""

import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, EffectParameter, Shift, prior_of
from ...errors import ModelError
from ...representation import ShortRepr
from ...residuals.channels import Array
from ...vehicle import Vehicle, relative_deviation
from ..model.model import Model
from ..model.numbers import Number

UNCALIBRATED = (
    "{}: holds no [calibration], so what has changed since cannot be told; make one by `uavtwin "
    "calibrate FLIGHT... --vehicle DRAFT --out FILE`."
)  # error; name of the vehicle


@dataclass(frozen=True, slots=True)
class Priors(ShortRepr):
    """Priors of the numbers that a search may change, including shape parameters. Arrays have shape
    (k,).

    Attributes:
        columns: Indices among the numbers of the model.
        names: Name "effect.number" of each.
        cause: Cause to which each belongs: an effect, or its part for one rotor or one clock,
            "effect:part".
        shape: Whether it is a shape parameter, which exists only together with its effect.
        now: Value in the nominal model.
        mean: Prior mean with the effect.
        slab: Prior standard deviation with the effect.
        file: Prior covariance without the effect, shape (k, k).
        low: Lower bound.
        high: Upper bound.
        held: Expected change from `now` without the effect.
        day: Between-flight standard deviation; 0: all flights share it.
        odds: Log prior odds of each cause.
        most: Maximum number of rotors that may differ, by effect of single rotors: half of all.
        ages: Columns whose sum is the age of a signal, by that which varies from day to day.
    """

    columns: tuple[int, ...]
    names: tuple[str, ...]
    cause: tuple[str, ...]
    shape: NDArray[np.bool_]
    now: Array
    mean: Array
    slab: Array
    file: Array
    low: Array
    high: Array
    held: Array
    day: Array
    odds: Mapping[str, float]
    most: Mapping[str, int] = field(default_factory=dict)
    ages: Mapping[int, NDArray[np.intp]] = field(default_factory=dict)

    @property
    def causes(self) -> tuple[str, ...]:
        """Causes that may be present, in the order of the columns, without shape parameters."""
        pairs = zip(self.cause, self.shape, strict=True)
        return tuple(dict.fromkeys(c for c, shape in pairs if not shape and c in self.odds))

    @property
    def spike(self) -> Array:
        """Standard deviation about `now` without the effect, shape (k,)."""
        return np.asarray(np.sqrt(np.diag(self.file)))

    @property
    def tailed(self) -> Array:
        """Standard deviation of each Student prior; 0 for a shape parameter, which is normal."""
        return np.where(self.shape, 0.0, self.slab)

    @property
    def unsure(self) -> frozenset[str]:
        """Effects with a number that is uncertain in the vehicle file."""
        return frozenset(effect_of(self.cause[i]) for i in np.flatnonzero(self.spike > 0))

    @property
    def days(self) -> NDArray[np.intp]:
        """Columns with day-to-day variation."""
        return np.flatnonzero(self.day > 0)

    def log_odds(self, causes: Collection[str]) -> float:
        """Log prior odds of a set of causes; minus infinity where more rotors differ than
        allowed."""
        several = Counter(effect_of(c) for c in causes if c != effect_of(c))
        if any(several[e] > n for e, n in self.most.items()):
            return -math.inf
        return sum(self.odds[c] for c in causes)

    def of(self, causes: Iterable[str]) -> NDArray[np.intp]:
        """Columns of some causes, including shape parameters of their effects."""
        wanted = set(causes)
        wanted |= {effect_of(c) for c in wanted}
        return np.array([i for i, c in enumerate(self.cause) if c in wanted], dtype=np.intp)

    def extended(self, names: Sequence[str], sd: float) -> "Priors":
        """The priors with more numbers, each its own cause with mean 0 and standard deviation
        `sd`."""
        more = 0, len(names)
        return replace(
            self,
            columns=(*self.columns, *[-1] * len(names)),
            names=(*self.names, *names),
            cause=(*self.cause, *names),
            shape=np.pad(self.shape, more),
            now=np.pad(self.now, more),
            mean=np.pad(self.mean, more),
            slab=np.pad(self.slab, more, constant_values=sd),
            file=np.pad(self.file, more),
            low=np.pad(self.low, more, constant_values=-np.inf),
            high=np.pad(self.high, more, constant_values=np.inf),
            held=np.pad(self.held, more),
            day=np.pad(self.day, more),
            odds={**self.odds, **dict.fromkeys(names, 0.0)},
        )

    def tension(self, values: Mapping[str, float]) -> dict[str, float]:
        """Deviation of each value from its prior mean in prior standard deviations; for a positive
        number, such as a factor, in its logarithm; 0 for a fixed one."""
        place = {n: i for i, n in enumerate(self.names)}
        found = {}
        for name, value in values.items():
            if (i := place.get(name)) is None:
                continue
            mean, sd = self.mean[i], self.slab[i]
            if sd == 0:
                found[name] = 0.0
            elif min(self.low[i], mean, value) > 0:
                found[name] = float(abs(np.log(value / mean)) / (sd / mean))
            else:
                found[name] = float(abs(value - mean) / sd)
        return found


def parameter_of(number: Number) -> tuple[EffectParameter, str]:
    """A number's parameter before scaling to a vehicle, and its name."""
    effect = EFFECTS[number.effect]
    known = {p.name: p for p in (*effect.parameters, *effect.of_logs)}
    stem = number.name if number.name in known else number.name.rpartition("_")[0]
    return known[stem], stem


def effect_of(cause: str) -> str:
    """Effect of a cause or of its part."""
    return cause.partition(":")[0]


def _cause_of(number: Number) -> str:
    """Cause of a number: single rotors and single clocks are separate causes."""
    if number.about.per_rotor:
        return f"{number.effect}:{number.name.removeprefix(number.about.name).lstrip('_')}"
    effect = EFFECTS[number.effect]
    several = len(effect.parameters) + len(effect.of_logs) > 1
    if several and isinstance(effect.observable_as, Shift):
        return f"{number.effect}:{number.name}"
    return number.effect


def _unsure(number: Number, vehicle: Vehicle, trusted: bool) -> float:
    """Standard deviation of a number by the vehicle file, without the effect; 0: exact."""
    own = vehicle.deviations.get(f"effects.{number.full}")
    if own is not None and own.numbers is not None:
        return own.numbers[0]
    prior = prior_of(EFFECTS[number.effect])
    known = None if prior.corrects is None else relative_deviation(vehicle, prior.corrects)
    if known is None or (trusted and not known.stated):
        return 0.0
    scale = prior.written or parameter_of(number)[0].scale
    return known.sd * (1.0 if scale is None else scale(vehicle))


def _covariance(numbers: Sequence[Number], sd: Array, vehicle: Vehicle) -> Array:
    """Prior covariance of numbers by the vehicle file, without the effects, given the standard
    deviation of each as written: a torque given per thrust has the uncertainty of the thrust as
    well."""
    file = np.diag(sd**2)
    place = {prior_of(EFFECTS[n.effect]).corrects: i for i, n in enumerate(numbers) if not n.shape}
    thrust, torque = (place.get(f"rotors.{of}") for of in ("thrust", "torque"))
    if thrust is None or torque is None or "rotors.torque_per_thrust" not in vehicle.sources:
        return file
    if sd[torque] > 0:
        file[torque, torque] += sd[thrust] ** 2
        file[thrust, torque] = file[torque, thrust] = sd[thrust] ** 2
    return file


def priors_since(model: Model) -> Priors:
    """Priors of changes since the calibration of an aircraft.

    Raises:
        ModelError: The vehicle holds no calibration.
    """
    known = model.vehicle.calibration
    if known is None:
        raise ModelError(UNCALIBRATED.format(model.vehicle.name))
    usual = priors_of(model)
    indoors = all(f.flight.indoors for f in model.flights)
    place = {n: i for i, n in enumerate(usual.names)}
    inside = [i for i, n in enumerate(known.numbers) if n in place]
    at = np.array([place[known.numbers[i]] for i in inside], dtype=np.intp)
    file = np.zeros_like(usual.file)
    file[np.ix_(at, at)] = known.covariance[np.ix_(inside, inside)]
    held = np.array(
        [known.records.get(n, v) - v for n, v in zip(usual.names, usual.now, strict=True)]
    )
    day, mean, low = usual.day.copy(), usual.now + held, usual.low.copy()
    slab = np.sqrt(np.diag(file))
    for i, (name, cause) in enumerate(zip(usual.names, usual.cause, strict=True)):
        day[i] = known.days.get(name, day[i])
        change = EFFECTS[effect_of(cause)].change
        if change is None:
            continue
        number = model.numbers[usual.columns[i]]
        about, stem = parameter_of(number)
        expected = change.of(stem, indoors).sized(about, model.vehicle)
        mean[i] = expected.mean if usual.shape[i] else mean[i] + expected.mean
        slab[i] = np.hypot(slab[i], expected.sd)
        if change.one_sided and not usual.shape[i]:
            low[i] = usual.now[i]
    changes = {c: EFFECTS[effect_of(c)].change for c in usual.cause}
    odds = {c: change.odds for c, change in changes.items() if change is not None}
    usual = replace(usual, mean=mean, slab=slab, file=file, low=low, held=held, day=day)
    return replace(usual, odds=odds, ages={})


def _lowest(number: Number, vehicle: Vehicle, trusted: bool) -> float:
    """Lower bound of a number: single rotors can only lose thrust, except in a calibration or where
    the file gives one more thrust."""
    if trusted and number.about.per_rotor and not number.shape:
        return min(number.now, number.about.neutral or 0.0)
    least = prior_of(EFFECTS[number.effect]).least(vehicle)
    return number.about.bounds[0] if least is None or number.shape else least


PROPELLERS = 0.03
"""Standard deviation of a rotor's relative thrust: propellers of one batch differ by 2 to 5 %."""


def priors_of(model: Model, trusted: bool = True) -> Priors:
    """Priors of a model's numbers.

    Args:
        model: Flights and vehicle.
        trusted: Whether the vehicle file's numbers are exact except for their written standard
            deviations; otherwise the reliability of their sources counts as well, and each rotor
            has a factor of its own.
    """
    vehicle, numbers = model.vehicle, model.numbers
    indoors = all(f.flight.indoors for f in model.flights)
    effects = list(model.effects)
    columns = [i for i, n in enumerate(numbers) if n.effect in effects]
    own = [numbers[i] for i in columns]
    of_effect = {e: prior_of(EFFECTS[e]) for e in effects}
    mean, slab, day, spike = (np.zeros(len(own)) for _ in range(4))
    for i, n in enumerate(own):
        about, stem = parameter_of(n)
        expected = of_effect[n.effect].of(stem, indoors).sized(about, vehicle)
        if n.shape and n.about.unit == "V":
            expected = of_effect[n.effect].of(stem, indoors).scaled(n.now)
        if not n.shape:
            expected = of_effect[n.effect].change(expected, vehicle)
        in_file = n.effect in vehicle.effects
        mean[i] = n.now if in_file else expected.mean
        slab[i], day[i] = expected.sd, expected.day
        spike[i] = 0.0 if n.shape else _unsure(n, vehicle, trusted)
        if n.about.per_rotor and not n.shape and not trusted:
            spike[i] = max(spike[i], PROPELLERS)
    single = Counter(n.effect for n in own if n.about.per_rotor and not n.shape)
    file = _covariance(own, spike, vehicle)
    clocks = [int(i) for i in np.flatnonzero(day) if own[i].moves]
    return Priors(
        tuple(columns),
        tuple(n.full for n in own),
        tuple(_cause_of(n) for n in own),
        np.array([n.shape for n in own], dtype=np.bool_),
        np.array([n.now for n in own]),
        mean,
        np.hypot(slab, np.sqrt(np.diag(file))),
        file,
        np.array([_lowest(n, vehicle, trusted) for n in own]),
        np.array([n.about.bounds[1] for n in own]),
        np.zeros(len(own)),
        day,
        {_cause_of(n): of_effect[n.effect].odds_for(vehicle) for n in own},
        {e: n // 2 for e, n in single.items()},
        {i: np.flatnonzero([n.moves == own[i].moves for n in own]) for i in clocks},
    )


# -- bounds --------------------------------------------------------------------------------


EDGE = 1e-6
"""Tolerance of a fit at a limit, as a share of the limit's terms."""


@dataclass(frozen=True, slots=True)
class Bounds(ShortRepr):
    """Bounds and linear inequality constraints of k numbers.

    Attributes:
        low: Lower bound of each, shape (k,).
        high: Upper bound of each, shape (k,).
        rows: Weights of each constraint, shape (m, k).
        least: Least value of each weighted sum, shape (m,).
    """

    low: Array
    high: Array
    rows: Array
    least: Array

    @classmethod
    def of(cls, numbers: Sequence[Number], vehicle: Vehicle) -> "Bounds":
        """Bounds by priors and the effects' own limits; the nominal model is always inside."""
        place = {n.full: i for i, n in enumerate(numbers)}
        now = np.array([n.now for n in numbers])
        rows = []
        for effect in dict.fromkeys(n.effect for n in numbers):
            for limit in EFFECTS[effect].limits(vehicle):
                row = np.zeros(len(numbers))
                row[[place[f"{effect}.{k}"] for k in limit.weights]] = [*limit.weights.values()]
                rows.append(row)
        every = np.array(rows).reshape(-1, len(numbers))
        low, high = (np.array([n.about.bounds[i] for n in numbers]) for i in (0, 1))
        return cls(low, high, every, np.minimum(0.0, every @ now))

    def around(self, values: Array) -> "Bounds":
        """Bounds of changes from some values."""
        return Bounds(
            self.low - values, self.high - values, self.rows, self.least - self.rows @ values
        )

    def extended(self, more: int) -> "Bounds":
        """The bounds with more unbounded numbers."""
        none, anything = np.zeros((len(self.rows), more)), np.full(more, np.inf)
        low, high = np.append(self.low, -anything), np.append(self.high, anything)
        return replace(self, low=low, high=high, rows=np.hstack([self.rows, none]))

    def part(self, columns: Sequence[int]) -> "Bounds":
        """Bounds of some of the numbers, with the others fixed."""
        c = np.asarray(columns, dtype=np.intp)
        reach = np.any(self.rows[:, c], axis=1)
        return replace(
            self,
            low=self.low[c],
            high=self.high[c],
            rows=self.rows[reach][:, c],
            least=self.least[reach],
        )

    def inside(self, values: Array, covariance: Array) -> Array:
        """Nearest values inside, in the metric of a fit.

        Args:
            values: Values, shape (..., k).
            covariance: Covariance of the fit, shape (..., k, k).
        """
        values = np.clip(values, self.low, self.high)
        for row, least in zip(self.rows, self.least, strict=True):
            short = np.maximum(least - values @ row, 0.0)
            way = covariance @ row
            values = values + (short / (way @ row))[..., None] * way
        return np.clip(values, self.low, self.high)


def edges(
    numbers: Sequence[Number], values: Mapping[str, float], vehicle: Vehicle
) -> Iterator[tuple[str, str]]:
    """Effects at a bound, and which bound: an indication that another effect is the cause."""
    for n in numbers:
        value = values[n.full]
        at = np.isclose(value, n.about.bounds, rtol=EDGE, atol=0)
        if np.any(at) and value != n.about.neutral and not n.about.ends:
            yield (
                n.effect,
                f"{n.full} = {value:.4g} is at the edge of the range that is considered, "
                f"{n.about.bounds[0]:g} to {n.about.bounds[1]:g}: perhaps another effect is meant",
            )
    for effect in dict.fromkeys(n.effect for n in numbers):
        for limit in EFFECTS[effect].limits(vehicle):
            parts = [w * values[f"{effect}.{k}"] for k, w in limit.weights.items()]
            if sum(parts) <= EDGE * sum(map(abs, parts)):  # all of the allowed sum is used
                yield (
                    effect,
                    f"{effect} is at the edge of what is possible: {limit.meaning}; another "
                    f"effect may be meant",
                )
