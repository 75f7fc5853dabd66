"""PX4's multirotor mixer with airmode off, as CasADi expressions.

The same as `flightlog.px4_control.mix`, which works on arrays of a log; a test compares them.

Source: PX4 v1.12, lib/mixer/MultirotorMixer (BSD licence; written from the description of
what it computes).
"""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_YAW_CEILING = 1.15
_CLIPPED_LOW = 0.005


def mix_airmode_off(controls: list[ca.SX], scale: Array, thrust_factor: ca.SX) -> list[ca.SX]:
    """Roll, pitch, yaw (-1..1) and thrust (0..1) -> motor commands 0..1.

    Args:
        controls: Roll, pitch, yaw, thrust.
        scale: Share of each in each motor, shape (motors, 4).
        thrust_factor: THR_MDL_FAC.
    """
    roll, pitch, yaw = (ca.fmin(ca.fmax(c, -1.0), 1.0) for c in controls[:3])
    thrust = ca.fmin(ca.fmax(controls[3], 0.0), 1.0)
    out = [r * roll + p * pitch + t * thrust for r, p, _, t in scale]
    out = _desaturate(out, scale[:, 3], reduce_only=True)
    out = _desaturate(_desaturate(out, scale[:, 0]), scale[:, 1])
    out = [o + y * yaw for o, y in zip(out, scale[:, 2], strict=True)]
    out = _desaturate(out, scale[:, 2], high=_YAW_CEILING)
    out = _desaturate(out, scale[:, 3], reduce_only=True)
    return [ca.fmin(ca.fmax(_linearised(o, thrust_factor), 0.0), 1.0) for o in out]


def blocked_by(commands: list[ca.SX], column: Array) -> tuple[ca.SX, ca.SX]:
    """Whether a motor at its lower end forbids the integral of one axis to grow, and to shrink."""
    grow, shrink = ca.SX(0), ca.SX(0)
    for command, share in zip(commands, column.tolist(), strict=True):
        low = command < _CLIPPED_LOW
        if share < 0:
            grow = ca.logic_or(grow, low)
        if share > 0:
            shrink = ca.logic_or(shrink, low)
    return grow, shrink


def _linearised(out: ca.SX, factor: ca.SX) -> ca.SX:
    """Command that gives a thrust when `thrust = factor cmd^2 + (1 - factor) cmd`."""
    safe = ca.fmax(factor, 1e-3)
    half = (1.0 - safe) / (2.0 * safe)
    curved = -half + ca.sqrt(half * half + ca.fmax(out, 0.0) / safe)
    return ca.if_else(factor > 0, curved, out)


def _desaturate(
    out: list[ca.SX], way: Array, high: float = 1.0, reduce_only: bool = False
) -> list[ca.SX]:
    """Shift the outputs along `way` until they fit, or the excess is equal at both ends."""
    first = _gain(out, way, high)
    moved = [o + first * w for o, w in zip(out, way, strict=True)]
    second = 0.5 * _gain(moved, way, high)
    moved = [o + second * w for o, w in zip(moved, way, strict=True)]
    if not reduce_only:
        return moved
    return [ca.if_else(first > 0, o, n) for o, n in zip(out, moved, strict=True)]


def _gain(out: list[ca.SX], way: Array, high: float) -> ca.SX:
    """How far to go along `way` to undo the worst excess below 0 and above `high`."""
    low_k, high_k = ca.SX(0), ca.SX(0)
    for o, w in zip(out, way.tolist(), strict=True):
        if abs(w) < 1e-7:
            continue
        k = ca.if_else(o < 0, -o, ca.if_else(o > high, high - o, 0.0)) / w
        low_k, high_k = ca.fmin(low_k, k), ca.fmax(high_k, k)
    return low_k + high_k
