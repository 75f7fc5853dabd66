"""Functions shared by the flight controllers: attitude geometry, interface, airframe in hover.

Geometry without angles: vectors, dot products and square roots. Vectors are lists of three CasADi
expressions, NED unless stated otherwise. Inputs are named as the outputs of other components.

`HoverModel` is the airframe linearised about hover, with the thrust maps of its rotors inverted.
The Jacobians are those of the airframe's own equations, so a controller designed on them includes
geometry, drag, lag and active effects.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from ..component import Component, ComponentBuilder
from ..component.portable import angle, cosine, sine
from ..effects import acting_late
from ..errors import ModelError
from ..frames import AXES, FRD, NED, cross, multiply, to_body
from ..physics.airframe import airframe
from ..vehicle import Vehicle

Vector = list[ca.SX]
_TINY = 1e-9  # keeps divisions and roots finite; far below any velocity or angle


def dot(a: Sequence[ca.SX], b: Sequence[ca.SX]) -> ca.SX:
    """Scalar product."""
    return sum((x * y for x, y in zip(a, b, strict=True)), start=ca.SX(0))


def length(v: Sequence[ca.SX]) -> ca.SX:
    """Euclidean length; the small term keeps the slope finite at zero."""
    return ca.sqrt(dot(v, v) + _TINY**3)


def clamp(value: ca.SX, low: ca.SX | float, high: ca.SX | float) -> ca.SX:
    """The value within two bounds."""
    return ca.fmin(ca.fmax(value, low), high)


def shorten(v: Sequence[ca.SX], longest: ca.SX | float) -> Vector:
    """The vector, scaled down to a length where it is longer."""
    scale = ca.fmin(1.0, longest / ca.fmax(length(v), _TINY))
    return [scale * x for x in v]


def desired_axes(up: Sequence[ca.SX], yaw: ca.SX) -> tuple[Vector, Vector]:
    """Body forward and down axes of the attitude with thrust along a vector and a given yaw angle.

    Args:
        up: Direction of thrust, of any length but 0, not below the horizon.
        yaw: Heading of the nose, rad.
    """
    size = length(up)
    down = [-x / size for x in up]
    forward = cross([-sine(yaw), cosine(yaw), ca.SX(0)], down)
    size = length(forward)
    return [x / size for x in forward], down


def attitude_error(
    q_nb: Sequence[ca.SX],
    forward: Sequence[ca.SX],
    down: Sequence[ca.SX],
    yaw_weight: ca.SX | None = None,
) -> Vector:
    """Rotation from an attitude to the desired one, as twice the vector part of its quaternion.

    First the shortest rotation of the thrust axis, then a rotation about that axis. Close to zero
    it is the rotation vector in rad, body axes.

    Args:
        q_nb: Attitude, body to NED.
        forward: Desired body forward, NED.
        down: Desired body down, NED.
        yaw_weight: Share of the rotation about the thrust axis that is included; None: all of it.

    Source: Brescianini, Hehn & D'Andrea, Nonlinear Quadrocopter Attitude Control, ETH 2013,
    sec. 4; Brescianini & D'Andrea, ICRA 2018 (yaw weight).
    """
    x, y, z = to_body(q_nb, down)
    size = ca.sqrt(x * x + y * y + ca.fmax(1 + z, 1e-3) ** 2)
    tilt = [ca.fmax(1 + z, 1e-3) / size, -y / size, x / size, ca.SX(0)]
    cos, sin, _ = to_body(tilt, to_body(q_nb, forward))
    half = ca.sqrt(ca.fmax(1 + cos, _TINY) / 2)
    if yaw_weight is None:
        turn = [half, ca.SX(0), ca.SX(0), sin / (2 * half)]
    else:
        scaled = yaw_weight * angle(half, sin / (2 * half))
        turn = [cosine(scaled), ca.SX(0), ca.SX(0), sine(scaled)]
    return [2 * part for part in multiply(tilt, turn)[1:]]


def thrust_axis(q_nb: Sequence[ca.SX]) -> Vector:
    """Direction of the thrust (body up) in NED."""
    w, x, y, z = q_nb
    return [-2 * (x * z + w * y), -2 * (y * z - w * x), 2 * (x * x + y * y) - 1]


def limit_acceleration(
    wanted: Sequence[ca.SX], gravity: ca.SX, climb: ca.SX, sink: ca.SX, tilt: ca.SX
) -> Vector:
    """Acceleration NED within limits of climb and sink (m/s2) and tilt (rad), height first."""
    z = clamp(wanted[2], -climb, sink)
    x, y = shorten(wanted[:2], (gravity - z) * sine(tilt) / cosine(tilt))
    return [x, y, z]


@dataclass(frozen=True, slots=True)
class Signals:
    """Inputs of a controller, as expressions.

    Attributes:
        pos: Position, NED, m.
        vel: Velocity, NED, m/s.
        q_nb: Attitude, body to NED.
        omega_b: Body rates, FRD, rad/s.
        pos_sp: Position setpoint, NED, m.
        vel_sp: Velocity setpoint, NED, m/s.
        acc_sp: Acceleration setpoint, NED, m/s2.
        yaw_sp: Heading setpoint, rad.
        armed: Whether the motors may turn, a Boolean.
    """

    pos: list[ca.SX]
    vel: list[ca.SX]
    q_nb: list[ca.SX]
    omega_b: list[ca.SX]
    pos_sp: list[ca.SX]
    vel_sp: list[ca.SX]
    acc_sp: list[ca.SX]
    yaw_sp: ca.SX
    armed: ca.SX


def declare_signals(m: ComponentBuilder) -> Signals:
    """Declare the inputs: `pos_*`, `vel_*`, `q_*`, `omega_*`, `setpoint_*` and `armed`."""

    def vector(name: str, unit: str, meaning: str, directions: tuple[str, ...]) -> list[ca.SX]:
        """One input per axis."""
        return [
            m.input(f"{name}_{a}", unit, f"{meaning} {d}")
            for a, d in zip(AXES, directions, strict=True)
        ]

    return Signals(
        pos=vector("pos", "m", "Position, NED", NED),
        vel=vector("vel", "m/s", "Velocity, NED", NED),
        q_nb=[
            m.input(f"q_{a}", "1", f"Attitude quaternion body to NED, {a}", float(a == "w"))
            for a in "wxyz"
        ],
        omega_b=vector("omega", "rad/s", "Body rate about", FRD),
        pos_sp=vector("setpoint_pos", "m", "Position setpoint, NED", NED),
        vel_sp=vector("setpoint_vel", "m/s", "Velocity setpoint, NED", NED),
        acc_sp=vector("setpoint_acc", "m/s2", "Acceleration setpoint, NED", NED),
        yaw_sp=m.input("setpoint_yaw", "rad", "Heading setpoint of the nose, from north to east"),
        armed=m.input("armed", "1", "Whether the motors may turn", kind="boolean", nominal=1.0)
        > 0.5,
    )


def declare_drives(m: ComponentBuilder, drive: str, values: list[ca.SX]) -> None:
    """Declare the outputs `cmd_1..n`, or `rotor_1..n` for a vehicle whose input is rotor speed."""
    for i, value in enumerate(values, start=1):
        if drive == "rotor_speed":
            m.output(f"rotor_{i}", "rad/s", f"Speed of rotor {i}", value)
        else:
            m.output(f"cmd_{i}", "1", f"Command of motor {i}, 0..1", value)


Array = NDArray[np.float64]
FULL_OVER_HOVER = 2.5
"""Largest thrust over hover thrust of a rotor without a known speed limit. Made up."""
FASTEST_RAD_S = 1e5
"""Rotor speed up to which the largest thrust is searched. Made up."""
IDLE_OVER_HOVER = 0.05
"""Smallest thrust in flight over hover thrust: no rotor stops in the air. Made up."""
INVERSE_DEGREE = 9
"""Degree of the polynomial that inverts a thrust map: the smallest odd one with an error below 2 %
of the hover thrust for `thrust_curve` from -0.75 to 2 on the Crazyflie's cubic (7: 5 %)."""
INVERSE_USED, INVERSE_ERROR = 0.3, 0.03
"""Thrust over hover thrust from which an inverse must be accurate, and its largest relative error.
Made up."""

_LEAST_SLOPE = 1e-6  # relative thrust per relative input in hover
_FIT_POINTS = 1001  # over the range of thrust, in a fit and its check
_LEAST_RISE = 1e-6  # of a polynomial's Bernstein coefficients, over the largest input
_LEAST_WEIGHT, _END_WEIGHT = 1e-3, 1e4
"""Weights of the fit where thrust hardly rises, and at full thrust, the end of the range. Made
up."""


@dataclass(frozen=True, slots=True)
class HoverModel:
    """Linear model of an airframe in hover for the design of a controller.

    Attributes:
        thrust_n: Thrust of each rotor, shape (n,).
        effect: Upward acceleration (m/s2), then angular acceleration forward, right, down (rad/s2),
            per newton of the mean rotor's thrust at the same input, in steady state, shape (4, n).
        drag_1_s: Deceleration per speed along forward, right, down, shape (3,).
        air_moment_rad_m_s: Angular acceleration about forward per speed to the right, and about
            right per speed forward: from drag above the centre of mass and flapping. Shape (2,).
        gravity_m_s2: Acceleration per radian of tilt.
        lag_s: Time constant of the thrust; 0 without lag.
    """

    thrust_n: Array
    effect: Array
    drag_1_s: Array
    air_moment_rad_m_s: Array
    gravity_m_s2: float
    lag_s: float


def drives(component: Component) -> list[str]:
    """Names of the rotor inputs of an airframe."""
    return [n for n in component.input_names if n.startswith(("cmd_", "rotor_"))]


def punctual(vehicle: Vehicle) -> Vehicle:
    """The vehicle without delay of the motor commands.

    Commands do not enter the equations of motion of an airframe with a delay: they arrive at sample
    instants.
    """
    late = {e.name for e in acting_late()}
    others = {k: v for k, v in vehicle.effects.items() if k not in late}
    return vehicle.with_effects(others)


def linearise(vehicle: Vehicle) -> HoverModel:
    """Hover model of a vehicle, at its airframe's initial trim, without delays.

    Raises:
        ModelError: The thrust of a rotor does not rise with its input in hover, or the rotors
            cannot give moments about all three axes.
    """
    body = airframe(punctual(vehicle))
    u0, p0 = body.input_values(), body.parameter_values({"ground.enabled": 0.0})
    x0 = np.asarray(body.initial(u0, p0), dtype=np.float64).ravel()
    rate = dict(zip((s.name for s in body.states), range(len(x0)), strict=True))
    output = {n: i for i, n in enumerate(body.output_names)}
    a, b, c, d = _jacobians(body, x0, u0, p0)
    driven = [body.input_names.index(n) for n in drives(body)]
    level = _levels(body)
    thrust = [output[f"thrust_{i}"] for i in range(1, len(driven) + 1)]
    rows = [rate["vel_z"]] + [rate[f"omega_{axis}"] for axis in AXES]
    slope, effect = np.diag(d[np.ix_(thrust, driven)]), b[np.ix_(rows, driven)]
    lag_s = 0.0
    if level:
        rest_s = -1.0 / np.diag(a[np.ix_(level, level)])
        settled = rest_s * np.diag(b[np.ix_(level, driven)])  # level per command
        later = np.diag(c[np.ix_(thrust, level)]) * settled
        slope, effect = slope + later, effect + a[np.ix_(rows, level)] * settled
    y0 = np.asarray(body.outputs(x0, u0, p0), dtype=np.float64).ravel()
    relative = slope * u0[driven] / y0[thrust]
    if not relative.min() > _LEAST_SLOPE:
        stated = ", ".join(
            f"effects.{e}.{name} = {value:g}"
            for e, own in vehicle.effects.items()
            for name, value in own.items()
        )
        raise ModelError(
            f"{vehicle.name}: in hover 1 % more input of a rotor changes its thrust by "
            f"{round(relative.min(), 3) + 0.0:g} %, so no controller holds its height; correct its "
            f"thrust map or its effects ({stated or 'it has none'})."
        )
    if level:
        lag_s = float(np.mean(later / slope * rest_s))
    alike = _steady_thrust_n(body, vehicle, u0[driven].mean(keepdims=True))[0]
    effect = effect * alike / alike.mean() / slope * np.array([[-1.0], [1.0], [1.0], [1.0]])
    largest = np.maximum(np.abs(effect).max(axis=1, keepdims=True), 1e-12)
    if np.linalg.matrix_rank(effect / largest) < 4:
        raise ModelError(
            f"{vehicle.name}: the rotors cannot lift and turn it about all axes; "
            f"check rotor positions and directions."
        )
    speed = [rate[f"vel_{axis}"] for axis in AXES]
    return HoverModel(
        thrust_n=y0[thrust],
        effect=effect,
        drag_1_s=-np.diag(a[np.ix_(speed, speed)]),
        air_moment_rad_m_s=a[[rate["omega_x"], rate["omega_y"]], [rate["vel_y"], rate["vel_x"]]],
        gravity_m_s2=float(0.5 * a[rate["vel_y"], rate["q_x"]]),  # q_x is half the angle
        lag_s=lag_s,
    )


def _levels(body: Component) -> list[int]:
    """Indices of the rotors' states, where they follow their input with a lag."""
    names = [s.name for s in body.states]
    return [i for i, n in enumerate(names) if n.startswith(("rotor_", "effort_"))]


def _jacobians(body: Component, x0: Array, u0: Array, p0: Array) -> list[Array]:
    """Matrices A, B, C, D of the linearisation about a state."""
    x, u = ca.SX.sym("x", len(x0)), ca.SX.sym("u", len(u0))
    dx, y = body.derivatives(x, u, p0), body.outputs(x, u, p0)
    slopes = [ca.jacobian(f, v) for f in (dx, y) for v in (x, u)]
    values = ca.Function("slopes", [x, u], slopes)(x0, u0)
    return [np.asarray(v, dtype=np.float64) for v in values]


@dataclass(frozen=True, slots=True)
class ThrustInverse:
    """Rotor input as a polynomial of sqrt(thrust / full), and its range of validity.

    Monotonically increasing. Exact for thrust that is linear in the command or quadratic in the
    speed, else a fit (of the Crazyflie's cubic to 0.3 % of the hover thrust).

    Attributes:
        coefficients: Ascending coefficients, shape (INVERSE_DEGREE + 1,); command 0..1 or rad/s.
        idle_n: Smallest thrust.
        hover_n: Thrust in hover.
        full_n: Largest thrust.
    """

    coefficients: Array
    idle_n: float
    hover_n: float
    full_n: float

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest rotor input."""
        low, high = self.input([self.idle_n, self.full_n])
        return float(low), float(high)

    def input(self, thrust_n: Sequence[float] | Array) -> Array:
        """Rotor inputs for thrusts, N, of any shape."""
        root = np.sqrt(np.asarray(thrust_n, dtype=np.float64) / self.full_n)
        return np.asarray(polynomial.polyval(root, self.coefficients), dtype=np.float64)


def thrust_inverse(vehicle: Vehicle) -> ThrustInverse:
    """Inverse of the steady thrust of a vehicle's mean rotor, effects included.

    Where thrust does not increase everywhere with the input, the increasing part up to the largest
    thrust.

    Raises:
        ModelError: The vehicle has no hover trim, or no polynomial inverts its thrust map.
    """
    body = airframe(punctual(vehicle))
    u0, p0 = body.input_values(), body.parameter_values()
    x0 = np.asarray(body.initial(u0, p0), dtype=np.float64).ravel()
    hover_n = float(_thrust_n(body, x0[None], u0[None]).mean())
    limit = 1.0
    while vehicle.drive == "rotor_speed" and limit < FASTEST_RAD_S:
        if _steady_thrust_n(body, vehicle, np.array([limit])).mean() >= FULL_OVER_HOVER * hover_n:
            break
        limit *= 1.01
    driven = np.linspace(0.0, limit, 2001)
    thrust = _steady_thrust_n(body, vehicle, driven).mean(axis=1)
    driven, thrust = _rising(driven, thrust)
    idle_n, full_n = max(IDLE_OVER_HOVER * hover_n, float(thrust[0])), float(thrust[-1])
    if idle_n >= min(hover_n, full_n):
        raise ModelError(
            f"{vehicle.name}: where its thrust rises with the input it gives {idle_n:.3g} to "
            f"{full_n:.3g} N a rotor, hover takes {hover_n:.3g} N; check its thrust map."
        )
    used = slice(max(int(np.searchsorted(thrust, idle_n)) - 1, 0), None)
    driven, thrust = driven[used], thrust[used]
    coefficients = _monotone_fit(driven, np.sqrt(np.maximum(thrust, 0) / full_n), idle_n / full_n)
    inverse = ThrustInverse(coefficients, idle_n, hover_n, full_n)
    used_n = np.linspace(min(INVERSE_USED * hover_n, full_n), full_n, _FIT_POINTS)
    off_n = np.abs(np.interp(inverse.input(used_n), driven, thrust) - used_n).max()
    if off_n > INVERSE_ERROR * hover_n:
        raise ModelError(
            f"{vehicle.name}: its thrust map is inverted only to {off_n / hover_n:.1%} of the "
            f"hover thrust, {INVERSE_ERROR:.0%} is needed; check its thrust map and effects."
        )
    return inverse


def _rising(driven: Array, thrust: Array) -> tuple[Array, Array]:
    """The increasing part of a map, without gaps, up to the largest thrust."""
    last = int(np.argmax(thrust)) + 1
    breaks = np.flatnonzero(np.diff(thrust[:last]) <= 0.0)
    part = slice(int(breaks[-1]) + 1 if len(breaks) else 0, last)
    return driven[part], thrust[part]


def _monotone_fit(driven: Array, root: Array, idle: float) -> Array:
    """Coefficients of an increasing polynomial of sqrt(thrust / full), of least thrust error.

    A polynomial increases where its Bernstein coefficients do, which bounded least squares ensures.

    Args:
        driven: Inputs, ascending.
        root: Values of sqrt(thrust / full) at the inputs, ascending to 1.
        idle: Smallest thrust over full.

    Source: Farouki, The Bernstein polynomial basis: a centennial retrospective, Computer Aided
    Geometric Design 29 (2012), sec. 5.
    """
    at = np.linspace(np.sqrt(idle), 1.0, _FIT_POINTS)
    wanted = scipy.interpolate.PchipInterpolator(root, driven)(at)
    order = np.arange(INVERSE_DEGREE + 1)
    basis = scipy.stats.binom.pmf(order, INVERSE_DEGREE, ((at - at[0]) / (1.0 - at[0]))[:, None])
    rises = basis @ np.tril(np.ones((len(order), len(order))))
    weight = np.interp(wanted, driven, np.gradient(root**2, driven / driven[-1]))
    weight = np.maximum(weight, _LEAST_WEIGHT)
    weight[-1] = _END_WEIGHT
    least = np.where(order == 0, -np.inf, _LEAST_RISE * driven[-1])
    found = scipy.optimize.lsq_linear(
        rises * weight[:, None], wanted * weight, (least, np.inf), method="bvls"
    )
    return np.asarray(polynomial.polyfit(at, rises @ found.x, INVERSE_DEGREE), dtype=np.float64)


def _steady_thrust_n(body: Component, vehicle: Vehicle, driven: Array) -> Array:
    """Thrust of each rotor of a hovering airframe, N, all at the same input, shape (n, n_rotors).

    Args:
        body: The airframe.
        vehicle: Vehicle of the airframe.
        driven: Inputs, shape (n,).
    """
    u0, p0 = body.input_values(), body.parameter_values()
    x0 = np.asarray(body.initial(u0, p0), dtype=np.float64).ravel()
    level = driven
    if vehicle.drive == "command" and vehicle.rotors.speed_rad_s:
        level = np.maximum(polynomial.polyval(driven, vehicle.rotors.speed_rad_s), 0.0)
    x, u = np.tile(x0, (len(driven), 1)), np.tile(u0, (len(driven), 1))
    x[:, _levels(body)] = level[:, None]
    u[:, [body.input_names.index(n) for n in drives(body)]] = driven[:, None]
    return _thrust_n(body, x, u)


def _thrust_n(body: Component, states: Array, inputs: Array) -> Array:
    """Thrust of each rotor of an airframe in the air, N, shape (n, n_rotors)."""
    thrust = [i for i, n in enumerate(body.output_names) if n.startswith("thrust_")]
    rows = body.outputs_along(states, inputs, {"ground.enabled": 0.0})
    return np.asarray(rows[:, thrust])
