"""The flight table as a file: Parquet, or CSV with the same header; a stream during recording.

`twin.logs.columns.COLUMNS` defines the table; `validate.validate` checks it.
"""

import io
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ..errors import LogError
from .attitude import with_quaternion
from .autopilot import check_autopilot
from .columns import ALIASES, COLUMNS, EULER, MAX_MOTORS, in_order, is_known, motor_columns, over
from .flight import Array, Finding, Flight, Notes
from .formats import ReadOptions
from .rotor_lag import as_stamped
from .stamps import EARLIER
from .stored import ParquetColumns, StoredFlight, as_log_error, opened
from .validate import check_columns, validate

# -- metadata -----------------------------------------------------------------------------------
#
# Metadata of a flight table in Parquet, as JSON.

_KEY = b"uavtwin"  # key in the metadata
_MOST_ROTORS = 64  # rotors of a layout; more are damage
_LONGEST_FILTER_S = 0.25  # delay of a low-pass; readers correct for those from 1 Hz: 0.225 s


def noted(notes: Notes) -> dict[bytes, bytes]:
    """Notes as metadata of a Parquet file."""
    return {_KEY: msgspec.json.encode(notes.notes, enc_hook=_listed)}


def read_notes(metadata: Mapping[bytes, bytes] | None) -> Notes:
    """The notes in the metadata of a Parquet file, all of them or none.

    Returns:
        No notes for a file without any; a finding for a file whose notes cannot be read.
    """
    content = (metadata or {}).get(_KEY)
    if content is None:
        return Notes()
    try:
        found = msgspec.json.decode(content, type=Notes, dec_hook=_array)
        _check(found)
    except (ValueError, TypeError, RecursionError) as error:
        reason = f" ({error})" if isinstance(error, msgspec.ValidationError) else ""
        text = f"what the writer noted cannot be read{reason}"
        return Notes(findings=(Finding("warning", "file", text),))
    early = [f.where for f in found.findings if EARLIER in f.message]
    if lost := [w for w in early if w not in found.filter_delays_s]:
        text = (
            f"written by a version that did not note by how much {' and '.join(lost)} were set "
            "earlier: predictions count the delay of their low-pass twice. Convert the log again"
        )
        doubt = Finding("warning", "file", text)
        return replace(found, findings=(*(f for f in found.findings if f != doubt), doubt))
    return found


def _check(notes: Notes) -> None:
    """Refuse notes with valid types but invalid values.

    Raises:
        ValueError: A value is invalid.
    """
    if notes.autopilot is not None:
        check_autopilot(notes.autopilot)
    settled = notes.settled
    if settled is not None and not all(0.0 < r < 1e6 for r in settled.rates_hz.values()):
        raise ValueError("a rate that is none")
    layout = None if notes.airframe is None else notes.airframe.layout
    if not 0.0 <= notes.speeds_late_s < np.inf:
        raise ValueError("a delay that is none")
    if not {*notes.filter_delays_s} <= {"acc", "gyro"}:
        raise ValueError("a filter of a signal that has none")
    if not all(0.0 <= d < _LONGEST_FILTER_S for d in notes.filter_delays_s.values()):
        raise ValueError("a filter with a delay that is none")
    if any(f.count < 1 for f in notes.findings):
        raise ValueError("a finding is counted less than once")
    if layout is not None:
        if layout.direction.ndim != 1 or not 0 < layout.count <= _MOST_ROTORS:
            raise ValueError("a layout without rotors, or with too many")
        if layout.position.shape != (layout.count, 3):
            raise ValueError("a layout whose rotors have not three coordinates each")
        if not (np.abs(layout.direction) == 1).all() or not layout.arm > 0:
            raise ValueError("a layout whose rotors do not turn, or lie in one place")


def _listed(value: Any) -> Any:
    """Conversion of types that JSON does not have."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be noted")


def _array(kind: type, value: Any) -> Any:
    """An array of numbers."""
    return np.asarray(value, dtype=np.float64)


# -- writing ------------------------------------------------------------------------------------


def check_suffix(path: Path) -> None:
    """Refuse a file name with an extension in which no flight table can be written.

    Raises:
        LogError: The extension is neither `.parquet` nor `.csv`.
    """
    if path.suffix not in (".parquet", ".csv"):
        raise LogError(f"{path.name}: a flight table is written as .parquet or .csv.")


def write_flight(flight: Flight, path: str | Path) -> None:
    """Write the table of a flight; an existing file is replaced.

    Args:
        flight: Flight to write. Parquet stores its notes, CSV cannot, so what was corrected returns
            to its original time stamps there (`as_stamped`); late rotor speeds are corrected again
            on reading.
        path: File ending in `.parquet` or `.csv`.
    """
    path = Path(path)
    check_suffix(path)
    try:
        if path.suffix == ".parquet":
            arrow = pa.Table.from_pandas(flight.table, preserve_index=False, nthreads=1)
            arrow = arrow.replace_schema_metadata(noted(flight))
            pq.write_table(arrow, path)
        else:
            as_stamped(flight).table.to_csv(path, index=False, lineterminator="\n")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error}.") from None


# -- reading ------------------------------------------------------------------------------------

_LONGEST_LINE = 1_000_000  # characters; longer ones are no table
_MOST_ROWS = 10_000_000  # an hour at 2.8 kHz
_MOST_COLUMNS = 10_000  # that are read
_MOST_CELLS = 100_000_000  # 0.8 GB of float64
HELD_CELLS = 10_000_000
"""Larger tables in Parquet stay in their file: 80 MB of float64, eight minutes at 1 kHz."""
_SHOWN = 40  # characters of a name in an error
_EMPTY = ["", "nan", "NaN", "NAN"]  # cells without a sample


def header(path: Path) -> list[str]:
    """Names of the columns of a table in Parquet or CSV; none for any other file."""
    with path.open("rb") as file:
        line = file.readline(_LONGEST_LINE)
    if line.startswith(b"PAR1"):
        try:
            with opened(path, path.name) as file:
                return list(file.schema_arrow.names)
        except LogError:
            return []  # the reader raises the error
    text = line.decode("utf-8-sig", errors="replace").strip()
    return [c.strip().strip('"') for c in text.split(",")] if text.startswith("time") else []


def read_parquet(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a flight table in Parquet with its notes; arguments and errors as in
    `formats.Reader`."""
    raw, notes, found = _parquet(path, blob)
    return _checked(path, raw, notes, [*notes.findings, *found])


def read_csv(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a flight table in CSV; arguments and errors as in `formats.Reader`."""
    findings: list[Finding] = []
    return _checked(path, _csv(path, blob, findings), Notes(), findings)


def open_parquet(path: Path) -> StoredFlight | None:
    """A flight table in Parquet that stays in its file if large and of plain numbers.

    Args:
        path: Path of the file.

    Returns:
        None where it must be read whole: smaller than `HELD_CELLS`, with Euler angles to be
        converted to a quaternion, with a column of another name, or one without plain numbers.

    Raises:
        LogError: It contradicts the definition of the flight table.
    """
    with opened(path, path.name) as file:
        schema, size = file.schema_arrow, file.metadata
    if {*schema.names} & {*ALIASES}:
        return None
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
    known = frozenset([*there, "phase"])
    of_log = notes.notes | {"findings": (*notes.findings, *findings, *doubts)}
    return StoredFlight(path.stem, stored, mended, path, time_s, known, **of_log)


def _checked(path: Path, raw: pa.Table, notes: Notes, findings: list[Finding]) -> Flight:
    """The flight of the known columns as they are in the file, checked."""
    columns: dict[str, Any] = {}
    phase = _phase(raw)
    for name in [c for c in raw.column_names if c != "phase"]:
        columns[name] = _numbers(path, name, raw.column(name).to_pandas(use_threads=False))
        raw = raw.drop_columns(name)
    attitude = with_quaternion(path.name, columns)
    columns = {c: v for c, v in columns.items() if c not in EULER} | attitude.columns
    columns["phase"] = phase
    mended, doubts = validate(path.name, {c: columns[c] for c in in_order(columns)})
    columns |= mended
    columns["phase"] = pd.Series(phase, dtype=object)
    table = pd.DataFrame(columns, copy=False)
    of_log = notes.notes | {"findings": (*findings, *attitude.findings, *doubts)}
    if attitude.derived:
        of_log["derived_angles"] = attitude.derived
    return Flight(path.stem, table, path, **of_log)


def _parquet(path: Path, blob: bytes) -> tuple[pa.Table, Notes, list[Finding]]:
    """Known columns of a Parquet file as they are, its notes, and findings on columns."""
    with opened(blob, path.name) as file:
        schema, size = file.schema_arrow, file.metadata
        _check_size(path, size.num_rows, size.num_columns)
        names = [ALIASES.get(n, n) for n in schema.names]
        _check_once(path, names)
        held = [n for n, own in zip(schema.names, names, strict=True) if is_known(own)]
        found = [*_renamed(schema.names), *check_columns(path.name, names)]
        _check_flat(path, schema, held)
    # A text that is repeated in many rows is held in memory once.
    texts = [n for n in held if not _is_number(schema.field(n).type)]
    with opened(blob, path.name, texts, size) as file, as_log_error(path.name):
        raw = file.read(columns=held, use_threads=False)
    raw = raw.rename_columns([ALIASES.get(n, n) for n in held])
    return raw, read_notes(schema.metadata), found


def _renamed(names: list[str]) -> list[Finding]:
    """Findings on columns with an alternative name."""
    found = [n for n in names if n in ALIASES]
    text = f"read from {', '.join(found)}: of the motion, north-east-down, no gravity in it"
    return [Finding("info", ALIASES[found[0]][:-2], text)] if found else []


def _check_size(path: Path, rows: int, columns: int) -> None:
    """Refuse a table that would not fit in memory, before it is unpacked."""
    _check_rows(path, rows, columns)
    if rows * columns > _MOST_CELLS:
        raise LogError(
            f"{path.name}: {rows} rows of {columns} columns; at most {_MOST_CELLS} cells are held "
            "in memory. Cut the flight, or leave out columns that are not of the flight table; a "
            "table in Parquet, of numbers alone and with q_* for the attitude, is not held in "
            "memory by check, gap and explain."
        )


def _check_rows(path: Path, rows: int, columns: int) -> None:
    """Refuse a table with too few or too many rows for a flight."""
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
    """Known columns of a CSV file as they are; a last row without line end is dropped and
    counted."""
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
    given = [c.strip().strip('"') for c in lines[0].split(",")]
    findings += _renamed(given)
    header = [ALIASES.get(c, c) for c in given]
    if len(header) == 1 and any(s in lines[0] for s in ";\t"):
        raise LogError(f"{path.name}: columns must be separated by commas: '{lines[0][:40]}'.")
    _check_once(path, header)
    _check_size(path, len(lines), len(header))
    if len(lines) > 1 and not text.endswith(("\n", "\r")):
        findings.append(
            Finding("error", "file", "cut short? The last row has no line end and is not used")
        )
        lines = lines[:-1]
    body = "\n".join(lines[1:]).encode()
    if not body.strip():
        raise LogError(f"{path.name}: a header and no row below it.")
    findings += check_columns(path.name, header)
    for k, line in enumerate(lines[1:], 1):
        if line.strip() and line.count(",") != len(header) - 1:
            raise LogError(
                f"{path.name}: data row {k} has {line.count(',') + 1} fields, the header has "
                f"{len(header)}."
            )
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
    return arrow.select([c for c in header if is_known(c)])


def _numbers(path: Path, name: str, column: "pd.Series[Any]") -> Array:
    """A column as float64; anything else is an error with its row."""
    if pd.api.types.is_numeric_dtype(column.dtype) or column.isna().all():
        return np.array(column.to_numpy(dtype=np.float64, na_value=np.nan))
    if isinstance(column.dtype, pd.CategoricalDtype):  # each distinct text once
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


# -- a table that grows -------------------------------------------------------------------------
#
# Tables that are written during recording, as an Arrow stream: each second a batch of rows.
#
# Cut off at any byte, such a file is complete up to the last batch before it. At its end it is
# converted to Parquet, batch by batch.

_GROUP_ROWS = 1 << 16  # rows of a row group
_UNUSED = ("roll_rad", "pitch_rad", "yaw_rad", "acc_ned_x", "acc_ned_y", "acc_ned_z")
"""Columns that no live flight has."""
_END = b"\xff\xff\xff\xff\x00\x00\x00\x00"
"""End marker of a complete stream."""
CUT = "cut off while it was written; what came in the last second before that is missing"  # finding


def flight_schema(motors: int) -> pa.Schema:
    """Columns of a flight table during recording, of which any may stay empty.

    Args:
        motors: Number of motors, up to `MAX_MOTORS`.
    """
    names = [c.name for c in COLUMNS if not c.per_motor and c.name not in _UNUSED]
    for stem in ("cmd", "rotor"):
        names += motor_columns(stem, min(motors, MAX_MOTORS))
    kinds = {"phase": pa.string()}
    return pa.schema([(name, kinds.get(name, pa.float64())) for name in in_order(names)])


class TableStream:
    """A file to which a table is written during recording."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        """Begin a file.

        Raises:
            LogError: It cannot be written.
        """
        self.path, self.schema = path, schema
        try:
            self._file: BinaryIO = path.open("xb")
        except OSError as error:
            raise LogError(f"{path}: cannot be written: {error.strerror}.") from None
        self._writer = pa.ipc.new_stream(self._file, schema)
        self._file.flush()

    def append(
        self, columns: Mapping[str, Any], metadata: Mapping[bytes, bytes] | None = None
    ) -> None:
        """Write rows immediately, so that they survive if the process is killed.

        Args:
            columns: Columns by name, shape (n,) each; a missing one is empty.
            metadata: Metadata of the table at this time.
        """
        n = len(next(iter(columns.values())))
        arrays = [
            pa.array(columns[f.name], type=f.type, from_pandas=True)
            if f.name in columns
            else pa.nulls(n, f.type)
            for f in self.schema
        ]
        batch = pa.RecordBatch.from_arrays(arrays, schema=self.schema)
        self._writer.write_batch(batch, custom_metadata=dict(metadata or {}))
        self._file.flush()

    def close(self) -> None:
        """End the file."""
        self._writer.close()
        self._file.close()


def batches(source: BinaryIO) -> Iterator[tuple[pa.RecordBatch, dict[bytes, bytes]] | None]:
    """Complete batches with their metadata; None at the end where the stream was cut off."""
    try:
        reader = pa.ipc.open_stream(source)
        while True:
            batch, metadata = reader.read_next_batch_with_custom_metadata()
            batch.validate()
            yield batch, dict(metadata or {})
    except StopIteration:
        return
    except (pa.ArrowException, OSError, ValueError, TypeError):
        yield None


def fold(stream: Path, parquet: Path) -> int:
    """Convert a stream to Parquet and delete it; empty columns are omitted.

    Args:
        stream: File written by `TableStream`.
        parquet: Path of the Parquet file, which replaces the stream once it is complete.

    Returns:
        Number of rows; with 0, no file is written.
    """
    filled: set[str] = set()
    metadata: dict[bytes, bytes] = {}
    rows = 0
    for batch, about in _whole(stream):
        filled |= {n for n in batch.schema.names if batch.column(n).null_count < batch.num_rows}
        metadata |= about
        rows += batch.num_rows
    if rows:
        partial = parquet.with_suffix(".partial")
        names = None
        writer, group, held = None, [], 0
        for batch, _ in _whole(stream):
            names = names or [n for n in batch.schema.names if n in filled]
            group.append(batch.select(names))
            held += batch.num_rows
            if writer is None:
                writer = pq.ParquetWriter(partial, group[0].schema.with_metadata(metadata))
            if held >= _GROUP_ROWS:
                writer.write_table(pa.Table.from_batches(group).replace_schema_metadata(metadata))
                group, held = [], 0
        assert writer is not None
        if group:
            writer.write_table(pa.Table.from_batches(group).replace_schema_metadata(metadata))
        writer.close()
        partial.replace(parquet)
    stream.unlink()
    return rows


def _whole(stream: Path) -> Iterator[tuple[pa.RecordBatch, dict[bytes, bytes]]]:
    with stream.open("rb") as file:
        yield from (found for found in batches(file) if found is not None)


def read_stream(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read an incomplete flight table; arguments and errors as in `formats.Reader`."""
    found: list[pa.RecordBatch] = []
    metadata: dict[bytes, bytes] = {}
    for each in batches(io.BytesIO(blob)):
        if each is None:
            break
        found.append(each[0])
        metadata |= each[1]
    if not found:
        raise LogError(f"{path.name}: no whole batch of rows in {len(blob)} bytes.")
    try:
        table = pa.Table.from_batches(found)
        empty = [n for n in table.column_names if table.column(n).null_count == table.num_rows]
        content = io.BytesIO()
        table = table.drop_columns(empty).replace_schema_metadata(metadata)
        pq.write_table(table, content)
    except (pa.ArrowException, ValueError, TypeError, KeyError) as error:
        raise LogError(f"{path.name}: damaged Arrow stream ({error}). Copy it again.") from None
    flight = read_parquet(path, content.getvalue(), options)
    findings = () if blob.endswith(_END) else (Finding("warning", "file", CUT),)
    return replace(flight, findings=(*flight.findings, *findings))
