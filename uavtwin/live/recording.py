"""Conversion of MAVLink samples to rows of a flight table in order of time, and their recording.

`RowBuffer` waits for reordered messages. `raw.tlog` contains every message with its time of
arrival. Tables are written as Arrow streams (`flight.arrows`) and converted to Parquet
(`flight.parquet`) at the end. A new section, after a restart of the aircraft's clock, has a number:
`flight_2.parquet`. `errors.txt` contains tracebacks of parts of the program that failed in flight
(`FaultIsolation`).
"""

import heapq
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from twin.errors import TwinError
from twin.logs.columns import in_order
from twin.logs.flight import Finding, Notes, Settled
from twin.logs.mavlink.decoder import LANDED, Sample, Sources, columns_of
from twin.logs.mavlink.frames import PHASES, stamped
from twin.logs.table import TableStream, flight_schema, fold, noted
from twin.residuals.gap import Channel
from twin.residuals.stream_residuals import ResidualBlock

from ..output import check_folder

HOLD_S = 0.15
"""Time for which rows wait for reordered messages."""
PROBE_US = 1_000_000
"""Time from the first sample in which the rates of several sources are measured."""
_SILENT_US = 5_000_000
"""Silence after which another source of a signal is used."""
_MOST_WAITING = 100_000
"""Largest number of waiting samples: with a stopped clock none would ever be released."""
_CRUISE_M_S = 1.0
"""Horizontal speed above which a phase of flight is forward, m/s. Made up."""
Columns = dict[str, NDArray[np.float64] | NDArray[np.object_]]


@dataclass(slots=True)
class RowBuffer:
    """The jitter buffer of one flight section.

    Attributes:
        hold_us: Time for which rows wait, us of the aircraft's clock.
        zero_us: Time on the aircraft's clock that is time 0 of the flight; None: none received yet.
        late: Number of samples that arrived too late for their row, by signal.
    """

    hold_us: int = round(1e6 * HOLD_S)
    zero_us: int | None = None
    late: Counter[str] = field(default_factory=Counter)
    _heap: list[tuple[int, int, Sample]] = field(default_factory=list)
    _count: int = 0
    _first_us: int | None = None
    _newest_us: int = -(2**62)
    _released_us: int = -(2**62)
    _sources: Sources = field(default_factory=Sources)
    _last_us: dict[str, int] = field(default_factory=dict)
    _landed: int = 0
    _speed_m_s: float = 0.0

    @property
    def sources(self) -> dict[str, str]:
        """Source message of each signal."""
        return self._sources.chosen

    @property
    def waiting(self) -> int:
        """Number of samples that have not been released."""
        return len(self._heap)

    def add(self, sample: Sample) -> None:
        """Add a sample."""
        if self._first_us is None:
            self._first_us = sample.t_us
        if sample.t_us <= self._released_us:
            if self.sources.get(sample.group, sample.source) == sample.source:
                self.late[sample.group] += 1
            return
        self._sources.add(sample)
        self._newest_us = max(self._newest_us, sample.t_us)
        self._count += 1
        heapq.heappush(self._heap, (sample.t_us, self._count, sample))

    def take(self, everything: bool = False) -> Columns | None:
        """Complete rows; None: there are none.

        Args:
            everything: Whether no more samples will arrive.
        """
        if self._first_us is None or not self._heap:
            return None
        everything = everything or len(self._heap) > _MOST_WAITING
        if not everything and self._newest_us - self._first_us < PROBE_US:
            return None
        until = self._newest_us if everything else self._newest_us - self.hold_us
        if self._heap[0][0] > until:
            return None
        self._sources.choose()
        portion = _Portion()
        while self._heap and self._heap[0][0] <= until:
            sample = heapq.heappop(self._heap)[2]
            if not self._counts(sample):
                continue
            if sample.group == LANDED:
                self._landed = int(sample.values[0])
                continue
            if not portion.add(sample):  # of a time that has a sample already
                continue
            if sample.group == "vel":
                self._speed_m_s = math.hypot(*sample.values[:2])
            portion.phases[-1] = self._phase()
        self._released_us = max(self._released_us, until)
        if not portion.t_us:
            return None
        if self.zero_us is None:  # a whole second, so that grids match the aircraft's clock
            self.zero_us = portion.t_us[0] // 1_000_000 * 1_000_000
        return portion.columns(self.zero_us)

    def _counts(self, sample: Sample) -> bool:
        """Whether a sample is from the selected source of its signal."""
        chosen, last = self.sources[sample.group], self._last_us.get(sample.group)
        if sample.source != chosen:
            if last is None or sample.t_us - last < _SILENT_US:
                return False
            self.sources[sample.group] = sample.source
        self._last_us[sample.group] = sample.t_us
        return True

    def _phase(self) -> str:
        """Phase of flight: by the land detector, in the air by speed."""
        if not self._landed:
            return ""
        cruising = "forward" if self._speed_m_s > _CRUISE_M_S else "hover"
        return PHASES.get(self._landed, cruising)


class _Portion:
    """Rows that are released together, in order of time.

    Attributes:
        t_us: Times of the rows, us.
        phases: Phases of flight of the rows.
    """

    def __init__(self) -> None:
        self.t_us: list[int] = []
        self.phases: list[str] = []
        self._signals: dict[tuple[str, int], tuple[list[int], list[tuple[float, ...]]]] = {}

    def add(self, sample: Sample) -> bool:
        """Add a sample, not older than those before; returns whether its place was free."""
        if not self.t_us or self.t_us[-1] != sample.t_us:
            self.t_us.append(sample.t_us)
            self.phases.append("")
        row, key = len(self.t_us) - 1, (sample.group, len(sample.values))
        rows, values = self._signals.setdefault(key, ([], []))
        if rows and rows[-1] == row:
            return False
        rows.append(row)
        values.append(sample.values)
        return True

    def columns(self, zero_us: int) -> Columns:
        """Rows by column, NaN where there is no sample."""
        found: Columns = {}
        for (group, width), (rows, values) in self._signals.items():
            signal = np.array(values, dtype=np.float64)
            for k, name in enumerate(columns_of(group, width)):
                column = found.setdefault(name, np.full(len(self.t_us), np.nan))
                column[rows] = signal[:, k]
        since_us = np.array(self.t_us, dtype=np.int64) - zero_us
        found["time"] = np.asarray(since_us * 1e-6, dtype=np.float64)
        found["phase"] = np.array(self.phases, dtype=object)
        return {name: found[name] for name in in_order(found)}


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
)  # columns of the residuals, SI units
_CUT_OFF = "flight*.arrows"  # a recording that was not closed


class RawLog:
    """File of all messages as they arrive, in the format of ground stations."""

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = path.open("xb")

    def add(self, arrival_us: int, frame: bytes) -> None:
        """Append a message with its time of arrival, us since 1970."""
        self._file.write(stamped(arrival_us, frame))

    def flush(self) -> None:
        """Flush to the system: the data then survive this process."""
        self._file.flush()

    def close(self) -> None:
        """End the file."""
        self._file.close()


class Recording:
    """Folder of a live flight's recording."""

    def __init__(self, folder: Path, motors: int) -> None:
        """Start a recording.

        Args:
            folder: Path of the folder, new or empty.
            motors: Number of motors.

        Raises:
            TwinError: It is not empty, or cannot be written.
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
        """Start a separate flight: the aircraft's clock restarted."""
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
        """Append rows of the flight table, with the present facts of the flight."""
        notes = Notes(facts=dict(facts), findings=tuple(findings), settled=settled)
        self._tables["flight"].append(rows, noted(notes))

    def add_residuals(self, block: ResidualBlock) -> None:
        """Append samples of all channels."""
        channels = [c for c in (*block.channels, *block.short) if len(c.t_s)]
        if channels:
            self._tables["residuals"].append(_long(channels))

    def add_alarm(self, alarm: Mapping[str, Any]) -> None:
        """Append a line to `alarms.jsonl`."""
        self._alarms.write(json.dumps(alarm, allow_nan=False) + "\n")
        self._alarms.flush()

    def close(self) -> None:
        """End all files, independently of failures of others."""
        with ExitStack() as stack:
            for end in (self._alarms.close, self.raw.close, self._end_section):
                stack.callback(end)

    def _end_section(self) -> None:
        tables, self._tables = self._tables, {}
        with ExitStack() as stack:
            for name, table in tables.items():
                parquet = self.folder / f"{self._stem(name)}.parquet"
                stack.callback(fold, table.path, parquet)
                stack.callback(table.close)  # before it is converted

    def _stem(self, name: str) -> str:
        return name if self._section == 1 else f"{name}_{self._section}"


def _long(channels: list[Channel]) -> dict[str, Any]:
    """Channels in long form, one below the other."""
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
