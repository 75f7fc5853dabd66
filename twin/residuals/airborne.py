"""Where a flight is in the air: carried by its rotors and above its resting place."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component
from ..component.rows import OverRows
from .measured import MeasuredMotion

Array = NDArray[np.float64]
LIFT_OFF_HEIGHT_M = 0.1
"""Above its resting place by this much, a vehicle counts as airborne."""
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
