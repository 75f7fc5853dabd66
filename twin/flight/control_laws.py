"""What the flight controllers share: attitude geometry and their interface.

Geometry without angles: vectors, dot products and square roots. Vectors are lists of three CasADi
expressions, NED unless said otherwise. Inputs have the names that others give them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from ..component import ComponentBuilder
from ..component.portable import angle, cosine, sine
from ..frames import AXES, cross, multiply, to_body

Vector = list[ca.SX]
_TINY = 1e-9


def dot(a: Sequence[ca.SX], b: Sequence[ca.SX]) -> ca.SX:
    """Scalar product."""
    return sum((x * y for x, y in zip(a, b, strict=True)), start=ca.SX(0))


def length(v: Sequence[ca.SX]) -> ca.SX:
    """Euclidean length; the tiny term keeps the slope finite at zero."""
    return ca.sqrt(dot(v, v) + _TINY**3)


def clamp(value: ca.SX, low: ca.SX | float, high: ca.SX | float) -> ca.SX:
    """The value within two bounds."""
    return ca.fmin(ca.fmax(value, low), high)


def shorten(v: Sequence[ca.SX], longest: ca.SX | float) -> Vector:
    """The vector, shortened to a length where it is longer."""
    scale = ca.fmin(1.0, longest / ca.fmax(length(v), _TINY))
    return [scale * x for x in v]


def desired_axes(up: Sequence[ca.SX], yaw: ca.SX) -> tuple[Vector, Vector]:
    """Body forward and down of the attitude whose thrust points up a vector, nose at a yaw angle.

    Args:
        up: Any length but 0, not below the horizon.
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

    First the shortest turn of the thrust axis, then a turn about that axis. Close to zero it is
    the rotation vector in rad, body axes.

    Args:
        q_nb: Attitude.
        forward: Desired body forward, NED.
        down: Desired body down, NED.
        yaw_weight: Share of the turn about the thrust axis that is asked for; None: all of it.

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
    """Acceleration NED within a climb, a sink (m/s2) and a tilt (rad) limit, height first."""
    z = clamp(wanted[2], -climb, sink)
    x, y = shorten(wanted[:2], (gravity - z) * sine(tilt) / cosine(tilt))
    return [x, y, z]


_NED = ("north", "east", "down")
_FRD = ("forward", "right", "down")


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
        armed: Whether the motors may turn, true or false.
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
        pos=vector("pos", "m", "Position, NED", _NED),
        vel=vector("vel", "m/s", "Velocity, NED", _NED),
        q_nb=[
            m.input(f"q_{a}", "1", f"Attitude quaternion body to NED, {a}", float(a == "w"))
            for a in "wxyz"
        ],
        omega_b=vector("omega", "rad/s", "Body rate about", _FRD),
        pos_sp=vector("setpoint_pos", "m", "Position setpoint, NED", _NED),
        vel_sp=vector("setpoint_vel", "m/s", "Velocity setpoint, NED", _NED),
        acc_sp=vector("setpoint_acc", "m/s2", "Acceleration setpoint, NED", _NED),
        yaw_sp=m.input("setpoint_yaw", "rad", "Heading setpoint of the nose, from north to east"),
        armed=m.input("armed", "1", "Whether the motors may turn", kind="boolean") > 0.5,
    )


def declare_drives(m: ComponentBuilder, drive: str, values: list[ca.SX]) -> None:
    """Declare the outputs `cmd_1..n`, or `rotor_1..n` for a vehicle known by rotor speed."""
    for i, value in enumerate(values, start=1):
        if drive == "rotor_speed":
            m.output(f"rotor_{i}", "rad/s", f"Speed of rotor {i}", value)
        else:
            m.output(f"cmd_{i}", "1", f"Command of motor {i}, 0..1", value)
