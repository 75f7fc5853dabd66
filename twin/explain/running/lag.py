"""How the rotors' own states answer to a number, carried along a flight frame by frame."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...component.along import Along
from ...residuals.channels import GRID_HZ
from ...residuals.teacher_forced import rotor_states_of
from ..model.prediction import Physics
from .hypotheses import Library

Array = NDArray[np.float64]


class LagSlopes:
    """Derivative of the states of the rotors by numbers that move them.

    With the step r' = F(r, u, theta) of the rotors, z' = F_r z + F_theta, exact derivatives of the
    step that the twin itself takes.

    Attributes:
        columns: Positions of these numbers within `Library.columns`.
    """

    def __init__(self, body: Component, library: Library, physics: Physics) -> None:
        """Differentiate the step.

        Args:
            body: Airframe, built with the effects of the library.
            library: Numbers.
            physics: Of that airframe.
        """
        self._index = rotor_states_of(body)
        reached = {
            k: library.name(k)
            for k in range(len(library.columns))
            if physics.reached.get(library.name(k).full, frozenset()) & {*self._index}
        }
        self.columns = tuple(reached)
        self._width, n = len(body.states), len(self._index)
        names = [v.name for v in body.parameters]
        effects = {number.effect for number in reached.values()}
        p = ca.SX(body.parameter_values({f"{e}.enabled": 1.0 for e in effects}))
        theta = ca.SX.sym("theta", len(reached))
        for k, number in enumerate(reached.values()):
            p[names.index(number.full)] = theta[k]
        self._now = np.array([number.now for number in reached.values()])
        z = ca.SX.sym("z", n * len(reached))
        v, u = ca.SX.sym("v", n), ca.SX.sym("u", len(body.inputs))
        x = ca.SX(body.initial(body.input_values(), body.parameter_values()))
        x[self._index] = v
        after = body.step(x, u, p, 1 / GRID_HZ)[self._index]
        moved = ca.jacobian(after, v) @ ca.reshape(z, n, len(reached)) + ca.jacobian(after, theta)
        moved = ca.substitute(ca.vec(moved), theta, self._now)
        self._along = Along(ca.Function("carried", [z, v, u], [ca.cse(ca.densify(moved))]))
        self._state = np.zeros(n * len(reached))

    def along(self, states: Array, inputs: Array) -> list[tuple[int, Array]]:
        """The next rows: of each column, the change of all states, shape (n, n_x).

        Args:
            states: Of the airframe, shape (n, n_x).
            inputs: Of the airframe, shape (n, n_u).
        """
        if not self.columns:
            return []
        rotors = states[:, self._index]
        (after,) = self._along(self._state, np.nan_to_num(rotors), inputs)
        here = np.vstack([self._state, after[:-1]])
        self._state = after[-1]
        found = []
        for k, column in enumerate(self.columns):
            change = np.zeros((len(states), self._width))
            n = len(self._index)
            change[:, self._index] = here[:, k * n : (k + 1) * n]
            found.append((column, change))
        return found
