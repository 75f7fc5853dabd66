"""Position controller derived from the airframe's own equations: LQR gains in a cascade.

    a   = a_sp + d v_sp + k_p (p_sp - p) + k_v (v_sp - v) + I,   dI/dt = k_i (p_sp - p)
    R_d = thrust along a - g, nose at the yaw setpoint
    dω/dt = k_θ θ(R -> R_d) - k_ω ω - k_α α,   lift = (a - g) . thrust axis

The aerodynamic moment on a moving aircraft is subtracted from dω/dt: the part from its velocity in
still air, and that from the wind, which is estimated from the body rates (`_AirMoment`).

For small errors this is the state feedback of `Gains` (its position gains divided by that of the
tilt are k_p, k_v, k_i), so hover is optimal in its sense; the intermediate desired attitude makes
it valid at any heading and tilt. α and the lift after the rotors' lag are modelled in the
controller. Limits: tilt, climb, sink and the effect of the position error, with back-calculation
for the integral; the mixer reduces yaw first.

Gains are linear-quadratic regulators of three chains of integrators. With the mixer converting
accelerations into rotor thrusts, the hover model decouples into

| chain | states | input: command of |
|---|---|---|
| horizontal | integral, position, velocity, tilt, body rate, lag | angular acceleration |
| vertical | integral, position, velocity, lag | acceleration |
| heading | integral, heading, body rate, lag | angular acceleration |

each of which has its own algebraic Riccati equation; the lag is included if the rotors have one.
Nothing is tuned by hand but the weights, which follow Bryson's rule.

The mixer converts accelerations into rotor inputs: thrust shares, saturation, inverse thrust map.
In saturation yaw is reduced first, then lift, roll and pitch last.

Sources: Bryson & Ho, Applied Optimal Control, sec. 5.2; integral action, Franklin, Powell &
Emami-Naeini, Feedback Control of Dynamic Systems, sec. 7.10; cascade on the thrust vector, Lee,
Leok & McClamroch, CDC 2010; back-calculation, Astrom & Murray, Feedback Systems, sec. 10.4.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy
from numpy.typing import NDArray

from ..component import Component, ComponentBuilder
from ..frames import AXES, to_body
from ..vehicle import GRAVITY_M_S2, Vehicle
from ..vehicle.vehicle import polynomial
from .control_laws import (
    HoverModel,
    Signals,
    ThrustInverse,
    attitude_error,
    clamp,
    declare_drives,
    declare_signals,
    desired_axes,
    dot,
    length,
    limit_acceleration,
    linearise,
    shorten,
    thrust_axis,
    thrust_inverse,
)

Array = NDArray[np.float64]
ACCEPTABLE = {
    "integral": 0.25,  # m s
    "position": 0.25,  # m
    "velocity": 0.8,  # m/s
    "tilt": 0.4,  # rad
    "rate": 4.0,  # rad/s
    "heading_integral": 0.5,  # rad s
    "heading": 0.3,  # rad
    "heading_rate": 1.5,  # rad/s
    "thrust": 0.25,  # share of the hover thrust of a rotor
}
"""Largest acceptable deviation per quantity (Bryson's rule): made up, for agile indoor flight."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Feedback `command = -gain @ states` of one chain.

    Attributes:
        gain: Gains in the order of the states, shape (n,).
        poles: Closed-loop poles, rad/s, shape (n,).
    """

    gain: Array
    poles: NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of all chains, and the mixer that they assume.

    Attributes:
        mixer_n: Rotor thrusts per upward and angular acceleration, shape (n_rotors, 4).
    """

    horizontal: Chain
    vertical: Chain
    heading: Chain
    mixer_n: Array


def design(hover: HoverModel) -> Gains:
    """Gains for a hover model. The weaker of roll and pitch determines those of the horizontal
    chain."""
    mixer = np.asarray(np.linalg.pinv(hover.effect), dtype=np.float64)
    share = ACCEPTABLE["thrust"] * hover.thrust_n.mean()
    # Equal penalty per newton on all rotors, converted to each acceleration command.
    lift, roll, pitch, yaw = np.sum((mixer / share) ** 2, axis=0)
    drag = float(hover.drag_1_s[:2].mean())
    motion = [ACCEPTABLE[k] for k in ("integral", "position", "velocity")]
    return Gains(
        horizontal=_chain(
            [1.0, 1.0, hover.gravity_m_s2, 1.0],
            [0.0, 0.0, drag, 0.0, 0.0],
            hover.lag_s,
            [*motion, ACCEPTABLE["tilt"], ACCEPTABLE["rate"]],
            max(roll, pitch),
        ),
        vertical=_chain([1.0, 1.0], [0.0, 0.0, hover.drag_1_s[2]], hover.lag_s, motion, lift),
        heading=_chain(
            [1.0, 1.0],
            [0.0, 0.0, 0.0],
            hover.lag_s,
            [ACCEPTABLE[k] for k in ("heading_integral", "heading", "heading_rate")],
            yaw,
        ),
        mixer_n=mixer,
    )


def _chain(
    links: list[float], decay: list[float], lag_s: float, acceptable: list[float], penalty: float
) -> Chain:
    """Riccati design of `dx_k/dt = link_k x_(k+1) - decay_k x_k`, the input at the end."""
    n = len(decay)
    a = np.diag(np.array(links), 1) - np.diag(np.array(decay))
    b = np.zeros((n, 1))
    b[-1] = 1.0
    weight = [1.0 / v**2 for v in acceptable]
    if lag_s > 0:
        a = np.block([[a, b], [np.zeros((1, n)), np.array([[-1.0 / lag_s]])]])
        b = np.vstack([np.zeros((n, 1)), [[1.0 / lag_s]]])
        weight.append(0.0)  # its own command has a separate weight
    q, r = np.diag(weight), np.array([[penalty]])
    gain = np.linalg.solve(r, b.T @ scipy.linalg.solve_continuous_are(a, b, q, r)).ravel()
    return Chain(gain, np.linalg.eigvals(a - b * gain).astype(np.complex128))


_TINY = 1e-12  # keeps divisions finite; far below any command
_WAYS = (
    ("lift", "kg", "upward acceleration"),
    ("roll", "kg.m", "angular acceleration about forward"),
    ("pitch", "kg.m", "angular acceleration about right"),
    ("yaw", "kg.m", "angular acceleration about down"),
)  # input of the plant, its unit, accelerated quantity


@dataclass(frozen=True, slots=True)
class Mixed:
    """Rotor inputs, and the resulting accelerations once the rotors have settled."""

    inputs: list[ca.SX]
    lift: ca.SX
    angular: list[ca.SX]


def mix(
    m: ComponentBuilder,
    shares: Array,
    inverse: ThrustInverse,
    unit: str,
    lift: ca.SX,
    angular: list[ca.SX],
) -> Mixed:
    """Declare the mixer's parameters and outputs.

    Args:
        m: Builder of the controller.
        shares: Thrust per acceleration, N, shape (n_rotors, 4): lift, roll, pitch, yaw.
        inverse: Inverse of the thrust map.
        unit: Unit of the rotor inputs.
        lift: Wanted specific thrust along body up, m/s2.
        angular: Wanted angular acceleration, rad/s2.
    """
    idle = m.parameter("thrust.idle", inverse.idle_n, "N", "Smallest thrust of a rotor", minimum=0)
    full = m.parameter(
        "thrust.full", inverse.full_n, "N", "Largest thrust of a rotor", minimum=1e-6
    )
    coefficients = [
        m.parameter(
            f"inverse.c{k}",
            float(c),
            unit,
            f"Rotor input, coefficient of sqrt(thrust / thrust.full)^{k}",
        )
        for k, c in enumerate(inverse.coefficients)
    ]
    up, *ways = [
        [
            m.parameter(
                f"mixer_{i}.{way}", float(row[k]), per, f"Thrust of rotor {i} per {meaning}"
            )
            for i, row in enumerate(shares, start=1)
        ]
        for k, (way, per, meaning) in enumerate(_WAYS)
    ]
    turn = [a * angular[0] + b * angular[1] for a, b in zip(ways[0], ways[1], strict=True)]
    spread = _most(turn) - _least(turn)
    share = ca.fmin(1.0, (full - idle) / ca.fmax(spread, _TINY))
    turn = [share * t for t in turn]
    # Between the lift that keeps the lowest rotor turning and the one that saturates the highest.
    low = _most([(idle - t) / s for t, s in zip(turn, up, strict=True)])
    high = _least([(full - t) / s for t, s in zip(turn, up, strict=True)])
    lifted = clamp(lift, low, ca.fmax(low, high))
    base = [s * lifted + t for s, t in zip(up, turn, strict=True)]
    yaw = [s * angular[2] for s in ways[2]]
    room = [
        ca.if_else(y > 0, full - b, b - idle) / ca.fmax(ca.fabs(y), _TINY)
        for b, y in zip(base, yaw, strict=True)
    ]
    turned = clamp(_least(room), 0.0, 1.0)
    thrust = [clamp(b + turned * y, idle, full) for b, y in zip(base, yaw, strict=True)]
    return Mixed(
        inputs=[polynomial(coefficients, ca.sqrt(t / full)) for t in thrust],
        lift=lifted,
        angular=[share * angular[0], share * angular[1], turned * angular[2]],
    )


def _most(values: list[ca.SX]) -> ca.SX:
    largest = values[0]
    for value in values[1:]:
        largest = ca.fmax(largest, value)
    return largest


def _least(values: list[ca.SX]) -> ca.SX:
    return -_most([-value for value in values])


TILT_LIMIT_RAD = 0.7
"""Largest tilt demanded by the position loop, 40 degrees. Made up."""
CLIMB_LIMIT_M_S2 = 4.0
"""Largest upward acceleration demanded by the position loop. Made up."""
SINK_LIMIT_M_S2 = 4.0
"""Largest downward acceleration demanded by the position loop. Made up."""
LIFT_RESERVE = 0.8
"""Share of the full thrust available for level flight and tilt; the rest is for moments."""
LEAST_LIFT = 1.05
"""Thrust over weight that a vehicle with weak rotors may always use. All made up."""
LEAST_AIR_MOMENT_RAD_M_S = 0.1
"""Smallest moment of the air that is compensated: at 10 m/s a smaller one tilts an aircraft less
than a gust does. Made up."""
LEAST_AIR_MOMENT_S = 0.1
"""Time constant of the wind's moment estimate for rotors without lag. Made up: gusts are slower,
gyroscopes faster."""
RELEASE_1_S = 20.0
"""Rate at which integrals decay while disarmed. Made up."""
Vector = list[ca.SX]


def controller(vehicle: Vehicle) -> Component:
    """The flight controller of a vehicle as a component, with gains designed for the vehicle."""
    hover = linearise(vehicle)
    gains = design(hover)
    inverse = thrust_inverse(vehicle)
    m = ComponentBuilder("controller", f"Position controller of {vehicle.name}, LQR in a cascade")
    s = declare_signals(m)
    gravity = m.parameter(
        "gravity", vehicle.gravity_m_s2, "m/s2", "Acceleration of free fall", minimum=0
    )
    wanted = _acceleration(m, s, gravity, hover, gains, _limits(inverse))
    up = [wanted[0], wanted[1], wanted[2] - gravity]
    lift = ca.fmax(dot(up, thrust_axis(s.q_nb)), 0.0)
    turn = _angular(m, s, up, gains)
    lag = _Lag(m, hover.lag_s) if hover.lag_s > 0 else None
    if lag is not None:
        lift, *turn = lag.led([lift, *turn], gains)
    unit = "rad/s" if vehicle.drive == "rotor_speed" else "1"
    air = _AirMoment(m, s, hover) if _turned_by_air(hover) else None
    asked = turn if air is None else [t - a for t, a in zip(turn, air.angular, strict=True)]
    mixed = mix(m, gains.mixer_n, inverse, unit, lift, asked)
    settled = mixed.angular
    if air is not None:
        settled = [t + a for t, a in zip(mixed.angular, air.angular, strict=True)]
        air.follow(settled if lag is None else lag.turn)
    if lag is not None:
        lag.follow([ca.if_else(s.armed, v, 0.0) for v in (mixed.lift, *settled)])
    declare_drives(m, vehicle.drive, [ca.if_else(s.armed, v, 0.0) for v in mixed.inputs])
    return m.build()


def _turned_by_air(hover: HoverModel) -> bool:
    return bool(np.abs(hover.air_moment_rad_m_s).max() >= LEAST_AIR_MOMENT_RAD_M_S)


class _AirMoment:
    """Angular acceleration by the air, rad/s2, body axes: `k v + l`.

    `k v` is that of the velocity in still air. `l` is the addition of the wind in roll and pitch:
    the part of the body rates that the modelled angular acceleration does not explain, times a
    gain,

        l = (omega - z) / T,   dz/dt = modelled angular acceleration,

    so that a steady wind causes no attitude error. A quarter of T is at least the lag of the
    rotors, with which the loop is critically damped: T lag s^2 + T s + 1 = 0 has no oscillation.

    Source: disturbance observer without differentiation, Ohnishi, Shibata & Murakami, IEEE/ASME
    Trans. Mechatronics 1 (1996), 56-67.
    """

    def __init__(self, m: ComponentBuilder, s: Signals, hover: HoverModel) -> None:
        self._m, self._s = m, s
        ahead, right, _ = to_body(s.q_nb, s.vel)
        time = m.parameter(
            "air_moment.time",
            max(4.0 * hover.lag_s, LEAST_AIR_MOMENT_S),
            "s",
            "Time constant with which the moment of the wind is learned",
            minimum=1e-3,
        )
        self._off, self.angular = [], []
        of_speed = (("forward per speed to the right", right), ("right per speed forward", ahead))
        for axis, k, (text, speed), omega in zip(
            AXES, hover.air_moment_rad_m_s, of_speed, s.omega_b, strict=False
        ):
            per_speed = m.parameter(
                f"air_moment.{axis}", float(k), "rad/(m.s)", f"Angular acceleration about {text}"
            )
            modelled = m.state(f"modelled_omega_{axis}", "rad/s", f"Modelled body rate, {axis}", 0)
            self._off.append(omega - modelled)
            self.angular.append(per_speed * speed + self._off[-1] / time)
        self.angular.append(ca.SX(0))

    def follow(self, turn: Vector) -> None:
        """Integrate the modelled angular acceleration to modelled body rates."""
        for axis, off, rate in zip(AXES, self._off, turn, strict=False):
            slope = ca.if_else(self._s.armed, rate, RELEASE_1_S * off)
            self._m.derivative(f"modelled_omega_{axis}", slope)


class _Lag:
    """Model of lift and angular acceleration after the lag of the rotors."""

    def __init__(self, m: ComponentBuilder, lag_s: float) -> None:
        self._m = m
        self._time = m.parameter(
            "lag.time", lag_s, "s", "Time constant of the rotors", minimum=1e-3
        )
        self._names = ["lift", *(f"turn_{a}" for a in AXES)]
        units = ["m/s2", "rad/s2", "rad/s2", "rad/s2"]
        self._now = [
            m.state(n, u, f"Modelled {n} behind the lag", 0.0)
            for n, u in zip(self._names, units, strict=True)
        ]

    @property
    def turn(self) -> Vector:
        """The modelled angular acceleration."""
        return self._now[1:]

    def led(self, wanted: Vector, gains: Gains) -> Vector:
        """Demanded lift and angular acceleration with the feedback of the modelled ones."""
        lead = _gain(self._m, "lift", "lag", "1", "lift against the wanted", _lead(gains.vertical))
        tilt, yaw = (
            _gain(self._m, name, "lag", "1", "angular acceleration", chain.gain[-1])
            for name, chain in (("tilt", gains.horizontal), ("yaw", gains.heading))
        )
        lift, *turn = wanted
        led = [t - k * b for t, k, b in zip(turn, (tilt, tilt, yaw), self._now[1:], strict=True)]
        return [lift + lead * (lift - self._now[0]), *led]

    def follow(self, settled: Vector) -> None:
        """Integrate the modelled ones towards the demand on the rotors."""
        for name, now, then in zip(self._names, self._now, settled, strict=True):
            self._m.derivative(name, (then - now) / self._time)


def _limits(inverse: ThrustInverse) -> dict[str, float]:
    """Limits by the thrust over weight of the vehicle."""
    most = max(LIFT_RESERVE * inverse.full_n / inverse.hover_n, LEAST_LIFT)
    return {
        "tilt": float(min(TILT_LIMIT_RAD, np.arccos(min(1.0 / most, 1.0)))),
        "climb": min(CLIMB_LIMIT_M_S2, (most - 1.0) * GRAVITY_M_S2),
        "sink": SINK_LIMIT_M_S2,
    }


def _acceleration(
    m: ComponentBuilder,
    s: Signals,
    gravity: ca.SX,
    hover: HoverModel,
    gains: Gains,
    start: dict[str, float],
) -> Vector:
    """Outer loop: demanded acceleration NED from position and velocity."""
    tilt = m.parameter("limit.tilt", start["tilt"], "rad", "Largest tilt", minimum=0, maximum=1.4)
    climb = m.parameter(
        "limit.climb", start["climb"], "m/s2", "Largest upward acceleration", minimum=0
    )
    sink = m.parameter(
        "limit.sink", start["sink"], "m/s2", "Largest downward acceleration", minimum=0, maximum=9.0
    )
    pull = m.parameter(
        "limit.pull",
        0.5 * GRAVITY_M_S2 * float(np.tan(start["tilt"])),
        "m/s2",
        "Largest acceleration that a position error asks for",
        minimum=0,
    )
    ways = (("xy", _outer(gains.horizontal, hover)), ("z", _inner(gains.vertical)))
    gain = {
        f"{name}_{way}": _gain(m, name, f"k_{way}", unit, meaning, value)
        for way, values in ways
        for (name, unit, meaning), value in zip(_OUTER, values, strict=True)
    }
    drag = m.parameter(
        "drag", float(hover.drag_1_s[:2].mean()), "1/s", "Deceleration per horizontal speed"
    )
    off = [sp - p for sp, p in zip(s.pos_sp, s.pos, strict=True)]
    ahead = [a + drag * v for a, v in zip(s.acc_sp[:2], s.vel_sp[:2], strict=True)]
    far_xy, far_z = pull / gain["position_xy"], pull / gain["position_z"]
    # A large position error is not integrated.
    near = [length(off[:2]) < far_xy] * 2 + [ca.fabs(off[2]) < far_z]
    off = [*shorten(off[:2], far_xy), clamp(off[2], -far_z, far_z)]
    raw, integrals = [], []
    for i, axis in enumerate(AXES):
        way = "z" if axis == "z" else "xy"
        integral = m.state(f"integral_{axis}", "m/s2", f"Integral of the position error, {axis}", 0)
        feedback = gain[f"position_{way}"] * off[i] + gain[f"velocity_{way}"] * (
            s.vel_sp[i] - s.vel[i]
        )
        raw.append((s.acc_sp[2] if axis == "z" else ahead[i]) + feedback + integral)
        integrals.append(integral)
    limited = limit_acceleration(raw, gravity, climb, sink, tilt)
    for i, axis in enumerate(AXES):
        way = "z" if axis == "z" else "xy"
        back = gain[f"position_{way}"] / gain[f"velocity_{way}"]
        rate = gain[f"integral_{way}"] * ca.if_else(near[i], off[i], 0.0)
        rate += back * (limited[i] - raw[i])
        m.derivative(f"integral_{axis}", ca.if_else(s.armed, rate, -RELEASE_1_S * integrals[i]))
    return limited


def _angular(m: ComponentBuilder, s: Signals, up: Vector, gains: Gains) -> Vector:
    """Inner loop: demanded angular acceleration from attitude and body rates."""
    tilt, tilt_rate = gains.horizontal.gain[3:5]
    k_tilt = _gain(m, "attitude", "k_tilt", "1/s2", "tilt", tilt)
    k_tilt_rate = _gain(m, "rate", "k_tilt", "1/s", "rate of roll and pitch", tilt_rate)
    i_yaw, yaw, yaw_rate = gains.heading.gain[:3]
    k_yaw = _gain(m, "attitude", "k_yaw", "1/s2", "heading", yaw)
    k_yaw_rate = _gain(m, "rate", "k_yaw", "1/s", "yaw rate", yaw_rate)
    k_i = _gain(m, "integral", "k_yaw", "1/s3", "integral of the heading", i_yaw)
    error = attitude_error(s.q_nb, *desired_axes(up, s.yaw_sp))
    integral = m.state("integral_yaw", "rad/s2", "Integral of the heading error", 0.0)
    small = clamp(error[2], -_FAR_RAD, _FAR_RAD)  # a large yaw error is not integrated
    m.derivative("integral_yaw", ca.if_else(s.armed, k_i * small, -RELEASE_1_S * integral))
    return [
        k_tilt * error[0] - k_tilt_rate * s.omega_b[0],
        k_tilt * error[1] - k_tilt_rate * s.omega_b[1],
        k_yaw * error[2] - k_yaw_rate * s.omega_b[2] + integral,
    ]


_FAR_RAD = 0.2  # largest yaw error that is integrated; by judgement
_OUTER = (
    ("integral", "1/s3", "integral of the position"),
    ("position", "1/s2", "position"),
    ("velocity", "1/s", "velocity"),
)  # gain of the position loop, its unit, controlled quantity


def _outer(chain: Chain, hover: HoverModel) -> list[float]:
    """Gains from integral, position, velocity to acceleration, from those to the tilt."""
    return [float(hover.gravity_m_s2 / chain.gain[3] * k) for k in chain.gain[:3]]


def _inner(chain: Chain) -> list[float]:
    """Gains of the vertical chain, without the lead that compensates its lag."""
    return [float(k / (1.0 + _lead(chain))) for k in chain.gain[:3]]


def _lead(chain: Chain) -> float:
    return float(chain.gain[3]) if len(chain.gain) > 3 else 0.0


def _gain(
    m: ComponentBuilder, stem: str, leaf: str, unit: str, meaning: str, value: float
) -> ca.SX:
    return m.parameter(f"{stem}.{leaf}", float(value), unit, f"Feedback of the {meaning}")
