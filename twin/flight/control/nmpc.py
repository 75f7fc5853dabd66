"""Nonlinear model predictive controller: the airframe's own equations over a receding horizon.

Multiple shooting with RK4 between the nodes; the sum of squares of the deviations from the
setpoints, each over the deviation that is still fine, is minimised with the rotor inputs within
their range. Every solution, shifted by a node, is the start of the next one.

It reads the whole state of the airframe, rotors included, and knows neither wind nor a plant that
differs from its model: there it keeps an offset, where the cascade of
`twin.flight.control.lqr_cascade` integrates. A `command_delay` is left to the plant.

Solve time on one core of a 2-core x86-64 machine, Crazyflie, 20 nodes of 50 ms, 2 m step: median
29 ms, and up to 140 ms in the first moments of a step, where the commands are at their bounds: a
simulation does not mind, an aircraft would need compiled derivatives.

Source: Diehl et al., Fast direct multiple shooting algorithms for optimal robot control, 2006;
solver, Vanroye et al., FATROP, IROS 2023.
"""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ...frames import multiply
from ...physics.airframe import airframe
from ...vehicle import Vehicle
from .hover import drives, punctual, thrust_inverse

Array = NDArray[np.float64]
NODES, NODE_S, SUBSTEPS = 20, 0.05, 2
ACCEPTABLE = {
    "pos": 0.1,  # m
    "vel": 1.0,  # m/s
    "attitude": 0.5,  # rad
    "omega": 4.0,  # rad/s
    "input": 0.3,  # share of the hover input
}
"""Largest deviation that is still fine, per quantity (Bryson's rule): made up, for agile flight."""
LAST_NODE = 10.0
"""Weight of the last node over that of the others: it stands for all that comes after."""
N_SETPOINT = 10
_OPTIONS: dict[str, Any] = {
    "structure_detection": "auto",
    "expand": True,
    "print_time": False,
    # The shifted last plan is close: few iterations, the next call goes on where this one ends.
    "fatrop": {"print_level": 0, "max_iter": 8, "tol": 1e-4},
}


class Nmpc:
    """Receding-horizon controller of one vehicle.

    Attributes:
        node_s: Time between two nodes, the period at which commands should be asked for.
        state_names: Order of the states that `command` reads.
    """

    def __init__(self, vehicle: Vehicle, nodes: int = NODES, node_s: float = NODE_S) -> None:
        body = airframe(punctual(vehicle))
        self.node_s, self._nodes = node_s, nodes
        self.state_names = tuple(s.name for s in body.states)
        self._driven = [body.input_names.index(n) for n in drives(body)]
        u0, p = body.input_values(), body.parameter_values({"ground.enabled": 0.0})
        self._hover_u = u0[self._driven]
        self._bounds = []
        for far, end in zip((-np.inf, np.inf), thrust_inverse(vehicle).bounds, strict=True):
            free, held = np.full(len(body.states), far), np.full(len(self._driven), end)
            self._bounds.append(np.concatenate([np.tile(np.r_[free, held], nodes), free]))

        x, u = ca.SX.sym("x", len(body.states)), ca.SX.sym("u", len(self._driven))
        full_u = ca.SX(u0)
        full_u[self._driven] = u
        after = x
        for _ in range(SUBSTEPS):
            after = body.step(after, full_u, p, node_s / SUBSTEPS)
        self._step = ca.Function("node", [x, u], [ca.cse(after)])
        self._deviation = self._deviations()
        self._solver = self._problem()
        self.reset()

    def reset(self) -> None:
        """Forget the last solution."""
        self._guess: Array | None = None

    def command(self, state: Array, setpoints: Array) -> Array:
        """Rotor inputs for the next node.

        Args:
            state: Of the airframe, in the order of `state_names`.
            setpoints: Position and velocity (m, m/s), acceleration (unused), heading (rad):
                shape (10,) for a setpoint that holds, or (nodes + 1, 10) for one per node.

        Returns:
            Shape (n_rotors,).

        Raises:
            ModelError: No solution was found.
        """
        wanted = np.broadcast_to(
            np.asarray(setpoints, dtype=np.float64)[..., :N_SETPOINT],
            (self._nodes + 1, N_SETPOINT),
        )
        n_x, n_u = len(self.state_names), len(self._driven)
        guess = self._guess
        if guess is None:
            guess = np.concatenate([np.tile(np.r_[state, self._hover_u], self._nodes), state])
        found = self._solver(
            x0=guess,
            p=np.concatenate([state, wanted.ravel()]),
            lbx=self._bounds[0],
            ubx=self._bounds[1],
            lbg=0.0,
            ubg=0.0,
        )
        plan = np.asarray(found["x"], dtype=np.float64).ravel()
        if not (np.all(np.isfinite(plan)) and np.all(np.isfinite(state))):
            self.reset()
            raise ModelError(
                f"model predictive controller: no plan from this state: "
                f"{np.array2string(np.asarray(state), precision=3)}."
            )
        last_u, last_x = plan[-n_x - n_u : -n_x], plan[-n_x:]
        beyond = np.asarray(self._step(last_x, last_u), dtype=np.float64).ravel()
        self._guess = np.concatenate([plan[n_x + n_u :], last_u, beyond])
        # An interior-point solution may pass its bounds by the tolerance.
        return np.clip(plan[n_x : n_x + n_u], self._bounds[0][n_x], self._bounds[1][n_x])

    def _deviations(self) -> ca.Function:
        """`(x, u, setpoint) -> r`: what is minimised in the square, at one node."""
        x, u = ca.SX.sym("x", len(self.state_names)), ca.SX.sym("u", len(self._driven))
        setpoint = ca.SX.sym("setpoint", N_SETPOINT)

        def states(stem: str, letters: str = "xyz") -> ca.SX:
            return x[[self.state_names.index(f"{stem}_{a}") for a in letters]]

        half = setpoint[9] / 2
        level = [ca.cos(half), ca.SX(0), ca.SX(0), -ca.sin(half)]  # its conjugate
        turned = multiply(level, ca.vertsplit(states("q", "wxyz")))
        # Twice the vector part, and no second zero at the opposite sign of the quaternion.
        attitude = ca.if_else(turned[0] < 0, -2.0, 2.0) * ca.SX(ca.vertcat(*turned[1:]))
        parts = (
            (states("pos") - setpoint[:3]) / ACCEPTABLE["pos"],
            (states("vel") - setpoint[3:6]) / ACCEPTABLE["vel"],
            attitude / ACCEPTABLE["attitude"],
            states("omega") / ACCEPTABLE["omega"],
            (u / self._hover_u - 1) / ACCEPTABLE["input"],
        )
        return ca.Function("deviation", [x, u, setpoint], [ca.vertcat(*parts)])

    def _problem(self) -> ca.Function:
        """The nonlinear program: unknowns x_0 u_0 x_1 ... x_N, constraints in the same order."""
        n_x, n_u = len(self.state_names), len(self._driven)
        now = ca.MX.sym("now", n_x)
        wanted = ca.MX.sym("wanted", N_SETPOINT, self._nodes + 1)
        xs = [ca.MX.sym(f"x{k}", n_x) for k in range(self._nodes + 1)]
        us = [ca.MX.sym(f"u{k}", n_u) for k in range(self._nodes)]
        gaps, cost = [], ca.MX(0)
        for k in range(self._nodes):
            gaps.append(xs[k + 1] - self._step(xs[k], us[k]))
            if k == 0:
                gaps.append(xs[0] - now)
            cost += ca.sumsqr(self._deviation(xs[k], us[k], wanted[:, k]))
        last = self._deviation(xs[-1], ca.MX(self._hover_u), wanted[:, -1])
        cost += LAST_NODE * ca.sumsqr(last)
        unknowns = [v for pair in zip(xs, us, strict=False) for v in pair] + [xs[-1]]
        problem: dict[str, Any] = {
            "x": ca.vertcat(*unknowns),
            "p": ca.vertcat(now, ca.vec(wanted)),
            "f": cost,
            "g": ca.vertcat(*gaps),
        }
        equality = [True] * problem["g"].shape[0]
        return ca.nlpsol("nmpc", "fatrop", problem, {**_OPTIONS, "equality": equality})
