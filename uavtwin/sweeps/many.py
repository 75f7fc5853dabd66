"""Many simulations in one call, flown by the engine of the sweep."""

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, TypedDict, Unpack, overload

import pandas as pd

from cosim.limits import Limits
from cosim.recording import RunError
from twin.component import unknown_name
from twin.effects import EFFECTS
from twin.errors import TwinError

from ..jobs.engine import Workers
from ..output import results_folder
from ..run import Run, described, facts_of
from ..simulation import MAX_VALUES, Scenario, asked_scenario
from ..vehicles import Vehicle
from .design import Choice, Design, Value
from .plan import EFFECT, TWIN, WIND, Job, Plan, SharedSystem, of_run, plan_of
from .result import SweepResult, table_of
from .sweep import BUILDING, SWITCH, Progress, RunResult, SweepTask, blocks, recording_file

VERB = "simulate_many"
_FORM = "give the arguments of each run, e.g. [{'seed': k} for k in range(100)]"


class Arguments(TypedDict, total=False):
    """Arguments of one run; `uavtwin.simulate` describes them."""

    scenario: str | Path
    vehicle: Vehicle
    wind: tuple[float, float, float]
    gusts: bool
    seed: int
    controller: str
    effects: Iterable[str] | Mapping[str, Mapping[str, float]]
    starts: Mapping[str, float]


class Listed(Design):
    """Design with an explicit list of points."""

    def __post_init__(self) -> None:
        """Skip the checks of a sampled design."""


@dataclass(frozen=True, repr=False, eq=False)
class Runs(SweepResult, Sequence[Run]):
    """Simulations in the order of the request: a sequence of `Run`.

    Its table and page are those of a sweep whose factors are the arguments of the runs.

    Attributes:
        runs: The single runs, in order.
    """

    runs: tuple[Run, ...] = ()

    @overload
    def __getitem__(self, which: int) -> Run: ...

    @overload
    def __getitem__(self, which: slice) -> tuple[Run, ...]: ...

    def __getitem__(self, which: int | slice) -> Run | tuple[Run, ...]:
        """One run, or a tuple of runs."""
        return self.runs[which]

    def __len__(self) -> int:
        """Number of runs."""
        return len(self.runs)

    def frame(self) -> pd.DataFrame:
        """All outputs of all runs, one column each, indexed by number of the run and time, s."""
        return pd.concat([run.frame() for run in self.runs], keys=range(len(self)), names=["run"])

    def save(self, path: str | Path) -> Path:
        """Write a folder with the table, `runs.parquet`, and in `recordings` each run that has a
        row, as `Run.save` does; returns its path.

        Raises:
            TwinError: The folder exists and is not empty.
        """
        with results_folder(Path(path), force=False) as folder:
            super().save(folder / "runs.parquet")
            for number, run in enumerate(self.runs):
                if len(run.recording.time_s):
                    file = recording_file(folder, number)
                    file.parent.mkdir(exist_ok=True)
                    run.save(file)
        return Path(path)


def simulate_many(
    runs: Iterable[Mapping[str, Any]],
    *,
    duration: float | None = None,
    interval: float | None = None,
    workers: int | None = None,
    limits: Limits | None = None,
    progress: Progress = lambda _: None,
    **shared: Unpack[Arguments],
) -> Runs:
    """Fly many scenarios, eight at a time; each is equal to the last bit to `simulate` of it alone.

        winds = [{"wind": (w, 0.0, 0.0), "seed": k} for w in (0.0, 4.0, 8.0) for k in range(100)]
        flown = ut.simulate_many(winds, scenario="tour", vehicle=mine, gusts=True)

    From 64 runs of one mission, vehicle and controller on, their FMU is compiled to fly eight of
    them at once; one twin is built for each mission, vehicle and controller. All recordings are
    held in memory. A run that an FMU ends is recorded up to there, and `Run.ended` gives the
    reason.

    Args:
        runs: Arguments of `simulate` for each run: `scenario`, `vehicle`, `wind`, `gusts`, `seed`,
            `controller`, `effects`, `starts`.
        duration: Simulated time of each run, s; default: that of the mission or of the `.ssp`.
        interval: Time between recorded rows, s; default: about 10 ms.
        workers: Number of processes; default: one per core.
        limits: Limits of the processes of FMUs that do not fly in lanes.
        progress: Called with the share done, 0..1.
        shared: Arguments of all runs that do not set their own.

    Raises:
        TwinError: An unknown name, a value outside its range, or too many rows for the memory.
    """
    if not isinstance(runs, Iterable):
        raise TwinError(f"{VERB}: runs = {runs!r}: {_FORM}.")
    if isinstance(shared.get("effects"), Iterator):
        shared["effects"] = tuple(shared["effects"])
    asked: dict[str, None] = {}
    scenarios = []
    for number, own in enumerate(runs):
        with of_run(number):
            if not isinstance(own, Mapping):
                raise TwinError(f"{own!r}: {_FORM}.")
            given = {**shared, **own}
            scenarios.append(_scenario(given))
            asked |= dict.fromkeys(given)
    if not scenarios:
        raise TwinError(f"{VERB}: no runs are given; {_FORM}.")
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as scratch:
        plan = plan_of(
            scenarios,
            Path(scratch),
            duration,
            interval_s=interval,
            whole=True,
            progress=lambda done: progress(BUILDING * done),
            check_size=_check_memory,
        )
        points = _points(asked, plan)
        flown = _flown(plan, workers, limits or Limits(), progress)
        about = [_described(stand) for stand in plan.stands]
    factors = [n for n in points[0] if all(p[n] == p[n] for p in points)]
    levels = {n: Choice(tuple(dict.fromkeys(p[n] for p in points))) for n in factors}
    return Runs(
        ", ".join(dict.fromkeys(s.name for s in scenarios)),
        table_of(points, (f.outcome for f in flown)),
        Listed(levels, "listed"),
        scenarios,
        periods=plan.periods(factors),
        warnings=plan.warnings,
        runs=tuple(
            _run(scenarios[job.run], flown[job.run], *about[job.stand], plan.idle[job.run])
            for job in plan.jobs
        ),
    )


def _scenario(given: Mapping[str, Any]) -> Scenario:
    """Scenario of one run.

    Raises:
        TwinError: An argument is unknown or wrong, or no scenario is named.
    """
    for name in given:
        if name not in Arguments.__annotations__:
            raise TwinError(unknown_name(VERB, "argument", name, Arguments.__annotations__))
    if "scenario" not in given:
        raise TwinError("of what? Give scenario='tour', of each run or of all.")
    asked = asked_scenario(VERB, **given)
    return replace(asked, fused=not asked.is_system)


def _check_memory(values: float) -> None:
    """Refuse more values than fit in memory.

    Raises:
        TwinError: There are more than `MAX_VALUES` values.
    """
    if values > MAX_VALUES:
        raise TwinError(
            f"{VERB}: {values:.3g} values, at most {MAX_VALUES} are held in memory. Give a longer "
            f"interval or a shorter duration, fly fewer at a time, or let sweep(..., "
            f"recordings=True) write them into files."
        )


def _flown(plan: Plan, workers: int | None, limits: Limits, progress: Progress) -> list[RunResult]:
    """Fly every run; results in order of the runs."""
    task, found = SweepTask("", plan.stands, limits, keep=True), dict[int, RunResult]()
    with Workers(workers=workers).opened() as engine:
        for one in chain.from_iterable(engine.run(task, blocks(plan.jobs))):
            found[one.outcome.run] = one
            progress(BUILDING + (1 - BUILDING) * len(found) / len(plan.jobs))
    return [found[job.run] for job in plan.jobs]


def _described(stand: SharedSystem) -> tuple[dict[str, str], dict[str, str]]:
    """Units of the outputs, and how each FMU is run; without the prefix of the fused twin."""
    units, ways = described(stand.system)
    return {name.removeprefix(TWIN): unit for name, unit in units.items()}, ways


def _run(
    scenario: Scenario,
    flown: RunResult,
    units: Mapping[str, str],
    ways: Mapping[str, str],
    idle: tuple[str, ...],
) -> Run:
    """A run with the names of `simulate`: outputs named "part.output", without the prefix of the
    twin."""
    recording, outcome = flown.recording, flown.outcome
    assert recording is not None
    recording = replace(recording, names=tuple(n.removeprefix(TWIN) for n in recording.names))
    failed = RunError(outcome.why, recording) if outcome.outcome == "failed" else None
    return Run(scenario.name, recording, units, facts_of(scenario), failed, ways, idle)


def _points(asked: Iterable[str], plan: Plan) -> list[dict[str, Value]]:
    """Arguments as factors of a sweep, equal names for each run, with the values that fly.

    Args:
        asked: Arguments that are given to any run.
        plan: Systems and runs.
    """
    switches, starts = dict[str, str](), dict[str, str]()
    for scenario in plan.scenarios:
        starts |= {name: name for name in scenario.starts}
        for name in scenario.effects:
            block = f"{EFFECTS[name].component}.{name}"
            switches[f"{EFFECT}{name}"] = f"{block}{SWITCH}"
            if isinstance(scenario.effects, Mapping):
                starts |= {f"{EFFECT}{name}.{k}": f"{block}.{k}" for k in scenario.effects[name]}

    def point(job: Job) -> dict[str, Value]:
        """Factors of one run."""
        flown = plan.scenarios[job.run]
        known: dict[str, dict[str, Value]] = {
            "scenario": {"mission": str(flown.target)},
            "vehicle": {"vehicle": plan.vehicles[job.stand]},
            "wind": dict(zip(WIND[2:], flown.wind_m_s, strict=True)),
            "seed": {"seed": float(flown.seed)},
            "gusts": {"gusts": flown.gusts},
            "controller": {"controller": flown.controller},
            "effects": {k: plan.start(job, name) == 1.0 for k, name in switches.items()},
            "starts": {k: plan.start(job, name) for k, name in starts.items()},
        }
        shown = dict.fromkeys((*asked, "starts"))  # numbers of effects are start values
        return {k: v for name in shown for k, v in known[name].items()}

    return [point(job) for job in plan.jobs]
