"""Numbers that a search may change: those of every observable effect; known payloads."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...effects import EFFECTS, Average, Displacement, Effect, EffectParameter, Equation, Shift
from ...logs import AnyFlight, Flight
from ...logs.columns import ACC_NED, MIN_MOTORS, POS, QUAT, VEL, Array, motor_columns
from ...physics.sensors.table import BODY, SENSORS
from ...representation import ShortRepr
from ...vehicle import Vehicle

Payloads = Mapping[str, float]
"""Payload mass by name of the flight, kg; 0 for flights without an entry."""


def carrying(vehicle: Vehicle, payload_kg: float) -> Vehicle:
    """The vehicle with a point mass at its centre of mass, which leaves the inertia unchanged."""
    return replace(vehicle, mass_kg=vehicle.mass_kg + payload_kg)


STEPS = 30.0
"""Number of difference steps over the range of a number."""
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
"""Flight-table columns of each signal named in `Effect.needs`; for motors, the first column."""
ACCELEROMETER, GYROSCOPE = (s.signal for s in SENSORS if s.group == BODY)
"""Signal names of accelerometer and gyroscope in a flight table."""
PLACE, TURN = ("pos", "vel"), ("q",)
"""Signals of the pose, which may have two clocks."""
DRIVES = ("cmd", "rotor")
"""Signals that drive the airframe; each flight uses one of them."""


@dataclass(frozen=True, slots=True)
class Number(ShortRepr):
    """One number of an effect, scaled to a vehicle.

    Attributes:
        effect: Identifier of the effect.
        name: Name in the FMU, without the effect's name.
        about: Unit, prior and neutral value.
        now: Value in the nominal model: the vehicle's setting, else the neutral value; for a shape
            parameter the start value.
    """

    effect: str
    name: str
    about: EffectParameter
    now: float

    @property
    def full(self) -> str:
        """Full name in the FMU."""
        return f"{self.effect}.{self.name}"

    @property
    def shape(self) -> bool:
        """Whether it is a shape parameter: no value of it makes the effect vanish."""
        return self.about.neutral is None

    @property
    def moves(self) -> tuple[str, ...]:
        """Signals that it shifts in time."""
        how = EFFECTS[self.effect].observable_as
        return how.moves.get(self.name, ()) if isinstance(how, Shift) else ()

    @property
    def acts(self) -> bool:
        """Whether these signals act late; otherwise their readings are old."""
        how = EFFECTS[self.effect].observable_as
        return isinstance(how, Shift) and how.acts

    @property
    def averages(self) -> tuple[str, ...]:
        """Signals that it averages over time."""
        how = EFFECTS[self.effect].observable_as
        return how.spreads.get(self.name, ()) if isinstance(how, Average) else ()

    @property
    def less(self) -> str:
        """Number, "effect.number", from which it is subtracted where the pose predicts a sensor; ""
        for most."""
        how = EFFECTS[self.effect].observable_as
        return how.less[self.name] if isinstance(how, Displacement) else ""

    @property
    def turns_pose(self) -> bool:
        """Whether it rotates the logged attitude about the vertical."""
        how = EFFECTS[self.effect].observable_as
        return isinstance(how, Equation) and how.turns_pose == self.name

    @property
    def step(self) -> float:
        """Step of numerical differentiation by this number."""
        return float(np.ptp(self.about.bounds)) / STEPS


def numbers_of(effects: Iterable[Effect], vehicle: Vehicle) -> list[Number]:
    """All numbers of some effects, shape parameters last."""
    found = []
    for effect in effects:
        settings = vehicle.effects.get(effect.name, {})
        for p in (p.sized(vehicle) for p in effect.parameters):
            rest = p.start if p.neutral is None else p.neutral
            for name in p.names(vehicle):
                found.append(Number(effect.name, name, p, float(settings.get(name, rest))))
    return sorted(found, key=lambda n: n.shape)


def numbers_of_logs(effects: Iterable[Effect], vehicle: Vehicle) -> list[Number]:
    """Numbers of effects that belong to a log, neutral in every model."""
    sized = ((e, p.sized(vehicle)) for e in effects for p in e.of_logs)
    return [Number(e.name, p.name, p, p.neutral or 0.0) for e, p in sized]


def at_voltage(number: Number, flights: Sequence[Flight], vehicle: Vehicle) -> Number:
    """The number with a voltage taken from the flights, where the vehicle has none; other numbers
    unchanged."""
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
    """Whether the effect is observable in every flight."""
    return not any(lacking(effect, flight) for flight in flights)


def lacking(effect: Effect, flight: AnyFlight) -> tuple[str, ...]:
    """Signals of `Effect.needs` whose absence makes an effect unobservable in a flight.

    A velocity is derived from the position. Accelerometer and gyroscope can be replaced by the pose
    for effects on the airframe; not for effects of the IMU, for effects with an observer that needs
    the accelerometer, or for effects without a mean.
    """
    whole = on_the_body(effect) or not flight.derived_angles  # whether the attitude suffices
    return tuple(
        need
        for need in effect.needs
        if not (has_signal(flight, need) and (whole or need not in TURN))
        and not (need == "vel" and flight.has(*POS))
        and not (on_the_body(effect) and pose_shows(need, flight))
    )


def pose_shows(signal: str, flight: AnyFlight) -> bool:
    """Whether the pose of a flight can replace a sensor of the IMU."""
    if signal not in (ACCELEROMETER, GYROSCOPE) or not flight.has(*QUAT):
        return False
    return signal == GYROSCOPE or any(flight.has(*c) for c in (VEL, POS, ACC_NED))


def on_the_body(effect: Effect) -> bool:
    """Whether the effect is observable from the pose alone."""
    observable_as = effect.observable_as
    if effect.component in {s.component for s in SENSORS}:
        return False
    return isinstance(observable_as, Shift) or (
        isinstance(observable_as, Equation) and observable_as.observer is None
    )


def has_signal(flight: AnyFlight, signal: str) -> bool:
    """Whether a flight has a signal named in `Effect.needs`."""
    return flight.has(SIGNALS[signal][0])


# -- which effects a flight shows -------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ObservableEffects:
    """Observability of effects in a flight.

    Attributes:
        effects: Observable effects by the component on which they act.
        unknown: The other effects by the missing signals, as text.
    """

    effects: dict[str, tuple[str, ...]]
    unknown: dict[str, tuple[str, ...]]


def observable_effects(flight: AnyFlight) -> ObservableEffects:
    """Effects that are observable in the columns of a flight, by the rule of the search itself.

    Duration and excitation of the flight are not considered.
    """
    drive = _no_drive(flight)
    observable: dict[str, list[str]] = {}
    unknown: dict[str, list[str]] = {}
    for effect in EFFECTS.values():
        missing = drive or "; ".join(_missing(effect, flight))
        found, key = (unknown, missing) if missing else (observable, effect.component)
        found.setdefault(key, []).append(effect.name)
    return ObservableEffects(
        {k: tuple(v) for k, v in observable.items()}, {k: tuple(v) for k, v in unknown.items()}
    )


def _no_drive(flight: AnyFlight) -> str:
    """Text on what is missing to drive a model, "" where nothing is."""
    for stem in ("cmd", "rotor"):
        count = sum(c.startswith(f"{stem}_") for c in flight.columns)
        if count >= MIN_MOTORS and flight.has(*motor_columns(stem, count)):
            return ""
    return "neither commands cmd_1..n nor speeds rotor_1..n of all motors"


def _missing(effect: Effect, flight: AnyFlight) -> Iterator[str]:
    """Texts on the signals that an effect lacks."""
    instead = {"vel": " (or pos)"}
    if on_the_body(effect):
        instead |= {ACCELEROMETER: " (or q with vel, pos or acc_ned)", GYROSCOPE: " (or q)"}
    for signal in lacking(effect, flight):
        yield f"no {', '.join(SIGNALS[signal])}{instead.get(signal, '')}"


# -- values --------------------------------------------------------------------------------------


def columns_of(numbers: Sequence[Number], effects: Iterable[str]) -> list[int]:
    """Indices of the numbers of some effects, without shape parameters."""
    wanted = set(effects)
    return [i for i, n in enumerate(numbers) if n.effect in wanted and not n.shape]


def with_effects(vehicle: Vehicle, effects: Iterable[str], values: Mapping[str, float]) -> Vehicle:
    """The vehicle with some effects enabled, without those of logs; `values` are "effect.number" ->
    value."""
    settings = {name: dict(numbers) for name, numbers in vehicle.effects.items()}
    for name in (e for e in effects if EFFECTS[e].of_vehicle):
        own = {n.name: n.now for n in numbers_of([EFFECTS[name]], vehicle)}
        settings[name] = {k: values.get(f"{name}.{k}", v) for k, v in own.items()}
    return vehicle.with_effects(settings)


def values_of(numbers: Sequence[Number], change: Mapping[str, float]) -> Array:
    """Values of all numbers with changes ("effect.number" -> value), shape (len(numbers),)."""
    return np.array([change.get(n.full, n.now) for n in numbers])


def lateness_of(numbers: Sequence[Number], theta: Array, signal: str) -> float:
    """Additional delay of a signal against the nominal model, s, at the values `theta`; an older
    reading counts as negative delay."""
    moved = ((n, v) for n, v in zip(numbers, theta.tolist(), strict=True) if v != n.now)
    return float(sum((v - n.now) * (1 if n.acts else -1) for n, v in moved if signal in n.moves))


def age_of(numbers: Sequence[Number], theta: Array, signals: Sequence[str]) -> float:
    """Additional age of some signals against the record, s, at the values `theta`."""
    aged = ((n, v) for n, v in zip(numbers, theta.tolist(), strict=True) if v)
    return float(sum(v for n, v in aged if {*n.moves} & {*signals} and not n.acts))
