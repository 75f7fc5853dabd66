"""`uavtwin verify`: FMUs against their reference results."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Exit, Json, Prints
from .printing import print_json, print_sections


def verify(
    fmus: Annotated[list[Path], typer.Argument(help="FMUs that hold reference results, or .ssp.")],
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.exports.verify:VerifyRecord",
            about="A list, one of each FMU. What it shows, and what not: [evidence](evidence.md).",
        ),
    ] = False,
) -> None:
    """Rerun the reference results inside FMUs, and say whether they come out the same here.

    Their code is executed. Exit code 1: one is not the same.
    """
    from ..exports.verify import verify as rerun

    found = [rerun(path) for path in fmus]
    if as_json:
        print_json([f.record for f in found])
    else:
        for result in found:
            print_sections(result.findings())
    if not all(f.passed for f in found):
        raise typer.Exit(Exit.FINDINGS)
