"""Tables that are written while they grow, as an Arrow stream: each second a batch of rows.

Cut off at any byte, such a file is whole up to the last batch before it. At its end it is folded
into Parquet, batch by batch.
"""

import io
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from ...errors import LogError
from ..columns import COLUMNS, MAX_MOTORS, in_order, motor_columns
from ..flight import Finding, Flight
from ..formats import ReadOptions
from .read import read_parquet

_GROUP_ROWS = 1 << 16
_UNUSED = ("roll_rad", "pitch_rad", "yaw_rad", "acc_ned_x", "acc_ned_y", "acc_ned_z")
_END = b"\xff\xff\xff\xff\x00\x00\x00\x00"
"""Of a stream that was ended."""
CUT = "cut off while it was written; what came in the last second before that is missing"


def flight_schema(motors: int) -> pa.Schema:
    """Columns of a flight table that grows, of which any may stay empty.

    Args:
        motors: How many, up to `MAX_MOTORS`.
    """
    names = [c.name for c in COLUMNS if not c.per_motor and c.name not in _UNUSED]
    for stem in ("cmd", "rotor"):
        names += motor_columns(stem, min(motors, MAX_MOTORS))
    kinds = {"phase": pa.string()}
    return pa.schema([(name, kinds.get(name, pa.float64())) for name in in_order(names)])


class TableStream:
    """A table that grows in a file."""

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
        """Write rows at once, those that are killed afterwards leave them.

        Args:
            columns: By name, shape (n,) each; what is not there is empty.
            metadata: Of the table, as it is known now.
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
    """Whole batches with their metadata; None at the end, where the stream was cut off."""
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
    """Write a stream as Parquet and take it away; empty columns are left out.

    Args:
        stream: Written by `TableStream`.
        parquet: Takes its place when it is whole.

    Returns:
        How many rows it has; without any, no file is written.
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
    """Read a flight table that was being written; arguments and errors as in `read_parquet`."""
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
