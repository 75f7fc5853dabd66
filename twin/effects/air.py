"""Effects of the air on airframe and rotors: drag, inflow, lift, flapping, wind, gusts, ground.

Gusts are Dryden turbulence, three forming filters driven by white noise. With tau = L / V (L length
scale, V airspeed) and white noise of unit intensity

    along the wind:  sigma sqrt(2 tau) / (1 + tau s)
    across, down:    sigma sqrt(tau) (1 + sqrt(3) tau s) / (1 + tau s)^2

Each filter is advanced from sample to sample by its exact transition, with noise whose covariance
preserves the stationary one, so the variance is sigma^2 at any sample period. Length scales and
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
from ..frames import cross
from ..vehicle import GRAVITY_M_S2, Vehicle
from .definition import Block, Effect, Equation, Family, Limit, RandomForce
from .parameters import COMMON, RARE, EffectParameter, Normal, Prior
from .stages import Air, Thrust, Wrench
from .wording import FLY_FOR_DRAG, Undetected, Wording, drag_clause, flapping_clause, wind_clause

FOOT_M = 0.3048  # m; exact by definition
GUST_HEIGHT_M = 6.096  # 20 ft, reference height of the winds of MIL-F-8785C
LIGHT_WIND_M_S = 7.7
"""Wind at 20 ft for the default gust: light turbulence, 15 kn."""
_ROOT3 = float(np.sqrt(3.0))  # coefficient of the cross-wind filters


@dataclass(frozen=True, slots=True)
class Breeze:
    """The wind at the vehicle, in the environment.

    Attributes:
        steady_n: Mean velocity of the air, NED, m/s.
        through: Speed of the vehicle through the air, m/s.
        period: Time between two sample instants, s.
        gust_n: Gust velocity in addition to the mean, NED, m/s.
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
        height_m: Height above ground, 3 to 300 m; below 10 ft the values at 10 ft are used.
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
"""Start values of the gust's parameters."""
_WAYS = (("u", "along the mean wind"), ("v", "across the mean wind"), ("w", "down"))
"""Suffix of a parameter, and direction of its axis."""

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
    prior=None,
    change=None,
    wording=None,
    advice=None,
)


FAINT = 1e-3
"""Weight over the hover thrust of one rotor below which there is no hover: the reference rotor
speed would be zero without gravity."""
NEAREST_GROUND = 0.25
"""Smallest rotor height over the scale of the ground effect; the effect is constant below it."""


def _weight_on_arm(vehicle: Vehicle) -> float:
    """Moment of the whole weight on the arm of a rotor, N m."""
    return vehicle.mass_kg * vehicle.gravity_m_s2 * vehicle.arm_m


def _rotor_drag(w: Wrench, p: Block) -> Wrench:
    """Rotor speed relative to hover is the root of thrust over weight, whatever thrust map the file
    has; so the drag in hover is separate from its growth with thrust."""
    m = w.motion.body.mass * w.motion.density
    weight = ca.fmax(m * w.motion.gravity, FAINT * w.rotors.hover)
    load = sum(w.rotors.thrust, start=ca.SX(0)) / weight
    # The root has no derivative at zero, with rotors at rest.
    spin = ca.if_else(load > 0, ca.sqrt(ca.fmax(load, 1e-30)), 0.0)
    m, air = m * (1 + p["spin_share"] * (spin - 1)), w.motion.air_b
    k = [p["k_xy_1_s"], p["k_xy_1_s"], p["k_z_1_s"]]
    drag = [-m * c * v for c, v in zip(k, air, strict=True)]
    hubs = w.motion.body.hubs
    point = [sum(places, start=ca.SX(0)) / len(hubs) for places in zip(*hubs, strict=True)]
    point[2] -= p["height_m"]
    return replace(
        w,
        force=[f + d for f, d in zip(w.force, drag, strict=True)],
        moment=[a + b for a, b in zip(w.moment, cross(point, drag), strict=True)],
    )


def _parasitic_drag(w: Wrench, p: Block) -> Wrench:
    air = w.motion.air_b
    # Bounded below: the root has no derivative at rest.
    speed = ca.sqrt(ca.fmax(sum((v * v for v in air), start=ca.SX(0)), 1e-30))
    m = w.motion.body.mass * w.motion.density * speed
    c = [p["c_1_m"], p["c_1_m"] + p["more_y_1_m"], p["c_1_m"] + p["more_z_1_m"]]
    return replace(w, force=[f - m * k * v for f, k, v in zip(w.force, c, air, strict=True)])


def _slowing(_: Vehicle) -> tuple[Limit, ...]:
    return tuple(
        Limit({"c_1_m": 1.0, f"more_{a}_1_m": 1.0}, f"drag along body {a} slows")
        for a in ("y", "z")
    )


def _induced_inflow(r: Thrust, p: Block) -> Thrust:
    climb = [-down for _, _, down in r.motion.hubs_air_b]
    factor = [ca.fmax(1 - p["k_s_m"] * c, 0.0) for c in climb]
    return replace(r, thrust=[t * f for t, f in zip(r.thrust, factor, strict=True)])


def _translational_lift(r: Thrust, p: Block) -> Thrust:
    x, y, _ = r.motion.air_b
    half = (x * x + y * y) / (2 * p["induced_m_s"] ** 2)
    inflow = ca.sqrt(ca.sqrt(1 + half * half) - half)
    factor = 1 + p["gain"] * (1 - inflow)
    return replace(r, thrust=[t * factor for t in r.thrust])


def _blade_flapping(w: Wrench, p: Block) -> Wrench:
    total = sum(w.rotors.thrust, start=ca.SX(0))
    x, y, _ = w.motion.air_b
    back = [-total * p["k_rad_s_m"] * x, -total * p["k_rad_s_m"] * y, ca.SX(0)]
    moment = cross([ca.SX(0), ca.SX(0), -p["height_m"]], back)
    return replace(
        w,
        force=[f + d for f, d in zip(w.force, back, strict=True)],
        moment=[a + b for a, b in zip(w.moment, moment, strict=True)],
    )


def _flapping_moment(w: Wrench, p: Block) -> Wrench:
    share = w.motion.density / len(w.rotors.spin)
    moment = list(w.moment)
    for spin, (x, y, _) in zip(w.rotors.spin, w.motion.hubs_air_b, strict=True):
        k = p["k_n_s"] * share * spin
        moment = [moment[0] - k * y, moment[1] + k * x, moment[2]]
    return replace(w, moment=moment)


def _steady_wind(a: Air, p: Block) -> Air:
    blow = [p["north_m_s"], p["east_m_s"], p["down_m_s"]]
    return replace(a, wind_n=[w + b for w, b in zip(a.wind_n, blow, strict=True)])


def _ground_effect(r: Thrust, p: Block) -> Thrust:
    height = ca.fmax(r.motion.height / p["height_m"], NEAREST_GROUND)
    factor = 1 + p["gain"] / (1 + height * height)
    return replace(r, thrust=[t * factor for t in r.thrust])


ROTOR_DRAG = Effect(
    "rotor_drag",
    "drag of the turning rotors, about the middle of their hubs, proportional to the speed through "
    "the air, and to that of the rotors as far as it answers to it",
    "airframe",
    Wrench,
    (
        EffectParameter(
            "k_xy_1_s", "1/s", "drag over mass and speed in hover, body x and y", 0.3, (0, 1.5)
        ),
        EffectParameter(
            "k_z_1_s", "1/s", "drag over mass and speed in hover, body z", 0.0, (0, 1.5)
        ),
        EffectParameter(
            "height_m", "m", "where it attacks, over the middle of the hubs", 0.0, (-0.15, 0.15)
        ),
        EffectParameter(
            "spin_share",
            "1",
            "share that grows with rotor speed; the rest does not answer to it",
            1.0,
            (0, 1),
            neutral=None,
            ends=True,
        ),
    ),
    ("acc", "vel", "q"),
    "Faessler, Franchi & Scaramuzza, RA-L 3 (2018), eq. 7, with rotor speed as in Foerster, System "
    "Identification of the Crazyflie 2.0, ETH Zurich (2015); 0.38 1/s measured on a Crazyflie",
    _rotor_drag,
    observable_as=Equation(mistaken_for=("blade_flapping",)),
    prior=Prior(
        COMMON,
        "0.1 to 0.5 1/s published; attacks within the height of motors and propellers; theory has "
        "it grow with rotor speed, identified models and simulators often leave that out",
        {
            "": Normal(0.2, 0.2),
            "height_m": Normal(0.0, 0.02),
            "spin_share": Normal(0.7, 0.4),
        },
    ),
    change=None,
    wording=Wording(
        drag_clause, undetected=Undetected(9, "rotor drag below {}"), secondary=("height_m",)
    ),
    advice={"": FLY_FOR_DRAG},
)

PARASITIC_DRAG = Effect(
    "parasitic_drag",
    "drag of body and arms, growing with the square of the speed through the air",
    "airframe",
    Wrench,
    (
        EffectParameter(
            "c_1_m", "1/m", "drag over mass and speed squared, 0.5 rho Cd A / m", 0.02, (0, 0.2)
        ),
        EffectParameter("more_y_1_m", "1/m", "on top of that along body y", 0.0, (-0.2, 0.2)),
        EffectParameter("more_z_1_m", "1/m", "on top of that along body z", 0.0, (-0.2, 0.4)),
    ),
    ("acc", "vel", "q"),
    "Stevens, Lewis & Johnson, Aircraft Control and Simulation, ch. 2; a coefficient per axis on "
    "the whole speed: Folk, Paulos & Kumar, RotorPy, arXiv 2306.04485",
    _parasitic_drag,
    _slowing,
    prior=Prior(RARE, "0.5 rho Cd A / m", {"": Normal(0.0, 0.03)}),
    change=None,
    wording=None,
    advice=None,
)

INDUCED_INFLOW = Effect(
    "induced_inflow",
    "rotors lose thrust in a climb and gain it in a descent, each by its own speed through the air",
    "airframe",
    Thrust,
    (EffectParameter("k_s_m", "s/m", "share of the thrust lost per climb speed", 0.05, (0, 0.3)),),
    ("acc", "vel", "q"),
    "Leishman, Principles of Helicopter Aerodynamics, sec. 2.13: linear part of the climb",
    _induced_inflow,
    prior=Prior(RARE, "momentum theory: 1 / (2 v_i) to 1 / v_i", {"": Normal(0.05, 0.04)}),
    change=None,
    wording=None,
    advice=None,
)

TRANSLATIONAL_LIFT = Effect(
    "translational_lift",
    "rotors gain thrust in forward flight, where fresh air reaches them",
    "airframe",
    Thrust,
    (
        EffectParameter("gain", "1", "thrust gained far above the induced speed", 0.3, (0, 1)),
        EffectParameter(
            "induced_m_s", "m/s", "speed of the induced flow in hover", 4.0, (1, 12), neutral=None
        ),
    ),
    ("acc", "vel", "q"),
    "Glauert's inflow in forward flight, Leishman, sec. 2.14, eq. 2.125 at zero disc angle",
    _translational_lift,
    prior=Prior(RARE, "Glauert", {"gain": Normal(0.0, 0.3), "induced_m_s": Normal(4.0, 2.0)}),
    change=None,
    wording=None,
    advice=None,
)

BLADE_FLAPPING = Effect(
    "blade_flapping",
    "the rotor discs tilt back in forward flight: a drag that grows with thrust, and a moment",
    "airframe",
    Wrench,
    (
        EffectParameter("k_rad_s_m", "rad.s/m", "tilt of the discs per speed", 0.015, (0, 0.08)),
        EffectParameter(
            "height_m", "m", "discs over the centre of mass", 0.03, (0, 0.15), neutral=None
        ),
    ),
    ("acc", "vel", "q", "gyro"),
    "Mahony, Kumar & Corke, IEEE Robotics & Automation Magazine 19 (2012), p. 25",
    _blade_flapping,
    observable_as=Equation(mistaken_for=("rotor_drag",)),
    prior=Prior(
        RARE,
        "stiff propellers tilt little",
        {"k_rad_s_m": Normal(0.005, 0.01), "height_m": Normal(0.03, 0.03)},
    ),
    change=None,
    wording=Wording(flapping_clause, secondary=("height_m",)),
    advice=None,
)

FLAPPING_MOMENT = Effect(
    "flapping_moment",
    "the air turns the aircraft as it moves through it: front rotors meet fresh air and rear ones "
    "the wake, and discs lift their leading edge; a moment without a force, nose up in forward "
    "flight where it is positive",
    "airframe",
    Wrench,
    (
        EffectParameter(
            "k_n_s",
            "N.s",
            "moment of all rotors per speed in hover",
            0.005,
            (-0.05, 0.05),
            scale=_weight_on_arm,
        ),
    ),
    ("gyro", "vel", "q"),
    "hub moment of stiff rotors, proportional to rotor speed and to that through the air: Martin & "
    "Salaun, ICRA 2010; Folk, Paulos & Kumar, RotorPy, arXiv 2306.04485 (k_flap, other sign); a "
    "skewed wake, Leishman, sec. 3.5.2, gives the same law, as thrust V / v_i, with v_i "
    "proportional to rotor speed",
    _flapping_moment,
    prior=Prior(
        COMMON,
        "a skewed wake, at most 0.3 V / v_i of weight times arm, v_i 4 to 8 m/s; measured 0.03 per "
        "m/s on a Crazyflie (NanoBench), 0.006 to 0.016 on 18 kg (quiver)",
        {"": Normal(0.015, 0.015)},
    ),
    change=None,
    wording=None,
    advice=None,
)

STEADY_WIND = Effect(
    "steady_wind",
    "a wind that does not change during the flight",
    "airframe",
    Air,
    (
        EffectParameter("north_m_s", "m/s", "air moves north", 3.0, (-25, 25), trifle=0.24),
        EffectParameter("east_m_s", "m/s", "air moves east", 0.0, (-25, 25), trifle=0.24),
        EffectParameter("down_m_s", "m/s", "air moves down", 0.0, (-3, 3)),
    ),
    ("acc", "vel", "q"),
    "definition: velocity of the air, NED",
    _steady_wind,
    of_weather=True,
    prior=Prior(
        COMMON,
        "up to 12 m/s is flown in; no mean vertical wind near the ground; indoors a draught",
        {"": Normal(0.0, 4.0, 2.0), "down_m_s": Normal(0.0, 0.3)},
        indoors={"": Normal(0.0, 0.1, 0.03), "down_m_s": Normal(0.0, 0.03)},
    ),
    change=Prior(
        COMMON,
        "weather",
        {"": Normal(0.0, 4.0), "down_m_s": Normal(0.0, 0.3)},
        indoors={"": Normal(0.0, 0.3), "down_m_s": Normal(0.0, 0.05)},
    ),
    wording=Wording(wind_clause, undetected=Undetected(10, "a steady wind below {}")),
    advice=None,
)

GROUND_EFFECT = Effect(
    "ground_effect",
    "rotors gain thrust close to the ground",
    "airframe",
    Thrust,
    (
        EffectParameter("gain", "1", "thrust gained at the ground", 0.3, (0, 1)),
        EffectParameter(
            "height_m",
            "m",
            "height of the centre of mass at which half of it is left",
            2.0,
            (0.2, 10),
            neutral=None,
            scale=lambda v: v.arm_m,
        ),
    ),
    ("acc", "pos", "q"),
    "Cheeseman & Bennett, ARC R&M 3021 (1955), far-field 1 + (R/4z)^2, bounded at the ground",
    _ground_effect,
    prior=Prior(
        COMMON,
        "Cheeseman & Bennett 1955",
        {"gain": Normal(0.3, 0.2), "height_m": Normal(2.0, 1.0)},
    ),
    change=None,
    wording=None,
    advice=None,
)

LINEAR_DRAG = Family(
    "rotor drag",
    "(m/s²)/(m/s)",
    {"rotor_drag.k_xy_1_s": 1.0, "blade_flapping.k_rad_s_m": GRAVITY_M_S2},
)
"""Common law in hover: a force across the rotors, against the airspeed v, that grows with a power p
of their thrust T, m k v (T / m g)^p. Blade drag has p from 0 to 1/2 (`spin_share`). A disc that
tilts back by k v has p = 1: it deflects k v g of the weight that it carries. Thrust changes at
constant airspeed separate the two."""
FAMILIES = (LINEAR_DRAG,)
"""Laws of the air that several effects share."""

EFFECTS = (
    ROTOR_DRAG,
    PARASITIC_DRAG,
    INDUCED_INFLOW,
    TRANSLATIONAL_LIFT,
    BLADE_FLAPPING,
    FLAPPING_MOMENT,
    STEADY_WIND,
    GROUND_EFFECT,
    GUST,
)
