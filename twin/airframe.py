"""Airframe: rigid body with six degrees of freedom, rotors, drag and ground contact.

    m dv/dt   = m g e_z + R_nb F_b                               (NED)
    J domega/dt = M_b - omega x (J omega) - G_a                  (body FRD)
    dq/dt     = q * [0, omega] / 2

Source: Eq. 5 of the paper the project builds on, "Physics-Aware Multichannel Vector Quantization
for Hybrid Digital Twin Modeling of UAV Systems", with gravity left in NED where it belongs: the
paper rotates it with the matrix that takes body velocity to earth. G_a is the gyroscopic torque
of the spinning rotors.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .component import Component
from .component_builder import ComponentBuilder
from .errors import ModelError
from .frames import cross, quaternion_rate, to_body, to_ned
from .ground import ground_wrench
from .rotors import Drive, RotorExpressions, rotor_equations
from .vehicle import GRAVITY_M_S2, Vehicle

Array = NDArray[np.float64]
AXES = ("x", "y", "z")
_FRD = ("forward", "right", "down")
_NED = ("north", "east", "down")
START_HEIGHT_M = 10.0
"""Height at which the airframe starts, in hover, when no start value says otherwise."""


def airframe(vehicle: Vehicle, drive: Drive | None = None) -> Component:
    """The airframe of a vehicle as a component; its start values are a hover at 10 m.

    Args:
        vehicle: Numbers of the aircraft.
        drive: "command" (inputs `cmd_1..n`) or "rotor_speed" (inputs `rotor_1..n`, rad/s);
            default: what the vehicle file describes.

    Raises:
        ModelError: The vehicle's maps do not allow this drive, or it has no hover trim.
    """
    component = _equations(vehicle, drive or vehicle.drive)
    return component.with_starts(hover_trim(component, vehicle))


def _equations(vehicle: Vehicle, drive: Drive) -> Component:
    m = ComponentBuilder(
        "airframe", f"Six-degree-of-freedom airframe of {vehicle.name}, driven by {drive}"
    )
    rotors = rotor_equations(m, vehicle.rotors, drive)
    wind_n = [
        m.input(f"wind_{a}", "m/s", f"Wind, NED {d}") for a, d in zip(AXES, _NED, strict=True)
    ]
    mass = m.parameter("mass", vehicle.mass_kg, "kg", "Take-off mass", minimum=1e-4)
    inertia = _inertia(m, vehicle.inertia_kg_m2)
    gravity = m.parameter("gravity", GRAVITY_M_S2, "m/s2", "Acceleration of free fall", minimum=0)
    pos_n, vel_n, q_nb, omega_b = _motion_states(m)

    air_b = to_body(q_nb, [v - w for v, w in zip(vel_n, wind_n, strict=True)])
    drag_b = _drag(m, vehicle, air_b)
    thrust_b, thrust_moment_b, spin_momentum = _rotor_wrench(m, vehicle, rotors)
    contact_b, contact_moment_b = ground_wrench(m, vehicle, pos_n, vel_n, q_nb, omega_b)

    specific_force_b = [
        (t + d + c) / mass for t, d, c in zip(thrust_b, drag_b, contact_b, strict=True)
    ]
    acceleration_n = to_ned(q_nb, specific_force_b)
    acceleration_n[2] += gravity

    momentum_b = [
        sum((j * w for j, w in zip(row, omega_b, strict=True)), start=ca.SX(0)) for row in inertia
    ]
    momentum_b[2] += spin_momentum
    moment_b = [
        t + c - g
        for t, c, g in zip(
            thrust_moment_b, contact_moment_b, cross(omega_b, momentum_b), strict=True
        )
    ]
    inverse = _symmetric_inverse(inertia)
    angular_acceleration_b = [
        sum((i * t for i, t in zip(row, moment_b, strict=True)), start=ca.SX(0)) for row in inverse
    ]
    for i, axis in enumerate(AXES):
        m.derivative(f"pos_{axis}", vel_n[i])
        m.derivative(f"vel_{axis}", acceleration_n[i])
        m.derivative(f"omega_{axis}", angular_acceleration_b[i])
    for name, rate in zip("wxyz", quaternion_rate(q_nb, omega_b), strict=True):
        m.derivative(f"q_{name}", rate)

    for i, axis in enumerate(AXES):
        m.output(f"pos_{axis}", "m", f"Position, NED {_NED[i]}", pos_n[i])
    for i, axis in enumerate(AXES):
        m.output(f"vel_{axis}", "m/s", f"Velocity, NED {_NED[i]}", vel_n[i])
    for i, name in enumerate("wxyz"):
        m.output(f"q_{name}", "1", f"Attitude quaternion body to NED, {name}", q_nb[i])
    for i, axis in enumerate(AXES):
        m.output(f"omega_{axis}", "rad/s", f"Body rate about {_FRD[i]}", omega_b[i])
    for i, axis in enumerate(AXES):
        m.output(
            f"specific_force_{axis}",
            "m/s2",
            f"Specific force at the centre of mass, body {_FRD[i]}",
            specific_force_b[i],
        )
    for i, axis in enumerate(AXES):
        m.output(
            f"angular_acceleration_{axis}",
            "rad/s2",
            f"Angular acceleration about {_FRD[i]}",
            angular_acceleration_b[i],
        )
    for i, thrust in enumerate(rotors.thrust_n, start=1):
        m.output(f"thrust_{i}", "N", f"Thrust of rotor {i}", thrust)
    if drive == "command":
        for i, speed in enumerate(rotors.speed_rad_s, start=1):
            m.output(f"rotor_{i}", "rad/s", f"Speed of rotor {i}", speed)
    if vehicle.battery is not None:
        m.output(
            "ibat_a", "A", "Battery current", _current(m, vehicle, rotors.thrust_n, gravity, mass)
        )
    return m.build()


def hover_trim(component: Component, vehicle: Vehicle) -> dict[str, float]:
    """Start values (inputs and initial rotor states) of an unaccelerated level hover.

    Newton's method with the least-norm step on vertical and angular acceleration against the
    rotor inputs, at steady rotors, with the derivatives of the component's own equations.

    Raises:
        ModelError: No command inside 0..1 (no positive speed) hovers.
    """
    names = [n for n in component.input_names if n.startswith(("cmd_", "rotor_"))]
    index = [component.input_names.index(n) for n in names]
    steady = [i for i, s in enumerate(component.states) if s.name.startswith(("rotor_", "effort_"))]
    v = ca.SX.sym("v", len(names))
    r = ca.SX.sym("r", len(steady))
    u = ca.SX(component.input_values())
    u[index] = v
    p = component.parameter_values()
    x = ca.SX(component.initial(component.input_values(), p))
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
    guess = _trim_guess(vehicle, component.input_names)
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
    for i, level in zip(steady, guess[len(names) :].tolist(), strict=True):
        trim[f"initial.{component.states[i].name}"] = level
    return trim


def _trim_guess(vehicle: Vehicle, inputs: Sequence[str]) -> Array:
    """Equal rotors that carry the weight: argument of the thrust map, then its state if any."""
    rotors = vehicle.rotors

    def solve(coefficients: tuple[float, ...], value: float, low: float, high: float) -> float:
        grid = np.linspace(low, high, 2001)
        level = np.polynomial.polynomial.polyval(grid, coefficients)
        return float(grid[int(np.argmax(level >= value))])

    if not rotors.from_speed:
        level = command = solve(rotors.thrust_n, vehicle.hover_thrust_n, 0.0, 1.0)
    else:
        limit = 10.0
        while (
            np.polynomial.polynomial.polyval(limit, rotors.thrust_n) < vehicle.hover_thrust_n
            and limit < 1e6
        ):
            limit *= 2
        level = solve(rotors.thrust_n, vehicle.hover_thrust_n, 0.0, limit)
        command = solve(rotors.speed_rad_s, level, 0.0, 1.0) if rotors.speed_rad_s else level
    first = level if "rotor_1" in inputs else command
    has_state = "rotor_1" not in inputs and rotors.lag_up_s > 0
    return np.array([first] * rotors.count + [level] * (rotors.count if has_state else 0))


def _motion_states(
    m: ComponentBuilder,
) -> tuple[list[ca.SX], list[ca.SX], list[ca.SX], list[ca.SX]]:
    """Position and velocity NED, attitude, body rates, each starting at its `initial.*`."""
    start = {"pos_z": -START_HEIGHT_M, "q_w": 1.0}
    rows = (
        [(f"pos_{a}", "m", f"position, NED {d}") for a, d in zip(AXES, _NED, strict=True)]
        + [(f"vel_{a}", "m/s", f"velocity, NED {d}") for a, d in zip(AXES, _NED, strict=True)]
        + [(f"q_{a}", "1", f"attitude quaternion body to NED, {a}") for a in "wxyz"]
        + [(f"omega_{a}", "rad/s", f"body rate about {d}") for a, d in zip(AXES, _FRD, strict=True)]
    )
    initial = {
        name: m.parameter(
            f"initial.{name}", start.get(name, 0.0), unit, f"Initial {meaning}", fixed=True
        )
        for name, unit, meaning in rows
    }
    q0 = [initial[f"q_{a}"] for a in "wxyz"]
    norm = ca.sqrt(sum((c * c for c in q0), start=ca.SX(0)))
    for a in "wxyz":
        initial[f"q_{a}"] = initial[f"q_{a}"] / norm
    x = {name: m.state(name, unit, meaning, initial[name]) for name, unit, meaning in rows}
    q = [x[f"q_{a}"] for a in "wxyz"]
    length = ca.sqrt(sum((c * c for c in q), start=ca.SX(0)))
    for a, c in zip("wxyz", q, strict=True):
        m.projection(f"q_{a}", c / length)
    return (
        [x[f"pos_{a}"] for a in AXES],
        [x[f"vel_{a}"] for a in AXES],
        q,
        [x[f"omega_{a}"] for a in AXES],
    )


def _inertia(m: ComponentBuilder, J: Array) -> list[list[ca.SX]]:
    element = {
        a + b: m.parameter(
            f"inertia.{a}{b}",
            float(J[i, j]),
            "kg.m2",
            f"Inertia matrix about the centre of mass, element {a}{b}",
            minimum=1e-9 if i == j else None,
        )
        for i, a in enumerate(AXES)
        for j, b in enumerate(AXES)
        if i <= j
    }
    return [[element["".join(sorted(a + b))] for b in AXES] for a in AXES]


def _symmetric_inverse(J: list[list[ca.SX]]) -> list[list[ca.SX]]:
    """Inverse of a symmetric 3x3 matrix by its adjugate."""
    (a, b, c), (_, d, e), (_, _, f) = J
    adjugate = [
        [d * f - e * e, c * e - b * f, b * e - c * d],
        [c * e - b * f, a * f - c * c, b * c - a * e],
        [b * e - c * d, b * c - a * e, a * d - b * b],
    ]
    determinant = a * adjugate[0][0] + b * adjugate[0][1] + c * adjugate[0][2]
    return [[value / determinant for value in row] for row in adjugate]


def _drag(m: ComponentBuilder, vehicle: Vehicle, air_b: Sequence[ca.SX]) -> list[ca.SX]:
    """Linear and quadratic drag along the body axes.

    Source: quadratic, Stevens, Lewis & Johnson, ch. 2; linear (rotor drag lumped into the body),
    Faessler, Franchi & Scaramuzza, RA-L 2018, eq. 7.
    """
    force = []
    for i, (axis, air) in enumerate(zip(AXES, air_b, strict=True)):
        linear = m.parameter(
            f"drag.linear_{axis}",
            float(vehicle.drag_linear_n_s_m[i]),
            "N.s/m",
            f"Linear drag along body {_FRD[i]}",
            minimum=0,
        )
        quadratic = m.parameter(
            f"drag.quadratic_{axis}",
            float(vehicle.drag_quadratic_n_s2_m2[i]),
            "N.s2/m2",
            f"Quadratic drag along body {_FRD[i]}",
            minimum=0,
        )
        force.append(-(linear + quadratic * ca.fabs(air)) * air)
    return force


def _rotor_wrench(
    m: ComponentBuilder, vehicle: Vehicle, rotors: RotorExpressions
) -> tuple[list[ca.SX], list[ca.SX], ca.SX]:
    """Force, moment (body FRD) and spin angular momentum about body z of all rotors."""
    force_z, moment, momentum = ca.SX(0), [ca.SX(0)] * 3, ca.SX(0)
    spin_inertia = (
        m.parameter(
            "spin_inertia",
            vehicle.rotors.spin_inertia_kg_m2,
            "kg.m2",
            "Inertia of one rotor about its axis",
            minimum=0,
        )
        if rotors.speed_rad_s
        else ca.SX(0)
    )
    for i in range(vehicle.rotors.count):
        n = i + 1
        x, y = (
            m.parameter(
                f"rotor_{n}.{a}",
                float(vehicle.rotors.position_m[i, k]),
                "m",
                f"Hub of rotor {n} from the centre of mass, body {_FRD[k]}",
            )
            for k, a in enumerate("xy")
        )
        direction = float(
            vehicle.rotors.direction[i]
        )  # +1 clockwise seen from above: spins about +z
        thrust = rotors.thrust_n[i]
        force_z -= thrust
        moment = [
            moment[0] - y * thrust,
            moment[1] + x * thrust,
            moment[2] - direction * rotors.torque_n_m[i],
        ]
        if rotors.speed_rad_s:
            momentum += direction * spin_inertia * rotors.speed_rad_s[i]
    return [ca.SX(0), ca.SX(0), force_z], moment, momentum


def _current(
    m: ComponentBuilder, vehicle: Vehicle, thrust_n: list[ca.SX], gravity: ca.SX, mass: ca.SX
) -> ca.SX:
    """Battery current: induced power grows with thrust^1.5 (momentum theory, Leishman ch. 2)."""
    assert vehicle.battery is not None
    hover = m.parameter(
        "hover_current", vehicle.battery.hover_current_a, "A", "Battery current in hover", minimum=0
    )
    share = mass * gravity / len(thrust_n)
    loads = [ca.if_else(t > 0, t, 0.0) / share for t in thrust_n]
    # x sqrt(x), not x**1.5: the power function differs in the last bit between platforms.
    load = sum((x * ca.sqrt(x) for x in loads), start=ca.SX(0))
    return hover * load / len(thrust_n)
