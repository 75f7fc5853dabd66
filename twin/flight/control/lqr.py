"""Gains of the controller: linear-quadratic regulators of three chains of integrators.

With the mixer turning accelerations into rotor thrusts, the hover model falls apart into

| chain | states | input: command of |
|---|---|---|
| horizontal | integral, position, velocity, tilt, body rate, lag | angular acceleration |
| vertical | integral, position, velocity, lag | acceleration |
| heading | integral, heading, body rate, lag | angular acceleration |

each of which has its own algebraic Riccati equation; the lag is there if the rotors have one.
Nothing is tuned by hand but the weights, which follow Bryson's rule.

Source: Bryson & Ho, Applied Optimal Control, sec. 5.2; integral action, Franklin, Powell &
Emami-Naeini, Feedback Control of Dynamic Systems, sec. 7.10.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

from .hover import Hover

Array = NDArray[np.float64]
ACCEPTABLE = {
    "integral": 0.25,  # m s
    "position": 0.25,  # m
    "velocity": 0.8,  # m/s
    "tilt": 0.4,  # rad
    "rate": 4.0,  # rad/s
    "heading_integral": 0.5,  # rad s
    "heading": 0.3,  # rad
    "heading_rate": 1.5,  # rad/s
    "thrust": 0.25,  # share of the hover thrust of a rotor
}
"""Largest deviation that is still fine, per quantity (Bryson's rule): made up, for agile indoor
flight."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Feedback `command = -gain @ states` of one chain.

    Attributes:
        gain: In the order of the states, shape (n,).
        poles: Closed-loop poles, rad/s, shape (n,).
    """

    gain: Array
    poles: NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Gains:
    """All chains, and the mixer they rest on.

    Attributes:
        mixer_n: Rotor thrusts per upward and angular acceleration, shape (n_rotors, 4).
    """

    horizontal: Chain
    vertical: Chain
    heading: Chain
    mixer_n: Array


def design(hover: Hover) -> Gains:
    """Gains for a hover model. The weaker of roll and pitch sets those of the horizontal chain."""
    mixer = np.asarray(np.linalg.pinv(hover.effect), dtype=np.float64)
    share = ACCEPTABLE["thrust"] * hover.thrust_n.mean()
    # One newton-for-newton penalty on the rotors, seen by each acceleration command.
    lift, roll, pitch, yaw = np.sum((mixer / share) ** 2, axis=0)
    drag = float(hover.drag_1_s[:2].mean())
    motion = [ACCEPTABLE[k] for k in ("integral", "position", "velocity")]
    return Gains(
        horizontal=_chain(
            [1.0, 1.0, hover.gravity_m_s2, 1.0],
            [0.0, 0.0, drag, 0.0, 0.0],
            hover.lag_s,
            [*motion, ACCEPTABLE["tilt"], ACCEPTABLE["rate"]],
            max(roll, pitch),
        ),
        vertical=_chain([1.0, 1.0], [0.0, 0.0, hover.drag_1_s[2]], hover.lag_s, motion, lift),
        heading=_chain(
            [1.0, 1.0],
            [0.0, 0.0, 0.0],
            hover.lag_s,
            [ACCEPTABLE[k] for k in ("heading_integral", "heading", "heading_rate")],
            yaw,
        ),
        mixer_n=mixer,
    )


def _chain(
    links: list[float], decay: list[float], lag_s: float, acceptable: list[float], penalty: float
) -> Chain:
    """Riccati design of `dx_k/dt = link_k x_(k+1) - decay_k x_k`, the input at the end."""
    n = len(decay)
    a = np.diag(np.array(links), 1) - np.diag(np.array(decay))
    b = np.zeros((n, 1))
    b[-1] = 1.0
    weight = [1.0 / v**2 for v in acceptable]
    if lag_s > 0:
        a = np.block([[a, b], [np.zeros((1, n)), np.array([[-1.0 / lag_s]])]])
        b = np.vstack([np.zeros((n, 1)), [[1.0 / lag_s]]])
        weight.append(0.0)  # its own command is weighted
    q, r = np.diag(weight), np.array([[penalty]])
    gain = np.linalg.solve(r, b.T @ solve_continuous_are(a, b, q, r)).ravel()
    return Chain(gain, np.linalg.eigvals(a - b * gain).astype(np.complex128))
