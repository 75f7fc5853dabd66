"""`uavtwin fleet`: many logs of many aircraft."""

import csv
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from twin.errors import TwinError

from .options import (
    VEHICLE_VARIABLE,
    Engine,
    Exit,
    Force,
    Indoor,
    Json,
    Out,
    Prints,
    Scheduler,
    TrustVehicle,
    Workers,
    of_unit,
    seconds,
    vehicle_named,
)
from .printing import STDERR, STDOUT, print_json, print_rows, print_table, progress

if TYPE_CHECKING:
    from ..fleets.dataset import JobRows
    from ..fleets.fleet import FleetRequest
    from ..fleets.result import FleetResult


def fleet(
    logs: Annotated[list[str], typer.Argument(help="Logs, patterns, or folders of logs.")],
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file of all aircraft, or the name of a built-in vehicle. "
            f"Default: that of {VEHICLE_VARIABLE} in the environment."
        ),
    ] = None,
    per_aircraft: Annotated[
        Path | None,
        typer.Option(help="Instead of --vehicle: folder with a vehicle file per aircraft."),
    ] = None,
    verbs: Annotated[
        str, typer.Option(help="What is done with each log, of check, why, gap, explain.")
    ] = "check,why,gap,explain",
    each: Annotated[
        Literal["flight", "aircraft"],
        typer.Option(help="Explain each flight, or each aircraft with all its flights."),
    ] = "flight",
    indoor: Indoor = None,
    trust_vehicle: TrustVehicle = False,
    engine: Engine = "local",
    workers: Workers = None,
    scheduler: Scheduler = None,
    time_limit: Annotated[float, seconds("Of one log, or one aircraft, s.")] = 3600.0,
    memory_limit: Annotated[
        float, of_unit("GiB", "GIB", help="Of the process that looks at a log, GiB.")
    ] = 4.0,
    out: Out = Path("fleet"),
    force: Force = False,
    sql: Annotated[
        str | None,
        typer.Option(
            "--sql",
            help="Ask the tables of the folder that an earlier call wrote. One SELECT over "
            "flights, channels, effects, findings, in the SQL of DuckDB.",
        ),
    ] = None,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.fleets.result:FleetRecord",
            file="fleet.json",
            about="A list of rows by the columns of the `SELECT`, where it is asked by `--sql`.",
        ),
    ] = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print the rows of --sql as CSV.")] = False,
) -> None:
    """Check, diagnose, compare and explain many logs.

    Which aircraft differs, which numbers drift, what went wrong, which logs are bad?

    After an interruption the same command resumes the analysis. `uavtwin fleet FOLDER --sql "SELECT
    ..."` queries the resulting tables; no other file is read.
    """
    if sql is not None:
        _print_answer(_one_folder(logs), sql, time_limit, as_json, as_csv)
        return
    if as_csv:
        raise TwinError("fleet: --csv prints the rows of --sql. Give both, or neither.")
    from ..fleets.fleet import FOLDER, FleetRequest, Work, run_fleet
    from ..jobs.process import JobLimits

    named = None if per_aircraft else vehicle_named(vehicle, "") or None
    listed: Any = tuple(v.strip() for v in verbs.split(",") if v.strip())
    both = vehicle if per_aircraft else named
    request = FleetRequest(both, per_aircraft, listed, each == "flight", indoor, trust_vehicle)
    work = Work(engine, workers, scheduler, JobLimits(time_limit, memory_limit))
    with progress("looking") as done:
        result = run_fleet(
            *(list(logs), request, out, work, force, done),
            lambda r: print_json(r.record) if as_json else STDOUT.print(str(r)),
            lambda r, folder: _note(r, folder, request),
            _found,
        )
    if not as_json:
        STDOUT.print(
            f"written: {out / 'report.html'}, flights, channels, effects, findings (.parquet), "
            f"{f'{FOLDER}/, ' if (out / FOLDER).is_dir() else ''}fleet.json, run.json"
        )
    said = (result.misfits, result.differing, result.drifting, result.spreads)
    if result.bad or result.went_wrong or any(said):
        raise typer.Exit(Exit.FINDINGS)


def _one_folder(given: list[str]) -> Path:
    """The folder for `--sql`."""
    if len(given) != 1:
        raise TwinError(f"fleet --sql: asks one folder that fleet wrote; {len(given)} are given.")
    return Path(given[0])


def _print_answer(folder: Path, sql: str, time_limit_s: float, as_json: bool, as_csv: bool) -> None:
    """Query the tables of a fleet, and print the rows as a table, JSON or CSV; of a table wider
    than the terminal, a line per cell."""
    from ..display import TextTable
    from ..fleets.query import query

    if as_json and as_csv:
        raise TwinError("--json and --csv are both given. Choose one.")
    answer = query(folder, sql, time_limit_s)
    if as_json:
        print_rows(answer.records())
    elif as_csv:
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow(answer.names)
        writer.writerows(["" if v is None else v for v in row] for row in answer.rows)
    else:
        table = TextTable(answer.names, tuple(tuple(map(_cell, r)) for r in answer.rows))
        if table.width <= STDOUT.width:
            print_table(table)
        else:
            STDOUT.print(table.upright(), soft_wrap=True)


def _cell(value: object) -> str:
    """A value in the form of a printed table."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _found(found: "JobRows") -> None:
    """Print one line on the results of a log, or of an aircraft, as they arrive."""
    from ..fleets.result import of_log

    for row in found.rows.get("flights", ()):
        error = f": {row['error']}" if row.get("error") else ""
        STDERR.print(f"{of_log(row).line()}{error}")
    if "flights" not in found.rows:
        rows = found.rows.get("effects", ())
        named = {f"{r['aircraft']}: {r.get('effect') or r['verdict']}": None for r in rows}
        STDERR.print("\n".join(named))


def _note(result: "FleetResult", folder: Path, request: "FleetRequest") -> None:
    """Write `run.json`; logs are identified by their fingerprints in `flights`."""
    from ..output import write_run

    options = {
        "vehicle": result.vehicle or None,
        "per_aircraft": None if request.per_aircraft is None else request.per_aircraft.name,
        "verbs": list(request.verbs),
        "each": "flight" if request.alone else "aircraft",
        "indoor": request.indoors,
        "trust_vehicle": request.trust_vehicle,
        "logs": result.logs,
    }
    own = request.per_aircraft
    given = [Path(request.vehicle or "")] if own is None else sorted(own.glob("*.toml"))
    write_run(folder, "fleet", options, [p for p in given if p.is_file()])
