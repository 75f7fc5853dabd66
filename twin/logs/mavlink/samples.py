"""Samples of a flight table that MAVLink messages carry, and which of several messages counts."""

from collections.abc import Mapping
from dataclasses import dataclass

from ..columns import ACC, GYRO, MAG, POS, QUAT, VEL

GROUPS: dict[str, tuple[str, ...]] = {
    "acc": ACC,
    "gyro": GYRO,
    "mag": MAG,
    "baro": ("baro_pa",),
    "pos": POS,
    "vel": VEL,
    "q": QUAT,
    "vbat_v": ("vbat_v",),
    "ibat_a": ("ibat_a",),
}
"""Columns that are sampled together; those of `cmd` and `rotor` depend on the number of motors."""
LANDED = "landed"
"""Group of what the land detector says: a member of MAV_LANDED_STATE."""
RANKS: tuple[str, ...] = (
    "HIGHRES_IMU",
    "ODOMETRY",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "ACTUATOR_OUTPUT_STATUS",
    "DEBUG_FLOAT_ARRAY",
    "BATTERY_STATUS",
    "SCALED_IMU",
    "RAW_IMU",
    "SCALED_IMU2",
    "SCALED_IMU3",
    "ATTITUDE",
    "VICON_POSITION_ESTIMATE",
    "SERVO_OUTPUT_RAW",
    "ESC_TELEMETRY",
    "SCALED_PRESSURE",
    "SYS_STATUS",
    "EXTENDED_SYS_STATE",
)
"""Sources of samples, those that lose less on the wire before the others."""
_OFTEN = 1.5
"""A source that comes so many times as often counts more than one of a better rank."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One reading of one signal.

    Attributes:
        group: A key of `GROUPS`, `cmd`, `rotor` or `LANDED`.
        source: Kind of message, a member of `RANKS`.
        t_us: When it was taken, on the aircraft's clock, us.
        values: In the units of the flight table, in the order of its columns.
    """

    group: str
    source: str
    t_us: int
    values: tuple[float, ...]


def best_source(counts: Mapping[str, int]) -> str:
    """Which of several sources of one group counts.

    Args:
        counts: Samples of each over the same time.
    """
    most = max(counts.values())
    often = [s for s, n in counts.items() if n * _OFTEN >= most]
    return min(often, key=RANKS.index)
