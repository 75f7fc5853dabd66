"""The dataset of a fleet: columns of its tables, rows of one job, journal, Parquet files."""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from twin.errors import TwinError
from twin.logs.stored import as_log_error, opened

from ..jobs import journal
from ..output import output_file

Row = dict[str, Any]
"""One row of a table, by column."""
MOTORS = 12
"""Largest number of motors of an aircraft that is read."""
Kind = Literal["text", "count", "number", "flag"]
_TYPES: Mapping[Kind, pa.DataType] = {
    "text": pa.string(),
    "count": pa.int64(),
    "number": pa.float64(),
    "flag": pa.bool_(),
}
"""Parquet type of each kind of column."""


@dataclass(frozen=True, slots=True)
class Column:
    """Column of a table.

    Attributes:
        name: Name in the table.
        kind: Kind of its values; each may be missing.
        unit: Printed unit, "" without one.
        meaning: Meaning in one line.
    """

    name: str
    kind: Kind
    unit: str
    meaning: str


def _text(name: str, meaning: str) -> Column:
    return Column(name, "text", "", meaning)


def _count(name: str, meaning: str) -> Column:
    return Column(name, "count", "1", meaning)


_LOG = _text("log", "path of the log, from the folder that all logs have in common")  # a column
_AIRCRAFT = _text("aircraft", "as the log names it; empty where it does not")
"""Columns that every table has."""

VITALS = (
    Column("hover_command", "number", "1", "mean command of the motors in hover"),
    Column("hover_speed_rad_s", "number", "rad/s", "mean speed of the rotors in hover"),
    Column("hover_voltage_v", "number", "V", "battery voltage in hover"),
    Column(
        "battery_resistance_ohm",
        "number",
        "ohm",
        "by how much the voltage falls with the current within the flight, its slow fall left out",
    ),
    Column(
        "carried",
        "number",
        "1",
        "thrust of the twin in hover over what the flight shows: below 1 where the aircraft is "
        "lighter or stronger than its twin",
    ),
    Column("back_m", "number", "m", "centre of mass further back than the twin's, from the hover"),
    Column("right_m", "number", "m", "centre of mass further to the right, from the hover"),
    *(
        Column(
            f"gyro_bias_{a}_rad_s",
            "number",
            "rad/s",
            f"gyroscope about {axis} minus how fast the attitude turns, median over the flight",
        )
        for a, axis in zip("xyz", ("roll", "pitch", "yaw"), strict=True)
    ),
    *(
        Column(
            f"motor_{i}",
            "number",
            "1",
            f"command (or speed) of motor {i} in hover over the mean of all, minus 1",
        )
        for i in range(1, MOTORS + 1)
    ),
)
"""Numbers of a flight on the state of the aircraft, from `check` and `gap` only."""

NO_LOG = "no log"
"""Status of a file with the extension of logs that is no log, such as a list in CSV."""

TABLES: Mapping[str, Sequence[Column]] = {
    "flights": (
        _LOG,
        Column("bytes", "count", "byte", "size of the log"),
        _text(
            "status",
            "fine; findings: something is damaged in it; refused: read, and of no use for a verb; "
            "unreadable; no log: a file of something else; copy: the flight of an earlier log; "
            "failed: its process ended",
        ),
        _text("error", "why it is unreadable, no log, refused, a copy or failed"),
        _text("format", "of the log"),
        _AIRCRAFT,
        _text("airframe", "kind of airframe as the log names it"),
        _text("hardware", "autopilot as the log names it"),
        _text("vehicle", "name of the vehicle file it was compared with"),
        Column("date_year", "number", "year", "date by the satellites, as a decimal year"),
        Column("duration_s", "number", "s", "of the flight table"),
        _count("rows", "rows of the flight table"),
        _text("fingerprint", "hash of all numbers of the flight"),
        _count("problems", "findings that are errors"),
        _count("warnings", "findings that are warnings"),
        _text("why", "verdict of why: found, nothing_found, cannot_tell"),
        _text("causes", "causes that why names, consequences left out"),
        _text("verdict", "of explain: named, nothing, unnamed, cannot_tell, unusable"),
        Column("nothing_probability", "number", "1", "that no effect is missing"),
        _text("named", "effects that explain lists, the most probable first"),
        *VITALS,
    ),
    "channels": (
        _LOG,
        _AIRCRAFT,
        _text("channel", "quantity"),
        _text("phase", "phase of flight; `whole flight`: every phase"),
        _text("unit", "of rms and mean"),
        Column(
            "horizon_s", "number", "s", "since the twin was set to the measured state; 0: at it"
        ),
        _count("n", "samples"),
        Column("rms", "number", "unit", "of measured minus simulated"),
        Column("rms_low", "number", "unit", "lower end of its 95 % interval"),
        Column("rms_high", "number", "unit", "upper end"),
        Column("mean", "number", "unit", "of measured minus simulated"),
        Column("share", "number", "1", "rms over that of the signal about its mean"),
        Column("slow_rms", "number", "unit", "rms of the slow part"),
    ),
    "effects": (
        _text("log", "of which flight; empty where all flights of an aircraft were explained"),
        _AIRCRAFT,
        _text("verdict", "of the explanation; one that lists no effect has one row without any"),
        _text("effect", "name"),
        Column("probability", "number", "1", "that it is missing in the vehicle file"),
        _text("number", "of the effect"),
        Column("value", "number", "unit", "estimate"),
        Column("sd", "number", "unit", "standard deviation; missing where there is none"),
        Column("low", "number", "unit", "lower end of the 95 % interval"),
        Column("high", "number", "unit", "upper end"),
        _text("unit", "of value, sd, low and high"),
        Column("prior_share", "number", "1", "posterior over prior deviation: 1 tells nothing"),
    ),
    "findings": (
        _LOG,
        _AIRCRAFT,
        _text("verb", "that found it: check, gap, explain"),
        _text("severity", "problem, warning or note"),
        _text("text", "what"),
    ),
}
"""Tables of the dataset."""


def schema(table: str) -> pa.Schema:
    """Schema of a table in Parquet, with units in the metadata of its columns."""
    return pa.schema(
        [
            pa.field(
                c.name,
                _TYPES[c.kind],
                metadata={"unit": c.unit, "meaning": c.meaning},
            )
            for c in TABLES[table]
        ]
    )


def row(table: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """A row with all columns of a table, None for missing values.

    Raises:
        KeyError: A value has no column.
    """
    names = [c.name for c in TABLES[table]]
    for name in values:
        if name not in names:
            raise KeyError(f"{table} has no column {name}")
    return {name: values.get(name) for name in names}


@dataclass
class JobRows:
    """Results of a job, as rows of the tables.

    Attributes:
        job: Number of the job.
        rows: Rows by table.
    """

    job: int
    rows: dict[str, list[Row]] = field(default_factory=dict)

    def add(self, table: str, **values: Any) -> Row:
        """Add a row, which may still be changed."""
        made = row(table, values)
        self.rows.setdefault(table, []).append(made)
        return made

    def json(self) -> dict[str, Any]:
        """Content of a journal line; missing numbers are omitted."""
        tables = {
            table: [{k: v for k, raw in r.items() if (v := _strict(raw)) is not None} for r in rows]
            for table, rows in self.rows.items()
        }
        return {"job": self.job, **tables}

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> "JobRows":
        """Rows from the result of `json`."""
        return cls(content["job"], {k: v for k, v in content.items() if k != "job"})


def _strict(value: Any) -> Any:
    """Null for a number that JSON cannot represent, plain types for those of numpy."""
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


JOURNAL = "fleet.jsonl"
"""File that marks an unfinished fleet."""
PIECE = 500
"""Number of logs whose rows are in memory at once."""
COPY = "holds the same flight as {}, which counts once"
"""Error of a log with the same flight as another one."""


class Journal(journal.Journal[int]):
    """Results of logs and aircraft, by job number."""

    kind = "fleet"
    differs = "other vehicles, verbs or version"

    def named(self, content: journal.Content) -> int:
        """Number of the job."""
        if not (isinstance(content["job"], int) and content.keys() <= {"job", *TABLES}):
            raise ValueError
        return int(content["job"])

    def add(self, found: JobRows) -> None:
        """Append the result of a job."""
        self.write(found.json())

    def places(self) -> dict[int, int]:
        """Offset of each job's line."""
        return {int(content["job"]): place for place, content in self.contents()}

    def lines(self, jobs: Iterable[int], places: Mapping[int, int]) -> Iterator[dict[str, Any]]:
        """Lines of jobs, in order, with duplicate flights marked.

        Args:
            jobs: Numbers of the jobs; all must be done.
            places: Offsets of their lines.
        """
        first: dict[bytes, str] = {}
        with self._path.open("rb") as file:
            for job in jobs:
                file.seek(places[job])
                yield _once(json.loads(file.readline()), first)


def _once(content: dict[str, Any], first: dict[bytes, str]) -> dict[str, Any]:
    """A line without the rows of a duplicate flight."""
    about = (content.get("flights") or [{}])[0]
    print_ = about.get("fingerprint")
    if print_ is None:
        return content
    log = first.setdefault(bytes.fromhex(print_)[:12], about["log"])
    if log == about["log"]:
        return content
    identity = {k: about[k] for k in ("log", "bytes", "format", "aircraft", "fingerprint")}
    return {"flights": [identity | {"status": "copy", "error": COPY.format(log)}]}


def write_dataset(lines: Iterable[Mapping[str, Any]], out: Path) -> None:
    """Write all tables, each atomically.

    Args:
        lines: Lines of the journal, in the order of the rows.
        out: Output folder.
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
    """Path of a table."""
    return folder / f"{table}.parquet"


def read_table(
    folder: Path, table: str, columns: Sequence[str] | None = None, filters: Any = None
) -> pd.DataFrame:
    """A table, or some of its columns.

    Args:
        folder: Folder of the dataset.
        table: Name in `TABLES`.
        columns: Names of the columns; None: all.
        filters: Filters of `pyarrow.parquet.read_table`.
    """
    names = None if columns is None else list(columns)
    path = path_of(folder, table)
    with as_log_error(path.name):
        found = pq.read_table(path, columns=names, filters=filters)
        frame: pd.DataFrame = found.to_pandas()
    return frame


def distinct(folder: Path, table: str, columns: Sequence[str]) -> list[tuple[str, ...]]:
    """Distinct combinations of values of text columns, in order of appearance; reads the table in
    pieces."""
    found: dict[tuple[str, ...], None] = {}
    path = path_of(folder, table)
    with opened(path, path.name) as file, as_log_error(path.name):
        for piece in file.iter_batches(columns=list(columns)):
            frame = piece.to_pandas().drop_duplicates()
            found |= dict.fromkeys(frame[list(columns)].itertuples(index=False, name=None))
    return list(found)


def check_dataset(folder: Path) -> None:
    """Refuse a folder without the tables, or with other files of their names.

    Raises:
        TwinError: It is no folder of `uavtwin fleet`.
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
