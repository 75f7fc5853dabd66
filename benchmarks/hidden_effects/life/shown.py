"""How clearly one of many hidden effects shows: what it alone changes in the readings of a flight.

The flight is the one with all effects. At its true motion and commands the readings of the aircraft
with this one effect, less those of the aircraft without any, by channel, rms in the air, over what
one reading is uncertain by: its noise in the band of the residuals and, where flights have days,
the constant of a day.
"""

import numpy as np
from numpy.polynomial.polynomial import polyval
from scipy.signal import lfilter

from ..gap import AIRBORNE_M
from ..plants.aircraft import Aircraft
from ..plants.missions import CONTROL_HZ
from ..plants.noise import Noise
from ..plants.own.flight import STEPS, Trace
from ..plants.own.parameters import FIELD_T, STEP_S, Array, Batch, Parameters
from ..plants.own.physics import Dynamics, Layout, motion, own_dynamics
from ..plants.sensing import accelerometer, barometer, magnetometer
from .conditions import SENSORS, Conditions
from .days import ACCEL_BIAS_M_S2, HEADING_RAD, PRESSURE_PA

_BAND_HZ = 18.0
"""Of the residuals."""
_LEFT = float(np.sqrt(2 * _BAND_HZ / CONTROL_HZ))
"""Of white noise of the IMU in that band."""
_PER_S = 2 * np.pi * _BAND_HZ / np.sqrt(3)
"""Rms of the derivative of noise in that band over that of the noise."""


def shown(
    aircraft: Aircraft,
    alone: Parameters,
    trace: Trace,
    i: int,
    noise: Noise,
    conditions: Conditions,
    dynamics: Dynamics = own_dynamics,
) -> float:
    """Largest ratio of a channel that the log has, for the i-th flight of a trace."""
    airborne = -trace.truth[:, 2, i] > aircraft.nominal.leg + AIRBORNE_M
    changes = _changes(aircraft, alone, trace, i, dynamics)
    uncertain = _uncertain(noise, conditions)
    gone = SENSORS.get(conditions.without, ())
    return max(
        float(np.sqrt(np.mean(row[airborne] ** 2))) / uncertain[name]
        for name, rows in changes.items()
        if not name.startswith(gone or ("-",))
        for row in rows
    )


def _changes(
    aircraft: Aircraft, alone: Parameters, trace: Trace, i: int, dynamics: Dynamics
) -> dict[str, Array]:
    """Readings with the effect less those without, rows over time."""
    nominal, truth = aircraft.nominal, trace.truth[:, :, i].T
    imu_force, turning = _moved(aircraft, alone, trace, i, dynamics)
    imu_force_0, turning_0 = _moved(aircraft, nominal, trace, i, dynamics)
    late = alone.imu_delay * STEP_S
    rates, pose_late = truth[10:13], alone.position_delay * STEP_S
    acceleration = np.gradient(truth[3:6], 1 / CONTROL_HZ, axis=1)
    return {
        "acc_": accelerometer(alone, imu_force)
        - accelerometer(nominal, imu_force_0)
        - late * np.gradient(imu_force_0, 1 / CONTROL_HZ, axis=1),
        "gyro_": (alone.gyro_scale - 1)[:, None] * rates
        + alone.gyro_bias[:, None]
        - late * truth[13:16],
        "turn_": turning - turning_0,
        "mag_": magnetometer(alone, trace, i) - magnetometer(nominal, trace, i),
        "baro_": (barometer(alone, trace, i) - barometer(nominal, trace, i))[None],
        "pos_": -pose_late * truth[3:6],
        "vel_": -pose_late * acceleration,
        "att_": -pose_late * alone.late_attitude * rates,
    }


def _uncertain(noise: Noise, conditions: Conditions) -> dict[str, float]:
    """Of one reading, by channel."""
    day = float(conditions.days)
    north = float(np.hypot(*FIELD_T[:2]))
    return {
        "acc_": float(np.hypot(_LEFT * noise.accel, day * ACCEL_BIAS_M_S2)),
        "gyro_": _LEFT * noise.gyro,
        "turn_": _LEFT * noise.gyro * float(_PER_S),
        "mag_": float(np.hypot(noise.mag, day * HEADING_RAD * north)),
        "baro_": float(np.hypot(noise.baro, day * PRESSURE_PA)),
        "pos_": noise.position,
        "vel_": noise.velocity,
        "att_": noise.attitude,
    }


def _moved(
    aircraft: Aircraft, p: Parameters, trace: Trace, i: int, dynamics: Dynamics
) -> tuple[Array, Array]:
    """Specific force at the accelerometer and angular acceleration of `p` in the flown motion."""
    truth, command = trace.truth[:, :, i].T, trace.command[:, :, i].T
    batch, layout = Batch([p]), Layout(len(command))
    x = np.zeros((layout.size, truth.shape[1]))
    x[:13] = truth[:13]
    x[layout.rope][2] = 1.0
    current, voltage = truth[16:18]
    x[layout.charge] = (voltage - p.empty_v + p.resistance * current) / (p.full_v - p.empty_v)
    steps = np.arange(command.shape[1]) - p.command_delay / STEPS
    command = np.array([np.interp(steps, np.arange(len(row)), row) for row in command])
    target = polyval(command, aircraft.speed_of_command or (p.speed_0, p.speed_1))
    target = target * (voltage / p.reference_v) ** p.voltage_exponent
    stay = float(np.exp(-1 / (CONTROL_HZ * p.lag)))
    begin = np.full((len(command), 1), p.hover_speed) * stay
    x[layout.rotor] = lfilter([0.0, 1 - stay], [1.0, -stay], target, axis=1, zi=begin)[0]
    wind = np.asarray(p.wind)[:, None]
    at = motion(batch, layout, x, command, wind, 0.0, dynamics)
    return at.imu_force, at.angular_acceleration
