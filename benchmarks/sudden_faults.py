"""Sudden faults planted in simulated flights, and what `why` says of them without a vehicle file.

    python -m benchmarks.sudden_faults [--seeds N] [--journal answers.jsonl]
    SCIPY_ARRAY_API=1 python -m benchmarks.sudden_faults --plant drone_models

The built-in vehicles fly random waypoints in wind and turbulence, as in `live_alarms`; a rotor
loses 10 to 100 % of its thrust, the mass changes, a gust comes, a gyroscope gets a bias, or nothing
happens. Commands are logged at 200 Hz, or at 10 Hz as PX4 logs them. Seeds below 1000 chose the
levels of `twin.why`, those from 1000 on are scored. `drone_models` is somebody else's simulator
(`sudden_elsewhere`). A journal keeps each answer, so that a run goes on where it ended. Beside it
stands the trivial rule: when the outputs part by 150 us after six seconds of flight, the highest is
the failed rotor.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from msgspec import Struct, json
from numpy.typing import NDArray

from twin.flight.closed_loop import STEP_S
from twin.flight.simulate_flight import Later, Recorder, simulate_flight
from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.vehicle import Vehicle
from twin.why import diagnose
from twin.why.motion import moved
from twin.why.rules import RuleReading, parted
from uavtwin.demo.flights import Waypoints, setpoints_along

from . import sudden_elsewhere
from .live_alarms import flights as plants
from .sudden_elsewhere import Flown

Array = NDArray[np.float64]
Key = tuple[str, float, int, float]
"""Cause, size, seed, rate of the commands, Hz."""
OWN = "own"
"""The project's own plants."""

LOSSES = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
"""Shares of the thrust of one rotor."""
FAULTS = (
    *(("rotor_failure", s) for s in LOSSES),
    ("mass_change", -0.3),
    ("mass_change", 0.3),
    ("gust", 8.0),
    ("gyro_bias", 0.06),
    ("", 0.0),
)
"""Cause and size: share of thrust, share of mass, m/s, rad/s; "": nothing."""
FAULTS_ELSEWHERE = (
    *(("rotor_failure", s) for s in (0.2, 0.3, 0.5, 0.7, 1.0)),
    ("mass_change", -0.3),
    ("mass_change", 0.3),
    ("", 0.0),
)
"""The same in flights of somebody else's simulator."""
RATES_HZ = (200.0, 10.0)
"""Of the logged commands."""
BEGINS_S, AFTER_S, CLEAN_S = (22.0, 30.0), 8.0, 120.0
"""When a fault begins, what is flown after it, and how long without one."""
GUST_S = 0.4
"""Standard deviation of the envelope of a gust."""
SCORED = 1000
"""First seed that is scored."""
CLOSE = 0.25
"""What counts as the right size."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is flown, and through what air.

    Attributes:
        setpoints: Of the controller.
        phases: Of the flight, one for each setpoint.
        courses: Wind, m/s, and voltage, V, over time, each `STEP_S`.
        later: Effect that begins; None: none does.
        rotor: Of the fault, from 1; None: of none.
        begins_s: When the fault begins, s; infinity: there is none.
        seed: Of the noise of the sensors.
    """

    setpoints: Array
    phases: Sequence[str]
    courses: dict[str, Array]
    later: Later | None
    rotor: int | None
    begins_s: float
    seed: int


@dataclass(frozen=True, slots=True)
class Planted:
    """One flight.

    Attributes:
        cause: Of the fault; "": nothing.
        size: See `FAULTS`.
        seed: Of everything that is drawn.
        rate_hz: Of the commands.
    """

    cause: str
    size: float
    seed: int
    rate_hz: float = 200.0

    @property
    def lively(self) -> bool:
        """Whether nothing fails, but much happens."""
        return not self.cause and self.size > 0

    @property
    def vehicle(self) -> Vehicle:
        """Which flies."""
        return plants.aircraft(plants.AIRCRAFT[self.seed % len(plants.AIRCRAFT)])

    def flown(self) -> tuple[Flight, float, int | None]:
        """The flight, when its fault begins, and its rotor from 1."""
        v, plan = self.vehicle, self.planned()
        name = f"{self.cause or 'nothing'}_{self.size:g}_{self.seed}"
        flight = simulate_flight(
            plan.setpoints,
            plan.phases,
            v,
            v,
            self._recorder(v, plan.seed),
            name,
            later=plan.later,
            courses=plan.courses,
        )
        return flight, plan.begins_s, plan.rotor

    def planned(self) -> "Plan":
        """What is flown, and through what air."""
        rng = np.random.default_rng([self.seed, *self.cause.encode(), int(1000 * abs(self.size))])
        v = self.vehicle
        begins_s = float(rng.uniform(*BEGINS_S)) if self.cause else np.inf
        seconds = begins_s + AFTER_S if self.cause else CLEAN_S
        legs = plants.waypoints(v, seconds, rng)
        setpoints, phases = setpoints_along(v, lively(v, legs, rng) if self.lively else legs)
        courses = plants.air(len(setpoints), rng)
        if self.lively:
            _make_gusty(courses, rng)
        courses["vbat_v"] = plants.voltage(v, len(setpoints), np.inf)
        later, rotor = self._later(v, begins_s, rng)
        if self.cause == "gust":
            t, angle = STEP_S * np.arange(len(setpoints)), float(rng.uniform(0, 2 * np.pi))
            blow = self.size * np.exp(-0.5 * ((t - begins_s) / GUST_S) ** 2)
            courses["wind_x"] += np.cos(angle) * blow
            courses["wind_y"] += np.sin(angle) * blow
        seed = int(rng.integers(2**31))
        return Plan(setpoints, phases, courses, later, rotor, begins_s, seed)

    def _later(
        self, v: Vehicle, begins_s: float, rng: np.random.Generator
    ) -> tuple[Later | None, int | None]:
        """The effect that begins, and its rotor."""
        if self.cause == "rotor_failure":
            numbers = plants.numbers("rotor_efficiency_loss", self.size, v, rng)
            rotor = next(i for i in range(1, v.rotors.count + 1) if numbers[f"loss_{i}"] > 0)
            return Later({"rotor_efficiency_loss": numbers}, begins_s), rotor
        if self.cause == "mass_change":
            return Later({"mass_offset": {"mass_kg": self.size * v.mass_kg}}, begins_s), None
        if self.cause == "gyro_bias":
            bias = plants.numbers("gyro_bias", self.size, v, rng)
            return Later({"gyro_bias": bias}, begins_s), None
        return None, None

    def _recorder(self, v: Vehicle, seed: int) -> Recorder:
        made = plants.recorder_of(v, seed)
        drives = motor_columns("cmd" if v.drive == "command" else "rotor", v.rotors.count)
        slower = [
            replace(s, period_s=1 / self.rate_hz) for s in made.streams if s.columns == drives
        ]
        others = [s for s in made.streams if s.columns != drives]
        return replace(made, streams=(*slower, *others))


def lively(v: Vehicle, legs: Waypoints, rng: np.random.Generator) -> Waypoints:
    """Waypoints with throttle punches and landings between some of them."""
    out, top = [], 1.0 if v.arm_m < 0.06 else 3.0
    for k, (phase, seconds, (x, y, z)) in enumerate(legs):
        out.append((phase, seconds, (x, y, z)))
        what = rng.uniform() if k > 3 else 1.0
        if what < 0.15:
            quick = 2.0 * float(np.sqrt(top / 4.0)) * float(rng.uniform(0.9, 1.4))
            out += [("forward", quick, (x, y, z - top)), ("forward", 1.3 * quick, (x, y, z))]
        elif what < 0.22:
            out += [("land", 3.0, (x, y, 0.0)), ("ground", 2.0, (x, y, 0.0))]
            out += [("takeoff", 3.0, (x, y, z))]
    return tuple(out)


def _make_gusty(courses: dict[str, Array], rng: np.random.Generator) -> None:
    """Wind of up to 6 m/s more, three times the turbulence, and a gust every ten seconds."""
    t, angle = STEP_S * np.arange(len(courses["wind_x"])), float(rng.uniform(0, 2 * np.pi))
    extra = float(rng.uniform(0.0, 6.0)) * np.array([np.cos(angle), np.sin(angle), 0.0])
    for k, axis in enumerate("xyz"):
        w = courses[f"wind_{axis}"]
        w[:] = w.mean() + 3.0 * (w - w.mean()) + extra[k]
    for begins_s in np.arange(5.0, t[-1], 10.0) + rng.uniform(-4.0, 4.0):
        toward = rng.standard_normal(3) * (1.0, 1.0, 0.4)
        size, long_s = float(rng.uniform(1.0, 4.0)), float(rng.uniform(0.3, 2.0))
        blow = size * np.exp(-0.5 * ((t - begins_s) / long_s) ** 2)
        for k, axis in enumerate("xyz"):
            courses[f"wind_{axis}"] += toward[k] / np.linalg.norm(toward) * blow


class Answer(Struct, frozen=True, kw_only=True):
    """What was said of one flight.

    Attributes:
        plant: Which simulator flew it.
        planted: Cause, size, seed, and rate of the commands, Hz.
        begins_s: Onset of its fault; null: it has none.
        rotor: Of the fault.
        cause: The first that is named; "": none.
        named_rotor: Its rotor.
        onset_s: Its onset.
        size: As it is said.
        trivial: Rotor that the trivial rule names; null: it is silent.
        processor_s: Of the finder.
        flown_s: How long the flight is.
    """

    plant: str
    planted: tuple[str, float, int, float]
    begins_s: float | None
    rotor: int | None
    cause: str
    named_rotor: int | None
    onset_s: float | None
    size: float | None
    trivial: int | None
    processor_s: float
    flown_s: float

    @classmethod
    def of(cls, plant: str, planted: Key, flown: Flown) -> "Answer":
        """Ask of a flight."""
        flight, began = flown.flight, process_time()
        found = diagnose(flight, finders=[moved])
        spent, read = process_time() - began, trivial_rule(flight)
        first = found.events[0] if found.events else None
        return cls(
            plant=plant,
            planted=planted,
            begins_s=flown.begins_s if np.isfinite(flown.begins_s) else None,
            rotor=flown.rotor,
            cause="" if first is None else first.cause,
            named_rotor=first.rotor[0] if first and first.rotor else None,
            onset_s=None if first is None else first.onset_s,
            size=first.severity.value if first and first.severity else None,
            trivial=None if read is None else read.rotor,
            processor_s=spent,
            flown_s=float(flight.time_s[-1] - flight.time_s[0]),
        )

    @property
    def late_s(self) -> float:
        """Of the onset."""
        return np.inf if self.onset_s is None else self.onset_s - (self.begins_s or 0.0)


def trivial_rule(flight: Flight) -> RuleReading | None:
    """What the commands, or the speeds over the largest, say by `parted`."""
    stem = "cmd" if flight.has("cmd_1") else "rotor"
    count = sum(flight.has(f"{stem}_{i}") for i in range(1, 13))
    t, c = flight.signal(motor_columns(stem, count))
    return parted(t, c / max(float(np.percentile(c, 99.5)), 1.0))


def page(answers: Sequence[Answer]) -> str:
    """The table of `docs/results/why.md`."""
    return "\n".join(_lines(answers))


def _lines(answers: Sequence[Answer]) -> Iterator[str]:
    header = ("plant, commands", "planted", "flights", "named", "its rotor", "size within 25 %")
    yield "| " + " | ".join((*header, "another cause or rotor", "onset, median", "trivial")) + " |"
    yield "|---" * (len(header) + 3) + "|"
    groups: dict[tuple[str, float, str, float], list[Answer]] = {}
    for a in answers:
        cause, size, _, rate = a.planted
        groups.setdefault((a.plant, rate, cause, size), []).append(a)
    for group, mine in groups.items():
        yield _row(*group, mine)


def _row(plant: str, rate: float, cause: str, size: float, mine: Sequence[Answer]) -> str:
    right = [a for a in mine if a.cause == cause] if cause else []
    where = [a for a in right if a.named_rotor == a.rotor]
    close = [a for a in where if a.size is not None and size and abs(a.size / size - 1) <= CLOSE]
    late = f"{np.median([abs(a.late_s) for a in right]):.2f} s" if right else ""
    of_rotor = cause == "rotor_failure"
    rule = [a for a in mine if a.trivial is not None and (a.trivial == a.rotor or not of_rotor)]
    cells = (
        f"{plant}, {rate:g} Hz",
        f"{cause.replace('_', ' ')} {size:g}"
        if cause
        else "nothing, lively"
        if size
        else "nothing",
        f"{len(mine)}",
        f"{len(right)}" if cause else "",
        f"{len(where)}" if of_rotor else "",
        f"{len(close)}" if cause in ("rotor_failure", "mass_change") else "",
        f"{sum(a.cause != '' for a in mine) - len(where)}",
        late,
        f"{len(rule)}" if of_rotor else f"{len(rule)} named",
    )
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Fly, ask and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=SCORED)
    parser.add_argument("--plant", choices=(OWN, sudden_elsewhere.PLANT), default=OWN)
    parser.add_argument("--journal", type=Path)
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    faults = FAULTS if given.plant == OWN else FAULTS_ELSEWHERE
    keys = [(*fault, seed, rate) for rate in RATES_HZ for fault in faults for seed in seeds]
    answers = list(answered(given.plant, keys, given.journal))
    print(page(answers))
    spent, flown = (sum(getattr(a, n) for a in answers) for n in ("processor_s", "flown_s"))
    print(f"\n{flown / 3600:.2f} h flown; processor for 60 s of them: {60 * spent / flown:.1f} s")


def answered(plant: str, keys: Sequence[Key], journal: Path | None) -> Iterator[Answer]:
    """Answers to all flights, those of the journal first."""
    lines = journal.read_text("utf-8").splitlines() if journal and journal.exists() else []
    known = {(a.plant, a.planted): a for a in (json.decode(x, type=Answer) for x in lines)}
    open_keys = [k for k in keys if (plant, k) not in known]
    yield from (known[plant, k] for k in keys if (plant, k) in known)
    for key, flown in zip(open_keys, _flights(plant, open_keys), strict=True):
        answer = Answer.of(plant, key, flown)
        if journal is not None:
            with journal.open("ab") as file:
                file.write(json.encode(answer) + b"\n")
        yield answer


def _flights(plant: str, keys: Sequence[Key]) -> Iterator[Flown]:
    """Flights one after the other; of another simulator those of one rate together."""
    if plant == OWN:
        yield from (Flown(*Planted(*key).flown()) for key in keys)
        return
    for rate in dict.fromkeys(k[3] for k in keys):
        yield from sudden_elsewhere.flown([k[:3] for k in keys if k[3] == rate], rate)


if __name__ == "__main__":
    main()
