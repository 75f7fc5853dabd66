"""Which flights teach, which are flown, and on whose vehicle file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.compensator.simulated import VEHICLE, Individual, individuals
from benchmarks.real_flights.scenarios import SCENARIOS, Scenario, read
from twin.logs import Flight, read_flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle

FINER, MOVING = "finer", "moving"
"""Groups of the simulated aircraft of blade elements: taught by hover and takeoff, as the paper
does, or by flights like those that are flown."""
RECORDED = ("real", "simulated", "nanobench")
"""Scenarios of `benchmarks.real_flights` whose flights have motion and IMU."""
GROUPS = (*RECORDED, FINER, MOVING)


@dataclass(frozen=True, slots=True)
class Places:
    """Where flights are.

    Attributes:
        data: Of recorded ones.
        work: Of simulated ones.
    """

    data: Path
    work: Path


@dataclass(frozen=True, slots=True)
class Rotation:
    """One training, and the flights that it is judged by.

    Attributes:
        group: Of `GROUPS`.
        name: Of the flight held out; of a simulated aircraft.
    """

    group: str
    name: str

    @property
    def simulated(self) -> bool:
        """Whether it is of an aircraft of blade elements, and not recorded."""
        return self.group not in RECORDED

    @property
    def indoors(self) -> bool | None:
        """Of these flights, as `explain` wants it; None: as it finds them."""
        return None if self.simulated else self._scenario.indoors

    def files(self, places: Places) -> tuple[list[Path], list[Path]]:
        """Flights that teach, and those that are flown."""
        if self.simulated:
            one = self._aircraft
            taught, flown = (one.files(places.work, use) for use in ("train", "test"))
            if self.group == FINER:
                return taught, flown
            return [f for f in flown if f.stem.endswith("1")], [
                f for f in flown if not f.stem.endswith("1")
            ]
        paths = [places.data / f for f in self._scenario.flights]
        return [p for p in paths if p.stem != self.name], [p for p in paths if p.stem == self.name]

    def read(self, places: Places) -> tuple[list[Flight], list[Flight], Vehicle]:
        """The same, and the vehicle as it stands."""
        taught, flown = self.files(places)
        if self.simulated:
            vehicle = load_vehicle(self._aircraft.folder(places.work) / VEHICLE)
            return [read_flight(f) for f in taught], [read_flight(f) for f in flown], vehicle
        data, vehicle = places.data, self._scenario.read_vehicle()
        taught_here, flown_here = (
            [read(data, f.relative_to(data).as_posix()) for f in some] for some in (taught, flown)
        )
        return taught_here, flown_here, vehicle

    @property
    def _scenario(self) -> Scenario:
        return next(s for s in SCENARIOS if s.name == self.group)

    @property
    def _aircraft(self) -> Individual:
        return next(i for i in finer_aircraft() if i.name == self.name)


def rotations(groups: Sequence[str]) -> list[Rotation]:
    """Each recorded flight in turn held out; one simulated aircraft of each set of effects."""
    recorded = (
        Rotation(s.name, Path(f).stem) for s in SCENARIOS if s.name in RECORDED for f in s.flights
    )
    finer = (Rotation(g, one.name) for g in (FINER, MOVING) for one in finer_aircraft())
    every = (*recorded, *finer)
    return [r for group in GROUPS if group in groups for r in every if r.group == group]


def finer_aircraft() -> Sequence[Individual]:
    """One of each set of hidden effects."""
    return individuals(seeds=1)
