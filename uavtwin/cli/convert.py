"""`uavtwin convert`: a log as a flight table, or as MCAP."""

from pathlib import Path
from typing import Annotated

import typer

from twin.errors import TwinError

from .options import Exit, Force, Rebuild
from .printing import STDERR, STDOUT, print_damage

_WRITTEN = (".parquet", ".csv", ".mcap")
"""Extensions of the files that can be written."""


def convert(
    log: Annotated[Path, typer.Argument(help="Log of any format that is read, or flight table.")],
    out: Annotated[
        Path, typer.Option("--out", help="Flight table to write, .parquet or .csv; or .mcap.")
    ],
    rebuild_commands: Rebuild = None,
    force: Force = False,
) -> None:
    """Write a log as a flight table: SI, NED, FRD, one clock.

    Parquet includes facts and findings of the log, CSV only the table. MCAP is for Foxglove and
    PlotJuggler, with a layout for each next to it; no command reads it.
    """
    from twin.logs import read_flight, write_flight

    from ..output import check_file, check_record, record_of, recorded_file
    from ..series.layouts import layout_files, write_layouts
    from ..series.mcap import check_mcap, write_flight_mcap

    if out.suffix not in _WRITTEN:
        raise TwinError(f"{out.name}: a flight is written as {', '.join(_WRITTEN)}.")
    layouts = layout_files(out) if out.suffix == ".mcap" else []
    if layouts:
        check_mcap()
    for file in (out, *layouts):
        check_file(file, force)
    check_record(record_of(out), force)
    flight = read_flight(log, rebuild_commands=rebuild_commands)
    columns = ", ".join(str(c) for c in flight.table if c != "time" and flight.has(str(c)))
    seconds = flight.table["time"].iloc[-1] - flight.table["time"].iloc[0]
    STDOUT.print(
        f"{flight.facts['format']}, {seconds:.1f} s, {len(flight.table)} rows: {columns}",
    )
    for finding in flight.findings:
        if finding.severity == "warning":
            STDERR.print(f"{finding.where}: {finding.message}", style="yellow")
    with recorded_file(out, force) as (file, note):
        note("convert", {"rebuild_commands": rebuild_commands}, [log])
        if out.suffix == ".mcap":
            write_flight_mcap(flight, file)
        else:
            write_flight(flight, file)
    if layouts:
        write_layouts(flight, out)
    STDOUT.print(
        f"written: {', '.join([str(out), record_of(out).name, *(f.name for f in layouts)])}"
    )
    if print_damage([flight]):
        raise typer.Exit(Exit.FINDINGS)
