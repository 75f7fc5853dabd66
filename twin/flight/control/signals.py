"""The interface of every flight controller: what it reads, under the names others give it."""

from dataclasses import dataclass

import casadi as ca

from ...component import ComponentBuilder
from ...frames import AXES

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
