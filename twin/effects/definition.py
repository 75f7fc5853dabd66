"""Definition of an effect: a named physical cause with a term in the equations of one component.

A term is a pure function of a stage, the quantities that the component has computed so far, and
returns the stage with some of them changed. `Blocks` puts terms into a component as blocks of
tunable parameters, `<effect>.enabled` first, off by default. A disabled effect is exactly absent:
the quantities are those of the component without the effect, to the last bit.

An effect also declares its properties outside of the equation: prior, change since a calibration,
wording, advice. Each is given, or declined by None; a forgotten one fails on import.

How an effect is observable, which the search uses to find it:

| kind | trace in a record |
|---|---|
| Equation | readings that its component predicts with the effect |
| Shift | signals that are offset in time |
| Average | a pose that is smoother than the motion |
| Displacement | a pose of another point than the sensors assume |
| NoiseFloor | the flat part of a spectrum |
| Lines | lines of a spectrum, at rotor frequency or at a fixed one |
| RandomForce | a slow random force that no curve explains |
| Repeats | readings that are constant |

The first four change a mean, and are fitted together; each of the others has its own rule. Numbers
are referred to by their names within the effect, signals as in `Effect.needs`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import ComponentBuilder
from ..vehicle import Vehicle
from .parameters import RARE, EffectParameter, Normal, Prior
from .wording import Advice, Wording

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Observer:
    """Observer for the states of an effect along a flight, driven by the force that they exert.

    States that a flight does not measure are integrated along its motion. Where their dynamics have
    no damping, such as a pendulum, an error in their start or numbers never decays: an observer
    corrects them with the measured force, from past samples only.

    Attributes:
        follow: `(free_n, excess_n, lag_s, height_m, numbers, step_s, vehicle) -> course`: specific
            force at the centre of mass predicted without the effect, m/s^2, and the excess of the
            accelerometer over its prediction, zero where unknown, both NED, shape (n, 3), the lag
            of the latter, s, and height above the resting place, infinite where unknown, shape
            (n,), to the input of `place`. Of the numbers it uses only the shapes: those without a
            neutral value.
        place: `(states, names, course, free_n, numbers, vehicle) -> states`: the states of the
            airframe, shape (n, n_x), with those of the effect filled in.
        channels: Readings that drive the observer.
        gain_1_s: Bandwidth of the observer's response to such a reading, by the vehicle.
    """

    follow: Callable[[Array, Array, float, Array, Mapping[str, float], float, Vehicle], Any]
    place: Callable[[Array, Sequence[str], Any, Array, Mapping[str, float], Vehicle], Array]
    channels: tuple[str, ...]
    gain_1_s: Callable[[Vehicle], float]


@dataclass(frozen=True, slots=True)
class Equation:
    """Observable in the predictions of its component, by the derivatives of its equations.

    Every state that its term declares is integrated along the measured motion, and again for other
    numbers.

    Attributes:
        observer: Observer of its states, in place of integration.
        turns_pose: Number that rotates the logged attitude about the vertical.
        mistaken_for: Effects that together imitate a part of this one, so that no single step of
            the search adds it; where they are in a model, each part is tried in place of the first.
        scales: Quantity that its numbers multiply, "inertia" or "torque", which no mean determines;
            "": none.
    """

    observer: Observer | None = None
    turns_pose: str | None = None
    mistaken_for: tuple[str, ...] = ()
    scales: str = ""


@dataclass(frozen=True, slots=True)
class Shift:
    """Observable as a shift of signals in time.

    Attributes:
        moves: Signals that each number, s, shifts.
        acts: Whether these signals act later than recorded; else they are older than recorded.
    """

    moves: Mapping[str, tuple[str, ...]]
    acts: bool = False


@dataclass(frozen=True, slots=True)
class Average:
    """Observable in a pose that is a symmetric average over time about each instant.

    Attributes:
        spreads: Signals for which each number, s^2, is the variance of the averaging weights.
    """

    spreads: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Displacement:
    """Observable in a pose whose motion predicts a sensor that sits elsewhere.

    Attributes:
        less: Number of another effect, "effect.number", that each number is subtracted from where a
            sensor is predicted from the pose.
    """

    less: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """Observable in the noise of readings, relative to that of the vehicle file.

    Attributes:
        scale: Number that multiplies the noise of all readings.
        further: Number that adds noise to each signal.
    """

    scale: str
    further: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Lines:
    """Observable in spectral lines above the frequencies of the body's motion.

    Attributes:
        frequency: Number: frequency with the rotors at hover, Hz.
        amplitudes: Number with the amplitude in each signal.
    """

    frequency: str
    amplitudes: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class RandomForce:
    """Observable as a slow random force.

    Attributes:
        intensity: Numbers: standard deviation of the speed of the air along the mean wind, across
            it and down, m/s.
        length: Numbers: length scales in the same directions.
    """

    intensity: tuple[str, str, str]
    length: tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class Repeats:
    """Observable as a reading that is constant.

    Attributes:
        channel: Number: index into `channels`, from 1.
        since: Number: start time, s.
        channels: Columns of the flight table that its component can freeze.
    """

    channel: str
    since: str
    channels: tuple[str, ...] = field(default=())


Observability = (
    Equation | Shift | Average | Displacement | NoiseFloor | Lines | RandomForce | Repeats
)


# -- effects -------------------------------------------------------------------------------


ComponentName = str
"""Name of the component with an effect's term: airframe, environment or a sensor."""
Stage = TypeVar("Stage")
RECORD = "record"
"""Component of effects of a log: no aircraft has them, and no FMU."""


@dataclass(frozen=True, slots=True)
class Limit:
    """Physical limit on an effect's numbers: a weighted sum of them that is not negative.

    Attributes:
        weights: Weight of each number.
        meaning: Reason, as continuation of "is at the edge of what is possible: ".
    """

    weights: Mapping[str, float]
    meaning: str


@dataclass(frozen=True, slots=True)
class Family:
    """Effects with one law but different powers: a flight may determine their sum, but not which of
    them it is. They share a name and a unit, those of the first.

    Attributes:
        name: Name of their sum, in words.
        unit: Unit of the sum, as reported.
        weights: Factor from each "effect.number" to the sum; 1 for the number of the first.
    """

    name: str
    unit: str
    weights: Mapping[str, float]

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects with these numbers."""
        return tuple(dict.fromkeys(full.partition(".")[0] for full in self.weights))

    @property
    def first(self) -> str:
        """The effect that is reported where flights do not determine which one it is."""
        return self.effects[0]


@dataclass(frozen=True, slots=True)
class Period:
    """Time between the sample instants of a memory, in a component without sampling."""

    seconds: float
    description: str


def _no_limits(_: Vehicle) -> tuple[Limit, ...]:
    return ()


@dataclass(frozen=True, slots=True)
class Effect:
    """A physical cause that a model may lack.

    Attributes:
        name: Identifier.
        meaning: One line that a pilot understands.
        component: Name of the component with its term.
        stage: Class of the stage that its term changes.
        parameters: Numbers of the effect.
        needs: Flight-table signals that are necessary to observe it; "q" stands for q_w..q_z, "acc"
            for acc_x..acc_z, and so on.
        source: Paper and equation, or the measurement.
        term: `(stage, block) -> stage`, pure.
        limits: Limits on its numbers together, for a vehicle.
        prior: Prior of the effect; None: rare and uniform over its range.
        change: Prior of a change since a calibration; None: it does not change from one flight to
            the next.
        wording: Clauses on the effect in a report; None: only its numbers are reported.
        advice: Manoeuvres to fly where its numbers are undetermined, by number or by the start of
            its name, "" for all others; None: nothing in particular.
        observable_as: Way in which a flight makes the effect observable.
        of_logs: Numbers that it has in a log only, not in a component.
        period: Sample period of the airframe for its memory; None: it has no memory there.
        of_weather: Whether it depends on the day: an estimate from one flight is not valid for
            others.
    """

    name: str
    meaning: str
    component: ComponentName
    stage: type[Any]
    parameters: tuple[EffectParameter, ...]
    needs: tuple[str, ...]
    source: str
    term: Callable[[Any, "Block"], Any] = field(repr=False)
    limits: Callable[[Vehicle], tuple[Limit, ...]] = field(default=_no_limits, repr=False)
    _: KW_ONLY
    prior: Prior | None
    change: Prior | None
    wording: Wording | None
    advice: Mapping[str, Advice] | None
    observable_as: Observability = field(default_factory=Equation)
    of_logs: tuple[EffectParameter, ...] = ()
    period: Period | None = None
    of_weather: bool = False

    @property
    def in_the_air(self) -> bool:
        """Whether it changes how the aircraft flies; else it changes sensors or records."""
        return self.component in ("airframe", "environment")

    @property
    def of_vehicle(self) -> bool:
        """Whether an aircraft can have it; else only a record has it."""
        return self.component != RECORD

    @property
    def observer(self) -> Observer | None:
        """Observer of its states; None without one."""
        return self.observable_as.observer if isinstance(self.observable_as, Equation) else None

    @property
    def mistaken_for(self) -> tuple[str, ...]:
        """Effects that imitate it, as in `Equation.mistaken_for`."""
        return self.observable_as.mistaken_for if isinstance(self.observable_as, Equation) else ()

    def starts(self, vehicle: Vehicle) -> dict[str, float]:
        """Numbers of the effect by name, each at its start value."""
        sized = [p.sized(vehicle) for p in self.parameters]
        return {name: p.start for p in sized for name in p.names(vehicle)}


def effect_of_records(
    name: str,
    meaning: str,
    numbers: tuple[EffectParameter, ...],
    needs: tuple[str, ...],
    source: str,
    observable_as: Observability,
    *,
    prior: Prior | None,
    change: Prior | None,
    wording: Wording | None,
    advice: Mapping[str, Advice] | None,
) -> Effect:
    """An effect without a term in any component. Arguments as in `Effect`."""
    return Effect(
        name,
        meaning,
        RECORD,
        object,
        (),
        needs,
        source,
        lambda stage, _: stage,
        prior=prior,
        change=change,
        wording=wording,
        advice=advice,
        observable_as=observable_as,
        of_logs=numbers,
    )


def prior_of(effect: Effect) -> Prior:
    """Prior of an effect; without one, rare and uniform over its range."""
    if effect.prior is not None:
        return effect.prior
    numbers = {}
    for p in (*effect.parameters, *effect.of_logs):
        low, high = p.bounds
        middle = (low + high) / 2 if p.neutral is None else p.neutral
        numbers[p.name] = Normal(middle, (high - low) / 4)
    return Prior(RARE, "a quarter of the range: nothing else is known", numbers)


class Block:
    """Parameters and states of one effect inside a component."""

    def __init__(self, m: ComponentBuilder, effect: Effect, vehicle: Vehicle) -> None:
        self._m, self._effect = m, effect
        settings = vehicle.effects.get(effect.name)
        self.enabled = m.parameter(
            f"{effect.name}.enabled",
            float(settings is not None),
            "1",
            f"Whether this acts: {effect.meaning}",
            kind="boolean",
            minimum=0,
            maximum=1,
        )
        self._values: dict[str, list[ca.SX]] = {}
        for parameter in effect.parameters:
            sized = parameter.sized(vehicle)
            self._values[parameter.name] = [
                m.parameter(
                    f"{effect.name}.{name}",
                    (settings or {}).get(name, sized.start),
                    parameter.unit,
                    f"{effect.name}: {parameter.description}",
                    kind=parameter.kind,
                )
                for name in parameter.names(vehicle)
            ]

    def __getitem__(self, name: str) -> ca.SX:
        """Symbol of a parameter."""
        (value,) = self._values[name]
        return value

    def each(self, name: str) -> list[ca.SX]:
        """Symbols of a parameter that each rotor has."""
        return self._values[name]

    def state(self, name: str, unit: str, description: str, initial: ca.SX | float = 0.0) -> ca.SX:
        """Declare a state of the effect; it is constant while the effect is off."""
        full = f"{self._effect.name}.{name}"
        return self._m.state(full, unit, f"{self._effect.name}: {description}", initial)

    def start(self, name: str, unit: str, description: str) -> ca.SX:
        """Declare an initial value, 0 for a state that starts at its default."""
        full = f"initial.{self._effect.name}.{name}"
        meaning = f"{self._effect.name}: initial {description}"
        return self._m.parameter(full, 0.0, unit, meaning, fixed=True)

    def derivative(self, name: str, rate: ca.SX) -> None:
        """Give the time derivative of a state of the effect."""
        self._m.derivative(f"{self._effect.name}.{name}", ca.if_else(self.enabled, rate, 0.0))

    def memory(self, name: str, unit: str, description: str, initial: ca.SX | float = 0.0) -> ca.SX:
        """Declare a state that changes at sample instants only."""
        full = f"{self._effect.name}.{name}"
        return self._m.memory(full, unit, f"{self._effect.name}: {description}", initial)

    def update(self, name: str, value: ca.SX) -> None:
        """Give the value of a memory of the effect from each sample instant on."""
        self._m.update(f"{self._effect.name}.{name}", value)

    def noise(self) -> ca.SX:
        """A standard normal draw, new at each sample instant, 0 while off; for use in updates."""
        return self._m.noise(self.enabled)

    def crossing(self, name: str, unit: str, description: str, expression: ca.SX) -> None:
        """Declare that derivatives are discontinuous where an expression changes sign; the
        expression is 1 while the effect is off."""
        self._m.crossing(
            f"{self._effect.name}.{name}",
            unit,
            f"{self._effect.name}: {description}",
            ca.if_else(self.enabled, expression, 1.0),
        )

    def delayed(self, name: str, signal: ca.SX, delay_s: ca.SX, samples: int) -> ca.SX:
        """Delayed signal at each sample instant; for use in updates."""
        return self._m.delayed(f"{self._effect.name}.{name}", signal, delay_s, samples)


class Blocks:
    """The effects of one component, applied stage by stage during its construction.

    Attributes:
        switches: Symbols of the `<effect>.enabled` parameters so far.
        sampled: Symbols of the switches of effects with sample instants.
    """

    def __init__(self, m: ComponentBuilder, vehicle: Vehicle, effects: Iterable[Effect]) -> None:
        self._m, self._vehicle, self._effects = m, vehicle, list(effects)
        self.switches: list[ca.SX] = []
        self.sampled: list[ca.SX] = []

    def apply(self, stage: Stage) -> Stage:
        """The stage after all effects that change its class, each enabled by its switch."""
        for effect in self._effects:
            if effect.stage is not type(stage):
                continue
            block = Block(self._m, effect, self._vehicle)
            self.switches.append(block.enabled)
            if effect.period is not None:
                self.sampled.append(block.enabled)
            stage = _blend(block.enabled, effect.term(stage, block), stage)
        return stage

    def include(self, name: str) -> bool:
        """Whether the component was built with an effect, on or off."""
        return any(e.name == name for e in self._effects)

    def off(self) -> ca.SX:
        """Expression: no effect is switched on."""
        return sum(self.switches, start=ca.SX(0)) == 0

    def idle(self) -> None:
        """Let the component skip the effects while all of them are off; called at its end."""
        if self.switches:
            self._m.idle_while(self.off(), ca.SX.sym("step"), self.switches)


def _blend(enabled: ca.SX, changed: Stage, old: Stage) -> Stage:
    """For each field the changed value where the effect is on, the old one where it is off."""
    values = {
        f.name: _choose(enabled, getattr(changed, f.name), getattr(old, f.name))
        for f in fields(old)  # type: ignore[arg-type]
        if getattr(changed, f.name) is not getattr(old, f.name)
    }
    return replace(old, **values)  # type: ignore[type-var]


def _choose(enabled: ca.SX, new: Any, old: Any) -> Any:
    if isinstance(old, ca.SX | float | int):
        return ca.if_else(enabled, new, old)
    return [_choose(enabled, a, b) for a, b in zip(new, old, strict=True)]
