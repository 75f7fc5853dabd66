"""Airframe: rigid body with six degrees of freedom, rotors, drag and ground contact.

    m dv/dt   = m g e_z + R_nb F_b                               (NED)
    J domega/dt = M_b - omega x (J omega) - G_a                  (body FRD)
    dq/dt     = q * [0, omega] / 2

Source: Eq. 5 of the paper the project builds on, "Physics-Aware Multichannel Vector Quantization
for Hybrid Digital Twin Modeling of UAV Systems", with gravity in NED, where it belongs: the paper
rotates it with the matrix from body velocity to earth. G_a is the gyroscopic torque of the spinning
rotors.

Also: the trim of an airframe in hover.
"""

from collections.abc import Iterable, Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component, ComponentBuilder, built_once
from ..effects import Blocks, Effect, Period, effects_of
from ..effects.stages import AIR_DENSITY_KG_M3, Air, Body, Motion, Thrust, Wrench
from ..errors import ModelError
from ..frames import AXES, FRD, NED, cross, to_body
from ..vehicle import Vehicle
from ..vehicle.vehicle import first_reaching, hover_level
from .observer import followed, never_followed, shown
from .rigid_body import (
    OUTSIDE,
    angular_acceleration,
    ground_contact,
    inertia_matrix,
    motion_states,
    move,
)
from .rotors import Drive, hub_loads, rotor_equations, rotor_inputs

RESTART_PERIOD_S = 1e-3
"""Period of possible restarts, s: the communication step of the co-simulation."""
RESTARTS = Period(RESTART_PERIOD_S, "Time between two instants at which it can be set anew")
"""Parameter of the airframe for that period."""
Array = NDArray[np.float64]


def hover_trim(component: Component, vehicle: Vehicle) -> dict[str, float]:
    """Start values (inputs and initial rotor states) of an unaccelerated level hover.

    Newton's method with the least-norm step on vertical and angular acceleration over the rotor
    inputs, at steady rotors, with the derivatives of the component's own equations.

    Raises:
        ModelError: No command in 0..1 (no positive speed) gives a hover.
    """
    names = [n for n in component.input_names if n.startswith(("cmd_", "rotor_"))]
    index = [component.input_names.index(n) for n in names]
    steady = [i for i, s in enumerate(component.states) if s.name.startswith(("rotor_", "effort_"))]
    v = ca.SX.sym("v", len(names))
    r = ca.SX.sym("r", len(steady))
    u = ca.SX(component.input_values())
    u[index] = v
    p = component.parameter_values()
    x = component.initial(u, p)
    if steady:
        x[steady] = r
    rates = component.derivatives(x, u, p)
    wanted = [
        i
        for i, s in enumerate(component.states)
        if s.name in ("vel_z", "omega_x", "omega_y", "omega_z")
    ]
    residual = ca.vertcat(rates[wanted], rates[steady])
    unknown = ca.vertcat(v, r)
    newton = ca.Function("newton", [unknown], [residual, ca.jacobian(residual, unknown)])
    guess = _trim_guess(vehicle, component.input_names, len(steady))
    for _ in range(50):
        value, slope = (np.asarray(a, dtype=np.float64) for a in newton(guess))
        step = np.linalg.pinv(slope) @ value.ravel()
        guess = guess - step
        if np.max(np.abs(step)) < 1e-15 * max(1.0, float(np.max(np.abs(guess)))):
            break
    value = np.asarray(newton(guess)[0], dtype=np.float64)
    commands = guess[: len(names)]
    too_high = component.input_names[index[0]].startswith("cmd_") and commands.max() > 1
    if (
        not np.all(np.isfinite(guess))
        or np.max(np.abs(value)) > 1e-6
        or commands.min() < 0
        or too_high
    ):
        raise ModelError(
            f"{vehicle.name}: no hover trim: rotor inputs {np.round(commands, 4).tolist()} leave "
            f"an acceleration of {np.max(np.abs(value)):.3g}. Check mass, thrust map, rotor "
            f"positions and directions."
        )
    trim = dict(zip(names, commands.tolist(), strict=True))
    starts = [f"initial.{component.states[i].name}" for i in steady]
    return trim | dict(zip(starts, guess[len(names) :].tolist(), strict=True))


def _trim_guess(vehicle: Vehicle, inputs: Sequence[str], n_steady: int) -> Array:
    """Initial guess: equal rotors that carry the weight, argument of the thrust map, then its state
    if any."""
    rotors = vehicle.rotors
    level = hover_level(vehicle)
    command = level
    if rotors.from_speed and rotors.speed_rad_s:
        command = first_reaching(rotors.speed_rad_s, level, 1.0)
    first = level if "rotor_1" in inputs else command
    return np.array([first] * rotors.count + [level] * n_steady)


REPORTED = "drive."
"""Prefix of an output that repeats an input of the airframe for other components."""


def airframe(
    vehicle: Vehicle,
    drive: Drive | None = None,
    effects: Iterable[str] = (),
    restart: bool = False,
    voltage: bool = False,
    trimmed: bool = True,
) -> Component:
    """The airframe of a vehicle as a component; its start values are a hover at 10 m.

    Inputs `force_*` and `moment_*` are external loads; zero unless connected.

    Args:
        vehicle: Numbers of the aircraft, and the effects that are switched on.
        drive: "command" (inputs `cmd_1..n`) or "rotor_speed" (inputs `rotor_1..n`, rad/s); default:
            the input that the vehicle file describes.
        effects: Effects to build in, switched off, as blocks of parameters: identifiers of
            `twin.effects.EFFECTS`; those of other components are ignored. The effects of the
            vehicle are always built in, and on.
        restart: Whether its state can be set during a simulation: inputs `restart` and
            `restart.pos_x` to `restart.omega_z`. At the end of every `RESTART_PERIOD_S` in which
            `restart` is true its motion is set to the given one; rotors and memories continue. Its
            rotor inputs are repeated as outputs `drive.cmd_1` and so on, since no part of a twin
            computes them.
        voltage: Whether the battery voltage is an input although nothing in the airframe depends on
            it, for another component that reads its output `voltage`.
        trimmed: Whether it starts in that hover; else the start is not defined, and it need not be
            able to hover, as an aircraft with a stopped rotor.

    Raises:
        ModelError: The vehicle's maps do not allow this input, or it has no hover trim.
    """
    wanted = {*effects, *vehicle.effects}
    chosen = [e for e in effects_of("airframe") if e.name in wanted]
    return built_once(
        _built, chosen, vehicle, drive or vehicle.drive, bool(restart), bool(voltage), trimmed
    )


def _built(
    effects: Sequence[Effect],
    vehicle: Vehicle,
    drive: Drive,
    restart: bool,
    voltage: bool,
    trimmed: bool,
) -> Component:
    component = _equations(vehicle, drive, effects, restart, voltage)
    return component.with_starts(hover_trim(component, vehicle)) if trimmed else component


def _equations(
    vehicle: Vehicle, drive: Drive, effects: Sequence[Effect], restart: bool, voltage: bool
) -> Component:
    m = ComponentBuilder(
        "airframe", f"Six-degree-of-freedom airframe of {vehicle.name}, driven by {drive}"
    )
    blocks = Blocks(m, vehicle, effects)
    inputs = rotor_inputs(m, vehicle, drive)
    periods = sorted((e.period for e in effects if e.period), key=lambda p: p.seconds)
    if restart:
        periods.insert(0, RESTARTS)
    period = m.sampled(periods[0].seconds, periods[0].description) if periods else ca.SX(0)
    z_ground = m.parameter("ground.z", 0.0, "m", "Ground plane, NED down")
    voltage |= drive == "command" and vehicle.rotors.reference_voltage_v is not None
    motion = _motion(m, vehicle, blocks, z_ground, voltage or blocks.include("battery_sag"))
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    sizes = {"N": weight, "N.m": weight * vehicle.arm_m}
    outside = [m.input(*row, nominal=sizes[row[1]] or None) for row in OUTSIDE]
    learned = followed(m, motion, period, outside) if restart else never_followed(outside)
    rotors = blocks.apply(rotor_equations(m, vehicle, drive, inputs, motion, blocks))
    wrench = blocks.apply(_wrench(m, vehicle, rotors))
    contact = ground_contact(
        m, vehicle, z_ground, motion.pos_n, motion.vel_n, motion.q_nb, motion.omega_b
    )
    switches = [contact.enabled, *blocks.switches]
    m.idle_while(ca.logic_and(blocks.off(), contact.out_of_reach), contact.step, switches)
    blocks.idle()
    if not restart:
        m.rests_while(sum(blocks.sampled, start=ca.SX(0)) == 0)

    force_b, moment_b = (
        [sum(terms, start=ca.SX(0)) for terms in zip(*parts, strict=True)]
        for parts in (
            (wrench.force, contact.force, learned.outside[:3], learned.force_b),
            (wrench.moment, contact.moment, learned.outside[3:], learned.moment_b),
        )
    )
    specific_force_b = [f / motion.body.mass for f in force_b]
    angular_acceleration_b = angular_acceleration(motion, moment_b)
    move(m, motion, specific_force_b, angular_acceleration_b, learned.gravity_b)
    for i, thrust in enumerate(rotors.thrust, start=1):
        m.output(f"thrust_{i}", "N", f"Thrust of rotor {i}", thrust)
    for i, spin in enumerate(rotors.spin, start=1):
        m.output(f"spin_{i}", "1", f"Speed of rotor {i} over that in hover", spin)
    if drive == "command" and vehicle.rotors.from_speed:
        for i, spin in enumerate(rotors.spin, start=1):
            speed = spin * hover_level(vehicle)
            m.output(f"rotor_{i}", "rad/s", f"Speed of rotor {i}", speed)
    m.output("voltage", "V", "Battery voltage at the motors", motion.voltage)
    if restart:
        for i, given in enumerate(inputs, start=1):
            name, unit = (f"cmd_{i}", "1") if drive == "command" else (f"rotor_{i}", "rad/s")
            m.output(f"{REPORTED}{name}", unit, f"What drives rotor {i}, as it is given", given)
        shown(m, learned)
    if vehicle.battery is not None:
        m.output("ibat_a", "A", "Battery current", _current(m, vehicle, rotors))
    return m.build()


def _motion(
    m: ComponentBuilder, vehicle: Vehicle, blocks: Blocks, z_ground: ca.SX, measured: bool
) -> Motion:
    """Declare the states of the rigid body and its environment.

    Args:
        m: Builder of the airframe.
        vehicle: Numbers of the vehicle.
        blocks: Effects of the airframe.
        z_ground: Height of the ground, NED down.
        measured: Whether the battery voltage is an input; else it is the nominal one of the
            vehicle.
    """
    wind_n = [
        m.input(f"wind_{a}", "m/s", f"Velocity of the air, NED {d}")
        for a, d in zip(AXES, NED, strict=True)
    ]
    density = m.input("density", "kg/m3", "Air density", AIR_DENSITY_KG_M3)
    voltage = ca.SX(vehicle.voltage_v)
    if measured:
        voltage = m.input("vbat_v", "V", "Battery voltage", vehicle.voltage_v)
    mass = m.parameter("mass", vehicle.mass_kg, "kg", "Take-off mass", minimum=1e-4)
    gravity = m.parameter(
        "gravity", vehicle.gravity_m_s2, "m/s2", "Acceleration of free fall", minimum=0
    )
    body = _body(m, vehicle, blocks, mass)
    air = blocks.apply(Air(wind_n))
    initial, pos_n, vel_n, q_nb, omega_b = motion_states(m)
    reference = m.parameter(
        "reference_density",
        AIR_DENSITY_KG_M3,
        "kg/m3",
        "Air density at which the numbers of rotors and drag hold",
        minimum=1e-3,
    )
    return Motion(
        body=body,
        pos_n=pos_n,
        vel_n=vel_n,
        q_nb=q_nb,
        omega_b=omega_b,
        air_b=to_body(q_nb, [v - w for v, w in zip(vel_n, air.wind_n, strict=True)]),
        height=z_ground - pos_n[2],
        density=density / reference,
        gravity=gravity,
        voltage=voltage,
        start_vel_n=[initial[f"vel_{a}"] for a in AXES],
    )


def _body(m: ComponentBuilder, vehicle: Vehicle, blocks: Blocks, mass: ca.SX) -> Body:
    """Mass properties with the effects on them."""
    inertia, hubs = inertia_matrix(m, vehicle.inertia_kg_m2), _hubs(m, vehicle)
    return blocks.apply(Body(mass, inertia, hubs, [ca.SX(0)] * 3))


def frame_origin(vehicle: Vehicle) -> Array:
    """Origin of the frame: centre of mass by the vehicle file, from that with the vehicle's
    effects, body FRD, m, shape (3,). Parts attached to the frame remain there."""
    m = ComponentBuilder("frame", f"Frame of {vehicle.name}")
    blocks = Blocks(m, vehicle, [e for e in effects_of("airframe") if e.name in vehicle.effects])
    body = _body(m, vehicle, blocks, ca.SX(vehicle.mass_kg))
    for axis, place, d in zip(AXES, body.origin, FRD, strict=True):
        m.output(f"origin_{axis}", "m", f"Centre of mass of the vehicle file, {d}", place)
    return np.asarray(m.build().outputs_along(np.zeros((1, 0)), np.zeros((1, 0)))[0])


def _drag(m: ComponentBuilder, vehicle: Vehicle, motion: Motion) -> list[ca.SX]:
    """Linear and quadratic drag along the body axes.

    Source: quadratic, Stevens, Lewis & Johnson, ch. 2; linear (rotor drag lumped into the body),
    Faessler, Franchi & Scaramuzza, RA-L 2018, eq. 7; by the total speed, as in one flow round the
    body, with a coefficient per axis, Folk, Paulos & Kumar, RotorPy, arXiv 2306.04485.
    """
    force = []
    for i, (axis, air) in enumerate(zip(AXES, motion.air_b, strict=True)):
        linear = m.parameter(
            f"drag.linear_{axis}",
            float(vehicle.drag_linear_n_s_m[i]),
            "N.s/m",
            f"Linear drag along body {FRD[i]}",
            minimum=0,
        )
        quadratic = m.parameter(
            f"drag.quadratic_{axis}",
            float(vehicle.drag_quadratic_n_s2_m2[i]),
            "N.s2/m2",
            f"Quadratic drag along body {FRD[i]}",
            minimum=0,
        )
        force.append(-motion.density * (linear + quadratic * ca.fabs(air)) * air)
    if not np.any(vehicle.drag_parasitic_n_s2_m2):
        return force
    c = _per_axis(
        m,
        "drag.parasitic",
        vehicle.drag_parasitic_n_s2_m2,
        "N.s2/m2",
        "Drag by the square of the whole speed, along body",
    )
    # Bounded below: the root has no derivative at rest.
    speed = ca.sqrt(ca.fmax(sum((v * v for v in motion.air_b), start=ca.SX(0)), 1e-30))
    return [
        f - motion.density * k * speed * v for f, k, v in zip(force, c, motion.air_b, strict=True)
    ]


def _damping(m: ComponentBuilder, vehicle: Vehicle, motion: Motion) -> list[ca.SX]:
    """Aerodynamic moment on a rotating body, by the square of each body rate."""
    if not np.any(vehicle.drag_angular_n_m_s2):
        return [ca.SX(0)] * 3
    c = _per_axis(
        m,
        "drag.angular",
        vehicle.drag_angular_n_m_s2,
        "N.m.s2/rad2",
        "Moment of the air by the square of the rate about body",
    )
    return [-motion.density * k * ca.fabs(w) * w for k, w in zip(c, motion.omega_b, strict=True)]


def _per_axis(
    m: ComponentBuilder, name: str, values: Array, unit: str, meaning: str
) -> list[ca.SX]:
    """Three non-negative numbers as parameters, one per body axis."""
    return [
        m.parameter(f"{name}_{a}", v, unit, f"{meaning} {d}", minimum=0)
        for a, d, v in zip(AXES, FRD, values.tolist(), strict=True)
    ]


def _hubs(m: ComponentBuilder, vehicle: Vehicle) -> list[list[ca.SX]]:
    """Positions of the rotor hubs from the centre of mass, one [x, y, z] per rotor."""
    return [
        [
            m.parameter(
                f"rotor_{n}.{a}", hub[k], "m", f"Hub of rotor {n} from the centre of mass, {d}"
            )
            for k, (a, d) in enumerate(zip(AXES, FRD, strict=True))
        ]
        for n, hub in enumerate(vehicle.rotors.position_m.tolist(), start=1)
    ]


def _wrench(m: ComponentBuilder, vehicle: Vehicle, rotors: Thrust) -> Wrench:
    """Sum of body drag and of thrust, torques and aerodynamic loads of the rotors."""
    motion = rotors.motion
    force = _drag(m, vehicle, motion)
    moment = _damping(m, vehicle, motion)
    for hub, direction, thrust, torque in zip(
        motion.body.hubs, rotors.direction, rotors.thrust, rotors.torque, strict=True
    ):
        force[2] -= thrust
        # +1 clockwise seen from above spins about +z; the reaction acts on the body.
        moment = [
            moment[0] - hub[1] * thrust,
            moment[1] + hub[0] * thrust,
            moment[2] - direction * torque,
        ]
    if vehicle.rotors.from_speed:
        inertia = m.parameter(
            "spin_inertia",
            vehicle.rotors.spin_inertia_kg_m2,
            "kg.m2",
            "Inertia of one rotor about its axis",
            minimum=0,
        )
        spin = sum((d * s for d, s in zip(rotors.direction, rotors.spin, strict=True)), ca.SX(0))
        momentum = [ca.SX(0), ca.SX(0), inertia * hover_level(vehicle) * spin]
        gyroscopic = cross(motion.omega_b, momentum)
        moment = [a - b for a, b in zip(moment, gyroscopic, strict=True)]
    for push, twist in hub_loads(m, vehicle, rotors):
        force = [a + b for a, b in zip(force, push, strict=True)]
        moment = [a + b for a, b in zip(moment, twist, strict=True)]
    return Wrench(rotors, force, moment)


def _current(m: ComponentBuilder, vehicle: Vehicle, rotors: Thrust) -> ca.SX:
    """Battery current: induced power grows with thrust^1.5 (momentum theory, Leishman ch. 2)."""
    assert vehicle.battery is not None
    hover = m.parameter(
        "hover_current", vehicle.battery.hover_current_a, "A", "Battery current in hover", minimum=0
    )
    motion = rotors.motion
    share = motion.body.mass * motion.gravity / len(rotors.thrust)
    loads = [ca.if_else(t > 0, t, 0.0) / share for t in rotors.thrust]
    # x sqrt(x), not x**1.5: the power function differs in the last bit between platforms. Bounded
    # below: the root has no derivative at zero, with a rotor at rest.
    load = sum((x * ca.sqrt(ca.fmax(x, 1e-30)) for x in loads), start=ca.SX(0))
    return hover * load / len(loads)
