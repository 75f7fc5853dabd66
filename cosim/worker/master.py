"""The master's methods for a system that runs in a worker process.

The whole loop runs there, so a step costs what it costs in this process. What is recorded lies in
memory that both share, so it is here whatever becomes of the worker.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isfinite
from types import TracebackType
from typing import Any, Self

import numpy as np

from fmus.names import shown
from twin.errors import FmuError

from ..limits import Limits
from ..recording import Interrupted, Recording, RunError
from ..slave.trace import read_table, table_bytes
from ..stepping import Algorithm
from ..system import System
from .process import Ended, Process

Progress = Callable[[float], None]


class WorkerMaster:
    """As `Master`, method by method; after a fault or Ctrl-C a new one is needed."""

    def __init__(
        self, system: System, record: Sequence[str] | None = None, limits: Limits | None = None
    ) -> None:
        """Start a worker and load the FMUs.

        Raises:
            FmuError: As `Master`, or an FMU ended the worker.
        """
        self.system, self._record_only, self._limits = system, record, limits or Limits()
        self._last: Recording | None = None
        self._start()

    def _start(self) -> None:
        """A worker with all FMUs loaded."""
        system, record = self.system, self._record_only
        self._time_s, self._step_s, self._rows = system.start_time_s, 0.0, 0
        self._process = Process(self._limits)
        try:
            names = self._ask(
                "load",
                fmus={name: str(path.absolute()) for name, path in system.fmus.items()},
                connections=[[c.source, c.target] for c in system.connections],
                starts=dict(system.starts),
                periods=dict(system.periods),
                start_time_s=system.start_time_s,
                record=None if record is None else list(record),
            )
            if not (isinstance(names, list) and all(isinstance(n, str) for n in names)):
                raise FmuError(self._fault(str(self._process.spoilt())))
            self.record_names = tuple(names)
        except BaseException:
            self._process.end()
            self._process.forget()
            raise

    def initialize(
        self,
        start_time_s: float | None = None,
        starts: Mapping[str, float] | None = None,
        stop_time_s: float | None = None,
    ) -> None:
        """See `Master.initialize`; a new worker takes the place of one that a reset ended.

        Raises:
            FmuError: As there, or an FMU ended the worker.
        """
        self._process.begin()
        arguments = {
            "start_time_s": start_time_s,
            "starts": None if starts is None else dict(starts),
            "stop_time_s": stop_time_s,
        }
        try:
            self._ask("initialize", **arguments)
        except FmuError:
            if self._process.running or self._process.entry().function != "reset":
                raise
            self._process.forget()
            self._start()
            self._ask("initialize", **arguments)
        self._time_s = self.system.start_time_s if start_time_s is None else start_time_s

    def run(
        self,
        stop_time_s: float,
        step_s: float,
        algorithm: Algorithm = "jacobi",
        every: int = 1,
        progress: Progress | None = None,
        realtime: float | None = None,
    ) -> Recording:
        """See `Master.run`.

        Raises:
            FmuError: As there.
            RunError: As there, or an FMU ended the worker; holds the recording.
            Interrupted: Ctrl-C; holds the recording.
        """
        request = {
            "do": "run",
            "stop_time_s": stop_time_s,
            "step_s": step_s,
            "algorithm": algorithm,
            "every": every,
            "realtime": realtime,
        }
        clocked_s = (stop_time_s - self._time_s) / realtime if realtime else None
        return self._record(request, progress, clocked_s, every)

    def run_adaptive(
        self,
        stop_time_s: float,
        step_s: float,
        tolerance: float,
        algorithm: Algorithm = "settled",
        progress: Progress | None = None,
    ) -> Recording:
        """See `Master.run_adaptive`.

        Raises:
            FmuError: As there.
            RunError: As there, or an FMU ended the worker; holds the recording.
            Interrupted: Ctrl-C; holds the recording.
        """
        request = {
            "do": "run_adaptive",
            "stop_time_s": stop_time_s,
            "step_s": step_s,
            "tolerance": tolerance,
            "algorithm": algorithm,
        }
        return self._record(request, progress)

    def close(self) -> None:
        """Free all slaves and end the worker.

        Raises:
            RunError: An FMU ended the worker, or did not return; holds the last recording.
        """
        if not self._process.running:
            self._process.forget()
            return
        try:
            self._ask("close")
        except FmuError as error:
            if self._last is None:
                raise
            raise RunError(str(error), replace(self._last, incomplete=str(error))) from error
        finally:
            self._process.end()
            self._process.forget()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except FmuError:
            if kind is None:
                raise

    # -- requests ---------------------------------------------------------------------------

    def _record(
        self,
        request: Mapping[str, Any],
        progress: Progress | None,
        clocked_s: float | None = None,
        every: int = 1,
    ) -> Recording:
        self._last = None
        steps = self._steps(request["stop_time_s"], request["step_s"])
        self._rows = 0 if every < 1 else steps // every + 1
        self._step_s = request["step_s"]
        try:
            answer = self._request(request, progress, clocked_s, self._rows)
        except KeyboardInterrupt:
            why = f"interrupted at {self._process.entry().clock_s:g} s"
            raise Interrupted(self._recording(every, incomplete=why)) from None
        except FmuError as error:
            why = str(error)
            raise RunError(why, self._recording(every, incomplete=why)) from None
        if "refused" in answer:
            raise FmuError(_text(answer["refused"]))
        failed = "failed" in answer
        why = _text(answer.get("failed", ""))
        try:
            done, rejected, lateness_s = answer["run"] if failed else answer["done"]
            counts = int(done), int(rejected), float(lateness_s)
        except (KeyError, TypeError, ValueError, OverflowError):
            counts, why = (0, 0, 0.0), self._fault(str(self._process.spoilt()))
        self._last = self._recording(every, *counts, why)
        if not why and len(self._last.time_s) < self._rows:
            why = self._fault(str(self._process.spoilt()))
            self._last = replace(self._last, incomplete=why)
        if why:
            raise RunError(why, self._last)
        self._time_s += steps * request["step_s"]
        return self._last

    def _steps(self, stop_time_s: float, step_s: float) -> int:
        """Steps of a run, as `Master` counts them; 0 where it refuses to run."""
        steps = (stop_time_s - self._time_s) / step_s if step_s > 0 else 0.0
        return max(0, round(steps)) if isfinite(steps) else 0

    def _recording(
        self,
        every: int,
        steps: int | None = None,
        rejected: int = 0,
        lateness_s: float = 0.0,
        incomplete: str = "",
    ) -> Recording:
        """What has been recorded; where nobody counted, the steps up to its last row."""
        expected_s = np.asarray(self._time_s + every * np.arange(self._rows) * self._step_s)
        time_s, values = read_table(self._process.table, expected_s, len(self.record_names))
        if steps is None:
            steps = every * max(0, len(time_s) - 1)
        printed = self._process.printed
        return Recording(
            self.record_names, time_s, values, steps, rejected, lateness_s, incomplete, printed
        )

    def _ask(self, do: str, **arguments: Any) -> Any:
        answer = self._request({"do": do, **arguments})
        if "done" not in answer:
            raise FmuError(_text(answer.get("refused", answer.get("failed"))))
        return answer["done"]

    def _request(
        self,
        request: Mapping[str, Any],
        progress: Progress | None = None,
        clocked_s: float | None = None,
        rows: int | None = None,
    ) -> Mapping[str, Any]:
        table = None if rows is None else table_bytes(rows * (1 + len(self.record_names)))
        try:
            return self._process.ask(request, progress, clocked_s, table)
        except Ended as ended:
            raise FmuError(self._fault(str(ended))) from None
        except (OSError, OverflowError) as error:
            raise FmuError(
                f"no room for a recording of {rows} rows and {len(self.record_names)} columns: "
                f"{error}. Record less often (--interval), or a shorter run."
            ) from error

    def _fault(self, what: str) -> str:
        """Which FMU, in which function, when, and what became of the worker."""
        entry = self._process.entry()
        if not entry.who:
            printed = shown(self._process.printed.strip()[-300:], 400)
            return f"the process for the FMUs of this system: {what}. It printed {printed}."
        place = entry.function if entry.busy else f"after {entry.function}"
        return f"{entry.who}: {place} at {entry.clock_s:g} s: {what}."


def _text(content: Any) -> str:
    """An answer as text on one line."""
    return " ".join(str(content).split())
