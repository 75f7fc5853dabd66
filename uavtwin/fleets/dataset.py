"""Tables of a fleet in Parquet, written from the journal a piece at a time."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from twin.errors import TwinError
from twin.logs.table.parquet import damage_told, opened

from ..jobs import journal
from ..output import output_file
from .columns import TABLES, schema
from .looking import Found, Look

JOURNAL = "fleet.jsonl"
PIECE = 500
"""Logs whose rows are in memory at once."""
COPY = "holds the same flight as {}, which counts once"


class Journal(journal.Journal[int]):
    """Of logs and aircraft, by the numbers of their jobs."""

    kind = "fleet"
    differs = "other vehicles, verbs or version"

    def named(self, content: journal.Content) -> int:
        """Number of the job."""
        if not (isinstance(content["job"], int) and content.keys() <= {"job", *TABLES}):
            raise ValueError
        return int(content["job"])

    def add(self, found: Found) -> None:
        """Write a job down."""
        self.write(found.json())

    def places(self) -> dict[int, int]:
        """Where the line of each job begins."""
        return {int(content["job"]): place for place, content in self.contents()}

    def lines(self, looks: Iterable[Look], places: Mapping[int, int]) -> Iterator[dict[str, Any]]:
        """Lines of jobs, in their order, a copy of a flight marked as such.

        Args:
            looks: Jobs, all of which are done.
            places: Of their lines.
        """
        first: dict[bytes, str] = {}
        with self._path.open("rb") as file:
            for look in looks:
                file.seek(places[look.job])
                yield _once(json.loads(file.readline()), first)


def _once(content: dict[str, Any], first: dict[bytes, str]) -> dict[str, Any]:
    """A line, without what would count twice."""
    about = (content.get("flights") or [{}])[0]
    print_ = about.get("fingerprint")
    if print_ is None:
        return content
    log = first.setdefault(bytes.fromhex(print_)[:12], about["log"])
    if log == about["log"]:
        return content
    kept = {k: about[k] for k in ("log", "bytes", "format", "aircraft", "fingerprint")}
    return {"flights": [kept | {"status": "copy", "error": COPY.format(log)}]}


def write_dataset(lines: Iterable[Mapping[str, Any]], out: Path) -> None:
    """Write all tables, each at once and as a whole.

    Args:
        lines: Of the journal, in the order of the rows.
        out: Folder.
    """
    with ExitStack() as stack:
        writers = {
            table: stack.enter_context(
                pq.ParquetWriter(
                    stack.enter_context(output_file(path_of(out, table))),
                    schema(table),
                    compression="zstd",
                )
            )
            for table in TABLES
        }
        rows: dict[str, list[Mapping[str, Any]]] = {table: [] for table in TABLES}
        count = 0
        for count, line in enumerate(lines, start=1):
            for table, held in rows.items():
                held += line.get(table, ())
            if count % PIECE == 0:
                _flush(writers, rows)
        _flush(writers, rows)


def _flush(
    writers: Mapping[str, pq.ParquetWriter], rows: dict[str, list[Mapping[str, Any]]]
) -> None:
    for table, held in rows.items():
        if held:
            writers[table].write_table(pa.Table.from_pylist(held, schema(table)))
            held.clear()


def path_of(folder: Path, table: str) -> Path:
    """File of a table."""
    return folder / f"{table}.parquet"


def read_table(
    folder: Path, table: str, columns: Sequence[str] | None = None, filters: Any = None
) -> pd.DataFrame:
    """A table, or some columns of it.

    Args:
        folder: Of the dataset.
        table: Of `TABLES`.
        columns: Wanted; None: all.
        filters: As of `pyarrow.parquet.read_table`.
    """
    names = None if columns is None else list(columns)
    path = path_of(folder, table)
    with damage_told(path.name):
        found = pq.read_table(path, columns=names, filters=filters)
        frame: pd.DataFrame = found.to_pandas()
    return frame


def distinct(folder: Path, table: str, columns: Sequence[str]) -> list[tuple[str, ...]]:
    """Combinations of values of some columns of text, in order of appearance; memory holds a piece
    of the table."""
    found: dict[tuple[str, ...], None] = {}
    path = path_of(folder, table)
    with opened(path, path.name) as file, damage_told(path.name):
        for piece in file.iter_batches(columns=list(columns)):
            frame = piece.to_pandas().drop_duplicates()
            found |= dict.fromkeys(frame[list(columns)].itertuples(index=False, name=None))
    return list(found)


def check_dataset(folder: Path) -> None:
    """Refuse a folder without the tables, or with others of their names.

    Raises:
        TwinError: It is none of `uavtwin fleet`.
    """
    missing = [path_of(folder, t).name for t in TABLES if not path_of(folder, t).is_file()]
    if missing:
        raise TwinError(
            f"{folder}: {'is no folder' if not folder.is_dir() else 'lacks ' + ', '.join(missing)}"
            f". Give the --out of `uavtwin fleet`; one that was interrupted has its tables when "
            f"the same command has ended."
        )
    for table in TABLES:
        path = path_of(folder, table)
        with opened(path, path.name) as file:
            there, own = file.schema_arrow, schema(table)
        wrong = [
            n for n in own.names if n not in there.names or there.field(n).type != own.field(n).type
        ]
        if wrong:
            raise TwinError(
                f"{path}: columns {', '.join(wrong[:5])} are missing, or of another type than "
                f"`uavtwin fleet` writes. Run it again into another folder."
            )
