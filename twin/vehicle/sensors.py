"""The numbers of an aircraft's sensors and of the site where it flies, in SI units."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..representation import short_repr

EARTH_FIELD_N_T = (2.11e-5, 1.5e-6, 4.384e-5)
"""World Magnetic Model 2025 at 48 N, 11 E, 500 m, mid 2025, rounded."""
SEA_LEVEL_PRESSURE_PA = 101325.0
"""ISA at sea level, ICAO Doc 7488."""
SEA_LEVEL_TEMPERATURE_K = 288.15
"""ISA at sea level, ICAO Doc 7488."""


@dataclass(frozen=True, slots=True)
class Sensors:
    """Noise of the sensors, and what they read at the origin of NED.

    Noise is the standard deviation of a reading, walk that of the bias after 1 s.

    Attributes:
        field_n_t: Magnetic flux density, NED, T.
        pressure_pa: Static pressure at the origin.
        temperature_k: Air temperature at the origin.
        position: What differs from a preset of `twin.physics.sensors.position`, by its attribute
            names.
    """

    accel_noise_m_s2: float = 0.0
    accel_walk_m_s2: float = 0.0
    gyro_noise_rad_s: float = 0.0
    gyro_walk_rad_s: float = 0.0
    mag_noise_t: float = 0.0
    mag_walk_t: float = 0.0
    baro_noise_pa: float = 0.0
    baro_walk_pa: float = 0.0
    field_n_t: tuple[float, ...] = EARTH_FIELD_N_T
    pressure_pa: float = SEA_LEVEL_PRESSURE_PA
    temperature_k: float = SEA_LEVEL_TEMPERATURE_K
    position: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)

    __repr__ = short_repr
