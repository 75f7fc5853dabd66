"""How each effect is hidden: what changes in the plant, how much, and what the truth file says.

Sizes are small, medium and large; medium is what matters in practice. The caller has already
varied the size at random; signs and directions are drawn here.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .plants.aircraft import Aircraft
from .plants.missions import DURATION_S
from .plants.own.parameters import GRAVITY_M_S2, STEP_S, Array, Parameters
from .plants.own.physics import climb_slope, induced_velocity

AXES = "xyz"


@dataclass(frozen=True)
class Number:
    """A number of the truth.

    Attributes:
        value: In `unit`.
        unit: SI.
        exact: Whether the plant has just this parameter; else its own law behaves like a
            law with this parameter about hover.
        neutral: Value at which the effect vanishes.
    """

    value: float
    unit: str
    exact: bool = True
    neutral: float = 0.0


Truth = dict[str, Number]
Change = tuple[Parameters, Truth]
Hide = Callable[[Parameters, Aircraft, float, np.random.Generator], Change]


@dataclass(frozen=True)
class Hidden:
    """An effect that can be hidden.

    Attributes:
        name: Identifier of design.md, or one of our own for effects outside the library.
        sizes: Small, medium, large.
        hide: Changes a plant by an effect of a size.
        outside: Whether no identifier of the library describes it.
    """

    name: str
    sizes: tuple[float, float, float]
    hide: Hide
    outside: bool = False


def sign(rng: np.random.Generator) -> float:
    """Plus or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def direction(rng: np.random.Generator, size: float, axes: int = 3) -> Array:
    """A vector of this length: all axes, or forward and right alone."""
    v = np.zeros(3)
    v[:axes] = rng.standard_normal(axes)
    return np.asarray(size * v / np.sqrt(v @ v))


def uneven(rng: np.random.Generator, size: float) -> Array:
    """Three numbers of either sign, each 0.5 to 1.2 times the size."""
    return np.asarray(size * rng.uniform(0.5, 1.2, 3) * rng.choice([-1.0, 1.0], 3))


def factor(value: float, exact: bool = True) -> Number:
    """A number that changes nothing at one."""
    return Number(value, "1", exact, neutral=1.0)


def vector(pattern: str, values: Array, unit: str, exact: bool = True) -> Truth:
    """Numbers of a vector: `pattern` holds `{}` for the axis."""
    return {
        pattern.format(a): Number(float(v), unit, exact) for a, v in zip(AXES, values, strict=False)
    }


def factors(pattern: str, values: Array) -> Truth:
    """Numbers of a vector that changes nothing at ones."""
    return {pattern.format(a): factor(float(v)) for a, v in zip(AXES, values, strict=True)}


def changed(p: Parameters, truth: Truth, **numbers: Any) -> Change:
    """The plant with some numbers changed."""
    return replace(p, **numbers), truth


Rng = np.random.Generator


def _induced(p: Parameters) -> float:
    """Induced velocity of hover, m/s."""
    return float(np.mean(induced_velocity(p.hover_thrust, np.asarray(p.radius))))


# -- air --------------------------------------------------------------------------------------


def _rotor_drag(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """In-plane force of the blades' profile drag: Leishman, sec. 3.5.2, linear in the advance."""
    h = size * p.mass / (len(p.hubs) * p.hover_speed)
    return changed(p, {"k_xy_1_s": Number(size, "1/s", False)}, rotor_h=h)


def _parasitic_drag(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    return changed(p, {"c_1_m": Number(size, "1/m")}, parasitic=size * p.mass)


def _induced_inflow(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    slope = climb_slope(size, _induced(p))
    return changed(
        p,
        {"k_s_m": Number(slope, "s/m", False)},
        inflow_gain=max(size, p.inflow_gain),
        inflow_axial=1.0,
    )


def _translational_lift(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    truth = {
        "gain": Number(size, "1", False),
        "induced_m_s": Number(_induced(p), "m/s", False),
    }
    return changed(p, truth, inflow_gain=max(size, p.inflow_gain), inflow_forward=1.0)


def _blade_flapping(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """Tilt of the disc proportional to the advance ratio: Mahony et al. 2012, eq. 13."""
    raised = float(rng.uniform(0.05, 0.15)) * a.arm
    height = raised - float(p.hubs[:, 2].mean())
    truth = {
        "k_rad_s_m": Number(size, "rad*s/m", False),
        "height_m": Number(height, "m", False),
    }
    return changed(p, truth, flap=size * p.hover_speed * p.radius, flap_height=raised)


def _steady_wind(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    wind = direction(rng, size, axes=2)
    truth = {
        f"{n}_m_s": Number(float(v), "m/s")
        for n, v in zip(("north", "east", "down"), wind, strict=True)
    }
    return changed(p, truth, wind=wind)


def _gust(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """First-order turbulence, the longitudinal Dryden spectrum of MIL-F-8785C at fixed speed."""
    time = float(rng.uniform(0.4, 1.2))
    truth = {"sigma_m_s": Number(size, "m/s", False), "time_s": Number(time, "s", False)}
    return changed(p, truth, gust_sigma=size, gust_time=time)


def _ground_effect(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """Cheeseman & Bennett 1955 with the larger coefficient of multirotors (Sanchez-Cuevas 2017)."""
    return changed(p, {"rho": Number(size, "1", False)}, ground_effect=size)


# -- propulsion -------------------------------------------------------------------------------


def _thrust_scale(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    scale = 1 + sign(rng) * size
    return changed(p, {"scale": factor(scale)}, thrust_k=p.thrust_k * scale)


def _thrust_curve(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    slope = sign(rng) * size
    return changed(p, {"slope": Number(slope, "1", False)}, thrust_exponent=1 + slope)


def _battery_sag(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """Speed at a command falls with the voltage; thrust with twice the power."""
    truth = {"slope": Number(size, "1", False), "reference_v": Number(p.reference_v, "V", False)}
    return changed(p, truth, voltage_exponent=size / 2)


def _motor_lag(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    return changed(p, {"tau_s": Number(size, "s")}, lag=p.lag + size)


def _rotor_efficiency_loss(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    i = int(rng.integers(len(p.hubs)))
    k = p.thrust_k.copy()
    k[i] *= 1 - size
    return changed(p, {f"loss_{i + 1}": Number(size, "1")}, thrust_k=k)


def _rotor_inertia_torque(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    inertia = size * a.spin_inertia
    truth = {"momentum_n_m_s": Number(inertia * p.hover_speed, "N*m*s")}
    return changed(p, truth, spin_inertia_yaw=inertia)


def _gyroscopic_torque(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    inertia = size * a.spin_inertia
    truth = {"momentum_n_m_s": Number(inertia * p.hover_speed, "N*m*s")}
    return changed(p, truth, spin_inertia_gyro=inertia)


def _yaw_torque_scale(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    scale = float((1 + size) ** sign(rng))
    return changed(p, {"scale": factor(scale)}, torque_k=p.torque_k * scale)


def _thrust_tilt(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    tilt = direction(rng, size, axes=2)
    return changed(p, vector("{}_rad", tilt[:2], "rad"), tilt=tilt)


# -- mass -------------------------------------------------------------------------------------


def _mass_offset(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    extra = sign(rng) * size * a.nominal.mass
    return changed(p, {"mass_kg": Number(extra, "kg")}, mass=p.mass + extra)


def _cog_offset(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """Hubs, accelerometer and markers stay on the frame; the centre of mass moves."""
    shift = direction(rng, size * a.arm, axes=2)
    return changed(
        p,
        vector("{}_m", shift[:2], "m"),
        hubs=p.hubs - shift,
        imu_arm=p.imu_arm - shift,
        marker=p.marker - shift,
    )


def _inertia_error(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    scale = np.exp(sign(rng) * size * rng.uniform(0.6, 1.2, 3))
    return changed(p, factors("scale_{}", scale), inertia=p.inertia * scale)


def _slung_load(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """Point mass on a massless rope that pulls only, at the centre of mass; it knows no ground."""
    mass, length = size * a.nominal.mass, float(rng.uniform(0.5, 1.1))
    truth = {"mass_kg": Number(mass, "kg"), "length_m": Number(length, "m")}
    return changed(p, truth, load_mass=mass, load_length=length)


# -- outside the library ----------------------------------------------------------------------


def _duct_leak(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """Air escapes along body x in proportion to the command of the front motors."""
    force = np.array([sign(rng) * size * p.mass * GRAVITY_M_S2, 0.0, 0.0])
    return changed(p, vector("force_{}_n", force, "N"), duct_leak=force)


def _cubic_drag(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    return changed(p, {"c_s_m2": Number(size, "s/m^2")}, drag_cubic=size * p.mass)


def _periodic_force(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    force, hz = direction(rng, size * p.mass), float(rng.uniform(0.7, 2.0))
    truth = {**vector("force_{}_n", force, "N"), "frequency_hz": Number(hz, "Hz")}
    return changed(p, truth, shudder=force, shudder_hz=hz)


def _yaw_rate_pitch_torque(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    k = sign(rng) * size * float(p.inertia[1])
    return changed(p, {"k_n_m_s": Number(k, "N*m*s")}, pitch_per_yaw=k)


def _one_sided_drag(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    return changed(p, {"k_1_s": Number(size, "1/s")}, lee_drag=size * p.mass)


FORCES = (
    Hidden("rotor_drag", (0.1, 0.3, 0.6), _rotor_drag),
    Hidden("parasitic_drag", (0.012, 0.035, 0.08), _parasitic_drag),
    Hidden("induced_inflow", (0.25, 0.7, 1.6), _induced_inflow),
    Hidden("translational_lift", (0.2, 0.5, 1.0), _translational_lift),
    Hidden("blade_flapping", (0.006, 0.018, 0.035), _blade_flapping),
    Hidden("steady_wind", (1.5, 3.5, 7.0), _steady_wind),
    Hidden("gust", (0.7, 1.6, 3.0), _gust),
    Hidden("ground_effect", (2.0, 4.5, 7.5), _ground_effect),
    Hidden("thrust_scale", (0.04, 0.08, 0.15), _thrust_scale),
    Hidden("thrust_curve", (0.08, 0.18, 0.35), _thrust_curve),
    Hidden("battery_sag", (0.5, 1.0, 2.0), _battery_sag),
    Hidden("motor_lag", (0.008, 0.02, 0.045), _motor_lag),
    Hidden("rotor_efficiency_loss", (0.05, 0.1, 0.18), _rotor_efficiency_loss),
    Hidden("rotor_inertia_torque", (0.4, 1.0, 2.0), _rotor_inertia_torque),
    Hidden("gyroscopic_torque", (1.0, 2.5, 5.0), _gyroscopic_torque),
    Hidden("yaw_torque_scale", (0.15, 0.35, 0.8), _yaw_torque_scale),
    Hidden("thrust_tilt", (0.01, 0.025, 0.05), _thrust_tilt),
    Hidden("mass_offset", (0.03, 0.08, 0.16), _mass_offset),
    Hidden("cog_offset", (0.01, 0.03, 0.07), _cog_offset),
    Hidden("inertia_error", (0.12, 0.25, 0.45), _inertia_error),
    Hidden("slung_load", (0.05, 0.1, 0.2), _slung_load),
)
OUTSIDE = (
    Hidden("duct_leak", (0.03, 0.08, 0.16), _duct_leak, outside=True),
    Hidden("cubic_drag", (0.004, 0.01, 0.025), _cubic_drag, outside=True),
    Hidden("periodic_force", (0.1, 0.3, 0.8), _periodic_force, outside=True),
    Hidden("yaw_rate_pitch_torque", (0.5, 1.5, 4.0), _yaw_rate_pitch_torque, outside=True),
    Hidden("one_sided_drag", (0.12, 0.35, 0.8), _one_sided_drag, outside=True),
)


_SOFT = ("xx", "yy", "zz", "xy", "xz", "yz")


def _accel_bias(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    bias = direction(rng, size)
    return changed(p, vector("{}_m_s2", bias, "m/s^2"), accel_bias=bias)


def _accel_scale(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    scale = 1 + uneven(rng, size)
    return changed(p, factors("{}", scale), accel_scale=scale)


def _accel_misalignment(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    turn = direction(rng, size)
    return changed(p, vector("{}_rad", turn, "rad"), accel_turn=turn)


def _imu_lever_arm(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    arm = direction(rng, size * a.arm)
    return changed(p, vector("{}_m", arm, "m"), imu_arm=p.imu_arm + arm)


def _gyro_bias(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    bias = direction(rng, size)
    return changed(p, vector("{}_rad_s", bias, "rad/s"), gyro_bias=bias)


def _gyro_scale(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    scale = 1 + uneven(rng, size)
    return changed(p, factors("{}", scale), gyro_scale=scale)


def _sensor_noise_level(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    return changed(p, {"scale": factor(size)}, noise_scale=size)


def _vibration(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    turn = 0.02 * size
    truth = {
        "frequency_hz": Number(p.hover_speed / (2 * np.pi), "Hz"),
        "accel_m_s2": Number(size, "m/s^2", False),
        "gyro_rad_s": Number(turn, "rad/s", False),
    }
    return changed(p, truth, shake_accel=size, shake_gyro=turn)


def _stuck_sensor(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """A channel stands still over the last part of the flight, a share of `size`."""
    channel = float(rng.integers(1, 7))
    time = round((1 - size) * DURATION_S, 3)
    truth = {"channel": Number(channel, "1"), "time_s": Number(time, "s")}
    return changed(p, truth, stuck_channel=channel, stuck_time=time)


def _mag_hard_iron(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    field = direction(rng, size)
    return changed(p, vector("{}_t", field, "T"), mag_hard=field)


def _mag_soft_iron(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    own, other = uneven(rng, size), 0.6 * uneven(rng, size)
    soft = np.diag(1 + own)
    for (i, j), v in zip(((0, 1), (0, 2), (1, 2)), other, strict=True):
        soft[i, j] = soft[j, i] = v
    values = [*(1 + own), *other]
    truth = {
        k: Number(float(v), "1", neutral=float(k[0] == k[1]))
        for k, v in zip(_SOFT, values, strict=True)
    }
    return changed(p, truth, mag_soft=soft)


def _mag_current_coupling(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    field = direction(rng, size)
    return changed(p, vector("{}_t_a", field, "T/A"), mag_per_current=field)


def _heading_offset(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    yaw = sign(rng) * size
    return changed(p, {"yaw_rad": Number(yaw, "rad")}, heading=yaw)


def _baro_bias(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    bias = sign(rng) * size
    return changed(p, {"pa": Number(bias, "Pa")}, baro_bias=bias)


def _baro_dynamic_pressure(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    share = sign(rng) * size
    return changed(p, {"share": Number(share, "1")}, baro_dynamic=share)


def _steps(size: float) -> tuple[int, dict[str, Number]]:
    steps = max(round(size / STEP_S), 1)
    return steps, {"delay_s": Number(steps * STEP_S, "s")}


def _imu_delay(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """The log alone is late; the controller reads its gyroscope in time."""
    steps, truth = _steps(size)
    return changed(p, truth, imu_delay=steps)


def _position_delay(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    """Position and velocity are late; in half of the cases the attitude of the log, too."""
    steps, truth = _steps(size)
    late = float(rng.integers(2))
    truth["attitude_is_late"] = Number(late, "1")
    return changed(p, truth, position_delay=steps, late_attitude=late)


def _command_delay(p: Parameters, a: Aircraft, size: float, rng: Rng) -> Change:
    steps, truth = _steps(size)
    return changed(p, truth, command_delay=steps)


READINGS = (
    Hidden("accel_bias", (0.1, 0.25, 0.6), _accel_bias),
    Hidden("accel_scale", (0.015, 0.03, 0.06), _accel_scale),
    Hidden("accel_misalignment", (0.015, 0.03, 0.07), _accel_misalignment),
    Hidden("imu_lever_arm", (0.15, 0.35, 0.7), _imu_lever_arm),
    Hidden("gyro_bias", (0.01, 0.025, 0.06), _gyro_bias),
    Hidden("gyro_scale", (0.02, 0.05, 0.1), _gyro_scale),
    Hidden("mag_hard_iron", (2e-6, 5e-6, 12e-6), _mag_hard_iron),
    Hidden("mag_soft_iron", (0.03, 0.08, 0.15), _mag_soft_iron),
    Hidden("mag_current_coupling", (1e-7, 2.5e-7, 6e-7), _mag_current_coupling),
    Hidden("heading_offset", (0.05, 0.15, 0.4), _heading_offset),
    Hidden("baro_bias", (20.0, 60.0, 200.0), _baro_bias),
    Hidden("baro_dynamic_pressure", (0.5, 0.9, 1.25), _baro_dynamic_pressure),
    Hidden("sensor_noise_level", (1.5, 2.5, 5.0), _sensor_noise_level),
    Hidden("vibration", (0.3, 1.0, 3.0), _vibration),
    Hidden("stuck_sensor", (0.2, 0.4, 0.6), _stuck_sensor),
    Hidden("imu_delay", (0.005, 0.012, 0.025), _imu_delay),
    Hidden("position_delay", (0.02, 0.04, 0.08), _position_delay),
    Hidden("command_delay", (0.006, 0.015, 0.025), _command_delay),
)
