"""Many simulations in one call, flown by the engine of the sweep."""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, TypedDict, Unpack, overload

import numpy as np
import pandas as pd

from cosim.limits import Limits
from cosim.recording import RunError
from twin.component import unknown_name
from twin.errors import TwinError

from ..jobs.engine import Workers
from ..output import results_folder
from ..run import Run, described, facts_of
from ..simulation import MAX_VALUES, Scenario, asked_scenario
from ..vehicles import Vehicle
from .design import Choice, Design, Value
from .plan import TWIN, WIND, Plan, SharedSystem, plan_of
from .result import SweepResult, table_of
from .sweep import BUILDING, Progress, RunResult, SweepTask, blocks, recording_file

VERB = "simulate_many"


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


@dataclass(frozen=True, repr=False)
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
        """Write a folder as `sweep --recordings` does: the table, and each recording; returns its
        path.

        Raises:
            TwinError: The folder exists and is not empty.
        """
        with results_folder(Path(path), force=False) as folder:
            super().save(folder / "runs.parquet")
            for number, run in enumerate(self.runs):
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
    given = [{**shared, **own} for own in runs]
    scenarios = [_scenario(number, own) for number, own in enumerate(given)]
    if not scenarios:
        raise TwinError(f"{VERB}: no runs are given, e.g. [{{'seed': k}} for k in range(100)].")
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as scratch:
        plan = plan_of(
            scenarios,
            Path(scratch),
            duration,
            interval_s=interval,
            whole=True,
            progress=lambda done: progress(BUILDING * done),
        )
        _check_memory(plan)
        flown = _flown(plan, workers, limits or Limits(), progress)
        about = [_described(stand) for stand in plan.stands]
    points = _points(given)
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
            _run(scenarios[job.run], flown[job.run], *about[job.stand]) for job in plan.jobs
        ),
    )


def _scenario(number: int, given: Mapping[str, Any]) -> Scenario:
    """Scenario of one run.

    Raises:
        TwinError: An argument is unknown or wrong, or no scenario is named.
    """
    for name in given:
        if name not in Arguments.__annotations__:
            raise TwinError(unknown_name(VERB, "argument", name, Arguments.__annotations__))
    if "scenario" not in given:
        raise TwinError(f"run {number}: of what? Give scenario='tour', of each run or of all.")
    fused = Path(given["scenario"]).suffix != ".ssp"
    try:
        return asked_scenario(VERB, fused=fused, **given)
    except TwinError as error:
        raise TwinError(f"run {number}: {error}") from error


def _check_memory(plan: Plan) -> None:
    """Refuse more values than fit in memory.

    Raises:
        TwinError: There are more than `MAX_VALUES` values.
    """
    columns = [len(described(stand.system)[0]) for stand in plan.stands]
    values = sum(plan.stands[job.stand].times.rows * columns[job.stand] for job in plan.jobs)
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
    scenario: Scenario, flown: RunResult, units: Mapping[str, str], ways: Mapping[str, str]
) -> Run:
    """A run with the names of `simulate`: outputs named "part.output", without the prefix of the
    twin."""
    recording, outcome = flown.recording, flown.outcome
    assert recording is not None
    recording = replace(recording, names=tuple(n.removeprefix(TWIN) for n in recording.names))
    failed = RunError(outcome.why, recording) if outcome.outcome == "failed" else None
    return Run(scenario.name, recording, units, facts_of(scenario), failed, ways)


def _points(given: Sequence[Mapping[str, Any]]) -> list[dict[str, Value]]:
    """Arguments as factors of a sweep, equal names for each run; NaN, "" or false where a run lacks
    one."""
    each = [dict(_factors(own)) for own in given]
    names = dict.fromkeys(name for own in each for name in own)
    kinds = {name: next(type(own[name]) for own in each if name in own) for name in names}
    missing = {n: False if k is bool else "" if k is str else np.nan for n, k in kinds.items()}
    return [{name: own.get(name, missing[name]) for name in names} for own in each]


def _factors(own: Mapping[str, Any]) -> Iterable[tuple[str, Value]]:
    """Arguments of one run as factors of a sweep."""
    for name, value in own.items():
        if name == "scenario":
            yield "mission", str(value)
        elif name == "vehicle":
            yield name, value.name
        elif name == "wind":
            yield from zip(WIND[2:], map(float, value), strict=True)
        elif name == "starts":
            yield from ((n, float(v)) for n, v in value.items())
        elif name == "effects":
            yield from (
                (f"effect.{n}", True) for n in ([value] if isinstance(value, str) else value)
            )
            if isinstance(value, Mapping):
                yield from (
                    (f"effect.{n}.{k}", float(v)) for n, x in value.items() for k, v in x.items()
                )
        else:
            yield name, float(value) if name == "seed" else value
