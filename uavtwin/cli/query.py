"""`uavtwin query`: SQL over the tables of a fleet."""

import csv
import sys
from pathlib import Path
from typing import Annotated

import typer

from twin.errors import TwinError

from .options import Json, Prints, seconds
from .printing import STDOUT, print_rows, print_table

SQL = "One SELECT over flights, channels, effects, findings, in the SQL of DuckDB"
"""Meaning of the argument."""
AsCsv = Annotated[bool, typer.Option("--csv", help="Print the rows of --sql as CSV.")]
ROWS = "A list of rows by the columns of the `SELECT`, where it is asked by `--sql`."
"""What `--json` of `--sql` prints."""


def query(
    folder: Annotated[Path, typer.Argument(help="Folder that `uavtwin fleet` wrote.")],
    sql: Annotated[str, typer.Argument(help=f"{SQL}.")],
    time_limit: Annotated[float, seconds("Of the query, s.")] = 300.0,
    as_json: Annotated[Json, Prints(about=ROWS)] = False,
    as_csv: AsCsv = False,
) -> None:
    """Former name of `uavtwin fleet FOLDER --sql SELECT`."""
    print_answer(folder, sql, time_limit, as_json, as_csv)


def print_answer(folder: Path, sql: str, time_limit_s: float, as_json: bool, as_csv: bool) -> None:
    """Ask the tables of a fleet, and print the rows as a table, JSON or CSV; a table that is wider
    than the terminal, a line per cell."""
    from ..display import TextTable
    from ..fleets.query import query as run_query

    if as_json and as_csv:
        raise TwinError("--json and --csv are both given. Choose one.")
    answer = run_query(folder, sql, time_limit_s)
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
    """As printed in a table."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
