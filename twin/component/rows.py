"""Evaluation of a CasADi function over the rows of arrays: each instruction over all rows at once.

CasADi's own `map` executes all instructions row by row; numpy takes a column of rows per
instruction, which is several times faster and needs no set-up per number of rows.

`noiseless_outputs` evaluates a sensor on a whole record at once, without noise.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .along import accumulated, mapped
from .component import Component

Array = NDArray[np.float64]
CHUNK = 4096
"""Rows at a time: operands of an instruction then stay in the processor's cache."""

_NUMPY: dict[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_LOG1P: np.log1p,
    ca.OP_EXPM1: np.expm1,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_INV: lambda a: 1.0 / a,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_FABS: np.fabs,
    ca.OP_SIGN: np.sign,
    ca.OP_NOT: lambda a: np.equal(a, 0.0).astype(np.float64),
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_HYPOT: np.hypot,
    ca.OP_FMOD: np.fmod,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_LT: lambda a, b: np.less(a, b).astype(np.float64),
    ca.OP_LE: lambda a, b: np.less_equal(a, b).astype(np.float64),
    ca.OP_EQ: lambda a, b: np.equal(a, b).astype(np.float64),
    ca.OP_NE: lambda a, b: np.not_equal(a, b).astype(np.float64),
    ca.OP_AND: lambda a, b: np.logical_and(a, b).astype(np.float64),
    ca.OP_OR: lambda a, b: np.logical_or(a, b).astype(np.float64),
    ca.OP_IF_ELSE_ZERO: lambda a, b: np.where(a, b, 0.0),
}  # NumPy's function for each operation of CasADi


_ZERO = 0.0
"""The constant of results that are zero by the structure of the function."""
_Step = tuple[Callable[..., Any], int, tuple[int, ...]]


class OverRows:
    """Evaluates a function once per row.

    Values agree with CasADi to a few units in the last place: numpy has its own sine.
    """

    def __init__(self, function: ca.Function, rows: int) -> None:
        """Set up for a function.

        Args:
            function: Function of dense columns; its first output is dense, others are not used.
            rows: Number of arguments, the first ones, that differ from row to row.

        Raises:
            NotImplementedError: The function has an instruction without an equivalent in numpy.
        """
        function = function.expand()
        self._rows, self._size = rows, function.numel_out(0)
        self._width = function.sz_w()
        self._steps = [
            step
            for k in range(function.n_instructions())
            if (step := _step(function, k)) is not None
        ]

    def __call__(self, *arguments: Array) -> Array:
        """First output, shape (n, size), in Fortran order.

        Args:
            arguments: Arguments, shape (n, size) each for those that differ, shape (size,) each for
                the others.
        """
        n = len(arguments[0])
        result = np.zeros((self._size, n))  # rows of zeros take no memory
        same = arguments[self._rows :]
        with np.errstate(all="ignore"):
            for first in range(0, n, CHUNK):
                part = slice(first, first + CHUNK)
                differ = [_columns(a[part]) for a in arguments[: self._rows]]
                self._evaluate([*differ, *same], result[:, part])
        return result.T

    def _evaluate(self, arguments: Sequence[Array], result: Array) -> None:
        """Fill a result, shape (size, n), from arguments of shape (size, n) or (size,)."""
        work: list[Any] = [0.0] * self._width
        for step, out, given in self._steps:
            if step is _load:
                work[out] = arguments[given[0]][given[1]]
            elif step is _store:
                if (value := work[given[0]]) is not _ZERO:
                    result[out] = value
            else:
                work[out] = step(*[work[g] for g in given])


def _columns(rows: Array) -> Array:
    """The transpose, with contiguous rows."""
    return rows.T if rows.strides[0] == rows.itemsize else np.ascontiguousarray(rows.T)


def _step(function: ca.Function, k: int) -> _Step | None:
    """One instruction: operation, index of its result, indices of its operands."""
    op, given = function.instruction_id(k), tuple(function.instruction_input(k))
    out = function.instruction_output(k)
    if op == ca.OP_INPUT:
        return _load, out[0], given
    if op == ca.OP_OUTPUT:
        return (_store, out[1], given) if out[0] == 0 else None
    if op == ca.OP_CONST:
        value = function.instruction_constant(k) or _ZERO
        return lambda: value, out[0], ()
    if op not in _NUMPY:
        raise NotImplementedError(
            f"{function.name()}: CasADi's instruction {op} has no numpy word; add it to _NUMPY"
        )
    return _NUMPY[op], out[0], given


def _load() -> None:
    """Marker of an instruction that reads an argument."""


def _store() -> None:
    """Marker of an instruction that writes the result."""


def noiseless_outputs(
    component: Component, u: Array, step_s: float, parameters: Mapping[str, float] | None = None
) -> Array:
    """Outputs of a sampled component on a uniform grid, with all random draws zero.

    Sample instants are the grid points. Inputs of a delay line may depend on inputs and continuous
    states, not on memory, as in all sensors of `twin`.

    Args:
        component: Component of a sensor.
        u: Inputs at the grid points, shape (n, n_u).
        step_s: Step of the grid.
        parameters: Parameters that differ from their start values; the sample period is ignored.

    Returns:
        Outputs, shape (n, n_y).
    """
    sampling = component.sampling
    assert sampling is not None, component.name
    p = component.parameter_values({**(parameters or {}), sampling.period: step_s})
    start = np.asarray(component.initial(u[0], p), dtype=np.float64).ravel()
    every_p = np.broadcast_to(p, (len(u), len(p)))
    every_step = np.broadcast_to(step_s, (len(u), 1))
    (path,) = accumulated(component.step, start, u, every_p, every_step)
    states = np.vstack([start, path[:-1]])
    signals = mapped(sampling.signals, states, u, every_p).T
    delays_s = np.asarray(sampling.delays(p), dtype=np.float64).ravel()
    t = step_s * np.arange(len(u))
    late = [np.interp(t - d, t, s) for d, s in zip(delays_s, signals, strict=True)]

    x, v = ca.SX.sym("x", len(start)), ca.SX.sym("u", u.shape[1])
    d = ca.SX.sym("d", len(late))
    after = sampling.update(x, v, p, np.zeros(sampling.channels), d)
    both = ca.Function("both", [x, v, d], [component.step(after, v, p, step_s), after])
    delayed = np.reshape(late, (len(late), len(u))).T
    _, sampled = accumulated(both, start, u, delayed)
    return mapped(component.outputs, sampled, u, every_p)
