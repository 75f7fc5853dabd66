"""Sudden faults in flights of somebody else's simulator: drone-models with its two Crazyflies.

Its dynamics are flown by the controller and seen by the sensors of `hidden_effects`; from an
instant on those of a damaged aircraft take their place. All flights of an aircraft go on together.
drone-models asks for `SCIPY_ARRAY_API=1` in the environment before scipy is imported.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.logs import Flight
from twin.logs.columns import motor_columns

from .hidden_effects.plants.aircraft import NOISE
from .hidden_effects.plants.missions import CONTROL_HZ, Order, mission
from .hidden_effects.plants.own.flight import fly
from .hidden_effects.plants.own.parameters import Array, Batch, Parameters
from .hidden_effects.plants.own.physics import Instant
from .hidden_effects.plants.sensing import flight_table
from .hidden_effects.plants.third_party import CRAZYFLIES, Crazyflies, crazyflie

PLANT = "drone_models"
"""Name on PyPI, with a dash."""
BEGINS_S = (13.0, 16.0)
"""When a fault begins, of flights of 24 s."""
AFTER_S = 8.0
"""What is flown after it."""
MISSION = "tour"
"""What is flown: legs, a circle, an eight, a hover."""
WIND_M_S, GUST_M_S = 1.0, 0.3
"""Largest mean wind, and standard deviation of the turbulence: an aircraft of 40 g."""


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight.

    Attributes:
        flight: As logged.
        begins_s: Onset of its fault; infinity: it has none.
        rotor: Of the fault, from 1; None: of none.
    """

    flight: Flight
    begins_s: float
    rotor: int | None


class Failing:
    """Dynamics that become those of other parameters, each flight at its own time."""

    def __init__(self, model: str, later: Sequence[Parameters], begins_s: Array) -> None:
        self._sound, self._damaged = Crazyflies(model), Crazyflies(model)
        self._later, self._begins_s = Batch(list(later)), begins_s

    def __call__(self, batch: Batch, now: Instant) -> tuple[Array, Array]:
        """Force without weight and angular acceleration, body axes."""
        force, twist = self._sound(batch, now)
        begun = now.t >= self._begins_s
        if not begun.any():
            return force, twist
        other, turned = self._damaged(self._later, now)
        weight = np.asarray(batch.p.mass) / np.asarray(self._later.p.mass)
        return np.where(begun, other * weight, force), np.where(begun, turned, twist)


def flown(faults: Sequence[tuple[str, float, int]], rate_hz: float) -> Iterator[Flown]:
    """Flights with faults, in their order.

    Args:
        faults: Cause, size and seed of each; the seed decides which aircraft flies.
        rate_hz: Of the logged commands, at most 200 Hz.
    """
    done: dict[int, Flown] = {}
    for number, model in enumerate(CRAZYFLIES):
        mine = [k for k, (_, _, seed) in enumerate(faults) if seed % len(CRAZYFLIES) == number]
        for k, flight in zip(mine, _flown(model, [faults[k] for k in mine], rate_hz), strict=True):
            done[k] = flight
    yield from (done[k] for k in range(len(faults)))


def _flown(model: str, faults: Sequence[tuple[str, float, int]], rate_hz: float) -> Iterator[Flown]:
    """Flights of one aircraft."""
    if not faults:
        return
    aircraft = crazyflie(model)
    orders: list[Order] = []
    later: list[Parameters] = []
    begins: list[float] = []
    rotors: list[int | None] = []
    for cause, size, seed in faults:
        rng = np.random.default_rng([seed, *cause.encode(), int(1000 * abs(size))])
        angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0, WIND_M_S)
        wind = speed * np.array([np.cos(angle), np.sin(angle), 0.0])
        plant = replace(aircraft.nominal, wind=wind, gust_sigma=GUST_M_S)
        setpoints = mission(MISSION, plant.leg, aircraft.pace, rng)
        orders.append(Order(aircraft, plant, setpoints, NOISE["medium"], (seed, len(orders))))
        rotor = int(rng.integers(4)) if cause == "rotor_failure" else None
        later.append(_damaged(plant, cause, size, rotor))
        begins.append(float(rng.uniform(*BEGINS_S)) if cause else np.inf)
        rotors.append(rotor)
    trace = fly(orders, Failing(model, later, np.array(begins)))
    for i, order in enumerate(orders):
        table, rotor = flight_table(order, trace, i), rotors[i]
        commands = list(motor_columns("cmd", len(aircraft.nominal.hubs)))
        table.loc[np.arange(len(table)) % round(CONTROL_HZ / rate_hz) != 0, commands] = np.nan
        table = table[table["time"] < begins[i] + AFTER_S]
        name = "_".join(map(str, faults[i]))
        yield Flown(Flight(name, table), begins[i], None if rotor is None else rotor + 1)


def _damaged(plant: Parameters, cause: str, size: float, rotor: int | None) -> Parameters:
    """Parameters from the onset on: a share of the thrust and torque of a rotor is gone, or a share
    of the mass comes; what it carries sits at the centre of mass."""
    if rotor is not None:
        left = 1.0 - size * (np.arange(len(plant.hubs)) == rotor)
        return replace(plant, thrust_k=plant.thrust_k * left, torque_k=plant.torque_k * left)
    return replace(plant, mass=plant.mass * (1 + size)) if cause == "mass_change" else plant
