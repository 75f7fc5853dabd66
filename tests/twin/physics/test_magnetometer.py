"""Magnetometer: the field of the earth against geometry, compass and the model's test values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import Rig, plain, q
from sensor_rig import draws, effect_on

from twin.effects import EFFECTS
from twin.errors import ModelError
from twin.frames import from_euler
from twin.physics.sensors.magnetometer import magnetometer
from twin.vehicle.earth import world_field
from twin.vehicle.vehicle import EARTH_FIELD_N_T

IDEAL = Rig(magnetometer(plain()))
ALL = magnetometer(plain(), EFFECTS)
angles = st.tuples(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))


def read(rig: Rig, attitude: np.ndarray, **more: float) -> np.ndarray:
    y = rig.outputs(rig.state(), rig.inputs(q(attitude) | more))
    return np.array([y[f"mag_{a}"] for a in "xyz"])


def having(*names: str, **numbers: float) -> Rig:
    return Rig(ALL, effect_on(*names, **numbers))


@given(angles)
@settings(max_examples=50, deadline=None)
def test_turning_changes_the_direction_of_the_field_alone(euler: tuple[float, ...]) -> None:
    strength = np.linalg.norm(read(IDEAL, from_euler(*euler)))
    assert strength == pytest.approx(np.linalg.norm(EARTH_FIELD_N_T), rel=1e-12)


@given(angles, st.floats(-1.5, 1.5))
@settings(max_examples=50, deadline=None)
def test_the_compass_shows_the_yaw(euler: tuple[float, ...], offset: float) -> None:
    """Tilt-compensated heading plus declination: the yaw, plus the heading offset if on."""
    roll, pitch, yaw = euler
    declination = np.arctan2(EARTH_FIELD_N_T[1], EARTH_FIELD_N_T[0])
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    level = np.array([[cp, sr * sp, cr * sp], [0, cr, -sr]])  # undoes roll, then pitch
    shifted = having("heading_offset", heading_offset__yaw_rad=offset)
    for rig, more in ((IDEAL, 0.0), (shifted, offset)):
        north, east = level @ read(rig, from_euler(*euler))
        heading = np.arctan2(-east, north) + declination
        assert np.angle(np.exp(1j * (heading - yaw - more))) == pytest.approx(0, abs=1e-9)


def test_iron_and_current_move_and_bend_the_field() -> None:
    attitude = from_euler(0.3, -0.4, 1.0)
    truth = read(IDEAL, attitude)
    hard = having("mag_hard_iron", mag_hard_iron__x_t=1e-5, mag_hard_iron__z_t=-2e-5)
    np.testing.assert_allclose(
        read(hard, attitude) - truth, [1e-5, -4e-6, -2e-5], rtol=1e-9
    )  # y at its start
    matrix = np.array([[1.1, 0.05, 0.05], [0.05, 0.95, 0.05], [0.05, 0.05, 1.05]])
    np.testing.assert_allclose(read(having("mag_soft_iron"), attitude), matrix @ truth, rtol=1e-12)
    coupled = having("mag_current_coupling")
    np.testing.assert_allclose(
        read(coupled, attitude, ibat_a=20.0) - truth, [6e-6, 4e-6, -6e-6], rtol=1e-9
    )


def test_the_current_is_an_input_only_where_an_effect_asks_for_it() -> None:
    assert "ibat_a" not in IDEAL.component.input_names
    assert "ibat_a" in magnetometer(plain(), ["mag_current_coupling"]).input_names


@pytest.mark.slow
def test_noise_and_walk() -> None:
    white = draws(IDEAL.component, {"mag_noise": 3e-7}, 2000) - EARTH_FIELD_N_T
    assert white.std(axis=0) == pytest.approx([3e-7] * 3, rel=0.07)
    ends = [
        draws(IDEAL.component, {"mag_bias_walk": 1e-7}, 101, seed)[[25, 100]] for seed in range(60)
    ]
    early, later = np.std(np.array(ends) - EARTH_FIELD_N_T, axis=(0, 2))
    assert later == pytest.approx(1e-7 * np.sqrt(1.01), rel=0.17)  # 180 walks
    assert later / early == pytest.approx(2.0, rel=0.25)


@pytest.mark.parametrize(
    ("year", "height_km", "latitude", "longitude", "field_nt"),
    [
        (2020.0, 0.0, 80.0, 0.0, (6570.4, -146.3, 54606.0)),
        (2022.5, 0.0, 0.0, 120.0, (39684.7, -42.2, -10809.5)),
        (2022.5, 100.0, -80.0, 240.0, (5815.0, 14803.0, -49755.3)),
    ],
)
def test_world_field_against_the_values_published_with_the_model(
    year: float,
    height_km: float,
    latitude: float,
    longitude: float,
    field_nt: tuple[float, ...],
) -> None:
    """The US/UK World Magnetic Model for 2020-2025, table of test values."""
    found = world_field(np.radians(latitude), np.radians(longitude), 1e3 * height_km, year)
    np.testing.assert_allclose(1e9 * np.array(found), field_nt, atol=0.06)


def test_the_default_field_is_that_of_its_place() -> None:
    found = world_field(np.radians(48), np.radians(11), 500.0, 2025.5)
    np.testing.assert_allclose(found, EARTH_FIELD_N_T, rtol=0.002)


def test_years_without_a_model_are_refused() -> None:
    with pytest.raises(ModelError, match="year 1950"):
        world_field(0.8, 0.2, 0.0, 1950.0)
