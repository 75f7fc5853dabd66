"""Dryden turbulence: three forming filters driven by white noise.

With tau = L / V (L length scale, V airspeed) and white noise of unit intensity

    along the wind:  sigma sqrt(2 tau) / (1 + tau s)
    across, down:    sigma sqrt(tau) (1 + sqrt(3) tau s) / (1 + tau s)^2

Each is advanced from sample to sample by its exact transition, with noise whose covariance keeps
the stationary one, so the variance is sigma^2 at any sample period. The length scales and
intensities are those of low altitude; V is the speed through the mean wind, and at least
`airspeed_min`, so that turbulence still passes a vehicle that drifts with the wind.

Source: MIL-F-8785C, sec. 3.7 (the same spectra as MIL-HDBK-1797, whose length scales across and
down are twice as long and enter halved); exact discretisation, Gelb, Applied Optimal Estimation,
sec. 3.7.
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from ..component.portable import decay
from ..errors import ModelError
from .definition import Block, Effect, EffectParameter
from .observability import RandomForce

FOOT_M = 0.3048
GUST_HEIGHT_M = 6.096
LIGHT_WIND_M_S = 7.7
"""Height and wind at 20 ft for which the default gust is computed: light turbulence, 15 kn."""
_ROOT3 = float(np.sqrt(3.0))


@dataclass(frozen=True, slots=True)
class Breeze:
    """The wind at the vehicle, in the environment.

    Attributes:
        steady_n: Mean velocity of the air, NED, m/s.
        through: Speed of the vehicle through it, m/s.
        period: Time between two sample instants, s.
        gust_n: What comes on top of the mean, NED, m/s.
    """

    steady_n: list[ca.SX]
    through: ca.SX
    period: ca.SX
    gust_n: list[ca.SX]


@dataclass(frozen=True, slots=True)
class Turbulence:
    """Length scales (m) and intensities (m/s) along the mean wind, across it and down."""

    length_m: tuple[float, float, float]
    intensity_m_s: tuple[float, float, float]


def low_altitude_turbulence(height_m: float, wind_20ft_m_s: float) -> Turbulence:
    """Length scales and intensities at a height.

    Args:
        height_m: Above ground, 3 to 300 m; below 10 ft the values of 10 ft hold.
        wind_20ft_m_s: Mean wind at 20 ft; 15, 30, 45 kn are light, moderate, severe turbulence.

    Raises:
        ModelError: The height is above 1000 ft.

    Source: MIL-F-8785C, sec. 3.7.3.4.
    """
    feet = max(height_m / FOOT_M, 10.0)
    if feet > 1000.0:
        raise ModelError(f"low-altitude turbulence ends at 304.8 m, not {height_m:g} m.")
    shape = 0.177 + 0.000823 * feet
    along, down = feet / shape**1.2 * FOOT_M, feet * FOOT_M
    sigma_down = 0.1 * wind_20ft_m_s
    sigma = sigma_down / shape**0.4
    return Turbulence((along, along, down), (sigma, sigma, sigma_down))


def _gust(b: Breeze, p: Block) -> Breeze:
    speed = ca.fmax(b.through, p["airspeed_min"])
    along, across, down = (
        p[f"intensity_{name}"] * kind(p, name, b.period * speed / p[f"length_{name}"])
        for name, kind in (("u", _along), ("v", _across), ("w", _across))
    )
    north, east, _ = b.steady_n
    level = ca.sqrt(north**2 + east**2)
    calm = level < 1e-6
    ahead = ca.if_else(calm, 1.0, north / ca.fmax(level, 1e-6))
    aside = ca.if_else(calm, 0.0, east / ca.fmax(level, 1e-6))
    blown = [ahead * along - aside * across, aside * along + ahead * across, down]
    return replace(b, gust_n=[g + n for g, n in zip(b.gust_n, blown, strict=True)])


def _along(p: Block, name: str, step: ca.SX) -> ca.SX:
    """First-order filter of unit variance, advanced by `step` time constants."""
    x = p.memory(name, "1", f"{name} over its intensity")
    retained = decay(step)
    p.update(name, retained * x + ca.sqrt(1 - retained * retained) * p.noise())
    return x


def _across(p: Block, name: str, step: ca.SX) -> ca.SX:
    """Second-order filter of unit variance, advanced by `step` time constants.

    dz1 = -z1 + w, dz2 = z1 - z2 has the stationary covariance P = [[1/2, 1/4], [1/4, 1/4]] and
    the output sqrt(3) z1 + (1 - sqrt(3)) z2 the transfer function (1 + sqrt(3) s) / (1 + s)^2 and
    variance 1. The noise of a step has the covariance P - F P F', F the transition.
    """
    z1 = p.memory(f"{name}_1", "1", f"{name}, first filter")
    z2 = p.memory(f"{name}_2", "1", f"{name}, second filter")
    retained = decay(step)
    square = retained * retained
    q11 = 0.5 * (1 - square)
    q12 = 0.25 - square * (0.5 * step + 0.25)
    q22 = 0.25 - square * (0.5 * step * step + 0.5 * step + 0.25)
    spread = ca.sqrt(ca.fmax(q11, 1e-300))
    shared = q12 / spread
    own = ca.sqrt(ca.fmax(q22 - shared * shared, 0.0))
    first, second = p.noise(), p.noise()
    p.update(f"{name}_1", retained * z1 + spread * first)
    p.update(f"{name}_2", retained * (step * z1 + z2) + shared * first + own * second)
    return _ROOT3 * z1 + (1 - _ROOT3) * z2


_START = low_altitude_turbulence(GUST_HEIGHT_M, LIGHT_WIND_M_S)
_WAYS = (("u", "along the mean wind"), ("v", "across the mean wind"), ("w", "down"))

GUST = Effect(
    "gust",
    "the wind gusts: turbulence on top of the mean wind",
    "environment",
    Breeze,
    (
        *(
            EffectParameter(f"intensity_{name}", "m/s", f"standard deviation {way}", sigma, (0, 6))
            for (name, way), sigma in zip(_WAYS, _START.intensity_m_s, strict=True)
        ),
        *(
            EffectParameter(f"length_{name}", "m", f"length scale {way}", length, (1, 600), None)
            for (name, way), length in zip(_WAYS, _START.length_m, strict=True)
        ),
        EffectParameter(
            "airspeed_min", "m/s", "smallest speed at which gusts pass by", 1.0, (0.1, 5), None
        ),
    ),
    ("acc", "vel", "q"),
    "MIL-F-8785C, sec. 3.7",
    _gust,
    observable_as=RandomForce(
        ("intensity_u", "intensity_v", "intensity_w"), ("length_u", "length_v", "length_w")
    ),
    of_weather=True,
)

EFFECTS = (GUST,)
