"""Communication steps in C: the calls of one step as a table, many steps in one call from Python.

The common case: one rate and no algebraic loop. Numbers and errors are those of `stepping`, whose
loop in Python remains for all else and for machines where nothing can be compiled.
"""

import contextlib
import ctypes
import signal
import tempfile
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from twin.errors import FmuError

from .calls import SharedTrace, TracedCall
from .slave import Slave

Verb = Literal["set", "get", "step"]
_VERBS: tuple[Verb, ...] = ("set", "get", "step")
_TYPES = (
    *(np.float64, np.float32, np.int8, np.uint8, np.int16, np.uint16),
    *(np.int32, np.uint32, np.int64, np.uint64, np.bool_),
)
_NOT_FINITE = -1
PATIENCE_S = 0.02
"""Time after which Python has its turn, for Ctrl-C."""


class _Call(ctypes.Structure):
    """`Call` of stepping.c."""

    _fields_ = (
        ("verb", ctypes.c_int32),
        ("fmi", ctypes.c_int32),
        ("type", ctypes.c_int32),
        ("number", ctypes.c_int64),
        ("function", ctypes.c_void_p),
        ("instance", ctypes.c_void_p),
        ("references", ctypes.c_void_p),
        ("count", ctypes.c_size_t),
        ("buffer", ctypes.c_void_p),
        ("values", ctypes.c_void_p),
        ("positions", ctypes.c_void_p),
        ("time", ctypes.c_void_p),
        ("length", ctypes.c_void_p),
        ("reached", ctypes.c_void_p),
        ("flags", ctypes.c_void_p),
    )


class _Run(ctypes.Structure):
    """`Run` of stepping.c."""

    _fields_ = (
        ("calls", ctypes.POINTER(_Call)),
        ("n_calls", ctypes.c_int64),
        ("origin", ctypes.c_double),
        ("step", ctypes.c_double),
        ("stop", ctypes.c_double),
        ("done", ctypes.c_int64),
        ("last", ctypes.c_int64),
        ("every", ctypes.c_int64),
        ("values", ctypes.c_void_p),
        ("n_values", ctypes.c_int64),
        ("columns", ctypes.c_void_p),
        ("n_columns", ctypes.c_int64),
        ("times", ctypes.c_void_p),
        ("rows", ctypes.c_void_p),
        ("trace", ctypes.c_void_p),
        ("patience", ctypes.c_double),
        ("interrupted", ctypes.c_int32),
        ("status", ctypes.c_int32),
        ("spoilt", ctypes.c_int32),
    )


@cache
def library() -> Any:
    """The function `take_steps` of stepping.c; None where it cannot be compiled or loaded."""
    from fmus.builder import compile_library
    from fmus.platforms import DEFAULT, PLATFORMS, compilers

    platform, source = PLATFORMS[DEFAULT[0]], "stepping.c"
    text = (resources.files(__package__) / source).read_text()
    try:
        compiler = compilers((platform,))[platform.name]
        binary = compile_library("stepping", platform, compiler, {source: text}, (source,))
        with tempfile.TemporaryDirectory(prefix="uavtwin-") as folder:
            file = Path(folder, f"stepping{platform.suffix}")
            file.write_bytes(binary)
            function = ctypes.CDLL(str(file)).take_steps
    except (FmuError, OSError):
        return None
    function.argtypes, function.restype = [ctypes.POINTER(_Run)], ctypes.c_int64
    return function


@dataclass(frozen=True, slots=True)
class Times:
    """Communication points origin + k * step.

    Attributes:
        stop_s: Time that the last step does not exceed.
        every: Decimation of the rows, in steps.
    """

    origin_s: float
    step_s: float
    stop_s: float
    every: int


class CompiledSteps:
    """The calls of one step of a system."""

    def __init__(
        self,
        take_steps: Any,
        plan: Sequence[tuple[Verb, Slave]],
        values: NDArray[np.float64],
        parts: dict[str, NDArray[np.intp]],
        trace: SharedTrace | None,
    ) -> None:
        """Make the table.

        Args:
            take_steps: The function that `library` returns.
            plan: What a step does with which slave.
            values: Values of the bus.
            parts: Slave -> index in `values` of the source of each input.
            trace: Trace of the calls.
        """
        self._take_steps, self._trace, self._values = take_steps, trace, values
        self._alive: list[Any] = [values]
        self._of: list[tuple[Verb, Slave, Any]] = []
        calls: list[_Call] = []
        for verb, slave in plan:
            if verb == "step":
                calls.append(self._step(slave))
            else:
                calls += self._transfer(verb, slave, parts[slave.name])
        self._calls = (_Call * len(calls))(*calls)

    def _call(self, verb: Verb, slave: Slave, name: str, call: Any, **more: Any) -> _Call:
        self._of.append((verb, slave, call))
        function, instance = slave.library.addresses(name)
        number = 0 if self._trace is None else cast(TracedCall, call).number
        return _Call(
            verb=_VERBS.index(verb),
            fmi=slave.library.fmi,
            number=number,
            function=function,
            instance=instance,
            **more,
        )

    def _step(self, slave: Slave) -> _Call:
        doing = slave.doing
        return self._call(
            "step",
            slave,
            "DoStep",
            doing.call,
            time=ctypes.addressof(doing.time_s),
            length=ctypes.addressof(doing.step_s),
            reached=ctypes.addressof(doing.reached_s),
            flags=ctypes.addressof(doing.flags),
        )

    def _transfer(self, verb: Verb, slave: Slave, part: NDArray[np.intp]) -> Iterator[_Call]:
        transfer = slave.sets if verb == "set" else slave.gets
        values = self._values if verb == "set" else slave.outputs
        made = zip(transfer.calls, transfer.functions, strict=True)
        for (call, buffer, positions), (name, references) in made:
            if verb == "set":
                positions = part if positions is None else part[positions]
            alive = [references, buffer]
            if positions is not None:
                alive.append(np.ascontiguousarray(positions, np.int64))
            self._alive += alive
            yield self._call(
                verb,
                slave,
                name,
                call,
                type=_TYPES.index(buffer.dtype.type),
                references=references.ctypes.data,
                count=len(references),
                buffer=buffer.ctypes.data,
                values=values.ctypes.data,
                positions=None if positions is None else alive[2].ctypes.data,
            )

    def start(
        self,
        times: Times,
        columns: NDArray[np.intp],
        time_s: NDArray[np.float64],
        rows: NDArray[np.float64],
    ) -> "CompiledRun":
        """A run, which fills the rows from the second on.

        Args:
            times: When.
            columns: Index in `values` of each column.
            time_s: Time of each row.
            rows: Values of each row.
        """
        columns = np.ascontiguousarray(columns, np.int64)
        run = _Run(
            calls=self._calls,
            n_calls=len(self._calls),
            origin=times.origin_s,
            step=times.step_s,
            stop=times.stop_s,
            every=times.every,
            values=self._values.ctypes.data,
            n_values=len(self._values),
            columns=columns.ctypes.data,
            n_columns=len(columns),
            times=time_s.ctypes.data,
            rows=rows.ctypes.data,
            trace=None if self._trace is None else ctypes.addressof(self._trace.call),
            patience=PATIENCE_S,
        )
        return CompiledRun(self._take_steps, run, self._of, (columns, time_s, rows, self))


class CompiledRun:
    """A run in progress."""

    def __init__(
        self, take_steps: Any, run: _Run, of: Sequence[tuple[Verb, Slave, Any]], alive: Any
    ) -> None:
        self._take_steps, self._run, self._of, self._alive = take_steps, run, of, alive

    @property
    def done(self) -> int:
        """Steps taken."""
        return int(self._run.done)

    @property
    def rows(self) -> int:
        """Rows filled, without the first."""
        return self.done // int(self._run.every)

    def after(self, steps: int) -> float:
        """Time after a number of steps, s."""
        return float(self._run.origin + steps * self._run.step)

    def advance(self, last: int) -> bool:
        """Steps up to the one of a number, or fewer; whether all values are finite.

        Raises:
            FmuError: A slave failed.
            KeyboardInterrupt: Ctrl-C, between two steps.
        """
        self._run.last = last
        with _after_a_step(self._run):
            code = self._take_steps(self._run)
        if code > 0:
            verb, slave, call = self._of[code - 1]
            status = self._run.status
            if self._run.spoilt:
                raise cast(TracedCall, call).spoilt()
            if verb == "step":
                slave.judge_step(status)
            else:
                slave.judge(status, f"{verb} {'inputs' if verb == 'set' else 'outputs'}")
        return bool(code != _NOT_FINITE)


@contextlib.contextmanager
def _after_a_step(run: _Run) -> Iterator[None]:
    """Ctrl-C ends the steps after the present one, also where it meets Python code of an FMU."""
    here = threading.current_thread() is threading.main_thread()
    if not here or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def note(number: int, frame: Any) -> None:
        """Handler of SIGINT: the C loop reads the mark."""
        run.interrupted = 1

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if run.interrupted:
        raise KeyboardInterrupt
