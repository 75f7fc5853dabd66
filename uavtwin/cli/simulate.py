"""`uavtwin simulate`: flights of the twin, and systems from other tools."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from twin.errors import TwinError

from .options import (
    VEHICLE_VARIABLE,
    CallLimit,
    Controller,
    Csv,
    Effects,
    Exit,
    Force,
    Gusts,
    Json,
    Mcap,
    MemoryLimit,
    Out,
    Prints,
    Starts,
    Wind,
    seconds,
    start_values,
    trained,
    vehicle_named,
)
from .printing import STDERR, STDOUT, print_incomplete, print_json, print_written, progress, warn

Algorithm = Literal["jacobi", "settled", "gauss_seidel"]
_VEHICLE = "copter_default"
"""Default vehicle."""
Aircraft = Annotated[
    str | None,
    typer.Option(
        help="Vehicle file (TOML), or the name of a built-in vehicle. Default: that of "
        f"{VEHICLE_VARIABLE} in the environment, else {_VEHICLE}; of an .ssp its own parts."
    ),
]
ScenarioName = Annotated[
    str, typer.Argument(help="hover, takeoff, tour, forward, land, or an .ssp file.")
]
Model = Annotated[
    Path | None,
    trained(
        "Folder of what train wrote: a learned force, or a compensator of the sensors that "
        "sees no measurement."
    ),
]
Trust = Annotated[
    Path | None,
    typer.Option(help="Hashes by sha256sum, of an .ssp or all its FMUs: run in this process."),
]

if TYPE_CHECKING:
    from ..output import OptionalSteps
    from ..run import Run


def simulate(
    scenario: ScenarioName,
    vehicle: Aircraft = None,
    wind: Wind = "0,0,0",
    gusts: Gusts = False,
    seed: Annotated[int, typer.Option(min=0, help="Of every noise.")] = 0,
    controller: Controller = "lqr",
    effect: Effects = None,
    start: Starts = None,
    model: Model = None,
    stop: Annotated[float | None, seconds("Stop time, s.")] = None,
    step: Annotated[float | None, seconds("Communication step, s.")] = None,
    interval: Annotated[float | None, seconds("Time between recorded rows, s.")] = None,
    algorithm: Annotated[Algorithm, typer.Option(help="How the parts exchange values.")] = "jacobi",
    fused: Annotated[bool, typer.Option("--fused", help="Run the twin as one FMU.")] = False,
    realtime: Annotated[bool, typer.Option("--realtime", help="As fast as the clock.")] = False,
    trust: Trust = None,
    call_limit: CallLimit = 60.0,
    time_limit: Annotated[float, seconds("Of a run of foreign FMUs, s.")] = 3600.0,
    memory_limit: MemoryLimit = 4.0,
    csv: Csv = False,
    mcap: Mcap = False,
    out: Out = Path("simulation"),
    force: Force = False,
    as_json: Annotated[Json, Prints("uavtwin.run:RunRecord", file="summary.json")] = False,
) -> None:
    """Fly a scenario, or run an .ssp, and record every output."""
    from cosim.limits import Limits

    from ..output import OptionalSteps, check_folder
    from ..run import run_plan, with_model
    from ..series.files import chosen_forms
    from ..simulation import Scenario
    from ..vehicles import load_vehicle

    check_folder(out, force)
    forms = chosen_forms(csv, mcap)
    vehicle, own_parts = aircraft_of(scenario, vehicle)
    plan = Scenario(
        scenario,
        None if own_parts else load_vehicle(vehicle),
        controller,
        three_numbers(wind, "--wind"),
        gusts,
        seed,
        tuple(effect or ()),
        start_values(start),
        fused,
    )
    if model is not None:
        plan = with_model(plan, model)
    with progress("simulating") as done:
        run = run_plan(
            plan,
            None,
            done,
            trust,
            stop_s=stop,
            step_s=step,
            interval_s=interval,
            algorithm=algorithm,
            realtime=1.0 if realtime else None,
            limits=Limits(call_limit, time_limit, memory_limit),
        )
    options = {
        "scenario": plan.name,
        "vehicle": Path(vehicle).name,
        "wind": wind,
        "gusts": gusts,
        "controller": controller,
        "effect": effect or [],
        "start": start or [],
        "model": None if model is None else model.name,
        "stop": stop,
        "step": step,
        "interval": interval,
        "algorithm": algorithm,
        "fused": fused,
        "trust": None if trust is None else trust.name,
    }
    given = (Path(scenario), Path(vehicle), *([] if trust is None else [trust]))
    inputs = [p for p in given if p.is_file()]
    recordings = [f"recording.{form}" for form in forms]
    for warning in run.warnings:
        warn(warning)
    if as_json:
        print_json(run.record)
    elif run.ended is None:
        STDOUT.print(run.claim, style="bold")
        if realtime:
            STDERR.print(f"at most {1e3 * run.recording.lateness_s:.1f} ms behind the clock")
    steps = OptionalSteps()
    recorded = _write(run, out, force, recordings, options, inputs, seed, steps)
    failed = print_incomplete(steps)
    if run.ended is not None:
        _end(run, out)
    if not as_json:
        if run.recording.printed:
            STDERR.print(f"what the FMUs printed is in {out / 'printed.txt'}")
        print_written(out, ["report.html", *recorded, "summary.json"])
    if failed:
        raise typer.Exit(Exit.FINDINGS)


def _write(
    run: "Run",
    out: Path,
    force: bool,
    recordings: Sequence[str],
    options: Mapping[str, Any],
    inputs: Sequence[Path],
    seed: int,
    steps: "OptionalSteps",
) -> list[str]:
    """Write all results of a run, marked if incomplete; returns the names of the recordings.

    Without space for a recording, figures and page are still written.
    """
    from ..output import results_folder, write_json, write_run
    from ..report.simulation import page_text

    printed = run.recording.printed
    with results_folder(out, force) as folder:
        write_json(folder / "summary.json", run.json())
        facts = {k: v for k, v in options.items() if v not in (None, [], "", False)}
        (folder / "report.html").write_text(page_text(run, facts), "utf-8")
        if printed:
            (folder / "printed.txt").write_text(printed, "utf-8")

        def save(place: Path, name: str) -> Path:
            return run.save(place / name)

        recorded = [n for n in recordings if steps.run(n, folder, partial(save, name=n))]
        why = "; ".join(filter(None, [run.recording.incomplete, steps.incomplete]))
        write_run(folder, "simulate", options, inputs, seed, incomplete=why, fmus=run.fmus)
    return recorded


def _end(run: "Run", out: Path) -> NoReturn:
    """Print how a run ended and the path of its recording, and end with its exit code."""
    text = (
        f"{run.recording.incomplete.rstrip('.')}. What was recorded up to "
        f"{run.recording.time_s[-1]:g} s is in {out}, marked incomplete."
    )
    if isinstance(run.ended, KeyboardInterrupt):
        STDERR.print(text)
        raise KeyboardInterrupt from run.ended
    STDERR.print(f"error: {text}", style="red")
    raise typer.Exit(Exit.FINDINGS)


def aircraft_of(scenario: str, given: str | None) -> tuple[str, bool]:
    """Name of the vehicle; and whether an `.ssp` uses its own parts instead."""
    if scenario.endswith(".ssp") and given in (None, _VEHICLE):
        return _VEHICLE, True
    return vehicle_named(given, _VEHICLE), False


def three_numbers(text: str, option: str) -> tuple[float, float, float]:
    """Three numbers separated by commas."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise TwinError(f"{option} {text}: write three numbers, e.g. 5,0,0.") from None
    return x, y, z
