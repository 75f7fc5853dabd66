"""Every case of the benchmark: what is hidden, how much, with which sensors, by which seed.

Two halves of plants and effects: thresholds and priors are chosen on one, the other scores them.

The digest of plant and hidden effects decides, so that an effect that was tuned on in one plant is
never scored in it, whatever its size, noise and seed. Where nothing is hidden, or one of a few
things has happened to a calibrated aircraft, the seed decides as well.

A case is named by a hash: the name of its folder says nothing about what is hidden in it.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

from .plants.kinds import EFFECTS, PLANTS, Plant

TUNE, SCORE = HALVES = ("tune", "score")


def half_of(plant: str, kind: str, effects: Iterable[str], seed: int) -> str:
    """The half that a case belongs to."""
    names = "+".join(sorted(effects))
    text = f"{plant}/{names}"
    if not names or kind == "since":
        text += f"/{kind}/{seed}"
    return HALVES[hashlib.sha256(text.encode()).digest()[0] % 2]


SENSORS = {
    "field": ("mag_", "baro_"),
    "velocity": ("vel_",),
    "inertial": ("acc_", "gyro_", "mag_", "baro_", "vel_"),
}
"""Columns of the flight table, by their beginnings, that go with a group of sensors."""
NORMAL_FLIGHTS = 5
"""Of a case in which something happens to a calibrated aircraft."""


@dataclass(frozen=True)
class Conditions:
    """How life is.

    Attributes:
        off: Whether the numbers of the vehicle file are off by their own standard deviations.
        days: Whether every flight has small constants of its own.
        rotors: Whether the log has rotor speeds in place of commands, and the file their map.
        without: Group of sensors that the log lacks, a key of `SENSORS`; "" for none.
        fits: Flights to fit on.
        slow: Whether all flights hover or go round at a walk.
    """

    off: bool = False
    days: bool = False
    rotors: bool = False
    without: str = ""
    fits: int = 2
    slow: bool = False

    @property
    def key(self) -> str:
        """Text that tells them from all others; empty for those of today's cases."""
        usual = asdict(Conditions())
        return ",".join(f"{k}={v}" for k, v in asdict(self).items() if v != usual[k])

    @property
    def as_json(self) -> dict[str, Any]:
        """For the truth file."""
        return asdict(self)


MAGNITUDES = ("small", "medium", "large")
NOISE_LEVELS = ("low", "medium", "high")
_SHARES = {"single": 0.5, "nothing": 0.2, "pair": 0.2, "outside": 0.1, "triple": 0.1}
"""Of a subset, where it is to hold all kinds but triples; what is missing is shared out."""


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        plant: Name of the plant.
        kind: single, pair, triple, outside or nothing; in the set of `life` many, uncertain or
            since, too.
        effects: Names of the hidden effects; of since, the class of what has happened.
        magnitude: small, medium or large; "none" when nothing is hidden, "mixed" where each
            effect has its own.
        noise: Level of the sensors.
        seed: Draws sizes, signs, missions and noise.
        life: What it has beside what is hidden.
    """

    plant: str
    kind: str
    effects: tuple[str, ...]
    magnitude: str
    noise: str
    seed: int
    life: Conditions = field(default_factory=Conditions)

    @property
    def key(self) -> str:
        """Text that tells it from all others."""
        effects = "+".join(self.effects)
        key = f"{self.plant}/{effects}/{self.magnitude}/{self.noise}/{self.seed}"
        return f"{key}/{self.kind}/{self.life.key}" if self.life.key else key

    @property
    def id(self) -> str:
        """Name of its folder."""
        return digest(self.key)[:12]

    @property
    def entropy(self) -> int:
        """Where its random numbers start."""
        return int(digest(self.key + "/random")[:15], 16)

    @property
    def aircraft(self) -> str:
        """Name of the aircraft that flies it."""
        names = PLANTS[self.plant].aircraft
        return names[self.seed % len(names)]


def cases(plants: Iterable[str] = PLANTS) -> list[Case]:
    """All cases of some plants."""
    return [case for name in plants for case in _cases(PLANTS[name])]


def _cases(plant: Plant) -> Iterator[Case]:
    for noise in NOISE_LEVELS:
        for name in plant.effects:
            kind = "outside" if EFFECTS[name].outside else "single"
            for magnitude in MAGNITUDES:
                for seed in range(plant.seeds):
                    yield Case(plant.name, kind, (name,), magnitude, noise, seed)
        for pair in plant.pairs:
            for seed in range(plant.seeds):
                yield Case(plant.name, "pair", pair, "medium", noise, seed)
        for triple in plant.triples:
            for seed in range(plant.seeds):
                yield Case(plant.name, "triple", triple, "medium", noise, seed)
        for seed in range(plant.quiet_seeds):
            yield Case(plant.name, "nothing", (), "none", noise, seed)


def subset(every: Iterable[Case], size: int) -> list[Case]:
    """So many cases, spread evenly over plants, kinds and effects; the same ones each time."""
    every = list(every)
    chosen: list[Case] = []
    kinds = [k for k in _SHARES if any(c.kind == k for c in every)]
    whole = sum(_SHARES[k] for k in kinds)
    for kind in kinds:
        wanted = round(size * _SHARES[kind] / whole)
        chosen += round_robin([c for c in every if c.kind == kind], wanted)
    return chosen


def round_robin(every: list[Case], wanted: int) -> list[Case]:
    """One of each effect (and plant), then a second of each, and so on."""
    strata: dict[tuple[str, ...], list[Case]] = {}
    for case in sorted(every, key=lambda c: digest(c.key)):
        strata.setdefault((case.plant, *case.effects), []).append(case)
    rounds = max((len(s) for s in strata.values()), default=0)
    order = [s[i] for i in range(rounds) for s in strata.values() if i < len(s)]
    return order[:wanted]


def digest(text: str) -> str:
    """A number in hexadecimals that is the same everywhere."""
    return hashlib.sha256(text.encode()).hexdigest()
