"""The residual channels, their groups, and the phases that condition them."""

from types import MappingProxyType

from twin.flight.mission import PHASES
from twin.frames import AXES

_SENSORS = (
    ("gyro", "rad/s"),
    ("acc", "m/s²"),
    ("mag", "T"),
    ("pos", "m"),
    ("vel", "m/s"),
)
CHANNELS = tuple(f"{sensor}_{axis}" for sensor, _ in _SENSORS for axis in AXES)
"""Gyroscope, accelerometer, magnetometer, position, velocity: flight-table columns, in order."""
UNITS = tuple(unit for _, unit in _SENSORS for _ in AXES)
GROUPS = MappingProxyType(
    {sensor: slice(3 * i, 3 * i + 3) for i, (sensor, _) in enumerate(_SENSORS)}
)
"""Columns of each sensor."""
UNKNOWN_PHASE = len(PHASES)
PHASE_CODES = MappingProxyType({**PHASES, "unknown": UNKNOWN_PHASE})
"""Phases of a mission by their codes, and where a flight says nothing."""
N_PHASES = len(PHASE_CODES)
