"""What a sweep will run: the systems, built once each, and the start values of every run."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cosim.slave.interface import read_interface
from cosim.ssp import read_ssp
from cosim.system import System
from twin.component.variable import check_range
from twin.errors import TwinError
from twin.flight.assembly import Assembly, flying_twin
from twin.representation import short_repr

from ..simulation import (
    DEFAULT_VEHICLE,
    Scenario,
    Times,
    ineffective,
    scenario_system,
    shaping_starts,
    times_of,
)
from ..vehicles import Vehicle, load_vehicle
from .design import Design
from .distributions import Value
from .factors import period_of, scenario_of
from .outcome import WATCHED

STEP_S = 0.01
"""Communication step of the twin in one FMU, which inside steps by 1 ms all the same."""
MOST_SYSTEMS = 100
TWIN = "twin."
"""Before the names of the twin in one FMU."""


@dataclass(frozen=True, slots=True)
class Stand:
    """A system that several runs share.

    Attributes:
        system: FMUs and connections.
        times: Of each run.
        record: Outputs that are recorded; None: all.
        arm_m: Of the aircraft; None: nothing is known to fly.
    """

    system: System
    times: Times
    record: tuple[str, ...] | None
    arm_m: float | None

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Job:
    """One run.

    Attributes:
        run: Number, from 0 on.
        stand: Of `Plan.stands`.
        starts: Start values on top of the system's.
    """

    run: int
    stand: int
    starts: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Plan:
    """All of a sweep.

    Attributes:
        stands: Systems.
        jobs: Runs, in order.
        points: Factors of each run.
        scenarios: Of each run.
        periods: Of factors that are angles: what a whole turn is.
        warnings: What the windiest run of a system asks for although it changes nothing.
    """

    stands: tuple[Stand, ...]
    jobs: tuple[Job, ...]
    points: Sequence[Mapping[str, Value]]
    scenarios: Sequence[Scenario]
    periods: Mapping[str, float]
    warnings: tuple[str, ...]

    __repr__ = short_repr


def plan_of(
    base: Scenario,
    design: Design,
    folder: Path,
    duration_s: float | None = None,
    step_s: float | None = None,
    whole: bool = False,
    progress: Callable[[float], None] = lambda _: None,
) -> Plan:
    """Build what is needed; every name and value of every run is looked at.

    Args:
        base: What all runs share; an aircraft flies as one FMU.
        design: What they differ in.
        folder: For the FMUs.
        duration_s: Of each run; None: the mission's, or the system's own.
        step_s: Communication step; None: 10 ms, which inside are 1 ms, or the system's own.
        whole: Whether recordings are kept, with every output.
        progress: Called with the share built, 0..1.

    Raises:
        TwinError: An unknown name, a value outside its range, or too many systems.
    """
    base = base if base.is_system else replace(base, fused=True)
    points = design.points()
    vehicles: dict[str, Vehicle] = {}
    scenarios: list[Scenario] = []
    places: dict[tuple[str, str, str], int] = {}
    where: list[int] = []
    for run, factors in enumerate(points):
        scenario = scenario_of(base, factors, design.seed + run)
        if "vehicle" in factors:
            name = str(factors["vehicle"])
            if name not in vehicles:
                vehicles[name] = load_vehicle(name)
            scenario = replace(scenario, vehicle=vehicles[name])
        scenarios.append(scenario)
        key = (str(scenario.target), str(factors.get("vehicle", "")), scenario.controller)
        where.append(places.setdefault(key, len(places)))
    if len(places) > MOST_SYSTEMS:
        raise TwinError(
            f"sweep: {len(places)} combinations of mission, vehicle and controller, at most "
            f"{MOST_SYSTEMS} are built."
        )
    firsts = [scenarios[where.index(number)] for number in range(len(places))]
    twins = [None if s.is_system else _twin(s) for s in firsts]
    checks = [
        _of_system(s) if t is None else _of_twin(t) for s, t in zip(firsts, twins, strict=True)
    ]
    units = _units_of_system(firsts[0]) if twins[0] is None else _units_of_twin(twins[0])
    jobs = [
        Job(run, k, checks[k](run, s))
        for run, (k, s) in enumerate(zip(where, scenarios, strict=True))
    ]
    stands = []
    for number, first in enumerate(firsts):
        own = folder / str(number)
        own.mkdir(parents=True, exist_ok=True)
        stands.append(_stand(first, own, duration_s, step_s, whole))
        progress((number + 1) / len(firsts))
    periods = {n: p for n in design.vary if (p := period_of(n, units)) is not None}
    windiest = [
        max((s for k, s in zip(where, scenarios, strict=True) if k == n), key=_wind)
        for n in range(len(places))
    ]
    idle = {
        text: None
        for scenario, twin in zip(windiest, twins, strict=True)
        if twin is not None
        for text in ineffective(twin.with_starts(shaping_starts(twin, scenario)), scenario)
    }
    return Plan(tuple(stands), tuple(jobs), points, scenarios, periods, tuple(idle))


Check = Callable[[int, Scenario], Mapping[str, float]]
"""From a run and its scenario to its start values, each within its range."""


def _wind(scenario: Scenario) -> tuple[float, bool]:
    """By which the windiest of several scenarios is found."""
    return math.hypot(*scenario.wind_m_s), scenario.gusts


def _vehicle(scenario: Scenario) -> Vehicle:
    return Vehicle.of(scenario.vehicle or load_vehicle(DEFAULT_VEHICLE))


def _twin(scenario: Scenario) -> Assembly:
    return flying_twin(_vehicle(scenario), str(scenario.target), scenario.controller)


def _stand(
    first: Scenario, folder: Path, duration_s: float | None, step_s: float | None, whole: bool
) -> Stand:
    """The system of a scenario, without what its runs differ in."""
    if first.is_system:
        system = scenario_system(replace(first, starts={}), folder)
        return Stand(system, _times(system, duration_s, step_s), None, None)
    bare = replace(first, starts={}, effects=(), wind_m_s=(0.0, 0.0, 0.0), gusts=False, seed=0)
    system = scenario_system(bare, folder)
    times = _times(system, duration_s, STEP_S if step_s is None else step_s)
    record = None if whole else tuple(n for n in _named(system) if n.removeprefix(TWIN) in WATCHED)
    return Stand(system, times, record, _vehicle(first).arm_m)


def _times(system: System, duration_s: float | None, step_s: float | None) -> Times:
    stop = None if duration_s is None else system.start_time_s + duration_s
    return times_of(system, stop, step_s)


def _named(system: System) -> list[str]:
    """All outputs, "slave.output"."""
    return [
        f"{slave}.{port.name}"
        for slave, path in system.fmus.items()
        for port in read_interface(path).ports.values()
        if port.causality == "output"
    ]


def _units_of_twin(twin: Assembly) -> dict[str, str]:
    """Units of its start values, "part.variable" -> unit."""
    return {f"{k}.{v.name}": v.unit for k, part in twin.parts.items() for v in part.variables}


def _units_of_system(first: Scenario) -> dict[str, str]:
    """Units of the variables of an `.ssp`, "slave.variable" -> unit."""
    system = read_ssp(Path(first.target))  # holds the unpacked FMUs
    return {
        f"{slave}.{port.name}": port.unit or ""
        for slave, path in system.fmus.items()
        for port in read_interface(path).ports.values()
    }


def _of_twin(twin: Assembly) -> Check:
    known = {f"{k}.{v.name}": (k, v) for k, part in twin.parts.items() for v in part.variables}
    plain = {name: v.start for name, (_, v) in known.items()}

    def check(run: int, scenario: Scenario) -> dict[str, float]:
        """Start values that differ from those of the twin."""
        starts = shaping_starts(twin, scenario)
        for name, value in starts.items():
            if name not in known:
                twin.with_starts({name: value})  # says what is wrong
            part, variable = known[name]
            check_range(f"run {run}: {part}", variable, value)
        return {f"{TWIN}{n}": v for n, v in starts.items() if v != plain[n]}

    return check


def _of_system(first: Scenario) -> Check:
    system = read_ssp(Path(first.target))
    interfaces = {name: read_interface(path) for name, path in system.fmus.items()}

    def check(run: int, scenario: Scenario) -> Mapping[str, float]:
        """Start values of slaves."""
        del run  # the FMU says at its start what it does not take
        for name in scenario.starts:
            slave, variable = system.split(name)
            interfaces[slave].scalar(variable)
        return scenario.starts

    return check
