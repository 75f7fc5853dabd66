"""`uavtwin why`: what went wrong in a flight, from its log alone."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Exit, Json, Prints


def why(
    log: Annotated[Path, typer.Argument(help="Log of any format, or flight table.")],
    reference: Annotated[
        list[Path] | None,
        typer.Option(help="Normal flights of the same aircraft: one or several."),
    ] = None,
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
    from .results import print_result

    found = ask_why(log, reference or [])
    print_result(found, as_json)
    raise typer.Exit(Exit.FINE if found.record.verdict == "nothing_found" else Exit.FINDINGS)
