"""What differs from flight to flight of one aircraft: constants of the day.

Sizes by section 7 of the notes on inference from real flights: the battery is put in anew, the
accelerometer is warmer, the weather has changed, the motion capture was calibrated again. Wind is
that of a calm day outdoors; a clock is late by half a normal distribution, never early.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..plants.aircraft import Aircraft
from ..plants.own.parameters import STEP_S, Array, Parameters

ACCEL_BIAS_M_S2 = 0.1
CENTRE_ARMS = 0.015
PRESSURE_PA = 20.0
HEADING_RAD = 0.1
WIND_M_S = 0.5
DELAY_S = 0.02


@dataclass(frozen=True)
class Day:
    """Constants of one flight; vectors body FRD, wind NED.

    Attributes:
        accel_bias_m_s2: On top of what is hidden.
        centre_m: Centre of mass forward and right of where it is on average.
        pressure_pa: Of the ground above the file's.
        heading_rad: Of the compass, shown minus true.
        wind_m_s: North, east, down.
        delay_steps: Of position and velocity, in steps of the plant.
    """

    accel_bias_m_s2: Array
    centre_m: Array
    pressure_pa: float
    heading_rad: float
    wind_m_s: Array
    delay_steps: int

    @property
    def as_json(self) -> dict[str, Any]:
        """For the truth file, delay in s."""
        return {
            "accel_bias_m_s2": self.accel_bias_m_s2.tolist(),
            "centre_m": self.centre_m.tolist(),
            "pressure_pa": self.pressure_pa,
            "heading_rad": self.heading_rad,
            "wind_m_s": self.wind_m_s.tolist(),
            "position_delay_s": self.delay_steps * STEP_S,
        }


def draw_day(aircraft: Aircraft, rng: np.random.Generator) -> Day:
    """Constants of a flight of this aircraft."""
    flat = np.array([1.0, 1.0, 0.0])
    return Day(
        ACCEL_BIAS_M_S2 * rng.standard_normal(3),
        CENTRE_ARMS * aircraft.arm * flat * rng.standard_normal(3),
        PRESSURE_PA * float(rng.standard_normal()),
        HEADING_RAD * float(rng.standard_normal()),
        WIND_M_S * aircraft.pace * flat * rng.standard_normal(3),
        round(DELAY_S * abs(float(rng.standard_normal())) / STEP_S),
    )


def mean_deviations(days: Sequence[Day], aircraft: Aircraft) -> dict[str, float]:
    """How far the mean of some days is from what it is expected to be, in its own standard
    deviations, by the effect that has such a constant: of several numbers the farthest."""
    flat = slice(0, 2)
    drawn = {
        "accel_bias": [d.accel_bias_m_s2 / ACCEL_BIAS_M_S2 for d in days],
        "cog_offset": [d.centre_m[flat] / (CENTRE_ARMS * aircraft.arm) for d in days],
        "baro_bias": [np.array([d.pressure_pa / PRESSURE_PA]) for d in days],
        "heading_offset": [np.array([d.heading_rad / HEADING_RAD]) for d in days],
        "steady_wind": [d.wind_m_s[flat] / (WIND_M_S * aircraft.pace) for d in days],
    }
    root = float(np.sqrt(len(days)))
    return {k: root * float(np.abs(np.mean(v, axis=0)).max()) for k, v in drawn.items()}


def on_day(plant: Parameters, day: Day) -> Parameters:
    """What flies on that day."""
    return replace(
        plant,
        accel_bias=plant.accel_bias + day.accel_bias_m_s2,
        hubs=plant.hubs - day.centre_m,
        imu_arm=plant.imu_arm - day.centre_m,
        marker=plant.marker - day.centre_m,
        baro_bias=plant.baro_bias + day.pressure_pa,
        heading=plant.heading + day.heading_rad,
        wind=plant.wind + day.wind_m_s,
        position_delay=plant.position_delay + day.delay_steps,
    )
