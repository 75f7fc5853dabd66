"""Flights with sudden faults of four plants, all flown by our controller and seen by our sensors.

Dynamics of a damaged aircraft take the place of the sound ones from an instant on, or grow into it.
JSBSim integrates itself: there the difference of our own plant with and without the damage comes in
from outside, as in `hidden_effects`. drone-models asks for `SCIPY_ARRAY_API=1` in the environment
before scipy is imported.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from benchmarks.hidden_effects.plants.aircraft import AIRCRAFT, NOISE, Aircraft
from benchmarks.hidden_effects.plants.jsbsim import JsbsimFlights, f450
from benchmarks.hidden_effects.plants.missions import CONTROL_HZ, Order, Setpoints, mission
from benchmarks.hidden_effects.plants.own.flight import Trace, fly
from benchmarks.hidden_effects.plants.own.parameters import Array, Batch
from benchmarks.hidden_effects.plants.own.physics import (
    Dynamics,
    Instant,
    Layout,
    own_dynamics,
    to_body,
)
from benchmarks.hidden_effects.plants.sensing import flight_table
from benchmarks.hidden_effects.plants.third_party import CRAZYFLIES, Crazyflies, crazyflie
from twin.logs import Flight
from twin.logs.airframe import Airframe
from twin.logs.columns import ACC, GYRO, MAG, motor_columns
from twin.vehicle import layouts

from .kinds import KINDS, NOTHING, Fault
from .rotorpy import hummingbird, hummingbird_dynamics

BEGINS_S, AFTER_S = (13.0, 16.0), 8.0
"""When a fault begins, of flights of 24 s, and what is flown after it."""
MISSION, HIGHER_M, CLIMBS_S = "tour", 4.0, (0.8, 6.8)
"""What is flown: legs, a circle, an eight, a hover; so much higher than in `hidden_effects`, so
that what falls does not hit the ground at once; between these times it climbs there."""
WIND_M_S, GUST_SHARE = 3.0, 0.1
"""Largest mean wind, and standard deviation of the turbulence over it; a third for an aircraft
below `LIGHT_KG`."""
LIGHT_KG = 0.1
RING = 6
"""Rotors of the aircraft that numbers them round the ring, as no autopilot does by itself."""
FULL_TURN = 2 * np.pi


@dataclass(frozen=True, slots=True)
class Key:
    """One flight.

    Attributes:
        plant: Of `PLANTS`.
        kind: Of `KINDS`; "": nothing fails.
        size: One of its sizes.
        seed: Of everything that is drawn.
        rate_hz: Of the commands.
    """

    plant: str
    kind: str
    size: float
    seed: int
    rate_hz: float


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight.

    Attributes:
        flight: As logged.
        begins_s: Onset of its fault; infinity: it has none.
        rotors: Of the fault, from 1.
    """

    flight: Flight
    begins_s: float
    rotors: tuple[int, ...]


def _aircraft(plant: str) -> tuple[Aircraft, ...]:
    """Those that a plant flies, seed by seed."""
    makers: Mapping[str, Callable[[], tuple[Aircraft, ...]]] = {
        "own": lambda: tuple(AIRCRAFT.values()),
        "drone_models": lambda: tuple(map(crazyflie, CRAZYFLIES)),
        "rotorpy": lambda: (hummingbird(),),
        "jsbsim": lambda: (f450(),),
    }
    return makers[plant]()


def _dynamics(plant: str, aircraft: Aircraft) -> Dynamics:
    """New ones of an aircraft."""
    if plant == "drone_models":
        return Crazyflies(aircraft.name)
    if plant == "jsbsim":
        return JsbsimFlights()
    return hummingbird_dynamics if plant == "rotorpy" else own_dynamics


PLANTS = ("own", "drone_models", "rotorpy", "jsbsim")
"""Names of the plants."""


class Failing:
    """Dynamics that become those of a damaged aircraft, each flight at its own time."""

    def __init__(self, sound: Dynamics, damaged: Dynamics, faults: Sequence[Fault]) -> None:
        self._sound, self._damaged, self._faults = sound, damaged, faults
        self._later = Batch([f.after for f in faults])
        self._begins = min(f.begins_s for f in faults)
        self._push = np.stack([f.push for f in faults], axis=-1)
        self._tilts = np.stack([f.bias("gyroscope") for f in faults], axis=-1)

    def shares(self, t: float) -> Array:
        """Of each fault that has come, shape (n,)."""
        return np.array([f.share(t) for f in self._faults])

    def blow(self, t: float) -> Array:
        """Wind of gusts, NED, shape (3, n)."""
        return np.stack([f.blow(t) for f in self._faults], axis=-1)

    def weigh(self, batch: Batch, t: float) -> Array:
        """Shares that have come; a biased gyroscope misleads the controller from then on."""
        share = self.shares(t)
        batch.p.gyro_bias[:] = share * self._tilts
        return share

    def __call__(self, batch: Batch, now: Instant) -> tuple[Array, Array]:
        """Force without weight and angular acceleration, body axes."""
        if now.t < self._begins - 2.0:
            return self._sound(batch, now)
        now = replace(now, air=now.air - to_body(now.r, self.blow(now.t)))
        share = self.weigh(batch, now.t)
        force, turn = self._sound(batch, now)
        other, turned = self._damaged(self._later, now)
        weight = np.asarray(batch.p.mass) / np.asarray(self._later.p.mass)
        force = force + share * (other * weight - force + to_body(now.r, self._push))
        return force, turn + share * (turned - turn)


class FailingJsbsim(JsbsimFlights):
    """The same of JSBSim: what the damage changes comes in from outside.

    A mass that comes weighs and lags behind by a step: dm (g - a) at the acceleration of before.
    """

    def __init__(self, faults: Sequence[Fault]) -> None:
        super().__init__()
        self._failing = Failing(own_dynamics, own_dynamics, faults)
        self._before = Batch([f.before for f in faults])
        self._after = Batch([f.after for f in faults])
        self._t = 0.0

    def __call__(self, batch: Batch, now: Instant) -> tuple[Array, Array]:
        """As `JsbsimFlights`, with what the damage changes for the next step."""
        force, turn = super().__call__(batch, now)
        self._t = now.t
        share = self._failing.weigh(batch, now.t)
        if share.any():
            sound, turning = own_dynamics(self._before, now)
            damaged, turned = own_dynamics(self._after, now)
            more = np.asarray(self._after.p.mass) - np.asarray(self._before.p.mass)
            rope = to_body(now.r, self._failing._push)
            load = -more * force / np.asarray(batch.p.mass)
            self._push = self._push + share * (damaged - sound + rope + load)
            self._twist = self._twist + share * batch.p.inertia * (turned - turning)
        return force, turn

    def step(self, layout: Layout, x: Array, command: Array, wind: Array) -> None:
        """One step, in the gust as well."""
        super().step(layout, x, command, wind + self._failing.blow(self._t))


def flown(keys: Sequence[Key]) -> Iterator[tuple[Key, Flown]]:
    """Flights of keys, those of one plant and one number of rotors together."""
    groups: dict[tuple[str, str], list[Key]] = {}
    for key in keys:
        aircraft = _aircraft(key.plant)
        mine = aircraft[key.seed % len(aircraft)]
        groups.setdefault((key.plant, mine.name), []).append(key)
    for (plant, name), mine_keys in groups.items():
        craft = next(a for a in _aircraft(plant) if a.name == name)
        yield from zip(mine_keys, _flown(plant, craft, mine_keys), strict=True)


def _flown(plant: str, aircraft: Aircraft, keys: Sequence[Key]) -> Iterator[Flown]:
    drawn = [_drawn(aircraft, key) for key in keys]
    orders, faults = [o for o, _ in drawn], [f for _, f in drawn]
    sound, damaged = (_dynamics(plant, aircraft) for _ in range(2))
    within = isinstance(sound, JsbsimFlights)
    trace = fly(orders, FailingJsbsim(faults) if within else Failing(sound, damaged, faults))
    for i, (key, order, fault) in enumerate(zip(keys, orders, faults, strict=True)):
        table = _table(order, trace, i, fault, key.rate_hz)
        name = f"{key.kind or 'nothing'}_{key.size:g}_{key.seed}"
        flight = Flight(name, table, airframe=_stated(aircraft))
        yield Flown(flight, fault.begins_s, tuple(r + 1 for r in fault.rotors))


def _stated(aircraft: Aircraft) -> Airframe | None:
    """What the log says of the rotors: where they are numbered in no usual order, all."""
    if len(aircraft.nominal.hubs) != RING:
        return None
    hubs, direction = aircraft.nominal.hubs, aircraft.nominal.direction
    return Airframe(layout=layouts.Layout(hubs, direction, metric=True, sd=0.0, source="stated"))


def _drawn(aircraft: Aircraft, key: Key) -> tuple[Order, Fault]:
    """What is flown, and what fails."""
    kind = KINDS[key.kind] if key.kind else NOTHING
    rng = np.random.default_rng([key.seed, *key.kind.encode(), round(1e7 * abs(key.size))])
    angle, light = float(rng.uniform(0, FULL_TURN)), aircraft.nominal.mass < LIGHT_KG
    speed = float(rng.uniform(0.3, 1.0)) * WIND_M_S * (1 / 3 if light else 1.0)
    wind = speed * np.array([np.cos(angle), np.sin(angle), 0.0])
    plant = replace(aircraft.nominal, wind=wind, gust_sigma=GUST_SHARE * WIND_M_S)
    begins_s = float(rng.uniform(*BEGINS_S)) if key.kind else np.inf
    count, across = len(plant.hubs), float(rng.uniform(0, FULL_TURN))
    rotors = tuple(sorted(rng.permutation(count)[: kind.rotors].tolist()))
    toward = np.array([np.cos(across), np.sin(across), 0.0])
    fault = Fault(kind, key.size, rotors, begins_s, toward, plant)
    setpoints = _setpoints(plant.leg, aircraft.pace, rng, fault)
    return Order(aircraft, plant, setpoints, NOISE["medium"], (key.seed, len(key.kind))), fault


def _setpoints(leg: float, pace: float, rng: np.random.Generator, fault: Fault) -> Setpoints:
    """The mission, higher; commands that are cut are those of motors that are not armed."""
    found = mission(MISSION, leg, pace, rng)
    t = np.arange(len(found.yaw)) / CONTROL_HZ
    x = np.clip((t - CLIMBS_S[0]) / (CLIMBS_S[1] - CLIMBS_S[0]), 0.0, 1.0)
    down = -HIGHER_M * x**3 * (10 + x * (-15 + 6 * x))
    climb = np.gradient(down, 1 / CONTROL_HZ)
    bend = np.gradient(climb, 1 / CONTROL_HZ)
    along = np.array([0.0, 0.0, 1.0])
    cut = (t >= fault.begins_s) & (t < fault.begins_s + fault.size)
    return replace(
        found,
        pos=found.pos + down[:, None] * along,
        vel=found.vel + climb[:, None] * along,
        acc=found.acc + bend[:, None] * along,
        armed=found.armed & ~(cut & (fault.kind is KINDS["commands cut"])),
    )


def _table(order: Order, trace: Trace, i: int, fault: Fault, rate_hz: float) -> pd.DataFrame:
    """The flight as logged, with biased instruments and rotor speeds."""
    table = flight_table(order, trace, i)
    since = (table["time"] >= fault.begins_s).to_numpy(dtype=float)
    for kind, columns in (("gyroscope", GYRO), ("accelerometer", ACC), ("compass", MAG)):
        for name, bias in zip(columns, fault.bias(kind), strict=True):
            table[name] = table[name] + since * bias
    if fault.kind is KINDS["battery"]:
        table["vbat_v"] *= 1 - since * (1 - np.sqrt(1 - fault.size))
    rotors = len(order.plant.hubs)
    slowed = np.ones((len(table), rotors))
    if fault.kind is KINDS["motor"]:
        slowed[since > 0] = np.sqrt(1 - fault.size * np.isin(np.arange(rotors), fault.rotors))
    for k, name in enumerate(motor_columns("rotor", rotors)):
        table[name] = trace.rotor[:, k, i] * slowed[:, k]
    drives = [*motor_columns("cmd", rotors), *motor_columns("rotor", rotors)]
    table.loc[np.arange(len(table)) % round(CONTROL_HZ / rate_hz) != 0, drives] = np.nan
    return table[table["time"] < fault.begins_s + AFTER_S]
