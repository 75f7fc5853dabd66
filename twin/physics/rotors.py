"""Rotors: from motor commands or rotor speeds to thrust and reaction torque.

Three kinds, by the vehicle file and the signals of the flight:

| thrust map | input | state per rotor |
|---|---|---|
| of the speed | command, through `speed_from_command` and a lag | speed, rad/s |
| of the speed | measured rotor speed | none |
| of the command | command, through a lag | effective command, 0..1 |

Effects of a rotor's motion through the air: advance, drag, inflow, lift, moments. The laws, their
signs and their sources are those of `twin.vehicle.RotorAir` and `Advance`. All act at the hub,
whose velocity through the air is that of the centre of mass and of the rotating body. A coefficient
of zero removes its term from the equations.
"""

import itertools
from collections.abc import Sequence
from typing import Literal

import casadi as ca
import numpy as np

from ..component import ComponentBuilder
from ..effects.definition import Blocks
from ..effects.stages import Motion, Motors, Thrust
from ..errors import ModelError
from ..frames import cross
from ..vehicle import RotorAir, Rotors, Vehicle
from ..vehicle.vehicle import hover_level, polynomial

SLOWEST_RAD_S = 1e-3
"""Rotor speed below which the advance ratio is that at this speed: thrust is negligible."""


def by_advance(
    m: ComponentBuilder, rotors: Rotors, motion: Motion, speed: list[ca.SX]
) -> tuple[list[ca.SX], list[ca.SX]]:
    """Factors on thrust and on reaction torque of each rotor, at rotor speeds in rad/s.

    The rows of the tables are constants of the equations, not parameters.
    """
    one = [ca.SX(1)] * len(speed)
    if rotors.advance is None:
        return one, one
    diameter = m.parameter(
        "diameter", rotors.advance.diameter_m, "m", "Diameter of a rotor", minimum=1e-4
    )
    ratios = [
        -z * 2 * np.pi / (ca.fmax(w, SLOWEST_RAD_S) * diameter)
        for w, (_, _, z) in zip(speed, motion.hubs_air_b, strict=True)
    ]
    thrust, torque = (
        [_on_lines(table, j) for j in ratios] if table else one
        for table in (rotors.advance.thrust, rotors.advance.torque)
    )
    return thrust, torque


def _on_lines(table: Sequence[tuple[float, float]], x: ca.SX) -> ca.SX:
    """Linear interpolation of a table at x, the first and last values beyond."""
    value = ca.SX(table[0][1])
    for (x0, y0), (x1, y1) in itertools.pairwise(table):
        way = ca.if_else(x > x0, ca.if_else(x < x1, x - x0, x1 - x0), 0.0)
        value += (y1 - y0) / (x1 - x0) * way
    return value


def gained_thrust(
    m: ComponentBuilder, air: RotorAir, motion: Motion, speed: list[ca.SX]
) -> list[ca.SX]:
    """Additional thrust of each rotor by its motion through the air, N, at rotor speeds in
    rad/s."""
    gained = [ca.SX(0)] * len(speed)
    if air.lift_kg_m:
        k = m.parameter(
            "rotor_air.lift",
            air.lift_kg_m,
            "N.s2/m2",
            "Thrust of one rotor per square of its in-plane speed through the air",
        )
        gained = [
            t + motion.density * k * (x * x + y * y)
            for t, (x, y, _) in zip(gained, motion.hubs_air_b, strict=True)
        ]
    if air.inflow_kg_rad:
        k = m.parameter(
            "rotor_air.inflow",
            air.inflow_kg_rad,
            "kg/rad",
            "Thrust that one rotor loses per rotor speed and climb speed",
            minimum=0,
        )
        gained = [
            t + motion.density * k * w * z
            for t, w, (_, _, z) in zip(gained, speed, motion.hubs_air_b, strict=True)
        ]
    return gained


def hub_loads(
    m: ComponentBuilder, vehicle: Vehicle, rotors: Thrust
) -> list[tuple[list[ca.SX], list[ca.SX]]]:
    """Force, N, and moment about the centre of mass, N m, of the air on each rotor, body FRD.

    Without thrust and reaction torque. Empty where the vehicle has no such numbers.
    """
    air, motion = vehicle.rotors.air, rotors.motion
    if not (air.drag_kg_rad or air.flapping_kg_m_rad or air.rolling_kg_m_rad):
        return []
    zero = ca.SX(0)
    drag, flapping, rolling = (
        m.parameter(f"rotor_air.{name}", value, unit, meaning, minimum=minimum) if value else zero
        for name, value, unit, meaning, minimum in (
            (
                "drag",
                air.drag_kg_rad,
                "kg/rad",
                "In-plane drag of one rotor per rotor speed and hub speed",
                0,
            ),
            (
                "flapping_moment",
                air.flapping_kg_m_rad,
                "kg.m/rad",
                "Moment of one rotor, leading edge up, per rotor speed and hub speed",
                None,
            ),
            (
                "rolling_moment",
                air.rolling_kg_m_rad,
                "kg.m/rad",
                "Moment of one rotor against its velocity, per rotor speed and hub speed",
                None,
            ),
        )
    )
    hover, loads = hover_level(vehicle), []
    for hub, spin, (x, y, _) in zip(motion.body.hubs, rotors.spin, motion.hubs_air_b, strict=True):
        blow = motion.density * hover * spin
        force = [-blow * drag * x, -blow * drag * y, zero]
        tilt = [
            -blow * (flapping * y + rolling * x),
            blow * (flapping * x - rolling * y),
            zero,
        ]
        loads.append((force, [a + b for a, b in zip(cross(hub, force), tilt, strict=True)]))
    return loads


Drive = Literal["command", "rotor_speed"]
SHORTEST_LAG_S = 15e-3
"""Time constant of the state that gives the rate of a rotor where the file has no lag: that of the
fastest rotors among published airframes, 15 to 75 ms. A shorter one would turn steps of recorded
commands into accelerations."""


def rotor_inputs(m: ComponentBuilder, vehicle: Vehicle, drive: Drive) -> list[ca.SX]:
    """Declare the inputs of the rotors, one each: `cmd_i`, 0..1, or `rotor_i`, rad/s.

    Raises:
        ModelError: The vehicle's maps do not allow this input.
    """
    numbers = range(1, vehicle.rotors.count + 1)
    if drive == "command":
        return [m.input(f"cmd_{i}", "1", f"Command of motor {i}, 0..1") for i in numbers]
    if not vehicle.rotors.from_speed:
        raise ModelError(
            "Measured rotor speeds cannot drive a vehicle whose thrust map is of the command; "
            "give rotors.thrust_from_speed in the vehicle file."
        )
    # Hover trim is a start value of the inputs, set once the whole airframe is built.
    return [m.input(f"rotor_{i}", "rad/s", f"Speed of rotor {i}") for i in numbers]


def rotor_equations(
    m: ComponentBuilder,
    vehicle: Vehicle,
    drive: Drive,
    inputs: list[ca.SX],
    motion: Motion,
    blocks: Blocks,
) -> Thrust:
    """Declare parameters and states of the rotors; returns thrust and torque of each."""
    rotors = vehicle.rotors
    argument, argument_unit = ("rotor speed", "rad/s") if rotors.from_speed else ("command", "1")
    thrust = _coefficients(m, "thrust", "N", "Thrust", rotors.thrust_n, argument, argument_unit)
    torque = _coefficients(
        m, "torque", "N.m", "Reaction torque", rotors.torque_n_m, argument, argument_unit
    )
    if drive == "rotor_speed":
        level, rate = inputs, _spin_rates(m, rotors, blocks)
    else:
        level, rate = _driven_by_command(m, vehicle, inputs, motion.voltage, blocks)
    # A fitted polynomial may be negative near zero, where a rotor at rest has no negative thrust.
    pushes = [_not_negative(polynomial(thrust, x)) * motion.density for x in level]
    twists = [_not_negative(polynomial(torque, x)) * motion.density for x in level]
    thrust_share, torque_share = by_advance(m, rotors, motion, level)
    gained = gained_thrust(m, rotors.air, motion, level)
    # With commands and without lag the file's rotors have no acceleration.
    known = drive == "rotor_speed" or rotors.follows
    reactions = _reactions(m, rotors, rate) if known else [ca.SX(0)] * rotors.count
    pushes = [t * k + g for t, k, g in zip(pushes, thrust_share, gained, strict=True)]
    twists = [q * k + r for q, k, r in zip(twists, torque_share, reactions, strict=True)]
    spin, spin_rate = _spin(vehicle, level, rate)
    return Thrust(
        motion, rotors.direction.tolist(), vehicle.hover_thrust_n, spin, spin_rate, pushes, twists
    )


def _spin_rates(m: ComponentBuilder, rotors: Rotors, blocks: Blocks) -> list[ca.SX]:
    """Time derivatives of measured rotor speeds, an input where an effect needs them."""
    if not blocks.include("rotor_inertia_torque") and rotors.reaction_inertia_kg_m2 == 0:
        return [ca.SX(0)] * rotors.count
    return [
        m.input(f"spin_rate_{i}", "rad/s2", f"Rate of change of the speed of rotor {i}")
        for i in range(1, rotors.count + 1)
    ]


def _reactions(m: ComponentBuilder, rotors: Rotors, rate: list[ca.SX]) -> list[ca.SX]:
    """Torque that accelerates each rotor, whose reaction acts on the body."""
    if rotors.reaction_inertia_kg_m2 == 0:
        return [ca.SX(0)] * rotors.count
    inertia = m.parameter(
        "reaction_inertia",
        rotors.reaction_inertia_kg_m2,
        "kg.m2",
        "Inertia of one rotor in the reaction to its own acceleration",
        minimum=0,
    )
    return [inertia * r for r in rate]


def _driven_by_command(
    m: ComponentBuilder,
    vehicle: Vehicle,
    commands: list[ca.SX],
    voltage: ca.SX,
    blocks: Blocks,
) -> tuple[list[ca.SX], list[ca.SX]]:
    """Rotor speed or effective command after saturation, voltage and lag, and its rate."""
    rotors = vehicle.rotors
    if rotors.from_speed and not rotors.speed_rad_s:
        raise ModelError(
            f"Commands cannot drive {vehicle.name}: it is known by rotor speed only. Give "
            f"rotors.speed_from_command in the vehicle file."
        )
    up, down = ca.SX(0), ca.SX(0)
    if rotors.lag_up_s > 0:
        up = m.parameter(
            "lag.up", rotors.lag_up_s, "s", "Rotor time constant, rising", minimum=1e-3
        )
        down = m.parameter(
            "lag.down", rotors.lag_down_s, "s", "Rotor time constant, falling", minimum=1e-3
        )
    motors = blocks.apply(Motors(commands, up, down))
    steady = [ca.fmin(ca.fmax(c, 0.0), 1.0) for c in motors.command]
    if rotors.reference_voltage_v is not None:
        reference = m.parameter(
            "reference_voltage",
            rotors.reference_voltage_v,
            "V",
            "Battery voltage at which the maps of the command hold",
            minimum=1e-3,
        )
        exponent = m.parameter(
            "voltage_exponent",
            rotors.voltage_exponent,
            "1",
            "Power of voltage over reference voltage that multiplies the command",
        )
        scale = ca.fmax(voltage / reference, 0.0) ** exponent
        steady = [c * scale for c in steady]
    if rotors.speed_rad_s:
        speed = _coefficients(
            m, "speed", "rad/s", "Steady rotor speed", rotors.speed_rad_s, "command", "1"
        )
        steady = [ca.fmax(polynomial(speed, c), 0.0) for c in steady]
    asked = any(map(blocks.include, ("motor_lag", "rotor_inertia_torque")))
    if not (rotors.follows or asked):
        return steady, [ca.SX(0)] * rotors.count
    return _lagging(m, rotors, steady, motors)


def _lagging(
    m: ComponentBuilder, rotors: Rotors, steady: list[ca.SX], motors: Motors
) -> tuple[list[ca.SX], list[ca.SX]]:
    """First-order lag per rotor: its output and rate of change.

    Where the model has no lag of its own, a lag L below T = `SHORTEST_LAG_S` is

        level = (1 - L/T) target + (L/T) x,    T dx/dt = target - x,

    with the delay of a lag of L to first order, and equal to the input at L = 0; the rate is that
    of x, a rotor that cannot change its speed instantly.
    """
    state, unit, meaning = (
        ("rotor", "rad/s", "speed of rotor")
        if rotors.from_speed
        else ("effort", "1", "effective command of motor")
    )
    gains = _run_up(m, rotors)
    levels, rates = [], []
    for i, target in enumerate(steady, start=1):
        start = m.parameter(f"initial.{state}_{i}", 0.0, unit, f"Initial {meaning} {i}", fixed=True)
        x = m.state(f"{state}_{i}", unit, meaning.capitalize() + f" {i}", start)
        lag = ca.if_else(target > x, motors.lag_up, motors.lag_down)
        if gains is not None:
            # As a time constant, 1 / gain: a further lag is added to it.
            (a_up, b_up), (a_down, b_down) = gains
            a, b = ca.if_else(target > x, a_up, a_down), ca.if_else(target > x, b_up, b_down)
            gain = a + b * (target + x)
            level, rate = x, gain * (target - x) / (1 + lag * gain)
        elif rotors.lag_up_s > 0:
            level, rate = x, (target - x) / lag
        else:
            share = ca.fmin(lag / SHORTEST_LAG_S, 1.0)
            level = ca.if_else(share < 1, target + share * (x - target), x)
            rate = (target - x) / ca.fmax(lag, SHORTEST_LAG_S)
        m.derivative(f"{state}_{i}", rate)
        levels.append(level)
        rates.append(rate)
    return levels, rates


def _run_up(m: ComponentBuilder, rotors: Rotors) -> list[tuple[ca.SX, ca.SX]] | None:
    """Linear and quadratic coefficient, rising and falling, as parameters."""
    if rotors.run_up is None:
        return None
    return [
        (
            m.parameter(
                f"run_up.linear_{way}",
                r.linear_1_s,
                "1/s",
                f"Acceleration of a {way} rotor per missing speed",
                minimum=0,
            ),
            m.parameter(
                f"run_up.quadratic_{way}",
                r.quadratic_1_rad,
                "1/rad",
                f"Acceleration of a {way} rotor per missing square of the speed",
                minimum=0,
            ),
        )
        for way, r in zip(("rising", "falling"), rotors.run_up, strict=True)
    ]


SLOWEST_SPIN = 0.1
"""Rotor speed relative to hover below which its rate does not follow from the thrust: the map of
the command has no slope there."""


def _spin(
    vehicle: Vehicle, level: list[ca.SX], rate: list[ca.SX]
) -> tuple[list[ca.SX], list[ca.SX]]:
    """Rotor speed relative to hover, and its rate; thrust grows with its square where the map is of
    the command."""
    rotors = vehicle.rotors
    if rotors.from_speed:
        hover = hover_level(vehicle)
        return [x / hover for x in level], [r / hover for r in rate]
    x = ca.SX.sym("x")
    share = _not_negative(polynomial(rotors.thrust_n, x)) / vehicle.hover_thrust_n
    slope = ca.Function("slope", [x], [share, ca.jacobian(share, x)])
    spins, rates = [], []
    for value, change in zip(level, rate, strict=True):
        load, steepness = slope(value)
        # The root has no derivative at zero, with a rotor at rest.
        spin = ca.if_else(load > 0, ca.sqrt(ca.fmax(load, 1e-30)), 0.0)
        spins.append(spin)
        rates.append(steepness * change / (2 * ca.fmax(spin, SLOWEST_SPIN)))
    return spins, rates


def _coefficients(
    m: ComponentBuilder,
    prefix: str,
    unit: str,
    meaning: str,
    values: Sequence[float],
    argument: str,
    argument_unit: str,
) -> list[ca.SX]:
    """Coefficients as parameters; those that are zero are omitted from the equations."""
    return [
        m.parameter(
            f"{prefix}.c{k}",
            value,
            per_power(unit, argument_unit, k),
            f"{meaning} polynomial, coefficient of {argument}^{k}",
        )
        if value
        else ca.SX(0)
        for k, value in enumerate(values)
    ]


def _not_negative(value: ca.SX) -> ca.SX:
    """Zero where a fitted polynomial is negative; compiles to no call, unlike fmax."""
    return ca.if_else(value > 0, value, 0.0)


def per_power(unit: str, argument_unit: str, power: int) -> str:
    """Unit of the coefficient of `argument^power` in a polynomial with the given unit."""
    if power == 0 or argument_unit == "1":
        return unit
    suffix = "" if power == 1 else str(power)
    if unit == "rad/s":
        raise ValueError("a speed is a polynomial of the command only")
    return f"{unit}.s{suffix}/rad{suffix}"
