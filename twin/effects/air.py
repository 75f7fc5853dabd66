"""Effects of the air on airframe and rotors."""

from dataclasses import replace

import casadi as ca

from ..frames import cross
from ..vehicle import Vehicle
from .definition import Block, Effect, EffectParameter, Limit
from .stages import Air, Thrust, Wrench

NEAREST_GROUND = 0.25
"""Rotor height over the scale of the ground effect below which it grows no more: standing."""


def _weight_on_arm(vehicle: Vehicle) -> float:
    """Moment of the whole weight on the arm of a rotor, N m."""
    return vehicle.mass_kg * vehicle.gravity_m_s2 * vehicle.arm_m


def _rotor_drag(w: Wrench, p: Block) -> Wrench:
    spin = sum(w.rotors.spin, start=ca.SX(0)) / len(w.rotors.spin)
    grown = 1 + p["spin_share"] * (spin - 1)
    m, air = w.motion.body.mass * w.motion.density * grown, w.motion.air_b
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
)

FLAPPING_MOMENT = Effect(
    "flapping_moment",
    "the air twists the rotors as they move through it: a moment without a force, nose up in "
    "forward flight where it is positive",
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
    "Salaun, ICRA 2010; Folk, Paulos & Kumar, RotorPy, arXiv 2306.04485 (k_flap, other sign)",
    _flapping_moment,
)

STEADY_WIND = Effect(
    "steady_wind",
    "a wind that does not change during the flight",
    "airframe",
    Air,
    (
        EffectParameter("north_m_s", "m/s", "air moves north", 3.0, (-12, 12)),
        EffectParameter("east_m_s", "m/s", "air moves east", 0.0, (-12, 12)),
        EffectParameter("down_m_s", "m/s", "air moves down", 0.0, (-3, 3)),
    ),
    ("acc", "vel", "q"),
    "definition: velocity of the air, NED",
    _steady_wind,
    of_weather=True,
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
)

EFFECTS = (
    ROTOR_DRAG,
    PARASITIC_DRAG,
    INDUCED_INFLOW,
    TRANSLATIONAL_LIFT,
    BLADE_FLAPPING,
    FLAPPING_MOMENT,
    STEADY_WIND,
    GROUND_EFFECT,
)
