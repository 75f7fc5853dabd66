"""From the true course of a flight to the flight table that a user gets.

Sensor models: bias, scale and misalignment, IEEE Std 1293-2018 and 952-1997; iron, Gebre-Egziabher
et al., J. Aerospace Engineering 19 (2006); pressure, ISO 2533:1975.
"""

import numpy as np
import pandas as pd

from .aircraft import ACCEL_BIT_M_S2, GYRO_BIT_RAD_S
from .missions import CONTROL_HZ, Order
from .own.flight import POSE_EVERY, Trace
from .own.parameters import (
    FIELD_T,
    GRAVITY_M_S2,
    GROUND_PRESSURE_PA,
    GROUND_TEMPERATURE_K,
    Array,
    Parameters,
)
from .own.physics import rotation, to_body, turned

SLOW_EVERY = 4
"""Samples of the IMU per sample of magnetometer and barometer."""
_AXES = "xyz"
_LAPSE_K_M, _GAS_J_KG_K = 0.0065, 287.05287


def flight_table(order: Order, trace: Trace, i: int) -> pd.DataFrame:
    """The i-th flight of a trace as a flight table."""
    rng = np.random.default_rng([*order.seed, 1])
    noise, p = order.noise, order.plant
    k = np.arange(len(trace.acc))
    pose = measured_pose(p, trace, i)
    pos = pose[:3] + trace.draws.pos[:, :, i].T
    vel = pose[3:6] + trace.draws.vel[:, :, i].T
    q = turned(pose[6:], trace.draws.attitude[:, :, i].T)
    imu = np.concatenate([accelerometer(p, trace.acc[:, :, i].T), gyroscope(p, trace, i)])
    imu[:3] += trace.draws.accel[:, :, i].T
    imu[3:] += trace.draws.gyro[:, :, i].T
    if noise.quantised:
        bit = np.array([ACCEL_BIT_M_S2] * 3 + [GYRO_BIT_RAD_S] * 3)[:, None]
        imu = bit * np.round(imu / bit)
    if p.stuck_channel:
        channel = round(p.stuck_channel) - 1
        since = int(np.searchsorted(k / CONTROL_HZ, p.stuck_time))
        imu[channel, since:] = imu[channel, since : since + 1]
    mag = magnetometer(p, trace, i) + noise.mag * rng.standard_normal((3, len(k)))
    baro = barometer(p, trace, i) + noise.baro * rng.standard_normal(len(k))
    current, voltage = trace.truth[:, 16:18, i].T

    columns: dict[str, object] = {"time": k / CONTROL_HZ}
    for m in range(trace.command.shape[1]):
        columns[f"cmd_{m + 1}"] = trace.command[:, m, i]
    for a, value in zip(_AXES, imu[:3], strict=True):
        columns[f"acc_{a}"] = value
    for a, value in zip(_AXES, imu[3:], strict=True):
        columns[f"gyro_{a}"] = value
    for a, value in zip(_AXES, mag, strict=True):
        columns[f"mag_{a}"] = _every(value, SLOW_EVERY)
    columns["baro_pa"] = _every(baro, SLOW_EVERY)
    for name, vector in (("pos", pos), ("vel", vel)):
        for a, value in zip(_AXES, vector, strict=True):
            columns[f"{name}_{a}"] = _every(value, POSE_EVERY)
    for a, value in zip("wxyz", q, strict=True):
        columns[f"q_{a}"] = _every(value, POSE_EVERY)
    columns["vbat_v"] = voltage + noise.voltage * rng.standard_normal(len(k))
    columns["ibat_a"] = current * (1 + 0.01 * np.sign(noise.accel) * rng.standard_normal(len(k)))
    columns["phase"] = order.setpoints.phase.astype(object)
    return pd.DataFrame(columns)


def accelerometer(p: Parameters, specific_force: Array) -> Array:
    """Reading without noise: turned sensor, scale, bias; shape (3, k)."""
    w = 0.5 * p.accel_turn
    q = np.concatenate([[np.sqrt(1 - w @ w)], w])[:, None]
    inside = to_body(rotation(q), specific_force)
    return np.asarray(p.accel_scale[:, None] * inside + p.accel_bias[:, None])


def gyroscope(p: Parameters, trace: Trace, i: int) -> Array:
    """Reading without noise, shape (3, k)."""
    return np.asarray(p.gyro_scale[:, None] * trace.gyro[:, :, i].T + p.gyro_bias[:, None])


def measured_pose(p: Parameters, trace: Trace, i: int) -> Array:
    """Position, velocity and attitude of the position sensor without noise, shape (10, k)."""
    attitude = trace.pose[:, 6:, i] if p.late_attitude else trace.truth[:, 6:10, i]
    return np.concatenate([trace.pose[:, :6, i].T, attitude.T])


def magnetometer(p: Parameters, trace: Trace, i: int) -> Array:
    """Reading without noise, shape (3, k)."""
    c, s = np.cos(p.heading), np.sin(p.heading)
    north, east, down = FIELD_T
    field = np.array([c * north + s * east, c * east - s * north, down])
    there = to_body(rotation(trace.truth[:, 6:10, i].T), field[:, None])
    seen = (p.mag_soft[:, :, None] * there).sum(axis=1)
    return np.asarray(
        seen + p.mag_hard[:, None] + np.outer(p.mag_per_current, trace.truth[:, 16, i])
    )


def barometer(p: Parameters, trace: Trace, i: int) -> Array:
    """Reading without noise, Pa, shape (k,)."""
    warmer = 1 + _LAPSE_K_M * trace.truth[:, 2, i] / GROUND_TEMPERATURE_K
    static = GROUND_PRESSURE_PA * warmer ** (GRAVITY_M_S2 / (_GAS_J_KG_K * _LAPSE_K_M))
    density = static / (_GAS_J_KG_K * GROUND_TEMPERATURE_K * warmer)
    return np.asarray(static + p.baro_bias + p.baro_dynamic * 0.5 * density * trace.truth[:, 18, i])


def _every(values: Array, step: int) -> Array:
    """NaN where there is no sample."""
    out = np.full(len(values), np.nan)
    out[::step] = values[::step]
    return out
