"""A sweep from start to end: planned, flown on an engine, resumed where one was killed."""

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from cosim.limits import Limits
from twin.errors import TwinError
from twin.vehicle import Vehicle

from ..output import check_folder, sha256, write_json
from ..simulation import Scenario
from ..vehicles import checked_vehicle, load_vehicle
from .design import Design, read_design
from .distributions import distribution_of
from .engine import Engine
from .engine.local import LocalEngine
from .flying import Flown
from .journal import JOURNAL, Journal
from .plan import Plan, plan_of
from .result import SweepResult, table_of

Progress = Callable[[float], None]
EngineName = Literal["local", "dask"]
RECORDINGS = "recordings"
_BUILDING = 0.05
"""Share of the work that building takes, about."""


def sweep(
    scenario: str | Path,
    vehicle: Vehicle | str | None = None,
    *,
    out: str | Path,
    vary: Mapping[str, Any] | None = None,
    design: Design | str | Path | None = None,
    runs: int | None = None,
    method: str | None = None,
    seed: int | None = None,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gusts: bool = False,
    controller: str = "lqr",
    effects: Iterable[str] | Mapping[str, Mapping[str, float]] = (),
    starts: Mapping[str, float] | None = None,
    duration: float | None = None,
    step: float | None = None,
    engine: EngineName = "local",
    workers: int | None = None,
    scheduler: str | None = None,
    recordings: bool = False,
    limits: Limits | None = None,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> SweepResult:
    """Fly a scenario many times, each time with other numbers.

    A sweep that was interrupted or killed goes on where it was when the same call is made again.
    The results are the same to the last bit with any engine and any number of workers.

    Args:
        scenario: Name of a mission, or an `.ssp` file.
        vehicle: That flies, or its file or built-in name, which the page's commands then name;
            default: `copter_default`.
        out: Folder for `runs.parquet` and what else comes of it.
        vary: Factors: `{"airframe.mass": {"low": 1.2, "high": 1.6}, "controller": ["lqr", "px4"]}`;
            on top of those of the design.
        design: Or a file that describes one, see `uavtwin.sweeps.design`.
        runs: How many; default: as the design says, else 100.
        method: `latin_hypercube`, `sobol`, `random`, `grid` or `saltelli`.
        seed: Of the points; run k has noise of the seed after k more.
        wind: Of all runs, as for `simulate`.
        gusts: As for `simulate`.
        controller: As for `simulate`.
        effects: As for `simulate`.
        starts: As for `simulate`.
        duration: Of each run, s.
        step: Communication step, s.
        engine: `local`, or `dask` with a scheduler.
        workers: Processes of the local engine; default: one per core.
        scheduler: Address of a Dask scheduler.
        recordings: Whether every output of every run is kept.
        limits: Of the processes that FMUs run in; the time as a whole is that of one run.
        force: Whether files in the folder may be replaced.
        progress: Called with the share done, 0..1.

    Raises:
        TwinError: An unknown name, a value outside its range, or a folder that is not free.
    """
    named = vehicle if isinstance(vehicle, str) else ""
    if isinstance(vehicle, str):
        vehicle = load_vehicle(vehicle)
    elif vehicle is not None:
        vehicle = checked_vehicle(vehicle, "sweep")
    base = Scenario(
        scenario,
        vehicle,
        controller,
        wind,
        gusts,
        0,
        effects if isinstance(effects, Mapping) else tuple(effects),
        dict(starts or {}),
    )
    chosen = chosen_design(design, vary, runs, method, seed)
    folder, used = Path(out), limits or Limits()
    if not (folder / JOURNAL).exists():
        check_folder(folder, force)
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as scratch:
        plan = plan_of(
            base,
            chosen,
            Path(scratch),
            duration,
            step,
            recordings,
            lambda done: progress(_BUILDING * done),
        )
        key = sweep_key(plan, recordings)
        with Journal(folder / JOURNAL, key) as journal:
            with _engine(engine, key, used, workers, scheduler, recordings) as flying:
                _fly(plan, flying, journal, folder, progress)
            table = table_of(plan.points, journal.outcomes())
            result = SweepResult(base.name, table, chosen, plan.scenarios, named)
            result.save(folder / "runs.parquet")
            result.report(folder / "report.html")
            write_json(folder / "sweep.json", result.json())
            journal.remove()
    return result


def chosen_design(
    design: Design | str | Path | None,
    vary: Mapping[str, Any] | None = None,
    runs: int | None = None,
    method: str | None = None,
    seed: int | None = None,
) -> Design:
    """A design, with what is given besides on top.

    Raises:
        TwinError: It is wrong.
    """
    if design is None:
        given = Design()
    else:
        given = design if isinstance(design, Design) else read_design(Path(design))
    more = {
        name: found if hasattr(found, "at") else distribution_of(name, found, "vary")
        for name, found in (vary or {}).items()
    }
    return Design(
        {**given.vary, **more},
        given.method if method is None else method,
        given.runs if runs is None else runs,
        given.seed if seed is None else seed,
    )


def sweep_key(plan: Plan, recordings: bool) -> str:
    """Hash of all that decides the outcomes."""
    import uavtwin

    stands = [
        {
            "fmus": {name: sha256(path) for name, path in s.system.fmus.items()},
            "connections": [[c.source, c.target] for c in s.system.connections],
            "starts": dict(s.system.starts),
            "periods": dict(s.system.periods),
            "times": asdict(s.times),
            "arm_m": s.arm_m,
        }
        for s in plan.stands
    ]
    jobs = [[j.run, j.stand, dict(j.starts)] for j in plan.jobs]
    content = [uavtwin.__version__, stands, jobs, [dict(p) for p in plan.points], recordings]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@contextmanager
def _engine(
    name: str,
    key: str,
    limits: Limits,
    workers: int | None,
    scheduler: str | None,
    keep: bool,
) -> Iterator[Engine]:
    """The engine of that name."""
    if name == "dask":
        from .engine.dask import DaskEngine

        if scheduler is None:
            raise TwinError("--engine dask: give --scheduler tcp://HOST:8786.")
        remote = DaskEngine(scheduler, key, limits, keep)
        try:
            yield remote
        finally:
            remote.close()
        return
    if scheduler is not None:
        raise TwinError("--scheduler: goes with --engine dask.")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    count = (cores or 1) if workers is None else workers
    if not 1 <= count <= 1024:
        raise TwinError(f"workers = {count}: needs 1 to 1024.")
    yield LocalEngine(count, limits, keep)


def _fly(plan: Plan, engine: Engine, journal: Journal, folder: Path, progress: Progress) -> None:
    """Fly what is not done, those of one system after those of another."""
    left = [j for j in plan.jobs if j.run not in journal.done]
    left.sort(key=lambda j: (j.stand, j.run))
    done = len(plan.jobs) - len(left)
    for flown in engine.fly(left, plan.stands):
        _keep(flown, folder)
        journal.add(flown.outcome)
        done += 1
        progress(_BUILDING + (1 - _BUILDING) * done / len(plan.jobs))


def _keep(flown: Flown, folder: Path) -> None:
    """Write a recording, before its run counts as done."""
    if flown.recording is not None and len(flown.recording.time_s):
        path = folder / RECORDINGS / f"run_{flown.outcome.run:06d}.parquet"
        path.parent.mkdir(exist_ok=True)
        part = path.with_suffix(".part.parquet")
        flown.recording.write(part)
        os.replace(part, path)
