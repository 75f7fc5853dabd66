"""Effects between motor command and rotor wrench."""

from dataclasses import replace

import casadi as ca

from ..frames import cross
from ..vehicle import Vehicle
from ..vehicle.vehicle import hover_level, voltage_power
from .definition import Block, Effect, Equation
from .parameters import COMMON, RARE, UNMEASURED, EffectParameter, Normal, Prior
from .stages import Motors, Thrust, Wrench
from .wording import (
    FLY_FOR_BATTERY_SAG,
    FLY_FOR_INERTIA,
    FLY_FOR_THRUST,
    FLY_FOR_YAW_TORQUE,
    Undetected,
    Wording,
    cant_clause,
    delay_clause,
    factor_clause,
    rotor_clause,
    sag_clause,
)

QUICKEST_LAG_S = 0.008
"""Smallest lag that a grid of 5 ms can distinguish from none."""


LEAST_LAG_S = 2.5e-3
"""Smallest lag to which that of a file is reduced: half the longest step of integration."""


LEAST_SHARE = 1e-3
"""Thrust over that in hover, or over that of a whole rotor, below which a power of it is constant:
a root has no finite slope at zero."""


def _hover_momentum(vehicle: Vehicle) -> float:
    """Spin momentum of one rotor in hover, N m s, estimated from thrust and arm.

    The estimate is thrust times arm over 40 rad/s^2: 0.07 mN m s for 27 g, 20 mN m s for 1.5 kg.
    """
    return vehicle.hover_thrust_n * vehicle.arm_m / 40.0


def _scaled(r: Thrust, factor: list[ca.SX]) -> Thrust:
    return replace(r, thrust=[t * k for t, k in zip(r.thrust, factor, strict=True)])


def _thrust_scale(r: Thrust, p: Block) -> Thrust:
    return _scaled(r, [p["scale"]] * len(r.thrust))


def _thrust_curve(r: Thrust, p: Block) -> Thrust:
    return _scaled(r, [ca.fmax(t / r.hover, LEAST_SHARE) ** p["slope"] for t in r.thrust])


def _battery_sag(r: Thrust, p: Block) -> Thrust:
    factor = ca.fmax(1 + p["slope"] * (r.motion.voltage / p["reference_v"] - 1), 0.0)
    return replace(r, thrust=[t * factor for t in r.thrust], torque=[q * factor for q in r.torque])


def _motor_lag(d: Motors, p: Block) -> Motors:
    def longer(lag: ca.SX) -> ca.SX:
        return ca.fmax(lag + p["tau_s"], ca.fmin(lag, LEAST_LAG_S))

    return replace(d, lag_up=longer(d.lag_up), lag_down=longer(d.lag_down))


def _spare_lag(vehicle: Vehicle) -> float:
    """Largest reduction of the file's lag, as a negative number, s."""
    rotors = vehicle.rotors
    lag = min(rotors.lag_up_s, rotors.lag_down_s)
    return min(0.0, max(-0.9 * lag, LEAST_LAG_S - lag))


def _rotor_efficiency_loss(r: Thrust, p: Block) -> Thrust:
    left, share = [1 - k for k in p.each("loss")], p["torque_share"]
    torque = [q * ca.fmax(k, LEAST_SHARE) ** share for q, k in zip(r.torque, left, strict=True)]
    return replace(_scaled(r, left), torque=torque)


def _rotor_inertia_torque(r: Thrust, p: Block) -> Thrust:
    k = p["momentum_n_m_s"]
    return replace(r, torque=[q + k * s for q, s in zip(r.torque, r.spin_rate, strict=True)])


def _gyroscopic_torque(w: Wrench, p: Block) -> Wrench:
    spin = sum((d * s for d, s in zip(w.rotors.direction, w.rotors.spin, strict=True)), ca.SX(0))
    momentum = [ca.SX(0), ca.SX(0), p["momentum_n_m_s"] * spin]
    torque = cross(w.motion.omega_b, momentum)
    return replace(w, moment=[m - t for m, t in zip(w.moment, torque, strict=True)])


def _yaw_torque_scale(r: Thrust, p: Block) -> Thrust:
    return replace(r, torque=[p["scale"] * q for q in r.torque])


def _thrust_tilt(w: Wrench, p: Block) -> Wrench:
    x, y = p["x_rad"], p["y_rad"]
    axis = [x, y, 1 - ca.sqrt(ca.fmax(1 - x * x - y * y, 0.0))]  # change of [0, 0, -1]
    force, moment = list(w.force), list(w.moment)
    for hub, t in zip(w.motion.body.hubs, w.rotors.thrust, strict=True):
        change = [t * a for a in axis]
        force = [f + c for f, c in zip(force, change, strict=True)]
        moment = [m + c for m, c in zip(moment, cross(hub, change), strict=True)]
    return replace(w, force=force, moment=moment)


def _rotor_cant(w: Wrench, p: Block) -> Wrench:
    lift = sum(w.rotors.thrust, start=ca.SX(0))
    x, y, z = w.moment
    return replace(w, moment=[x, y, z + p["yaw_m"] * lift])


def _voltage(vehicle: Vehicle) -> float:
    return vehicle.voltage_v


def _momentum(vehicle: Vehicle, inertia_kg_m2: float) -> float:
    """Spin momentum of one rotor in hover by its inertia; 0 where its speed is unknown."""
    return inertia_kg_m2 * hover_level(vehicle) if vehicle.rotors.from_speed else 0.0


_MOMENTUM = EffectParameter(
    "momentum_n_m_s",
    "N.m.s",
    "spin momentum of one rotor in hover",
    1.0,
    (0, 10),
    scale=_hover_momentum,
)


THRUST_SCALE = Effect(
    "thrust_scale",
    "every rotor gives more or less thrust than its map says, by the same factor",
    "airframe",
    Thrust,
    (
        EffectParameter(
            "scale", "1", "thrust over that of the map", 0.9, (0.4, 2.5), neutral=1.0, trifle=0.01
        ),
    ),
    ("acc",),
    "definition: one factor on the thrust map",
    _thrust_scale,
    observable_as=Equation(mistaken_for=("mass_offset",)),
    prior=Prior(
        UNMEASURED,
        "maps come from other propellers: bench tests 10 to 30 % off, copied files 50 %",
        {"": Normal(1.0, 0.3)},
        corrects="rotors.thrust",
    ),
    change=None,
    wording=Wording(
        factor_clause("its rotors give", "thrust"),
        undetected=Undetected(2, "thrust that is off by less than {}"),
    ),
    advice={"": FLY_FOR_THRUST},
)

THRUST_CURVE = Effect(
    "thrust_curve",
    "thrust grows faster or slower with the command than the map says, the same in hover",
    "airframe",
    Thrust,
    (
        EffectParameter(
            "slope",
            "1",
            "what is added to the power of thrust over that in hover",
            0.2,
            (-1.0, 2.0),
        ),
    ),
    ("acc",),
    "definition: a power of thrust over that in hover, so that more command never lifts less, "
    "however far beyond the commands that were flown; range: at -1 no command lifts more than "
    "another, at 2 a map that is linear in the command should be its cube",
    _thrust_curve,
    prior=Prior(RARE, "the shape of a map is better known than its size", {"": Normal(0.0, 0.15)}),
    change=None,
    wording=None,
    advice=None,
)

BATTERY_SAG = Effect(
    "battery_sag",
    "thrust falls as the battery voltage falls",
    "airframe",
    Thrust,
    (
        EffectParameter(
            "slope",
            "1",
            "relative thrust per relative voltage, on top of the model's",
            1.5,
            (0, 4),
            floor=lambda v: -voltage_power(v),
        ),
        EffectParameter(
            "reference_v",
            "V",
            "voltage at which the maps hold",
            1.0,
            (0.7, 1.3),
            neutral=None,
            scale=_voltage,
        ),
    ),
    ("acc", "vbat"),
    "thrust of a brushless motor against voltage, slope 1 to 2: Podhradsky, Coopmans & Jensen, "
    "J. Intell. Robot. Syst. 74 (2014)",
    _battery_sag,
    prior=Prior(
        COMMON,
        "slope 1 to 2 (Podhradsky et al. 2014) on every motor controller without compensation",
        {"slope": Normal(1.3, 0.6), "reference_v": Normal(1.0, 0.05)},
        corrects="rotors.voltage_exponent",
        written=voltage_power,
        whole=True,
        unsaid=lambda v: not v.states_voltage,
    ),
    change=None,
    wording=Wording(sag_clause),
    advice={"": FLY_FOR_BATTERY_SAG},
)

MOTOR_LAG = Effect(
    "motor_lag",
    "rotors follow the command more slowly than the model's do, or faster",
    "airframe",
    Motors,
    (
        EffectParameter(
            "tau_s",
            "s",
            "time constant on top of the model's",
            0.05,
            (0, 0.3),
            trifle=0.003,
            floor=_spare_lag,
        ),
    ),
    ("acc", "gyro"),
    "first-order rotor dynamics: Mahony, Kumar & Corke 2012, p. 22; 75 ms measured on a Crazyflie",
    _motor_lag,
    prior=Prior(
        UNMEASURED,
        "whole lag of all published airframes: 15 to 75 ms",
        {"": Normal(0.03, 0.015)},
        corrects="rotors.lag",
        written=lambda v: v.rotors.lag_up_s,
        whole=True,
        timed=True,
        least=lambda v: None if v.rotors.follows else QUICKEST_LAG_S,
    ),
    change=None,
    wording=Wording(
        delay_clause("its rotors follow"),
        undetected=Undetected(7, "a motor lag that is off by less than {}"),
    ),
    advice={"": FLY_FOR_INERTIA},
)

ROTOR_EFFICIENCY_LOSS = Effect(
    "rotor_efficiency_loss",
    "single rotors give less thrust than the others: a damaged blade, a worn motor",
    "airframe",
    Thrust,
    (
        EffectParameter(
            "loss", "1", "share of the thrust lost", 0.0, (-0.3, 1), per_rotor=True, trifle=0.006
        ),
        EffectParameter(
            "torque_share",
            "1",
            "power of the share of the thrust left that is left of the reaction torque",
            1.0,
            (0, 1.5),
            neutral=None,
            ends=True,
        ),
    ),
    ("acc", "gyro"),
    "definition: one factor per rotor, and a power of it on its torque, which stays positive; "
    "thrust and torque of a rotor that turns more slowly go with the square of its speed (power "
    "1), one with a damaged blade may keep more of its torque",
    _rotor_efficiency_loss,
    observable_as=Equation(mistaken_for=("cog_offset", "thrust_scale", "mass_offset")),
    prior=Prior(
        RARE,
        "propellers of one bag differ by 2 to 5 %, damaged blades cost up to 30 %; slower rotors "
        "lose torque as they lose thrust, damaged blades less of it, those of many simulators none",
        {"loss": Normal(0.0, 0.12), "torque_share": Normal(0.8, 0.5)},
    ),
    change=Prior(
        COMMON,
        "a nicked blade costs 5 to 30 % of its rotor's thrust",
        {"loss": Normal(0.1, 0.1), "torque_share": Normal(1.0, 0.3)},
        one_sided=True,
    ),
    wording=Wording(
        rotor_clause, undetected=Undetected(1, "a loss below {} of the thrust of one rotor")
    ),
    advice=None,
)

ROTOR_INERTIA_TORQUE = Effect(
    "rotor_inertia_torque",
    "rotors that speed up or slow down twist the body about the yaw axis",
    "airframe",
    Thrust,
    (_MOMENTUM,),
    ("gyro",),
    "reaction to the rotor's own acceleration; measured on a Crazyflie: R2 of yaw 0.52 to 0.92",
    _rotor_inertia_torque,
    prior=Prior(
        COMMON,
        "0.9 to 1.6 times the guess from thrust and arm: OS4 (Bouabdallah 2007), AR.Drone, "
        "Hummingbird, an F450, a quadrotor of 1.8 kg; Crazyflie by mass and radius of its blades",
        {"": Normal(1.0, 0.5)},
        corrects="rotors.reaction_inertia",
        written=lambda v: _momentum(v, v.rotors.reaction_inertia_kg_m2),
        unsaid=lambda v: not v.rotors.follows,
    ),
    change=None,
    wording=None,
    advice={"": FLY_FOR_YAW_TORQUE},
)

GYROSCOPIC_TORQUE = Effect(
    "gyroscopic_torque",
    "spinning rotors resist roll and pitch rates with a torque at right angles",
    "airframe",
    Wrench,
    (_MOMENTUM,),
    ("gyro",),
    "Stevens, Lewis & Johnson, eq. 1.7-8 with the momentum of the rotors",
    _gyroscopic_torque,
    prior=Prior(
        RARE,
        "the same momentum",
        {"": Normal(1.0, 0.5)},
        corrects="rotors.spin_inertia",
        written=lambda v: _momentum(v, v.rotors.spin_inertia_kg_m2),
    ),
    change=None,
    wording=None,
    advice=None,
)

YAW_TORQUE_SCALE = Effect(
    "yaw_torque_scale",
    "rotors twist the body about the yaw axis more or less than their map says",
    "airframe",
    Thrust,
    (EffectParameter("scale", "1", "reaction torque over that of the map", 1.5, (0.2, 5), 1.0),),
    ("gyro",),
    "definition: one factor on the torque map",
    _yaw_torque_scale,
    observable_as=Equation(scales="torque"),
    prior=Prior(
        UNMEASURED,
        "torque coefficients are the least known numbers of a file",
        {"": Normal(1.0, 0.5)},
        corrects="rotors.torque",
    ),
    change=None,
    wording=Wording(factor_clause("its rotors give", "yaw torque")),
    advice={"": FLY_FOR_YAW_TORQUE},
)

THRUST_TILT = Effect(
    "thrust_tilt",
    "rotor axes are not parallel to body z: a constant sideways part of the thrust",
    "airframe",
    Wrench,
    (
        EffectParameter("x_rad", "rad", "thrust leans forward", 0.03, (-0.2, 0.2)),
        EffectParameter("y_rad", "rad", "thrust leans right", 0.0, (-0.2, 0.2)),
    ),
    ("acc", "q"),
    "definition: axis of the thrust in body axes",
    _thrust_tilt,
    prior=Prior(COMMON, "1 to 2 degrees of frame and board", {"": Normal(0.0, 0.03)}),
    change=None,
    wording=None,
    advice=None,
)

ROTOR_CANT = Effect(
    "rotor_cant",
    "rotor axes lean around the body: a constant yaw moment per thrust",
    "airframe",
    Wrench,
    (
        EffectParameter(
            "yaw_m",
            "m",
            "yaw moment per thrust",
            0.02,
            (-0.2, 0.2),
            scale=lambda v: v.arm_m,
        ),
    ),
    ("gyro",),
    "definition: tangential tilt of arms or motor mounts, equal to the difference of reaction "
    "torques of the two directions of rotation",
    _rotor_cant,
    prior=Prior(
        UNMEASURED,
        "arms that are turned by 1 degree make 0.017 arm lengths, 10 to 25 % of the reaction "
        "torque per thrust of usual propellers; a propeller put on anew changes it",
        {"": Normal(0.0, 0.02, 0.0005)},
    ),
    change=None,
    wording=Wording(cant_clause),
    advice={"": FLY_FOR_YAW_TORQUE},
)

EFFECTS = (
    THRUST_SCALE,
    THRUST_CURVE,
    BATTERY_SAG,
    MOTOR_LAG,
    ROTOR_EFFICIENCY_LOSS,
    ROTOR_INERTIA_TORQUE,
    GYROSCOPIC_TORQUE,
    YAW_TORQUE_SCALE,
    THRUST_TILT,
    ROTOR_CANT,
)
