"""From cases to flights, vehicle files and truth."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd

from .cases import Case
from .gap import gap_json, true_gap
from .life.log import as_logged
from .planning import aircraft_of, plan
from .plants.aircraft import vehicle_toml
from .plants.kinds import PLANTS
from .plants.noise import NOISE
from .plants.own.flight import fly
from .plants.own.physics import Simulator, own_dynamics
from .plants.sensing import flight_table
from .truth import life_json, truth_json


@dataclass(frozen=True)
class Produced:
    """One finished case.

    Attributes:
        case: What it is.
        flights: Flight tables by name.
        vehicle: Text of the vehicle file.
        truth: What the truth file holds.
    """

    case: Case
    flights: dict[str, pd.DataFrame]
    vehicle: str
    truth: dict[str, Any]


def produce(batch: list[Case]) -> Iterator[Produced]:
    """Fly cases of one plant all at once, with aircraft that may fly together."""
    _, dynamics = PLANTS[batch[0].plant].load(batch[0].aircraft)
    plans = [plan(case) for case in batch]
    trace = fly([order for p in plans for order in p.flights.values()], dynamics)
    pure = own_dynamics if isinstance(dynamics, Simulator) else dynamics
    first = 0
    for case, planned in zip(batch, plans, strict=True):
        rows = range(first, first + len(planned.flights))
        first += len(planned.flights)
        aircraft = planned.file.believed if planned.file else aircraft_of(case)
        gaps = [
            true_gap(aircraft, order.plant, trace, i, pure)
            for i, order in zip(rows, planned.flights.values(), strict=True)
        ]
        yield Produced(
            case,
            {
                name: as_logged(flight_table(order, trace, i), trace.rotor[:, :, i], case.life)
                for i, (name, order) in zip(rows, planned.flights.items(), strict=True)
            },
            vehicle_toml(
                aircraft,
                NOISE[case.noise],
                planned.file.sd if planned.file else None,
                case.life.rotors,
            ),
            {
                **truth_json(case, planned.truth),
                "aircraft": aircraft.name,
                "gap": gap_json(gaps),
                **(life_json(case, planned, trace, rows[-1], pure) if case.life.key else {}),
            },
        )
