"""PX4's cascade: P position, PID velocity, P attitude, PID rate, multirotor mixer.

Equations and parameter names are those of PX4, so the gains of a log can be flown. Differences: all
loops run at one sample period (on board position runs at 50 to 100 Hz, attitude at 250 Hz); the
setpoints are not smoothed again; hover thrust is a constant where PX4 estimates it; the velocity
setpoint is limited as a vector; there is no land detector.

Source: PX4 v1.12, modules mc_pos_control, mc_att_control, mc_rate_control and
lib/mixer/MultirotorMixer (BSD licence; written from the description of what they compute).

The mixer has airmode off. It is the same as `mix` of `twin.logs.px4.control`, which works on arrays
of a log; a test compares them. PX4 uses degrees; here angles are rad. `from_px4` is the only place
that converts.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component, ComponentBuilder
from ..component.portable import cosine, sine
from ..errors import ModelError
from ..frames import AXES
from ..logs.px4.control import geometry_scale
from ..vehicle import GRAVITY_M_S2, Vehicle
from .control_laws import (
    Signals,
    attitude_error,
    clamp,
    declare_signals,
    desired_axes,
    length,
    shorten,
    thrust_inverse,
)

Array = NDArray[np.float64]
_YAW_CEILING = 1.15  # `mix_yaw` of PX4's mixer allows yaw 15 % above full
_CLIPPED_LOW = 0.005  # -0.99 of PX4's -1..1 as a command, `update_saturation_status`


def mix_airmode_off(controls: list[ca.SX], scale: Array, thrust_factor: ca.SX) -> list[ca.SX]:
    """Roll, pitch, yaw (-1..1) and thrust (0..1) -> motor commands 0..1.

    Args:
        controls: Controls roll, pitch, yaw, thrust.
        scale: Share of each control in each motor, shape (motors, 4).
        thrust_factor: THR_MDL_FAC.
    """
    roll, pitch, yaw = (ca.fmin(ca.fmax(c, -1.0), 1.0) for c in controls[:3])
    thrust = ca.fmin(ca.fmax(controls[3], 0.0), 1.0)
    out = [r * roll + p * pitch + t * thrust for r, p, _, t in scale]
    out = _desaturate(out, scale[:, 3], reduce_only=True)
    out = _desaturate(_desaturate(out, scale[:, 0]), scale[:, 1])
    out = [o + y * yaw for o, y in zip(out, scale[:, 2], strict=True)]
    out = _desaturate(out, scale[:, 2], high=_YAW_CEILING)
    out = _desaturate(out, scale[:, 3], reduce_only=True)
    return [ca.fmin(ca.fmax(_linearised(o, thrust_factor), 0.0), 1.0) for o in out]


def blocked_by(commands: list[ca.SX], column: Array) -> tuple[ca.SX, ca.SX]:
    """Whether a motor at its lower limit blocks an increase, and a decrease, of one axis'
    integral."""
    grow, shrink = ca.SX(0), ca.SX(0)
    for command, share in zip(commands, column.tolist(), strict=True):
        low = command < _CLIPPED_LOW
        if share < 0:
            grow = ca.logic_or(grow, low)
        if share > 0:
            shrink = ca.logic_or(shrink, low)
    return grow, shrink


def _linearised(out: ca.SX, factor: ca.SX) -> ca.SX:
    """Command for a thrust by `thrust = factor cmd^2 + (1 - factor) cmd`."""
    safe = ca.fmax(factor, 1e-3)
    half = (1.0 - safe) / (2.0 * safe)
    curved = -half + ca.sqrt(half * half + ca.fmax(out, 0.0) / safe)
    return ca.if_else(factor > 0, curved, out)


def _desaturate(
    out: list[ca.SX], way: Array, high: float = 1.0, reduce_only: bool = False
) -> list[ca.SX]:
    """Shift the outputs along `way` until they fit, or the excess is equal at both ends."""
    first = _gain(out, way, high)
    moved = [o + first * w for o, w in zip(out, way, strict=True)]
    second = 0.5 * _gain(moved, way, high)
    moved = [o + second * w for o, w in zip(moved, way, strict=True)]
    if not reduce_only:
        return moved
    return [ca.if_else(first > 0, o, n) for o, n in zip(out, moved, strict=True)]


def _gain(out: list[ca.SX], way: Array, high: float) -> ca.SX:
    """Step along `way` that removes the worst excess below 0 and above `high`."""
    low_k, high_k = ca.SX(0), ca.SX(0)
    for o, w in zip(out, way.tolist(), strict=True):
        if abs(w) < 1e-7:
            continue
        k = ca.if_else(o < 0, -o, ca.if_else(o > high, high - o, 0.0)) / w
        low_k, high_k = ca.fmin(low_k, k), ca.fmax(high_k, k)
    return low_k + high_k


@dataclass(frozen=True, slots=True)
class Px4Parameter:
    """One parameter of PX4.

    Attributes:
        default: Default of PX4, in PX4's unit.
        unit: SI unit of its value here.
        meaning: Meaning in one line.
        degrees: Whether PX4's unit has degrees in place of radians.
        positive: Whether it must be above zero.
    """

    default: float
    unit: str
    meaning: str
    degrees: bool = False
    positive: bool = False


def _rates() -> dict[str, Px4Parameter]:
    table: dict[str, Px4Parameter] = {}
    for axis, p, i, d, most in (
        ("ROLL", 0.15, 0.2, 0.003, 220.0),
        ("PITCH", 0.15, 0.2, 0.003, 220.0),
        ("YAW", 0.2, 0.1, 0.0, 200.0),
    ):
        name = axis.lower()
        table |= {
            f"MC_{axis}RATE_P": Px4Parameter(p, "s", f"Rate of {name}, proportional"),
            f"MC_{axis}RATE_I": Px4Parameter(i, "1", f"Rate of {name}, integral"),
            f"MC_{axis}RATE_D": Px4Parameter(d, "s2", f"Rate of {name}, derivative"),
            f"MC_{axis}RATE_FF": Px4Parameter(0.0, "s", f"Rate of {name}, feed-forward"),
            f"MC_{axis}RATE_K": Px4Parameter(1.0, "1", f"Rate of {name}, common factor"),
            f"MC_{axis}RATE_MAX": Px4Parameter(
                most, "rad/s", f"Largest rate of {name} (deg/s in PX4)", degrees=True
            ),
            f"MC_{axis[0]}R_INT_LIM": Px4Parameter(0.3, "1", f"Largest integral of {name}"),
        }
    return table


PARAMETERS: dict[str, Px4Parameter] = {
    "MPC_XY_P": Px4Parameter(0.95, "1/s", "Horizontal position, proportional"),
    "MPC_Z_P": Px4Parameter(1.0, "1/s", "Vertical position, proportional"),
    "MPC_XY_VEL_P_ACC": Px4Parameter(
        1.8, "1/s", "Horizontal velocity, proportional", positive=True
    ),
    "MPC_XY_VEL_I_ACC": Px4Parameter(0.4, "1/s2", "Horizontal velocity, integral"),
    "MPC_XY_VEL_D_ACC": Px4Parameter(0.2, "1", "Horizontal velocity, derivative"),
    "MPC_Z_VEL_P_ACC": Px4Parameter(4.0, "1/s", "Vertical velocity, proportional"),
    "MPC_Z_VEL_I_ACC": Px4Parameter(2.0, "1/s2", "Vertical velocity, integral"),
    "MPC_Z_VEL_D_ACC": Px4Parameter(0.0, "1", "Vertical velocity, derivative"),
    "MPC_VELD_LP": Px4Parameter(5.0, "Hz", "Low-pass of the derivative of velocity", positive=True),
    "MPC_XY_VEL_MAX": Px4Parameter(12.0, "m/s", "Largest horizontal velocity"),
    "MPC_Z_VEL_MAX_UP": Px4Parameter(3.0, "m/s", "Largest climb rate"),
    "MPC_Z_VEL_MAX_DN": Px4Parameter(1.0, "m/s", "Largest sink rate"),
    "MPC_TILTMAX_AIR": Px4Parameter(45.0, "rad", "Largest tilt (deg in PX4)", degrees=True),
    "MPC_THR_HOVER": Px4Parameter(0.5, "1", "Thrust in hover", positive=True),
    "MPC_THR_MIN": Px4Parameter(0.12, "1", "Smallest thrust", positive=True),
    "MPC_THR_MAX": Px4Parameter(1.0, "1", "Largest thrust", positive=True),
    "MC_ROLL_P": Px4Parameter(6.5, "1/s", "Roll, proportional"),
    "MC_PITCH_P": Px4Parameter(6.5, "1/s", "Pitch, proportional"),
    "MC_YAW_P": Px4Parameter(2.8, "1/s", "Yaw, proportional"),
    "MC_YAW_WEIGHT": Px4Parameter(0.4, "1", "Weight of yaw against tilt", positive=True),
    **_rates(),
    "IMU_GYRO_CUTOFF": Px4Parameter(30.0, "Hz", "Low-pass of the gyroscope", positive=True),
    "IMU_DGYRO_CUTOFF": Px4Parameter(
        30.0, "Hz", "Low-pass of the angular acceleration", positive=True
    ),
    "THR_MDL_FAC": Px4Parameter(0.0, "1", "Curvature of thrust over command, 0 linear"),
}
"""The controller's parameters by PX4's names, with its defaults."""


def from_px4(values: Mapping[str, float]) -> dict[str, float]:
    """Parameters in PX4's units -> those of the controller, in SI; unknown ones are omitted."""
    return {
        name: float(np.radians(value)) if PARAMETERS[name].degrees else float(value)
        for name, value in values.items()
        if name in PARAMETERS
    }


SAMPLE_PERIOD_S = 1e-3
"""Sample period of all loops, s: the step of the co-simulation."""
_AXES = ("ROLL", "PITCH", "YAW")  # in PX4's names
_I_FACTOR_RAD_S = float(np.radians(400.0))  # 400 deg/s, PX4's `RateControl::updateIntegral`
Vector = list[ca.SX]


def px4_controller(vehicle: Vehicle, parameters: Mapping[str, float] | None = None) -> Component:
    """PX4's controller for a vehicle as a component.

    Args:
        vehicle: Vehicle; its rotors determine the mixer, its trim the hover thrust.
        parameters: Values that differ from PX4's defaults, in PX4's units (degrees), by PX4's
            names; unknown names are ignored. The hover thrust is that of the vehicle unless
            MPC_THR_HOVER is given and MPC_USE_HTE is not 1 (with 1 PX4 estimates the hover thrust).

    Raises:
        ModelError: The vehicle's input is rotor speed, or a value is outside its range.
    """
    if vehicle.drive == "rotor_speed":
        raise ModelError(f"{vehicle.name}: PX4 gives motor commands, the rotors want speeds.")
    given = dict(parameters or {})
    start = {name: p.default for name, p in PARAMETERS.items()}
    start |= {name: value for name, value in given.items() if name in PARAMETERS}
    values = from_px4(start)
    if "MPC_THR_HOVER" not in given or given.get("MPC_USE_HTE", 0.0) == 1.0:
        values["MPC_THR_HOVER"] = _hover_thrust(vehicle, values["THR_MDL_FAC"])
    m = ComponentBuilder("controller_px4", f"PX4's position controller for {vehicle.name}")
    period = m.sampled(SAMPLE_PERIOD_S, "Period of all loops")
    p = {
        name: m.parameter(
            name, values[name], row.unit, row.meaning, minimum=1e-3 if row.positive else 0.0
        )
        for name, row in PARAMETERS.items()
    }
    s = declare_signals(m)
    thrust_n, yaw_sp = _thrust(m, s, p, period), s.yaw_sp
    rate_sp = _rate_setpoint(s, p, thrust_n, yaw_sp)
    motors = range(1, vehicle.rotors.count + 1)
    held = [m.memory(f"cmd_{i}", "1", f"Command of motor {i}") for i in motors]
    rotors = np.column_stack([vehicle.rotors.position_m[:, :2], -vehicle.rotors.direction])
    scale = geometry_scale(rotors)
    torque = _torque(m, s, p, period, rate_sp, [blocked_by(held, scale[:, k]) for k in range(3)])
    mixed = mix_airmode_off([*torque, length(thrust_n)], scale, p["THR_MDL_FAC"])
    for i, command, new in zip(motors, held, mixed, strict=True):
        m.update(f"cmd_{i}", ca.if_else(s.armed, new, 0.0))
        m.output(f"cmd_{i}", "1", f"Command of motor {i}, 0..1", command)
    return m.build()


def _hover_thrust(vehicle: Vehicle, factor: float) -> float:
    """Thrust control in hover: the trim command through PX4's thrust curve."""
    inverse = thrust_inverse(vehicle)
    command = float(inverse.input([inverse.hover_n])[0])
    return factor * command**2 + (1.0 - factor) * command


def _thrust(m: ComponentBuilder, s: Signals, p: dict[str, ca.SX], period: ca.SX) -> Vector:
    """Position and velocity loops: thrust setpoint NED, 1 = full."""
    hover, least, most = p["MPC_THR_HOVER"], p["MPC_THR_MIN"], p["MPC_THR_MAX"]
    way = ("XY", "XY", "Z")
    ask = [
        v + p[f"MPC_{w}_P"] * (sp - x)
        for w, v, sp, x in zip(way, s.vel_sp, s.pos_sp, s.pos, strict=True)
    ]
    ask = [
        *shorten(ask[:2], p["MPC_XY_VEL_MAX"]),
        clamp(ask[2], -p["MPC_Z_VEL_MAX_UP"], p["MPC_Z_VEL_MAX_DN"]),
    ]
    error = [a - v for a, v in zip(ask, s.vel, strict=True)]
    integral = [m.memory(f"velocity_integral_{a}", "m/s2", f"Velocity integral, {a}") for a in AXES]
    slope = _velocity_slope(m, s, p, period)
    acc = [
        s.acc_sp[k]
        + p[f"MPC_{w}_VEL_P_ACC"] * error[k]
        + integral[k]
        - p[f"MPC_{w}_VEL_D_ACC"] * slope[k]
        for k, w in enumerate(way)
    ]
    limit = sine(p["MPC_TILTMAX_AIR"]) / cosine(p["MPC_TILTMAX_AIR"])
    lean = shorten([-acc[0] / GRAVITY_M_S2, -acc[1] / GRAVITY_M_S2], limit)
    down = (hover / GRAVITY_M_S2) * acc[2] - hover  # its part along NED down
    # The tilted thrust is longer by 1 / cos(tilt), so that its vertical part is as demanded.
    stretch = ca.sqrt(1 + lean[0] ** 2 + lean[1] ** 2)
    down = ca.fmin(stretch * down, -least) / stretch
    down_cut = ca.fmax(down, -most)
    level = shorten(
        [down * lean[0], down * lean[1]],
        ca.sqrt(ca.fmax(most * most - down_cut * down_cut, 0.0)),
    )
    thrust = [*level, down_cut]

    stuck = ca.logic_or(
        ca.logic_and(down_cut >= -least, error[2] >= 0),
        ca.logic_and(down_cut <= -most, error[2] <= 0),
    )
    arw = 2 / p["MPC_XY_VEL_P_ACC"]
    to_integrate = [
        *(error[k] - arw * (acc[k] - level[k] * GRAVITY_M_S2 / hover) for k in range(2)),
        ca.if_else(stuck, 0.0, error[2]),
    ]
    for k, (axis, w) in enumerate(zip(AXES, way, strict=True)):
        grown = integral[k] + p[f"MPC_{w}_VEL_I_ACC"] * period * to_integrate[k]
        if axis == "z":
            grown = clamp(grown, -GRAVITY_M_S2, GRAVITY_M_S2)
        m.update(f"velocity_integral_{axis}", ca.if_else(s.armed, grown, 0.0))
    return thrust


def _velocity_slope(m: ComponentBuilder, s: Signals, p: dict[str, ca.SX], period: ca.SX) -> Vector:
    """Derivative of the velocity after a first-order low-pass."""
    tau = 1 / (2 * np.pi * p["MPC_VELD_LP"])
    slopes = []
    for a, v in zip(AXES, s.vel, strict=True):
        before = m.memory(f"velocity_{a}", "m/s", f"Velocity at the last sample, {a}", v)
        slope = m.memory(f"acceleration_{a}", "m/s2", f"Low-passed derivative of velocity, {a}")
        new = slope + period / (tau + period) * ((v - before) / period - slope)
        m.update(f"velocity_{a}", v)
        m.update(f"acceleration_{a}", new)
        slopes.append(new)
    return slopes


def _rate_setpoint(s: Signals, p: dict[str, ca.SX], thrust_n: Vector, yaw_sp: ca.SX) -> Vector:
    """Attitude loop: body rate setpoint."""
    forward, down = desired_axes(thrust_n, yaw_sp)
    error = attitude_error(s.q_nb, forward, down, p["MC_YAW_WEIGHT"])
    gain = [p["MC_ROLL_P"], p["MC_PITCH_P"], p["MC_YAW_P"] / p["MC_YAW_WEIGHT"]]
    most = [p[f"MC_{axis}RATE_MAX"] for axis in _AXES]
    return [clamp(g * e, -b, b) for g, e, b in zip(gain, error, most, strict=True)]


def _torque(
    m: ComponentBuilder,
    s: Signals,
    p: dict[str, ca.SX],
    period: ca.SX,
    rate_sp: Vector,
    blocked: list[tuple[ca.SX, ca.SX]],
) -> Vector:
    """Rate loop: roll, pitch, yaw controls."""
    torque = []
    for axis, letter, omega, sp, (grow, shrink) in zip(
        _AXES, AXES, s.omega_b, rate_sp, blocked, strict=True
    ):
        gain = {g: p[f"MC_{axis}RATE_{g}"] for g in ("P", "I", "D", "FF", "K")}
        rate = _low_pass(m, f"gyro_{letter}", "rad/s", omega, period * p["IMU_GYRO_CUTOFF"])
        before = m.memory(f"rate_{letter}", "rad/s", f"Low-passed body rate, {letter}")
        m.update(f"rate_{letter}", rate)
        slope = _low_pass(
            m,
            f"dgyro_{letter}",
            "rad/s2",
            (rate - before) / period,
            period * p["IMU_DGYRO_CUTOFF"],
        )
        integral = m.memory(f"rate_integral_{letter}", "1", f"Rate integral, {letter}")
        error = sp - rate
        torque.append(
            gain["K"] * (gain["P"] * error - gain["D"] * slope) + integral + gain["FF"] * sp
        )
        held = ca.if_else(grow, ca.fmin(error, 0.0), error)
        held = ca.if_else(shrink, ca.fmax(held, 0.0), held)
        factor = ca.fmax(1 - (held / _I_FACTOR_RAD_S) ** 2, 0.0)
        most = p[f"MC_{axis[0]}R_INT_LIM"]
        grown = clamp(integral + factor * gain["K"] * gain["I"] * held * period, -most, most)
        m.update(f"rate_integral_{letter}", ca.if_else(s.armed, grown, 0.0))
    return torque


def _low_pass(m: ComponentBuilder, name: str, unit: str, signal: ca.SX, turns: ca.SX) -> ca.SX:
    """Second-order Butterworth low-pass, cutoff in cycles per sample (PX4's LowPassFilter2p)."""
    first = m.memory(f"{name}_1", unit, f"Low-pass of {name}, one sample ago")
    second = m.memory(f"{name}_2", unit, f"Low-pass of {name}, two samples ago")
    half = np.pi * ca.fmin(turns, 0.49)
    tan = sine(half) / cosine(half)
    middle, square = float(np.sqrt(2.0)) * tan, tan * tan
    c = 1 + middle + square
    new = signal - first * (2 * (square - 1) / c) - second * ((1 - middle + square) / c)
    m.update(f"{name}_1", new)
    m.update(f"{name}_2", first)
    return square / c * (new + 2 * first + second)
