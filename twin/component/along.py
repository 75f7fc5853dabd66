"""CasADi functions along a record, some thousand rows at a time: memory except for the results does
not grow with its length.

One thread at a time builds CasADi's expressions: CasADi releases Python's lock while it works,
which is safe for evaluation but not for construction: two threads that build at once may crash the
process. Where threads run in parallel, as in live flights, each one that builds, or calls a
function with CasADi's own matrices, holds this lock.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

BUILDING = threading.RLock()
"""Lock for the construction of expressions and functions."""


Array = NDArray[np.float64]
CHUNK = 1024
"""Rows at a time."""
STEPS = 128
"""Steps at a time, each of which continues from the one before: for a thousand, CasADi's set-up
would take as long as a second of flight."""


class Along:
    """Repeated application of a step along a record, one block of rows after another."""

    def __init__(self, step: ca.Function) -> None:
        """Set up for a step function.

        Args:
            step: Step function; its first argument is the state, its first output the state
                afterwards.
        """
        with BUILDING:
            step = _dense(step)
        self._sizes = [step.numel_out(i) for i in range(step.n_out())]
        self._loops = _Loops(step, lambda size: step.mapaccum("accumulated", size))

    def __call__(self, start: Array, *rows: Array) -> tuple[Array, ...]:
        """Outputs at every row, each step starting from the state after the previous one.

        Args:
            start: State before the first row, shape (k,).
            rows: Other arguments of the step, shape (n, size) each.

        Returns:
            Each output, shape (n, size).
        """
        n, state = len(rows[0]), start
        found = tuple(np.empty((n, size)) for size in self._sizes)
        for here in _parts(n, STEPS):
            self._loops.run([state, *(r[here] for r in rows)], [whole[here] for whole in found])
            state = found[0][here.stop - 1]
        return found


class EachRow:
    """A function's first output at every row; for some hundred rows faster than `OverRows`."""

    def __init__(self, function: ca.Function, rows: int) -> None:
        """Set up for a function.

        Args:
            function: Function to evaluate; only its first output is used.
            rows: Number of arguments, the first ones, that differ from row to row.
        """
        with BUILDING:
            inputs = [ca.MX.sym(f"a{i}", *function.size_in(i)) for i in range(function.n_in())]
            first = _dense(ca.Function(function.name(), inputs, function.call(inputs)[:1]))
        same = [*range(rows, function.n_in())]
        self._size = first.numel_out(0)
        self._loops = _Loops(first, lambda size: first.map("mapped", "serial", size, same, []))
        self._rows = rows

    def __call__(self, *arguments: Array) -> Array:
        """First output, shape (n, size).

        Args:
            arguments: Arguments, shape (n, size) each for those that differ, shape (size,) each for
                the others.
        """
        differ, same = arguments[: self._rows], arguments[self._rows :]
        found = np.empty((len(differ[0]), self._size))
        for here in _parts(len(found), CHUNK):
            self._loops.run([*(r[here] for r in differ), *same], [found[here]])
        return found


class _Loops:
    """Repeated calls of a function on arrays, without copies.

    CasADi sets up a loop for each number of rows: here these are few, and cached.
    """

    def __init__(self, function: ca.Function, repeated: Callable[[int], ca.Function]) -> None:
        self._function, self._repeated = function, repeated
        self._made: dict[int, tuple[Any, Callable[[], None]]] = {}

    def run(self, given: Sequence[Array], results: Sequence[Array]) -> None:
        """Call the function once per row of the results.

        Args:
            given: Arguments of the function.
            results: Arrays to fill, shape (n, size) each, in C order.
        """
        size = len(results[0])
        if size not in self._made:
            with BUILDING:
                loop = self._function if size == 1 else self._repeated(size)
                self._made[size] = loop.buffer()
        buffer, run = self._made[size]
        arrays = [np.ascontiguousarray(a, dtype=np.float64) for a in given]
        for i, array in enumerate(arrays):
            buffer.set_arg(i, array.data)
        for i, array in enumerate(results):
            buffer.set_res(i, array.data)
        run()


def accumulated(step: ca.Function, start: Array, *rows: Array) -> tuple[Array, ...]:
    """Outputs of a step at every row, as in `Along`, for a single use."""
    return Along(step)(start, *rows)


def mapped(function: ca.Function, *rows: Array) -> Array:
    """First output of a function at every row, shape (n, size), for a single use.

    Args:
        function: Function of dense columns.
        rows: Arguments, shape (n, size) each.
    """
    return EachRow(function, len(rows))(*rows)


def _parts(n: int, most: int) -> Iterator[slice]:
    """Slices of rows whose sizes are powers of two, up to a maximum."""
    first = 0
    while first < n:
        size = min(1 << ((n - first).bit_length() - 1), most)
        yield slice(first, first + size)
        first += size


def _dense(function: ca.Function) -> ca.Function:
    """The function with dense arguments and outputs."""
    sides = (function.n_in(), function.sparsity_in), (function.n_out(), function.sparsity_out)
    if all(of(i).is_dense() for count, of in sides for i in range(count)):
        return function
    given = [ca.MX.sym(f"a{i}", *function.size_in(i)) for i in range(function.n_in())]
    return ca.Function(function.name(), given, [ca.densify(y) for y in function.call(given)])
