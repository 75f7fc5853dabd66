"""The co-simulation master: loads a system, initialises it and runs it; see `stepping` for how."""

from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from twin.errors import FmuError

from .adaptive import SAMPLE_PERIOD, Control, Grid, advance_to
from .bus import Bus
from .realtime import Pace
from .recording import Interrupted, Recording, RunError
from .rollback import Rollback
from .slave.slave import Slave
from .slave.told import TracedSlave
from .slave.trace import SharedTrace
from .stepping import Algorithm, Stepping
from .system import System

__all__ = ["Algorithm", "Interrupted", "Master", "Recording", "RunError"]

SHORTEST = 1e-9
"""Shortest step of the step-size control, in output steps."""


class Master:
    """Loads a system once and runs it as often as wanted; a context manager.

    Attributes:
        slaves: In the order of the system.
        record_names: "slave.variable" of each recorded column.
        time_s: Time reached.
    """

    def __init__(
        self, system: System, record: Sequence[str] | None = None, trace: SharedTrace | None = None
    ) -> None:
        """Load the FMUs.

        Args:
            system: What to run.
            record: "slave.variable" outputs to record; None: all that are scalars.
            trace: Where another process can read the calls under way and the recording.

        Raises:
            FmuError: A file, a name, a unit or a connection is wrong.
        """
        self.system, self._trace = system, trace
        self.slaves: list[Slave] = []
        self._ready = False
        self._record = record
        try:
            for name in system.fmus:
                self.slaves.append(self._instance(name))
            system.check({s.name: s.interface for s in self.slaves})
            self._connect()
        except BaseException:
            self.close()
            raise
        self.record_names = self._bus.recorded

    def _instance(self, name: str) -> Slave:
        path = self.system.fmus[name]
        return Slave(name, path) if self._trace is None else TracedSlave(name, path, self._trace)

    def _connect(self) -> None:
        """Bus and algorithms over the present instances, whose addresses they hold."""
        self._bus = Bus(self.system, {s.name: s for s in self.slaves}, self._record)
        self._stepping = Stepping(self._bus)

    def _reset(self) -> None:
        """Put all slaves into the instantiated state; what cannot is instantiated again."""
        renewed = False
        for i, s in enumerate(self.slaves):
            try:
                s.reset()
            except FmuError:
                s.close()
                self.slaves[i] = self._instance(s.name)
                renewed = True
        if renewed:
            self._connect()

    def initialize(
        self,
        start_time_s: float | None = None,
        starts: Mapping[str, float] | None = None,
        stop_time_s: float | None = None,
    ) -> None:
        """Set start values and initialise all slaves at a time, after a run from its beginning.

        Args:
            start_time_s: Time of the first communication point; None: the system's.
            starts: Start values on top of the system's, "slave.variable" -> value.
            stop_time_s: Stop time that the slaves get, and no run goes beyond; None: they get none.

        Raises:
            FmuError: A start value is wrong, a slave refused, a loop has no solution, or an output
                is no finite number.
        """
        start_s = self.system.start_time_s if start_time_s is None else start_time_s
        self._stop_s = np.inf if stop_time_s is None else stop_time_s
        values: dict[str, dict[str, float]] = {s.name: {} for s in self.slaves}
        for name, value in {**self.system.starts, **(starts or {})}.items():
            slave, variable = self.system.split(name)
            values[slave][variable] = value
        self._ready = False
        self._reset()
        for s in self.slaves:
            s.initialize(start_s, values[s.name], stop_time_s)
        for s in self.slaves:
            s.read_outputs()  # where the solution of loops starts
        self._stepping.settle(start_s, initial=True)
        self._bus.write_all()
        for s in self.slaves:
            s.finish_initialization()
            s.read_outputs()
        self._stepping.settle(start_s)
        with np.errstate(invalid="ignore"):
            self._bus.check(start_s)
        self._stepping.count = 0
        self.time_s = self._start_s = start_s
        self._ready = True

    # -- fixed steps ------------------------------------------------------------------------

    def run(
        self,
        stop_time_s: float,
        step_s: float,
        algorithm: Algorithm = "jacobi",
        every: int = 1,
        progress: Callable[[float], None] | None = None,
        realtime: float | None = None,
    ) -> Recording:
        """Step until a time; the first row is the present.

        Args:
            stop_time_s: Time of the last communication point.
            step_s: Base communication step.
            algorithm: See `stepping`.
            every: Record every so many steps.
            progress: Called now and then with the time reached.
            realtime: Simulated seconds per second of the clock, 1 for real time; None: as fast
                as possible.

        Raises:
            FmuError: The step is not positive, or the time is past.
            RunError: A slave failed or gave what is no finite number; holds the recording.
            Interrupted: Ctrl-C; holds the recording up to then. Between two steps, where a run in
                real time spends its time, the system can be run on.
        """
        steps = self._steps(stop_time_s, step_s)
        if every < 1:
            raise FmuError(f"every = {every}: record every so many steps, at least 1.")
        if realtime is not None and not (realtime > 0 and np.isfinite(realtime)):
            raise FmuError(f"realtime = {realtime:g}: needs a positive factor, e.g. 1.")
        step, bus = self._stepping.algorithm(algorithm), self._bus
        rows = _Rows(bus, steps // every + 1, self._trace)
        rows.add(self.time_s)
        origin = self.time_s
        pace = Pace(realtime, origin) if realtime is not None else None
        self._ready = waiting = False
        done = 0
        try:
            with np.errstate(invalid="ignore"):  # `check` looks for what is not finite
                for done in range(1, steps + 1):
                    step(self.time_s, min(step_s, self._stop_s - self.time_s))
                    self.time_s = origin + done * step_s
                    bus.check(self.time_s)
                    if done % every == 0:
                        rows.add(self.time_s)
                    if pace is not None:
                        waiting = True
                        pace.wait(self.time_s)
                        waiting = False
                    if progress is not None and done % 1000 == 0:
                        progress(self.time_s)
        except KeyboardInterrupt:
            self._ready = waiting
            done = round((self.time_s - origin) / step_s)
            raise Interrupted(
                rows.recording(done, pace=pace, incomplete=self._broken_off())
            ) from None
        except FmuError as error:
            raise RunError(
                str(error), rows.recording(done - 1, pace=pace, incomplete=str(error))
            ) from error
        self._ready = True
        return rows.recording(steps, pace=pace)

    # -- controlled steps -------------------------------------------------------------------

    def run_adaptive(
        self,
        stop_time_s: float,
        step_s: float,
        tolerance: float,
        algorithm: Algorithm = "settled",
        progress: Callable[[float], None] | None = None,
    ) -> Recording:
        """Run with step-size control and record on an even grid; the first row is the present.

        No step crosses an output instant, nor a sample instant of a slave that has a parameter
        `sample_period`.

        Args:
            stop_time_s: Time of the last output.
            step_s: Time between two outputs, the longest step.
            tolerance: Error allowed per step in every real number that is connected or recorded,
                relative to the larger of its value and its nominal value.
            algorithm: See `stepping`.
            progress: Called now and then with the time reached.

        Raises:
            FmuError: A slave cannot take steps back.
            RunError: A slave failed, or the tolerance cannot be reached; holds the recording.
            Interrupted: Ctrl-C; holds the recording up to then.
        """
        steps = self._steps(stop_time_s, step_s)
        if not (tolerance > 0 and np.isfinite(tolerance)):
            raise FmuError(f"tolerance = {tolerance:g}: needs a positive number, e.g. 1e-4.")
        if not self._stepping.one_rate:
            raise FmuError(
                "step-size control and periods of slaves exclude each other: give the slave a "
                "parameter sample_period, or use fixed steps."
            )
        for s in self.slaves:
            if not (s.interface.varies_step and s.interface.saves_state):
                raise FmuError(
                    f"{s.name} ({s.path.name}): step-size control needs "
                    f"canHandleVariableCommunicationStepSize and canGetAndSetFMUstate; this FMU "
                    f"says no. Use fixed steps."
                )
        advance, bus = self._stepping.algorithm(algorithm), self._bus
        ports = {n: bus.port(n) for n in bus.position}
        compared = [n for n, port in ports.items() if port.kind == "Real"]
        nominal = np.array([ports[n].nominal for n in compared])
        control = Control(compared, nominal, tolerance, SHORTEST * step_s, step_s)
        grids, rollback = self._sample_grids(), Rollback(bus)
        rows = _Rows(bus, steps + 1, self._trace)
        rows.add(self.time_s)
        origin = self.time_s
        self._ready = False
        try:
            for k in range(1, steps + 1):
                instant = min(origin + k * step_s, self._stop_s)
                advance_to(
                    instant, self.time_s, control, grids, advance, rollback, bus.positions(compared)
                )
                self.time_s = instant
                with np.errstate(invalid="ignore"):
                    bus.check(instant)
                rows.add(instant)
                if progress is not None and k % 100 == 0:
                    progress(instant)
        except KeyboardInterrupt:
            raise Interrupted(
                rows.recording(control.steps, control.rejected, incomplete=self._broken_off())
            ) from None
        except FmuError as error:
            why = str(error)
            raise RunError(
                why, rows.recording(control.steps, control.rejected, incomplete=why)
            ) from error
        finally:
            rollback.free()
        self._ready = True
        return rows.recording(control.steps, control.rejected)

    def _sample_grids(self) -> list[Grid]:
        sampled = [s for s in self.slaves if SAMPLE_PERIOD in s.ports]
        return [Grid(self._start_s, s.get(SAMPLE_PERIOD)) for s in sampled]

    def _broken_off(self) -> str:
        return f"interrupted at {self.time_s:g} s"

    def _steps(self, stop_time_s: float, step_s: float) -> int:
        """Number of steps until a time.

        Raises:
            FmuError: There is no such number, or nothing has been initialised.
        """
        if not step_s > 0 or not np.isfinite(step_s):
            raise FmuError(f"communication step {step_s:g} s must be positive, e.g. 0.001.")
        if not np.isfinite(stop_time_s):
            raise FmuError(f"stop time {stop_time_s:g} s must be a finite number.")
        if not self._ready:
            raise FmuError("the system is not initialised: call initialize() before run().")
        steps = round((stop_time_s - self.time_s) / step_s)
        if stop_time_s > self._stop_s:
            raise FmuError(
                f"{stop_time_s:g} s is beyond the stop time {self._stop_s:g} s that the FMUs were "
                f"initialised with: give a later one to initialize()."
            )
        missed_s = abs(self.time_s + steps * step_s - stop_time_s)
        if steps < 0 or missed_s > 1e-6 * step_s * max(1, steps):
            raise FmuError(
                f"from {self.time_s:g} s to {stop_time_s:g} s is not a whole number of steps of "
                f"{step_s:g} s."
            )
        return steps

    # -- end --------------------------------------------------------------------------------

    def close(self) -> None:
        """Free all slaves."""
        self._ready = False
        for s in self.slaves:
            s.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class _Rows:
    """The rows of a recording under way."""

    def __init__(self, bus: Bus, count: int, trace: SharedTrace | None) -> None:
        self._bus, self._filled = bus, 0
        width = len(bus.recorded)
        size = count * (1 + width)
        table = np.empty(size) if trace is None else trace.table(size)
        self._time, self._values = table[:count], table[count:].reshape(count, width)
        # Where everything on the bus is recorded, a copy does without the slower gather.
        everything = np.array_equal(bus.columns, np.arange(len(bus.values)))
        self._columns: NDArray[np.intp] | slice = slice(None) if everything else bus.columns

    def add(self, time_s: float) -> None:
        """Record the present; the time last, which says in a trace that the row is whole."""
        self._values[self._filled] = self._bus.values[self._columns]
        self._time[self._filled] = time_s
        self._filled += 1

    def recording(
        self, steps: int, rejected: int = 0, pace: Pace | None = None, incomplete: str = ""
    ) -> Recording:
        """What has been recorded so far."""
        return Recording(
            self._bus.recorded,
            self._time[: self._filled],
            self._values[: self._filled],
            steps,
            rejected,
            0.0 if pace is None else pace.lateness_s,
            incomplete,
        )
