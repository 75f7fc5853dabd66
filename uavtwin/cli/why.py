"""`uavtwin why`: what went wrong in a flight, from its log alone."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Exit, Force, Json, Prints
from .printing import STDOUT, print_error, print_json, print_sections, print_table

if TYPE_CHECKING:
    from ..diagnosis import WhyRecord


def why(
    logs: Annotated[
        list[Path], typer.Argument(help="Logs of any format, or flight tables: one or several.")
    ],
    reference: Annotated[
        list[Path] | None,
        typer.Option(help="Normal flights of the same aircraft: one or several."),
    ] = None,
    since: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file of `uavtwin calibrate`, instead of --reference: what has changed "
            "since then, in newtons and kilograms."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Page of one log to write, .html: opens offline."),
    ] = None,
    diagnostic: Annotated[
        Path | None,
        typer.Option(
            "--diagnostic", help="JSON of one log to write: records as flight-review has them."
        ),
    ] = None,
    force: Force = False,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.diagnosis:WhyRecord",
            "uavtwin.diagnosis:UnreadRecord",
            about="Of several logs a list, of which one that cannot be read has the second form. "
            "How to read it: [why](../guide/why.md).",
        ),
    ] = False,
) -> None:
    """Say why a flight went wrong, and when: no vehicle file, no mass, no size."""
    from ..diagnosis import UnreadRecord, read_asked, why_table
    from ..diagnosis import why as ask_why
    from ..diagnostic import write_diagnostics
    from ..output import check_file
    from ..vehicles import load_vehicle

    for file, suffix in ((out, ".html"), (diagnostic, ".json")):
        if file is None:
            continue
        if file.suffix != suffix:
            raise typer.BadParameter(f"{file.name}: name a file that ends in {suffix}.")
        if len(logs) > 1:
            raise typer.BadParameter(f"{file.name}: it holds one flight; give one log.")
        check_file(file, force)
    vehicle = None if since is None else load_vehicle(since)
    normal, found, worst = read_asked(reference or []), [], Exit.FINE
    records: list[WhyRecord | UnreadRecord] = []
    for log in logs:
        try:
            result = ask_why(log, normal, vehicle)
        except Exception as error:  # an unreadable one does not affect others
            if len(logs) == 1:
                raise
            worst = max(worst, print_error(error, f"why {log}"))
            records.append(UnreadRecord(flight=log.stem, error=str(error)))
            continue
        found.append(result)
        records.append(result.record)
        if not as_json:
            if len(logs) > 1:
                STDOUT.print(log, style="bold")
            print_sections(result.findings())
        if result.record.verdict != "nothing_found":
            worst = max(worst, Exit.FINDINGS)
    if as_json:
        print_json(records if len(logs) > 1 else records[0])
    elif len(logs) > 1:
        print_table(why_table(records))
    if out is not None:
        found[0].report(out)
    if diagnostic is not None:
        write_diagnostics(found[0], diagnostic)
    if not as_json and (written := [str(f) for f in (out, diagnostic) if f is not None]):
        STDOUT.print(f"written: {', '.join(written)}")
    raise typer.Exit(worst)
