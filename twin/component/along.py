"""CasADi functions along a record, some thousand rows at a time: what they need besides their
results does not grow with its length."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CHUNK = 1024
"""Rows at a time."""


class Along:
    """A step that goes along a record, one block of rows after another.

    CasADi sets up a loop for each number of rows; here each is a sum of powers of two, whose loops
    are kept, and arrays are read and written where they lie.
    """

    def __init__(self, step: ca.Function) -> None:
        """Take a step.

        Args:
            step: Its first argument is the state, its first output the state afterwards.
        """
        self._step = _dense(step)
        self._sizes = [self._step.numel_out(i) for i in range(self._step.n_out())]
        self._loops: dict[int, tuple[Any, Callable[[], None]]] = {}

    def __call__(self, start: Array, *rows: Array) -> tuple[Array, ...]:
        """Its outputs at every row, each step going on from where the one before ended.

        Args:
            start: State before the first row, shape (k,).
            rows: Its other arguments, shape (n, size) each.

        Returns:
            Each output, shape (n, size).
        """
        n, first, state = len(rows[0]), 0, start
        found = tuple(np.empty((n, size)) for size in self._sizes)
        while first < n:
            size = min(1 << ((n - first).bit_length() - 1), CHUNK)
            here = slice(first, first + size)
            self._run(size, [state, *(r[here] for r in rows)], [whole[here] for whole in found])
            first, state = here.stop, found[0][here.stop - 1]
        return found

    def _run(self, size: int, given: list[Array], results: list[Array]) -> None:
        """So many steps, from arrays and into arrays."""
        if size not in self._loops:
            loop = self._step if size == 1 else self._step.mapaccum("accumulated", size)
            self._loops[size] = loop.buffer()
        buffer, run = self._loops[size]
        given = [np.ascontiguousarray(a, dtype=np.float64) for a in given]
        for i, array in enumerate(given):
            buffer.set_arg(i, memoryview(array))
        for i, array in enumerate(results):
            buffer.set_res(i, memoryview(array))
        run()


def accumulated(step: ca.Function, start: Array, *rows: Array) -> tuple[Array, ...]:
    """A step's outputs at every row, as of `Along`, for whoever asks once."""
    return Along(step)(start, *rows)


def mapped(function: ca.Function, *rows: Array) -> Array:
    """A function's first output at every row, shape (n, size).

    Args:
        function: Of dense columns.
        rows: Its arguments, shape (n, size) each.
    """
    found = np.empty((len(rows[0]), function.numel_out(0)))
    for first in range(0, len(found), CHUNK):
        here = slice(first, first + CHUNK)
        (said, *_) = function.map(len(found[here])).call([r[here].T for r in rows])
        found[here] = np.asarray(said, dtype=np.float64).T
    return found


def _dense(function: ca.Function) -> ca.Function:
    """The same with arguments and outputs of which every entry has a place in memory."""
    sides = (function.n_in(), function.sparsity_in), (function.n_out(), function.sparsity_out)
    if all(of(i).is_dense() for count, of in sides for i in range(count)):
        return function
    given = [ca.MX.sym(f"a{i}", *function.size_in(i)) for i in range(function.n_in())]
    return ca.Function(function.name(), given, [ca.densify(y) for y in function.call(given)])
