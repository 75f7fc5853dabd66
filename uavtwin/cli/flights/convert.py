"""`uavtwin convert`: a log as a flight table."""

from pathlib import Path
from typing import Annotated

import typer

from ..options import Exit, Force, Rebuild
from ..printing import STDERR, STDOUT, print_damage


def convert(
    log: Annotated[Path, typer.Argument(help="Log of any format that is read, or flight table.")],
    out: Annotated[Path, typer.Option("--out", help="Flight table to write, .parquet or .csv.")],
    rebuild_commands: Rebuild = None,
    force: Force = False,
) -> None:
    """Write a log as a flight table: SI, NED, FRD, one clock.

    Parquet keeps what the log says of itself and what was found in it, CSV the table alone.
    """
    from twin.logs import read_flight, write_flight
    from twin.logs.table import check_suffix

    from ...output import check_file, output_file, write_run

    check_suffix(out)
    check_file(out, force)
    flight = read_flight(log, rebuild_commands=rebuild_commands)
    with output_file(out) as file:
        write_flight(flight, file)
    options = {"rebuild_commands": rebuild_commands}
    write_run(out.parent, "convert", options, [log], file=f"{out.stem}.run.json")
    columns = ", ".join(str(c) for c in flight.table if c != "time" and flight.has(str(c)))
    seconds = flight.table["time"].iloc[-1] - flight.table["time"].iloc[0]
    STDOUT.print(
        f"{flight.facts['format']}, {seconds:.1f} s, {len(flight.table)} rows: {columns}",
        markup=False,
    )
    for finding in flight.findings:
        if finding.severity == "warning":
            STDERR.print(f"{finding.where}: {finding.message}", style="yellow", markup=False)
    STDOUT.print(f"written: {out}, {out.stem}.run.json", markup=False)
    if print_damage([flight]):
        raise typer.Exit(Exit.FINDINGS)
