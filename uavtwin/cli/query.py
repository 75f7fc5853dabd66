"""`uavtwin query`: SQL over the tables of a fleet."""

import csv
import sys
from pathlib import Path
from typing import Annotated

import typer

from twin.errors import TwinError

from .options import Json, Prints, seconds
from .printing import print_rows, print_table


def query(
    folder: Annotated[Path, typer.Argument(help="Folder that `uavtwin fleet` wrote.")],
    sql: Annotated[
        str, typer.Argument(help="One SELECT over flights, channels, effects, findings.")
    ],
    time_limit: Annotated[float, seconds("Of the query, s.")] = 300.0,
    as_json: Annotated[
        Json, Prints(about="A list of rows, by the columns of the `SELECT`.")
    ] = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV instead of a table.")] = False,
) -> None:
    """Ask the tables of a fleet, in the SQL of DuckDB; nothing else is read, nothing is written."""
    from ..display import TextTable
    from ..fleets.query import query as run_query

    if as_json and as_csv:
        raise TwinError("query: --json and --csv are both given. Choose one.")
    answer = run_query(folder, sql, time_limit)
    if as_json:
        print_rows(answer.records())
    elif as_csv:
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow(answer.names)
        writer.writerows(["" if v is None else v for v in row] for row in answer.rows)
    else:
        print_table(TextTable(answer.names, tuple(tuple(map(_cell, r)) for r in answer.rows)))


def _cell(value: object) -> str:
    """As printed in a table."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
