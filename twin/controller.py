"""Position controller derived from the airframe's own equations: LQR about hover.

The airframe is linearised at its trim with CasADi Jacobians, the quaternion is replaced by three
small angles, the integral of the position is added, and the gains solve the continuous algebraic
Riccati equation. Nothing is tuned by hand but the weights, which follow Bryson's rule.

Source: Bryson & Ho, Applied Optimal Control, sec. 5.2; integral action, Franklin, Powell &
Emami-Naeini, Feedback Control of Dynamic Systems, sec. 7.10.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

from .airframe import AXES
from .component import Component
from .frames import to_body

Array = NDArray[np.float64]
ACCEPTABLE = {
    "integral": 1.0,  # m s
    "pos": 0.4,  # m
    "vel": 0.8,  # m/s
    "att": 0.3,  # rad
    "omega": 3.0,  # rad/s
    "rotor": np.inf,  # not penalised: its own command is
    "command": 0.15,  # share of the trim command
}
"""Largest deviation that is still fine, per quantity (Bryson's rule): made up, for agile indoor
flight."""


@dataclass(frozen=True, slots=True)
class Lqr:
    """State feedback `u = u_trim - gain @ error` about hover.

    Attributes:
        gain: Shape (n_rotors, n_error): integral of position, position, velocity, attitude,
            body rates, rotor states.
        trim: Rotor inputs in hover, shape (n_rotors,).
        rotor_trim: Rotor states in hover, shape (n_states - 13,).
        poles: Closed-loop poles, rad/s.
    """

    gain: Array
    trim: Array
    rotor_trim: Array
    poles: NDArray[np.complex128]


def lqr(airframe: Component) -> Lqr:
    """Design the controller for an airframe whose start values are its hover trim."""
    names = [s.name for s in airframe.states]
    rotors = [i for i, n in enumerate(names) if n.startswith(("rotor_", "effort_"))]
    drives = [i for i, n in enumerate(airframe.input_names) if n.startswith(("cmd_", "rotor_"))]
    u0, p0 = airframe.input_values(), airframe.parameter_values({"ground.enabled": 0.0})
    x0 = np.asarray(airframe.initial(u0, p0), dtype=np.float64).ravel()
    x, u = ca.SX.sym("x", len(x0)), ca.SX.sym("u", len(u0))
    f = airframe.derivatives(x, u, p0)
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(f, x), ca.jacobian(f, u)])
    full_a, full_b = (np.asarray(m, dtype=np.float64) for m in slopes(x0, u0))
    # Error state: position, velocity, small angles (q = [1, angles / 2]), body rates, rotors.
    index = {n: i for i, n in enumerate(names)}
    order = [index[f"{g}_{a}"] for g in ("pos", "vel", "q", "omega") for a in AXES] + rotors
    scale = np.ones(len(order))
    scale[6:9] = 0.5
    a = full_a[np.ix_(order, order)] * scale / scale[:, None]
    b = full_b[np.ix_(order, drives)] / scale[:, None]
    a = np.block([[np.zeros((3, 3)), np.eye(3), np.zeros((3, len(order) - 3))],
                  [np.zeros((len(order), 3)), a]])  # fmt: skip
    b = np.vstack([np.zeros((3, len(drives))), b])
    limits = np.repeat([ACCEPTABLE[k] for k in ("integral", "pos", "vel", "att", "omega")], 3)
    limits = np.concatenate([limits, np.full(len(rotors), ACCEPTABLE["rotor"])])
    q = np.diag(1.0 / limits**2)
    r = np.diag(1.0 / (ACCEPTABLE["command"] * u0[drives]) ** 2)
    gain = np.linalg.solve(r, b.T @ solve_continuous_are(a, b, q, r))
    return Lqr(gain, u0[drives], x0[rotors], np.linalg.eigvals(a - b @ gain).astype(np.complex128))


def feedback(design: Lqr, airframe: Component) -> ca.Function:
    """`(x, integral, setpoint, u_held) -> u, integral rate` of the controller.

    The setpoint is position and velocity NED, shape (6,), heading north. The position error is
    turned into body axes, so the gains hold at any heading; commands stay within 0..1.
    """
    names = [s.name for s in airframe.states]
    index = {n: i for i, n in enumerate(names)}
    drives = [i for i, n in enumerate(airframe.input_names) if n.startswith(("cmd_", "rotor_"))]
    rotors = [i for i, n in enumerate(names) if n.startswith(("rotor_", "effort_"))]
    x, integral = ca.SX.sym("x", len(names)), ca.SX.sym("integral", 3)
    setpoint, u = ca.SX.sym("setpoint", 6), ca.SX.sym("u", len(airframe.inputs))
    q = [x[index[f"q_{a}"]] for a in "wxyz"]
    pos = ca.vertcat(*[x[index[f"pos_{a}"]] for a in AXES]) - setpoint[:3]
    vel = ca.vertcat(*[x[index[f"vel_{a}"]] for a in AXES]) - setpoint[3:]
    yaw = ca.atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] ** 2 + q[3] ** 2))
    heading = [ca.cos(yaw / 2), ca.SX(0), ca.SX(0), ca.sin(yaw / 2)]

    def level(v: ca.SX) -> ca.SX:
        return ca.SX(ca.vertcat(*to_body(heading, [v[0], v[1], v[2]])))

    sign = ca.if_else(q[0] < 0, -1.0, 1.0)
    error = ca.vertcat(
        level(integral),
        level(pos),
        level(vel),
        *[2 * sign * c for c in q[1:]],
        *[x[index[f"omega_{a}"]] for a in AXES],
        x[rotors] - design.rotor_trim if rotors else ca.SX(0, 1),
    )
    command = design.trim - design.gain @ error
    bounded = (
        ca.fmin(ca.fmax(command, 0.0), 1.0)
        if airframe.input_names[drives[0]].startswith("cmd_")
        else command
    )
    u_next = ca.SX(u)
    u_next[drives] = bounded
    return ca.Function("feedback", [x, integral, setpoint, u], [u_next, pos])
