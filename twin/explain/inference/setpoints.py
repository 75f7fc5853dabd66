"""Setpoints as accelerations: of a mission or pilot, of an attitude controller, and the mean of
other flights of the same mission; and the flown speed.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.signal import butter, correlate, sosfiltfilt

from ...frames import to_euler
from ...logs import Flight
from ...logs.columns import POS, QUAT, VEL
from ...residuals.channels import CHANNEL_HZ, Array, ChannelData
from ...residuals.measured import signal_of

FEWEST = 50
"""Least number of samples of a setpoint."""
ALIKE = 0.8
"""Correlation of velocities from which on two flights belong to one mission. Made up."""
SLOW_HZ, SLOWEST_WAY_M_S = 0.8, 0.25
"""Frequency below which, and standard deviation from which, speeds belong to deliberate travel. In
hover disturbances move aircraft by 0.05 to 0.3 m/s."""
SHARPEST = 0.3, 6.0
"""Cut-off of the low-pass of a setpoint before differentiation: share of its sample rate, and upper
limit in Hz."""


def turns(channel: str) -> bool:
    """Whether a channel is an angular acceleration."""
    return channel.startswith(("gyro_rate_", "motion_rate_"))


def lifts(channel: str) -> bool:
    """Whether a channel is the specific force along the thrust."""
    return channel in {"acc_z", "motion_acc_z"}


def _mission(flights: Sequence[Flight], own: Sequence[ChannelData], f: int) -> Array | None:
    """The velocity setpoint across an axis, and its third derivative, shape (n, 2): the moments by
    the air and by the rotors during the motion. For a position setpoint, one derivative more. About
    z it is the heading, which no position loop moves."""
    flight, autopilot, name = flights[f], flights[f].autopilot, own[f].name
    if name.endswith("z"):
        return _attitude(flights, own, f)
    courses = [] if autopilot is None else [autopilot.setpoint(VEL), autopilot.setpoint(POS)]
    course = next((s for s in courses if s is not None), None)
    if course is None or not flight.has(*QUAT):
        return None
    known, more = np.isfinite(course.values[:, :2]).all(axis=1), int(course.columns == POS)
    t_s = course.t_s[known]
    way = _across(flight, t_s, course.values[known, :2], name)
    turned, speed = (_derived(t_s, way, own[f].t_s, k + more) for k in (3, 0))
    return None if turned is None or speed is None else np.column_stack([turned, speed])


def _across(flight: Flight, t_s: Array, level: Array, name: str) -> Array:
    """Component of a horizontal vector, north and east, (n, 2): forward for a pitch channel, else
    to the right."""
    attitude = signal_of(flight, QUAT)
    yaw = np.interp(t_s, attitude.t_s, np.unwrap(to_euler(attitude.values.T)[2]))
    yaw += 0.0 if name.endswith("y") else np.pi / 2
    return np.asarray(np.cos(yaw) * level[:, 0] + np.sin(yaw) * level[:, 1])


def flown_across(flight: Flight, channel: ChannelData) -> Array | None:
    """The flown speed across an axis, m/s, at the samples of its channel; None about z, and where
    the flight does not contain it."""
    if channel.name.endswith("z") or not flight.has(*VEL, *QUAT):
        return None
    flown = signal_of(flight, VEL)
    way = _across(flight, flown.t_s, flown.values[:, :2], channel.name)
    return np.asarray(np.interp(channel.t_s, flown.t_s, way))


def _flown(flights: Sequence[Flight], own: Sequence[ChannelData], f: int) -> Array | None:
    """The flown speed itself, shape (n, 1), for a flight with deliberate travel."""
    speed = flown_across(flights[f], own[f])
    if speed is None or len(speed) < FEWEST:
        return None
    low = sosfiltfilt(butter(2, SLOW_HZ / (CHANNEL_HZ / 2), output="sos"), speed)
    return speed[:, None] if float(np.std(low)) >= SLOWEST_WAY_M_S else None


def _attitude(flights: Sequence[Flight], own: Sequence[ChannelData], f: int) -> Array | None:
    """Second derivative of the attitude setpoint, shape (n, 1)."""
    autopilot = flights[f].autopilot
    attitude = None if autopilot is None else autopilot.setpoint(QUAT)
    if attitude is None:
        return None
    known = np.isfinite(attitude.values).all(axis=1)
    angle = np.unwrap(to_euler(attitude.values[known].T)["xyz".index(own[f].name[-1])])
    return _derived(attitude.t_s[known], angle, own[f].t_s, 2)


def _others(flights: Sequence[Flight], own: Sequence[ChannelData], f: int) -> Array | None:
    """Mean prediction of other flights of the same mission, aligned in time, shape (n, 1)."""
    found = []
    for g in (g for g in range(len(own)) if g != f):
        later_s = _later(flights[f], flights[g])
        if later_s is not None:
            t_s, predicted = own[g].t_s - later_s, own[g].measured - own[g].residual
            found.append(np.interp(own[f].t_s, t_s, predicted, 0.0, 0.0))
    return np.mean(found, axis=0)[:, None] if found else None


SOURCES: dict[str, Callable[[Sequence[Flight], Sequence[ChannelData], int], Array | None]] = {
    "mission": _mission,
    "attitude setpoint": _attitude,
    "other flights": _others,
    "flown speed": _flown,
}
"""Possible instruments in order of trust: functions of the flights, the channel of each, and the
index of the flight."""


def _derived(t_s: Array, values: Array, at_s: Array, times: int) -> Array | None:
    """A derivative of a setpoint at some times, (n, 1); None where it has too few samples."""
    if len(t_s) < FEWEST:
        return None
    grid = np.arange(at_s[0] - 1, at_s[-1] + 1, 1 / CHANNEL_HZ)
    share, most_hz = SHARPEST
    edge = min(share / float(np.median(np.diff(t_s))), most_hz) / (CHANNEL_HZ / 2)
    z = sosfiltfilt(butter(2, edge, output="sos"), np.interp(grid, t_s, values))
    for _ in range(times):
        z = np.gradient(z) * CHANNEL_HZ
    return np.asarray(np.interp(at_s, grid, z))[:, None]


def _later(one: Flight, other: Flight) -> float | None:
    """Time offset of another flight of the same mission, s; None: it is of another mission."""
    if not (one.has(*VEL) and other.has(*VEL)):
        return None
    step_s, moved, starts = 2 / CHANNEL_HZ, [], []
    for velocity in (signal_of(f, VEL) for f in (one, other)):
        grid = np.arange(velocity.t_s[0], velocity.t_s[-1], step_s)
        moved.append([np.interp(grid, velocity.t_s, v) for v in velocity.values.T])
        starts.append(velocity.t_s[0])
    a, b = moved
    both = np.sum([correlate(y, x) for x, y in zip(a, b, strict=True)], axis=0)
    k = int(np.argmax(both))
    if both[k] < ALIKE * np.linalg.norm(a) * np.linalg.norm(b):
        return None
    return float((k - (len(a[0]) - 1)) * step_s + starts[1] - starts[0])
