"""The master's methods for a system that runs in a worker process.

The whole loop runs there, so a step costs what it costs in this process. What is recorded lies in
memory that both share, so it is here whatever becomes of the worker.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

from fmus.names import shown
from twin.errors import FmuError

from ..limits import Limits
from ..recording import Interrupted, Recording, RunError
from ..slave.board import read_table
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
        self._process = Process(self._limits)
        try:
            self.record_names = tuple(
                self._ask(
                    "load",
                    fmus={name: str(path.absolute()) for name, path in system.fmus.items()},
                    connections=[[c.source, c.target] for c in system.connections],
                    starts=dict(system.starts),
                    periods=dict(system.periods),
                    start_time_s=system.start_time_s,
                    record=None if record is None else list(record),
                )
            )
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
            if self._process.running or self._process.notice().function != "reset":
                raise
            self._process.forget()
            self._start()
            self._ask("initialize", **arguments)
        self._start_s = self.system.start_time_s if start_time_s is None else start_time_s

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
        clocked_s = (stop_time_s - self._start_s) / realtime if realtime else None
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
        self._process.clear_table()
        try:
            answer = self._request(request, progress, clocked_s)
        except KeyboardInterrupt:
            why = f"interrupted at {self._process.notice().clock_s:g} s"
            raise Interrupted(self._recording(every, incomplete=why)) from None
        except FmuError as error:
            why = str(error)
            raise RunError(why, self._recording(every, incomplete=why)) from None
        if "refused" in answer:
            raise FmuError(_text(answer["refused"]))
        steps, rejected, lateness_s = answer["run"] if "failed" in answer else answer["done"]
        why = _text(answer.get("failed", ""))
        self._last = self._recording(every, int(steps), int(rejected), float(lateness_s), why)
        if why:
            raise RunError(why, self._last)
        return self._last

    def _recording(
        self,
        every: int,
        steps: int | None = None,
        rejected: int = 0,
        lateness_s: float = 0.0,
        incomplete: str = "",
    ) -> Recording:
        """What has been recorded; where nobody counted, the steps up to its last row."""
        time_s, values = read_table(self._process.board, len(self.record_names))
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
    ) -> Mapping[str, Any]:
        try:
            return self._process.ask(request, progress, clocked_s)
        except Ended as ended:
            raise FmuError(self._fault(str(ended))) from None

    def _fault(self, what: str) -> str:
        """Which FMU, in which function, when, and what became of the worker."""
        notice = self._process.notice()
        if not notice.who:
            printed = shown(self._process.printed.strip()[-300:], 400)
            return f"the process for the FMUs of this system: {what}. It printed {printed}."
        place = notice.function if notice.busy else f"after {notice.function}"
        return f"{notice.who}: {place} at {notice.clock_s:g} s: {what}."


def _text(content: Any) -> str:
    """An answer as text on one line."""
    return " ".join(str(content).split())
