"""The co-simulation master: loads, initialises and runs a system; `stepping` has the algorithms.

In real time, simulated time does not run ahead of the clock.

Adaptive steps are controlled by comparing one step with two half steps, with rollback. The coupling
holds inputs over a step, so it is of first order: the difference between one step of h and two of
h/2 estimates the error of the latter, whose result is retained. Steps end at every output instant
and at every sample instant of a slave, and never cross one.

Source: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, sec. II.4; for
co-simulation, Schierz, Arnold & Clauss, Co-simulation with communication step size control in an
FMI compatible master algorithm, Modelica 2012.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from twin.errors import FmuError

from .calls import SharedTrace
from .compiled import CompiledRun, Times
from .recording import Interrupted, Recording, RunError
from .slave import SavedState, Slave, TracedSlave
from .stepping import Algorithm, Bus, Stepping
from .system import System


class Rollback:
    """One saved state of all slaves and of the bus, overwritten by each `keep`."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self._states: dict[str, SavedState] = {}

    def keep(self) -> None:
        """Save the present state.

        Raises:
            FmuError: A slave cannot save its state.
        """
        for name, s in self.bus.slaves.items():
            self._states[name] = s.save(self._states.get(name))
        self._values = self.bus.values.copy()

    def back(self) -> None:
        """Return to the saved state."""
        for name, s in self.bus.slaves.items():
            s.restore(self._states[name])
        self.bus.values[:] = self._values

    def free(self) -> None:
        """Free the saved state."""
        for name, state in self._states.items():
            self.bus.slaves[name].free(state)
        self._states.clear()


Array = NDArray[np.float64]
Advance = Callable[[float, float], None]
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0
"""`fac`, `facmin` and `facmax` of Hairer, Norsett & Wanner, sec. II.4."""
SAMPLE_PERIOD = "sample_period"
"""Parameter that marks a sampled slave: its period, s."""
ON_GRID = 1e-6
"""Distance of a time from an instant, in periods, below which they are equal: times have rounding
errors."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Instants origin + k * period that no step crosses."""

    origin_s: float
    period_s: float

    def after(self, time_s: float) -> float:
        """First instant after a time."""
        k = np.floor((time_s - self.origin_s) / self.period_s + ON_GRID) + 1
        return float(self.origin_s + k * self.period_s)


@dataclass
class Control:
    """Step-size control.

    Attributes:
        names: Names of the compared signals.
        nominal: Typical magnitude of each signal, shape (n,).
        tolerance: Largest error per step, relative to the larger of value and nominal value.
        shortest_s: Step length below which the run is aborted.
        step_s: Length of the next step.
        steps: Steps accepted, each of two halves.
        rejected: Number of rejected steps.
    """

    names: Sequence[str]
    nominal: Array
    tolerance: float
    shortest_s: float
    step_s: float
    steps: int = field(default=0, init=False)
    rejected: int = field(default=0, init=False)

    def length(self, left_s: float) -> float:
        """Length of the next step, such that no very short step remains before the next instant."""
        if self.step_s >= left_s * (1 - 1e-9):
            return left_s
        return min(self.step_s, left_s / 2)

    def accepts(self, time_s: float, tried_s: float, whole: Array, halves: Array) -> bool:
        """Accept or reject a step by its two results and set the next length.

        Raises:
            FmuError: A step would become too short.
        """
        with np.errstate(invalid="ignore"):
            scale = np.maximum(self.nominal, np.abs(halves))
            error = np.abs(whole - halves) / scale / self.tolerance
        error[np.isnan(error)] = np.inf  # a shorter step may remain finite
        ratio = float(error.max(initial=0.0))
        better_s = tried_s * SAFETY / np.sqrt(ratio) if ratio > 0 else np.inf
        if ratio <= 1:
            # A step shortened by an instant is no evidence against the longer planned step.
            longest_s = GROW * max(tried_s, self.step_s)
            self.steps += 1
        else:
            longest_s = tried_s
            self.rejected += 1
        self.step_s = float(np.clip(better_s, SHRINK * tried_s, longest_s))
        if ratio > 1 and self.step_s < self.shortest_s:
            raise FmuError(
                f"step-size control at {time_s:g} s: with a step of {tried_s:.3g} s the error of "
                f"{self.names[int(error.argmax())]} is still {ratio:.3g} times the tolerance. Does "
                f"it jump? Use the algorithm 'settled', a looser tolerance or fixed steps."
            )
        return ratio <= 1


def advance_to(
    instant_s: float,
    time_s: float,
    control: Control,
    grids: Sequence[Grid],
    advance: Advance,
    system: Rollback,
    compared: NDArray[np.intp],
) -> None:
    """Adaptive steps from a time to an instant."""
    values = system.bus.values
    while time_s < instant_s:
        end_s = min([instant_s, *(g.after(time_s) for g in grids)])
        system.keep()
        while True:
            h = control.length(end_s - time_s)
            advance(time_s, h)
            whole = values[compared]
            system.back()
            advance(time_s, h / 2)
            advance(time_s + h / 2, h / 2)
            if control.accepts(time_s, h, whole, values[compared]):
                break
            system.back()
        time_s = end_s if h == end_s - time_s else time_s + h


class Pace:
    """Waits at communication points until the clock has reached simulated time.

    Every deadline is counted from the first one, so one long wait does not delay later ones.

    Attributes:
        lateness_s: Largest delay of a communication point behind the clock.
    """

    def __init__(self, factor: float, start_time_s: float) -> None:
        self._factor, self._start_time_s = factor, start_time_s
        self._begin = time.perf_counter()
        self.lateness_s = 0.0

    def wait(self, time_s: float) -> None:
        """Wait until the clock reaches a simulated time; returns at once when late."""
        due = self._begin + (time_s - self._start_time_s) / self._factor
        ahead_s = due - time.perf_counter()
        if ahead_s > 0:
            time.sleep(ahead_s)
        else:
            self.lateness_s = max(self.lateness_s, -ahead_s)


__all__ = ["Algorithm", "Interrupted", "Master", "Recording", "RunError"]

SHORTEST = 1e-9
"""Shortest step of the step-size control, in output steps."""


class Master:
    """Loads a system once and runs it any number of times; a context manager.

    Attributes:
        slaves: Slaves in the order of the system.
        record_names: "slave.variable" of each recorded column.
        time_s: Present time.
    """

    def __init__(
        self,
        system: System,
        record: Sequence[str] | None = None,
        trace: SharedTrace | None = None,
        compiled: bool = True,
    ) -> None:
        """Load the FMUs.

        Args:
            system: System to run.
            record: Names "slave.variable" of outputs to record; None: all scalars.
            trace: Trace of the present calls and the recording for another process.
            compiled: Whether fixed steps are taken in C where they can be; the numbers are the
                same.

        Raises:
            FmuError: A file, a name, a unit or a connection is wrong.
        """
        self.system, self._trace, self._compiled = system, trace, compiled
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
        """Bus and algorithms for the present instances, whose addresses they use."""
        self._bus = Bus(self.system, {s.name: s for s in self.slaves}, self._record)
        self._stepping = Stepping(self._bus)

    def _reset(self) -> None:
        """Reset all slaves to the instantiated state; those that cannot are instantiated again."""
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
        """Set start values and initialise all slaves at a time, also after a run.

        Args:
            start_time_s: Time of the first communication point; None: the system's.
            starts: Start values in addition to the system's, "slave.variable" -> value.
            stop_time_s: Stop time of the slaves, which no run exceeds; None: they get none.

        Raises:
            FmuError: A start value is wrong, a slave refused, a loop has no solution, or an output
                is not finite.
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
            s.read_outputs()  # initial guess for loops
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
        """Step until a time; the first row is the present state.

        Args:
            stop_time_s: Time of the last communication point.
            step_s: Base communication step.
            algorithm: Algorithm of `stepping`.
            every: Decimation of the recording, in steps.
            progress: Called regularly with the time reached.
            realtime: Simulated seconds per second of the clock, 1 for real time; None: as fast
                as possible.

        Raises:
            FmuError: The step is not positive, or the time is past.
            RunError: A slave failed or returned a value that is not finite; has the recording.
            Interrupted: Ctrl-C; has the recording up to then. Between two steps, where steps in C
                end and a run in real time spends most of its time, the system can be continued.
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
        fast = self._compiled_run(algorithm, step_s, every, rows) if pace is None else None
        self._ready = waiting = False
        done = 0
        try:
            with np.errstate(invalid="ignore"):  # `check` tests for finite values
                while done < steps:
                    if fast is not None:
                        self._advance(fast, min(steps, done - done % 1000 + 1000), rows)
                        done = fast.done
                    else:
                        step(self.time_s, min(step_s, self._stop_s - self.time_s))
                        reached_s = origin + (done + 1) * step_s
                        bus.check(reached_s)
                        self.time_s = reached_s
                        done += 1
                        if done % every == 0:
                            rows.add(reached_s)
                    if pace is not None:
                        waiting = True
                        pace.wait(self.time_s)
                        waiting = False
                    if progress is not None and done % 1000 == 0:
                        progress(self.time_s)
        except KeyboardInterrupt:
            done = round((self.time_s - origin) / step_s)
            self._ready = waiting or (fast is not None and fast.done == done)
            raise Interrupted(
                rows.recording(done, pace=pace, incomplete=self._broken_off())
            ) from None
        except FmuError as error:
            done = round((self.time_s - origin) / step_s)
            why = str(error)
            raise RunError(why, rows.recording(done, pace=pace, incomplete=why)) from error
        self._ready = True
        return rows.recording(steps, pace=pace)

    def _compiled_run(
        self, algorithm: str, step_s: float, every: int, rows: "_Rows"
    ) -> CompiledRun | None:
        """A run in C; None where there is none."""
        if not self._compiled:
            return None
        calls = self._stepping.compiled(algorithm, self._trace)
        if calls is None:
            return None
        times = Times(self.time_s, step_s, self._stop_s, every)
        return calls.start(times, self._bus.columns, *rows.table)

    def _advance(self, run: CompiledRun, last: int, rows: "_Rows") -> None:
        """Steps in C, at most up to the one of a number."""
        try:
            finite = run.advance(last)
        finally:
            self.time_s, rows.filled = run.after(run.done), 1 + run.rows
        if not finite:
            self._bus.check(run.after(run.done + 1))

    # -- controlled steps -------------------------------------------------------------------

    def run_adaptive(
        self,
        stop_time_s: float,
        step_s: float,
        tolerance: float,
        algorithm: Algorithm = "settled",
        progress: Callable[[float], None] | None = None,
    ) -> Recording:
        """Run with step-size control, recording on a uniform grid from the present state on.

        No step crosses an output instant, nor a sample instant of a slave that has a parameter
        `sample_period`.

        Args:
            stop_time_s: Time of the last output.
            step_s: Time between two outputs, the longest step.
            tolerance: Largest error per step of every real number that is connected or recorded,
                relative to the larger of its value and its nominal value.
            algorithm: Algorithm of `stepping`.
            progress: Called regularly with the time reached.

        Raises:
            FmuError: A slave does not support rollback.
            RunError: A slave failed, or the tolerance cannot be reached; has the recording.
            Interrupted: Ctrl-C; has the recording up to then.
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
            FmuError: There is no such number, or the system is not initialised.
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
    """The rows of a recording in progress.

    Attributes:
        table: Times and values.
        filled: Number of rows that are recorded.
    """

    def __init__(self, bus: Bus, count: int, trace: SharedTrace | None) -> None:
        self._bus, self.filled = bus, 0
        width = len(bus.recorded)
        size = count * (1 + width)
        table = np.empty(size) if trace is None else trace.table(size)
        self._time, self._values = table[:count], table[count:].reshape(count, width)
        self.table = self._time, self._values
        # Where everything on the bus is recorded, a plain copy replaces the slower gather.
        everything = np.array_equal(bus.columns, np.arange(len(bus.values)))
        self._columns: NDArray[np.intp] | slice = slice(None) if everything else bus.columns

    def add(self, time_s: float) -> None:
        """Record the present state; the time last, which marks the row in a trace as complete."""
        self._values[self.filled] = self._bus.values[self._columns]
        self._time[self.filled] = time_s
        self.filled += 1

    def recording(
        self, steps: int, rejected: int = 0, pace: Pace | None = None, incomplete: str = ""
    ) -> Recording:
        """Recording of all rows so far."""
        return Recording(
            self._bus.recorded,
            self._time[: self.filled],
            self._values[: self.filled],
            steps,
            rejected,
            0.0 if pace is None else pace.lateness_s,
            incomplete,
        )
