"""What a slave is doing, written into memory that another process reads even when it is dead."""

import ctypes
import mmap
import os
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.errors import FmuError

Array = NDArray[np.float64]
HEADER = mmap.ALLOCATIONGRANULARITY
"""Bytes before the table; a clock, whether a call is under way, and which."""
_CLOCK, _BUSY, _CALL, _END = 0, 8, 9, 256
_ONE, _QUARTER, _MORE, _TINY = 1.0, 2.0**-54, 1.5 * 2.0**-53, 5e-324
_NEXT = 1.0 + 2.0**-52


class Board:
    """The written side: a header and a table in one file.

    Attributes:
        clock: Time of the call under way, s.
    """

    def __init__(self, file: int) -> None:
        """Take an open file, which holds the header at least."""
        self._file, self._pid = file, os.getpid()
        self._memory = mmap.mmap(file, HEADER)
        self.clock = ctypes.c_double.from_buffer(self._memory, _CLOCK)

    def table(self, count: int) -> Array:
        """That many NaN after the header, in the place of those before."""
        os.ftruncate(self._file, HEADER)
        size = 8 * count
        os.ftruncate(self._file, HEADER + size)
        if not size:
            return np.zeros(0)
        table = np.frombuffer(mmap.mmap(self._file, size, offset=HEADER), dtype=np.float64)
        table[:] = np.nan
        return table

    def watched(self, who: str, function: str, call: Callable[[], Any]) -> Callable[[], Any]:
        """A call that is announced before, and whose traces in this process are looked for after.

        Raises, when it is called:
            FmuError: The FMU changed how this process calculates.
        """
        text = f"{who}\n{function}".encode()[: _END - _CALL]
        announced = b"\1" + text.ljust(_END - _CALL, b"\0")
        memory, pid, getpid = self._memory, self._pid, os.getpid

        def watched() -> Any:
            memory[_BUSY:_END] = announced
            result = call()
            memory[_BUSY] = 0
            if getpid() != pid:
                os._exit(0)  # a copy of this process, which the FMU has made
            if not _usual_arithmetic():
                raise FmuError(
                    f"{who}: {function} at {self.clock.value:g} s: changed how the processor "
                    f"rounds or treats small numbers, and with that the results of others. Ask "
                    f"who made the FMU."
                )
            return result

        return watched


def _usual_arithmetic() -> bool:
    """Rounding to nearest, and numbers below the smallest normal one kept."""
    return _ONE + _QUARTER == _ONE and _ONE + _MORE == _NEXT and _TINY + _TINY > _TINY


class Notice(NamedTuple):
    """What a board says.

    Attributes:
        clock_s: Time of the last call.
        busy: Whether it has not returned.
        who: Slave and file, "" before the first call.
        function: Of the FMU.
    """

    clock_s: float
    busy: bool
    who: str
    function: str


def read_board(file: int) -> Notice:
    """The reading side."""
    header = os.pread(file, _END, 0)
    (clock_s,) = struct.unpack_from("d", header, _CLOCK)
    text = header[_CALL:].partition(b"\0")[0].decode(errors="replace")
    who, _, function = text.partition("\n")
    return Notice(clock_s, header[_BUSY] != 0, who, function)


def read_table(file: int, width: int) -> tuple[Array, Array]:
    """Times and rows that have been written, shapes (n,) and (n, width)."""
    count = max(0, os.fstat(file).st_size - HEADER) // 8
    flat = np.frombuffer(_read(file, 8 * count, HEADER), dtype=np.float64)
    rows = count // (1 + width)
    time_s, values = flat[:rows], flat[rows:].reshape(rows, width)
    filled = int(np.argmax(np.isnan(time_s))) if np.isnan(time_s).any() else rows
    return time_s[:filled].copy(), values[:filled].copy()


def _read(file: int, size: int, offset: int) -> bytes:
    """All of a part of a file."""
    parts = []
    while size > 0 and (part := os.pread(file, min(size, 2**30), offset)):
        parts.append(part)
        size, offset = size - len(part), offset + len(part)
    return b"".join(parts)
