"""`uavtwin check`: any file of a known kind."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Exit, Json, Prints
from .printing import STDOUT, print_error, print_json

if TYPE_CHECKING:
    from ..file_check import CheckReport

_STYLES = {
    "problem": "red",
    "warning": "yellow",
    "question": "cyan",
    "good for": "green",
    "explain can look for": "green",
}
"""Colour of a line on a terminal, by its kind."""


def check(
    files: Annotated[
        list[Path], typer.Argument(help="Logs, flight tables, FMUs, systems (.ssp), vehicle files.")
    ],
    vehicle: Annotated[
        str | None,
        typer.Option(help="Vehicle whose hover is compared with that of each flight."),
    ] = None,
    key: Annotated[
        Path | None,
        typer.Option(
            help="Public key of minisign: the signature beside each file, FILE.minisig, has to be "
            "of it, and of every byte."
        ),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Print every line, not the first of them.")
    ] = False,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.file_check:CheckReport",
            "uavtwin.file_check:UnreadFile",
            about="A list, one of each file; one that cannot be read has the second form.",
        ),
    ] = False,
) -> None:
    """Say what a file holds, what is wrong with it and what it is good for."""
    from ..file_check import UnreadFile, check_file
    from ..record import Record
    from ..vehicles import load_vehicle

    model = None if vehicle is None else load_vehicle(vehicle)
    reports: list[Record] = []
    worst = Exit.FINE
    for path in files:
        try:
            report = check_file(path, model, key)
        except Exception as error:  # an unreadable one does not affect others
            worst = max(worst, print_error(error, f"check {path}"))
            reports.append(UnreadFile(file=path.name, error=str(error)))
            continue
        if report.problems or report.warnings:
            worst = max(worst, Exit.FINDINGS)
        reports.append(report)
        if not as_json:
            _print(report, every)
    if as_json:
        print_json(reports)
    raise typer.Exit(worst)


def _print(report: "CheckReport", every: bool) -> None:
    """Print the verdict, then the most important lines, each on one line; or all of them, in
    full."""
    STDOUT.print(report.claim(), style="bold")
    shown = report.lines() if every else report.short_lines()
    cut = STDOUT.is_terminal and not every
    for kind, text in shown:
        STDOUT.print(
            f"  {text}",
            style=_STYLES.get(kind),
            no_wrap=cut,
            overflow="ellipsis" if cut else "fold",
        )
    if left := len(report.lines()) - len(shown):
        STDOUT.print(f"  {left} more lines: --all", style="dim")
