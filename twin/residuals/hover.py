"""The one diagnosis of a twin in hover, which all verbs show: level of the thrust, centre of mass,
axis of the thrust, split of the motors, a single weak rotor.

In a hover forces and moments balance on average, so that the means of measured and simulated
specific force and angular acceleration over it give, at the commands of the flight,

| quantity | by |
|---|---|
| thrust of the twin over that of the flight | mean acc_z of both |
| centre of mass against that of the file | mean moments about pitch and roll, over the weight |
| thrust axis against -z of the body | mean residual of acc_x and acc_y, over mean acc_z |
| a single weak rotor instead of another centre of mass | the rotor towards which the latter lies |

The two last rows of moments are one measurement: one hover cannot part them. Standard errors are
those of means over blocks of one second.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..draft.hover import LEAST_S, LONGEST_STEP_S, Hover
from ..logs.columns import ACC
from ..representation import short_repr
from ..vehicle import Vehicle
from .gap import Channel

Array = NDArray[np.float64]
_BLOCK_S, _FEWEST_BLOCKS = 1.0, 2
SURE = 2.0
"""Standard errors from which on a value of the diagnosis differs from zero."""


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over a hover.

    Attributes:
        value: In its unit.
        sd: Standard error.
    """

    value: float
    sd: float

    @property
    def clear(self) -> bool:
        """Whether it differs from zero."""
        return abs(self.value) > SURE * self.sd


@dataclass(frozen=True, slots=True)
class WeakRotor:
    """A single rotor that gives less thrust than the others, in the place of another centre of
    mass.

    Attributes:
        rotor: Number, from 1 on.
        loss: Share of its thrust.
    """

    rotor: int
    loss: Mean


@dataclass(frozen=True, slots=True)
class HoverDiagnosis:
    """A twin at the motor commands of a hover.

    Attributes:
        flight: Name of the flight.
        where: Which part of the flight, in words.
        seconds: How long.
        carried: Thrust of the twin over what the flight shows: 1 where it carries its weight.
        back_m: By how much the centre of mass would have to be further back than in the file for
            the mean moments about pitch to vanish, m; None: no body rates.
        right_m: By how much further right, about roll, m.
        lean_forward_rad: Angle by which the thrust of the flight leans forward of that of the twin,
            rad: of the rotors, or of the board that carries the accelerometer; None: unknown.
        lean_right_rad: The same to the right, rad.
        split: Of each motor its command, else speed, over the mean of all, less one.
        weakest: The rotor whose loss would do what the centre of mass would, if a single one can.
    """

    flight: str
    where: str
    seconds: float
    carried: Mean
    back_m: Mean | None
    right_m: Mean | None
    lean_forward_rad: Mean | None
    lean_right_rad: Mean | None
    split: tuple[float, ...]
    weakest: WeakRotor | None

    __repr__ = short_repr


def diagnose(
    channels: Sequence[Channel], vehicle: Vehicle, hover: Hover | None
) -> HoverDiagnosis | None:
    """Diagnosis of a twin in hover.

    Args:
        channels: Teacher-forced ones of the flight; specific force along z is needed.
        vehicle: Of the twin.
        hover: Of the flight, as `hover_of` gives it.

    Returns:
        None: the flight does not hover, or has less than 2 s of specific force along z there.
    """
    if hover is None or not hover.hovers:
        return None
    named = {c.name: c for c in channels if c.horizon_s == 0}
    lift = _both(named.get(ACC[2]), hover)
    if lift is None:
        return None
    t_s, measured, simulated = lift
    down, twin_down = float(measured.mean()), float(simulated.mean())
    ratio = twin_down / down
    carried = Mean(ratio, _standard_error(t_s, (simulated - ratio * measured) / down))
    arms = [_arm(named.get(n), hover, vehicle, axis, carried, down) for n, axis in _TURNS]
    leans = [_lean(named.get(name), hover, down) for name in ACC[:2]]
    back, right = arms
    return HoverDiagnosis(
        hover.flight,
        hover.where,
        hover.seconds,
        carried,
        back,
        right,
        leans[0],
        leans[1],
        hover.split,
        _weakest(vehicle, back, right),
    )


_TURNS = (("gyro_rate_y", 1), ("gyro_rate_x", 0))


def _both(channel: Channel | None, hover: Hover) -> tuple[Array, Array, Array] | None:
    """Times, shape (n,), and both sides of a channel in hover; None: no such channel, or less than
    2 s of it."""
    if channel is None or len(channel.t_s) < 2:
        return None
    near = np.clip(np.searchsorted(hover.t_s, channel.t_s), 1, len(hover.t_s) - 1)
    apart = np.abs(channel.t_s[:, None] - hover.t_s[np.stack([near - 1, near], axis=1)]).min(axis=1)
    rows = (apart <= LONGEST_STEP_S) & np.isfinite(channel.residual)
    if np.count_nonzero(rows) * float(np.median(np.diff(channel.t_s))) < LEAST_S:
        return None
    return channel.t_s[rows], channel.measured[rows], channel.simulated[rows]


def _standard_error(t_s: Array, values: Array) -> float:
    """Of a mean, by the means of blocks of one second; of the values where blocks are too few."""
    _, block = np.unique(np.floor(t_s / _BLOCK_S), return_inverse=True)
    count = np.bincount(block)
    means = np.bincount(block, values) / count
    full = means[count >= 0.5 * count.max()]
    if len(full) < _FEWEST_BLOCKS:
        return math.inf
    return float(full.std(ddof=1) / math.sqrt(len(full)))


def _arm(
    channel: Channel | None,
    hover: Hover,
    vehicle: Vehicle,
    axis: int,
    carried: Mean,
    down: float,
) -> Mean | None:
    """Mean moment about an axis that the twin lacks at its weight, over the weight, m."""
    turned = _both(channel, hover)
    if turned is None:
        return None
    t_s, measured, simulated = turned
    per_turn = float(vehicle.inertia_kg_m2[axis, axis]) / (-down * vehicle.mass_kg)
    missing = per_turn * (measured - simulated / carried.value)
    return Mean(float(missing.mean()), _standard_error(t_s, missing))


def _lean(channel: Channel | None, hover: Hover, down: float) -> Mean | None:
    """Angle of the thrust from that of the twin along an axis, rad."""
    pushed = _both(channel, hover)
    if pushed is None:
        return None
    t_s, measured, simulated = pushed
    angle = (measured - simulated) / -down
    return Mean(float(angle.mean()), _standard_error(t_s, angle))


def _weakest(vehicle: Vehicle, back: Mean | None, right: Mean | None) -> WeakRotor | None:
    """The rotor towards which the centre of mass seems to lie; None where it lies at the file's
    place, or towards none of them within its standard error.

    A rotor at p that lacks the share l of its thrust is commanded more; the twin, which does not
    lack it, then turns as if the centre of mass were the share r = l / (n - (n - 1) l) of p away,
    of n rotors.
    """
    if back is None or right is None or not (back.clear or right.clear):
        return None
    place = np.array([-back.value, right.value])
    sd = np.array([back.sd, right.sd])
    centre = vehicle.rotors.position_m[:, :2].mean(axis=0)
    rotors = vehicle.rotors.position_m[:, :2] - centre
    reach = rotors @ place / np.sum(rotors**2, axis=1)
    rotor = int(np.argmax(reach))
    unit = rotors[rotor] / np.linalg.norm(rotors[rotor])
    across = np.array([-unit[1], unit[0]])
    if abs(across @ place) > SURE * float(np.linalg.norm(across * sd)):
        return None
    count, share = len(rotors), float(reach[rotor])
    thrust = 1 + (count - 1) * share
    sd_share = float(np.linalg.norm(unit * sd)) / float(np.linalg.norm(rotors[rotor]))
    return WeakRotor(rotor + 1, Mean(count * share / thrust, count * sd_share / thrust**2))
