"""From wanted accelerations to rotor inputs: thrust shares, saturation, inverse thrust map.

What does not fit is given up in this order: yaw first, then lift, roll and pitch last.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...component import ComponentBuilder
from ...vehicle.thrust_map import polynomial
from .geometry import clamp
from .hover import ThrustInverse

Array = NDArray[np.float64]
_TINY = 1e-12
_WAYS = (
    ("lift", "kg", "upward acceleration"),
    ("roll", "kg.m", "angular acceleration about forward"),
    ("pitch", "kg.m", "angular acceleration about right"),
    ("yaw", "kg.m", "angular acceleration about down"),
)


@dataclass(frozen=True, slots=True)
class Mixed:
    """Rotor inputs, and the accelerations they give once the rotors have settled."""

    inputs: list[ca.SX]
    lift: ca.SX
    angular: list[ca.SX]


def mix(
    m: ComponentBuilder,
    shares: Array,
    inverse: ThrustInverse,
    unit: str,
    lift: ca.SX,
    angular: list[ca.SX],
) -> Mixed:
    """Declare the mixer's parameters and mix.

    Args:
        m: The controller.
        shares: Thrust per acceleration, N, shape (n_rotors, 4): lift, roll, pitch, yaw.
        inverse: Of the thrust map.
        unit: Of the rotor inputs.
        lift: Wanted specific thrust along body up, m/s2.
        angular: Wanted angular acceleration, rad/s2.
    """
    idle = m.parameter("thrust.idle", inverse.idle_n, "N", "Smallest thrust of a rotor", minimum=0)
    full = m.parameter(
        "thrust.full", inverse.full_n, "N", "Largest thrust of a rotor", minimum=1e-6
    )
    coefficients = [
        m.parameter(
            f"inverse.c{k}",
            float(c),
            unit,
            f"Rotor input, coefficient of sqrt(thrust / thrust.full)^{k}",
        )
        for k, c in enumerate(inverse.coefficients)
    ]
    up, *ways = [
        [
            m.parameter(
                f"mixer_{i}.{way}", float(row[k]), per, f"Thrust of rotor {i} per {meaning}"
            )
            for i, row in enumerate(shares, start=1)
        ]
        for k, (way, per, meaning) in enumerate(_WAYS)
    ]
    turn = [a * angular[0] + b * angular[1] for a, b in zip(ways[0], ways[1], strict=True)]
    spread = _most(turn) - _least(turn)
    share = ca.fmin(1.0, (full - idle) / ca.fmax(spread, _TINY))
    turn = [share * t for t in turn]
    # Between the lift that keeps the lowest rotor turning and the one that fills the highest.
    low = _most([(idle - t) / s for t, s in zip(turn, up, strict=True)])
    high = _least([(full - t) / s for t, s in zip(turn, up, strict=True)])
    lifted = clamp(lift, low, ca.fmax(low, high))
    base = [s * lifted + t for s, t in zip(up, turn, strict=True)]
    yaw = [s * angular[2] for s in ways[2]]
    room = [
        ca.if_else(y > 0, full - b, b - idle) / ca.fmax(ca.fabs(y), _TINY)
        for b, y in zip(base, yaw, strict=True)
    ]
    turned = clamp(_least(room), 0.0, 1.0)
    thrust = [clamp(b + turned * y, idle, full) for b, y in zip(base, yaw, strict=True)]
    return Mixed(
        inputs=[polynomial(coefficients, ca.sqrt(t / full)) for t in thrust],
        lift=lifted,
        angular=[share * angular[0], share * angular[1], turned * angular[2]],
    )


def _most(values: list[ca.SX]) -> ca.SX:
    largest = values[0]
    for value in values[1:]:
        largest = ca.fmax(largest, value)
    return largest


def _least(values: list[ca.SX]) -> ca.SX:
    return -_most([-value for value in values])
