"""What the means of a hover say of a twin: the weight that it carries, and where it hangs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..representation import short_repr
from ..vehicle import Vehicle
from .gap import Channel

_LEAST_S = 2.0
_LIFT, _ROLL, _PITCH = "acc_z", "gyro_rate_x", "gyro_rate_y"


@dataclass(frozen=True, slots=True)
class HoverMeans:
    """A twin on the motor commands of a hover.

    Attributes:
        carried: Thrust of the twin over what the flight shows: 1 where it carries its weight.
        back_m: By how much the centre of mass would have to be further back for the moments about
            pitch to vanish on average, as they do in a hover; None: no body rates.
        right_m: By how much further to the right, about roll.
    """

    carried: float
    back_m: float | None
    right_m: float | None

    __repr__ = short_repr


def hover_means(channels: Sequence[Channel], vehicle: Vehicle) -> HoverMeans | None:
    """Means over the phase `hover` of teacher-forced channels.

    Args:
        channels: Of one flight; specific force along z is needed, angular acceleration is used.
        vehicle: Of the twin.

    Returns:
        None: less than 2 s of hover, or no specific force along z.
    """
    named = {c.name: c for c in channels if c.horizon_s == 0}
    lift = _hovering(named.get(_LIFT))
    if lift is None:
        return None
    measured, simulated = lift
    carried = simulated / measured
    arms: list[float | None] = []
    for name, axis in ((_PITCH, 1), (_ROLL, 0)):
        turned = _hovering(named.get(name))
        if turned is None:
            arms.append(None)
            continue
        missing = float(vehicle.inertia_kg_m2[axis, axis]) * (turned[0] - turned[1] / carried)
        arms.append(missing / (-measured * vehicle.mass_kg))
    return HoverMeans(carried, arms[0], arms[1])


def _hovering(channel: Channel | None) -> tuple[float, float] | None:
    """Means of both sides in hover; None: no such channel, or too short."""
    if channel is None:
        return None
    rows = (channel.phase == "hover") & np.isfinite(channel.residual)
    if not rows.any() or np.count_nonzero(rows) * np.median(np.diff(channel.t_s)) < _LEAST_S:
        return None
    return float(channel.measured[rows].mean()), float(channel.simulated[rows].mean())
