"""A vehicle's model with its flights, as residuals that answer to the numbers of effects."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...effects import EFFECTS, Average, Effect, Equation, Shift, acting_late
from ...errors import LogError
from ...logs import Flight
from ...physics.airframe import airframe
from ...representation import short_repr
from ...residuals.channels import ChannelData
from ...residuals.teacher_forced import choose_drive
from ...vehicle import Vehicle
from .flight import FlightModel, missing_imu_signals
from .numbers import DRIVES, Number, at_voltage, has_signal, numbers_of, numbers_of_logs, visible
from .payload import Payloads, carrying
from .prediction import Physics

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Model:
    """All flights of one vehicle.

    Attributes:
        vehicle: The model as it stands.
        effects: Effects that all flights can show.
        numbers: Every number of these.
        flights: One per flight.
        unobservable: Effects that have no place in the airframe of some flight: where measured
            rotor speeds drive it, nothing between command and rotor.
        days: Per flight, what its day adds to numbers, "effect.number" -> difference; empty where
            all flights share all numbers.
    """

    vehicle: Vehicle
    effects: tuple[str, ...]
    numbers: tuple[Number, ...]
    flights: tuple[FlightModel, ...]
    unobservable: tuple[str, ...] = ()
    days: tuple[Mapping[str, float], ...] = ()

    __repr__ = short_repr

    def channels(
        self, columns: Sequence[int], change: Mapping[str, float] | None = None
    ) -> list[list[ChannelData]]:
        """Channels of each flight, the same ones in the same order.

        Args:
            columns: Numbers to differentiate by.
            change: "effect.number" -> value, for those that differ from the model as it stands.
        """
        rows = [f.channels(columns, self._of(i, change)) for i, f in enumerate(self.flights)]
        shared = [c.name for c in rows[0] if all(c.name in {d.name for d in r} for r in rows)]
        return [[next(c for c in r if c.name == name) for name in shared] for r in rows]

    def _of(self, flight: int, change: Mapping[str, float] | None) -> Mapping[str, float] | None:
        """Numbers of one flight, its day with them."""
        day = self.days[flight] if self.days else {}
        now = {n.full: n.now for n in self.numbers if n.full in day} | dict(change or {})
        return now | {name: now[name] + more for name, more in day.items()} if day else change


def candidates(flights: Sequence[Flight]) -> list[Effect]:
    """Effects that change a mean, of which all flights have the signals."""
    return [e for e in EFFECTS.values() if has_mean(e) and visible(e, flights)]


def has_mean(effect: Effect) -> bool:
    """Whether an effect changes a mean."""
    return isinstance(effect.observable_as, Equation | Shift | Average)


def model_of(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    effects: Sequence[Effect],
    progress: Callable[[float], None] = lambda _: None,
    payloads: Payloads | None = None,
) -> Model:
    """Put flights on their grids and differentiate the model.

    Args:
        flights: As read.
        vehicle: The model as it stands.
        effects: Effects whose numbers may change.
        progress: Called with the share done.
        payloads: Known masses aboard.

    Raises:
        LogError: A flight cannot be compared with this vehicle, or no flight is long enough.
    """
    masses = [(payloads or {}).get(f.name, 0.0) for f in flights]
    flown = {m: carrying(vehicle, m) for m in masses}
    kinds = [(choose_drive(f, flown[m]), m) for f, m in zip(flights, masses, strict=True)]
    standing = [e.name for e in effects if isinstance(e.observable_as, Equation)]
    bodies = {k: airframe(flown[k[1]], k[0], standing) for k in kinds}
    wanted = {e.name: e for e in (*effects, *acting_late())}.values()
    unobservable = [e.name for e in wanted if not all(_has_place(b, e) for b in bodies.values())]
    if unobservable:
        effects = [e for e in effects if e.name not in unobservable]
        standing = [name for name in standing if name not in unobservable]
        bodies = {k: airframe(flown[k[1]], k[0], standing) for k in kinds}
    own = (at_voltage(n, flights, vehicle) for n in numbers_of(effects, vehicle))
    of_logs = numbers_of_logs(effects, vehicle)
    numbers = (*(n for n in of_logs if _is_identifiable(n, flights, bodies.values())), *own)
    predicted = {k: Physics(b, flown[k[1]], standing, numbers) for k, b in bodies.items()}
    made, missing = [], missing_imu_signals(flights)
    for i, (flight, kind) in enumerate(zip(flights, kinds, strict=True)):
        made.append(
            FlightModel(flight, flown[kind[1]], predicted[kind], standing, numbers, missing)
        )
        progress((i + 1) / len(flights))
    names = tuple(e.name for e in effects)
    model = Model(vehicle, names, numbers, tuple(made), tuple(unobservable))
    if not model.channels([])[0]:
        raise LogError(
            f"{', '.join(f.name for f in flights)}: no reading that all have is known for long "
            f"enough in the air; the search needs accelerometer, gyroscope or a pose with "
            f"attitude, with motor commands, for some seconds of flight."
        )
    return model


def _is_identifiable(
    number: Number, flights: Sequence[Flight], bodies: Iterable[Component]
) -> bool:
    """Whether some flight shows a signal whose time a number of logs is about; else all do."""
    signals = (*number.moves, *number.averages)
    drives = tuple(f"{s}_" for s in signals if s in DRIVES)
    if drives:
        return any(name.startswith(drives) for b in bodies for name in b.input_names)
    return not signals or any(has_signal(f, s) for f in flights for s in signals)


def _has_place(body: Component, effect: Effect) -> bool:
    """Whether an airframe has what the effect acts on; an effect of a sensor always has it."""
    observable_as = effect.observable_as
    if isinstance(observable_as, Shift) and observable_as.acts:
        moved = [f"{s}_" for signals in observable_as.moves.values() for s in signals]
        return any(name.startswith(tuple(moved)) for name in body.input_names)
    if effect.component != body.name or not isinstance(observable_as, Equation):
        return True
    return any(v.name == f"{effect.name}.enabled" for v in body.parameters)
