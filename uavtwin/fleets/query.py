"""SQL queries of a fleet's dataset: only its tables can be read, nothing can be written."""

import datetime
import math
import threading
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow.dataset as ds

from twin.errors import TwinError, install_command

from .dataset import TABLES, check_dataset, path_of

if TYPE_CHECKING:
    import pandas as pd

_SETTINGS = {
    "python_enable_replacements": False,
    "autoinstall_known_extensions": False,
    "autoload_known_extensions": False,
}
"""Settings of DuckDB: no Python objects, no extensions."""
MOST_MEMORY = "4GB"
"""Memory limit of a query."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Result of a query.

    Attributes:
        names: Names of the columns.
        rows: Rows with a value per column: numbers, texts, None.
    """

    names: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def frame(self) -> "pd.DataFrame":
        """The rows as a pandas table."""
        import pandas as pd

        return pd.DataFrame(self.rows, columns=list(self.names))

    def records(self) -> list[dict[str, Any]]:
        """A mapping per row, of JSON types."""
        return [{n: _plain(v) for n, v in zip(self.names, row, strict=True)} for row in self.rows]


def query(folder: str | Path, sql: str, time_limit_s: float = 300.0) -> Answer:
    """Query the dataset of a fleet.

    Args:
        folder: Folder of `--out` of `uavtwin fleet`.
        sql: One SELECT over flights, channels, effects, findings, in the SQL of DuckDB.
        time_limit_s: Time after which the query is aborted: a recursive one may never end.

    Raises:
        TwinError: The package is missing, it is no such folder, DuckDB refuses the query, or it
            takes too long.
    """
    if not 0 < time_limit_s <= threading.TIMEOUT_MAX:
        raise TwinError(f"query: a time limit of {time_limit_s:g} s: needs a positive number.")
    folder = Path(folder)
    try:
        import duckdb
    except ImportError as error:
        raise TwinError(f"query: needs the package duckdb: {install_command('fleet')}.") from error
    check_dataset(folder)
    connection = duckdb.connect(":memory:", config=dict(_SETTINGS))
    try:
        for table in TABLES:
            connection.register(table, ds.dataset(path_of(folder, table)))
        connection.execute(f"SET memory_limit = '{MOST_MEMORY}'")
        connection.execute("SET enable_external_access = false")
        connection.execute("SET lock_configuration = true")
        statements = connection.extract_statements(sql)
        if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
            raise TwinError(
                f"query: {'no' if not statements else 'this is not one'} SELECT: "
                f"{sql.strip()[:100]!r}. "
                f"Ask by one SELECT; the dataset is only read."
            )
        clock = threading.Timer(time_limit_s, connection.interrupt)
        clock.start()
        try:
            executed = connection.execute(statements[0])
            names = tuple(str(d[0]) for d in executed.description or ())
            return Answer(names, tuple(executed.fetchall()))
        finally:
            clock.cancel()
    except duckdb.InterruptException as error:
        raise TwinError(
            f"query: took longer than {time_limit_s:g} s, the limit (--time-limit)."
        ) from error
    except duckdb.Error as error:
        raise TwinError(f"query: {_said(str(error))}") from error
    finally:
        connection.close()


def _said(text: str) -> str:
    """Message of DuckDB, with the available names."""
    first = text.split("\n\nLINE")[0].strip()
    if "file system operations are disabled" in text:
        return f"{first} A query reads nothing but {', '.join(TABLES)}."
    if first.startswith("Catalog Error: Table"):
        return f"{first.splitlines()[0]} There are {', '.join(TABLES)}."
    return first


def _plain(value: Any) -> Any:
    """A value of a JSON type."""
    if isinstance(value, Decimal):
        value = float(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, datetime.date | datetime.time | datetime.timedelta | bytes):
        return str(value)
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    return value if isinstance(value, str | int | bool | None) else str(value)
