"""`uavtwin sweep`: many runs of a scenario."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from .options import (
    CallLimit,
    Controller,
    Effects,
    Engine,
    Exit,
    Force,
    Gusts,
    Json,
    MemoryLimit,
    Out,
    Prints,
    Scheduler,
    Starts,
    Wind,
    Workers,
    seconds,
    start_values,
)
from .printing import STDOUT, print_json, print_written, progress, warn
from .simulate import Aircraft, ScenarioName, aircraft_of, three_numbers

if TYPE_CHECKING:
    from ..sweeps.result import SweepResult

Method = Literal["latin_hypercube", "sobol", "random", "grid", "saltelli"]


def sweep(
    scenario: ScenarioName,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="A factor: NAME=LOW:HIGH, NAME=LOW:HIGH:STEPS or NAME=A,B,C. NAME is "
            "PART.VARIABLE, wind.speed, wind.from, effect.NAME.NUMBER, gusts, seed, mission, "
            "vehicle or controller. May be repeated."
        ),
    ] = None,
    design: Annotated[Path | None, typer.Option(help="Factors in a TOML file.")] = None,
    runs: Annotated[int | None, typer.Option(min=1, help="How many. Default: 100.")] = None,
    method: Annotated[
        Method | None,
        typer.Option(help="How points are chosen. Default: latin_hypercube.", show_default=False),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of points and noise.")] = None,
    vehicle: Aircraft = None,
    wind: Wind = "0,0,0",
    gusts: Gusts = False,
    controller: Controller = "lqr",
    effect: Effects = None,
    start: Starts = None,
    duration: Annotated[float | None, seconds("Of each run, s.")] = None,
    step: Annotated[float | None, seconds("Communication step, s.")] = None,
    engine: Engine = "local",
    workers: Workers = None,
    scheduler: Scheduler = None,
    recordings: Annotated[
        bool, typer.Option("--recordings", help="Keep every output of every run.")
    ] = False,
    call_limit: CallLimit = 60.0,
    time_limit: Annotated[float, seconds("Of one run, s.")] = 3600.0,
    memory_limit: MemoryLimit = 4.0,
    out: Out = Path("sweep"),
    force: Force = False,
    as_json: Annotated[
        Json, Prints("uavtwin.sweeps.result:SweepRecord", file="sweep.json")
    ] = False,
) -> None:
    """Fly a scenario many times, each time with other numbers, and find the important ones.

    After an interruption the same command resumes the sweep.
    """
    from cosim.limits import Limits

    from ..simulation import Scenario
    from ..sweeps.design import factor_of
    from ..sweeps.sweep import Work, chosen_design, run_sweep
    from ..vehicles import load_vehicle

    vehicle, own_parts = aircraft_of(scenario, vehicle)
    base = Scenario(
        scenario,
        None if own_parts else load_vehicle(vehicle),
        controller,
        three_numbers(wind, "--wind"),
        gusts,
        effects=tuple(effect or ()),
        starts=start_values(start),
    )
    points = chosen_design(design, dict(map(factor_of, vary or ())), runs, method, seed)
    limits = Limits(call_limit, time_limit, memory_limit)
    work = Work(engine, workers, scheduler, recordings, limits)
    options = {
        **{"wind": wind, "gusts": gusts, "controller": controller, "effect": effect or []},
        **{"start": start or [], "duration": duration, "step": step, "vary": vary or []},
        "recordings": recordings,
    }
    inputs = (Path(scenario), Path(vehicle), *([] if design is None else [design]))
    named = "" if own_parts else vehicle
    with progress("flying") as done:
        result = run_sweep(
            *(base, points, out, work, duration, step, named, force, done),
            lambda r: print_json(r.record) if as_json else STDOUT.print(str(r)),
            lambda r, folder: _note(r, folder, Path(vehicle).name, options, inputs),
        )
    if as_json:
        for warning in result.warnings:
            warn(warning)
    else:
        print_written(out, ["report.html", "runs.parquet", "sweep.json"])
    if result.counts.get("failed"):
        raise typer.Exit(Exit.FINDINGS)


def _note(
    result: "SweepResult",
    folder: Path,
    vehicle: str,
    options: dict[str, Any],
    given: tuple[Path, ...],
) -> None:
    """Write `run.json`, without engine and workers, which do not affect the results."""
    from ..output import write_run

    about = {
        "scenario": result.name,
        "vehicle": vehicle,
        "runs": len(result.table),
        "method": result.design.method,
    }
    inputs = [p for p in given if p.is_file()]
    write_run(folder, "sweep", {**about, **options}, inputs, result.design.seed)
