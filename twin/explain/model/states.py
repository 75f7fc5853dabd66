"""Which numbers move states that nobody measures: asked of the component, whatever effect it is."""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...component.building import BUILDING
from ...residuals.channels import GRID_HZ
from ...residuals.unmeasured import integrate_states
from .numbers import Number

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def states_reached(component: Component, index: Sequence[int]) -> dict[str, frozenset[int]]:
    """By parameter, which of some states answer to it: by themselves, or through another of them.

    Args:
        component: Component.
        index: Positions of the states; what the others do is given.
    """
    index = list(index)
    if not index:
        return {}
    by_p = _depends(component.derivatives, 2) | _depends(component.initial, 1)
    by_x = _depends(component.derivatives, 0)
    if component.sampling is not None:
        s = component.sampling
        late = _depends(s.update, 4)
        by_p |= _depends(s.update, 2) | _both(late, _depends(s.signals, 2))
        by_p |= _both(late, _depends(s.delays, 0))
        by_x |= _depends(s.update, 0) | _both(late, _depends(s.signals, 0))
    by_p, by_x = by_p[index], by_x[np.ix_(index, index)]
    for _ in index:
        by_p = by_p | _both(by_x, by_p)
    return {
        v.name: frozenset(index[k] for k in np.flatnonzero(column))
        for v, column in zip(component.parameters, by_p.T, strict=True)
        if column.any()
    }


def _depends(function: ca.Function, argument: int) -> Mask:
    """Whether each result depends on each entry of an argument."""
    shape = function.numel_out(0), function.numel_in(argument)
    if 0 in shape:
        return np.zeros(shape, dtype=np.bool_)
    sparsity = ca.DM(function.jac_sparsity(0, argument), 1)
    return np.asarray(np.asarray(sparsity, dtype=np.float64) != 0)


def _both(a: Mask, b: Mask) -> Mask:
    """Dependence of what depends on what depends."""
    return np.asarray(a.astype(np.intp) @ b.astype(np.intp) > 0)


class EffectStates:
    """States that effects have in a sensor, integrated over its inputs.

    Attributes:
        sensor: Built with the effects.
        index: Positions of the states.
        numbers: Positions of the numbers that they answer to.
    """

    def __init__(
        self, sensor: Component, effects: Sequence[str], numbers: Sequence[Number]
    ) -> None:
        """Ask the component."""
        self.sensor, self._effects, self._numbers = sensor, list(effects), list(numbers)
        owners = [s.name.partition(".")[0] for s in sensor.states]
        self.index = [i for i, owner in enumerate(owners) if owner in effects]
        reached = states_reached(sensor, self.index)
        self.numbers = frozenset(i for i, n in enumerate(numbers) if n.full in reached)

    def along(self, inputs: Array, theta: Array) -> tuple[Array, ...]:
        """The states over all rows of a flight, shape (n, k); nothing where there are none."""
        if not self.index:
            return ()
        known = {v.name for v in self.sensor.parameters}
        values = {f"{e}.enabled": 1.0 for e in self._effects}
        values |= {n.full: float(v) for n, v in zip(self._numbers, theta, strict=True)}
        p = self.sensor.parameter_values({k: v for k, v in values.items() if k in known})
        x = np.zeros((len(inputs), len(self.sensor.states)))
        with BUILDING:  # it is built anew
            return (integrate_states(self.sensor, self.index, x, inputs, p, 1 / GRID_HZ),)

    def filled(self, x: ca.SX, z: ca.SX) -> ca.SX:
        """States of the sensor with these in place."""
        full = ca.SX(x)
        if self.index:
            full[self.index] = z
        return full
