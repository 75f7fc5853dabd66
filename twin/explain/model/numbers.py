"""The numbers that a search may change: those of every effect that flights can show."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Effect, EffectParameter
from ...effects.timing import POSE_SAMPLING_S
from ...logs import Flight
from ...vehicle import Vehicle

Array = NDArray[np.float64]
STEMS = {
    "acc": "acc_x",
    "gyro": "gyro_x",
    "mag": "mag_x",
    "pos": "pos_x",
    "vel": "vel_x",
    "q": "q_w",
    "baro": "baro_pa",
    "vbat": "vbat_v",
    "ibat": "ibat_a",
    "cmd": "cmd_1",
}
"""Flight-table column that stands for a signal named in `Effect.needs`."""


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

    @property
    def full(self) -> str:
        """Name in the FMU."""
        return f"{self.effect}.{self.name}"

    @property
    def shape(self) -> bool:
        """Whether it has no value at which the effect vanishes."""
        return self.about.neutral is None

    @property
    def sd(self) -> float:
        """Standard deviation of the prior: a quarter of its range."""
        low, high = self.about.prior
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


IN_LOGS = {
    "heading_offset": EffectParameter(
        "pose_rad", "rad", "logged attitude turned about the vertical", 0.2, (-1.6, 1.6)
    ),
    "position_delay": EffectParameter(
        "attitude_s", "s", "age of the attitude", 0.1, (0, 0.5), trifle=POSE_SAMPLING_S
    ),
}
"""Numbers that effects have in a log alone, and in no component: a compass that is off may have
misled the estimate of the attitude or not; attitude may come from where position does, or not."""


def numbers_of_logs(effects: Iterable[Effect]) -> list[Number]:
    """Numbers that effects have in a log alone."""
    return [
        Number(e.name, IN_LOGS[e.name].name, IN_LOGS[e.name], 0.0)
        for e in effects
        if e.name in IN_LOGS
    ]


def at_voltage(number: Number, flights: Sequence[Flight], vehicle: Vehicle) -> Number:
    """A voltage that the vehicle says nothing about, taken from the flights; others as they are."""
    if number.about.unit != "V" or vehicle.states_voltage:
        return number
    usual = float(np.median(np.concatenate([f.signal(["vbat_v"])[1].ravel() for f in flights])))
    if usual <= 0:
        return number
    ratio = usual / number.about.start
    low, high = number.about.prior
    about = replace(number.about, start=usual, prior=(low * ratio, high * ratio))
    return replace(number, about=about, now=usual)


def visible(effect: Effect, flights: Iterable[Flight]) -> bool:
    """Whether every flight has the signals without which the effect cannot be seen."""
    return all(flight.has(STEMS[need]) for flight in flights for need in effect.needs)


def columns_of(numbers: Sequence[Number], effects: Iterable[str]) -> list[int]:
    """Positions of the numbers of some effects, shapes left out."""
    wanted = set(effects)
    return [i for i, n in enumerate(numbers) if n.effect in wanted and not n.shape]


def with_effects(vehicle: Vehicle, effects: Iterable[str], values: Mapping[str, float]) -> Vehicle:
    """The vehicle with some effects on; `values` are "effect.number" -> value."""
    settings = {name: dict(numbers) for name, numbers in vehicle.effects.items()}
    for name in effects:
        own = {n.name: n.now for n in numbers_of([EFFECTS[name]], vehicle)}
        settings[name] = {k: values.get(f"{name}.{k}", v) for k, v in own.items()}
    return vehicle.with_effects(settings)
