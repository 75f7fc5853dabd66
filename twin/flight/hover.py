"""The airframe linearised about hover, and the thrust maps of its rotors turned round.

The Jacobians are those of the airframe's own equations, so a controller designed on them follows
whatever the equations say: geometry, drag, lag, effects that are switched on.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from ..component import Component
from ..effects import acting_late
from ..errors import ModelError
from ..frames import AXES
from ..physics.airframe import airframe
from ..vehicle import Vehicle

Array = NDArray[np.float64]
FULL_OVER_HOVER = 2.5
"""Largest thrust over hover thrust of a rotor whose speed has no known limit. Made up."""
IDLE_OVER_HOVER = 0.05
"""Smallest thrust in flight over hover thrust: no rotor stops in the air. Made up."""
INVERSE_DEGREE = 5


@dataclass(frozen=True, slots=True)
class Hover:
    """What a controller needs to know of an airframe in hover.

    Attributes:
        thrust_n: Thrust of each rotor, shape (n,).
        effect: Upward acceleration (m/s2), then angular acceleration forward, right, down
            (rad/s2), per newton of each rotor, rotors settled, shape (4, n).
        drag_1_s: Deceleration per speed along forward, right, down, shape (3,).
        gravity_m_s2: Acceleration per radian of tilt.
        lag_s: Time constant of the thrust; 0 without lag.
    """

    thrust_n: Array
    effect: Array
    drag_1_s: Array
    gravity_m_s2: float
    lag_s: float


def drives(component: Component) -> list[str]:
    """Names of the inputs that drive the rotors of an airframe."""
    return [n for n in component.input_names if n.startswith(("cmd_", "rotor_"))]


def punctual(vehicle: Vehicle) -> Vehicle:
    """The vehicle with motors that get their commands at once.

    The equations of motion of an airframe with a delay never see a command: it arrives at sample
    instants.
    """
    late = {e.name for e in acting_late()}
    others = {k: v for k, v in vehicle.effects.items() if k not in late}
    return vehicle.with_effects(others)


def linearise(vehicle: Vehicle) -> Hover:
    """Hover model of a vehicle, at the trim its airframe starts in, delays left out.

    Raises:
        ModelError: Its rotors cannot turn it about all three axes.
    """
    body = airframe(punctual(vehicle))
    u0, p0 = body.input_values(), body.parameter_values({"ground.enabled": 0.0})
    x0 = np.asarray(body.initial(u0, p0), dtype=np.float64).ravel()
    rate = dict(zip((s.name for s in body.states), range(len(x0)), strict=True))
    output = {n: i for i, n in enumerate(body.output_names)}
    a, b, c, d = _jacobians(body, x0, u0, p0)
    driven = [body.input_names.index(n) for n in drives(body)]
    level = [i for n, i in rate.items() if n.startswith(("rotor_", "effort_"))]
    thrust = [output[f"thrust_{i}"] for i in range(1, len(driven) + 1)]
    rows = [rate["vel_z"]] + [rate[f"omega_{axis}"] for axis in AXES]
    slope, effect = np.diag(d[np.ix_(thrust, driven)]), b[np.ix_(rows, driven)]
    lag_s = 0.0
    if level:
        rest_s = -1.0 / np.diag(a[np.ix_(level, level)])
        settled = rest_s * np.diag(b[np.ix_(level, driven)])  # level per command
        later = np.diag(c[np.ix_(thrust, level)]) * settled
        slope, effect = slope + later, effect + a[np.ix_(rows, level)] * settled
        lag_s = float(np.mean(later / slope * rest_s))
    effect = effect / slope * np.array([[-1.0], [1.0], [1.0], [1.0]])
    largest = np.maximum(np.abs(effect).max(axis=1, keepdims=True), 1e-12)
    if np.linalg.matrix_rank(effect / largest) < 4:
        raise ModelError(
            f"{vehicle.name}: the rotors cannot lift and turn it about all axes; "
            f"check rotor positions and directions."
        )
    speed = [rate[f"vel_{axis}"] for axis in AXES]
    y0 = np.asarray(body.outputs(x0, u0, p0), dtype=np.float64).ravel()
    return Hover(
        thrust_n=y0[thrust],
        effect=effect,
        drag_1_s=-np.diag(a[np.ix_(speed, speed)]),
        gravity_m_s2=float(0.5 * a[rate["vel_y"], rate["q_x"]]),  # q_x is half the angle
        lag_s=lag_s,
    )


def _jacobians(body: Component, x0: Array, u0: Array, p0: Array) -> list[Array]:
    """A, B, C, D about a state."""
    x, u = ca.SX.sym("x", len(x0)), ca.SX.sym("u", len(u0))
    dx, y = body.derivatives(x, u, p0), body.outputs(x, u, p0)
    slopes = [ca.jacobian(f, v) for f in (dx, y) for v in (x, u)]
    values = ca.Function("slopes", [x, u], slopes)(x0, u0)
    return [np.asarray(v, dtype=np.float64) for v in values]


@dataclass(frozen=True, slots=True)
class ThrustInverse:
    """Rotor input as a polynomial of sqrt(thrust / full), and the range it holds in.

    Exact for thrust that is linear in the command or quadratic in the speed, else a fit (for the
    Crazyflie's cubic to 0.1 % of the full thrust from half of hover on).

    Attributes:
        coefficients: Ascending, shape (6,); command 0..1 or rad/s.
        idle_n: Smallest thrust.
        full_n: Largest thrust.
    """

    coefficients: Array
    idle_n: float
    full_n: float

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest rotor input."""
        ends = np.sqrt([self.idle_n / self.full_n, 1.0])
        low, high = polynomial.polyval(ends, self.coefficients)
        return float(low), float(high)


def thrust_inverse(vehicle: Vehicle) -> ThrustInverse:
    """The steady maps of a vehicle's rotors, turned round."""
    rotors, hover_n = vehicle.rotors, vehicle.hover_thrust_n
    if vehicle.drive == "rotor_speed":
        limit = 1.0
        while polynomial.polyval(limit, rotors.thrust_n) < FULL_OVER_HOVER * hover_n:
            limit *= 1.01
        driven = level = np.linspace(0.0, limit, 2001)
    else:
        driven = np.linspace(0.0, 1.0, 2001)
        level = driven
        if rotors.speed_rad_s:
            level = np.maximum(polynomial.polyval(driven, rotors.speed_rad_s), 0.0)
    thrust = polynomial.polyval(level, rotors.thrust_n)
    idle_n, full_n = IDLE_OVER_HOVER * hover_n, float(thrust[-1])
    used = thrust >= idle_n
    root = np.sqrt(thrust[used] / full_n)
    # Full thrust is at the end of the range; low thrust matters less.
    weight = np.where(root < 1.0, root, 1e6)
    coefficients = polynomial.polyfit(root, driven[used], INVERSE_DEGREE, w=weight)
    return ThrustInverse(coefficients, idle_n, full_n)
