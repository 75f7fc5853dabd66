"""From the name of an effect to flights, vehicle file and truth."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from .cases import MAGNITUDES, Case
from .gap import gap_json, true_gap
from .hiding.effect import Number, Truth
from .plants.aircraft import Aircraft, vehicle_toml
from .plants.kinds import EFFECTS, PLANTS
from .plants.missions import mission
from .plants.noise import NOISE
from .plants.orders import Order
from .plants.own.flight import fly
from .plants.own.parameters import Parameters
from .plants.own.physics import Simulator, own_dynamics
from .plants.sensing import flight_table

FLIGHTS = {"fit_1": "tour", "fit_2": "forward", "holdout_1": "tour"}
"""Mission of each flight of a case."""
_CHARGES = {"fit_1": 0.95, "fit_2": 0.75, "holdout_1": 0.55}
"""State of charge at the start: one battery, flight after flight."""


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


def aircraft_of(case: Case) -> Aircraft:
    """The aircraft that flies a case."""
    return PLANTS[case.plant].load(case.aircraft)[0]


def hide(case: Case) -> tuple[Parameters, dict[str, Truth]]:
    """The plant of a case, and its truth by effect."""
    aircraft = aircraft_of(case)
    plant, truth = aircraft.nominal, {}
    for place, name in enumerate(case.effects):
        rng = np.random.default_rng([case.entropy, place])
        effect = EFFECTS[name]
        size = effect.sizes[MAGNITUDES.index(case.magnitude)] * float(rng.uniform(0.8, 1.2))
        plant, truth[name] = effect.hide(plant, aircraft, size, rng)
    return plant, truth


def orders(case: Case, plant: Parameters) -> dict[str, Order]:
    """The flights of a case."""
    aircraft = aircraft_of(case)
    return {
        name: Order(
            aircraft,
            replace(plant, charge=_CHARGES[name]),
            mission(
                kind,
                aircraft.nominal.leg,
                aircraft.pace,
                np.random.default_rng([case.entropy, 100 + place]),
            ),
            NOISE[case.noise],
            (case.entropy, 200 + place),
        )
        for place, (name, kind) in enumerate(FLIGHTS.items())
    }


def produce(batch: list[Case]) -> Iterator[Produced]:
    """Fly cases of one plant all at once, with aircraft that may fly together."""
    _, dynamics = PLANTS[batch[0].plant].load(batch[0].aircraft)
    hidden = [hide(case) for case in batch]
    wanted = [orders(case, plant) for case, (plant, _) in zip(batch, hidden, strict=True)]
    flat = [order for flights in wanted for order in flights.values()]
    trace = fly(flat, dynamics)
    pure = own_dynamics if isinstance(dynamics, Simulator) else dynamics
    first = 0
    for case, (plant, truth), flights in zip(batch, hidden, wanted, strict=True):
        rows = range(first, first + len(flights))
        first += len(flights)
        aircraft = aircraft_of(case)
        yield Produced(
            case,
            {
                name: flight_table(order, trace, i)
                for i, (name, order) in zip(rows, flights.items(), strict=True)
            },
            vehicle_toml(aircraft, NOISE[case.noise]),
            {
                **truth_json(case, truth),
                "aircraft": aircraft.name,
                "gap": gap_json([true_gap(aircraft, plant, trace, i, pure) for i in rows]),
            },
        )


def truth_json(case: Case, truth: dict[str, Truth]) -> dict[str, Any]:
    """The part of the truth file that every plant writes."""
    return {
        "case": case.id,
        "plant": case.plant,
        "kind": case.kind,
        "magnitude": case.magnitude,
        "noise": case.noise,
        "seed": case.seed,
        "missions": FLIGHTS,
        "effects": [
            {
                "name": name,
                "outside": EFFECTS[name].outside,
                "parameters": {k: _number(v) for k, v in numbers.items()},
            }
            for name, numbers in truth.items()
        ],
    }


def _number(number: Number) -> dict[str, Any]:
    return {
        "value": number.value,
        "unit": number.unit,
        "neutral": number.neutral,
        "exact": number.exact,
    }
