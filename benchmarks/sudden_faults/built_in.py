"""The built-in vehicles in closed loop, random waypoints, wind and turbulence, as in `live_alarms`.

A rotor loses thrust, the mass changes, or nothing happens: quick to fly, for tests; and flights in
which nothing fails, but much happens.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.live_alarms import flights as plants
from twin.flight.closed_loop import STEP_S
from twin.flight.simulate_flight import Later, Recorder, simulate_flight
from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.vehicle import Vehicle
from uavtwin.demo.flights import Waypoints, setpoints_along

from .kinds import GUST_S

Array = NDArray[np.float64]
BEGINS_S, AFTER_S, CLEAN_S = (22.0, 30.0), 8.0, 120.0
"""When a fault begins, what is flown after it, and how long without one."""


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
        gusts_s: When planted gusts rise most quickly, s.
    """

    setpoints: Array
    phases: Sequence[str]
    courses: dict[str, Array]
    later: Later | None
    rotor: int | None
    begins_s: float
    seed: int
    gusts_s: Sequence[float] = ()


@dataclass(frozen=True, slots=True)
class Planted:
    """One flight.

    Attributes:
        cause: "rotor_failure", "mass_change", "gust"; "": nothing.
        size: Share of the thrust of a rotor or of the mass, or m/s; where nothing fails, whether
            much happens.
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
        gusts_s = _make_gusty(courses, rng) if self.lively else []
        courses["vbat_v"] = plants.voltage(v, len(setpoints), np.inf)
        later, rotor = self._later(v, begins_s, rng)
        if self.cause == "gust":
            t, angle = STEP_S * np.arange(len(setpoints)), float(rng.uniform(0, 2 * np.pi))
            blow = self.size * np.exp(-0.5 * ((t - begins_s) / GUST_S) ** 2)
            courses["wind_x"] += np.cos(angle) * blow
            courses["wind_y"] += np.sin(angle) * blow
            gusts_s.append(begins_s - GUST_S)
        seed = int(rng.integers(2**31))
        return Plan(setpoints, phases, courses, later, rotor, begins_s, seed, gusts_s)

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


def _make_gusty(courses: dict[str, Array], rng: np.random.Generator) -> list[float]:
    """Wind of up to 6 m/s more, three times the turbulence, and a gust every ten seconds; when
    these rise most quickly, s."""
    t, angle = STEP_S * np.arange(len(courses["wind_x"])), float(rng.uniform(0, 2 * np.pi))
    extra = float(rng.uniform(0.0, 6.0)) * np.array([np.cos(angle), np.sin(angle), 0.0])
    for k, axis in enumerate("xyz"):
        w = courses[f"wind_{axis}"]
        w[:] = w.mean() + 3.0 * (w - w.mean()) + extra[k]
    rises_s = []
    for begins_s in np.arange(5.0, t[-1], 10.0) + rng.uniform(-4.0, 4.0):
        toward = rng.standard_normal(3) * (1.0, 1.0, 0.4)
        size, long_s = float(rng.uniform(1.0, 4.0)), float(rng.uniform(0.3, 2.0))
        blow = size * np.exp(-0.5 * ((t - begins_s) / long_s) ** 2)
        rises_s.append(float(begins_s) - long_s)
        for k, axis in enumerate("xyz"):
            courses[f"wind_{axis}"] += toward[k] / np.linalg.norm(toward) * blow
    return rises_s
