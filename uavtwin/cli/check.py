"""`uavtwin check`: any file that the program knows."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Exit, Json
from .printing import STDOUT, print_json

_STYLES = {
    "problem": "red",
    "warning": "yellow",
    "question": "cyan",
    "good for": "green",
    "explain can tell": "green",
}


def check(
    files: Annotated[list[Path], typer.Argument(help="Logs, flight tables, FMUs, vehicle files.")],
    as_json: Json = False,
) -> None:
    """Say what a file holds, what is wrong with it and what it is good for."""
    from ..file_check import check_file

    problems = 0
    if as_json:
        reports = [check_file(path) for path in files]
        problems = sum(len(r.problems) for r in reports)
        print_json([r.json() for r in reports])
    else:
        for path in files:
            report = check_file(path)  # one that cannot be read stops here, the others are told
            problems += len(report.problems)
            STDOUT.print(report.file, style="bold", markup=False)
            for kind, text in report.lines():
                STDOUT.print(f"  {text}", style=_STYLES.get(kind), markup=False)
    if problems:
        raise typer.Exit(Exit.FINDINGS)
