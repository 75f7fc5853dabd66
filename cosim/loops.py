"""Algebraic loops between slaves, solved by Newton's method.

A loop has the values v of its outputs on both sides: v = g(v), where g sets the connected inputs
of all slaves in the loop and reads their outputs. Each iteration solves
(1 - dg/dv) step = g(v) - v with the directional derivatives of the FMUs; a step that does not
bring g(v) - v down is halved.

Source: Deuflhard, Newton Methods for Nonlinear Problems, ch. 3; FMI 2.0.4, sec. 4.2.4.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.order import Loop, slave_of
from twin.errors import FmuError

from .bus import Bus
from .slave.jacobian import jacobian

Array = NDArray[np.float64]
TOLERANCE = 1e-12
"""Residual that ends the iterations, relative to the values in the loop."""
ROUNDING = 1e-9
"""Residual that is accepted where no step brings it down any more."""
SMALLEST = 1e-300
MAX_ITERATIONS = 30
MAX_HALVINGS = 20


@dataclass(frozen=True, slots=True)
class _Block:
    """Part of dg/dv that one slave gives.

    Attributes:
        rows: Positions of its outputs in the loop.
        takes: Which value of the loop each of its inputs takes, shape (inputs, loop), 0 or 1.
        slope: Outputs against inputs.
    """

    rows: list[int]
    takes: Array
    slope: Callable[[], Array]


class LoopSolver:
    """Solves one loop on the bus, starting from the values there."""

    def __init__(self, bus: Bus, loop: Loop) -> None:
        self._bus, self._loop = bus, loop
        self._at = bus.positions(loop.outputs)
        self._members = list(dict.fromkeys(map(slave_of, loop.outputs)))
        self._blocks = [self._block(name) for name in self._members]
        self._slope = np.zeros((len(self._at), len(self._at)))
        self._regular = False

    def _block(self, name: str) -> _Block:
        loop, bus, s = self._loop.outputs, self._bus, self._bus.slaves[name]
        rows = [i for i, o in enumerate(loop) if slave_of(o) == name]
        inputs = [u for u in s.bound_inputs if bus.source[f"{name}.{u}"] in loop]
        takes = np.array([[bus.source[f"{name}.{u}"] == o for o in loop] for u in inputs])
        outputs = [bus.system.split(loop[i])[1] for i in rows]
        return _Block(rows, takes.astype(np.float64), jacobian(s, outputs, inputs))

    def solve(self, time_s: float) -> None:
        """Leave the solution on the bus and in the slaves.

        Raises:
            FmuError: Newton's method found none.
        """
        v = self._bus.values[self._at]
        residual, size = self._residual(v), np.abs(v)
        for _ in range(MAX_ITERATIONS):
            size = np.maximum(size, np.abs(v + residual))
            scale = size + np.abs(self._slope) @ size + SMALLEST
            if self._regular and np.all(np.abs(residual) <= TOLERANCE * scale):
                return
            step = self._newton_step(residual, time_s)
            if not residual.any():
                return
            v, better = self._descend(v, residual, step, scale)
            if better is None:
                if np.all(np.abs(self._residual(v)) <= ROUNDING * scale):
                    return
                break
            residual = better
        raise self._error(time_s, residual, "Newton's method does not converge")

    def _newton_step(self, residual: Array, time_s: float) -> Array:
        """The full step from the present inputs."""
        for block in self._blocks:
            self._slope[block.rows] = block.slope() @ block.takes
        try:
            step = np.linalg.solve(np.eye(len(residual)) - self._slope, residual)
        except np.linalg.LinAlgError:
            raise self._error(time_s, residual, "it has no unique solution") from None
        self._regular = True
        return step.astype(np.float64, copy=False)

    def _descend(
        self, v: Array, residual: Array, step: Array, scale: Array
    ) -> tuple[Array, Array | None]:
        """The first of step, step / 2, step / 4, ... that brings the residual down; None: none."""
        worst = np.max(np.abs(residual) / scale)
        for _ in range(MAX_HALVINGS):
            after = self._residual(v + step)
            if np.max(np.abs(after) / scale) < worst:
                return v + step, after
            step = step / 2
        return v, None

    def _residual(self, v: Array) -> Array:
        """g(v) - v; leaves v in the inputs and g(v) on the bus."""
        bus = self._bus
        bus.values[self._at] = v
        for name in self._members:
            bus.write(name)
        for name in self._members:
            bus.slaves[name].read_outputs()
        return bus.values[self._at] - v

    def _error(self, time_s: float, residual: Array, what: str) -> FmuError:
        worst = int(np.argmax(np.abs(residual)))
        return FmuError(
            f"Algebraic loop {' -> '.join(self._loop.outputs)} at {time_s:g} s: {what}; residual "
            f"{residual[worst]:.3g} at {self._loop.outputs[worst]}. Put a state or a delay "
            f"between two of them, or start nearer to the solution."
        )
