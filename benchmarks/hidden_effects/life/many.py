"""Six to twelve effects at once, drawn from those that change the mean of a reading."""

import numpy as np

from ..cases import MAGNITUDES
from ..plants.kinds import EFFECTS, Plant
from .conditions import SENSORS, Conditions

FEWEST, MOST = 6, 12
_NO_MEAN = {"gust", "vibration", "sensor_noise_level", "stuck_sensor"}
_OF_COMMANDS = {"motor_lag", "command_delay", "battery_sag"}
"""What measured rotor speeds leave no place for."""
_ONE_OF = (
    {"motor_lag", "command_delay", "position_delay"},  # else the controller loses the aircraft
    {"induced_inflow", "translational_lift"},  # one rotor has one inflow
)
_SENSED_BY = {
    "accel_": ("acc_",),
    "imu_": ("acc_", "gyro_"),
    "gyro_": ("gyro_",),
    "mag_": ("mag_",),
    "heading_": ("mag_",),
    "baro_": ("baro_",),
}


def can_show(name: str, conditions: Conditions) -> bool:
    """Whether an effect of the library moves the mean of a reading that the log has."""
    if EFFECTS[name].outside or name in _NO_MEAN or (conditions.rotors and name in _OF_COMMANDS):
        return False
    gone = SENSORS.get(conditions.without, ())
    sensors = next((s for k, s in _SENSED_BY.items() if name.startswith(k)), None)
    return sensors is None or any(s not in gone for s in sensors)


def draw_effects(plant: Plant, conditions: Conditions, rng: np.random.Generator) -> tuple[str, ...]:
    """Names of a case with many effects."""
    wanted = int(rng.integers(FEWEST, MOST + 1))
    possible = [n for n in plant.effects if can_show(n, conditions)]
    drawn: list[str] = []
    for name in rng.permutation(np.array(possible)).tolist():
        rivals = [group for group in _ONE_OF if name in group]
        if not any(group & {*drawn} for group in rivals):
            drawn.append(name)
    return tuple(sorted(drawn[:wanted]))


def draw_magnitude(name: str, rng: np.random.Generator) -> str:
    """Small, medium or large; what makes the loop slower is never large."""
    level = int(rng.integers(3))
    return MAGNITUDES[min(level, 1) if name in _ONE_OF[0] else level]
