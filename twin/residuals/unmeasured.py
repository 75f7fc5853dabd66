"""States that no flight measures: a rotor's speed, the warmth of a motor, a load on its rope.

They are integrated along what is measured, with the steps and sample instants of the component's
own equations, every random draw zero.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component
from ..component.along import BUILDING, Along, mapped

Array = NDArray[np.float64]


def integrate_states(
    component: Component, index: Sequence[int], x: Array, u: Array, p: Array, step_s: float
) -> Array:
    """Some states of a component along the others and the inputs, from its own start on.

    Arguments and result as of `Integration`.
    """
    return Integration(component, index, p, step_s).along(x, u)


class Integration:
    """Some states of a component along the others and the inputs, one block of rows after another.

    What enters a delay line may depend on inputs and measured states, not on the states that are
    integrated.
    """

    def __init__(self, component: Component, index: Sequence[int], p: Array, step_s: float) -> None:
        """Begin at the component's own start.

        Args:
            component: It says how they change.
            index: Positions of the states.
            p: Parameters.
            step_s: Step of the grid.
        """
        self._component, self._index, self._p, self._step_s = component, list(index), p, step_s
        n_x, n_u = len(component.states), len(component.inputs)
        z, at, v = (ca.SX.sym(n, k) for n, k in (("z", len(index)), ("x", n_x), ("u", n_u)))
        full = ca.SX(at)
        full[self._index] = z
        self._sampled = _Sampled(component, self._index, p, step_s) if self._changes() else None
        after = component.step(full, v, p, step_s)[self._index]
        self._along = Along(ca.Function("hidden_step", [z, at, v], [after]))
        self._state: Array | None = None  # before the next row
        self._last = np.zeros((0, n_x)), np.zeros((0, n_u))  # where all was known last

    def along(self, x: Array, u: Array) -> Array:
        """The states in the next rows.

        Where something is unknown its last known value counts.

        Args:
            x: All states on a uniform grid, those that are integrated not used, NaN where unknown,
                shape (n, n_x).
            u: Inputs there, NaN where unknown, shape (n, n_u).

        Returns:
            Shape (n, len(index)); NaN as long as nothing has been known at all.
        """
        x, u = np.vstack([self._last[0], x]), np.vstack([self._last[1], u])
        others = np.setdiff1d(np.arange(x.shape[1]), self._index)
        known = np.all(np.isfinite(x[:, others]), axis=1) & np.all(np.isfinite(u), axis=1)
        before = len(self._last[0])
        if not known.any():
            return np.full((len(x), len(self._index)), np.nan)
        last = np.maximum.accumulate(np.where(known, np.arange(len(x)), -1))
        rows = np.where(last < 0, np.argmax(known), last)
        path, inputs = x[rows][before:], u[rows][before:]
        self._last = path[-1:], inputs[-1:]
        if self._state is None:
            with BUILDING:
                start = self._component.initial(inputs[0], self._p)
                self._state = np.asarray(start, dtype=np.float64).ravel()[self._index]
        if self._sampled is not None:
            after, here = self._sampled.along(self._state, path, inputs)
        else:
            (after,) = self._along(self._state, path, inputs)
            here = np.vstack([self._state, after[:-1]])
        self._state = after[-1]
        return here

    def _changes(self) -> bool:
        """Whether some of the states change at sample instants."""
        if self._component.sampling is None:
            return False
        update = self._component.sampling.update
        x, u, p, w, d = update.sx_in()
        after = update(x, u, p, w, d)
        return not all(ca.is_equal(after[i], x[i], 2) for i in self._index)


class _Sampled:
    """The same with memory, sampled as often as the component says."""

    def __init__(self, component: Component, index: list[int], p: Array, step_s: float) -> None:
        sampling = component.sampling
        assert sampling is not None
        self._sampling, self._p, self._step_s = sampling, p, step_s
        names = [v.name for v in component.parameters]
        period = float(p[names.index(sampling.period)])
        often, self._seldom = max(1, round(step_s / period)), max(1, round(period / step_s))
        self._delays_s = np.asarray(sampling.delays(p), dtype=np.float64).ravel()
        z, at, v, d, now = (
            ca.SX.sym(n, k)
            for n, k in (
                ("z", len(index)),
                ("x", len(component.states)),
                ("u", len(component.inputs)),
                ("d", len(self._delays_s)),
                ("now", 1),
            )
        )
        quiet = np.zeros(sampling.channels)

        def sample(values: ca.SX) -> ca.SX:
            """After a sample instant."""
            full = ca.SX(at)
            full[index] = values
            return sampling.update(full, v, p, quiet, d)[index]

        def advance(values: ca.SX, h: float) -> ca.SX:
            """After a step."""
            full = ca.SX(at)
            full[index] = values
            return component.step(full, v, p, h)[index]

        here = ca.if_else(now, sample(z), z)
        then = advance(here, step_s / often)
        for _ in range(often - 1):
            then = advance(sample(then), step_s / often)
        self._both = Along(ca.Function("both", [z, at, v, d, now], [then, here]))
        self._count = 0  # rows so far
        self._past = np.zeros((len(self._delays_s), 0))  # signals of the last of them

    def along(self, state: Array, path: Array, inputs: Array) -> tuple[Array, Array]:
        """States after each row's step, and in the row, shape (n, k) each."""
        every_p = np.broadcast_to(self._p, (len(path), len(self._p)))
        signals = mapped(self._sampling.signals, path, inputs, every_p).T
        signals = np.hstack([self._past, signals])
        past = self._past.shape[1]
        rows = np.arange(self._count, self._count + len(path))
        t = self._step_s * np.arange(self._count - past, self._count + len(path))
        late = [np.interp(t[past:] - d, t, s) for d, s in zip(self._delays_s, signals, strict=True)]
        instants = (rows % self._seldom == 0).astype(np.float64)
        delayed = np.reshape(late, (len(late), len(path))).T
        after, here = self._both(state, path, inputs, delayed, instants[:, None])
        reach = int(np.max(self._delays_s, initial=0.0) / self._step_s) + 2
        self._past, self._count = signals[:, -reach:], self._count + len(path)
        return after, here
