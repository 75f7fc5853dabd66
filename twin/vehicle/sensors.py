"""The numbers of an aircraft's sensors and of the site where it flies, in SI units."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..representation import short_repr

EARTH_FIELD_N_T = (2.11e-5, 1.5e-6, 4.384e-5)
"""World Magnetic Model 2025 at 48 N, 11 E, 500 m, mid 2025, rounded."""
SEA_LEVEL_PRESSURE_PA = 101325.0
"""ISA at sea level, ICAO Doc 7488."""
SEA_LEVEL_TEMPERATURE_K = 288.15
"""ISA at sea level, ICAO Doc 7488."""


def _number(key: str, stand_in: str = "", default: float = 0.0) -> Any:
    """A number that the vehicle file has under a key.

    Args:
        key: In the file.
        stand_in: What stands in for it, in words; default: no noise or no walk, as the key says.
        default: The same as a number.
    """
    words = stand_in or f"no {key.rpartition('.')[2].rpartition('_')[2]}"
    return field(default=default, metadata={"key": key, "stand_in": words})


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

    accel_noise_m_s2: float = _number("imu.accel_noise")
    accel_walk_m_s2: float = _number("imu.accel_walk")
    gyro_noise_rad_s: float = _number("imu.gyro_noise")
    gyro_walk_rad_s: float = _number("imu.gyro_walk")
    mag_noise_t: float = _number("magnetometer.noise")
    mag_walk_t: float = _number("magnetometer.walk")
    baro_noise_pa: float = _number("barometer.noise")
    baro_walk_pa: float = _number("barometer.walk")
    field_n_t: tuple[float, ...] = EARTH_FIELD_N_T
    pressure_pa: float = _number(
        "site.pressure", f"{SEA_LEVEL_PRESSURE_PA:g} Pa", SEA_LEVEL_PRESSURE_PA
    )
    temperature_k: float = _number(
        "site.temperature", f"{SEA_LEVEL_TEMPERATURE_K:g} K", SEA_LEVEL_TEMPERATURE_K
    )
    position: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)

    __repr__ = short_repr
