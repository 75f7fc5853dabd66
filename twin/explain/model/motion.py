"""What the pose shows of force and torque, where no accelerometer or gyroscope felt them.

Pose and airframe are compared without an IMU in between: the specific force where the vehicle file
has the centre of mass, and the angular acceleration. What was logged is the measurement, so that
the age of the pose and a heading that is off are put onto the prediction.
"""

from collections.abc import Collection, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...frames import to_ned
from ...logs import Flight
from ...logs.columns import ACC_NED, POS, VEL
from ...residuals.channels import (
    POSE_BAND_HZ,
    Measured,
    measured,
    on_grid,
    rate_over_step,
    shifted,
)
from ...residuals.measured import Signal, rates_of
from .factors import (
    FlightContext,
    SensorFactor,
    driven_apart,
    in_body,
    moving,
    pull_of_pose,
    reaching,
)
from .numbers import ACCELEROMETER, DRIVES, GYROSCOPE, PLACE, TURN, Number, age_of

Array = NDArray[np.float64]
FORCE, TORQUE = (tuple(f"motion_{kind}_{a}" for a in "xyz") for kind in ("acc", "rate"))
"""Names of the channels."""
SHARE_OF_RATE = 0.2
"""Band of what is differentiated once, over the rate at which it was sampled."""


def motion_factors(context: FlightContext, missing: Collection[str]) -> list[SensorFactor]:
    """Specific force and angular acceleration of the pose.

    Args:
        context: A flight and its twin.
        missing: Signals of the IMU that stand in no flight, or not in every one.
    """
    attitude = context.aligned.motion.attitude
    if attitude is None:
        return []
    t, found = context.aligned.inputs.t_s, []
    q_nb = attitude.at(t)
    band = min(POSE_BAND_HZ, SHARE_OF_RATE * attitude.rate_hz)
    reach = reaching("airframe") | moving(context, (*PLACE, *TURN, *DRIVES))
    pull = pull_of_pose(context) if ACCELEROMETER in missing else None
    if pull is not None:
        narrow = min(band, SHARE_OF_RATE * _rate_of_velocity(context.flight))
        turned = reach | {n.effect for n in context.numbers if n.turns_pose}
        shown = partial(_force_as_logged, q_nb, context.numbers)
        force = in_body(q_nb, pull)
        for axes, left_out in driven_apart(context, False):
            readings = _readings(context, FORCE[axes], "m/s²", force[:, axes], narrow, left_out)
            found.append((readings, slice(0, 3), turned, False, shown, axes))
    if GYROSCOPE in missing:
        turning = rate_over_step(on_grid(rates_of(attitude), t))
        ((_, left_out),) = driven_apart(context, True)
        readings = _readings(context, TORQUE, "rad/s²", turning, band, left_out)
        shown = partial(_torque_as_logged, context.numbers)
        found.append((readings, slice(3, 6), reach, True, shown, slice(0, 3)))
    nothing = np.zeros((0, 0))
    return [
        SensorFactor(
            readings, None, nothing, nothing, outputs, {}, effects, rate, as_logged=shown, axes=axes
        )
        for readings, outputs, effects, rate, shown, axes in found
        if readings is not None and len(readings.t_s)
    ]


def _rate_of_velocity(flight: Flight) -> float:
    """Samples per second of what the acceleration comes from; of a position, which is smoothed and
    differentiated twice, half."""
    if flight.has(*ACC_NED):
        return Signal(*flight.signal(ACC_NED)).rate_hz
    if flight.has(*VEL):
        return Signal(*flight.signal(VEL)).rate_hz
    return Signal(*flight.signal(POS)).rate_hz / 2


def _readings(
    context: FlightContext,
    names: Sequence[str],
    unit: str,
    values: Array,
    band_hz: float,
    left_out: NDArray[np.bool_] | None,
) -> Measured | None:
    known = context.aligned.airborne & np.all(np.isfinite(context.aligned.states), axis=1)
    known = known if left_out is None else known & ~left_out
    return measured(names, unit, context.aligned.inputs.t_s, values, known, band_hz, None)


def _force_as_logged(q_nb: Array, numbers: Sequence[Number], force_b: Array, theta: Array) -> Array:
    """A force in body axes, as a pose shows it.

    Args:
        q_nb: Logged attitude, shape (n, 4).
        numbers: Every number.
        force_b: On the grid, shape (n, 3).
        theta: Values of the numbers.
    """
    place_s, turn_s = (age_of(numbers, theta, signals) for signals in (PLACE, TURN))
    off_rad = float(sum(v for n, v in zip(numbers, theta, strict=True) if n.turns_pose))
    if not (place_s or turn_s or off_rad):
        return force_b
    q_then = shifted(q_nb, -turn_s)
    q_then /= np.linalg.norm(q_then, axis=1, keepdims=True)
    force_n = np.stack(to_ned(list(q_then.T), list(force_b.T)), axis=-1)
    north, east, down = shifted(force_n, place_s).T
    c, s = np.cos(off_rad), np.sin(off_rad)
    return in_body(q_nb, np.stack([c * north + s * east, c * east - s * north, down], axis=-1))


def _torque_as_logged(numbers: Sequence[Number], rates: Array, theta: Array) -> Array:
    """An angular acceleration as an old attitude shows it."""
    turn_s = age_of(numbers, theta, TURN)
    return shifted(rates, turn_s) if turn_s else rates
