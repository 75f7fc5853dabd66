"""Barometer: static pressure of the atmosphere at the height of the vehicle, plus noise.

    p = p_0 (1 - L h / T_0)^(g M / (R L)) + n

with pressure p_0 and temperature T_0 at the origin of NED, and h the height above it. At each
sample instant n, white noise plus a random walk, is drawn; between the instants it is held while
the rest follows the height. Bias and dynamic pressure are effects (`twin.effects`). Source: ISO
2533:1975, Standard Atmosphere, eq. 12.
"""

from collections.abc import Iterable

import casadi as ca

from ...component import Component, ComponentBuilder
from ...component.portable import binomial_power
from ...effects.stages import BaroReading
from ...vehicle import GRAVITY_M_S2, Vehicle
from ...vehicle.earth import GAS_CONSTANT_J_KG_K, LAPSE_K_M
from .common import EARTH, noise, noise_level, sensor_blocks, vector_input

SAMPLE_PERIOD_S = 0.02
"""Time between two draws of the noise, s. Made up."""


def barometer(vehicle: Vehicle, effects: Iterable[str] = ()) -> Component:
    """The barometer of a vehicle as a component.

    Args:
        vehicle: Numbers of the aircraft, and the effects that are switched on.
        effects: Effects to build in, switched off: identifiers of `twin.effects.EFFECTS`; those of
            other components are ignored.
    """
    m = ComponentBuilder("barometer", f"Barometer of {vehicle.name}")
    period = m.sampled(SAMPLE_PERIOD_S, "Time between two draws of the noise")
    blocks = sensor_blocks(m, vehicle, "barometer", effects)
    sensors = vehicle.sensors
    ground = m.parameter(
        "ground_pressure",
        sensors.pressure_pa,
        "Pa",
        "Static pressure at the origin of NED",
        minimum=1e3,
    )
    warmth = m.parameter(
        "ground_temperature",
        sensors.temperature_k,
        "K",
        "Air temperature at the origin of NED",
        minimum=100.0,
    )
    down = m.input("pos_z", "m", "Position, NED down")
    warmer = LAPSE_K_M * down / warmth
    pressure = ground * binomial_power(warmer, GRAVITY_M_S2 / (GAS_CONSTANT_J_KG_K * LAPSE_K_M))
    dynamic = ca.SX(0)
    if blocks.include("baro_dynamic_pressure"):
        density = pressure / (GAS_CONSTANT_J_KG_K * warmth * (1 + warmer))
        dynamic = density * _air_speed_squared(m) / 2
    reading = blocks.apply(BaroReading(pressure, dynamic))
    level = noise_level(m, "baro", "Pa", sensors.baro_noise_pa, sensors.baro_walk_pa)
    error = noise(m, "baro", "Pa", level, period)
    m.output("baro_pa", "Pa", "Static pressure read", reading.pressure + error)
    blocks.idle()
    return m.build()


def _air_speed_squared(m: ComponentBuilder) -> ca.SX:
    velocity = vector_input(m, "vel", "m/s", "Velocity", EARTH)
    wind = vector_input(m, "wind", "m/s", "Velocity of the air", EARTH)
    through = [v - w for v, w in zip(velocity, wind, strict=True)]
    return sum((v * v for v in through), start=ca.SX(0))
