"""`uavtwin why`: what went wrong in a flight, from its log alone."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Exit, Force, Json, Prints


def why(
    log: Annotated[Path, typer.Argument(help="Log of any format, or flight table.")],
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
        Path | None, typer.Option("--out", help="Page to write, .html: opens offline.")
    ] = None,
    diagnostic: Annotated[
        Path | None,
        typer.Option("--diagnostic", help="JSON to write: records as flight-review has them."),
    ] = None,
    force: Force = False,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.diagnosis:WhyRecord",
            about="How to read it: [why](../guide/why.md).",
        ),
    ] = False,
) -> None:
    """Say why a flight went wrong, and when: no vehicle file, no mass, no size."""
    from ..diagnosis import why as ask_why
    from ..diagnostic import write_diagnostics
    from ..output import check_file
    from ..vehicles import load_vehicle
    from .results import print_result

    for file, suffix in ((out, ".html"), (diagnostic, ".json")):
        if file is not None:
            if file.suffix != suffix:
                raise typer.BadParameter(f"{file.name}: name a file that ends in {suffix}.")
            check_file(file, force)
    vehicle = None if since is None else load_vehicle(since)
    found = ask_why(log, reference or [], vehicle)
    print_result(found, as_json)
    if out is not None:
        found.report(out)
    if diagnostic is not None:
        write_diagnostics(found, diagnostic)
    raise typer.Exit(Exit.FINE if found.record.verdict == "nothing_found" else Exit.FINDINGS)
