"""PX4's cascade: P position, PID velocity, P attitude, PID rate, multirotor mixer.

Equations and parameter names are those of PX4, so the gains of a log can be flown. What differs:
all loops run at one sample period (on board position runs at 50 to 100 Hz, attitude at 250 Hz);
the setpoints are taken as given instead of being smoothed again; hover thrust is a constant where
PX4 estimates it; the velocity setpoint is shortened as a whole; nothing detects the landing.

Source: PX4 v1.12, modules mc_pos_control, mc_att_control, mc_rate_control and
lib/mixer/MultirotorMixer (BSD licence; written from the description of what they compute).
"""

from collections.abc import Mapping
from pathlib import Path

import casadi as ca
import numpy as np

from ....component import Component, ComponentBuilder
from ....component.portable import cosine, sine
from ....errors import ModelError
from ....frames import AXES
from ....logs.px4.control import geometry_scale
from ....vehicle import GRAVITY_M_S2, Vehicle
from ..geometry import attitude_error, clamp, desired_axes, length, shorten
from ..hover import thrust_inverse
from ..signals import Signals, declare_signals
from .mixer import blocked_by, mix_airmode_off
from .parameters import PARAMETERS, from_px4, log_parameters

SAMPLE_PERIOD_S = 1e-3
_AXES = ("ROLL", "PITCH", "YAW")
_I_FACTOR_RAD_S = float(np.radians(400.0))
Vector = list[ca.SX]


def px4_controller(vehicle: Vehicle, parameters: Mapping[str, float] | None = None) -> Component:
    """PX4's controller for a vehicle as a component.

    Args:
        vehicle: Its rotors make the mixer, its trim the hover thrust.
        parameters: Values that differ from PX4's defaults, in PX4's units (degrees), by PX4's
            names; names that the controller does not know are left out. The hover thrust is that
            of the vehicle unless MPC_THR_HOVER is given and MPC_USE_HTE is not 1 (with it PX4
            finds the hover thrust by itself).

    Raises:
        ModelError: The vehicle is driven by rotor speed, or a value is outside its range.
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


def px4_controller_of_log(vehicle: Vehicle, log: Path) -> Component:
    """PX4's controller for a vehicle, with the parameters a log was flown with.

    Raises:
        LogError: The log holds no parameters.
    """
    return px4_controller(vehicle, log_parameters(log))


def _hover_thrust(vehicle: Vehicle, factor: float) -> float:
    """Thrust control that hovers: the trim command through PX4's thrust curve."""
    inverse = thrust_inverse(vehicle)
    root = np.sqrt(vehicle.hover_thrust_n / inverse.full_n)
    command = float(np.polynomial.polynomial.polyval(root, inverse.coefficients))
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
    down = (hover / GRAVITY_M_S2) * acc[2] - hover  # its share along NED down
    # The tilted thrust is longer by 1 / cos(tilt), so that its vertical part is as wanted.
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
    """Derivative of the velocity behind a first-order low-pass."""
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
    """Second-order Butterworth low-pass, cutoff in turns per sample (PX4's LowPassFilter2p)."""
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
