"""From a case to what is flown for it: plant, missions, days, and what its file says."""

from dataclasses import dataclass, replace
from itertools import cycle, islice

import numpy as np

from .cases import MAGNITUDES, Case
from .hiding import Truth
from .plants.aircraft import NOISE, Aircraft
from .plants.kinds import EFFECTS, PLANTS
from .plants.missions import Order, mission
from .plants.own.parameters import Parameters
from .realism import DEFECTS, Day, WrongFile, draw_day, draw_magnitude, on_day, wrong_file

FLIGHTS = {"fit_1": "tour", "fit_2": "forward", "holdout_1": "tour"}
"""Mission of each flight of a case of today."""
_CHARGES = {"fit_1": 0.95, "fit_2": 0.75, "holdout_1": 0.55}
"""State of charge at the start: one battery, flight after flight."""
_LIFE_CHARGES = (0.55, 0.95)
"""In the set of `life` it is any between these."""
_SLOW, _FAST = ("hover", "slow_circle"), ("tour", "forward")


@dataclass(frozen=True)
class Plan:
    """What is flown for a case.

    Attributes:
        plant: The aircraft with what is hidden.
        truth: What is hidden, by effect.
        flights: Orders by name of the flight.
        days: What is special in each flight; empty where nothing is.
        file: What the vehicle file says where it is off.
    """

    plant: Parameters
    truth: dict[str, Truth]
    flights: dict[str, Order]
    days: dict[str, Day]
    file: WrongFile | None


def aircraft_of(case: Case) -> Aircraft:
    """The aircraft that flies a case."""
    return PLANTS[case.plant].load(case.aircraft)[0]


def missions_of(case: Case) -> dict[str, str]:
    """Mission of each flight by its name."""
    if not case.life.key:
        return FLIGHTS
    turns = _SLOW if case.life.slow else _FAST
    names = {"since": ("normal", "since")}.get(case.kind, ("fit", "holdout"))
    many = [f"{names[0]}_{i + 1}" for i in range(case.life.fits)]
    first = dict(zip(many, islice(cycle(turns), len(many)), strict=True))
    return {**first, f"{names[1]}_1": turns[case.seed % 2] if case.life.slow else turns[0]}


def sizes(case: Case) -> dict[str, str]:
    """Magnitude of each hidden effect."""
    if case.magnitude != "mixed":
        return dict.fromkeys(case.effects, case.magnitude)
    rng = np.random.default_rng([case.entropy, 50])
    return {name: draw_magnitude(name, rng) for name in case.effects}


def hide(case: Case) -> tuple[Parameters, dict[str, Truth]]:
    """The plant of a case, and its truth by effect."""
    aircraft = aircraft_of(case)
    plant, truth = aircraft.nominal, dict[str, Truth]()
    if case.kind == "since":
        rng = np.random.default_rng([case.entropy, 0])
        return DEFECTS[(*case.effects, "none")[0]](plant, aircraft, rng)
    for name in case.effects:
        plant, truth[name] = hidden(case, plant, name)
    return plant, truth


def hidden(case: Case, plant: Parameters, name: str) -> tuple[Parameters, Truth]:
    """A plant with one effect of a case, of the same size in whatever company."""
    rng = np.random.default_rng([case.entropy, case.effects.index(name)])
    effect, magnitude = EFFECTS[name], sizes(case)[name]
    size = effect.sizes[MAGNITUDES.index(magnitude)] * float(rng.uniform(0.8, 1.2))
    return effect.hide(plant, aircraft_of(case), size, rng)


def plan(case: Case) -> Plan:
    """Everything that is flown for a case, and what its file says."""
    aircraft, (plant, truth) = aircraft_of(case), hide(case)
    flights, days = dict[str, Order](), dict[str, Day]()
    for place, (name, kind) in enumerate(missions_of(case).items()):
        flown = aircraft.nominal if name.startswith("normal") else plant
        if case.life.days:
            days[name] = draw_day(aircraft, np.random.default_rng([case.entropy, 300 + place]))
            flown = on_day(flown, days[name])
        flights[name] = Order(
            aircraft,
            replace(flown, charge=_charge(case, place, name)),
            mission(
                kind,
                aircraft.nominal.leg,
                aircraft.pace,
                np.random.default_rng([case.entropy, 100 + place]),
            ),
            NOISE[case.noise],
            (case.entropy, 200 + place),
        )
    file = None
    if case.life.off:
        rng = np.random.default_rng([case.entropy, 400])
        file = wrong_file(aircraft, case.life.rotors, rng)
    return Plan(plant, truth, flights, days, file)


def _charge(case: Case, place: int, name: str) -> float:
    """Of the battery at the start of a flight."""
    if not case.life.key:
        return _CHARGES[name]
    return float(np.random.default_rng([case.entropy, 500 + place]).uniform(*_LIFE_CHARGES))
