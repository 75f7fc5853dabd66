"""Effects on mass, its distribution, and slung loads.

A load on a rope is followed along a flight by an observer, a pendulum corrected by the
accelerometer:

    e = (d - (d . s) s) / max(|d|, d0) where T > 0, else 0;    s = p - tau w, of length one
    d p / d t = w + K e,   d w / d t = ((p . f) p - f) / l - |w|^2 p + L e
    T = M / (M + m) (l |w|^2 - p . f) m

p points from the vehicle to the load, w is its rate, f the specific force that the model predicts
at the centre of mass without the load, d the excess of the measured one, which lags by tau, all
NED; l is the length of the rope, M the mass of the vehicle, m that of the load, T the tension.
Integrated by Heun's method: the half step by which Euler's is late, 2.5 ms, costs loads 2 to 6 % of
their mass and ropes 3 % of their length.

A free pendulum does not forget its start: with an error of a percent in its length it is out of
phase after ten swings, and beyond the horizontal it is chaotic. The terms with e correct it towards
the direction of the measured force. They use past samples only, and directions instead of
magnitudes, so the swing does not depend on the mass.

Source: Sreenath, Michael & Kumar, ICRA 2013, eq. 2 to 5; e makes it a Luenberger observer
(IEEE Trans. Autom. Control 16, 1971).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component.along import accumulated
from ..frames import to_body
from ..vehicle import Vehicle
from .definition import Block, Effect, Equation, Limit, Observer
from .parameters import COMMON, RARE, UNMEASURED, EffectParameter, Normal, Prior
from .stages import Body, Wrench
from .wording import (
    FLY_FOR_CENTRE_OF_MASS,
    FLY_FOR_INERTIA,
    FLY_FOR_THRUST,
    FLY_FOR_YAW_TORQUE,
    Undetected,
    Wording,
    inertia_clause,
    load_clause,
    mass_clause,
    payload_clause,
    place_clause,
)

Array = NDArray[np.float64]
Course = tuple[Array, Array, NDArray[np.bool_]]
"""Unit vectors from the vehicle to the load, and their rates, 1/s, NED, shapes (n, 3); whether the
load is off the ground, shape (n,)."""
ROPE_M, ROPE_ARMS = 0.7, 3.0
"""Expected length of a rope, m, and the same for a large vehicle in arms."""
ROPE_HZ = 5.0
"""Natural frequency of the load on its elastic rope, Hz: stiff relative to any pendulum, slow
relative to 1 ms."""
DIRECTION_GAIN_1_S, RATE_GAIN_1_S2 = 8.0, 16.0
"""K and L. Chosen on benchmark flights: with half of them a load that swings beyond 60 degrees is
lost for seconds, and its mass is estimated too small. Other causes are not followed fast enough to
imitate a pendulum: their own effects still fit far better."""
FASTEST_RAD = 0.5
"""Largest turn of a load in one step: of a faster one the integration makes ever more."""
FAINT_M_S2 = 0.3
"""d0: force of a load of 3 % of the vehicle at rest; the direction of a smaller force is noise."""
PLACE = tuple(f"slung_load.r_{a}" for a in "xyz")  # states: load from its anchor, NED, m
SPEED = tuple(f"slung_load.v_{a}" for a in "xyz")  # states: velocity of the load, NED, m/s


def rope_of(vehicle: Vehicle) -> float:
    """Expected length of a rope relative to `ROPE_M`."""
    return max(1.0, ROPE_ARMS * vehicle.arm_m / ROPE_M)


def pace_of(vehicle: Vehicle) -> float:
    """K relative to that of a rope of `ROPE_M`: the swing on a longer rope is slower, and a faster
    observer follows noise."""
    return 1 / math.sqrt(rope_of(vehicle))


def observe_swing(
    free_n: Array,
    excess_n: Array,
    length_m: float,
    step_s: float,
    lifted: NDArray[np.bool_],
    pace: float = 1.0,
    lag_s: float = 0.0,
) -> Course:
    """Direction of the rope and its rate, starting from a load at rest.

    Args:
        free_n: Specific force predicted without the load, NED, m/s^2. Shape (n, 3).
        excess_n: Measured specific force minus the predicted one, NED, m/s^2; zero where unknown.
            Shape (n, 3).
        length_m: Length of the rope.
        step_s: Time step of the grid.
        lifted: Whether the load is off the ground; else it is at rest. Shape (n,).
        pace: Relative bandwidth, from `pace_of`.
        lag_s: Lag of the measured force.

    Returns:
        Direction, rate and flag, as in `Course`.
    """
    state, excess, rest = ca.SX.sym("state", 6), ca.SX.sym("excess", 3), ca.DM([0, 0, 1, 0, 0, 0])
    free, then, hangs = ca.SX.sym("free", 3), ca.SX.sym("then", 3), ca.SX.sym("hangs")
    p, w = state[:3], state[3:]
    seen = p - lag_s * w
    seen = seen / ca.norm_2(seen)
    taut = length_m * ca.dot(w, w) > ca.dot(p, free)
    innovation = (excess - ca.dot(excess, seen) * seen) / ca.fmax(
        ca.norm_2(excess + 1e-12), FAINT_M_S2
    )
    gains = ca.vertcat(*3 * [pace * DIRECTION_GAIN_1_S], *3 * [pace**2 * RATE_GAIN_1_S2])
    pulled = gains * ca.if_else(taut, ca.repmat(innovation, 2, 1), 0.0)

    def flow(x: ca.SX, force: ca.SX) -> ca.SX:
        """Time derivative of direction and rate."""
        along, rate = x[:3], x[3:]
        bend = (ca.dot(along, force) * along - force) / length_m - ca.dot(rate, rate) * along
        return ca.vertcat(rate, bend) + pulled

    first = flow(state, free)
    moved = state + step_s / 2 * (first + flow(state + step_s * first, then))
    p, w = moved[:3] / ca.norm_2(moved[:3]), moved[3:]
    w = w - ca.dot(w, p) * p
    w = w / ca.fmax(step_s * ca.norm_2(w + 1e-12) / FASTEST_RAD, 1.0)
    after_step = ca.if_else(hangs, ca.vertcat(p, w), rest)
    step = ca.Function("swing_step", [state, free, then, excess, hangs], [after_step])
    start, later = np.asarray(rest).ravel(), np.vstack([free_n[1:], free_n[-1:]])
    there = lifted[:, None].astype(np.float64)
    (after,) = accumulated(step, start, free_n, later, excess_n, there)
    rows = np.vstack([start, after[:-1]])
    return rows[:, :3], rows[:, 3:], lifted


def lifted_off(excess_n: Array, height_m: Array, length_m: float) -> NDArray[np.bool_]:
    """Whether a load is off the ground, shape (n,): the rope is shorter than the height, or it
    pulls equally well below that, as for a vehicle that took off from a stand.

    Args:
        excess_n: Measured specific force minus the predicted one, as in `observe_swing`.
        height_m: Height above the resting place; infinite where unknown. Shape (n,).
        length_m: Length of the rope.
    """
    high, known = height_m > length_m, np.any(excess_n != 0, axis=1)
    low = known & ~high
    if not low.any() or not (known & high).any():
        return np.ones_like(high)
    pull, below = (float(np.mean(excess_n[rows, 2])) for rows in (known & high, low))
    return high | (below >= 0.5 * pull)


def hang_load(
    states: Array,
    names: Sequence[str],
    swung: Course,
    free_n: Array,
    length_m: float,
    share: float,
) -> Array:
    """States with the load at its swing position, or on the ground with a slack rope.

    The rope is extended by the amount that gives the tension, so that the airframe's equations,
    whose rope is elastic, exert exactly this tension.

    Args:
        states: States of the airframe, shape (n, n_x).
        names: Names of the states.
        swung: Result of `observe_swing`.
        free_n: Specific force without the load, as in `observe_swing`.
        length_m: Length of the rope.
        share: Mass of the load over that of the vehicle, which reduces its acceleration.
    """
    along, rate, lifted = swung
    pull = length_m * np.sum(rate**2, axis=1) - np.sum(along * free_n, axis=1)
    stretch = np.maximum(pull, 0.0) / (1 + share) / (2 * np.pi * ROPE_HZ) ** 2
    at = {name: i for i, name in enumerate(names)}
    states = states.copy(order="K")
    distance = np.where(lifted, length_m + stretch, 0.5 * length_m)
    states[:, [at[n] for n in PLACE]] = along * distance[:, None]
    vel = states[:, [at[f"vel_{a}"] for a in "xyz"]]
    states[:, [at[n] for n in SPEED]] = vel + length_m * rate
    return states


ROPE_DAMPING = 0.3
"""Damping ratio of the rope. Made up: oscillations decay within a second."""
REACH = 1.5
"""Distance of the farthest load from the centre of mass, in arms: legs and guards end half an arm
beyond the hubs."""
LIGHTEST_SHARE = 0.01
"""Share of the mass below which a load adds no inertia: its position is undetermined."""
LIGHTEST_LOAD_KG = 1e-6
"""Smallest mass in the pendulum; a lighter load moves like this one, with a force in proportion to
its own mass."""


def _mass_offset(b: Body, p: Block) -> Body:
    return replace(b, mass=b.mass + p["mass_kg"])


def _cog_offset(b: Body, p: Block) -> Body:
    shift = [p["x_m"], p["y_m"], p["z_m"]]
    hubs = [[h - s for h, s in zip(hub, shift, strict=True)] for hub in b.hubs]
    return replace(b, hubs=hubs, origin=[o - s for o, s in zip(b.origin, shift, strict=True)])


def _payload_cg(b: Body, p: Block) -> Body:
    """A point mass m at the position r, by m and the static moment m r: mass, centre of mass and
    inertia about it (Huygens and Steiner) follow."""
    load, moment = p["mass_kg"], [p[f"moment_{a}_kg_m"] for a in "xyz"]
    mass = b.mass + load
    shift = [q / mass for q in moment]
    square = sum((q * q for q in moment), start=ca.SX(0))
    per_load = b.mass / (mass * ca.fmax(load, LIGHTEST_SHARE * b.mass))
    inertia = [
        [
            entry + per_load * ((square if i == j else 0.0) - moment[i] * moment[j])
            for j, entry in enumerate(row)
        ]
        for i, row in enumerate(b.inertia)
    ]
    hubs = [[h - s for h, s in zip(hub, shift, strict=True)] for hub in b.hubs]
    origin = [o - s for o, s in zip(b.origin, shift, strict=True)]
    return replace(b, mass=mass, inertia=inertia, hubs=hubs, origin=origin)


def _within_reach(vehicle: Vehicle) -> tuple[Limit, ...]:
    """Limits: a load is within `REACH` arms of the centre of mass along each axis."""
    reach = REACH * vehicle.arm_m
    return tuple(
        Limit(
            {"mass_kg": reach, f"moment_{a}_kg_m": sign},
            f"no load hangs farther than {REACH:g} arm lengths from the centre of mass",
        )
        for a in "xyz"
        for sign in (1.0, -1.0)
    )


def _inertia_error(b: Body, p: Block) -> Body:
    factor = [p[f"scale_{a}"] for a in "xyz"]
    inertia = [list(row) for row in b.inertia]
    for i, k in enumerate(factor):
        inertia[i][i] = k * inertia[i][i]
    return replace(b, inertia=inertia)


def _rigid(vehicle: Vehicle) -> tuple[Limit, ...]:
    """Limits: moments of inertia are sums of squares, I_y + I_z - I_x = 2 * integral of x^2 dm."""
    moments = dict(zip("xyz", np.diag(vehicle.inertia_kg_m2), strict=True))
    return tuple(
        Limit(
            {f"scale_{b}": float(-m if b == a else m) for b, m in moments.items()},
            f"no body's moment of inertia about {a} is larger than the other two together",
        )
        for a in moments
    )


def _slung_load(w: Wrench, p: Block) -> Wrench:
    motion = w.motion
    mass, length = ca.fmax(p["mass_kg"], LIGHTEST_LOAD_KG), p["length_m"]
    omega = 2 * np.pi * ROPE_HZ
    stiffness, damping = mass * omega**2, 2 * ROPE_DAMPING * mass * omega
    rest = [ca.SX(0), ca.SX(0), length + motion.gravity / omega**2]
    # Position and velocity of the load relative to the vehicle, NED.
    r = [
        p.state(
            f"r_{a}",
            "m",
            f"load from the vehicle, NED {a}",
            s + p.start(f"r_{a}", "m", f"place of the load from that at rest, NED {a}"),
        )
        for a, s in zip("xyz", rest, strict=True)
    ]
    v = [
        p.state(
            f"v_{a}",
            "m/s",
            f"speed of the load, NED {a}",
            s + p.start(f"v_{a}", "m/s", f"speed of the load from the vehicle's, NED {a}"),
        )
        for a, s in zip("xyz", motion.start_vel_n, strict=True)
    ]
    distance = ca.sqrt(sum((c * c for c in r), start=ca.SX(0)) + 1e-12)
    along = [c / distance for c in r]
    relative = [a - b for a, b in zip(v, motion.vel_n, strict=True)]
    stretch = sum((a * b for a, b in zip(along, relative, strict=True)), start=ca.SX(0))
    taut = distance > length
    p.crossing("slack", "m", "what the rope hangs through, at 0 it pulls", length - distance)
    tension = ca.if_else(
        taut, ca.fmax(stiffness * (distance - length) + damping * stretch, 0.0), 0.0
    )
    for a, way, unit in zip("xyz", relative, along, strict=True):
        pull = -tension * unit / mass
        p.derivative(f"r_{a}", way)
        p.derivative(f"v_{a}", pull + motion.gravity if a == "z" else pull)
    share = p["mass_kg"] / mass
    force = to_body(motion.q_nb, [share * tension * c for c in along])
    return replace(w, force=[f + t for f, t in zip(w.force, force, strict=True)])


def _follow_load(
    free_n: Array,
    excess_n: Array,
    lag_s: float,
    height_m: Array,
    numbers: Mapping[str, float],
    step_s: float,
    vehicle: Vehicle,
) -> Course:
    length = numbers["length_m"]
    lifted = lifted_off(excess_n, height_m, length)
    return observe_swing(free_n, excess_n, length, step_s, lifted, pace_of(vehicle), lag_s)


def _gain_of_load(vehicle: Vehicle) -> float:
    return DIRECTION_GAIN_1_S * pace_of(vehicle)


def _place_load(
    states: Array,
    names: Sequence[str],
    course: Course,
    free_n: Array,
    numbers: Mapping[str, float],
    vehicle: Vehicle,
) -> Array:
    share = numbers["mass_kg"] / vehicle.mass_kg
    return hang_load(states, names, course, free_n, numbers["length_m"], share)


MASS_OFFSET = Effect(
    "mass_offset",
    "the aircraft is heavier or lighter than the model",
    "airframe",
    Body,
    (
        EffectParameter(
            "mass_kg",
            "kg",
            "mass on top of the model's",
            0.1,
            (-0.5, 3.0),
            scale=lambda v: v.mass_kg,
            trifle=0.011,
        ),
    ),
    ("acc",),
    "definition",
    _mass_offset,
    observable_as=Equation(mistaken_for=("thrust_scale",)),
    prior=Prior(
        COMMON, "battery, payload of up to 30 %", {"": Normal(0.0, 0.12)}, corrects="body.mass"
    ),
    change=None,
    wording=Wording(mass_clause, undetected=Undetected(3, "a mass that is off by less than {}")),
    advice={"": FLY_FOR_THRUST},
)

COG_OFFSET = Effect(
    "cog_offset",
    "the centre of mass is not where the model has it",
    "airframe",
    Body,
    (
        EffectParameter(
            "x_m",
            "m",
            "centre of mass forward of the model's",
            0.05,
            (-0.4, 0.4),
            scale=lambda v: v.arm_m,
        ),
        EffectParameter(
            "y_m",
            "m",
            "centre of mass right of the model's",
            0.0,
            (-0.4, 0.4),
            scale=lambda v: v.arm_m,
        ),
        EffectParameter(
            "z_m",
            "m",
            "centre of mass below the model's",
            0.0,
            (-0.4, 0.4),
            scale=lambda v: v.arm_m,
        ),
    ),
    ("gyro",),
    "definition: rotor hubs move the other way; the airframe gives the specific force where the "
    "vehicle file has the centre of mass, so the IMU keeps its place",
    _cog_offset,
    prior=Prior(
        UNMEASURED,
        "place of the battery, put in anew before every flight",
        {"": Normal(0.0, 0.05, 0.015)},
        corrects="rotors.position",
    ),
    change=Prior(RARE, "a battery that sits elsewhere, of the same mass", {"": Normal(0.0, 0.05)}),
    wording=Wording(
        place_clause, undetected=Undetected(5, "a centre of mass that is off by less than {}")
    ),
    advice={"": FLY_FOR_CENTRE_OF_MASS},
)

INERTIA_ERROR = Effect(
    "inertia_error",
    "the aircraft turns more sluggishly or more nimbly than its inertia in the model says",
    "airframe",
    Body,
    tuple(
        EffectParameter(
            f"scale_{a}", "1", f"moment of inertia about {a} over the model's", 1.3, (0.3, 3), 1.0
        )
        for a in "xyz"
    ),
    ("gyro",),
    "definition: factors on the diagonal of the inertia matrix, which obeys the triangle "
    "inequality: Goldstein, Classical Mechanics, ch. 5",
    _inertia_error,
    _rigid,
    observable_as=Equation(scales="inertia"),
    prior=Prior(
        UNMEASURED,
        "CAD or bifilar 5 to 10 % off, guessed 30 %",
        {"": Normal(1.0, 0.25)},
        corrects="body.inertia",
    ),
    change=None,
    wording=Wording(
        inertia_clause, undetected=Undetected(6, "inertia that is off by less than {}")
    ),
    advice={"scale_z": FLY_FOR_YAW_TORQUE, "": FLY_FOR_INERTIA},
)

PAYLOAD_CG = Effect(
    "payload_cg",
    "a load is strapped to the aircraft: mass, centre of mass and inertia change together",
    "airframe",
    Body,
    (
        EffectParameter(
            "mass_kg",
            "kg",
            "mass of the load",
            0.1,
            (0, 3),
            scale=lambda v: v.mass_kg,
            trifle=0.01,
        ),
        *(
            EffectParameter(
                f"moment_{a}_kg_m",
                "kg.m",
                f"mass of the load times its place along {a} from the centre of mass",
                0.0,
                (-1.5, 1.5),
                scale=lambda v: v.mass_kg * v.arm_m,
                trifle=0.005,
            )
            for a in "xyz"
        ),
    ),
    ("acc", "gyro"),
    "definition: point mass; static moment and parallel axes, Goldstein, Classical Mechanics, "
    "ch. 5",
    _payload_cg,
    _within_reach,
    prior=None,
    change=Prior(
        COMMON,
        "a load of some 10 % of the mass anywhere between the hubs",
        {"mass": Normal(0.0, 0.1), "moment_z": Normal(0.0, 0.03), "moment": Normal(0.0, 0.07)},
        one_sided=True,
    ),
    wording=Wording(payload_clause, undetected=Undetected(4, "a load below {}")),
    advice={"mass": FLY_FOR_THRUST, "": FLY_FOR_CENTRE_OF_MASS},
)

SLUNG_LOAD = Effect(
    "slung_load",
    "a load hangs below on a rope and swings",
    "airframe",
    Wrench,
    (
        EffectParameter(
            "mass_kg", "kg", "mass of the load", 0.1, (0, 0.6), scale=lambda v: v.mass_kg
        ),
        EffectParameter(
            "length_m",
            "m",
            "length of the rope",
            ROPE_M,
            (0.1, 5),
            neutral=None,
            scale=rope_of,
        ),
    ),
    ("acc", "vel", "q"),
    "point mass on an elastic rope that pulls only, hung at the centre of mass; in simulations it "
    "knows no ground: Sreenath, Michael & Kumar, ICRA 2013, with a spring for the rigid link",
    _slung_load,
    observable_as=Equation(Observer(_follow_load, _place_load, ("acc_x", "acc_y"), _gain_of_load)),
    prior=Prior(
        RARE,
        "only where somebody hung one",
        {"mass_kg": Normal(0.0, 0.2), "length_m": Normal(ROPE_M, ROPE_M)},
    ),
    change=Prior(
        RARE,
        "a load of 5 to 25 % on a rope",
        {"mass_kg": Normal(0.1, 0.1), "length_m": Normal(ROPE_M, ROPE_M)},
        one_sided=True,
    ),
    wording=Wording(load_clause, undetected=Undetected(8, "a slung load below {}")),
    advice=None,
)

EFFECTS = (MASS_OFFSET, COG_OFFSET, INERTIA_ERROR, PAYLOAD_CG, SLUNG_LOAD)
