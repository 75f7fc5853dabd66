"""Calls into an FMU library whose arguments are made once: 0.3 us instead of 8 us a call."""

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .interface import SCALARS, Port
from .trace import SharedTrace

Array = NDArray[np.float64]
Call = Callable[[], int]


class Transfer:
    """Moves the values of some variables between a float64 array and the FMU.

    Attributes:
        calls: One raw call per FMI type, its buffer, and the positions of the buffer's entries in
            the array; None: the buffer is the array.
    """

    def __init__(self, library: "Library", verb: str, ports: Sequence[Port], values: Array) -> None:
        self.calls: list[tuple[Call, NDArray[Any], NDArray[np.intp] | None]] = []
        kinds = dict.fromkeys(SCALARS[library.fmi][p.type] for p in ports)
        for suffix, dtype in kinds:
            chosen = [
                i for i, p in enumerate(ports) if SCALARS[library.fmi][p.type] == (suffix, dtype)
            ]
            whole = dtype is np.float64 and len(chosen) == len(ports)
            buffer = values if whole else np.zeros(len(chosen), dtype=dtype)
            references = [ports[i].reference for i in chosen]
            call = library.transfer(verb + suffix, references, buffer)
            self.calls.append((call, buffer, None if whole else np.array(chosen)))


class Library:
    """The loaded library of one FMU instance.

    Attributes:
        clock: Time of the step under way, s.
    """

    def __init__(self, fmu: Any, fmi: int, who: str = "", trace: SharedTrace | None = None) -> None:
        """Take an instance; `trace` tells others its calls, made in the name of a slave."""
        self.fmi, self._who, self._trace = fmi, who, trace
        self.clock = ctypes.c_double() if trace is None else trace.clock
        self._dll = fmu.dll
        self._component = ctypes.c_void_p.from_param(fmu.component)
        self._buffers: list[Any] = []

    def call(self, function: str, *arguments: Any) -> Call:
        """A function, named without `fmi2` or `fmi3`, with its arguments after the instance.

        Indexing the library gives a pointer without the argument types that FMPy has set on its
        own, and `from_param` what ctypes would make of an argument in each call: nothing is left
        to convert.
        """
        full = f"fmi{self.fmi}{function}"
        call = partial(self._dll[full], self._component, *arguments)
        if self._trace is None:
            return call
        return self._trace.traced(self._who, full, call)

    def transfer(self, function: str, references: Sequence[int], buffer: NDArray[Any]) -> Call:
        """A get or set function of variables."""
        vr = np.array(references, np.uint32)
        n = ctypes.c_size_t.from_param(len(vr))
        more = [] if self.fmi == 2 else [n]
        return self.call(function, self._pointer(vr), n, self._pointer(buffer), *more)

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
        """Address of an array, which lives as long as the library from here on."""
        self._buffers.append(array)
        return ctypes.c_void_p.from_param(array.ctypes.data)


class Step:
    """The doStep of one instance.

    Attributes:
        call: Steps from `time_s` over `step_s`, ctypes doubles set before.
        flags: What FMI 3 tells after a step: event, termination, early return; one byte each.
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
