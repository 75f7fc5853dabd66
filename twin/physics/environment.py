"""Environment: steady wind, gusts, and air density of the standard atmosphere.

Gusts are an effect, off by default (`twin.effects.air`). Density: U.S. Standard Atmosphere 1976,
troposphere.
"""

import casadi as ca

from ..component import Component, ComponentBuilder
from ..component.portable import binomial_power
from ..effects import Blocks, effects_of
from ..effects.air import Breeze
from ..frames import AXES, NED
from ..vehicle import GRAVITY_M_S2, Vehicle
from ..vehicle.earth import GAS_CONSTANT_J_KG_K, LAPSE_K_M

SAMPLE_PERIOD_S = 1e-2
"""Time between two draws of the gust, s. Made up."""
GROUND_K, GROUND_PA = 288.15, 101325.0
"""Temperature, K, and pressure, Pa, at sea level; ISO 2533:1975."""
EXPONENT = GRAVITY_M_S2 / (LAPSE_K_M * GAS_CONSTANT_J_KG_K) - 1.0
"""Exponent of the temperature ratio in the density ratio."""


def environment(vehicle: Vehicle) -> Component:
    """Wind and air density at the vehicle as a component."""
    m = ComponentBuilder("environment", "Steady wind, Dryden gust, density of the atmosphere")
    period = m.sampled(SAMPLE_PERIOD_S, "Time between two draws of the gust")
    pos_z = m.input("pos_z", "m", "Position of the vehicle, NED down")
    vel = [
        m.input(f"vel_{a}", "m/s", f"Velocity of the vehicle, NED {d}")
        for a, d in zip(AXES, NED, strict=True)
    ]
    wind = [
        m.parameter(f"wind.{a}", 0.0, "m/s", f"Steady velocity of the air, NED {d}")
        for a, d in zip(AXES, NED, strict=True)
    ]
    through = ca.sqrt(sum(((v - w) ** 2 for v, w in zip(vel, wind, strict=True)), start=ca.SX(0)))
    blocks = Blocks(m, vehicle, effects_of("environment"))
    gust = blocks.apply(Breeze(wind, through, period, [ca.SX(0)] * 3)).gust_n
    for a, d, steady, change in zip(AXES, NED, wind, gust, strict=True):
        m.output(f"wind_{a}", "m/s", f"Velocity of the air, NED {d}", steady + change)
    m.output("density", "kg/m3", "Density of the air", _density(m, pos_z))
    blocks.idle()
    return m.build()


def _density(m: ComponentBuilder, pos_z: ca.SX) -> ca.SX:
    """Density in the troposphere above ground of given temperature and pressure."""
    warm = m.parameter(
        "ground.temperature", GROUND_K, "K", "Temperature at pos_z = 0", minimum=200, maximum=330
    )
    pressure = m.parameter(
        "ground.pressure", GROUND_PA, "Pa", "Air pressure at pos_z = 0", minimum=2e4, maximum=1.1e5
    )
    # Within the convergence range of the series: 10 km up and down.
    cooling = ca.fmin(ca.fmax(LAPSE_K_M * pos_z / warm, -0.25), 0.25)
    return pressure / (GAS_CONSTANT_J_KG_K * warm) * binomial_power(cooling, EXPONENT)
