"""Write the flights of the benchmark: `python -m benchmarks.hidden_effects.generate --out DIR`.

The set of cases that looks like life: today's kinds of all sizes, and those of this folder.

Spread over plants, aircraft, noise and conditions; the same cases each time.

    DIR/flights/ID/   fit_1.parquet fit_2.parquet holdout_1.parquet vehicle.toml
    DIR/truth/ID.json what is hidden, never beside the flights

Cases that are complete are skipped, so a run that was cut short goes on where it stopped.
"""

import argparse
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from importlib.util import find_spec
from itertools import count, cycle, islice, product, repeat
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from twin.logs.flight import Flight
from twin.logs.table import write_flight
from twin.vehicle_file import parse_vehicle

from .cases import (
    HALVES,
    MAGNITUDES,
    NOISE_LEVELS,
    NORMAL_FLIGHTS,
    SENSORS,
    Case,
    Conditions,
    cases,
    digest,
    half_of,
    round_robin,
    subset,
)
from .files import write_json
from .planning import missions_of
from .plants.kinds import PLANTS, Plant, may_fly_together
from .produce import Produced, produce
from .realism import can_show, draw_effects

LIFE_KINDS = ("many", "uncertain", "since")
_TODAY = {"single": 0.18, "nothing": 0.06, "pair": 0.07, "triple": 0.05, "outside": 0.05}
_NEW = {
    "many": 0.17,
    "uncertain": 0.07,
    "rotors": 0.06,
    "days": 0.11,
    "without": 0.08,
    "since": 0.10,
}
"""Shares of the set; of today's kinds, then of the new ones."""
_PLANT_TURNS = ("own", "drone_models", "own", "jsbsim", "own", "drone_models", "own")
"""Seven, which has no factor in common with the turns of conditions, sizes and aircraft."""
_DEFECT_TURNS = (
    "rotor",
    "payload",
    "none",
    "rotor",
    "slung",
    "accelerometer",
    "payload",
    "gyroscope",
)
_QUIET_EVERY = 5
"""One in so many flights with days, measured rotors or missing sensors has nothing hidden."""


def life_set(size: int, plants: Iterable[str] = PLANTS) -> list[Case]:
    """So many cases of all kinds with these plants; those of `since` are of our own alone."""
    plants = [*plants]
    every = cases(plants)
    chosen = []
    for kind, share in _TODAY.items():
        chosen += round_robin([c for c in every if c.kind == kind], round(size * share))
    turns = [p if p in plants else plants[0] for p in _PLANT_TURNS]
    for kind, share in _NEW.items():
        if kind == "since" and "own" not in plants:
            continue
        chosen += islice(_makers(turns)[kind], round(size * share))
    return chosen


def _makers(turns: list[str]) -> dict[str, Iterator[Case]]:
    """Endless cases of each new kind."""
    return {
        "many": _many(turns),
        "uncertain": _uncertain(turns),
        "rotors": _singles(turns, (Conditions(rotors=True),)),
        "days": _singles(turns, [Conditions(days=True, off=o, fits=n) for n, o in _DAYS]),
        "without": _singles(turns, [Conditions(without=s) for s in SENSORS]),
        "since": _since(),
    }


_DAYS = tuple(product((3, 2, 5, 6, 4), (False, True)))


def _many(turns: list[str]) -> Iterator[Case]:
    """Half with days, one in five driven by measured rotor speeds, one in six without a field."""
    for i, name in zip(count(), cycle(turns)):
        days = i % 2 == 1
        conditions = Conditions(
            off=True,
            days=days,
            rotors=i % 5 == 3,
            without="field" if i % 6 == 4 else "",
            fits=2 + i % 5 if days else 2,
        )
        rng = np.random.default_rng(int(digest(f"many/{name}/{i}")[:15], 16))
        effects = draw_effects(PLANTS[name], conditions, rng)
        yield Case(name, "many", effects, "mixed", _noise(i), i, conditions)


def _uncertain(turns: list[str]) -> Iterator[Case]:
    for i, name in zip(count(), cycle(turns)):
        days = i % 2 == 1
        conditions = Conditions(off=True, days=days, fits=2 + i % 4 if days else 2)
        yield Case(name, "uncertain", (), "none", _noise(i), i, conditions)


def _singles(turns: list[str], every: Iterable[Conditions]) -> Iterator[Case]:
    """One effect each, or none, under conditions in turn."""
    effects = {name: _effects(PLANTS[name]) for name in {*turns}}
    for i, name, conditions in zip(count(), cycle(turns), cycle(every)):
        if i % _QUIET_EVERY == _QUIET_EVERY - 1:
            yield Case(name, "nothing", (), "none", _noise(i), i, conditions)
            continue
        effect = next(n for n in effects[name] if can_show(n, conditions))
        size = MAGNITUDES[(i // 2) % len(MAGNITUDES)]
        yield Case(name, "single", (effect,), size, _noise(i), i, conditions)


def _effects(plant: Plant) -> Iterator[str]:
    """Its effects in an order that goes through all kinds of them, again and again."""
    return cycle(sorted(plant.effects, key=digest))


def _since() -> Iterator[Case]:
    for i, defect in zip(count(), cycle(_DEFECT_TURNS)):
        slow = (i // len(_DEFECT_TURNS) + i) % 2 == 0
        conditions = Conditions(off=True, days=True, fits=NORMAL_FLIGHTS, slow=slow)
        hidden = () if defect == "none" else (defect,)
        yield Case("own", "since", hidden, "mixed", _noise(i), i, conditions)


def _noise(i: int) -> str:
    """Levels in turn, out of step with plants and conditions."""
    return NOISE_LEVELS[(i + i // 3) % len(NOISE_LEVELS)]


KINDS = ("single", "pair", "outside", "nothing", "triple")
FLIGHTS_AT_ONCE = 300
"""In one simulation: beyond, memory grows and time per flight hardly falls."""
_DEVIATION = re.compile(r", sd = (\"[^\"]*\"|[^,}]*?)(?= })")
"""What a vehicle file says about the deviation of an entry; the rest is checked without it."""


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    add_options(parser)
    options = parser.parse_args(arguments)
    generate(options.out, chosen(options), options.jobs)
    return 0


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options that choose cases."""
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--subset", type=int, metavar="N", help="so many cases, spread evenly")
    size.add_argument("--life", type=int, metavar="N", help="so many cases as in real life")
    parser.add_argument("--plant", action="append", choices=tuple(PLANTS))
    parser.add_argument("--effect", action="append", help='with this effect, or "nothing"')
    parser.add_argument(
        "--kind",
        action="append",
        choices=(*KINDS, *LIFE_KINDS),
        help="default: all but triple; those after it come with --life alone, which has all",
    )
    parser.add_argument("--half", choices=HALVES, help="of plants and effects, as the score has it")
    parser.add_argument("--magnitude", action="append", choices=MAGNITUDES)
    parser.add_argument("--noise", action="append", choices=NOISE_LEVELS)


def chosen(options: argparse.Namespace) -> list[Case]:
    """The cases that the options ask for."""
    plants = options.plant or installed_plants()
    every = life_set(options.life, plants) if options.life else cases(plants)
    usual = (*KINDS, *LIFE_KINDS) if options.life else KINDS[:-1]
    wanted = [
        c
        for c in every
        if (not options.effect or set(options.effect) & ({*c.effects} or {"nothing"}))
        and c.kind in (options.kind or usual)
        and (not options.magnitude or c.magnitude in (*options.magnitude, "none"))
        and (not options.noise or c.noise in options.noise)
        and (not options.half or half_of(c.plant, c.kind, c.effects, c.seed) == options.half)
    ]
    return subset(wanted, options.subset) if options.subset else wanted


def generate(out: Path, wanted: list[Case], jobs: int) -> None:
    """Write the cases that are not there yet."""
    missing = [c for c in wanted if not is_complete(out, c)]
    print(f"{len(wanted)} cases, {len(wanted) - len(missing)} flown already", file=sys.stderr)
    start, done = time.perf_counter(), 0
    os.environ["SCIPY_ARRAY_API"] = "1"  # for drone-models, see third_party
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        for count in pool.map(write_batch, repeat(out), batches(missing)):
            done += count
            spent = time.perf_counter() - start
            print(
                f"{done}/{len(missing)} cases flown, {spent:.0f} s, {spent / done:.2f} s per case",
                file=sys.stderr,
            )


def installed_plants() -> list[str]:
    """Plants whose package is there; the others are named on stderr."""
    found = []
    for plant in PLANTS.values():
        if plant.package and not find_spec(plant.name):
            print(f"without {plant.name}: pip install {plant.package}", file=sys.stderr)
        else:
            found.append(plant.name)
    return found


def batches(wanted: Iterable[Case]) -> list[list[Case]]:
    """Cases that fly together, like effects side by side, about equally many flights at a time."""
    groups: dict[tuple[str, ...], list[Case]] = {}
    for case in sorted(wanted, key=lambda c: (c.effects, c.key)):
        together = may_fly_together(case.plant, case.aircraft)
        groups.setdefault((case.plant, *together), []).append(case)
    return [part for group in groups.values() for part in _parts(group)]


def _parts(group: list[Case]) -> Iterator[list[Case]]:
    """Cut where the flights become too many."""
    part: list[Case] = []
    flights = 0
    for case in group:
        n = len(missions_of(case))
        if flights + n > FLIGHTS_AT_ONCE:
            yield part
            part, flights = [], 0
        part.append(case)
        flights += n
    yield part


def write_batch(out: Path, batch: list[Case]) -> int:
    """Produce cases and write them; returns how many."""
    for produced in produce(batch):
        write_case(out, produced)
    return len(batch)


def write_case(out: Path, produced: Produced) -> None:
    """Write one case, its truth last: a case with a truth file is complete."""
    parse_vehicle(_DEVIATION.sub("", produced.vehicle), "vehicle.toml")
    folder, truth = flights_folder(out, produced.case), truth_file(out, produced.case)
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in produced.flights.items():
        flight = Flight(name, table, autopilot=produced.asked[name])
        write_flight(flight, folder / f"{name}.parquet")
    (folder / "vehicle.toml").write_text(produced.vehicle, "utf-8")
    write_json(truth, produced.truth)


def is_complete(out: Path, case: Case) -> bool:
    """Whether nothing of a case is missing."""
    folder = flights_folder(out, case)
    names = [f"{name}.parquet" for name in missions_of(case)] + ["vehicle.toml"]
    return truth_file(out, case).is_file() and all((folder / n).is_file() for n in names)


def flights_folder(out: Path, case: Case) -> Path:
    """Where the flights of a case lie."""
    return out / "flights" / case.id


def truth_file(out: Path, case: Case) -> Path:
    """Where the truth of a case lies."""
    return out / "truth" / f"{case.id}.json"


if __name__ == "__main__":
    raise SystemExit(main())
