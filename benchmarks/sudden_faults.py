"""Sudden faults planted in simulated flights, and what `why` says of them without a vehicle file.

    python -m benchmarks.sudden_faults [--seeds N] [--page docs/results/why.md]

The built-in vehicles fly random waypoints in wind and turbulence, as in `live_alarms`; a rotor
loses 10 to 100 % of its thrust, the mass changes, a gust comes, a gyroscope gets a bias, or nothing
happens. Commands are logged at 200 Hz, or at 10 Hz as PX4 logs them. Seeds below 1000 chose the
levels of `twin.why`, those from 1000 on are scored. Beside it stands the trivial rule: when the
outputs part by 150 us after six seconds of flight, the highest is the failed rotor.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray

from twin.flight.closed_loop import STEP_S
from twin.flight.simulate_flight import Later, Recorder, simulate_flight
from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.vehicle import Vehicle
from twin.why import Diagnosis, diagnose
from twin.why.motion import moved
from twin.why.rules import RuleReading, parted
from uavtwin.demo.flights import Waypoints, setpoints_along

from .live_alarms import flights as plants

Array = NDArray[np.float64]

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
        recorder = self._recorder(v, int(rng.integers(2**31)))
        name = f"{self.cause or 'nothing'}_{self.size:g}_{self.seed}"
        flight = simulate_flight(
            setpoints, phases, v, v, recorder, name, later=later, courses=courses
        )
        return flight, begins_s, rotor

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


@dataclass(frozen=True, slots=True)
class Answer:
    """What was said of one flight.

    Attributes:
        planted: The flight.
        begins_s: Onset of its fault.
        rotor: Of the fault.
        found: By `why`.
        trivial: What the trivial rule reads; None: it is silent.
        processor_s: Of the finder.
    """

    planted: Planted
    begins_s: float
    rotor: int | None
    found: Diagnosis
    trivial: RuleReading | None
    processor_s: float

    @classmethod
    def of(cls, planted: Planted) -> "Answer":
        """Fly it and ask."""
        flight, begins_s, rotor = planted.flown()
        began = process_time()
        found = diagnose(flight, finders=[moved])
        spent = process_time() - began
        return cls(planted, begins_s, rotor, found, trivial_rule(flight), spent)

    @property
    def first(self) -> tuple[str, int | None]:
        """The first cause that is named, and its rotor."""
        if not self.found.events:
            return "", None
        event = self.found.events[0]
        return event.cause, event.rotor[0] if event.rotor else None

    @property
    def late_s(self) -> float:
        """Of the onset."""
        onset_s = self.found.events[0].onset_s if self.found.events else None
        return np.inf if onset_s is None else onset_s - self.begins_s

    @property
    def size(self) -> float:
        """As it is said; NaN: it is not."""
        severity = self.found.events[0].severity if self.found.events else None
        return np.nan if severity is None else severity.value


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
    header = ("commands", "planted", "flights", "named", "rotor", "size within 25 %")
    yield "| " + " | ".join((*header, "onset, median", "trivial rule")) + " |"
    yield "|---" * (len(header) + 2) + "|"
    groups = dict.fromkeys((a.planted.rate_hz, a.planted.cause, a.planted.size) for a in answers)
    for rate, cause, size in groups:
        mine = [
            a
            for a in answers
            if (a.planted.rate_hz, a.planted.cause, a.planted.size) == (rate, cause, size)
        ]
        yield _row(rate, cause, size, mine)


def _row(rate: float, cause: str, size: float, mine: Sequence[Answer]) -> str:
    right = [a for a in mine if a.first[0] == cause]
    where = [a for a in right if a.first[1] == a.rotor]
    close = [a for a in where if abs(a.size / size - 1) <= CLOSE] if size else []
    late = f"{np.median([abs(a.late_s) for a in right]):.2f} s" if cause and right else ""
    if cause == "rotor_failure":
        simple = f"{sum(a.trivial is not None and a.trivial.rotor == a.rotor for a in mine)}"
        rotors, sizes = f"{len(where)}", f"{len(close)}"
    else:
        simple = f"{sum(a.trivial is not None for a in mine)} rotors named"
        rotors, sizes = "", f"{len(close)}" if cause == "mass_change" else ""
    what = f"{cause.replace('_', ' ')} {size:g}" if cause else "nothing"
    named = f"{len(right)}" if cause else f"{sum(a.first[0] != '' for a in mine)} false"
    return (
        f"| {rate:g} Hz | {what} | {len(mine)} | {named} | {rotors} | {sizes} | {late} | {simple} |"
    )


def main() -> None:
    """Fly, ask and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=SCORED)
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    answers = []
    for rate in RATES_HZ:
        for cause, size in FAULTS:
            for seed in range(given.first, given.first + given.seeds):
                answers.append(a := Answer.of(Planted(cause, size, seed, rate)))
                said = [(e.cause, e.rotor, e.onset_s) for e in a.found.events]
                print(a.planted, round(a.begins_s, 2), a.rotor, said, f"{a.processor_s:.1f} s")
    print(page(answers))
    if given.page is not None:
        before = given.page.read_text("utf-8").split("<!-- table -->")[0]
        given.page.write_text(f"{before}<!-- table -->\n\n{page(answers)}\n", "utf-8")


if __name__ == "__main__":
    main()
