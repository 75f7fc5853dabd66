"""Airframe equations over rows: integration steps, inputs and features of a force law, and their
slopes."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from twin.component import Component, substeps
from twin.component.along import EachRow
from twin.frames import AXES, to_body
from twin.physics.residual_force import FEATURES, OUTPUTS, features, motion_inputs
from twin.residuals.teacher_forced import GRID_S, RIGID
from twin.vehicle import Vehicle

Array = NDArray[np.float64]
STEPS = 10
"""Number of grid steps per integration step: commands change every 10 ms in logs, and rotors lag by
20 ms and more. With 4 the rollout is no closer to the exported FMU."""
STEP_S = STEPS * GRID_S
"""Step of the rollout through which a law is fitted, s."""
_N = len(RIGID)


class Equations:
    """Airframe equations over rows: integration steps, features of the motion, and slopes of both.

    Attributes:
        units: Force, N, and moment, N m, per specific force and angular acceleration, shape (6, 6).
        rigid: Indices of `RIGID` among its states.
    """

    def __init__(self, vehicle: Vehicle, body: Component) -> None:
        """Build from an airframe that has external forces and moments as inputs."""
        p = body.parameter_values({"ground.enabled": 0.0})
        names = [s.name for s in body.states]
        self.rigid = [names.index(s) for s in RIGID]
        self.units = _units(body, p)
        x, u = ca.SX.sym("x", len(body.states)), ca.SX.sym("u", len(body.inputs))
        volts, a = ca.SX.sym("volts"), ca.SX.sym("a", len(OUTPUTS))
        pushed = ca.SX(u)
        for i, (kind, axis) in enumerate(OUTPUTS):
            place = body.input_names.index(f"{kind}_{axis}")
            pushed[place] = u[place] + (ca.SX(self.units) @ a)[i]
        after = body.step(x, pushed, p, STEP_S)
        self.step = EachRow(ca.Function("step", [x, u, a], [ca.densify(after)]), 3)
        n, h = substeps(GRID_S, body.max_step_s)
        fine: ca.SX = x
        for _ in range(n):
            fine = body.step(fine, u, p, h)
        fine = ca.densify(fine[self.rigid])
        self.after = EachRow(ca.Function("after", [x, u], [fine]), 2)
        sees = _places(vehicle, body, x, u, p, volts)
        seen = ca.densify(features(sees))
        self.places = EachRow(ca.Function("places", [x, u, volts], [sees]), 3)
        self.features = EachRow(ca.Function("features", [x, u, volts], [seen]), 3)
        rate = body.derivatives(x, pushed, p)[self.rigid]
        by = ca.horzcat(ca.jacobian(rate, x)[:, self.rigid], ca.jacobian(rate, a))
        of_seen = ca.horzcat(ca.jacobian(seen, x)[:, self.rigid], ca.SX(len(FEATURES), 6))
        both = ca.vertcat(by, of_seen)
        flat = ca.vec(ca.densify(both.T))
        self._slopes = EachRow(ca.Function("slopes", [x, u, volts, a], [flat]), 4)

    def slopes(self, x: Array, u: Array, volts: Array, a: Array) -> tuple[Array, Array, Array]:
        """Slopes of a step: of `RIGID` by `RIGID`, (w, 13, 13), and by accelerations, (w, 13, 6);
        of the features by `RIGID`, (w, k, 13)."""
        flat = self._slopes(x, u, volts, a).reshape(len(x), _N + len(FEATURES), _N + 6)
        by_motion, by_push = flat[:, :_N, :_N], flat[:, :_N, _N:]
        half = np.eye(_N) + STEP_S / 2 * by_motion
        step = np.eye(_N) + STEP_S * by_motion @ half
        return step, STEP_S * half @ by_push, flat[:, _N:, :_N]


def _units(body: Component, p: Array) -> Array:
    """Force and moment per acceleration of the centre of mass and angular acceleration, shape (6,
    6); in hover, where body axes are NED.
    """
    names = [s.name for s in body.states]
    u0, u = body.input_values(), ca.SX.sym("u", len(body.inputs))
    rates = body.derivatives(body.initial(u0, p), u, p)
    moved = ca.vertcat(*[rates[names.index(f"{s}_{a}")] for s in ("vel", "omega") for a in AXES])
    pushes = [body.input_names.index(f"{kind}_{a}") for kind, a in OUTPUTS]
    slope = ca.Function("slope", [u], [ca.jacobian(moved, u)[:, pushes]])(u0)
    return np.asarray(np.linalg.inv(np.asarray(slope, dtype=np.float64)))


def _places(vehicle: Vehicle, body: Component, x: ca.SX, u: ca.SX, p: Array, volts: ca.SX) -> ca.SX:
    """Law inputs `INPUTS` as an expression of states and inputs."""
    y, state = body.outputs(x, u, p), {s.name: x[i] for i, s in enumerate(body.states)}
    given = {n: u[i] for i, n in enumerate(body.input_names)}
    spin = [y[body.output_names.index(f"spin_{i}")] for i in range(1, vehicle.rotors.count + 1)]
    air = [state[f"vel_{a}"] - given[f"wind_{a}"] for a in AXES]
    air_b = to_body([state[f"q_{a}"] for a in "wxyz"], air)
    omega = [state[f"omega_{a}"] for a in AXES]
    return ca.densify(motion_inputs(vehicle, air_b, omega, spin, volts, -state["pos_z"]))
