"""Write a flight table."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from ...errors import LogError
from ..flight import Flight
from .notes import Notes


def check_suffix(path: Path) -> None:
    """Refuse a name by which no flight table can be written.

    Raises:
        LogError: It ends neither in `.parquet` nor in `.csv`.
    """
    if path.suffix not in (".parquet", ".csv"):
        raise LogError(f"{path.name}: a flight table is written as .parquet or .csv.")


def write_flight(flight: Flight, path: str | Path) -> None:
    """Write the table of a flight; an existing file is replaced.

    Args:
        flight: Flight; its notes go along in Parquet, CSV has no room for them.
        path: File ending in `.parquet` or `.csv`.
    """
    path = Path(path)
    check_suffix(path)
    try:
        if path.suffix == ".parquet":
            arrow = pa.Table.from_pandas(flight.table, preserve_index=False, nthreads=1)
            arrow = arrow.replace_schema_metadata(Notes.of(flight).metadata())
            pq.write_table(arrow, path)
        else:
            flight.table.to_csv(path, index=False, lineterminator="\n")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error}.") from None
