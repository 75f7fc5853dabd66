"""Sensors of a flight as factors: readings, and their prediction from rows on the grid.

| factors | measured | predicted from |
|---|---|---|
| `imu_factors` | accelerometer, derivative of the gyroscope | airframe and IMU |
| `other_factors` | magnetometer, barometer | pose and the sensor's equation |
| `pose_factors` | accelerometer, gyroscope | motion implied by the pose, and IMU |
| `motion_factors` | specific force and angular acceleration of the pose | airframe |

The last is used where no accelerometer or no gyroscope was logged. Pose and airframe are then
compared without an IMU in between: the specific force at the centre of mass of the vehicle file,
and the angular acceleration. The logged pose is the measurement, so its age and heading error are
applied to the prediction.
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
from ...representation import ShortRepr
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
class FlightContext(ShortRepr):
    """Context of a flight: the record, its grid, the nominal model, all effects enabled in the
    equations, and all numbers in the order of the prediction's."""

    flight: Flight
    vehicle: Vehicle
    aligned: AlignedFlight
    effects: Sequence[str]
    numbers: Sequence[Number]


@dataclass(frozen=True, slots=True)
class SensorFactor(ShortRepr):
    """One sensor of a flight: readings, and their prediction from rows on the grid.

    Attributes:
        readings: Measured readings.
        batch: Prediction function; None: that of airframe and IMU, or of the airframe alone.
        rows: Inputs of the prediction, shape (n, n_u).
        at: Inputs at which the slopes are taken, shape (n, n_u).
        outputs: Indices of the outputs that are used.
        late: Sign with which each age, "effect.number", shifts the prediction in time.
        effects: Effects on which the prediction depends.
        rate: Whether the readings are time derivatives of the sensor's signal.
        turning: Body rates, rad/s, shape (n, 3), where position and attitude both enter the
            prediction.
        older: Function that returns rows with position and attitude taken later by two times in s,
            where ages matter.
        as_logged: Function `(values on the grid, numbers) -> values` that applies the age and
            heading error of the pose, where the pose is compared with the airframe directly; else
            None.
        axes: Axes of the prediction that are readings.
        averaged: Pose signals that are time-averaged and enter the prediction.
        sampled: Function `values on the grid, shape (n, k, m) -> values` that samples and
            interpolates like the pose; None: the readings are not filtered like that.
        carried: Change that `sampled` makes to the nominal prediction, shape (n, k), where the
            motion adds to what the pose implies.
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

    def seen(self, values: Array) -> Array:
        """Values on the grid, shape (n, k, m), at the known readings; zeros stay zeros."""
        return values if self.sampled is None or not np.any(values) else self.sampled(values)


def driven_apart(
    context: FlightContext, rate: bool
) -> list[tuple[slice, NDArray[np.bool_] | None]]:
    """Axes of a specific force, or of an angular acceleration (`rate`), with the grid points to
    omit.

    While a motor is saturated, thrust and torque do not follow its command; forces across the
    thrust do not depend on it.
    """
    saturated = context.aligned.saturated
    if not (saturated & context.aligned.airborne).any():
        return [(slice(0, 3), None)]
    if rate:
        return [(slice(0, 3), saturated)]
    return [(slice(0, 2), None), (slice(2, 3), saturated)]


@dataclass(frozen=True, slots=True)
class PoseAxis(ShortRepr):
    """Axes of the pose that are compared together, grid points to omit, shape (n,), and whether
    only motion below `DERIVED_BAND_HZ` is known."""

    axes: slice
    left_out: NDArray[np.bool_] | None
    slow: bool = False


def pose_axes(context: FlightContext, rate: bool) -> list[PoseAxis]:
    """Axes of a specific force, or of an angular acceleration, that can be derived from the pose.

    An attitude derived from the force contains no information on that force or on fast rotation;
    without a heading, forces across the thrust and rotation about the vertical are unknown.
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
    """Signal from which the acceleration of the pose is computed, and its number of
    differentiations.

    The logged acceleration where there is one, else the velocity; None without either.
    """
    if context.flight.has(*ACC_NED):
        return Signal(*context.flight.signal(ACC_NED)), 0
    velocity = context.aligned.motion.velocity
    return None if velocity is None else (velocity, 1)


def pull_of_pose(context: FlightContext) -> Array | None:
    """Acceleration of the pose minus gravity, NED, m/s^2, on the grid, shape (n, 3)."""
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
    """Sign with which each age shifts a prediction: later if the measured signal is old, earlier if
    an input of the prediction is."""
    late = {}
    for n in context.numbers:
        if set(n.moves) & set(shown):
            late[n.full] = 1.0
        elif set(n.moves) & set(measured_from):
            late[n.full] = -1.0
    return late


def moving(context: FlightContext, signals: Collection[str]) -> frozenset[str]:
    """Effects that shift some signals in time."""
    return frozenset(n.effect for n in context.numbers if set(n.moves) & set(signals))


def reaching(*components: str) -> frozenset[str]:
    """Effects that act on some components."""
    return frozenset(e.name for e in EFFECTS.values() if e.component in components)


def in_body(q_nb: Array, pull_n: Array) -> Array:
    """Rotate forces from NED to body axes by unit quaternions; shape (n, 3)."""
    q = q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True)
    return np.stack(to_body(list(q.T), list(pull_n.T)), axis=-1)


def in_ned(q_nb: Array, force_b: Array) -> Array:
    """Rotate forces from body axes to NED by unit quaternions; shape (n, 3)."""
    q = q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True)
    return np.stack(to_ned(list(q.T), list(force_b.T)), axis=-1)


# -- IMU, magnetometer, barometer ----------------------------------------------------------


def imu_factors(context: FlightContext) -> list[SensorFactor]:
    """Factors of the accelerometer, and of the derivative of the gyroscope."""
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
    """Factors of sensors that are predicted from the pose alone."""
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
        half, names = signal.rate_hz / 2, kind.channels
        readings = measured(names, kind.unit, t, signal.at(t), known, band, cutoff, half)
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
    """Inputs of a sensor with position and attitude taken later by these times, s."""
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
"""Number of passes of a pose's prediction through the low-pass: its differentiated noise above half
of `CHANNEL_HZ` is aliased when the channel is decimated, and the likelihood then a comb over the
age of the pose."""
AGE_S = 0.1
"""Time before the end of a pose that is not compared, s: of a delayed pose it is unknown."""


def pose_factors(context: FlightContext, force: Array) -> list[SensorFactor]:
    """Factors that compare the IMU readings with those implied by the pose, without physics of the
    vehicle.

    A pose is known only at its samples; between them, splines interpolate. Readings are filtered in
    the same way by `resample_like`. Slopes use the force predicted by the airframe and the
    gyroscope, as noise in a regressor would bias its estimate. The force is that of the nominal
    model; slopes by an age, which need its time derivative, use the current numbers.
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
    rate_hz = motion.attitude.rate_hz
    groups: list[tuple[Sensor, Array, slice, Sampled, float]] = []
    q_nb, pull = smooth_at(motion.attitude, t), None
    if flight.has(*accelerometer.columns):
        pull, shown = pull_of_pose(context), pull_signal(context)
    if pull is not None and shown is not None:
        acc = on_grid(Signal(*flight.signal(accelerometer.columns)), t)
        at_samples = partial(_forces_at_samples, q_nb, t, *shown)
        alpha = named("angular_acceleration", np.gradient(gyro, t, axis=0))
        implied |= alpha | named("specific_force", in_body(q_nb, pull))
        read |= alpha | named("specific_force", force)
        slower_hz = min(rate_hz, _rate_of_velocity(flight))
        groups.append((accelerometer, acc, slice(0, 3), at_samples, slower_hz))
    turned_at = partial(_turned_at_samples, t, motion.attitude)
    groups.append((gyroscope, gyro, slice(3, 6), turned_at, rate_hz))

    turned, pulls = GridSpline(q_nb), None if pull is None else GridSpline(pull)

    def older(position_s: float, attitude_s: float) -> Array:
        """Rows with position and attitude taken later by these times, s."""
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
    for kind, values, outputs, sampled, rate_hz in groups:
        bands = min(POSE_BAND_HZ, SHARE_OF_RATE * rate_hz), kind.cutoff_hz(v), rate_hz / 2
        names = tuple(f"pose_{c}" for c in kind.columns)
        taken = sampled(values[:, :, None])[:, :, 0]
        known_too = known & np.all(np.isfinite(sampled(there)), axis=(1, 2))  # at any numbers
        early_s = flight.filter_delays_s.get(kind.signal, 0.0)
        readings = measured(
            names, kind.unit, t, taken, known_too, *bands, passes=POSE_PASSES, early_s=early_s
        )
        if readings is None:
            continue
        reach = reaching(kind.component) | moving(context, (*PLACE, *TURN, kind.signal))
        reach |= {n.effect for n in context.numbers if n.turns_pose}
        carried = None
        reach |= {n.effect for n in context.numbers if n.less and n.less.partition(".")[0] in reach}
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
    """Forces in body axes, shape (n, 3, m), with the acceleration sampled like its signal."""
    each = range(b.shape[2])
    n = resample_like(np.hstack([in_ned(q_nb, b[:, :, k]) for k in each]), t_s, pose, derivative)
    return np.stack([in_body(q_nb, n[:, 3 * k : 3 * k + 3]) for k in each], axis=-1)


def _turned_at_samples(t_s: Array, attitude: AnySignal, rates: Array) -> Array:
    """Body rates, shape (n, 3, m), sampled like the attitude."""
    return resample_like(rates.reshape(len(rates), -1), t_s, attitude, 1).reshape(rates.shape)


# -- airframe against the pose -------------------------------------------------------------


FORCE, TORQUE = (tuple(f"motion_{kind}_{a}" for a in "xyz") for kind in ("acc", "rate"))
"""Channel names of specific force and of angular acceleration."""
SHARE_OF_RATE = 0.2
"""Bandwidth of a signal that is differentiated once, as a share of its sample rate."""
DERIVED_BAND_HZ = 1.0
"""Bandwidth of the angular acceleration of an attitude derived from the force, Hz: a fifth of the
force's."""


def motion_factors(context: FlightContext, missing: Collection[str]) -> list[SensorFactor]:
    """Factors of the specific force and angular acceleration of the pose."""
    attitude = context.aligned.motion.attitude
    if attitude is None:
        return []
    t, found = context.aligned.inputs.t_s, []
    q_nb = attitude.at(t)
    reach = reaching("airframe") | moving(context, (*PLACE, *TURN, *DRIVES))
    pull = pull_of_pose(context) if ACCELEROMETER in missing else None
    if pull is not None:
        slower_hz = min(attitude.rate_hz, _rate_of_velocity(context.flight))
        turned = reach | {n.effect for n in context.numbers if n.turns_pose}
        shown = partial(_force_as_logged, q_nb, context.numbers)
        force = in_body(q_nb, pull)
        for part in pose_axes(context, False):
            readings = _readings(context, FORCE, "m/s²", force, slower_hz, part)
            found.append((readings, slice(0, 3), turned, False, shown, part.axes))
    if GYROSCOPE in missing:
        turning = rate_over_step(on_grid(rates_of(attitude), t))
        shown = partial(_torque_as_logged, context.numbers)
        for part in pose_axes(context, True):
            readings = _readings(context, TORQUE, "rad/s²", turning, attitude.rate_hz, part)
            found.append((readings, slice(3, 6), reach, True, shown, part.axes))
    nothing = np.zeros((0, 0))
    return [
        SensorFactor(
            readings, None, nothing, nothing, outputs, {}, effects, rate, as_logged=shown, axes=axes
        )
        for readings, outputs, effects, rate, shown, axes in found
        if readings is not None
    ]


def _rate_of_velocity(flight: Flight) -> float:
    """Effective sample rate of the signal behind the acceleration, Hz; half for a position, which
    is smoothed and differentiated twice."""
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
    rate_hz: float,
    part: PoseAxis,
) -> Measured | None:
    known = context.aligned.airborne & np.all(np.isfinite(context.aligned.states), axis=1)
    known = known if part.left_out is None else known & ~part.left_out
    band_hz = min(DERIVED_BAND_HZ if part.slow else POSE_BAND_HZ, SHARE_OF_RATE * rate_hz)
    t_s, axes = context.aligned.inputs.t_s, part.axes
    return measured(names[axes], unit, t_s, values[:, axes], known, band_hz, None, rate_hz / 2)


def _force_as_logged(q_nb: Array, numbers: Sequence[Number], force_b: Array, theta: Array) -> Array:
    """A force in body axes as a delayed, rotated pose shows it."""
    place_s, turn_s = (age_of(numbers, theta, signals) for signals in (PLACE, TURN))
    off_rad = float(sum(v for n, v in zip(numbers, theta, strict=True) if n.turns_pose))
    if not (place_s or turn_s or off_rad):
        return force_b
    north, east, down = shifted(in_ned(shifted(q_nb, -turn_s), force_b), place_s).T
    c, s = np.cos(off_rad), np.sin(off_rad)
    return in_body(q_nb, np.stack([c * north + s * east, c * east - s * north, down], axis=-1))


def _torque_as_logged(numbers: Sequence[Number], rates: Array, theta: Array) -> Array:
    """An angular acceleration as a delayed attitude shows it."""
    turn_s = age_of(numbers, theta, TURN)
    return shifted(rates, turn_s) if turn_s else rates
