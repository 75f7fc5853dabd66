"""Positions on the ellipsoid, against closed forms and published numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.vehicle.earth import A_M, F, geodetic_of_ned, ned_of_geodetic

E2 = F * (2 - F)


def earth_fixed(latitude: float, longitude: float, height: float) -> np.ndarray:
    """The closed form, NIMA TR8350.2, 4-14."""
    n = A_M / np.sqrt(1 - E2 * np.sin(latitude) ** 2)
    across = (n + height) * np.cos(latitude)
    up = (n * (1 - E2) + height) * np.sin(latitude)
    return np.array([across * np.cos(longitude), across * np.sin(longitude), up])


def test_a_published_example() -> None:
    """That of MATLAB's Mapping Toolbox and of pymap3d: azimuth 33, elevation 70 degrees, 1 km."""
    ned = np.array([[286.842228, 186.277521, -939.692621]])
    latitude, longitude, height = geodetic_of_ned(ned, np.radians(42), np.radians(-82), 200.0)[0]
    assert np.degrees([latitude, longitude]) == pytest.approx([42.002582, -81.997752], abs=1e-6)
    assert height == pytest.approx(1139.7018, abs=1e-3)


def test_a_metre_is_as_many_radians_as_the_radii_of_curvature_say() -> None:
    """At the equator 6335439.327 m along a meridian and the semi-major axis across it; at a pole
    6399593.626 m (NIMA TR8350.2, table 3.3)."""
    north, east, down = geodetic_of_ned(np.eye(3), 0.0, 1.0, 0.0)
    assert 1 / north[0] == pytest.approx(6335439.327, rel=1e-7)
    assert 1 / (east[1] - 1.0) == pytest.approx(6378137.0, rel=1e-7)
    assert down == pytest.approx([0.0, 1.0, -1.0], abs=1e-9)
    (near_pole,) = geodetic_of_ned(np.array([[-1.0, 0, 0]]), np.pi / 2, 0.0, 0.0)
    assert 1 / (np.pi / 2 - near_pole[0]) == pytest.approx(6399593.626, rel=1e-6)


@given(
    *(st.floats(-1.57, 1.57), st.floats(-3.14, 3.14), st.floats(-400, 9000)),
    st.lists(st.floats(-30e3, 30e3), min_size=3, max_size=3),
)
def test_back_to_earth_fixed_axes_they_are_where_they_were(
    latitude: float, longitude: float, height: float, ned: list[float]
) -> None:
    """To a hundredth of a millimetre, within 30 km of the origin."""
    there = geodetic_of_ned(np.array([ned, [0.0, 0.0, 0.0]]), latitude, longitude, height)
    far, origin = (earth_fixed(*each) for each in there)
    assert np.linalg.norm(origin - earth_fixed(latitude, longitude, height)) < 1e-5
    assert np.linalg.norm(far - origin) == pytest.approx(np.linalg.norm(ned), abs=3e-5)
    back = ned_of_geodetic(there[0].tolist(), latitude, longitude, height)
    assert back == pytest.approx(ned, abs=3e-5)
