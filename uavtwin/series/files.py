"""Series of a result: columns over time of one flight, with their names and meanings.

A column is SIDE.CHANNEL: `measured.acc_x`, `twin.acc_x`, `residual.acc_x`. Columns may have
different sample times; the table has a row for every time of any of them, NaN where a column has no
sample there. Times are equal if they are equal in nanoseconds.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from twin.logs.airframe import Place
from twin.logs.columns import POS
from twin.representation import ShortRepr

from .mcap import (
    LOCATION,
    NS,
    LocationTopics,
    PlotTopics,
    PoseTopics,
    check_mcap,
    check_times,
    mcap_file,
    nanoseconds,
)

Array = NDArray[np.float64]
BLOCK_ROWS = 1 << 16
"""Rows that are assembled at a time."""
# Sides: sources of a quantity.
MEASURED, TWIN, EXPLAINED, CORRECTED = "measured", "twin", "explained", "corrected"
SPREAD, MODEL = "spread", "model"  # sides of a live flight and of a draw
SIDES: Mapping[str, tuple[str, str]] = {
    MEASURED: ("gap, explain, evaluate", "of the flight, filtered as the twin's"),
    TWIN: ("gap, explain, evaluate", "of the vehicle that was given, on the flight's commands"),
    EXPLAINED: ("explain, evaluate", "of the vehicle with the named effects"),
    CORRECTED: ("evaluate", "of the twin with the compensator, or with the learned force"),
    "residual": ("gap, explain, evaluate", "`measured` minus `twin`"),
    "residual_SIDE": (
        "explain, evaluate",
        "`measured` minus that side: `residual_explained.acc_x`",
    ),
    SPREAD: ("evaluate", "standard deviation that the compensator expects of `residual_corrected`"),
    MODEL: ("evaluate", "`anomaly`: above 1 rarely; `inside` the envelope of the training: 0 or 1"),
}
"""Part of a column's name before the point: verbs that write it, and its meaning."""


@dataclass(frozen=True, slots=True)
class Column(ShortRepr):
    """One quantity over time.

    Attributes:
        name: Name SIDE.CHANNEL.
        unit: SI unit, as printed; "1" or "" without one.
        t_s: Times from the start of the record, s, increasing, shape (n,).
        values: Values in the unit, shape (n,).
        about: Additional description.
    """

    name: str
    unit: str
    t_s: Array
    values: Array
    about: str = ""


@dataclass(frozen=True, slots=True)
class Series(ShortRepr):
    """Columns over time of one flight.

    Attributes:
        name: Name of the flight.
        columns: Columns with distinct names; those sampled together share their array of times.
        facts: Settings and inputs of the result, as text.
        origin: Origin of positions; None: not known.
    """

    name: str
    columns: tuple[Column, ...]
    facts: Mapping[str, str] = field(default_factory=dict)
    origin: Place | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(c.name for c in self.columns)

    def blocks(self, rows: int = BLOCK_ROWS) -> Iterator[tuple[NDArray[np.int64], list[Array]]]:
        """The table in blocks of rows, so that a long flight is never in memory as a whole.

        Args:
            rows: Largest number of rows in a block.

        Yields:
            Times in ns, increasing, shape (n,), and the values of each column there, (n,) each.
        """
        grids = {id(c.t_s): nanoseconds(c.t_s) for c in self.columns}
        every = np.unique(np.concatenate([*grids.values(), np.zeros(0, dtype=np.int64)]))
        for first in range(0, len(every), rows):
            t_ns = every[first : first + rows]
            places = {}
            for key, grid in grids.items():
                a, b = np.searchsorted(grid, [t_ns[0], t_ns[-1] + 1])
                places[key] = slice(a, b), np.searchsorted(t_ns, grid[a:b])
            found = []
            for column in self.columns:
                there, place = places[id(column.t_s)]
                values = np.full(len(t_ns), np.nan)
                values[place] = column.values[there]
                found.append(values)
            yield t_ns, found


def residual_of(side: str) -> str:
    """Name of a side's residual."""
    return "residual" if side == TWIN else f"residual_{side}"


def compared(
    channel: str,
    unit: str,
    t_s: Array,
    measured: Array,
    sides: Mapping[str, Array],
    about: str = "",
) -> Iterator[Column]:
    """Columns of one channel: measured, predicted by each side, and the residuals.

    Args:
        channel: Name of the channel.
        unit: Unit of all of them.
        t_s: Times, shape (n,).
        measured: Measured values, shape (n,).
        sides: Predicted values by side, shape (n,) each.
        about: Description, as in `Column`.
    """
    yield Column(f"{MEASURED}.{channel}", unit, t_s, measured, about)
    for side, values in sides.items():
        yield Column(f"{side}.{channel}", unit, t_s, values, about)
    for side, values in sides.items():
        yield Column(f"{residual_of(side)}.{channel}", unit, t_s, measured - values, about)


# -- MCAP ---------------------------------------------------------------------------------------
#
# Series as MCAP: a topic per side, a field per channel.

_BLOCK_ROWS = 1 << 12  # rows in memory at once
PLACED = (MEASURED, TWIN, EXPLAINED, CORRECTED)
"""Sides with a position in space; the others are differences and spreads."""


def write_series_mcap(series: Series, path: Path, pose: Sequence[str] = ()) -> None:
    """Write series as MCAP; the topic is the part of a column's name before its last point.

    Args:
        series: Series to write.
        path: Path of the file; an existing one is replaced.
        pose: Columns of a position, NED, and of an attitude, body to NED, w first, that are shown
            as a body in space; none: no pose.

    Raises:
        TwinError: The package `mcap` is not installed, or a time is negative.
    """
    topics: dict[str, dict[str, tuple[str, str]]] = {}
    for column in series.columns:
        side, _, name = column.name.rpartition(".")
        topics.setdefault("/" + side.replace(".", "/"), {})[column.name] = name, column.unit
    begun = False
    with mcap_file(path) as file:
        plots, body = PlotTopics(file, topics), PoseTopics(file) if pose else None
        places = LocationTopics(file, series.origin, _positions(series.names))
        file.note("uavtwin", {"name": series.name, **series.facts})
        file.note("units", {c.name: c.unit for c in series.columns})
        for t_ns, values in series.blocks(_BLOCK_ROWS):
            if not begun:
                check_times(series.name, int(t_ns[0]))
                if body is not None:
                    body.begin(int(t_ns[0]))
            begun = True
            block = dict(zip(series.names, values, strict=True))
            poses = np.column_stack([block[c] for c in pose]).tolist() if pose else ()
            of_rows = places.rows(block, len(t_ns))
            for k, (t, messages) in enumerate(zip(t_ns.tolist(), plots.rows(block), strict=True)):
                places.write(t, of_rows[k])
                if body is not None and np.isfinite(poses[k]).all():
                    body.write(t, poses[k][:3], poses[k][3:])
                for topic, message in messages:
                    file.write(topic, t, message)


def _positions(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Columns of a position by topic, for every side that has one and is no difference."""
    sides = dict.fromkeys(name.rpartition(".")[0] for name in names)
    found = {side: tuple(f"{side}.{c}" for c in POS) for side in sides if side in PLACED}
    return {f"/{s}{LOCATION}": columns for s, columns in found.items() if {*columns} <= {*names}}


# -- files --------------------------------------------------------------------------------------
#
# Series as files of a folder of results.

Form = Literal["parquet", "csv", "mcap"]
FOLDER = "series"
"""Folder of the series, in the folder of a result."""
METADATA = b"uavtwin"
"""Key of the Parquet metadata with name and facts of a series, as JSON."""
_LONGEST_NAME = 100  # characters of a file name


def chosen_forms(csv: bool, mcap: bool) -> tuple[Form, ...]:
    """Requested formats; Parquet by default.

    Raises:
        TwinError: MCAP is requested and cannot be written here.
    """
    if mcap:
        check_mcap()
    requested: list[tuple[Form, bool]] = [("csv", csv), ("mcap", mcap)]
    return tuple(form for form, wanted in requested if wanted) or ("parquet",)


def write_all_series(every: Iterable[Series], folder: Path, forms: Sequence[Form]) -> list[str]:
    """Write a file per series and format, named after the flight; no series, no file.

    Args:
        every: One series per flight.
        folder: Folder of the results.
        forms: Formats from `chosen_forms`.

    Returns:
        Names of the files relative to the folder.
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
    """Write one series in the format of the file extension.

    Args:
        series: Series to write, in blocks of rows, so that memory does not grow with its length.
        path: Path with extension `.parquet`, `.csv` or `.mcap`; an existing file is replaced.

    Raises:
        TwinError: MCAP cannot be written here, or not with negative times.
    """
    {".parquet": _write_parquet, ".csv": _write_csv, ".mcap": write_series_mcap}[path.suffix](
        series, path
    )


def write_frame(table: pd.DataFrame, units: Mapping[str, str], path: Path) -> None:
    """Write a table as Parquet, with its `attrs`, and units in the metadata of its columns.

    Args:
        table: Table; its index is not written.
        units: Units by column, "" without one.
        path: Path of the file; an existing one is replaced.
    """
    arrow = pa.Table.from_pandas(table, preserve_index=False, nthreads=1)
    unit = {"time": "s"} | {k: v for k, v in units.items() if v}
    fields = [
        f.with_metadata({"unit": unit[f.name]} if f.name in unit else {}) for f in arrow.schema
    ]
    pq.write_table(arrow.cast(pa.schema(fields, metadata=arrow.schema.metadata)), path)


def _write_parquet(series: Series, path: Path) -> None:
    """Floats of 64 bits, a row group per block; `unit` and `about` in the metadata of a column."""
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    for c in series.columns:
        metadata = {k: v for k, v in (("unit", c.unit), ("about", c.about)) if v}
        fields.append(pa.field(c.name, pa.float64(), metadata=metadata))
    about = json.dumps({"name": series.name, **series.facts})
    schema = pa.schema(fields, metadata={METADATA: about.encode()})
    with pq.ParquetWriter(path, schema) as file:
        for t_ns, values in series.blocks():
            arrays = [pa.array(v) for v in (t_ns / NS, *values)]
            file.write_batch(pa.record_batch(arrays, schema=schema))


def _write_csv(series: Series, path: Path) -> None:
    """Write CSV with full precision (shortest repr), an empty field where there is no sample."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(["time", *series.names]) + "\n")
        for t_ns, values in series.blocks():
            table = pd.DataFrame(dict(enumerate([t_ns / NS, *values])), copy=False)
            table.to_csv(file, index=False, header=False, lineterminator="\n")


def _file_stem(name: str, taken: set[str]) -> str:
    """A file name for a flight that is different from those taken."""
    plain = re.sub(r"[^\w.-]", "_", name, flags=re.ASCII).lstrip(".")[:_LONGEST_NAME] or "flight"
    found, k = plain, 1
    while found in taken:
        k += 1
        found = f"{plain}_{k}"
    return found
