"""Flights of a made fleet: aircraft of one type over some weeks, four of which are not as the rest.

The built-in `copter_default`, with its rotor drag left out of the vehicle file that the fleet is
compared with. Aircraft differ a little in mass, drag and sensors; days differ in wind. Then:

    A01  its battery's resistance grows
    A02  its rotor 3 loses thrust
    A03  the bias of its gyroscope about pitch grows
    A04  it is heavier

All numbers are made up. The voltage is made of the commands afterwards, and does not act on thrust.
"""

from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects.plants.aircraft import NOISE
from twin.flight.simulate_flight import Recorder, Stream, simulate_flight
from twin.logs import Flight, Site, write_flight
from twin.logs.airframe import Airframe, Place, SourcedValue
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL, motor_columns
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, setpoints_along

Array = NDArray[np.float64]
VEHICLE = "copter_default"
WEEKS = 8.0
BEGIN_YEAR = 2026.25
YEAR_D = 365.25
DRAG_1_S = 0.35
"""Rotor drag of the type, which its vehicle file lacks."""
BETWEEN = {"drag_1_s": 0.03, "mass": 0.004, "gyro_rad_s": 5e-4, "ohm": 5e-4, "rotor": 0.003}
"""Standard deviations between aircraft; mass and rotors as shares."""
OHM, FULL_V = 0.03, 16.4
AMPERE = 40.0
"""Of all motors at full command."""
BATTERY, ROTOR, GYROSCOPE, HEAVY = "A01", "A02", "A03", "A04"
OHM_PER_30_D, LOSS_PER_30_D, GYRO_PER_30_D = 0.01, 0.05, 0.006
HEAVIER = 0.08
LOST_ROTOR = 3


@dataclass(frozen=True, slots=True)
class Aircraft:
    """One aircraft of the fleet, on its first day.

    Attributes:
        name: As its logs name it.
        drag_1_s: Rotor drag.
        mass: Of it over that of the type.
        gyro_rad_s: Bias of the gyroscope, shape (3,).
        ohm: Resistance of the battery.
        loss: Thrust that each rotor lacks, as a share, shape (4,).
    """

    name: str
    drag_1_s: float
    mass: float
    gyro_rad_s: Array
    ohm: float
    loss: Array

    def after(self, days: float) -> "Aircraft":
        """The same some days later, where something of it is planted."""
        months = days / 30.0
        if self.name == BATTERY:
            return replace(self, ohm=self.ohm + OHM_PER_30_D * months)
        if self.name == ROTOR:
            lost = np.eye(4)[LOST_ROTOR - 1] * LOSS_PER_30_D * months
            return replace(self, loss=self.loss + lost)
        if self.name == GYROSCOPE:
            more = np.array([0.0, GYRO_PER_30_D * months, 0.0])
            return replace(self, gyro_rad_s=self.gyro_rad_s + more)
        return self

    def plant(self, vehicle: Vehicle) -> Vehicle:
        """What really flies."""
        losses = {f"loss_{i}": float(x) for i, x in enumerate(self.loss, start=1)}
        return vehicle.with_effects(
            {
                "rotor_drag": {"k_xy_1_s": self.drag_1_s, "k_z_1_s": 0.0},
                "mass_offset": {"mass_kg": (self.mass - 1) * vehicle.mass_kg},
                "rotor_efficiency_loss": losses | {"torque_share": 1.0},
            }
        )


def aircraft_of(count: int, seed: int = 0) -> list[Aircraft]:
    """The aircraft, A01 first.

    Args:
        count: How many.
        seed: Of what they differ in.
    """
    rng, sd = np.random.default_rng(seed), BETWEEN
    found = []
    for k in range(1, count + 1):
        name = f"A{k:02d}"
        found.append(
            Aircraft(
                name,
                DRAG_1_S + sd["drag_1_s"] * float(rng.standard_normal()),
                1 + sd["mass"] * float(rng.standard_normal()) + HEAVIER * (name == HEAVY),
                sd["gyro_rad_s"] * rng.standard_normal(3),
                OHM + sd["ohm"] * float(rng.standard_normal()),
                sd["rotor"] * np.abs(rng.standard_normal(4)),
            )
        )
    return found


def flown(aircraft: Aircraft, days: float, seed: int, seconds: float = 18.0) -> Flight:
    """A flight of an aircraft, as its log would be read.

    Args:
        aircraft: On its first day.
        days: Since then.
        seed: Of way, wind and noise.
        seconds: How long, about.
    """
    rng, vehicle = np.random.default_rng([seed, 7]), load_vehicle(VEHICLE)
    now = aircraft.after(days)
    plant = now.plant(vehicle)
    setpoints, phases = setpoints_along(plant, _way(seconds, rng))
    angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0, 1.5)
    n = len(setpoints)
    wind = {
        "wind_x": np.full(n, speed * np.cos(angle)),
        "wind_y": np.full(n, speed * np.sin(angle)),
    }
    name = f"{aircraft.name}_{seed:05d}"
    recorder = _recorder(vehicle, int(rng.integers(2**31)))
    flight = simulate_flight(setpoints, phases, vehicle, plant, recorder, name, courses=wind)
    table = flight.table
    table[list(GYRO)] = table[list(GYRO)].to_numpy() + now.gyro_rad_s
    table[["vbat_v", "ibat_a"]] = _battery(flight, now.ohm, rng)
    place = Place(0.8, 0.2, 100.0, BEGIN_YEAR + days / YEAR_D)
    return replace(
        flight,
        facts={"aircraft": f"autopilot {aircraft.name}", "airframe": "made copter"},
        airframe=Airframe(place=SourcedValue(place, "made")),
        site=Site(False, "made"),
    )


def _battery(flight: Flight, ohm: float, rng: np.random.Generator) -> Array:
    """Voltage and current where the commands are known, ten times a second, shape (n, 2)."""
    commands = flight.table[list(motor_columns("cmd", 4))].to_numpy(dtype=np.float64)
    amps = AMPERE * np.mean(np.clip(commands, 0, 1) ** 1.5, axis=1)
    seen = np.zeros(len(amps), dtype=bool)
    seen[::20] = True
    seen &= np.isfinite(amps)
    volts = FULL_V - 0.002 * flight.time_s - ohm * amps
    both = np.column_stack([volts, amps])
    both += np.array([0.01, 0.1]) * rng.standard_normal(both.shape)
    return np.asarray(np.where(seen[:, None], both, np.nan))


def _way(seconds: float, rng: np.random.Generator) -> Waypoints:
    """Up, a hover, legs to anywhere, a hover."""
    here = (0.0, 0.0, -1.5)
    legs = [("ground", 1.0, (0.0, 0.0, 0.0)), ("takeoff", 2.5, here), ("hover", 4.0, here)]
    while sum(leg[1] for leg in legs) < seconds - 2.0:
        x, y, z = *rng.uniform(-4, 4, 2), rng.uniform(-3.0, -1.2)
        here = (float(x), float(y), float(z))
        legs.append(("forward", float(rng.uniform(2.0, 3.0)), here))
    return (*legs, ("hover", 2.0, here))


def _recorder(v: Vehicle, seed: int) -> Recorder:
    noise = NOISE["low"]
    streams = (
        Stream(motor_columns("cmd", v.rotors.count), 0.005),
        Stream(ACC, 0.005, noise.accel),
        Stream(GYRO, 0.005, noise.gyro),
        Stream(POS, 0.02, noise.position),
        Stream(VEL, 0.02, noise.velocity),
        Stream(QUAT, 0.02, noise.attitude / 2),
    )
    return Recorder(streams, 200.0, 200.0, seed)


def flights_of(count: int, aircraft: int, seed: int = 0) -> Iterator[tuple[Aircraft, float, int]]:
    """Aircraft, day and seed of each flight: all aircraft in turn, over all weeks."""
    several = aircraft_of(aircraft, seed)
    rng = np.random.default_rng([seed, 11])
    rounds = -(-count // aircraft)
    for k in range(count):
        day = 7 * WEEKS * (k // aircraft + float(rng.uniform(0, 0.8))) / rounds
        yield several[k % aircraft], day, 1000 * seed + k


def write_fleet(
    folder: Path, count: int, aircraft: int, seed: int = 0, seconds: float = 18.0, workers: int = 1
) -> list[Path]:
    """Fly all flights that are not there yet, a flight table each, in a folder per aircraft."""
    several = [
        (folder / one.name / f"{one.name}_{number:05d}.parquet", one, days, number, seconds)
        for one, days, number in flights_of(count, aircraft, seed)
    ]
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        for _ in pool.map(_write, (x for x in several if not x[0].exists())):
            pass
    return [path for path, *_ in several]


def _write(given: tuple[Path, Aircraft, float, int, float]) -> None:
    path, one, days, number, seconds = given
    path.parent.mkdir(parents=True, exist_ok=True)
    write_flight(flown(one, days, number, seconds), path)


PLANTED: Mapping[str, tuple[str, str]] = {
    BATTERY: ("drifts", "battery_resistance_ohm"),
    ROTOR: ("drifts", f"motor_{LOST_ROTOR}"),
    GYROSCOPE: ("drifts", "gyro_bias_y_rad_s"),
    HEAVY: ("differences", "carried"),
}
"""What is planted in which aircraft, and the number that should tell it."""
