"""The set of cases that looks like life: today's kinds of all sizes, and those of this folder.

Spread over plants, aircraft, noise and conditions; the same cases each time.
"""

from collections.abc import Iterable, Iterator
from itertools import count, cycle, islice, product

import numpy as np

from ..cases import MAGNITUDES, NOISE_LEVELS, Case, cases, digest, round_robin
from ..plants.kinds import PLANTS, Plant
from .conditions import NORMAL_FLIGHTS, SENSORS, Conditions
from .many import can_show, draw_effects

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
