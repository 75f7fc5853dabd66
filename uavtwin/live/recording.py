"""What is kept of a live flight: all that came, the flight table, the residuals, the alarms.

`raw.tlog` holds every message with the time at which it came. Tables grow as Arrow streams
(`flight.arrows`) and become Parquet (`flight.parquet`) at the end. A new section, after the
aircraft's clock began anew, has a number: `flight_2.parquet`. `errors.txt` holds tracebacks of
parts of the program that failed in flight (`parts.py`).
"""

import json
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa

from twin.errors import TwinError
from twin.logs import Flight
from twin.logs.flight import Finding, Settled
from twin.logs.mavlink.frames import stamped
from twin.logs.table import Notes, TableStream, flight_schema, fold
from twin.residuals.gap import Channel
from twin.residuals.running.residuals import ResidualBlock

from ..output import check_folder
from .rows import Columns

_RESIDUALS = pa.schema(
    [
        ("time", pa.float64()),
        ("channel", pa.string()),
        ("unit", pa.string()),
        ("horizon_s", pa.float64()),
        ("phase", pa.string()),
        ("measured", pa.float64()),
        ("simulated", pa.float64()),
        ("residual", pa.float64()),
    ]
)
_CUT_OFF = "flight*.arrows"


class RawLog:
    """All messages as they come, as ground stations write them."""

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = path.open("xb")

    def add(self, arrival_us: int, frame: bytes) -> None:
        """A message that came at a time, us since 1970."""
        self._file.write(stamped(arrival_us, frame))

    def flush(self) -> None:
        """Hand over to the system what was added: it outlives this process."""
        self._file.flush()

    def close(self) -> None:
        """End the file."""
        self._file.close()


class Recording:
    """A folder that a live flight is recorded into."""

    def __init__(self, folder: Path, motors: int) -> None:
        """Begin a recording.

        Args:
            folder: New, or empty.
            motors: Of the aircraft.

        Raises:
            TwinError: It holds files, or cannot be written.
        """
        for left in sorted(folder.glob(_CUT_OFF)) if folder.is_dir() else ():
            raise TwinError(
                f"{folder}: holds a recording that was cut off. Any verb reads {left}; "
                f"uavtwin convert {left} --out {left.with_suffix('.parquet')} keeps it. Record "
                f"into another folder."
            )
        check_folder(folder, force=False)
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._motors, self._section = folder, motors, 0
        self.raw = RawLog(folder / "raw.tlog")
        self._alarms = (folder / "alarms.jsonl").open("x", encoding="utf-8")
        self._tables: dict[str, TableStream] = {}
        self.begin_section()

    def begin_section(self) -> None:
        """A flight of its own begins: the aircraft's clock began anew."""
        self._end_section()
        self._section += 1
        schemas = {"flight": flight_schema(self._motors), "residuals": _RESIDUALS}
        self._tables = {
            name: TableStream(self.folder / f"{self._stem(name)}.arrows", schema)
            for name, schema in schemas.items()
        }

    def add_rows(
        self,
        rows: Columns,
        facts: Mapping[str, str],
        findings: Iterable[Finding],
        settled: Settled | None,
    ) -> None:
        """New rows of the flight table, and what is known of the flight by now."""
        import pandas as pd

        flight = Flight("live", pd.DataFrame(), tuple(findings), dict(facts), settled=settled)
        self._tables["flight"].append(rows, Notes.of(flight).metadata())

    def add_residuals(self, block: ResidualBlock) -> None:
        """New samples of all channels."""
        channels = [c for c in (*block.channels, *block.short) if len(c.t_s)]
        if channels:
            self._tables["residuals"].append(_long(channels))

    def add_alarm(self, alarm: Mapping[str, Any]) -> None:
        """A line of `alarms.jsonl`."""
        self._alarms.write(json.dumps(alarm, allow_nan=False) + "\n")
        self._alarms.flush()

    def close(self) -> None:
        """End all files, each whatever becomes of the others."""
        with ExitStack() as stack:
            for end in (self._alarms.close, self.raw.close, self._end_section):
                stack.callback(end)

    def _end_section(self) -> None:
        tables, self._tables = self._tables, {}
        with ExitStack() as stack:
            for name, table in tables.items():
                parquet = self.folder / f"{self._stem(name)}.parquet"
                stack.callback(fold, table.path, parquet)
                stack.callback(table.close)  # before it is folded

    def _stem(self, name: str) -> str:
        return name if self._section == 1 else f"{name}_{self._section}"


def _long(channels: list[Channel]) -> dict[str, Any]:
    """Channels one below the other."""
    sizes = [len(c.t_s) for c in channels]

    def same(values: list[Any]) -> Any:
        return np.repeat(np.array(values, dtype=object), sizes)

    return {
        "time": np.concatenate([c.t_s for c in channels]),
        "channel": same([c.name for c in channels]),
        "unit": same([c.unit for c in channels]),
        "horizon_s": np.repeat([c.horizon_s for c in channels], sizes),
        "phase": np.concatenate([c.phase for c in channels]).astype(object),
        "measured": np.concatenate([c.measured for c in channels]),
        "simulated": np.concatenate([c.simulated for c in channels]),
        "residual": np.concatenate([c.residual for c in channels]),
    }
