"""Calls into an FMU library, and a trace of them for another process.

The arguments of a call are created once: 0.3 us instead of 8 us per call.

The trace shows the present call of a slave even when its process is dead. It is one file of fixed
size; each recording is another one of the requested size. The reading process creates them and
seals their sizes, so that no other process can truncate or extend them; it never reads more than it
requested.
"""

import ctypes
import fcntl
import mmap
import os
import struct
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.errors import FmuError

from .interface import SCALARS, Port

Array = NDArray[np.float64]
_LEAD = 4096
"""Bytes before all content: erroneous writes of an FMU to open files end there. A mapping in Python
keeps its file open."""
_CLOCK, _CALL, _NAMES, _NAME_BYTES, _MOST_NAMES = _LEAD, _LEAD + 8, _LEAD + 256, 256, 4095
"""Offsets in the trace, and sizes, bytes."""
HEADER = _NAMES + _MOST_NAMES * _NAME_BYTES
"""Size of the trace, bytes: the clock, the number of the call, and the list of calls."""
ONE, QUARTER, MORE, FOLLOWING, TINY = 1.0, 2.0**-54, 1.5 * 2.0**-53, 1.0 + 2.0**-52, 5e-324
"""Test values: a process rounds to nearest if ONE + QUARTER + MORE is FOLLOWING, and keeps
subnormal numbers if TINY + TINY is not 0. Variables, which are added at each test; a function call
would cost a step as much as the sums."""


_FENV_BYTES = 256
"""Upper bound of the size of C99's `fenv_t`, the floating-point environment of a thread."""


class SharedTrace:
    """Writer of the trace.

    Attributes:
        clock: Time of the present call, s.
        call: Number of the call; negative after it has returned.
    """

    def __init__(self, file: int) -> None:
        """Map an open file of `HEADER` bytes, which is closed."""
        self._table, self._pid = -1, os.getpid()
        self._memory = _mapped(file, HEADER)
        os.close(file)
        self._numbers: dict[str, int] = {}
        self._arithmetic = ctypes.create_string_buffer(_FENV_BYTES)
        self._libm = ctypes.CDLL(None)
        self._libm.fegetenv(self._arithmetic)
        self.call = ctypes.c_int64.from_buffer(self._memory, _CALL)
        self.clock = ctypes.c_double.from_buffer(self._memory, _CLOCK)

    def take_table(self, file: int) -> None:
        """Set the open file of the next recording."""
        self._table = file

    def table(self, count: int) -> Array:
        """Array of NaN in the file of the recording, which is closed.

        Raises:
            FmuError: There is none of this size.
        """
        file, self._table = self._table, -1
        try:
            if file < 0 or os.fstat(file).st_size != table_bytes(count):
                raise FmuError(f"no file for a recording of {count} numbers was given")
            if not count:
                return np.zeros(0)
            memory = _mapped(file, table_bytes(count))
            table = np.frombuffer(memory, dtype=np.float64, offset=_LEAD)
        finally:
            if file >= 0:
                os.close(file)
        table[:] = np.nan
        return table

    def check_process(self) -> None:
        """End this process if it is a copy, made by an FMU, of the process that wrote the trace."""
        if os.getpid() != self._pid:
            os._exit(0)

    def traced(self, who: str, function: str, call: Callable[[], Any]) -> "TracedCall":
        """The call, recorded in the trace before it is made; see `TracedCall`."""
        return TracedCall(self, who, function, call)

    def restore_arithmetic(self) -> None:
        """Restore rounding and subnormal handling as before the first call of an FMU."""
        self._libm.fesetenv(self._arithmetic)

    def number(self, text: str) -> int:
        """Number of a call, from 1; those beyond the last have no name."""
        number = self._numbers.setdefault(text, len(self._numbers) + 1)
        if number <= _MOST_NAMES:
            at = _NAMES + (number - 1) * _NAME_BYTES
            name = text.encode()[:_NAME_BYTES].ljust(_NAME_BYTES, b"\0")
            self._memory[at : at + _NAME_BYTES] = name
        return number


class TracedCall:
    """A call that writes its number to a trace before, and marks its return after.

    Attributes:
        number: Number of the call.
        bare: The call only, for a loop that writes the number itself.
    """

    def __init__(
        self, trace: SharedTrace, who: str, function: str, bare: Callable[[], Any]
    ) -> None:
        self._trace, self._slot, self.bare = trace, trace.call, bare
        self._who, self._function = who, function
        self.number = trace.number(f"{who}\n{function}")

    def __call__(self) -> Any:
        """Make the call.

        Raises:
            FmuError: The FMU changed the floating-point environment of this process.
        """
        self._slot.value = self.number
        result = self.bare()
        self._slot.value = -self.number
        if ONE + QUARTER + MORE == FOLLOWING and TINY + TINY:
            return result
        raise self.spoilt()

    def spoilt(self) -> FmuError:
        """Error for a call that has changed the floating-point environment, which is restored, so
        that later calls are not blamed."""
        self._trace.restore_arithmetic()
        return FmuError(
            f"{self._who}: {self._function} at {self._trace.clock.value:g} s: changed how the "
            f"processor rounds or treats small numbers, and with that the results of others. Ask "
            f"who made the FMU."
        )


def _mapped(file: int, size: int) -> mmap.mmap:
    """Mapping of a file that is not inherited by a copy of this process, made by an FMU: the copy
    crashes when it writes there."""
    memory = mmap.mmap(file, size)
    if hasattr(mmap, "MADV_DONTFORK"):  # Linux
        memory.madvise(mmap.MADV_DONTFORK)
    return memory


class TraceEntry(NamedTuple):
    """Content of a trace.

    Attributes:
        clock_s: Time of the last call.
        busy: Whether the call has not returned.
        who: Slave and file, "" before the first call.
        function: Name of the FMU function.
    """

    clock_s: float
    busy: bool
    who: str
    function: str


def shared_file(size: int) -> int:
    """A new unnamed file of zeros; where the system can, its size is sealed.

    It uses no memory before it is written.

    Raises:
        OSError: The size is not available.
    """
    if not hasattr(os, "memfd_create"):
        with tempfile.TemporaryFile() as stream:
            file = os.dup(stream.fileno())
        os.ftruncate(file, size)
        return file
    file = os.memfd_create("uavtwin", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(file, size)
        seals = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL
        fcntl.fcntl(file, fcntl.F_ADD_SEALS, seals)
    except BaseException:
        os.close(file)
        raise
    return file


def read_trace(file: int) -> TraceEntry:
    """Content of a trace, for the reading process."""
    clock_s, number = struct.unpack("dq", os.pread(file, 16, _CLOCK).ljust(16, b"\0"))
    at = _NAMES + (abs(number) - 1) * _NAME_BYTES
    name = os.pread(file, _NAME_BYTES, at) if 0 < abs(number) <= _MOST_NAMES else b""
    who, _, function = name.rstrip(b"\0").decode(errors="replace").partition("\n")
    return TraceEntry(clock_s, number > 0, who, function)


def table_bytes(count: int) -> int:
    """Size of the file of a recording with a number of values."""
    return _LEAD + 8 * count


def read_table(file: int, times_s: Array, width: int) -> tuple[Array, Array]:
    """Written times and rows, shapes (n,) and (n, width).

    The rows end before the first whose time is wrong: it was not written, or overwritten.

    Args:
        file: File of the recording.
        times_s: Requested times of the rows; no more is read, however long the file is.
        width: Number of values in a row.
    """
    rows = len(times_s)
    flat = np.full(rows * (1 + width), np.nan)
    view: Any = flat.view(np.uint8)
    done = 0
    while done < len(view) and (part := os.preadv(file, [view[done : done + 2**30]], _LEAD + done)):
        done += part
    time_s, values = flat[:rows], flat[rows:].reshape(rows, width)
    good = time_s == times_s
    filled = rows if good.all() else int(np.argmin(good))
    return time_s[:filled].copy(), values[:filled].copy()


Call = Callable[[], int]


class Transfer:
    """Moves the values of some variables between a float64 array and the FMU.

    Attributes:
        calls: One raw call per FMI type, its buffer, and the indices of the buffer's entries in the
            array; None: the buffer is the array.
        functions: Function of each call and its value references.
    """

    def __init__(self, library: "Library", verb: str, ports: Sequence[Port], values: Array) -> None:
        self.calls: list[tuple[Call, NDArray[Any], NDArray[np.intp] | None]] = []
        self.functions: list[tuple[str, NDArray[np.uint32]]] = []
        kinds = dict.fromkeys(SCALARS[library.fmi][p.type] for p in ports)
        for suffix, dtype in kinds:
            chosen = [
                i for i, p in enumerate(ports) if SCALARS[library.fmi][p.type] == (suffix, dtype)
            ]
            whole = dtype is np.float64 and len(chosen) == len(ports)
            buffer = values if whole else np.zeros(len(chosen), dtype=dtype)
            references = np.array([ports[i].reference for i in chosen], np.uint32)
            call = library.transfer(verb + suffix, references, buffer)
            self.calls.append((call, buffer, None if whole else np.array(chosen)))
            self.functions.append((verb + suffix, references))


class Library:
    """The loaded library of one FMU instance.

    Attributes:
        clock: Time of the present step, s.
    """

    def __init__(self, fmu: Any, fmi: int, who: str = "", trace: SharedTrace | None = None) -> None:
        """Set up an instance; `trace` records its calls under the name of a slave."""
        self.fmi, self._who, self._trace = fmi, who, trace
        self.clock = ctypes.c_double() if trace is None else trace.clock
        self._dll = fmu.dll
        self._component = ctypes.c_void_p.from_param(fmu.component)
        self._instance = ctypes.c_void_p(fmu.component).value
        self._buffers: list[Any] = []

    def call(self, function: str, *arguments: Any) -> Call:
        """A function, named without `fmi2` or `fmi3`, with its arguments after the instance.

        Indexing the library gives a pointer without the argument types that FMPy has set, and
        `from_param` the converted arguments: no conversion remains in each call.
        """
        full = f"fmi{self.fmi}{function}"
        call = partial(self._dll[full], self._component, *arguments)
        if self._trace is None:
            return call
        return self._trace.traced(self._who, full, call)

    def addresses(self, function: str) -> tuple[int | None, int | None]:
        """Addresses of a function and of the instance."""
        full = self._dll[f"fmi{self.fmi}{function}"]
        return ctypes.cast(full, ctypes.c_void_p).value, self._instance

    def transfer(self, function: str, references: NDArray[np.uint32], buffer: NDArray[Any]) -> Call:
        """A get or set function of variables."""
        n = ctypes.c_size_t.from_param(len(references))
        more = [] if self.fmi == 2 else [n]
        return self.call(function, self._pointer(references), n, self._pointer(buffer), *more)

    def tangent(self, outputs: Sequence[Port], known: Port, result: Array) -> Call:
        """The directional derivative of outputs for a unit change of one variable."""
        unknown = np.array([p.reference for p in outputs], np.uint32)
        vr, seed = np.array([known.reference], np.uint32), np.ones(1)
        m, one = (ctypes.c_size_t.from_param(n) for n in (len(unknown), 1))
        head = [self._pointer(unknown), m, self._pointer(vr), one]
        tail = [self._pointer(seed), self._pointer(result)]
        if self.fmi == 3:
            tail = [tail[0], one, tail[1], m]
        return self.call("GetDirectionalDerivative", *head, *tail)

    def _pointer(self, array: NDArray[Any]) -> Any:
        """Address of an array, which the library keeps alive."""
        self._buffers.append(array)
        return ctypes.c_void_p.from_param(array.ctypes.data)


class Step:
    """The doStep of one instance.

    Attributes:
        call: Step from `time_s` over `step_s`, ctypes doubles that are set before.
        flags: Flags of FMI 3 after a step: event, termination, early return; one byte each.
        reached_s: Time that the FMU has reached, FMI 3.
    """

    def __init__(self, library: Library) -> None:
        self.time_s, self.step_s = library.clock, ctypes.c_double()
        self.flags, self.reached_s = ctypes.c_uint32(), ctypes.c_double()
        if library.fmi == 2:
            tail: list[Any] = [ctypes.c_int.from_param(0)]  # a rollback may follow
        else:
            flags = [ctypes.byref(self.flags, i) for i in range(3)]
            tail = [ctypes.c_bool.from_param(False), *flags, ctypes.byref(self.reached_s)]
        self.call = library.call("DoStep", self.time_s, self.step_s, *tail)
