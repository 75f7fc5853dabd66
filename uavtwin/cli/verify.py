"""`uavtwin verify`: FMUs against their reference results."""

from pathlib import Path
from typing import Annotated

import typer

from twin.errors import TwinError

from .options import Exit, Json, Prints
from .printing import print_error, print_json, print_sections


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
    """Rerun the reference results inside FMUs, and compare the outputs.

    Their code is executed. Exit code 1: an output deviates.
    """
    from ..exports.verify import VerifyRecord
    from ..exports.verify import verify as rerun

    records, worst = [], Exit.FINE
    for path in fmus:
        try:
            result = rerun(path)
        except TwinError as error:  # a failed one does not affect others
            worst = max(worst, print_error(error, f"verify {path}"))
            lost = VerifyRecord(file=path.name, passed=False, experiments=(), error=str(error))
            records.append(lost)
            continue
        if not result.passed:
            worst = max(worst, Exit.FINDINGS)
        records.append(result.record)
        if not as_json:
            print_sections(result.findings())
    if as_json:
        print_json(records)
    raise typer.Exit(worst)
