"""The load on its rope as it swings in a flight: a pendulum that keeps an eye on the accelerometer.

    e = (d - (d . p) p) / max(|d|, d0) where T > 0, else 0
    d p / d t = w + K e,   d w / d t = ((p . f) p - f) / l - |w|^2 p + L e
    T = M / (M + m) (l |w|^2 - p . f) m

p points from the vehicle to the load, w is its rate, f the specific force that the model predicts
without the load, d what the accelerometer reads beyond that, all NED; l is the length of the rope,
M the mass of the vehicle, m that of the load, T the tension.

A pendulum left to itself forgets nothing: an error of a percent in its length and it is out of
step after ten swings, and beyond the horizontal it is chaotic. The terms with e pull it towards
the direction of the force that is really felt. They use the past only, and know directions, not
sizes, so the swing does not depend on the mass.

Source: Sreenath, Michael & Kumar, ICRA 2013, eq. 2 to 5; e makes it a Luenberger observer
(IEEE Trans. Autom. Control 16, 1971).
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component.along import accumulated

Array = NDArray[np.float64]
Course = tuple[Array, Array]
"""Unit vectors from the vehicle to the load, and their rates, 1/s, NED. Shapes (n, 3)."""
ROPE_HZ = 5.0
"""Natural frequency of the load on its rope, Hz: stiff beside any pendulum, slow beside 1 ms."""
DIRECTION_GAIN_1_S, RATE_GAIN_1_S2 = 8.0, 16.0
"""K and L. Chosen on benchmark flights: with half of them a load that swings beyond 60 degrees is
lost for seconds, and its mass comes out too small. What is no pendulum is not followed so fast that
it would pass as one: its own effect still fits far better."""
FAINT_M_S2 = 0.3
"""d0: force of a load of 3 % of the vehicle at rest; of a fainter one the direction is noise."""
PLACE = tuple(f"slung_load.r_{a}" for a in "xyz")
SPEED = tuple(f"slung_load.v_{a}" for a in "xyz")


def observe_swing(free_n: Array, excess_n: Array, length_m: float, step_s: float) -> Course:
    """Direction of the rope and its rate, from a load at rest.

    Args:
        free_n: Specific force predicted without the load, NED, m/s^2. Shape (n, 3).
        excess_n: Measured specific force beyond it, NED, m/s^2; zero where unknown. Shape (n, 3).
        length_m: Of the rope.
        step_s: Of the grid.

    Returns:
        Unit vectors from the vehicle to the load, and their rates, 1/s, NED. Shapes (n, 3).
    """
    state, free, excess = ca.SX.sym("state", 6), ca.SX.sym("free", 3), ca.SX.sym("felt", 3)
    p, w = state[:3], state[3:]
    taut = length_m * ca.dot(w, w) > ca.dot(p, free)
    innovation = (excess - ca.dot(excess, p) * p) / ca.fmax(ca.norm_2(excess + 1e-12), FAINT_M_S2)
    bend = (ca.dot(p, free) * p - free) / length_m - ca.dot(w, w) * p
    innovation = ca.if_else(taut, innovation, 0.0)
    w = w + step_s * (bend + RATE_GAIN_1_S2 * innovation)
    p = p + step_s * (w + DIRECTION_GAIN_1_S * innovation)
    p = p / ca.norm_2(p)
    step = ca.Function("swing_step", [state, free, excess], [ca.vertcat(p, w - ca.dot(w, p) * p)])
    start = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    (after,) = accumulated(step, start, free_n, excess_n)
    rows = np.vstack([start, after[:-1]])
    return rows[:, :3], rows[:, 3:]


def hang_load(
    states: Array,
    names: Sequence[str],
    swung: Course,
    free_n: Array,
    length_m: float,
    share: float,
) -> Array:
    """States with the load where it swings.

    The rope is stretched by what the tension asks for, so that the equations of the airframe,
    whose rope is elastic, pull with just this tension.

    Args:
        states: Of the airframe, shape (n, n_x).
        names: Of the states.
        swung: Direction and rate, of `observe_swing`.
        free_n: As in `observe_swing`.
        length_m: Of the rope.
        share: Mass of the load over that of the vehicle, which it slows down.
    """
    along, rate = swung
    pull = length_m * np.sum(rate**2, axis=1) - np.sum(along * free_n, axis=1)
    stretch = np.maximum(pull, 0.0) / (1 + share) / (2 * np.pi * ROPE_HZ) ** 2
    at = {name: i for i, name in enumerate(names)}
    states = states.copy()
    states[:, [at[n] for n in PLACE]] = along * (length_m + stretch)[:, None]
    vel = states[:, [at[f"vel_{a}"] for a in "xyz"]]
    states[:, [at[n] for n in SPEED]] = vel + length_m * rate
    return states
