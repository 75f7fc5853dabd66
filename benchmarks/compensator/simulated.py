"""Simulated flights with hidden effects: `python -m benchmarks.compensator.simulated --out DIR`.

    DIR/flights/NAME/  train_hover_1.parquet ... test_tour_1.parquet ... vehicle.toml
    DIR/truth/NAME.json  what is hidden, never alongside the flights

NAME is one aircraft with two or three effects that its vehicle file does not have, of one draw of
their sizes. It flies hover and takeoff for training, tour and forward for testing: as the paper
does, what is learned near hover is asked for in motion. The plants are those of
`benchmarks.hidden_effects`. Aircraft that are complete are skipped, so a run that was cut short
goes on where it stopped.
"""

import argparse
import hashlib
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects.cases import MAGNITUDES
from benchmarks.hidden_effects.files import write_json
from benchmarks.hidden_effects.hiding import Truth
from benchmarks.hidden_effects.plants.aircraft import AIRCRAFT, NOISE, Aircraft, vehicle_toml
from benchmarks.hidden_effects.plants.kinds import EFFECTS
from benchmarks.hidden_effects.plants.missions import Order, mission
from benchmarks.hidden_effects.plants.own.flight import Trace, fly
from benchmarks.hidden_effects.plants.own.parameters import Parameters
from benchmarks.hidden_effects.plants.sensing import flight_table
from twin.logs.flight import Flight
from twin.logs.table import write_flight

HIDDEN_SETS = {
    "worn": ("rotor_drag", "battery_sag", "accel_misalignment"),
    "loaded": ("mass_offset", "translational_lift", "mag_current_coupling"),
    "sluggish": ("motor_lag", "induced_inflow", "thrust_tilt"),
}
"""Effects that are hidden together."""
FLYERS = ("quad_450", "quad_150")
"""Aircraft, one after the other by seed; equally many rotors, so all fly in one simulation."""
TRAINING, TESTING = ("hover", "takeoff"), ("tour", "forward")
MAGNITUDE, NOISE_LEVEL = "large", "low"
"""Enough of an effect, over sensors good enough, that there is something to learn."""
FLIGHTS_AT_ONCE = 300
"""In one simulation: beyond, memory grows and time per flight hardly falls."""
VEHICLE = "vehicle.toml"


@dataclass(frozen=True, slots=True)
class Individual:
    """One aircraft with its hidden effects.

    Attributes:
        hidden: Name of the set, of `HIDDEN_SETS`.
        seed: Draws sizes, missions, charges and noise.
        repeats: Flights of each mission.
    """

    hidden: str
    seed: int
    repeats: int = 2

    @property
    def name(self) -> str:
        """Of its folder; says nothing about the sizes."""
        return f"{self.hidden}_{self.seed}"

    @property
    def aircraft(self) -> Aircraft:
        """Which aircraft it is."""
        return AIRCRAFT[FLYERS[self.seed % len(FLYERS)]]

    @property
    def flights(self) -> dict[str, str]:
        """Mission of each flight by its name."""
        return {
            f"{use}_{kind}_{k}": kind
            for use, kinds in (("train", TRAINING), ("test", TESTING))
            for kind in kinds
            for k in range(1, self.repeats + 1)
        }

    def rng(self, what: str) -> np.random.Generator:
        """Random numbers of their own for each purpose."""
        digest = hashlib.sha256(f"{self.hidden}/{self.seed}/{what}".encode()).hexdigest()
        return np.random.default_rng(int(digest[:15], 16))

    def folder(self, out: Path) -> Path:
        """Where its flights and its vehicle file lie."""
        return out / "flights" / self.name

    def files(self, out: Path, use: str) -> list[Path]:
        """Its flights for "train" or "test"."""
        return [self.folder(out) / f"{n}.parquet" for n in self.flights if n.startswith(use)]

    def truth(self, out: Path) -> Path:
        """File that says what is hidden; written last."""
        return out / "truth" / f"{self.name}.json"


def individuals(
    sets: Sequence[str] = tuple(HIDDEN_SETS), seeds: int = 3, repeats: int = 2
) -> list[Individual]:
    """Every hidden set with every seed."""
    return [Individual(hidden, seed, repeats) for hidden in sets for seed in range(seeds)]


def produce(out: Path, wanted: Sequence[Individual]) -> list[Individual]:
    """Fly and write the individuals that are not there yet; returns these."""
    missing = [i for i in wanted if not is_complete(out, i)]
    print(f"{len(wanted)} aircraft, {len(wanted) - len(missing)} flown already", file=sys.stderr)
    start, done = time.perf_counter(), 0
    for batch in _batches(missing):
        plants = [hide(i) for i in batch]
        flown = [orders(i, plant) for i, (plant, _) in zip(batch, plants, strict=True)]
        flat = [order for flights in flown for order in flights.values()]
        trace, first = fly(flat), 0
        for individual, flights, (_, truth) in zip(batch, flown, plants, strict=True):
            _write(out, individual, flights, truth, trace, first)
            first += len(flights)
        done += len(flat)
        spent = time.perf_counter() - start
        print(f"{done} flights in {spent:.0f} s, {spent / done:.2f} s each", file=sys.stderr)
    return missing


def is_complete(out: Path, individual: Individual) -> bool:
    """Whether nothing of an individual is missing."""
    files = [*individual.files(out, "train"), *individual.files(out, "test")]
    files += [individual.truth(out), individual.folder(out) / VEHICLE]
    return all(f.is_file() for f in files)


def hide(individual: Individual) -> tuple[Parameters, dict[str, Truth]]:
    """The plant of an individual, and what is hidden in it by effect."""
    plant, truth = individual.aircraft.nominal, {}
    for name in HIDDEN_SETS[individual.hidden]:
        rng, effect = individual.rng(name), EFFECTS[name]
        size = effect.sizes[MAGNITUDES.index(MAGNITUDE)] * float(rng.uniform(0.8, 1.2))
        plant, truth[name] = effect.hide(plant, individual.aircraft, size, rng)
    return plant, truth


def orders(individual: Individual, plant: Parameters) -> dict[str, Order]:
    """The flights of an individual by name, each from a battery charged again."""
    found = {}
    for name, kind in individual.flights.items():
        rng, aircraft = individual.rng(name), individual.aircraft
        charge = float(rng.uniform(0.5, 1.0))
        found[name] = Order(
            aircraft,
            replace(plant, charge=charge),
            mission(kind, aircraft.nominal.leg, aircraft.pace, rng),
            NOISE[NOISE_LEVEL],
            tuple(int(n) for n in rng.integers(2**31, size=2)),
        )
    return found


def _batches(missing: Sequence[Individual]) -> list[list[Individual]]:
    """Individuals that fly together."""
    found: list[list[Individual]] = [[]]
    for individual in missing:
        if sum(len(i.flights) for i in (*found[-1], individual)) > FLIGHTS_AT_ONCE and found[-1]:
            found.append([])
        found[-1].append(individual)
    return [batch for batch in found if batch]


def _write(
    out: Path,
    individual: Individual,
    flights: dict[str, Order],
    truth: dict[str, Truth],
    trace: Trace,
    first: int,
) -> None:
    folder = individual.folder(out)
    folder.mkdir(parents=True, exist_ok=True)
    for i, (name, order) in enumerate(flights.items(), start=first):
        write_flight(Flight(name, flight_table(order, trace, i)), folder / f"{name}.parquet")
    text = vehicle_toml(individual.aircraft, NOISE[NOISE_LEVEL])
    (folder / VEHICLE).write_text(text, "utf-8")
    write_json(individual.truth(out), _truth_json(individual, truth))


def _truth_json(individual: Individual, truth: dict[str, Truth]) -> dict[str, Any]:
    return {
        "aircraft": individual.aircraft.name,
        "set": individual.hidden,
        "seed": individual.seed,
        "magnitude": MAGNITUDE,
        "noise": NOISE_LEVEL,
        "missions": individual.flights,
        "effects": {
            name: {k: {"value": n.value, "unit": n.unit} for k, n in numbers.items()}
            for name, numbers in truth.items()
        },
    }


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--set", action="append", choices=tuple(HIDDEN_SETS), dest="sets")
    parser.add_argument("--seeds", type=int, default=3, help="draws of the sizes per set")
    parser.add_argument("--repeats", type=int, default=2, help="flights of each mission")
    options = parser.parse_args(arguments)
    sets = options.sets or tuple(HIDDEN_SETS)
    produce(options.out, individuals(sets, options.seeds, options.repeats))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
