"""Gravity by place."""

import numpy as np


def normal_gravity_m_s2(latitude_rad: float, height_m: float) -> float:
    """Acceleration of free fall at a place.

    Args:
        latitude_rad: Geodetic, north positive.
        height_m: Over the ellipsoid.

    Source: Somigliana's formula and its gradient at the surface, WGS 84, NIMA TR8350.2, ch. 4.
    Valid for: what multirotors reach.
    """
    sine = np.sin(latitude_rad) ** 2
    at_sea = 9.7803253359 * (1 + 0.00193185265241 * sine) / np.sqrt(1 - 0.00669437999013 * sine)
    return float(at_sea - 3.086e-6 * height_m)
