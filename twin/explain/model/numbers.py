"""Numbers that a search may change: those of every effect that flights can show; known payloads."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Average, Effect, EffectParameter, Equation, Shift
from ...logs import AnyFlight, Flight
from ...logs.columns import ACC_NED, POS, QUAT, VEL
from ...physics.sensors.table import BODY, SENSORS
from ...representation import short_repr
from ...vehicle import Vehicle

Payloads = Mapping[str, float]
"""Mass on top of the vehicle's by name of the flight, kg; a flight that is not named has none."""


def carrying(vehicle: Vehicle, payload_kg: float) -> Vehicle:
    """The vehicle with a small heavy thing at its centre of mass: it turns as before."""
    return replace(vehicle, mass_kg=vehicle.mass_kg + payload_kg)


Array = NDArray[np.float64]
STEPS = 30.0
"""Steps of differences over the range of a number."""
SIGNALS: dict[str, tuple[str, ...]] = {
    **{s.signal: s.columns for s in SENSORS},
    "pos": POS,
    "vel": VEL,
    "q": QUAT,
    "vbat": ("vbat_v",),
    "ibat": ("ibat_a",),
    "cmd": ("cmd_1",),
    "rotor": ("rotor_1",),
}
"""Flight-table columns of a signal named in `Effect.needs`; of motors, the first."""
ACCELEROMETER, GYROSCOPE = (s.signal for s in SENSORS if s.group == BODY)
"""Their signals in a flight table."""
PLACE, TURN = ("pos", "vel"), ("q",)
"""Signals of the pose, which may come from two clocks."""
DRIVES = ("cmd", "rotor")
"""Signals that drive the airframe, one of them each."""


@dataclass(frozen=True, slots=True)
class Number:
    """One number of an effect, sized for a vehicle.

    Attributes:
        effect: Identifier.
        name: As in the FMU, without the effect's name.
        about: Unit, prior, neutral value.
        now: Value in the model as it stands: the vehicle's setting, else the neutral value, for a
            shape the start value.
    """

    effect: str
    name: str
    about: EffectParameter
    now: float

    __repr__ = short_repr

    @property
    def full(self) -> str:
        """Name in the FMU."""
        return f"{self.effect}.{self.name}"

    @property
    def shape(self) -> bool:
        """Whether it has no value at which the effect vanishes."""
        return self.about.neutral is None

    @property
    def moves(self) -> tuple[str, ...]:
        """Signals that it shifts in time."""
        observable_as = EFFECTS[self.effect].observable_as
        return observable_as.moves.get(self.name, ()) if isinstance(observable_as, Shift) else ()

    @property
    def acts(self) -> bool:
        """Whether these act late; else what they show is old."""
        observable_as = EFFECTS[self.effect].observable_as
        return isinstance(observable_as, Shift) and observable_as.acts

    @property
    def averages(self) -> tuple[str, ...]:
        """Signals that it smooths."""
        observable_as = EFFECTS[self.effect].observable_as
        return (
            observable_as.spreads.get(self.name, ()) if isinstance(observable_as, Average) else ()
        )

    @property
    def turns_pose(self) -> bool:
        """Whether it turns the logged attitude about the vertical."""
        observable_as = EFFECTS[self.effect].observable_as
        return isinstance(observable_as, Equation) and observable_as.turns_pose == self.name

    @property
    def step(self) -> float:
        """By which it is moved where its answer is a difference."""
        low, high = self.about.bounds
        return (high - low) / STEPS

    @property
    def sd(self) -> float:
        """Standard deviation of the prior: a quarter of its range."""
        low, high = self.about.bounds
        return (high - low) / 4


def numbers_of(effects: Iterable[Effect], vehicle: Vehicle) -> list[Number]:
    """Every number of some effects, shapes behind all others."""
    found = []
    for effect in effects:
        settings = vehicle.effects.get(effect.name, {})
        for p in (p.sized(vehicle) for p in effect.parameters):
            rest = p.start if p.neutral is None else p.neutral
            for name in p.names(vehicle):
                found.append(Number(effect.name, name, p, float(settings.get(name, rest))))
    return sorted(found, key=lambda n: n.shape)


def numbers_of_logs(effects: Iterable[Effect], vehicle: Vehicle) -> list[Number]:
    """Numbers that effects have in a log alone, at rest in every model."""
    sized = ((e, p.sized(vehicle)) for e in effects for p in e.of_logs)
    return [Number(e.name, p.name, p, p.neutral or 0.0) for e, p in sized]


def at_voltage(number: Number, flights: Sequence[Flight], vehicle: Vehicle) -> Number:
    """A voltage that the vehicle says nothing about, taken from the flights; others as they are."""
    if number.about.unit != "V" or vehicle.states_voltage:
        return number
    usual = float(np.median(np.concatenate([f.signal(["vbat_v"])[1].ravel() for f in flights])))
    if usual <= 0:
        return number
    ratio = usual / number.about.start
    low, high = number.about.bounds
    about = replace(number.about, start=usual, bounds=(low * ratio, high * ratio))
    return replace(number, about=about, now=usual)


def visible(effect: Effect, flights: Iterable[Flight]) -> bool:
    """Whether every flight can show the effect."""
    return not any(lacking(effect, flight) for flight in flights)


def lacking(effect: Effect, flight: AnyFlight) -> tuple[str, ...]:
    """Signals of `Effect.needs` for want of which a flight cannot show an effect.

    A velocity is told from the position. What an accelerometer or a gyroscope would feel of the
    airframe is told from the pose; an effect of the IMU is not, nor is one whose states are
    followed by what is felt, nor one without a mean.
    """
    whole = on_the_body(effect) or not flight.derived_angles  # attitude that an effect finds
    return tuple(
        need
        for need in effect.needs
        if not (has_signal(flight, need) and (whole or need not in TURN))
        and not (need == "vel" and flight.has(*POS))
        and not (on_the_body(effect) and pose_shows(need, flight))
    )


def pose_shows(signal: str, flight: AnyFlight) -> bool:
    """Whether the pose of a flight can stand in for a sensor of the IMU."""
    if signal not in (ACCELEROMETER, GYROSCOPE) or not flight.has(*QUAT):
        return False
    return signal == GYROSCOPE or any(flight.has(*c) for c in (VEL, POS, ACC_NED))


def on_the_body(effect: Effect) -> bool:
    """Whether the pose alone can show what an effect does."""
    observable_as = effect.observable_as
    if effect.component in {s.component for s in SENSORS}:
        return False
    return isinstance(observable_as, Shift) or (
        isinstance(observable_as, Equation) and observable_as.observer is None
    )


def has_signal(flight: AnyFlight, signal: str) -> bool:
    """Whether a flight has a signal named in `Effect.needs`."""
    return flight.has(SIGNALS[signal][0])


def columns_of(numbers: Sequence[Number], effects: Iterable[str]) -> list[int]:
    """Positions of the numbers of some effects, shapes left out."""
    wanted = set(effects)
    return [i for i, n in enumerate(numbers) if n.effect in wanted and not n.shape]


def with_effects(vehicle: Vehicle, effects: Iterable[str], values: Mapping[str, float]) -> Vehicle:
    """The vehicle with some effects on; `values` are "effect.number" -> value.

    Effects of records stay out: they are of a flight, not of what flew.
    """
    settings = {name: dict(numbers) for name, numbers in vehicle.effects.items()}
    for name in (e for e in effects if EFFECTS[e].of_vehicle):
        own = {n.name: n.now for n in numbers_of([EFFECTS[name]], vehicle)}
        settings[name] = {k: values.get(f"{name}.{k}", v) for k, v in own.items()}
    return vehicle.with_effects(settings)


def values_of(numbers: Sequence[Number], change: Mapping[str, float]) -> Array:
    """Every number, changed ("effect.number" -> value) or as it is; shape (len(numbers),)."""
    return np.array([change.get(n.full, n.now) for n in numbers])


def lateness_of(numbers: Sequence[Number], theta: Array, signal: str) -> float:
    """By how much a signal acts later than in the model as it stands, s, at the values `theta`:
    what acts late does by its number, what is older than it says was there earlier."""
    moved = ((n, v) for n, v in zip(numbers, theta.tolist(), strict=True) if v != n.now)
    return float(sum((v - n.now) * (1 if n.acts else -1) for n, v in moved if signal in n.moves))


def age_of(numbers: Sequence[Number], theta: Array, signals: Sequence[str]) -> float:
    """By how much some signals are older than the record says, s, at the values `theta`."""
    aged = ((n, v) for n, v in zip(numbers, theta.tolist(), strict=True) if v)
    return float(sum(v for n, v in aged if {*n.moves} & {*signals} and not n.acts))
