"""The command line: `uavtwin VERB ...`. Exit 0 fine, 1 findings, 2 used wrongly.

Results go to stdout, progress and warnings to stderr. Heavy modules are imported by the verb that
needs them.
"""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from twin.errors import TwinError

from .fmu_verbs import export, simulate
from .learning_verbs import evaluate, train
from .options import Exit, Force, Json, Out, VehicleName
from .printing import (
    STDERR,
    STDOUT,
    print_damage,
    print_explanation,
    print_gap,
    print_json,
    progress,
)

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Hybrid digital twin of a multirotor, as FMI co-simulation components.",
)


def main() -> None:
    """Entry point: errors a user can mend become a text and exit code 2."""
    try:
        app(_spread(sys.argv[1:]))
    except TwinError as error:
        STDERR.print(f"error: {error}", style="red", markup=False)
        sys.exit(Exit.WRONG_USE)
    except OSError as error:
        STDERR.print(
            f"error: {error.filename or 'output'}: {error.strerror}", style="red", markup=False
        )
        sys.exit(Exit.WRONG_USE)
    except (KeyboardInterrupt, SystemError) as error:
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise  # an interrupt inside CasADi comes out as a SystemError
        STDERR.print("interrupted")
        sys.exit(130)


def _spread(arguments: list[str]) -> list[str]:
    """`--holdout A B` as `--holdout A --holdout B`: it takes all files up to the next option."""
    found: list[str] = []
    option = ""
    for argument in arguments:
        if argument.startswith("-"):
            option = argument
        elif option == "--holdout" and found[-1] != option:
            found.append(option)
        found.append(argument)
    return found


def _print_version(wanted: bool) -> None:
    from importlib.metadata import version

    if wanted:
        STDOUT.print(version("uavtwin"))
        raise typer.Exit(Exit.FINE)


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Options before the verb."""


@app.command()
def check(
    files: Annotated[list[Path], typer.Argument(help="Logs, flight tables, FMUs, vehicle files.")],
    as_json: Json = False,
) -> None:
    """Say what a file holds, what is wrong with it and what it is good for."""
    from ..check import check_file

    reports = [check_file(path) for path in files]
    if as_json:
        print_json([r.as_json() for r in reports])
    else:
        for report in reports:
            report.print(STDOUT)
    if any(r.problems for r in reports):
        raise typer.Exit(Exit.FINDINGS)


@app.command()
def gap(
    logs: Annotated[list[Path], typer.Argument(help="PX4 ULogs or flight tables.")],
    vehicle: VehicleName,
    out: Out = Path("gap"),
    horizon: Annotated[
        float, typer.Option(help="Short horizon in s: restart from the measured state that often.")
    ] = 0.5,
    rebuild_commands: Annotated[
        bool | None,
        typer.Option(
            "--rebuild-commands/--logged-commands",
            help="Rebuild motor commands at full rate from gyro and setpoints. "
            "Default: where the log needs it.",
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Fly the twin on the commands of real flights and report where the two disagree."""
    from twin.logs import read_flight
    from twin.residuals.flight_gap import flight_gap
    from twin.residuals.gap import gap_json
    from twin.vehicle.file import load_vehicle

    from ..output import check_folder, results_folder, write_json, write_run
    from ..report.gap import write_gap_report

    check_folder(out, force)
    model = load_vehicle(vehicle)
    flights = [read_flight(path, rebuild_commands=rebuild_commands) for path in logs]
    gaps = []
    with progress("comparing") as step:
        for i, flight in enumerate(flights):

            def share(done: float, i: int = i) -> None:
                step((i + done) / len(flights))

            gaps.append(flight_gap(flight, model, horizon, share))
    options = {
        "vehicle": Path(vehicle).name,
        "horizon": horizon,
        "rebuild_commands": rebuild_commands,
    }
    inputs = [*logs, Path(vehicle)] if Path(vehicle).is_file() else logs
    with results_folder(out, force) as folder:
        write_json(folder / "gap.json", gap_json(gaps))
        write_gap_report(gaps, folder / "report.html")
        write_run(folder, "gap", options, inputs)
    if as_json:
        print_json(gap_json(gaps))
    else:
        print_gap(gaps, out)
    damaged = print_damage(flights)
    if damaged or not any(g.channels for g in gaps):
        raise typer.Exit(Exit.FINDINGS)


@app.command()
def explain(
    flights: Annotated[list[Path], typer.Argument(help="PX4 ULogs or flight tables, to fit on.")],
    vehicle: VehicleName,
    holdout: Annotated[
        list[Path] | None,
        typer.Option(
            help="Flights that take no part in the fit and show the gap before and after. "
            "Default: blocks of time of the flights, which is weaker."
        ),
    ] = None,
    payload: Annotated[
        list[str] | None,
        typer.Option(help="Known mass aboard one of the flights, FLIGHT=KG. May be repeated."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of every bootstrap.")] = 0,
    no_fmus: Annotated[bool, typer.Option("--no-fmus", help="Build no FMUs.")] = False,
    out: Out = Path("explain"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Name the physical effect that a model lacks, add it, and show that the gap shrinks."""
    from fmus.platforms import DEFAULT, compilers, select_platforms
    from twin.explain.explanation import explain as search
    from twin.explain.result_json import explain_json
    from twin.logs import read_flight
    from twin.vehicle.file import load_vehicle

    from ..explanation import flight_payloads, write_explanation
    from ..output import check_folder, results_folder, write_run

    check_folder(out, force)
    if not no_fmus:
        compilers(select_platforms(DEFAULT))  # a missing one is reported before the search
    model, held = load_vehicle(vehicle), holdout or []
    for path in held:
        if path.resolve() in {p.resolve() for p in flights}:
            raise TwinError(f"{path}: is a flight of the fit; --holdout takes others.")
    fit, away = ([read_flight(path) for path in paths] for paths in (flights, held))
    payloads = flight_payloads(payload or [], [f.name for f in (*fit, *away)])
    with progress("explaining") as step:
        found = search(fit, away, model, seed, step, payloads=payloads)
    options = {"vehicle": Path(vehicle).name, "no_fmus": no_fmus, "payload": payload or []}
    inputs = [p for p in (*flights, *held, Path(vehicle)) if p.is_file()]
    with results_folder(out, force) as folder, progress("building") as step:
        written = write_explanation(found, vehicle, folder, not no_fmus, step)
        write_run(folder, "explain", options, inputs, seed)
    if as_json:
        print_json(explain_json(found))
    else:
        print_explanation(found)
        STDOUT.print(f"written: {out / written[0]}, {', '.join(written[1:])}, run.json")
    damaged = print_damage([*fit, *away])
    if damaged or found.verdict != "nothing":
        raise typer.Exit(Exit.FINDINGS)


@app.command()
def demo(
    seed: Annotated[
        int, typer.Option(min=0, help="Draws the hidden effect and the sensor noise.")
    ] = 1,
    vehicle: VehicleName = "copter_default",
    out: Out = Path("demo"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Hide an effect in built-in flights; find, name and add it, and show that the gap shrinks."""
    from twin.residuals.gap import rank, summaries
    from twin.vehicle.file import load_vehicle

    from ..demo.chain import demo_json, run_demo, write_demo
    from ..output import check_folder, results_folder, write_run
    from ..report.gap import claim

    check_folder(out, force)
    model = load_vehicle(vehicle)
    with progress("flying, comparing, explaining") as step:
        chain = run_demo(model, seed, step)
    with results_folder(out, force) as folder, progress("building") as step:
        written = write_demo(chain, vehicle, folder, step)
        write_run(folder, "demo", {"vehicle": Path(vehicle).name}, seed=seed)
    if as_json:
        print_json(demo_json(chain))
    else:
        STDOUT.print(claim(rank(summaries([chain.gap]))), style="bold", markup=False)
        print_explanation(chain.found)
        STDOUT.print(f"written: {out / written[0]}, {', '.join(written[1:])}, run.json")
    STDERR.print(chain.ending, markup=False)
    if not chain.right:
        raise typer.Exit(Exit.FINDINGS)


app.command()(export)
app.command()(simulate)
app.command()(train)
app.command()(evaluate)


@app.command()
def bench(as_json: Json = False) -> None:
    """Measure the speed figures of the README, here and now."""
    from ..bench.speed import run_bench

    with progress("measuring") as step:
        rows = run_bench(step)
    if as_json:
        print_json([row.as_json() for row in rows])
        return
    table = Table("what", "value", "unit", "goal", box=None)
    for row in rows:
        value = "-" if row.value is None else f"{row.value:.3g}"
        table.add_row(row.what, value, row.unit, row.goal)
    STDOUT.print(table)


@app.command("version")
def show_version() -> None:
    """Print the version."""
    _print_version(True)
