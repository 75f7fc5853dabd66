"""`uavtwin sweep`: many runs of a scenario."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .options import Exit, Force, Json, Out, start_values, vehicle_named
from .printing import STDOUT, print_json, progress
from .simulate import Aircraft, three_numbers

_VEHICLE = "copter_default"
Method = Literal["latin_hypercube", "sobol", "random", "grid", "saltelli"]


def sweep(
    scenario: Annotated[
        str, typer.Argument(help="hover, takeoff, tour, forward, land, or an .ssp file.")
    ],
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
    wind: Annotated[str, typer.Option(help="Velocity of the air NED, m/s: 5,0,0.")] = "0,0,0",
    gusts: Annotated[bool, typer.Option("--gusts", help="Dryden turbulence.")] = False,
    controller: Annotated[str, typer.Option(help="lqr or px4.")] = "lqr",
    effect: Annotated[
        list[str] | None, typer.Option(help="Effect to switch on; may be given several times.")
    ] = None,
    start: Annotated[list[str] | None, typer.Option(help="Start value PART.NAME=VALUE.")] = None,
    duration: Annotated[float | None, typer.Option(help="Of each run, s.")] = None,
    step: Annotated[float | None, typer.Option(help="Communication step, s.")] = None,
    engine: Annotated[
        Literal["local", "dask"], typer.Option(help="Processes here, or a Dask cluster.")
    ] = "local",
    workers: Annotated[
        int | None, typer.Option(help="Processes of the local engine. Default: one per core.")
    ] = None,
    scheduler: Annotated[str | None, typer.Option(help="Of Dask: tcp://HOST:8786.")] = None,
    recordings: Annotated[
        bool, typer.Option("--recordings", help="Keep every output of every run.")
    ] = False,
    call_limit: Annotated[float, typer.Option(help="Of one call into an FMU, s.")] = 60.0,
    time_limit: Annotated[float, typer.Option(help="Of one run, s.")] = 3600.0,
    memory_limit: Annotated[float, typer.Option(help="Of one process of FMUs, GiB.")] = 4.0,
    out: Out = Path("sweep"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Fly a scenario many times, each time with other numbers, and see what matters.

    A sweep that was interrupted goes on where it was when the same command is given again.
    """
    from cosim.limits import Limits

    from ..output import write_run
    from ..sweeps.design import factor_of
    from ..sweeps.sweep import sweep as run_sweep

    own_parts = scenario.endswith(".ssp") and vehicle in (None, _VEHICLE)
    vehicle = _VEHICLE if own_parts else vehicle_named(vehicle, _VEHICLE)
    given = dict(map(factor_of, vary or ()))
    with progress("flying") as done:
        result = run_sweep(
            scenario,
            None if own_parts else vehicle,
            out=out,
            vary=given,
            design=design,
            runs=runs,
            method=method,
            seed=seed,
            wind=three_numbers(wind, "--wind"),
            gusts=gusts,
            controller=controller,
            effects=tuple(effect or ()),
            starts=start_values(start),
            duration=duration,
            step=step,
            engine=engine,
            workers=workers,
            scheduler=scheduler,
            recordings=recordings,
            limits=Limits(call_limit, time_limit, memory_limit),
            force=force,
            progress=done,
        )
    options: dict[str, Any] = {
        "scenario": Path(scenario).name,
        "vehicle": Path(vehicle).name,
        "vary": vary or [],
        "design": None if design is None else design.name,
        "runs": len(result.table),
        "method": result.design.method,
        "wind": wind,
        "gusts": gusts,
        "controller": controller,
        "effect": effect or [],
        "start": start or [],
        "duration": duration,
        "step": step,
        "recordings": recordings,
    }
    inputs = [p for p in (Path(scenario), Path(vehicle), design) if p is not None and p.is_file()]
    write_run(out, "sweep", options, inputs, result.design.seed)
    if as_json:
        print_json(result.json())
    else:
        STDOUT.print(str(result), markup=False)
        STDOUT.print(f"written: {out / 'report.html'}, runs.parquet, sweep.json, run.json")
    if result.counts.get("failed"):
        raise typer.Exit(Exit.FINDINGS)
