"""What the controllers of ArduPilot were asked for, in the units of the flight table."""

import numpy as np

from ....frames import from_euler
from ...autopilot import Setpoint, setpoint_of
from ...columns import GYRO, POS, QUAT, VEL
from ...flight import Array
from ..log import ArduPilotLog, Topic

_AXES = "NED"
_TOGETHER_S = 0.2
"""The messages of three axes are of one step of the controller: sound logs, under 1 ms."""
_ANGLES = ("DesRoll", "DesPitch", "DesYaw")
_RATES = ("RDes", "PDes", "YDes")


def setpoints(log: ArduPilotLog, end_s: float) -> tuple[Setpoint, ...]:
    """Setpoints of position, velocity, attitude and rates, those that the log has.

    Args:
        log: The log, cut to the flight.
        end_s: End of the record, s.
    """
    found = [
        _course(log, POS, "TP", end_s),
        _course(log, VEL, "TV", end_s),
        _attitude(log, end_s),
        _rates(log, end_s),
    ]
    return tuple(s for s in found if s is not None)


def _course(
    log: ArduPilotLog, columns: tuple[str, ...], letters: str, end_s: float
) -> Setpoint | None:
    """Targets of PSCN, PSCE and PSCD (ArduPilot 4.1 and later), at the times of the last.

    The horizontal controller rests where the pilot gives a lean angle: nothing is asked for then.
    """
    axes = [log.whole(f"PSC{a}") for a in _AXES]
    down = axes[-1]
    if down is None:
        return None
    down, times = _until(down, end_s)
    values = np.full((len(times), len(_AXES)), np.nan)
    for k, (axis, topic) in enumerate(zip(_AXES, axes, strict=True)):
        name = f"{letters}{axis}"
        if topic is not None and topic.has(name):
            values[:, k] = _nearest(topic, topic.si((name,))[:, 0], times)
    return setpoint_of(columns, times, values)


def _nearest(topic: Topic, values: Array, t_s: Array) -> Array:
    """Values at the nearest of a topic's times; NaN where none is near."""
    after = np.clip(np.searchsorted(topic.t_s, t_s), 0, len(values) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(topic.t_s[before] - t_s) < np.abs(topic.t_s[after] - t_s)
    index = np.where(nearer, before, after)
    return np.where(np.abs(topic.t_s[index] - t_s) < _TOGETHER_S, values[index], np.nan)


def _attitude(log: ArduPilotLog, end_s: float) -> Setpoint | None:
    topic = log.whole("ATT")
    if topic is None or not topic.has(*_ANGLES):
        return None
    topic, times = _until(topic, end_s)
    roll, pitch, yaw = topic.si(_ANGLES).T
    q = np.asarray(from_euler(roll, pitch, yaw), dtype=np.float64).T
    return setpoint_of(QUAT, times, q)


def _rates(log: ArduPilotLog, end_s: float) -> Setpoint | None:
    topic = log.whole("RATE")
    if topic is None or not topic.has(*_RATES):
        return None
    topic, times = _until(topic, end_s)
    return setpoint_of(GYRO, times, topic.si(_RATES))


def _until(topic: Topic, end_s: float) -> tuple[Topic, Array]:
    """A topic in the record, and its times, s."""
    inside = (topic.t_us >= 0) & (topic.t_s <= end_s)
    cut = Topic(topic.name, topic.t_us[inside], topic.source, topic.rows[inside])
    return cut, cut.t_s
