"""Effects of sensors and timing in our own plant."""

import numpy as np

from ..plants.aircraft import Aircraft
from ..plants.missions import DURATION_S
from ..plants.own.parameters import STEP_S, Parameters
from .effect import (
    Change,
    Hidden,
    Number,
    changed,
    direction,
    factor,
    factors,
    sign,
    uneven,
    vector,
)

Rng = np.random.Generator
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
