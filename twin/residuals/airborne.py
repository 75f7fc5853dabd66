"""Where a flight is in the air: carried by its rotors and above its resting place.

What modelled thrust carries the vehicle is told by the flight, not by the weight of the vehicle
file: the file may be wrong in thrust or mass, which is for others to find. The flight shows that it
is in the air by, in this order, the land detector of the log, its height, and a specific force that
follows the thrust: on the ground the legs take the difference.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component
from ..component.rows import OverRows
from .measured import MeasuredMotion

Array = NDArray[np.float64]
LIFT_OFF_HEIGHT_M = 0.1
"""Above its resting place by this much, a vehicle counts as airborne."""
CLEAR_HEIGHT_M = 0.5
"""Above its lowest by this much, a vehicle is in the air, wherever its resting place is."""
CLEAR_S = 1.0
"""For this long it has to be."""
_ROUNDING = 1e-9
FOLLOWS, BLOCK_S, FEWEST_BLOCKS = 0.7, 0.25, 12
"""Correlation from which on the specific force follows the thrust, both as means over blocks of
time, of which so many are needed."""
LEAST_CARRY, TRUSTED_CARRY = 0.15, 1.5
"""Modelled thrust over weight below which nothing flies, however wrong the file: idling rotors;
factor either way by which the file may be off before it is of any concern here."""
START_S = 0.2
"""From the begin of a record, in which it is told whether it begins in the air."""


def starts_in_air(carried: NDArray[np.bool_], grounded: NDArray[np.bool_], step_s: float) -> bool:
    """Whether a record begins in the air.

    Args:
        carried: Whether the rotors carry half of the weight, from the first grid point on.
        grounded: Whether it is said to be on the ground.
        step_s: Step of the grid.
    """
    soon = slice(None, max(1, round(START_S / step_s)))
    return bool(np.median(carried[soon])) and not grounded[0]


def carry(
    thrust_n: NDArray[np.floating[Any]],
    grounded: NDArray[np.bool_],
    height_m: Array,
    force: Callable[[], Array],
    step_s: float,
) -> float | None:
    """Modelled thrust that carries the vehicle in a flight, N, whatever its file says of the
    weight; None: the flight does not show that it is in the air.

    Args:
        thrust_n: Modelled thrust, shape (n,).
        grounded: Whether the log says that it is on the ground, shape (n,).
        height_m: NaN where unknown, shape (n,); of no length without a position.
        force: Gives the specific force along the thrust, m/s^2, NaN where unknown, shape (n,); of
            no length without an accelerometer.
        step_s: Step of the grid.
    """
    least = CLEAR_S / step_s
    if grounded.any() and np.sum(~grounded) > least:
        return float(np.median(thrust_n[~grounded]))
    known_m = height_m[np.isfinite(height_m)]
    if len(known_m):
        above = ~grounded & (height_m > np.quantile(known_m, 0.01) + CLEAR_HEIGHT_M)
        if np.sum(above) > least:
            return float(np.median(thrust_n[above]))
    along = force()
    if not len(along):
        return None
    block = max(round(BLOCK_S / step_s), 1)
    whole = len(along) // block * block
    pushed, along = (v[:whole].reshape(-1, block).mean(axis=1) for v in (thrust_n, along))
    strong = np.isfinite(along)
    strong &= pushed > np.quantile(pushed, 0.9, method="lower") / 2 if len(pushed) else False
    x, y = pushed[strong], along[strong]
    if len(x) < FEWEST_BLOCKS:
        return None
    x_apart, y_apart = x - np.mean(x), y - np.mean(y)
    sizes = float(np.sqrt(np.sum(x_apart**2) * np.sum(y_apart**2)))
    if not sizes > _ROUNDING * float(np.sqrt(np.sum(x**2) * np.sum(y**2))):
        return None  # one of them is constant
    return float(np.median(x)) if np.sum(x_apart * y_apart) / sizes > FOLLOWS else None


def resting_height(height_m: Array, carried: NDArray[np.bool_]) -> float | None:
    """Height of the resting place, m: median of what is known where nothing carries; None: it is
    not known."""
    rest = height_m[np.isfinite(height_m) & ~carried]
    return float(np.median(rest)) if len(rest) else None


def in_flight(
    carried: NDArray[np.bool_],
    grounded: NDArray[np.bool_],
    height_m: Array,
    resting_m: float | None,
) -> NDArray[np.bool_]:
    """Grid points in flight, shape (n,).

    Args:
        carried: Shape (n,).
        grounded: Shape (n,).
        height_m: Shape (n,); not used without a resting place.
        resting_m: Height of the resting place; None: it does not count.
    """
    airborne = carried & ~grounded
    if resting_m is not None:
        airborne &= ~(height_m < resting_m + LIFT_OFF_HEIGHT_M)
    return np.asarray(airborne)


def why_grounded(motion: MeasuredMotion, said: bool) -> str:
    """Way out for a flight without a sample in the air, `said` to be on the ground all along."""
    if said:
        return "the whole flight is in phase ground."
    if motion.position is not None:
        down = motion.position.values[:, 2]
        if (
            np.max(down) - down[0] > 5 * LIFT_OFF_HEIGHT_M
            and down[0] - np.min(down) < LIFT_OFF_HEIGHT_M
        ):
            return (
                f"pos_z rises to {np.max(down):.2f} m and never goes below its start. It counts "
                f"down: is it an altitude?"
            )
    return (
        "its rotors never carry half of the weight more than 0.1 m above the resting place. Check "
        "the vehicle file, the scale of the commands and the length of the record."
    )


def rotor_thrust(body: Component, rotors: int) -> OverRows:
    """Thrust of all rotors together in still air, N, shape (n, 1), of their states and inputs."""
    moving = [i for i, s in enumerate(body.states) if s.name.startswith(("rotor_", "effort_"))]
    r, u = ca.SX.sym("r", len(moving)), ca.SX.sym("u", len(body.inputs))
    p = body.parameter_values()
    x = ca.SX(body.initial(body.input_values(), p))
    x[moving] = r
    each = [body.output_names.index(f"thrust_{i}") for i in range(1, rotors + 1)]
    total = ca.sum1(body.outputs(x, u, p)[each])
    return OverRows(ca.Function("thrust", [r, u], [ca.densify(total)]), 2)
