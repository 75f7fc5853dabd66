"""A vehicle's model with its flights, as residuals that answer to the numbers of effects."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Effect
from ...errors import LogError
from ...logs import Flight
from ...physics.rotors import Drive
from ...residuals.teacher_forced import choose_drive
from ...vehicle import Vehicle
from .channels import ChannelData
from .flight import FlightModel, in_equations
from .numbers import Number, at_voltage, numbers_of, numbers_of_logs, visible
from .payload import Payloads, carrying
from .prediction import Batch, physics

Array = NDArray[np.float64]
NOT_A_MEAN = ("stuck_sensor", "sensor_noise_level", "vibration", "gust")
"""Effects that change no mean: they are found in other ways."""


@dataclass(frozen=True, slots=True)
class Model:
    """All flights of one vehicle.

    Attributes:
        vehicle: The model as it stands.
        effects: Effects that all flights can show.
        numbers: Every number of these.
        flights: One per flight.
    """

    vehicle: Vehicle
    effects: tuple[str, ...]
    numbers: tuple[Number, ...]
    flights: tuple[FlightModel, ...]

    def channels(
        self, columns: Sequence[int], change: Mapping[str, float] | None = None
    ) -> list[list[ChannelData]]:
        """Channels of each flight, the same ones in the same order.

        Args:
            columns: Numbers to differentiate by.
            change: "effect.number" -> value, for those that differ from the model as it stands.
        """
        rows = [f.channels(columns, change) for f in self.flights]
        shared = [c.name for c in rows[0] if all(c.name in {d.name for d in r} for r in rows)]
        return [[next(c for c in r if c.name == name) for name in shared] for r in rows]


def candidates(flights: Sequence[Flight]) -> list[Effect]:
    """Effects that all flights can show as a change of a mean."""
    return [e for e in EFFECTS.values() if e.name not in NOT_A_MEAN and visible(e, flights)]


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
    own = (at_voltage(n, flights, vehicle) for n in numbers_of(effects, vehicle))
    numbers = (*numbers_of_logs(effects), *own)
    names = [n.full for n in numbers]
    standing = [e.name for e in effects if in_equations(e)]
    bodies: dict[tuple[Drive, float], Batch] = {}
    made = []
    for i, flight in enumerate(flights):
        payload_kg = (payloads or {}).get(flight.name, 0.0)
        flown = carrying(vehicle, payload_kg)
        kind = choose_drive(flight, flown), payload_kg
        if kind not in bodies:
            _, bodies[kind] = physics(flown, kind[0], standing, names)
        made.append(FlightModel(flight, flown, bodies[kind], standing, numbers))
        progress((i + 1) / len(flights))
    model = Model(vehicle, tuple(e.name for e in effects), numbers, tuple(made))
    if not model.channels([])[0]:
        raise LogError(
            f"{flights[0].name}: no reading is known for long enough in the air; the search needs "
            f"accelerometer or gyroscope, with motor commands, for some seconds of flight."
        )
    return model
