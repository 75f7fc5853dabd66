"""A CasADi function over the rows of arrays, without a detour through CasADi's own matrices."""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class OverRows:
    """Evaluates a function once per row."""

    def __init__(self, function: ca.Function, rows: int) -> None:
        """Take a function.

        Args:
            function: Of columns; its first output is dense.
            rows: How many of its arguments, the first ones, differ from row to row.
        """
        self._function = function
        self._same = list(range(rows, function.n_in()))
        self._mapped: dict[int, ca.Function] = {}

    def __call__(self, *arguments: Array) -> Array:
        """Its first output, shape (n, size).

        Args:
            arguments: Shape (n, size) each those that differ, shape (size,) each the others.
        """
        n = len(arguments[0])
        result = np.empty((n, self._function.numel_out(0)))
        if result.size == 0:
            return result
        if n not in self._mapped:
            self._mapped[n] = self._function.map("rows", "serial", n, self._same, [])
        buffer: Any
        buffer, evaluate = self._mapped[n].buffer()
        # The buffer keeps pointers alone: the arrays have to live as long as it.
        given = [np.ascontiguousarray(a, dtype=np.float64) for a in arguments]
        for i, argument in enumerate(given):
            if argument.size:
                buffer.set_arg(i, argument.data)
        buffer.set_res(0, result.data)
        evaluate()
        return result
