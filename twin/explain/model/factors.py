"""Sensors of a flight as factors: what each measured, and its prediction from rows on the grid.

| factors | measured | predicted from |
|---|---|---|
| `imu_factors` | accelerometer, rate of change of the gyroscope | airframe and IMU |
| `other_factors` | magnetometer, barometer | pose and the sensor's equation |
| `pose_factors` | accelerometer, gyroscope | motion implied by the pose, and IMU |
| `motion_factors` | specific force and angular acceleration of the pose | airframe |

The last stand in where no accelerometer or no gyroscope was logged. Pose and airframe are compared
without an IMU in between: the specific force where the vehicle file has the centre of mass, and the
angular acceleration. What was logged is the measurement, so the age of the pose and a heading error
are put onto the prediction.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...effects import EFFECTS
from ...frames import to_body, to_ned
from ...logs import Flight
from ...logs.columns import ACC_NED, EULER, POS, VEL
from ...physics.sensors.table import Sensor
from ...representation import short_repr
from ...residuals.aligned import AlignedFlight
from ...residuals.channels import (
    OF_IMU,
    OF_POSE,
    POSE_BAND_HZ,
    Array,
    GridSpline,
    Measured,
    imu_readings,
    measured,
    named,
    on_grid,
    pose_signals,
    prompt_imu,
    rate_over_step,
    rows_along_pose,
    rows_of,
    shifted,
)
from ...residuals.measured import AnySignal, Signal, rates_of, resample_like, smooth_at, turning_at
from ...vehicle import Vehicle
from .numbers import ACCELEROMETER, DRIVES, GYROSCOPE, PLACE, TURN, Number, age_of, values_of
from .prediction import SensorBatch


@dataclass(frozen=True, slots=True)
class FlightContext:
    """A flight as read and on the grid, the model as it stands, effects in the equations, all
    switched on, and every number in the order of the prediction's."""

    flight: Flight
    vehicle: Vehicle
    aligned: AlignedFlight
    effects: Sequence[str]
    numbers: Sequence[Number]

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class SensorFactor:
    """One sensor of a flight: readings, and what predicts them from rows on the grid.

    Attributes:
        readings: Measured.
        batch: Prediction; None: that of airframe and IMU, or of the airframe alone.
        rows: Its inputs, shape (n, n_u).
        at: Inputs at which its slopes are taken, shape (n, n_u).
        outputs: Which of its outputs.
        late: Sign with which ages, "effect.number", shift the prediction.
        effects: Effects that reach the prediction.
        rate: Whether the readings are rates of change, of what the sensor reads.
        turning: Body rates, shape (n, 3), where position and attitude both make the prediction.
        older: Rows with position and attitude from so many seconds later, where they do.
        as_logged: Where the pose is what is compared with the airframe alone, no IMU in between:
            `(values on the grid, numbers) -> values` as a pose of that age and heading shows them.
        axes: Which of these are the readings.
        averaged: Signals of the pose in whose place the motion itself would be predicted from.
        sampled: `values on the grid, shape (n, k, m) -> values` as they are seen at the samples of
            the pose alone, where the readings are; None: the readings are as they were read.
        carried: What that changes of the prediction by the model as it stands, shape (n, k), where
            the motion adds to what the pose implies.
    """

    readings: Measured
    batch: SensorBatch | None
    rows: Array
    at: Array
    outputs: slice
    late: Mapping[str, float]
    effects: frozenset[str]
    rate: bool = False
    turning: Array | None = None
    older: Callable[[float, float], Array] | None = None
    as_logged: Callable[[Array, Array], Array] | None = None
    axes: slice = field(default_factory=lambda: slice(0, 3))
    averaged: frozenset[str] = frozenset()
    sampled: Callable[[Array], Array] | None = None
    carried: Array | None = None

    __repr__ = short_repr

    def seen(self, values: Array) -> Array:
        """Values on the grid, shape (n, k, m), where the readings are known; zeros stay zeros."""
        return values if self.sampled is None or not np.any(values) else self.sampled(values)


def driven_apart(
    context: FlightContext, rate: bool
) -> list[tuple[slice, NDArray[np.bool_] | None]]:
    """Axes of a specific force, or of its `rate`, an angular acceleration, and grid points to omit.

    While a motor is at a limit its command does not tell thrust and torque; what acts across the
    thrust does not depend on it.
    """
    saturated = context.aligned.saturated
    if not (saturated & context.aligned.airborne).any():
        return [(slice(0, 3), None)]
    if rate:
        return [(slice(0, 3), saturated)]
    return [(slice(0, 2), None), (slice(2, 3), saturated)]


@dataclass(frozen=True, slots=True)
class PoseAxis:
    """Axes of the pose that are compared together, grid points to omit, shape (n,), and if only
    motion below `DERIVED_BAND_HZ` is known."""

    axes: slice
    left_out: NDArray[np.bool_] | None
    slow: bool = False

    __repr__ = short_repr


def pose_axes(context: FlightContext, rate: bool) -> list[PoseAxis]:
    """Axes of a specific force, or of an angular acceleration, that the pose shows.

    An angle that was told from the force shows neither that force nor a fast turn; without a
    heading nothing across the thrust or about the vertical is known, and no turn whose angle came
    from the force.
    """
    parts = driven_apart(context, rate)
    roll, pitch, yaw = (c in context.flight.derived_angles for c in EULER)
    if not (roll or pitch or yaw):
        return [PoseAxis(*part) for part in parts]
    if rate:
        lost, slow = (roll and yaw, pitch and yaw, yaw), (roll, pitch, False)
    else:
        lost, slow = (pitch or yaw, roll or yaw, False), (False, False, False)
    return [
        PoseAxis(slice(k, k + 1), left_out, slow[k])
        for axes, left_out in parts
        for k in range(axes.start, axes.stop)
        if not lost[k]
    ]


def pull_signal(context: FlightContext) -> tuple[AnySignal, int] | None:
    """What shows the acceleration of the pose, and how often it is to be differentiated.

    The acceleration of the record where it has one, else the velocity; None without either.
    """
    if context.flight.has(*ACC_NED):
        return Signal(*context.flight.signal(ACC_NED)), 0
    velocity = context.aligned.motion.velocity
    return None if velocity is None else (velocity, 1)


def pull_of_pose(context: FlightContext) -> Array | None:
    """Acceleration that the pose shows less gravity, NED, on the grid, shape (n, 3)."""
    shown = pull_signal(context)
    if shown is None:
        return None
    signal, derivative = shown
    pull = smooth_at(signal, context.aligned.inputs.t_s, derivative)
    pull[:, 2] -= context.vehicle.gravity_m_s2
    return pull


def shift_signs(
    context: FlightContext, shown: Collection[str], measured_from: Collection[str]
) -> dict[str, float]:
    """Sign with which each age shifts a prediction: later where what is shown is old, earlier where
    what it is told from is."""
    late = {}
    for n in context.numbers:
        if set(n.moves) & set(shown):
            late[n.full] = 1.0
        elif set(n.moves) & set(measured_from):
            late[n.full] = -1.0
    return late


def moving(context: FlightContext, signals: Collection[str]) -> frozenset[str]:
    """Effects that shift some signals."""
    return frozenset(n.effect for n in context.numbers if set(n.moves) & set(signals))


def reaching(*components: str) -> frozenset[str]:
    """Effects that act on some components."""
    return frozenset(e.name for e in EFFECTS.values() if e.component in components)


def in_body(q_nb: Array, pull_n: Array) -> Array:
    """A force in NED, in body axes of unit quaternions; shape (n, 3)."""
    q = q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True)
    return np.stack(to_body(list(q.T), list(pull_n.T)), axis=-1)


def in_ned(q_nb: Array, force_b: Array) -> Array:
    """A force in body axes of unit quaternions, in NED; shape (n, 3)."""
    q = q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True)
    return np.stack(to_ned(list(q.T), list(force_b.T)), axis=-1)


# -- IMU, magnetometer, barometer ----------------------------------------------------------


def imu_factors(context: FlightContext) -> list[SensorFactor]:
    """Accelerometer, and rate of change of the gyroscope."""
    flight, nothing = context.flight, np.zeros((0, 0))
    found = []
    for k, sensor in enumerate(OF_IMU):
        if not flight.has(*sensor.columns):
            continue
        late = shift_signs(context, (sensor.signal,), ())
        reach = reaching("airframe", sensor.component) | moving(context, (*PLACE, *TURN, *DRIVES))
        reach |= {name.partition(".")[0] for name in late}
        rate = sensor.rate is not None
        for axes, left_out in driven_apart(context, rate):
            readings = imu_readings(
                sensor, flight, context.vehicle, context.aligned, axes=axes, left_out=left_out
            )
            if readings is not None:
                outputs = slice(3 * k + axes.start, 3 * k + axes.stop)
                found.append(
                    SensorFactor(readings, None, nothing, nothing, outputs, late, reach, rate)
                )
    return found


def other_factors(context: FlightContext) -> list[SensorFactor]:
    """Sensors that the pose alone tells."""
    t, flight = context.aligned.inputs.t_s, context.flight
    pose = pose_signals(context.aligned)
    if flight.derived_angles:
        pose.pop("q", None)
    found = []
    for kind in OF_POSE:
        if not flight.has(*kind.columns) or not set(kind.needs) <= pose.keys():
            continue
        sensor = kind.make(context.vehicle, context.effects)
        rows = rows_along_pose(sensor, flight, pose, t)
        signal = Signal(*flight.signal(kind.columns))
        known = context.aligned.airborne & np.all(np.isfinite(rows), axis=1)
        band = min(POSE_BAND_HZ, 0.35 * signal.rate_hz)
        cutoff = kind.cutoff_hz(context.vehicle)
        readings = measured(kind.channels, kind.unit, t, signal.at(t), known, band, cutoff)
        if readings is None:
            continue
        pose_inputs = [s for s, values in pose.items() if values.keys() & set(sensor.input_names)]
        two_clocks = bool(set(pose_inputs) & set(PLACE)) and bool(set(pose_inputs) & set(TURN))
        first = sensor.output_names.index(kind.columns[0])
        found.append(
            SensorFactor(
                readings,
                SensorBatch(sensor, context.effects, context.numbers),
                rows,
                rows,
                slice(first, first + len(kind.columns)),
                shift_signs(context, (kind.signal,), () if two_clocks else pose_inputs),
                reaching(kind.component) | moving(context, (kind.signal, *pose_inputs)),
                older=partial(_older, sensor, rows) if two_clocks else None,
            )
        )
    return found


def _older(sensor: Component, rows: Array, position_s: float, attitude_s: float) -> Array:
    """Inputs of a sensor with position and attitude from so many seconds later."""
    rows = rows.copy()
    for signals, age_s in ((PLACE, position_s), (TURN, attitude_s)):
        stems = tuple(f"{s}_" for s in signals)
        own = [i for i, n in enumerate(sensor.input_names) if n.startswith(stems)]
        if age_s and own:
            rows[:, own] = shifted(rows[:, own], -age_s)
    return rows


# -- IMU against the pose ------------------------------------------------------------------


Sampled = Callable[[Array], Array]
POSE_PASSES = 2
"""How often what a pose implies passes the low-pass. Its noise, differentiated, grows with the
frequency; what is left of it beyond half `CHANNEL_HZ` is mirrored when the channel is thinned out.
With what is there already it makes a comb over the age of the pose, of one tooth every 20 ms: 45
nats high on NanoBench's helix, in which fits ended wherever they were. Of a made burst it is 260 by
one pass and all bands, 45 by one and those below `OF_POSE_HZ`, 6 by two and these.
"""
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

    turned, pulls = GridSpline(q_nb), None if pull is None else GridSpline(pull)

    def older(position_s: float, attitude_s: float) -> Array:
        """Rows with position and attitude from so many seconds later."""
        assert pulls is not None
        pulled = in_body(turned.later(-attitude_s), pulls.later(-position_s))
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
        there_too = known & reached
        readings = measured(names, kind.unit, t, taken, there_too, band, cutoff, passes=POSE_PASSES)
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


# -- airframe against the pose -------------------------------------------------------------


FORCE, TORQUE = (tuple(f"motion_{kind}_{a}" for a in "xyz") for kind in ("acc", "rate"))
"""Names of the channels."""
SHARE_OF_RATE = 0.2
"""Band of what is differentiated once, over the rate at which it was sampled."""
DERIVED_BAND_HZ = 1.0
"""Band of the angular acceleration of an angle that was told from the force: a fifth of that of the
force, so that its low-pass takes nothing of it."""


def motion_factors(context: FlightContext, missing: Collection[str]) -> list[SensorFactor]:
    """Specific force and angular acceleration of the pose."""
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
        for part in pose_axes(context, False):
            readings = _readings(context, FORCE, "m/s²", force, narrow, part)
            found.append((readings, slice(0, 3), turned, False, shown, part.axes))
    if GYROSCOPE in missing:
        turning = rate_over_step(on_grid(rates_of(attitude), t))
        shown = partial(_torque_as_logged, context.numbers)
        for part in pose_axes(context, True):
            readings = _readings(context, TORQUE, "rad/s²", turning, band, part)
            found.append((readings, slice(3, 6), reach, True, shown, part.axes))
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
    part: PoseAxis,
) -> Measured | None:
    known = context.aligned.airborne & np.all(np.isfinite(context.aligned.states), axis=1)
    known = known if part.left_out is None else known & ~part.left_out
    band_hz = min(band_hz, DERIVED_BAND_HZ) if part.slow else band_hz
    t_s, axes = context.aligned.inputs.t_s, part.axes
    return measured(names[axes], unit, t_s, values[:, axes], known, band_hz, None)


def _force_as_logged(q_nb: Array, numbers: Sequence[Number], force_b: Array, theta: Array) -> Array:
    """A force in body axes, as a pose shows it."""
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
