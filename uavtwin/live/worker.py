"""Processing behind the receiver: records rows, compares them with the twin, evaluates alarms.

It runs in a separate thread, so that no computation delays the receiver. `FaultIsolation` lets a
part of a session fail while the recording continues.
"""

import contextlib
import math
import threading
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from queue import Queue
from threading import Lock
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np

from twin.component.along import BUILDING
from twin.errors import TwinError
from twin.logs.flight import Finding
from twin.residuals.gap import Channel, weighs
from twin.residuals.stream import Equations, Stream
from twin.residuals.stream_residuals import ResidualBlock, StreamResiduals
from twin.vehicle import Vehicle
from twin.why.watch import PERIOD_S, Alarm

from ..wording import misfit
from .recording import Columns, Recording
from .status import FlightWatch, alarm_json

if TYPE_CHECKING:
    from ..compensators.running import RunningCompensator
    from .status import ModelStatus

ERRORS = "errors.txt"
"""File of tracebacks in the folder of a recording."""
_MOST = 50
"""Number of different errors whose text is stored. Made up."""
_P = ParamSpec("_P")
_T = TypeVar("_T")


class Part(Enum):
    """Part of a session that may fail separately."""

    RECEIVER = "the receiver"
    DECODER = "the decoder"
    ROWS = "the flight table"
    RAW = "raw.tlog"
    TABLES = "recorded tables"
    SECTION = "the flight section"
    GRID = "the grid of the twin"
    TWIN = "the twin"
    SHOWN = "the twin that is shown"
    PUBLISHER = "the publisher"
    PAGE = "the page"
    ALARMS = "alarms"
    COMPENSATOR = "the compensator"


_STATEFUL = {Part.RAW, Part.TABLES, Part.GRID, Part.TWIN, Part.SHOWN, Part.ALARMS, Part.COMPENSATOR}
"""Parts whose state is lost with an error: they are called again in the next flight section."""


class FaultIsolation:
    """Isolation of the parts of a session, so that an error in one does not end another.

    An error is reported once, its repetitions are counted. From any thread.
    """

    def __init__(self, folder: Path | None = None) -> None:
        """Set up without failures.

        Args:
            folder: Folder of the recording, for the tracebacks; None: no recording.
        """
        self._folder, self._lock = folder, Lock()
        self._counts: Counter[tuple[str, str]] = Counter()
        self._resting: set[Part] = set()

    def run(
        self, part: Part, work: Callable[_P, _T], *args: _P.args, **kwargs: _P.kwargs
    ) -> _T | None:
        """Call a part; None where it fails, or has failed in this flight section."""
        if part in self._resting:
            return None
        try:
            return work(*args, **kwargs)
        except Exception as error:
            self._note(part, error)
            if part in _STATEFUL:
                self._resting.add(part)
            return None

    def wake(self) -> None:
        """Reset the failures at the start of a new flight section."""
        self._resting.clear()

    def _note(self, part: Part, error: Exception) -> None:
        text = str(error) if isinstance(error, TwinError) else f"{type(error).__name__}: {error}"
        key = part.value, text
        with self._lock:
            if key not in self._counts and len(self._counts) >= _MOST:
                key = part.value, "further errors"
            self._counts[key] += 1
            new = self._counts[key] == 1
        if new and self._folder is not None:
            trace = "".join(traceback.format_exception(error))
            # The disk may have failed: the error is reported in any case.
            with (
                contextlib.suppress(OSError),
                (self._folder / ERRORS).open("a", encoding="utf-8", errors="replace") as file,
            ):
                file.write(f"{part.value}\n{trace}\n")

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All errors so far, without repetitions."""
        with self._lock:
            counts = dict(self._counts)
        return tuple(Finding("error", part, f"failed: {e}", n) for (part, e), n in counts.items())


JUDGED_S = 20.0
"""Time in the air after which the weight carried by the twin is checked: climbs and turns
cancel."""
EVERY_S = 1.0
"""Flight time between two blocks of residuals, s."""
_MOST_BEHIND_S = 3.0
"""Flight time after which residuals are computed although rows wait, s. Made up."""
_WAITING = 10
"""Largest number of waiting batches of rows, each a second: then the receiver waits, and datagrams
wait in the kernel. A sender in lockstep goes no faster; a kill loses no more than these."""


@dataclass(frozen=True, slots=True)
class Batch:
    """New rows, with the present facts of the flight."""

    rows: Columns
    facts: dict[str, str]
    findings: tuple[Finding, ...]


class _NewSection:
    """Marker: the aircraft's clock restarted."""


class _End:
    """Marker: no more data will arrive."""


@dataclass(slots=True)
class Lift:
    """Specific force along z in flight, of the aircraft and of the twin, up to `JUDGED_S`."""

    measured: float = 0.0
    simulated: float = 0.0
    flown_s: float = 0.0

    def carried(self, acc_z: Channel) -> float | None:
        """Share of its weight that the twin carries; None: not known yet."""
        t_s = acc_z.t_s
        if self.flown_s < JUDGED_S and len(t_s) > 1:
            step_s = float(np.median(np.diff(t_s)))
            self.measured += step_s * float(acc_z.measured.sum())
            self.simulated += step_s * float(acc_z.simulated.sum())
            self.flown_s += step_s * len(t_s)
        known = self.flown_s >= JUDGED_S and weighs(self.measured / self.flown_s)
        return self.simulated / self.measured if known else None


class Worker:
    """Thread that processes rows, and reports residuals and alarms. An error of a part ends that
    part of the section.

    Attributes:
        sections: Number of flights.
        flight_s: Time of the newest row.
        units: Units of the channels.
        equations: Equations of the twin.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        recording: Recording | None,
        horizon_s: float,
        watch: Callable[[], FlightWatch | None] = lambda: None,
        on_block: Callable[[ResidualBlock], None] = lambda _: None,
        on_alarm: Callable[[Alarm], None] = lambda _: None,
        compensator: "RunningCompensator | None" = None,
        on_anomaly: Callable[[float], None] = lambda _: None,
        parts: FaultIsolation | None = None,
    ) -> None:
        self._vehicle, self._recording, self._horizon_s = vehicle, recording, horizon_s
        self._parts = parts or FaultIsolation()
        self._new_watch, self._on_block, self._on_alarm = watch, on_block, on_alarm
        self._compensator, self._on_anomaly = compensator, on_anomaly
        self._queue: Queue[Batch | _NewSection | _End] = Queue(_WAITING)
        self._thread = threading.Thread(target=self._work, name="twin", daemon=True)
        self.sections, self.flight_s = 1, 0.0
        self.units: dict[str, str] = {}
        self._sums: dict[str, tuple[int, float]] = {}
        with BUILDING:
            self.equations = Equations(vehicle, vehicle.drive)
            self.equations.build()
        self._begin()
        self._thread.start()

    def add(self, batch: Batch) -> None:
        """Queue rows; waits where very many are queued."""
        self._queue.put(batch)

    def new_section(self) -> None:
        """Queue the start of a new section."""
        self._queue.put(_NewSection())

    def close(self) -> None:
        """Report the remaining results, and end."""
        self._queue.put(_End())
        self._thread.join()

    @property
    def waits_for(self) -> str:
        """Reason why the twin has not started."""
        return self._stream.waits_for

    @property
    def misfit(self) -> str:
        """Reason why the vehicle file does not fit; "": it does, or it is not known."""
        return (self._watch.misfit if self._watch is not None else "") or self._misfit

    @property
    def rests(self) -> str:
        """Reason why the search for alarms is off or partial; "": it is on, or not requested."""
        return "" if self._watch is None else self._watch.rests

    @property
    def rms(self) -> dict[str, float]:
        """Rms of the residuals of this section so far, by channel."""
        return {name: math.sqrt(s / n) for name, (n, s) in dict(self._sums).items() if n}

    @property
    def model(self) -> "ModelStatus | None":
        """State of the compensator in this section so far; None: there is none."""
        return None if self._compensator is None else self._compensator.status

    def _begin(self) -> None:
        self._watch = self._parts.run(Part.ALARMS, self._new_watch)
        self._stream = Stream(self._vehicle, equations=self.equations)
        self._residuals = StreamResiduals(self._stream, self._horizon_s)
        self._sums, self._lift, self._misfit = {}, Lift(), ""
        if self._compensator is not None:
            self._parts.run(Part.COMPENSATOR, self._compensator.begin)
        self._updated_s: float | None = None
        self._evaluated_s = 0.0

    def _work(self) -> None:
        while True:
            item = self._queue.get()
            if isinstance(item, Batch):
                self._parts.run(Part.SECTION, self._take, item)
                continue
            self._parts.run(Part.SECTION, self._finish)
            if isinstance(item, _End):
                return
            self._parts.run(Part.SECTION, self._restart)

    def _take(self, batch: Batch) -> None:
        rows = batch.rows
        columns = [c for c in rows if c not in ("time", "phase")]
        if self._parts.run(Part.GRID, self._stream.lacks, columns):
            self._finish()
            self._restart()
        self._parts.run(Part.GRID, self._stream.push, rows)
        if self._recording is not None:
            settled, found = self._stream.settled, (*batch.findings, *self._parts.findings)
            add = self._recording.add_rows
            self._parts.run(Part.TABLES, add, rows, batch.facts, found, settled)
        self.flight_s = float(rows["time"][-1])
        if self._updated_s is None:
            self._updated_s = self._evaluated_s = float(rows["time"][0])
        if self._watch is not None:
            self._parts.run(Part.ALARMS, self._watch.push, rows)
        if self.flight_s - self._evaluated_s >= PERIOD_S:
            self._look()
        # Waiting rows are recorded before any computation, up to a limit.
        behind_s = self.flight_s - self._updated_s
        if behind_s >= (EVERY_S if self._queue.empty() else _MOST_BEHIND_S):
            self._updated_s = self.flight_s
            self._publish(self._parts.run(Part.TWIN, self._residuals.update))

    def _look(self) -> None:
        """Evaluate the alarms: the only place that does."""
        self._evaluated_s = self.flight_s
        if self._watch is None:
            return
        for alarm in self._parts.run(Part.ALARMS, self._watch.evaluate) or ():
            if self._recording is not None:
                self._recording.add_alarm(alarm_json(alarm, self.sections))
            self._on_alarm(alarm)

    def _finish(self) -> None:
        """Report the remaining results of the section, and store its fixed values."""
        self._look()
        self._publish(self._parts.run(Part.TWIN, self._residuals.update, final=True))

    def _restart(self) -> None:
        self.sections += 1
        self._parts.wake()
        if self._recording is not None:
            self._parts.run(Part.TABLES, self._recording.begin_section)
        self._begin()

    def _publish(self, block: ResidualBlock | None) -> None:
        if block is None:
            return
        for channel in (*block.channels, *block.short):
            n, total = self._sums.get(channel.name, (0, 0.0))
            r = channel.residual
            self._sums[channel.name] = n + len(r), total + float(r @ r)
            self.units[channel.name] = channel.unit
            if channel.name == "acc_z" and channel.horizon_s == 0:
                self._misfit = misfit(self._lift.carried(channel), self._vehicle.name)
        if self._recording is not None:
            self._parts.run(Part.TABLES, self._recording.add_residuals, block)
        self._parts.run(Part.PAGE, self._on_block, block)
        if self._compensator is not None:
            self._parts.run(Part.COMPENSATOR, self._correct, self._compensator, block)

    def _correct(self, compensator: "RunningCompensator", block: ResidualBlock) -> None:
        """Run the compensator on the newest seconds."""
        with BUILDING:
            said = compensator.update(block.flight, block.end_s, block.fine)
        if said is not None and np.isfinite(score := float(said.anomaly.max())):
            self._on_anomaly(score)
