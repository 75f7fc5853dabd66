"""Read a flight table, in memory or as one that stays in its file."""

import io
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as csv
from numpy.typing import NDArray

from ...errors import LogError
from ..attitude import with_quaternion
from ..columns import EULER, in_order, is_known, over
from ..flight import Array, Finding, Flight
from ..formats import ReadOptions
from ..validate import check_columns, validate
from .notes import Notes, read_notes
from .parquet import damage_told, opened
from .stored import ParquetColumns, StoredFlight

_LONGEST_LINE = 1_000_000
_MOST_ROWS = 10_000_000  # an hour at 2.8 kHz
_MOST_COLUMNS = 10_000
_MOST_CELLS = 100_000_000  # 0.8 GB of float64
HELD_CELLS = 10_000_000
"""Larger tables in Parquet stay in their file: 80 MB of float64, eight minutes at 1 kHz."""
_SHOWN = 40
_EMPTY = ["", "nan", "NaN", "NAN"]


def header(path: Path) -> list[str]:
    """Names of the columns of a table in Parquet or CSV; nothing of any other file."""
    with path.open("rb") as file:
        line = file.readline(_LONGEST_LINE)
    if line.startswith(b"PAR1"):
        try:
            with opened(path, path.name) as file:
                return list(file.schema_arrow.names)
        except LogError:
            return []  # it is said why when it is read
    text = line.decode("utf-8-sig", errors="replace").strip()
    return [c.strip().strip('"') for c in text.split(",")] if text.startswith("time") else []


def read_parquet(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a flight table in Parquet; what its writer noted is taken over.

    Args:
        path: File name.
        blob: Content of the file.
        options: None of them concerns a flight table.

    Raises:
        LogError: It contradicts the definition of the flight table.
    """
    raw, notes, found = _parquet(path, blob)
    flight = _checked(path, raw, notes.facts, [*notes.findings, *found])
    return replace(
        flight,
        site=notes.site,
        airframe=notes.airframe,
        autopilot=notes.autopilot,
        settled=notes.settled,
    )


def read_csv(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a flight table in CSV; arguments and errors as in `read_parquet`."""
    findings: list[Finding] = []
    return _checked(path, _csv(path, blob, findings), {}, findings)


def open_parquet(path: Path) -> StoredFlight | None:
    """A flight table in Parquet, left in its file where it is large and holds plain numbers.

    Args:
        path: The file.

    Returns:
        None where it is to be read whole: smaller than `HELD_CELLS`, with Euler angles that have to
        be turned into a quaternion first, or with a column that holds no plain numbers.

    Raises:
        LogError: It contradicts the definition of the flight table.
    """
    with opened(path, path.name) as file:
        schema, size = file.schema_arrow, file.metadata
    held = [n for n in schema.names if is_known(n) and n != "phase"]
    plain = all(_is_plain(schema.field(n).type) for n in held if schema.names.count(n) == 1)
    if size.num_rows * (len(held) + 1) <= HELD_CELLS or not plain or {*held} & {*EULER}:
        return None
    _check_rows(path, size.num_rows, size.num_columns)
    _check_once(path, schema.names)
    findings = check_columns(path.name, schema.names)
    _check_flat(path, schema, [n for n in schema.names if is_known(n)])
    notes = read_notes(schema.metadata)
    stored = ParquetColumns(path, held)
    time_s = stored["time"]
    mended, doubts = validate(path.name, over({"time": time_s}, stored))
    there = [c for c in held if c not in mended and stored.has_sample(c)]
    there += [c for c, values in mended.items() if np.isfinite(values).any()]
    return StoredFlight(
        path.stem,
        stored,
        mended,
        (*notes.findings, *findings, *doubts),
        notes.facts,
        path,
        notes.site,
        notes.airframe,
        time_s,
        frozenset([*there, "phase"]),
        notes.autopilot,
        notes.settled,
    )


def _checked(path: Path, raw: pa.Table, facts: dict[str, str], findings: list[Finding]) -> Flight:
    """The flight of known columns as they are in the file."""
    columns: dict[str, Any] = {}
    phase = _phase(raw)
    for name in [c for c in raw.column_names if c != "phase"]:
        columns[name] = _numbers(path, name, raw.column(name).to_pandas(use_threads=False))
        raw = raw.drop_columns(name)
    quaternion, turned = with_quaternion(path.name, columns)
    columns = {c: v for c, v in columns.items() if c not in EULER} | quaternion
    columns["phase"] = phase
    mended, doubts = validate(path.name, {c: columns[c] for c in in_order(columns)})
    columns |= mended
    columns["phase"] = pd.Series(phase, dtype=object)
    table = pd.DataFrame(columns, copy=False)
    return Flight(path.stem, table, (*findings, *turned, *doubts), facts, path)


def _parquet(path: Path, blob: bytes) -> tuple[pa.Table, Notes, list[Finding]]:
    """Parquet -> known columns as they are, what the writer noted, and what is found of columns."""
    with opened(blob, path.name) as file:
        schema, size = file.schema_arrow, file.metadata
        _check_size(path, size.num_rows, size.num_columns)
        _check_once(path, schema.names)
        held = [n for n in schema.names if is_known(n)]
        found = check_columns(path.name, schema.names)
        _check_flat(path, schema, held)
    # A text that stands in many rows is held once.
    texts = [n for n in held if not _is_number(schema.field(n).type)]
    with opened(blob, path.name, texts, size) as file, damage_told(path.name):
        raw = file.read(columns=held, use_threads=False)
    return raw, read_notes(schema.metadata), found


def _check_size(path: Path, rows: int, columns: int) -> None:
    """Refuse what would not fit in memory, before it is unpacked."""
    _check_rows(path, rows, columns)
    if rows * columns > _MOST_CELLS:
        raise LogError(
            f"{path.name}: {rows} rows of {columns} columns; at most {_MOST_CELLS} cells are held "
            "in memory. Cut the flight, or leave out columns that are not of the flight table; a "
            "table in Parquet, of numbers alone and with q_* for the attitude, is not held in "
            "memory by check, gap and explain."
        )


def _check_rows(path: Path, rows: int, columns: int) -> None:
    """Refuse what no flight is."""
    if rows > _MOST_ROWS or columns > _MOST_COLUMNS:
        raise LogError(
            f"{path.name}: {rows} rows of {columns} columns; at most {_MOST_ROWS} rows and "
            f"{_MOST_COLUMNS} columns are read. Cut the flight, or leave out columns that are not "
            "of the flight table."
        )


def _check_once(path: Path, names: list[str]) -> None:
    """Refuse a name that two columns have."""
    name, times = max(Counter(names).items(), key=lambda c: c[1], default=("", 0))
    if times > 1:
        raise LogError(f"{path.name}: column {name[:_SHOWN]} stands there twice.")


def _is_number(kind: pa.DataType) -> bool:
    """Whether a column of Parquet holds numbers."""
    return bool(
        pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_boolean(kind)
        or pa.types.is_decimal(kind)
    )


def _is_plain(kind: pa.DataType) -> bool:
    """Whether a column of Parquet holds numbers as they are."""
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def _check_flat(path: Path, schema: pa.Schema, names: list[str]) -> None:
    """Refuse lists, times and the like where numbers belong."""
    for name in names:
        kind = schema.field(name).type
        inner = kind.value_type if pa.types.is_dictionary(kind) else kind
        text = pa.types.is_string(inner) or pa.types.is_large_string(inner)
        if not (_is_number(inner) or text or pa.types.is_null(inner)):
            raise LogError(f"{path.name}: column {name} holds {kind}, not numbers.")


def _csv(path: Path, blob: bytes, findings: list[Finding]) -> pa.Table:
    """CSV -> known columns as they are; a last row without line end is dropped and counted."""
    try:
        text = blob.decode("utf-8-sig").lstrip("\r\n")
    except UnicodeDecodeError as error:
        raise LogError(
            f"{path.name}: not UTF-8 text at byte {error.start}; save it as such."
        ) from None
    lines = text.splitlines()
    longest = max(range(len(lines)), key=lambda k: len(lines[k]))
    if len(lines[longest]) > _LONGEST_LINE:
        raise LogError(
            f"{path.name}: line {longest + 1} has {len(lines[longest])} characters; at most "
            f"{_LONGEST_LINE} are read. Is it a table?"
        )
    header = [c.strip().strip('"') for c in lines[0].split(",")]
    if len(header) == 1 and any(s in lines[0] for s in ";\t"):
        raise LogError(f"{path.name}: columns must be separated by commas: '{lines[0][:40]}'.")
    _check_once(path, header)
    _check_size(path, len(lines), len(header))
    if len(lines) > 1 and not text.endswith(("\n", "\r")):
        findings.append(
            Finding("error", "file", "cut short? The last row has no line end and is not used")
        )
        lines = lines[:-1]
    for k, line in enumerate(lines[1:], 1):
        if line.strip() and line.count(",") != len(header) - 1:
            raise LogError(
                f"{path.name}: data row {k} has {line.count(',') + 1} fields, the header has "
                f"{len(header)}."
            )
    body = "\n".join(lines[1:]).encode()
    if not body.strip():
        raise LogError(f"{path.name}: a header and no row below it.")
    try:
        arrow = csv.read_csv(
            io.BytesIO(body),
            csv.ReadOptions(column_names=header, block_size=len(body) + 1, use_threads=False),
            convert_options=csv.ConvertOptions(
                column_types={"phase": pa.string()}, null_values=_EMPTY, strings_can_be_null=True
            ),
        )
    except pa.ArrowException as error:
        raise LogError(f"{path.name}: not readable as CSV: {error}.") from None
    findings += check_columns(path.name, header)
    return arrow.select([c for c in header if is_known(c)])


def _numbers(path: Path, name: str, column: "pd.Series[Any]") -> Array:
    """A column as float64; anything else is an error with its row."""
    if pd.api.types.is_numeric_dtype(column.dtype) or column.isna().all():
        return np.array(column.to_numpy(dtype=np.float64, na_value=np.nan))
    if isinstance(column.dtype, pd.CategoricalDtype):  # one text each, however many rows have it
        each = pd.to_numeric(column.cat.categories.to_series(), errors="coerce")
        values = np.append(each.to_numpy(np.float64), np.nan)[column.cat.codes]
        numbers = pd.Series(values, index=column.index)
    else:
        numbers = pd.to_numeric(column, errors="coerce").astype(np.float64)
    text = np.flatnonzero(np.isnan(numbers.to_numpy()) & column.notna().to_numpy())
    if len(text) or not pd.api.types.is_string_dtype(column.dtype):
        k = int(text[0]) if len(text) else 0
        shown = str(column.iloc[k])[:_SHOWN]
        raise LogError(
            f"{path.name}: {name} in data row {k + 1} is '{shown}', not a number "
            f"({max(len(text), 1)} such values). Leave a cell empty where there is no sample."
        )
    return np.array(numbers.to_numpy())


def _phase(raw: pa.Table) -> NDArray[np.object_]:
    """Phase as text, "" where there is none, shape (n,)."""
    if "phase" not in raw.column_names:
        return np.full(raw.num_rows, "", dtype=object)
    column = raw.column("phase").to_pandas(use_threads=False)
    code, kinds = pd.factorize(column)  # missing: code -1, the last
    texts = np.array([*map(str, kinds), ""], dtype=object)
    return np.asarray(texts[code], dtype=object)
