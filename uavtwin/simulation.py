"""Simulation of a scenario or an `.ssp` with the co-simulation master."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.limits import Limits
from cosim.master import Algorithm, Master, Recording
from cosim.ssp import read_ssp
from cosim.system import System
from cosim.whole_twin import STEP_S, fused_model, system_of
from cosim.worker import WorkerMaster
from fmus import FmuModel, build
from fmus.archive import archive_members, repeated_entries
from twin.component import unknown_name
from twin.effects import EFFECTS
from twin.errors import TwinError
from twin.flight.assembly import Assembly, flying_twin, responds_to_wind, wind_starts
from twin.flight.mission import mission_names
from twin.frames import AXES
from twin.physics.residual_force import ForceLaw
from twin.representation import ShortRepr
from twin.vehicle import Vehicle

from .vehicles import checked_vehicle, load_vehicle

Array = NDArray[np.float64]
_INTERVAL_S = 0.01
"""Time between two rows of a recording, s."""
MAX_STEPS = 10**8
"""Largest number of steps of one run: 28 hours in steps of 1 ms."""
MAX_VALUES = 2**28
"""Largest number of values recorded in one run: 2 GiB."""
DEFAULT_VEHICLE = "copter_default"
"""Default vehicle."""


@dataclass(frozen=True, slots=True)
class Scenario(ShortRepr):
    """Settings of a simulation.

    Attributes:
        target: Name of a mission, or an `.ssp` file.
        vehicle: Vehicle to fly; None: `DEFAULT_VEHICLE`, or the `.ssp`'s own.
        controller: Name of the flight controller.
        wind_m_s: Velocity of the air, NED.
        gusts: Whether the wind gusts.
        seed: Seed of every noise.
        effects: Effects to switch on: names, at their start values unless `starts` overrides them;
            or numbers by effect.
        starts: Start values, "part.variable" -> value.
        fused: Whether the whole twin runs as one FMU.
        law: Learned law of force and moment; None: none.
        compensator: Compensator of the sensors; None: none.
    """

    target: str | Path
    vehicle: Vehicle | None = None
    controller: str = "lqr"
    wind_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gusts: bool = False
    seed: int = 0
    effects: Iterable[str] | Mapping[str, Mapping[str, float]] = ()
    starts: Mapping[str, float] = field(default_factory=dict)
    fused: bool = False
    law: ForceLaw | None = None
    compensator: FmuModel | None = None

    @property
    def is_system(self) -> bool:
        """Whether the target is an `.ssp`, which has its own parts."""
        return Path(self.target).suffix == ".ssp"

    @property
    def name(self) -> str:
        """Name of the mission, or of the file."""
        return Path(self.target).name


def asked_scenario(
    verb: str,
    scenario: str | Path,
    vehicle: Vehicle | None = None,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gusts: bool = False,
    seed: int = 0,
    controller: str = "lqr",
    effects: Iterable[str] | Mapping[str, Mapping[str, float]] = (),
    starts: Mapping[str, float] | None = None,
    fused: bool = False,
) -> Scenario:
    """A scenario as a person asks for it in Python.

    Args:
        verb: Function that was asked, for messages.
        scenario: And all others: as of `uavtwin.run.simulate`.

    Raises:
        TwinError: An argument is of another type than `uavtwin.run.simulate` takes.
    """
    if vehicle is not None:
        vehicle = checked_vehicle(vehicle, verb)
    if isinstance(effects, str):
        effects = (effects,)
    for name, value, kind, needs in (
        ("scenario", scenario, str | Path, "the name of a mission, or an .ssp file"),
        ("gusts", gusts, bool | np.bool_, "true or false"),
        ("seed", seed, int | np.integer, "a whole number from 0 on"),
        ("controller", controller, str, "a name"),
        ("effects", effects, Iterable, "names, or numbers by effect"),
    ):
        if not isinstance(value, kind):
            raise TwinError(f"{name} = {value!r}: needs {needs}.")
    try:
        north, east, down = map(float, wind)
    except (TypeError, ValueError) as error:
        text = f"wind = {wind!r}: give three numbers, north, east, down, in m/s."
        raise TwinError(text) from error
    return Scenario(
        scenario,
        vehicle,
        controller,
        (north, east, down),
        bool(gusts),
        int(seed),
        {str(name): _numbers(f"effects: {name}", own) for name, own in effects.items()}
        if isinstance(effects, Mapping)
        else tuple(map(str, effects)),
        _numbers("starts", starts or {}),
        fused,
    )


def _numbers(what: str, given: Any) -> dict[str, float]:
    """Numbers by name, as a person gives them."""
    try:
        return {str(name): float(value) for name, value in given.items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise TwinError(f"{what} = {given!r}: needs numbers by name.") from error


def scenario_system(
    scenario: Scenario,
    folder: Path,
    progress: Callable[[float], None] = lambda _: None,
    warn: Callable[[str], None] = lambda _: None,
) -> System:
    """FMUs and connections of a scenario, built into a folder where it is not an `.ssp`.

    Wind, gusts, seed and effects are start values of the system, so one mission of one vehicle is
    compiled once.

    Args:
        scenario: The scenario.
        folder: For the FMUs.
        progress: Called with the completed share of building.
        warn: Called with each sentence from `ineffective`, and on equal entries of an archive.

    Raises:
        TwinError: An unknown mission, effect or start value; a broken `.ssp`.
    """
    if scenario.is_system:
        given = read_ssp(Path(scenario.target))
        check_bare(scenario)
        for file in dict.fromkeys((Path(scenario.target), *given.fmus.values())):
            for text in repeated_entries(archive_members(file)):
                warn(f"{file.name}: {text}.")
        return replace(given, starts={**given.starts, **scenario.starts})
    if scenario.target not in mission_names():
        known = ", ".join(mission_names())
        raise TwinError(f"{scenario.target}: neither an .ssp file nor a scenario: {known}.")
    vehicle = scenario.vehicle or load_vehicle(DEFAULT_VEHICLE)
    network = scenario.compensator
    twin = flying_twin(vehicle, str(scenario.target), scenario.controller, law=scenario.law)
    shaped = twin.with_starts(shaping_starts(twin, scenario))
    for text in ineffective(shaped, scenario):
        warn(text)
    starts = _changes(twin, shaped)
    if not scenario.fused:
        parts = system_of(twin, folder, progress=progress, compensator=network)
        return replace(parts, starts=starts)
    whole = fused_system(twin, vehicle.name, folder, network)
    return replace(whole, starts={f"twin.{name}": value for name, value in starts.items()})


def fused_system(
    twin: Assembly, vehicle: str, folder: Path, compensator: FmuModel | None = None
) -> System:
    """The whole twin as one FMU, which is built into a folder.

    Args:
        twin: Components of the twin.
        vehicle: Name of the vehicle, after which the FMU is named.
        folder: For the FMU.
        compensator: Compensator of the sensors; None: without.
    """
    model = fused_model(twin, vehicle, compensator)
    fmu = build(model, folder / f"{model.name}.fmu")
    return System({"twin": fmu}, stop_time_s=twin.duration_s, step_s=STEP_S)


def check_bare(scenario: Scenario) -> None:
    """Refuse settings that do not apply to an `.ssp`.

    Raises:
        TwinError: There is one.
    """
    bare = Scenario(scenario.target)
    shaping = ("vehicle", "controller", "wind_m_s", "gusts", "seed", "effects", "fused", "law")
    given = [n for n in shaping if getattr(scenario, n) != getattr(bare, n)]
    if given:
        raise TwinError(
            f"{scenario.target}: an .ssp brings its own parts; of what shapes a scenario only "
            f"start values go with it, not {', '.join(given)}."
        )


def shaping_starts(twin: Assembly, scenario: Scenario) -> dict[str, float]:
    """Start values of a scenario, "part.variable" -> value, for wind, gusts, seed and effects.

    Raises:
        TwinError: An unknown effect, or one that no aircraft has.
    """
    switches = {}
    for name in scenario.effects:
        if name not in EFFECTS:
            raise TwinError(unknown_name("effects", "effect", name, EFFECTS))
        if not EFFECTS[name].of_vehicle:
            raise TwinError(f"effect {name} is one of a record; an aircraft that flies has none.")
        block = f"{EFFECTS[name].component}.{name}"
        part = twin.parts.get(EFFECTS[name].component)
        if part is not None and f"{name}.enabled" not in {v.name for v in part.parameters}:
            raise TwinError(
                f"effect {name} depends on the battery, of which the vehicle file says nothing: "
                f"add [battery], see docs/guide/vehicle.md."
            )
        switches[f"{block}.enabled"] = 1.0
        if isinstance(scenario.effects, Mapping):
            switches |= {f"{block}.{k}": x for k, x in scenario.effects[name].items()}
    return {
        **wind_starts(scenario.wind_m_s, scenario.gusts),
        **twin.seed_starts(scenario.seed),
        **switches,
        **scenario.starts,
    }


def ineffective(twin: Assembly, scenario: Scenario) -> list[str]:
    """Requested settings without effect on this twin, with the remedy.

    Args:
        twin: The twin, with the start values of the scenario.
        scenario: Scenario of the flight.
    """
    starts = {f"{k}.{v.name}": v.start for k, part in twin.parts.items() for v in part.variables}
    off = [
        f"{name}: changes nothing, {effect} is switched off. Add --effect {effect}, or --start "
        f"{part}.{effect}.enabled=1."
        for name in scenario.starts
        for part, _, rest in [name.partition(".")]
        for effect, _, number in [rest.partition(".")]
        if number != "enabled" and starts.get(f"{part}.{effect}.enabled", 1.0) == 0.0
    ]
    blown = [
        e.name.replace("_", " ")
        for e in EFFECTS.values()
        if e.of_weather and starts.get(f"{e.component}.{e.name}.enabled")
    ]
    if any(starts.get(f"environment.wind.{a}") for a in AXES):
        blown.insert(0, "wind")
    if blown and not responds_to_wind(twin):
        off.append(
            f"{' and '.join(blown)}: changes nothing, no part of this aircraft responds to the "
            f"air: its file has no drag. Switch one on (docs/reference/effects.md), or find it "
            f"with `uavtwin explain`."
        )
    return off


def _changes(before: Assembly, after: Assembly) -> dict[str, float]:
    """Start values in which two assemblies of the same parts differ, "part.variable" -> value."""
    return {
        f"{name}.{new.name}": new.start
        for name, part in before.parts.items()
        for old, new in zip(part.variables, after.parts[name].variables, strict=True)
        if new.start != old.start
    }


@dataclass(frozen=True, slots=True)
class Times:
    """Start, end and steps of a run.

    Attributes:
        begin_s: Time of the first communication point.
        end_s: Time of the last communication point.
        step_s: Communication step.
        every: Steps between two rows of the recording.
    """

    begin_s: float
    end_s: float
    step_s: float
    every: int

    @property
    def rows(self) -> float:
        """Rows of the recording after the first one."""
        return (self.end_s - self.begin_s) / (self.step_s * self.every)


def times_of(
    system: System,
    stop_s: float | None = None,
    step_s: float | None = None,
    interval_s: float | None = None,
) -> Times:
    """Times of a run, as in `run_scenario`.

    Raises:
        TwinError: No stop time is known, a time is not positive, the interval is not an integer
            number of steps, or there would be too many steps.
    """
    step = step_s if step_s is not None else system.step_s or STEP_S
    stop = system.stop_time_s if stop_s is None else stop_s
    begin = system.start_time_s
    if stop is None:
        raise TwinError("no stop time: the system names none, give one in seconds.")
    for what, value in (("step", step), ("interval", interval_s or step)):
        if not (np.isfinite(value) and value > 0):
            raise TwinError(f"{what} {value:g}: needs a positive number of seconds, e.g. 0.01.")
    every = max(1, round((_INTERVAL_S if interval_s is None else interval_s) / step))
    if interval_s is not None and abs(every * step - interval_s) > 1e-9:
        raise TwinError(f"interval {interval_s:g}: not a whole number of steps of {step:g} s.")
    last = begin + every * step * np.floor((stop - begin) / (every * step) + 1e-9)
    if not last > begin:
        raise TwinError(
            f"stop {stop:g}: not even one interval of {every * step:g} s after the start at "
            f"{begin:g} s."
        )
    steps = (last - begin) / step
    if steps > MAX_STEPS:
        raise TwinError(
            f"stop {stop:g} s in steps of {step:g} s: {steps:.3g} steps, at most {MAX_STEPS:g} are "
            f"taken. Give an earlier stop or a longer step."
        )
    return Times(begin, float(last), step, every)


def run_scenario(
    system: System,
    stop_s: float | None = None,
    step_s: float | None = None,
    interval_s: float | None = None,
    algorithm: Algorithm = "jacobi",
    realtime: float | None = None,
    progress: Callable[[float], None] = lambda _: None,
    limits: Limits | None = None,
) -> Recording:
    """Step a system from its start time on.

    Args:
        system: FMUs and connections.
        stop_s: Stop time; default: the system's own.
        step_s: Communication step; default: the system's own, else 1 ms.
        interval_s: Time between two rows of the recording; default: an integer number of steps,
            about 10 ms.
        algorithm: Co-simulation algorithm, see `cosim.stepping`.
        realtime: Simulated seconds per second of the clock; None: as fast as possible.
        progress: Called with the completed share.
        limits: Limits of the separate process for foreign FMUs; None: the defaults.

    Raises:
        TwinError: No stop time is known, a time is not positive, the interval is not an integer
            number of steps, or there would be too many steps or rows.
        RunError: An FMU failed during the run; has the recording.
        Interrupted: Ctrl-C during the run; has the recording.
    """
    times = times_of(system, stop_s, step_s, interval_s)
    begin, last, step, every = times.begin_s, times.end_s, times.step_s, times.every
    with WorkerMaster(system, limits=limits) if system.foreign else Master(system) as master:
        if times.rows * len(master.record_names) > MAX_VALUES:
            raise TwinError(
                f"stop {last:g} s with a row every {every * step:g} s: {times.rows:.3g} rows of "
                f"{len(master.record_names)} outputs, at most {MAX_VALUES} values are held. Give "
                f"an earlier stop or a longer interval."
            )
        master.initialize(begin)
        return master.run(
            last,
            step,
            algorithm,
            every,
            lambda t: progress((t - begin) / (last - begin)),
            realtime,
        )


def summary(recording: Recording) -> dict[str, Any]:
    """Figures of a flight: distance from the setpoint, tilt; empty without an aircraft."""
    columns = {name.removeprefix("twin."): i for i, name in enumerate(recording.names)}

    def vector(stem: str, letters: str = "xyz") -> Array | None:
        """Columns of a vector, None where the system has none."""
        names = [f"{stem}_{a}" for a in letters]
        if not set(names) <= columns.keys():
            return None
        return recording.values[:, [columns[n] for n in names]]

    pos, wanted, q = (
        vector("airframe.pos"),
        vector("mission.setpoint_pos"),
        vector("airframe.q", "wxyz"),
    )
    if pos is None or wanted is None or q is None:
        return {}
    flying = recording.values[:, columns["mission.phase"]] > 0
    if not flying.any():
        return {}
    miss = np.linalg.norm(pos - wanted, axis=1)[flying]
    tilt = np.arccos(np.clip(1 - 2 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1, 1))
    return {
        "tracking_rms_m": float(np.sqrt(np.mean(miss**2))),
        "tracking_worst_m": float(miss.max()),
        "tilt_worst_rad": float(tilt.max()),
        "end_pos_m": pos[-1].tolist(),
    }
