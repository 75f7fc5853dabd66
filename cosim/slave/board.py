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
_CLOCK, _CALL, _NAMES, _NAME_BYTES, _MOST_NAMES = 128, 136, 256, 256, 4095
HEADER = _NAMES + _MOST_NAMES * _NAME_BYTES
"""Bytes before the table: the clock, the number of the call, and what calls there are. What an FMU
writes into open files by mistake lands before the clock."""
ONE, QUARTER, MORE, FOLLOWING, TINY = 1.0, 2.0**-54, 1.5 * 2.0**-53, 1.0 + 2.0**-52, 5e-324
"""A process rounds to nearest if ONE + QUARTER + MORE is FOLLOWING, and keeps what is smaller than
the smallest normal number if TINY + TINY is not 0. Variables, which are added where they are asked
for; not a function, whose call would cost a step as much as the sums."""


_FENV_BYTES = 256
"""No less than the size of C99's `fenv_t`, the floating-point environment of a thread."""


class Board:
    """The written side: a header and a table in one file.

    Attributes:
        clock: Time of the call under way, s.
        call: Its number; negative after it has returned.
    """

    def __init__(self, file: int) -> None:
        """Take an open file, which holds the header at least."""
        self._file, self._pid = file, os.getpid()
        self._memory = _mapped(file, HEADER)
        self._numbers: dict[str, int] = {}
        self._arithmetic = ctypes.create_string_buffer(_FENV_BYTES)
        self._libm = ctypes.CDLL(None)
        self._libm.fegetenv(self._arithmetic)
        self.call = ctypes.c_int64.from_buffer(self._memory, _CALL)
        self.clock = ctypes.c_double.from_buffer(self._memory, _CLOCK)

    def table(self, count: int) -> Array:
        """That many NaN after the header, in the place of those before."""
        os.ftruncate(self._file, HEADER)
        size = 8 * count
        os.ftruncate(self._file, HEADER + size)
        if not size:
            return np.zeros(0)
        table = np.frombuffer(_mapped(self._file, size, HEADER), dtype=np.float64)
        table[:] = np.nan
        return table

    def check_process(self) -> None:
        """End this process if it is a copy, made by an FMU, of that which wrote the board."""
        if os.getpid() != self._pid:
            os._exit(0)

    def told(self, who: str, function: str, call: Callable[[], Any]) -> "Told":
        """A call that is told before; whether it changed how this process calculates is looked for
        after."""
        return Told(self, who, function, call)

    def restore_arithmetic(self) -> None:
        """Round and treat small numbers as before the first call of an FMU."""
        self._libm.fesetenv(self._arithmetic)

    def number(self, text: str) -> int:
        """Of a call, from 1 on; those beyond the last have no name."""
        number = self._numbers.setdefault(text, len(self._numbers) + 1)
        if number <= _MOST_NAMES:
            at = _NAMES + (number - 1) * _NAME_BYTES
            name = text.encode()[:_NAME_BYTES].ljust(_NAME_BYTES, b"\0")
            self._memory[at : at + _NAME_BYTES] = name
        return number


class Told:
    """A call that writes its number on a board before, and that it has returned after.

    Attributes:
        number: Of the call.
        bare: The call alone, for a loop that writes the number itself.
    """

    def __init__(self, board: Board, who: str, function: str, bare: Callable[[], Any]) -> None:
        self._board, self._slot, self.bare = board, board.call, bare
        self._who, self._function = who, function
        self.number = board.number(f"{who}\n{function}")

    def __call__(self) -> Any:
        """Make the call.

        Raises:
            FmuError: The FMU changed how this process calculates.
        """
        self._slot.value = self.number
        result = self.bare()
        self._slot.value = -self.number
        if ONE + QUARTER + MORE == FOLLOWING and TINY + TINY:
            return result
        raise self.spoilt()

    def spoilt(self) -> FmuError:
        """Error for a call that has changed how this process calculates, which is undone: what
        others do from here on, and the end of the run, is not held against them."""
        self._board.restore_arithmetic()
        return FmuError(
            f"{self._who}: {self._function} at {self._board.clock.value:g} s: changed how the "
            f"processor rounds or treats small numbers, and with that the results of others. Ask "
            f"who made the FMU."
        )


def _mapped(file: int, size: int, offset: int = 0) -> mmap.mmap:
    """Part of a file, which a copy of this process, made by an FMU, does not have: it ends where it
    writes there."""
    memory = mmap.mmap(file, size, offset=offset)
    if hasattr(mmap, "MADV_DONTFORK"):  # Linux
        memory.madvise(mmap.MADV_DONTFORK)
    return memory


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
    clock_s, number = struct.unpack("dq", os.pread(file, 16, _CLOCK))
    at = _NAMES + (abs(number) - 1) * _NAME_BYTES
    name = os.pread(file, _NAME_BYTES, at) if 0 < abs(number) <= _MOST_NAMES else b""
    who, _, function = name.rstrip(b"\0").decode(errors="replace").partition("\n")
    return Notice(clock_s, number > 0, who, function)


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
