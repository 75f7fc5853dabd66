"""Barometer: the standard atmosphere's table, dynamic pressure, noise."""

import numpy as np
import pytest
from rig import Rig, plain, vec
from sensor_rig import draws, effect_on

from twin.effects import EFFECTS
from twin.physics.sensors.barometer import barometer

IDEAL = Rig(barometer(plain()))
ALL = barometer(plain(), EFFECTS)


def read(rig: Rig, **inputs: float) -> float:
    return rig.outputs(rig.state(), rig.inputs(inputs))["baro_pa"]


@pytest.mark.parametrize(
    ("height_m", "pressure_pa"),
    [(0, 101325), (500, 95461), (1000, 89876), (2000, 79501), (3000, 70121), (-500, 107478)],
)
def test_standard_atmosphere(height_m: float, pressure_pa: float) -> None:
    """ISO 2533:1975, table 5, by geometric height, which differs from the geopotential one."""
    earth = 6356766.0
    height = earth * height_m / (earth + height_m)
    assert read(IDEAL, pos_z=-height) == pytest.approx(pressure_pa, rel=1.5e-5)


def test_pressure_carries_the_air_above() -> None:
    """dp/dh = -rho g, with the density of a perfect gas, on a hot day on a mountain."""
    rig = Rig(IDEAL.component, {"ground_pressure": 80e3, "ground_temperature": 300.0})
    h, step = 400.0, 0.5
    slope = (read(rig, pos_z=-h - step) - read(rig, pos_z=-h + step)) / (2 * step)
    density = read(rig, pos_z=-h) / (287.05287 * (300.0 - 0.0065 * h))
    assert slope == pytest.approx(-density * 9.80665, rel=1e-8)


def test_bias_is_added() -> None:
    rig = Rig(ALL, effect_on("baro_bias", baro_bias__pa=50.0))
    assert read(rig, pos_z=-20.0) - read(IDEAL, pos_z=-20.0) == pytest.approx(50.0, abs=1e-9)


def test_a_share_of_the_dynamic_pressure_is_read() -> None:
    """Of the air relative to the vehicle: rho v^2 / 2 with the ISA density at sea level."""
    rig = Rig(ALL, effect_on("baro_dynamic_pressure", baro_dynamic_pressure__share=-0.5))
    flying = vec("vel", [8.0, 0.0, 0.0]) | vec("wind", [-2.0, 3.0, 1.0])
    lost = read(rig, **flying) - read(IDEAL)
    assert lost == pytest.approx(-0.5 * 1.225 / 2 * (100 + 9 + 1), rel=1e-5)
    assert read(rig, **vec("vel", [3.0, 1, 0]), **vec("wind", [3.0, 1, 0])) == read(IDEAL)


def test_inputs_of_an_effect_are_there_only_with_it() -> None:
    assert IDEAL.component.input_names == ("pos_z",)
    assert barometer(plain(), ["baro_bias"]).input_names == ("pos_z",)
    assert "wind_x" in barometer(plain(), ["baro_dynamic_pressure"]).input_names


@pytest.mark.slow
def test_noise_and_walk() -> None:
    white = draws(IDEAL.component, {"baro_noise": 3.0}, 4000) - 101325.0
    assert white.std() == pytest.approx(3.0, rel=0.05)
    ends = [
        draws(IDEAL.component, {"baro_bias_walk": 2.0}, 101, seed)[[25, 100], 0] - 101325.0
        for seed in range(150)
    ]
    early, later = np.std(ends, axis=0)
    assert later == pytest.approx(2.0 * np.sqrt(1.01), rel=0.2)
    assert later / early == pytest.approx(2.0, rel=0.25)
