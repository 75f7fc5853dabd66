"""Residual flights as one Parquet file, kept beside a model: what it was trained on."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from twin.errors import LogError, ModelError
from twin.logs.stored import opened

from .channels import CHANNELS, check_channels
from .flights import ResidualFlight

_BLOCKS = ("virtual", "residual", "fresh")
_RATE = b"rate_hz"


def write_residuals(flights: Sequence[ResidualFlight], path: Path) -> None:
    """Write flights of one rate and number of commands; the same flights give the same bytes.

    Columns: `flight`, `t_s`, `phase` (code), `span` (number of the span, -1 outside), `cmd_1..m`,
    and `virtual.C`, `residual.C`, `fresh.C` per channel C. Real numbers keep their 64 bits.
    """
    table = pa.Table.from_pandas(
        pd.concat([_frame(f) for f in flights], ignore_index=True), preserve_index=False
    )
    rate = {_RATE: repr(flights[0].rate_hz).encode()}
    pq.write_table(table.replace_schema_metadata(rate), path, compression="zstd")


def read_residuals(path: Path) -> list[ResidualFlight]:
    """The flights that `write_residuals` wrote, without their notes.

    Raises:
        ModelError: It is missing or no such file.
    """
    try:
        with opened(path, path.name) as file:
            table = file.read()
        rate_hz = float(table.schema.metadata[_RATE])
        frame = table.to_pandas()
        parts = [_flight(str(k), f, rate_hz) for k, f in frame.groupby("flight", sort=False)]
    except (LogError, OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise ModelError(
            f"{path}: the residuals a model was trained on cannot be read ({error}); "
            "train the model anew."
        ) from error
    return parts


def _frame(flight: ResidualFlight) -> pd.DataFrame:
    span = np.full(len(flight.t_s), -1)
    for k, (a, b) in enumerate(flight.spans):
        span[a:b] = k
    columns = {"flight": flight.name, "t_s": flight.t_s, "phase": flight.phase, "span": span}
    columns |= {f"cmd_{i + 1}": c for i, c in enumerate(flight.commands.T)}
    for block in _BLOCKS:
        values = getattr(flight, block)
        columns |= {f"{block}.{c}": values[:, i] for i, c in enumerate(CHANNELS)}
    return pd.DataFrame(columns)


def _flight(name: str, frame: pd.DataFrame, rate_hz: float) -> ResidualFlight:
    stem = f"{_BLOCKS[0]}."
    names = [c.removeprefix(stem) for c in frame if c.startswith(stem)]
    check_channels(names)
    virtual, residual, fresh = (
        frame[[f"{block}.{c}" for c in CHANNELS]].to_numpy() for block in _BLOCKS
    )
    commands = [c for c in frame if c.startswith("cmd_")]
    rows = frame.groupby("span").indices
    spans = [(int(rows[k][0]), int(rows[k][-1]) + 1) for k in sorted(rows) if k >= 0]
    return ResidualFlight(
        name=name,
        rate_hz=rate_hz,
        t_s=frame["t_s"].to_numpy(),
        virtual=virtual,
        residual=residual,
        fresh=fresh,
        commands=frame[commands].to_numpy().reshape(len(frame), len(commands)),
        phase=frame["phase"].to_numpy(dtype=np.intp),
        spans=tuple(spans),
    )
