"""How large a constant of one flight may be that nothing explains: trim, levelling, warmth."""

from collections.abc import Sequence

from ...physics.sensors.table import BODY, sensor_of
from ...vehicle import GRAVITY_M_S2, Vehicle
from ..settings import EvidenceSettings

FAST_RAD_S = 0.4
"""Body rate of a brisk turn."""


def constants_of_days(
    channels: Sequence[str], vehicle: Vehicle, settings: EvidenceSettings
) -> list[float]:
    """Standard deviation of the constant of each channel between flights, in its unit."""
    return [_constant(name, vehicle, settings) for name in channels]


def _constant(name: str, vehicle: Vehicle, settings: EvidenceSettings) -> float:
    """Of one channel: of a sensor, or of what the pose says in its place (`motion_`) or against it
    (`pose_`)."""
    kind, _, read = name.partition("_")
    against = kind == "pose"
    if against or kind == "motion":
        name = read.replace("rate_", "gyro_rate_") if kind == "motion" else read
    sensor = sensor_of(name)
    assert sensor is not None, name
    if against:
        return settings.trim_pose * (FAST_RAD_S if sensor.rate_unit else GRAVITY_M_S2)
    columns = sensor.channels if name in sensor.channels else sensor.columns
    axis = columns.index(name)
    size = sensor.size(vehicle)[axis]
    if sensor.group != BODY:
        return settings.trim_other * size
    if not sensor.rate_unit:
        return settings.trim_force * size
    return settings.trim_turn * size * (settings.trim_yaw if axis == 2 else 1.0)
