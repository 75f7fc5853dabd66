"""`uavtwin gap`: flights against their twin."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    Csv,
    Exit,
    Force,
    Horizon,
    Json,
    Mcap,
    Out,
    Prints,
    Rebuild,
    TrustVehicle,
    VehicleName,
)
from .printing import (
    STDERR,
    STDOUT,
    print_damage,
    print_incomplete,
    print_json,
    print_table,
    print_written,
    progress,
)

if TYPE_CHECKING:
    from ..gaps import GapResult


def gap(
    logs: Annotated[list[Path], typer.Argument(help="PX4 ULogs or flight tables.")],
    vehicle: VehicleName,
    out: Out = Path("gap"),
    horizon: Horizon = 0.5,
    rebuild_commands: Rebuild = None,
    trust_vehicle: TrustVehicle = False,
    csv: Csv = False,
    mcap: Mcap = False,
    force: Force = False,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.gaps:GapRecord",
            file="gap.json",
            about="What the numbers mean: [the gap](../guide/gap.md).",
        ),
    ] = False,
) -> None:
    """Fly the twin on the commands of real flights and report where the two disagree."""
    from .. import gaps
    from ..flights import open_alike
    from ..output import OptionalSteps, check_folder, results_folder, write_json, write_run
    from ..series.files import chosen_forms, write_all_series
    from ..vehicles import load_vehicle

    check_folder(out, force)
    forms = chosen_forms(csv, mcap)
    model = load_vehicle(vehicle)
    flights = open_alike(logs, rebuild_commands, trust_vehicle)
    with progress("comparing") as step:
        found = gaps.gap(flights, model, horizon_s=horizon, progress=step)
    options = {
        "vehicle": Path(vehicle).name,
        "horizon": horizon,
        "rebuild_commands": rebuild_commands,
        "trust_vehicle": trust_vehicle,
        "series": list(forms),
    }
    inputs = [*logs, Path(vehicle)] if Path(vehicle).is_file() else logs
    if as_json:
        print_json(found.record)
    else:
        _print_gap(found)
    steps = OptionalSteps()
    with results_folder(out, force) as folder:
        write_json(folder / "gap.json", found.json())
        found.report(folder / "report.html")
        written, series = ["gap.json"], found.series()
        if steps.run("series", folder, lambda place: write_all_series(series, place, forms)):
            written.append("series/")
        write_run(folder, "gap", options, inputs, incomplete=steps.incomplete)
    if not as_json:
        print_written(out, ["report.html", *written])
    damaged = print_damage(flights)
    if print_incomplete(steps) or damaged or not any(g.channels for g in found.flights):
        raise typer.Exit(Exit.FINDINGS)


def _print_gap(found: "GapResult") -> None:
    """The gap as a table, warnings on stderr."""
    STDOUT.print(found.claim, style="bold")
    for sentence in found.hover:
        STDOUT.print(sentence)
    print_table(found.table())
    for g in found.flights:
        if "commands_match" in g.facts:
            STDOUT.print(f"{g.flight}: commands {g.facts['commands_match']}")
        for warning in g.warnings:
            STDERR.print(f"{g.flight}: {warning}", style="yellow")
