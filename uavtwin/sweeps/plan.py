"""Plan of a sweep: the scenario, system and start values of each run.

Each system is built once; its runs differ by start values.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cosim.interface import read_interface
from cosim.ssp import read_ssp
from cosim.system import System
from cosim.whole_twin import STEP_S
from twin.component import unknown_name
from twin.component.component import check_range
from twin.effects import EFFECTS
from twin.errors import TwinError
from twin.flight.assembly import Assembly, flying_twin
from twin.representation import ShortRepr

from ..simulation import (
    DEFAULT_VEHICLE,
    Scenario,
    Times,
    check_bare,
    fused_system,
    ineffective,
    scenario_system,
    shaping_starts,
    times_of,
)
from ..vehicles import Vehicle, content_of, load_vehicle
from .design import Value
from .outcome import WATCHED

MOST_SYSTEMS = 100
"""Maximum number of systems in a sweep: vehicles times controllers times missions."""
TWIN = "twin."
"""Prefix of the twin's variables in the fused FMU."""


@dataclass(frozen=True, slots=True)
class SharedSystem(ShortRepr):
    """A system that several runs share.

    Attributes:
        system: FMUs and connections.
        times: Start, stop and step times of each run.
        record: Recorded outputs, "slave.output"; None: all.
        arm_m: Arm length of the aircraft, m; None: the system may not be an aircraft.
    """

    system: System
    times: Times
    record: tuple[str, ...] | None
    arm_m: float | None


@dataclass(frozen=True, slots=True)
class Job:
    """One run.

    Attributes:
        run: Number of the run, from 0.
        stand: Index of its system in `Plan.stands`.
        starts: Start values on top of the system's.
    """

    run: int
    stand: int
    starts: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Plan(ShortRepr):
    """All systems and runs of a sweep.

    Attributes:
        stands: Systems.
        jobs: Runs, in order.
        scenarios: Scenario of each run.
        units: Unit of each start value, "part.variable" -> unit.
        vehicles: Name of the vehicle of each system, with a number where another one has the same
            name; "" for an `.ssp`.
        plain: Start values of each system where a run sets none, "part.variable" -> value.
        idle: Requests without effect, by run: of every run where full recordings are stored, else
            of the windiest run of each system.
    """

    stands: tuple[SharedSystem, ...]
    jobs: tuple[Job, ...]
    scenarios: Sequence[Scenario]
    units: Mapping[str, str]
    vehicles: tuple[str, ...]
    plain: tuple[Mapping[str, float], ...]
    idle: Mapping[int, tuple[str, ...]]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Requests without effect, each once."""
        return tuple(dict.fromkeys(text for texts in self.idle.values() for text in texts))

    def start(self, job: Job, name: str) -> float:
        """Start value of a run, by "part.variable"; NaN: the default of an FMU of an `.ssp`, or
        there is none of this name."""
        plain = self.plain[job.stand].get(name, math.nan)
        return job.starts.get(name, job.starts.get(f"{TWIN}{name}", plain))

    def periods(self, factors: Iterable[str]) -> dict[str, float]:
        """Period of each factor that is an angle, by name: 360 or 2 pi."""
        return {n: p for n in factors if (p := period_of(n, self.units)) is not None}


def scenarios_of(
    base: Scenario, points: Sequence[Mapping[str, Value]], seed: int
) -> list[Scenario]:
    """The scenario of each run.

    Args:
        base: Scenario that all runs share; an aircraft flies as one FMU.
        points: Values of the factors in each run.
        seed: Random seed of the noise in run 0; run k uses seed + k.

    Raises:
        TwinError: A factor does not exist, or its value has the wrong type.
    """
    base = base if base.is_system else replace(base, fused=True)
    vehicles: dict[str, Vehicle] = {}
    found = []
    for run, factors in enumerate(points):
        scenario = scenario_of(base, factors, seed + run)
        if "vehicle" in factors:
            name = str(factors["vehicle"])
            if name not in vehicles:
                vehicles[name] = load_vehicle(name)
            scenario = replace(scenario, vehicle=vehicles[name])
        found.append(scenario)
    return found


def plan_of(
    scenarios: Sequence[Scenario],
    folder: Path,
    duration_s: float | None = None,
    step_s: float | None = None,
    interval_s: float | None = None,
    whole: bool = False,
    progress: Callable[[float], None] = lambda _: None,
    check_size: Callable[[float], None] = lambda _: None,
) -> Plan:
    """Build the systems and check every name and value of every run.

    Args:
        scenarios: Scenario of each run.
        folder: Folder for the FMUs.
        duration_s: Simulated time of each run, s; None: that of the mission or system.
        step_s: Communication step, s; None: 10 ms with internal steps of 1 ms, or that of the
            system.
        interval_s: Time between recorded rows, s; None: about 10 ms.
        whole: Whether full recordings with every output are stored.
        progress: Called with the share of systems built, 0..1.
        check_size: Called before building with the number of values of all full recordings.

    Raises:
        TwinError: An unknown name, a value outside its range, or too many systems.
    """
    places: dict[tuple[str, str, str], int] = {}
    distinct = {id(s.vehicle): s for s in scenarios}
    content = {which: content_of(_vehicle(s)) for which, s in distinct.items()}
    keys = [(str(s.target), content[id(s.vehicle)], s.controller) for s in scenarios]
    where = [places.setdefault(key, len(places)) for key in keys]
    if len(places) > MOST_SYSTEMS:
        raise TwinError(
            f"{len(places)} combinations of mission, vehicle and controller, at most "
            f"{MOST_SYSTEMS} are built."
        )
    firsts = [where.index(number) for number in range(len(places))]
    twins, checks = [], []
    for run in firsts:
        with of_run(run):
            first = scenarios[run]
            twin = None if first.is_system else _twin(first)
            twins.append(twin)
            checks.append(_of_system(first) if twin is None else _of_twin(twin))
    jobs = []
    for run, (k, s) in enumerate(zip(where, scenarios, strict=True)):
        with of_run(run):
            jobs.append(Job(run, k, checks[k](s)))
    each = [
        _size(scenarios[run], twin, duration_s, step_s, interval_s)
        for run, twin in zip(firsts, twins, strict=True)
    ]
    check_size(sum(each[k] for k in where))
    runs_of = [[run for run, k in enumerate(where) if k == n] for n in range(len(places))]
    stands, idle = [], {}
    for number, (start, twin) in enumerate(zip(firsts, twins, strict=True)):
        own = folder / str(number)
        own.mkdir(parents=True, exist_ok=True)
        repeated: list[str] = []
        given = scenarios[start], twin, own, duration_s, step_s, interval_s, whole, repeated.append
        stands.append(_stand(*given))
        progress((number + 1) / len(firsts))
        runs = runs_of[number]
        for run in runs if whole else [max(runs, key=lambda run: _wind(scenarios[run]))]:
            idle[run] = (*repeated, *_ineffective(twin, scenarios[run]))
    return Plan(
        tuple(stands),
        tuple(jobs),
        scenarios,
        _units_of_system(scenarios[0]) if twins[0] is None else _units_of_twin(twins[0]),
        tuple(_distinct_names([(scenarios[run], keys[run][1]) for run in firsts])),
        tuple(
            stand.system.starts if twin is None else _starts_of_twin(twin)
            for stand, twin in zip(stands, twins, strict=True)
        ),
        idle,
    )


@contextmanager
def of_run(run: int) -> Iterator[None]:
    """Name the run in an error.

    Raises:
        TwinError: That of the block, with the number of the run.
    """
    try:
        yield
    except TwinError as error:
        raise TwinError(f"run {run}: {error}") from error


def _ineffective(twin: Assembly | None, scenario: Scenario) -> list[str]:
    """Requests of a scenario without effect on its twin; none for an `.ssp`."""
    if twin is None:
        return []
    return ineffective(twin.with_starts(shaping_starts(twin, scenario)), scenario)


def _distinct_names(vehicles: Iterable[tuple[Scenario, str]]) -> Iterator[str]:
    """Name of each vehicle, given as its scenario and its content; with a number from the second of
    that name on."""
    known: dict[str, list[str]] = {}
    for scenario, content in vehicles:
        name = "" if scenario.is_system else _vehicle(scenario).name
        same = known.setdefault(name, [])
        if content not in same:
            same.append(content)
        number = same.index(content) + 1
        yield name if number == 1 else f"{name} ({number})"


def _size(
    first: Scenario,
    twin: Assembly | None,
    duration_s: float | None,
    step_s: float | None,
    interval_s: float | None,
) -> float:
    """Number of values in a full recording of a scenario, from what is known before building."""
    if twin is None:
        system = read_ssp(Path(first.target))
        columns = len(_named(system))
    else:
        system = System({}, stop_time_s=twin.duration_s, step_s=STEP_S)
        columns = sum(len(part.output_names) for part in twin.parts.values())
    return columns * _times(system, duration_s, step_s, interval_s).rows


def _times(
    system: System, duration_s: float | None, step_s: float | None, interval_s: float | None
) -> Times:
    """Times of each run of a system."""
    stop = None if duration_s is None else system.start_time_s + duration_s
    return times_of(system, stop, step_s, interval_s)


Check = Callable[[Scenario], Mapping[str, float]]
"""Function of a scenario that returns its start values, each within range."""


def _wind(scenario: Scenario) -> tuple[float, bool]:
    """Sort key for the windiest scenario."""
    return math.hypot(*scenario.wind_m_s), scenario.gusts


def _vehicle(scenario: Scenario) -> Vehicle:
    return Vehicle.of(scenario.vehicle or load_vehicle(DEFAULT_VEHICLE))


def _twin(scenario: Scenario) -> Assembly:
    return flying_twin(_vehicle(scenario), str(scenario.target), scenario.controller)


def _stand(
    first: Scenario,
    twin: Assembly | None,
    folder: Path,
    duration_s: float | None,
    step_s: float | None,
    interval_s: float | None,
    whole: bool,
    warn: Callable[[str], None],
) -> SharedSystem:
    """System of a scenario, without the start values in which its runs differ."""
    if twin is None:
        system = scenario_system(replace(first, starts={}), folder, warn=warn)
        times = _times(system, duration_s, step_s, interval_s)
        return SharedSystem(system, times, None, None)
    vehicle = _vehicle(first)
    system = fused_system(twin, vehicle.name, folder)
    record = None if whole else tuple(n for n in _named(system) if n.removeprefix(TWIN) in WATCHED)
    own = _times(system, duration_s, step_s, interval_s)
    if step_s is None and interval_s is None:
        own = replace(own, step_s=own.step_s * own.every, every=1)
    return SharedSystem(system, own, record, vehicle.arm_m)


def _named(system: System) -> list[str]:
    """Names of all outputs, "slave.output"."""
    return [
        f"{slave}.{port.name}"
        for slave, path in system.fmus.items()
        for port in read_interface(path).ports.values()
        if port.causality == "output"
    ]


def _units_of_twin(twin: Assembly) -> dict[str, str]:
    """Unit of each start value of a twin, "part.variable" -> unit."""
    return {f"{k}.{v.name}": v.unit for k, part in twin.parts.items() for v in part.variables}


def _units_of_system(first: Scenario) -> dict[str, str]:
    """Unit of each variable of an `.ssp`, "slave.variable" -> unit."""
    system = read_ssp(Path(first.target))  # keeps the unpacked FMUs
    return {
        f"{slave}.{port.name}": port.unit or ""
        for slave, path in system.fmus.items()
        for port in read_interface(path).ports.values()
    }


def _starts_of_twin(twin: Assembly) -> dict[str, float]:
    """Default start values of a twin, "part.variable" -> value."""
    return {f"{k}.{v.name}": v.start for k, part in twin.parts.items() for v in part.variables}


def _of_twin(twin: Assembly) -> Check:
    known = {f"{k}.{v.name}": (k, v) for k, part in twin.parts.items() for v in part.variables}
    plain = _starts_of_twin(twin)

    def check(scenario: Scenario) -> dict[str, float]:
        """Start values that differ from the defaults of the twin."""
        starts = shaping_starts(twin, scenario)
        for name, value in starts.items():
            if name not in known:
                twin.with_starts({name: value})  # raises the error
            part, variable = known[name]
            check_range(part, variable, value)
        return {f"{TWIN}{n}": v for n, v in starts.items() if v != plain[n]}

    return check


def _of_system(first: Scenario) -> Check:
    system = read_ssp(Path(first.target))
    interfaces = {name: read_interface(path) for name, path in system.fmus.items()}

    def check(scenario: Scenario) -> Mapping[str, float]:
        """Start values of the slaves; the FMU itself refuses invalid ones at its start."""
        check_bare(scenario)
        for name in scenario.starts:
            slave, variable = system.split(name)
            interfaces[slave].scalar(variable)
        return scenario.starts

    return check


WORDS = ("mission", "vehicle", "controller")
"""Factors with text values, which select other FMUs."""
WIND = ("wind.speed", "wind.from", "wind.north", "wind.east", "wind.down")
"""Wind speed in m/s and direction from which the wind blows, in degrees clockwise from north; or
components of the air velocity NED in m/s."""
EFFECT = "effect."
"""Prefix of effects: `effect.NAME` is true or false, `effect.NAME.NUMBER` a number and switches the
effect on."""


def scenario_of(base: Scenario, factors: Mapping[str, Value], seed: int) -> Scenario:
    """Scenario of one run; its vehicle is that of `base`, whatever the factor `vehicle` is.

    Args:
        base: Scenario that all runs share.
        factors: Value of each factor, by name.
        seed: Random seed of its noise, where no factor sets one.

    Raises:
        TwinError: A factor does not exist, or its value has the wrong type.
    """
    changes: dict[str, Any] = {} if base.is_system else {"seed": seed}
    starts, wind = dict(base.starts), {}
    effects = {name: {**numbers} for name, numbers in _effects(base).items()}
    for name, value in factors.items():
        if name in WORDS:
            if name != "vehicle":
                changes["target" if name == "mission" else name] = _word(name, value)
        elif name == "gusts":
            changes["gusts"] = _switch(name, value)
        elif name == "seed":
            changes["seed"] = _whole(name, value)
        elif name in WIND:
            wind[name] = _number(name, value)
        elif name.startswith(EFFECT):
            _add_effect(effects, name, value)
        elif "." in name:
            starts[name] = _number(name, value)
        else:
            known = (*WORDS, "gusts", "seed", *WIND)
            text = unknown_name("sweep", "factor", name, known)
            raise TwinError(f"{text} Or PART.VARIABLE, or effect.NAME.NUMBER.")
    if wind:
        changes["wind_m_s"] = _air(base, wind)
    if effects or base.effects:
        changes["effects"] = effects
    return replace(base, starts=starts, **changes)


def period_of(name: str, units: Mapping[str, str]) -> float | None:
    """Period of a factor that is an angle, 360 or 2 pi; None for other factors.

    Args:
        name: Name of the factor.
        units: Unit of each start value, "part.variable" -> unit.
    """
    if name == "wind.from":
        return 360.0
    unit = units.get(name, "")
    if name.startswith(EFFECT):
        effect, _, number = name.removeprefix(EFFECT).partition(".")
        unit = next((p.unit for p in EFFECTS[effect].parameters if p.name == number), "")
    return {"rad": 2 * math.pi, "deg": 360.0}.get(unit)


def _effects(base: Scenario) -> Mapping[str, Mapping[str, float]]:
    """Parameters of the base scenario's effects, by effect; empty where the start values apply."""
    if isinstance(base.effects, Mapping):
        return base.effects
    return {name: {} for name in base.effects}


def _add_effect(effects: dict[str, dict[str, float]], name: str, value: Value) -> None:
    """Switch an effect on or off, or set one of its parameters."""
    effect, _, number = name.removeprefix(EFFECT).partition(".")
    if effect not in EFFECTS:
        raise TwinError(unknown_name("sweep", "effect", effect, EFFECTS))
    if number:
        known = [p.name for p in EFFECTS[effect].parameters]
        if number not in known:
            raise TwinError(unknown_name(f"effect {effect}", "number", number, known))
        effects.setdefault(effect, {})[number] = _number(name, value)
    elif _switch(name, value):
        effects.setdefault(effect, {})
    else:
        effects.pop(effect, None)


def _air(base: Scenario, wind: Mapping[str, float]) -> tuple[float, float, float]:
    """Velocity of the air, NED, m/s."""
    polar, plain = {"wind.speed", "wind.from"} & wind.keys(), {"wind.north", "wind.east"}
    north, east, down = base.wind_m_s
    if polar and plain & wind.keys():
        raise TwinError(
            f"sweep: {', '.join(wind)}: give the wind by speed and from, or by north and east."
        )
    if polar:
        speed = wind.get("wind.speed", math.hypot(north, east))
        bearing = math.degrees(math.atan2(-east, -north)) if north or east else 0.0
        came = math.radians(wind.get("wind.from", bearing))
        north, east = -speed * math.cos(came), -speed * math.sin(came)
    return (
        wind.get("wind.north", north),
        wind.get("wind.east", east),
        wind.get("wind.down", down),
    )


def _word(name: str, value: Value) -> str:
    if not isinstance(value, str):
        raise TwinError(f"{name} = {value!r}: needs names.")
    return value


def _switch(name: str, value: Value) -> bool:
    if not isinstance(value, bool):
        raise TwinError(f"{name} = {value!r}: needs true or false.")
    return value


def _number(name: str, value: Value) -> float:
    if isinstance(value, bool | str):
        raise TwinError(f"{name} = {value!r}: needs a number.")
    return value


def _whole(name: str, value: Value) -> int:
    number = _number(name, value)
    if number != int(number) or number < 0:
        raise TwinError(f"{name} = {number:g}: needs a whole number from 0 on.")
    return int(number)
