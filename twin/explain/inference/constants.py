"""How large a constant of one flight may be that nothing explains: trim, levelling, warmth."""

from collections.abc import Sequence

from ...physics.sensors.table import BODY, Sensor, sensor_of
from ...vehicle import GRAVITY_M_S2, Vehicle
from ..settings import EvidenceSettings

FAST_RAD_S = 0.4
"""Body rate of a brisk turn."""


def constants_of_days(
    channels: Sequence[str], vehicle: Vehicle, settings: EvidenceSettings
) -> list[float]:
    """Standard deviation of the constant of each channel between flights, in its unit."""
    return [_constant(name, vehicle, settings) for name in channels]


def sensor_read(channel: str) -> Sensor:
    """The sensor that a channel is of: that itself, or the one that the pose stands in for
    (`motion_`) or is compared with (`pose_`)."""
    sensor = sensor_of(_reading(channel))
    assert sensor is not None, channel
    return sensor


def _reading(channel: str) -> str:
    kind, _, read = channel.partition("_")
    if kind == "motion":
        return read.replace("rate_", "gyro_rate_")
    return read if kind == "pose" else channel


def _constant(name: str, vehicle: Vehicle, settings: EvidenceSettings) -> float:
    """Of one channel."""
    sensor, read = sensor_read(name), _reading(name)
    if name.startswith("pose_"):
        return settings.trim_pose * (FAST_RAD_S if sensor.rate_unit else GRAVITY_M_S2)
    columns = sensor.channels if read in sensor.channels else sensor.columns
    axis = columns.index(read)
    size = sensor.size(vehicle)[axis]
    if sensor.group != BODY:
        return settings.trim_other * size
    if not sensor.rate_unit:
        return settings.trim_force * size
    return settings.trim_turn * size * (settings.trim_yaw if axis == 2 else 1.0)
