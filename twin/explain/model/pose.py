"""What the IMU reads against what the pose implies."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...physics.sensors.table import Sensor
from ...residuals.at_samples import resample_like, smooth_at, turning_at
from ...residuals.channels import POSE_BAND_HZ, measured, on_grid, shifted
from ...residuals.imu import OF_IMU, prompt_imu
from ...residuals.measured import AnySignal, Signal
from .factors import (
    FlightContext,
    SensorFactor,
    in_body,
    in_ned,
    moving,
    named,
    pull_of_pose,
    pull_signal,
    reaching,
    rows_of,
    shift_signs,
)
from .numbers import PLACE, TURN, values_of
from .prediction import SensorBatch

Array = NDArray[np.float64]
Sampled = Callable[[Array], Array]
AGE_S = 0.1
"""Before its end a pose is not compared: a pose that is late would show there what is not known."""


def pose_factors(context: FlightContext, force: Array) -> list[SensorFactor]:
    """What the IMU reads against what the pose implies: no physics of the vehicle in between.

    A pose is known at its samples alone, and what it implies between them is made up by splines.
    Readings pass the same, `resample_like`, or few samples a second would be taken for an average.

    The slopes are taken at the force that the airframe predicts and at the gyroscope: noise in
    a regressor would shrink what is found with it, or feign it where the residual has it too. It is
    the force of the model as it stands; those by an age, which ask how it changes in time, take
    that of the numbers in question.
    """
    t, motion, flight = context.aligned.inputs.t_s, context.aligned.motion, context.flight
    accelerometer, gyroscope = OF_IMU
    if motion.attitude is None or not flight.has(*gyroscope.columns):
        return []
    v = context.vehicle
    gyro = on_grid(Signal(*flight.signal(gyroscope.columns)), t)
    sensor = prompt_imu(v, context.effects)
    batch = SensorBatch(sensor, context.effects, context.numbers)
    implied = named("omega", turning_at(motion.attitude, t))
    read = named("omega", gyro)
    band = min(POSE_BAND_HZ, 0.2 * motion.attitude.rate_hz)
    groups: list[tuple[Sensor, Array, slice, Sampled]] = []
    q_nb, pull = smooth_at(motion.attitude, t), None
    if flight.has(*accelerometer.columns):
        pull, shown = pull_of_pose(context), pull_signal(context)
    if pull is not None and shown is not None:
        acc = on_grid(Signal(*flight.signal(accelerometer.columns)), t)
        at_samples = partial(_forces_at_samples, q_nb, t, *shown)
        alpha = named("angular_acceleration", np.gradient(gyro, t, axis=0))
        implied |= alpha | named("specific_force", in_body(q_nb, pull))
        read |= alpha | named("specific_force", force)
        groups.append((accelerometer, acc, slice(0, 3), at_samples))
    groups.append((gyroscope, gyro, slice(3, 6), partial(_turned_at_samples, t, motion.attitude)))

    def older(position_s: float, attitude_s: float) -> Array:
        """Rows with position and attitude from so many seconds later."""
        assert motion.attitude is not None and pull is not None
        q = shifted(q_nb, -attitude_s)
        pulled = in_body(q, shifted(pull, -position_s))
        return rows_of(sensor, implied | named("specific_force", pulled), len(t))

    rows, at = rows_of(sensor, implied, len(t)), rows_of(sensor, read, len(t))
    known = context.aligned.airborne & np.all(np.isfinite(rows), axis=1)
    known &= np.all(np.isfinite(at), axis=1)
    known &= t < np.max(t[known], initial=-np.inf) - AGE_S
    still = rows_of(sensor, named("specific_force", force), len(t))
    now = values_of(context.numbers, {})
    moved = batch.value(now, at) - batch.value(now, still)
    there = np.where(np.all(np.isfinite(at), axis=1)[:, None, None], np.ones((1, 3, 1)), np.nan)
    found = []
    for kind, values, outputs, sampled in groups:
        names, cutoff = tuple(f"pose_{c}" for c in kind.columns), kind.cutoff_hz(v)
        taken = sampled(values[:, :, None])[:, :, 0]
        reached = np.all(np.isfinite(sampled(there)), axis=(1, 2))  # by what numbers change, too
        readings = measured(names, kind.unit, t, taken, known & reached, band, cutoff)
        if readings is None:
            continue
        reach = reaching(kind.component) | moving(context, (*PLACE, *TURN, kind.signal))
        reach |= {n.effect for n in context.numbers if n.turns_pose}
        carried = None
        if kind is accelerometer:
            late, averaged = shift_signs(context, (kind.signal,), ()), frozenset((*PLACE, *TURN))
            carried = sampled(moved[:, outputs, None])[:, :, 0] - moved[:, outputs]
            factor = SensorFactor(
                readings, batch, rows, at, outputs, late, reach, turning=gyro, older=older
            )
        else:
            late, averaged = shift_signs(context, (kind.signal,), TURN), frozenset(TURN)
            factor = SensorFactor(readings, batch, rows, at, outputs, late, reach)
        reach |= {n.effect for n in context.numbers if set(n.averages) & averaged}
        factor = replace(factor, effects=reach, averaged=averaged, sampled=sampled, carried=carried)
        found.append(factor)
    return found


def _forces_at_samples(
    q_nb: Array, t_s: Array, pose: AnySignal, derivative: int, b: Array
) -> Array:
    """Forces in body axes, shape (n, 3, m), where what shows the acceleration was sampled."""
    each = range(b.shape[2])
    n = resample_like(np.hstack([in_ned(q_nb, b[:, :, k]) for k in each]), t_s, pose, derivative)
    return np.stack([in_body(q_nb, n[:, 3 * k : 3 * k + 3]) for k in each], axis=-1)


def _turned_at_samples(t_s: Array, attitude: AnySignal, rates: Array) -> Array:
    """Body rates, shape (n, 3, m), where the attitude was sampled."""
    return resample_like(rates.reshape(len(rates), -1), t_s, attitude, 1).reshape(rates.shape)
