"""The Earth at a place: WGS 84 coordinates, magnetic field, gravity, standard atmosphere."""

from collections.abc import Sequence
from math import degrees

import numpy as np
from numpy.typing import NDArray
from pygeomag import GeoMag

from ..errors import ModelError

Array = NDArray[np.float64]
A_M = 6378137.0
"""Semi-major axis of WGS 84, m."""
F = 1 / 298.257223563
"""Flattening of WGS 84."""
_E2 = F * (2.0 - F)
"""First eccentricity of WGS 84, squared."""
LAPSE_K_M = 0.0065
"""Temperature lapse rate below 11 km, K/m; ISO 2533:1975."""
GAS_CONSTANT_J_KG_K = 287.05287
"""Specific gas constant of dry air, J/(kg K); ISO 2533:1975."""


def geodetic_of_ned(
    position_m: Array, latitude_rad: float, longitude_rad: float, height_m: float
) -> Array:
    """Latitude and longitude, rad, and height above the ellipsoid, m, of positions, shape (n, 3).

    Args:
        position_m: North, east, down from the origin, along its axes, m, shape (n, 3).
        latitude_rad: Geodetic latitude of the origin, north positive.
        longitude_rad: Longitude of the origin, east positive.
        height_m: Height of the origin above the ellipsoid.

    Source: WGS 84, NIMA TR8350.2, ch. 3 (ellipsoid) and ch. 4.5 (to Earth-fixed axes); inverse by
    Bowring, Survey Review 28 (1985), with a latitude error below 1e-11 rad here. Valid for:
    distances of multirotor flights.
    """
    origin = _earth_fixed(latitude_rad, longitude_rad, height_m)
    x, y, z = (origin + position_m @ _axes(latitude_rad, longitude_rad)).T
    across = np.hypot(x, y)
    b_m = A_M * (1.0 - F)
    ratio, second = np.hypot(across, z), _E2 / (1.0 - _E2)
    reduced = np.arctan2(b_m * z * (1.0 + second * b_m / ratio), A_M * across)
    latitude = np.arctan2(
        z + second * b_m * np.sin(reduced) ** 3, across - _E2 * A_M * np.cos(reduced) ** 3
    )
    sine = np.sin(latitude)
    height = across * np.cos(latitude) + z * sine - A_M * np.sqrt(1.0 - _E2 * sine**2)
    return np.column_stack([latitude, np.arctan2(y, x), height])


def ned_of_geodetic(
    place: Sequence[float], latitude_rad: float, longitude_rad: float, height_m: float
) -> Array:
    """North, east, down of a place from an origin, m, shape (3,): inverse of `geodetic_of_ned`.

    Args:
        place: Latitude and longitude, rad, and height above the ellipsoid, m.
        latitude_rad: Geodetic latitude of the origin; the others as in `geodetic_of_ned`.
    """
    off = _earth_fixed(*place) - _earth_fixed(latitude_rad, longitude_rad, height_m)
    return np.asarray(_axes(latitude_rad, longitude_rad) @ off)


def _axes(latitude_rad: float, longitude_rad: float) -> Array:
    """Unit vectors north, east and down in Earth-fixed axes, as rows."""
    sin_lat, cos_lat = np.sin(latitude_rad), np.cos(latitude_rad)
    sin_lon, cos_lon = np.sin(longitude_rad), np.cos(longitude_rad)
    north = [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat]
    down = [-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat]
    return np.array([north, [-sin_lon, cos_lon, 0.0], down])


def _earth_fixed(latitude_rad: float, longitude_rad: float, height_m: float) -> Array:
    """A place in Earth-fixed axes, m."""
    sin_lat = np.sin(latitude_rad)
    radius = A_M / np.sqrt(1.0 - _E2 * sin_lat**2)  # radius of curvature, east and west
    up = -_axes(latitude_rad, longitude_rad)[2]
    return np.asarray(up * (radius + height_m) - np.array([0.0, 0.0, _E2 * radius * sin_lat]))


def world_field(
    latitude_rad: float, longitude_rad: float, height_m: float, year: float
) -> tuple[float, float, float]:
    """Magnetic flux density by the World Magnetic Model, NED, T.

    Args:
        latitude_rad: Geodetic latitude, north positive.
        longitude_rad: Longitude, east positive.
        height_m: Height above the WGS 84 ellipsoid.
        year: Decimal year, 2025.5 in the middle of 2025.

    Raises:
        ModelError: No model covers the year.

    Source: NOAA NCEI and BGS, The US/UK World Magnetic Model for 2025-2030, as computed by
    pygeomag.
    """
    try:
        model = GeoMag(base_year=year)
        field = model.calculate(
            glat=degrees(latitude_rad), glon=degrees(longitude_rad), alt=height_m / 1e3, time=year
        )
    except ValueError as error:
        raise ModelError(f"no magnetic field for the year {year:g}: {error}.") from error
    return 1e-9 * field.x, 1e-9 * field.y, 1e-9 * field.z


def normal_gravity_m_s2(latitude_rad: float, height_m: float) -> float:
    """Acceleration of free fall at a place.

    Args:
        latitude_rad: Geodetic latitude, north positive.
        height_m: Height above the ellipsoid.

    Source: Somigliana's formula and its gradient at the surface, WGS 84, NIMA TR8350.2, ch. 4.
    Valid for: heights of multirotor flights.
    """
    sine = np.sin(latitude_rad) ** 2
    at_sea = 9.7803253359 * (1 + 0.00193185265241 * sine) / np.sqrt(1 - 0.00669437999013 * sine)
    return float(at_sea - 3.086e-6 * height_m)
