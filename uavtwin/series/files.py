"""Series as files of a folder of results."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from .mcap_file import check_mcap
from .series_mcap import write_series_mcap
from .table import NS, Series

Form = Literal["parquet", "csv", "mcap"]
FOLDER = "series"
"""Of the files, in the folder of a result."""
METADATA = b"uavtwin"
"""Key of what Parquet keeps of a series: its name and facts, as JSON."""
_LONGEST_NAME = 100


def chosen_forms(csv: bool, mcap: bool) -> tuple[Form, ...]:
    """Forms that were asked for; Parquet where none was.

    Raises:
        TwinError: MCAP was, and cannot be written here.
    """
    if mcap:
        check_mcap()
    asked: list[tuple[Form, bool]] = [("csv", csv), ("mcap", mcap)]
    return tuple(form for form, wanted in asked if wanted) or ("parquet",)


def write_all_series(every: Iterable[Series], folder: Path, forms: Sequence[Form]) -> list[str]:
    """Write a file per series and form, named for the flight; where there is none, nothing.

    Args:
        every: One of each flight.
        folder: Of the results.
        forms: Of `chosen_forms`.

    Returns:
        Names of the files as seen from the folder.
    """
    written: list[str] = []
    for series in every:
        stem = _file_stem(series.name, {Path(w).stem for w in written})
        for form in forms:
            path = folder / FOLDER / f"{stem}.{form}"
            path.parent.mkdir(exist_ok=True)
            write_series(series, path)
            written.append(f"{FOLDER}/{path.name}")
    return written


def write_series(series: Series, path: Path) -> None:
    """Write one series; its form is the ending of the name.

    Args:
        series: To write; rows in blocks, so that a long one needs no more memory.
        path: Ends in `.parquet`, `.csv` or `.mcap`; an existing one is replaced.

    Raises:
        TwinError: MCAP cannot be written here, or not of negative times.
    """
    {".parquet": _write_parquet, ".csv": _write_csv, ".mcap": write_series_mcap}[path.suffix](
        series, path
    )


def write_frame(table: pd.DataFrame, units: Mapping[str, str], path: Path) -> None:
    """Write a table as Parquet, `attrs` kept, with the unit of a column in its metadata.

    Args:
        table: Its index is left out.
        units: By column, "" where there is none.
        path: An existing one is replaced.
    """
    arrow = pa.Table.from_pandas(table, preserve_index=False, nthreads=1)
    told = {"time": "s"} | {k: v for k, v in units.items() if v}
    fields = [
        f.with_metadata({"unit": told[f.name]} if f.name in told else {}) for f in arrow.schema
    ]
    pq.write_table(arrow.cast(pa.schema(fields, metadata=arrow.schema.metadata)), path)


def _write_parquet(series: Series, path: Path) -> None:
    """Floats of 64 bits, a row group per block; `unit` and `about` in the metadata of a column."""
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    for c in series.columns:
        told = {"unit": c.unit, "about": c.about}
        fields.append(pa.field(c.name, pa.float64(), metadata={k: v for k, v in told.items() if v}))
    about = json.dumps({"name": series.name, **series.facts})
    schema = pa.schema(fields, metadata={METADATA: about.encode()})
    with pq.ParquetWriter(path, schema) as file:
        for t_ns, values in series.blocks():
            arrays = [pa.array(v) for v in (t_ns / NS, *values)]
            file.write_batch(pa.record_batch(arrays, schema=schema))


def _write_csv(series: Series, path: Path) -> None:
    """Every bit (shortest repr), an empty field where there is no sample."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(["time", *series.names]) + "\n")
        for t_ns, values in series.blocks():
            table = pd.DataFrame(dict(enumerate([t_ns / NS, *values])), copy=False)
            table.to_csv(file, index=False, header=False, lineterminator="\n")


def _file_stem(name: str, taken: set[str]) -> str:
    """The name of a flight as one of a file, none of those taken."""
    plain = re.sub(r"[^\w.-]", "_", name, flags=re.ASCII).lstrip(".")[:_LONGEST_NAME] or "flight"
    found, k = plain, 1
    while found in taken:
        k += 1
        found = f"{plain}_{k}"
    return found
