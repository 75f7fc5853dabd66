"""What an effect is: a named physical cause with a term in the equations of one component.

A term is a pure function of a stage, the quantities that the component has computed so far, and
gives the stage back with some of them changed. `Blocks` puts terms into a component as blocks of
tunable parameters, `<effect>.enabled` first, off by default. What is off is left out exactly:
the quantities are those of the component without the effect, to the last bit.

An effect also declares what everybody beyond its equation needs: prior, change since a calibration,
wording, advice. Each is given, or declined by None; one that is forgotten does not import.

How an effect is observable, which is what a search uses to find it:

| kind | what it leaves in a record |
|---|---|
| Equation | readings that its component, with it, predicts |
| Shift | signals that are apart in time |
| Average | a pose that is smoother than the motion |
| NoiseFloor | the flat part of a spectrum |
| Lines | lines of a spectrum, which follow the rotors or stand still |
| RandomForce | a slow random force that no curve explains |
| Repeats | readings that stand still |

The first three change a mean, and are fitted together; each of the others is found by its own rule.
Numbers are given by their names within the effect, signals as in `Effect.needs`.
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
    """Follows the states of an effect along a flight by the force that they exert.

    States that a flight does not measure are integrated along its motion. Where they forget
    nothing, such as those of a pendulum, an error of their start or their numbers never dies out:
    an observer pulls them towards what the flight shows, with what is past alone.

    Attributes:
        follow: `(free_n, excess_n, height_m, numbers, step_s, vehicle) -> course`: the specific
            force, m/s^2, that is predicted without the effect, and what the accelerometer reads
            beyond that, zero where unknown, both NED, shape (n, 3), and the height over where the
            vehicle stood, infinite where it never stood or no position is known, shape (n,), to
            whatever `place` needs. It uses the shapes alone of the numbers: those without a neutral
            value.
        place: `(states, names, course, free_n, numbers, vehicle) -> states`: the states of the
            airframe, shape (n, n_x), those of the effect filled in.
        channels: Readings by which it follows.
        gain_1_s: How fast what it follows answers to one of them, by the vehicle.
    """

    follow: Callable[[Array, Array, Array, Mapping[str, float], float, Vehicle], Any]
    place: Callable[[Array, Sequence[str], Any, Array, Mapping[str, float], Vehicle], Array]
    channels: tuple[str, ...]
    gain_1_s: Callable[[Vehicle], float]


@dataclass(frozen=True, slots=True)
class Equation:
    """In what its component predicts, by the derivatives of its equations.

    Every state that its term declares is integrated along the measured motion, again for other
    numbers.

    Attributes:
        observer: Follows its states instead.
        turns_pose: Number that turns the logged attitude about the vertical.
        mistaken_for: Effects that together do much of what one part of it does, so that no step
            from none of it on leads to it; where one of them is, each part is tried in the place
            of the first.
        scales: Which factor its numbers are, "inertia" or "torque", which no mean tells; "": none.
    """

    observer: Observer | None = None
    turns_pose: str | None = None
    mistaken_for: tuple[str, ...] = ()
    scales: str = ""


@dataclass(frozen=True, slots=True)
class Shift:
    """In time.

    Attributes:
        moves: Signals that each number, s, shifts.
        acts: Whether these signals act later than the record says; else what they show is older.
    """

    moves: Mapping[str, tuple[str, ...]]
    acts: bool = False


@dataclass(frozen=True, slots=True)
class Average:
    """In a pose that is an average over time, as far before each instant as after it.

    Attributes:
        spreads: Signals for which each number, s^2, is the variance of the weights.
    """

    spreads: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """In the noise of readings against that of the vehicle file.

    Attributes:
        scale: Number that multiplies the noise of all of them.
        further: Number that adds noise to each signal.
    """

    scale: str
    further: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Lines:
    """In lines above the motion of the body.

    Attributes:
        frequency: Number: frequency with the rotors at hover, Hz.
        amplitudes: Number of the amplitude in each signal.
    """

    frequency: str
    amplitudes: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class RandomForce:
    """In a slow random force.

    Attributes:
        intensity: Numbers: standard deviation of the speed of the air along the mean wind, across
            it and down, m/s.
        length: Numbers: length scales of the same.
    """

    intensity: tuple[str, str, str]
    length: tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class Repeats:
    """In a reading that stands still.

    Attributes:
        channel: Number: which of `channels`, from 1.
        since: Number: from when on, s.
        channels: Columns of the flight table that its component can hold still.
    """

    channel: str
    since: str
    channels: tuple[str, ...] = field(default=())


Observability = Equation | Shift | Average | NoiseFloor | Lines | RandomForce | Repeats


# -- effects -------------------------------------------------------------------------------


ComponentName = str
"""Name of the component that an effect stands in: of the airframe, the environment or a sensor."""
Stage = TypeVar("Stage")
RECORD = "record"
"""In the place of a component, for effects of a log: no aircraft has them, and no FMU."""


@dataclass(frozen=True, slots=True)
class Limit:
    """What nature allows of an effect's numbers: a weighted sum of them that is not negative.

    Attributes:
        weights: By number.
        meaning: Why, to be read after "is at the edge of what is possible: ".
    """

    weights: Mapping[str, float]
    meaning: str


@dataclass(frozen=True, slots=True)
class Family:
    """Effects of one law with different powers: a flight may tell what they make together, and not
    which of them it is. They share a name and a figure, those of the first.

    Attributes:
        name: What they make together, in words.
        unit: Of the figure, as it is told.
        weights: "effect.number" -> what makes it that; 1 for the number of the first.
    """

    name: str
    unit: str
    weights: Mapping[str, float]

    @property
    def effects(self) -> tuple[str, ...]:
        """Whose numbers these are."""
        return tuple(dict.fromkeys(full.partition(".")[0] for full in self.weights))

    @property
    def first(self) -> str:
        """The effect as which it is told where flights do not tell which it is."""
        return self.effects[0]


@dataclass(frozen=True, slots=True)
class Period:
    """Time between the sample instants of memory, in a component that has none by itself."""

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
        component: Where its term stands.
        stage: Class of the stage that its term changes.
        parameters: Its numbers.
        needs: Flight-table signals without which it cannot be seen; "q" stands for q_w..q_z,
            "acc" for acc_x..acc_z, and so on.
        source: Paper and equation, or the measurement.
        term: `(stage, block) -> stage`, pure.
        limits: What its numbers together can be, for a vehicle.
        prior: What is expected of it; None: that it is rare and anywhere in its range.
        change: What is expected of a change since a calibration; None: it does not change from one
            flight to the next.
        wording: Its clauses in a report; None: its numbers alone are given.
        advice: What to fly where its numbers are undetermined, by number or by the beginning of its
            name, "" for all others; None: nothing in particular.
        observable_as: How a flight shows it.
        of_logs: Numbers that it has in a log alone, and in no component.
        period: How often the airframe is sampled for its memory; None: it has no memory there.
        of_weather: Whether the day brings it: what a flight tells of it holds for no other.
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
        """Whether it changes how the aircraft flies; else what its sensors or its record say."""
        return self.component in ("airframe", "environment")

    @property
    def of_vehicle(self) -> bool:
        """Whether an aircraft can have it; else it is of a record alone."""
        return self.component != RECORD

    @property
    def observer(self) -> Observer | None:
        """What follows its states, if something does."""
        return self.observable_as.observer if isinstance(self.observable_as, Equation) else None

    @property
    def mistaken_for(self) -> tuple[str, ...]:
        """See `Equation.mistaken_for`."""
        return self.observable_as.mistaken_for if isinstance(self.observable_as, Equation) else ()

    def starts(self, vehicle: Vehicle) -> dict[str, float]:
        """Its numbers by name, each at its start value."""
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
    """An effect without a term in any component. Arguments as of `Effect`."""
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
    """Of an effect; of one without a prior, that it is rare and anywhere in its range."""
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
        """Symbols of a parameter that every rotor has."""
        return self._values[name]

    def state(self, name: str, unit: str, description: str, initial: ca.SX | float = 0.0) -> ca.SX:
        """Declare a state of the effect; it rests while the effect is off."""
        full = f"{self._effect.name}.{name}"
        return self._m.state(full, unit, f"{self._effect.name}: {description}", initial)

    def start(self, name: str, unit: str, description: str) -> ca.SX:
        """Declare a start value, 0 for a state that starts where it would by itself."""
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
        """Say that derivatives jump where an expression changes sign; 1 while the effect is off."""
        self._m.crossing(
            f"{self._effect.name}.{name}",
            unit,
            f"{self._effect.name}: {description}",
            ca.if_else(self.enabled, expression, 1.0),
        )

    def delayed(self, name: str, signal: ca.SX, delay_s: ca.SX, samples: int) -> ca.SX:
        """What a signal was a while before each sample instant; for use in updates."""
        return self._m.delayed(f"{self._effect.name}.{name}", signal, delay_s, samples)


class Blocks:
    """The effects of one component, applied stage by stage while it is being built.

    Attributes:
        switches: Symbols of the `<effect>.enabled` parameters so far.
        sampled: Those of effects that act at sample instants.
    """

    def __init__(self, m: ComponentBuilder, vehicle: Vehicle, effects: Iterable[Effect]) -> None:
        self._m, self._vehicle, self._effects = m, vehicle, list(effects)
        self.switches: list[ca.SX] = []
        self.sampled: list[ca.SX] = []

    def apply(self, stage: Stage) -> Stage:
        """The stage after all effects that change its class, each blended in by its switch."""
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
        """Let the component leave the effects out while all of them are off; said at its end."""
        if self.switches:
            self._m.idle_while(self.off(), ca.SX.sym("step"), self.switches)


def _blend(enabled: ca.SX, changed: Stage, old: Stage) -> Stage:
    """Field by field the changed value where the effect is on, the old one where it is off."""
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
