"""The magnetic field of the earth at a place and time."""

from math import degrees

from pygeomag import GeoMag

from ..errors import ModelError


def world_field(
    latitude_rad: float, longitude_rad: float, height_m: float, year: float
) -> tuple[float, float, float]:
    """Magnetic flux density by the World Magnetic Model, NED, T.

    Args:
        latitude_rad: Geodetic, north positive.
        longitude_rad: East positive.
        height_m: Over the WGS 84 ellipsoid.
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
