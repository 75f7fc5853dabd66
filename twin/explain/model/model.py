"""Predicted and measured readings of flights as a function of the effects' numbers.

| channels | measured | predicted by |
|---|---|---|
| acc_* | accelerometer | airframe and IMU at the measured motion and rates |
| gyro_rate_* | derivative of the gyroscope | airframe and IMU at the measured motion |
| pose_acc_* | accelerometer | acceleration of the measured pose, and IMU |
| pose_gyro_* | gyroscope | rotation of the measured attitude, and IMU |
| mag_* | magnetometer | measured attitude, and magnetometer |
| baro_pa | barometer | measured height and velocity, and barometer |
| motion_acc_* | acceleration of the pose minus gravity | airframe, at its centre of mass |
| motion_rate_* | angular acceleration of the pose | airframe |

The last two replace the accelerometer or gyroscope where not every flight has one.
"""

from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from ...component import Component
from ...effects import EFFECTS, Average, Displacement, Effect, Equation, Shift, acting_late
from ...errors import LogError
from ...frames import to_body, to_ned
from ...logs import Flight
from ...physics.airframe import airframe
from ...representation import ShortRepr
from ...residuals.aligned import AlignedFlight, align_flight
from ...residuals.channels import (
    GRID_HZ,
    OF_IMU,
    Array,
    ChannelData,
    GridSpline,
    averaged,
    mean_over_step,
    on_grid,
    shifted,
)
from ...residuals.measured import Signal
from ...residuals.teacher_forced import choose_drive
from ...vehicle import Vehicle
from .factors import FlightContext, imu_factors, motion_factors, other_factors, pose_factors
from .numbers import (
    DRIVES,
    PLACE,
    TURN,
    Number,
    Payloads,
    age_of,
    at_voltage,
    carrying,
    has_signal,
    numbers_of,
    numbers_of_logs,
    values_of,
    visible,
)
from .prediction import Batch, Physics, Trajectory, remembered

AGE_STEP_S = 0.002
"""Step of numerical differentiation by an age, a lag or a heading, s or rad."""
SMALL = 1e-4
"""Step of a derivative through an observer over that of the number: slack ropes bend slopes."""
SLOPES_AT_ONCE = 8
"""Number of slopes interpolated to the samples of a pose at once."""
RECENT = 2
"""Predictions per flight that are cached: slopes are requested where a residual was."""
BEND_S = 0.02
"""Step of second differences of time-averaged signals, s: accurate to 5 % at the pose's band."""


def missing_imu_signals(flights: Sequence[Flight]) -> tuple[str, ...]:
    """IMU signals that at least one flight lacks."""
    return tuple(s.signal for s in OF_IMU if not all(f.has(*s.columns) for f in flights))


def channel_names(flight: Flight, vehicle: Vehicle) -> list[str]:
    """Channels that a flight alone has, whatever the other flights lack.

    Raises:
        LogError: The flight cannot be resampled to the grid of the vehicle.
    """
    context = FlightContext(flight, vehicle, align_flight(flight, vehicle, 1 / GRID_HZ), (), ())
    force = np.zeros((len(context.aligned.inputs.t_s), 3))
    factors = imu_factors(context) + pose_factors(context, force) + other_factors(context)
    factors += motion_factors(context, missing_imu_signals([flight]))
    return [name for factor in factors for name in factor.readings.names]


def measured_turning(flight: Flight, aligned: AlignedFlight) -> Array | None:
    """Angular acceleration from the gyroscope on the grid, rad/s^2, shape (n, 3), 0 where unknown;
    None without a gyroscope."""
    _, gyroscope = OF_IMU
    if not flight.has(*gyroscope.columns):
        return None
    t = aligned.inputs.t_s
    rates = on_grid(Signal(*flight.signal(gyroscope.columns)), t)
    return np.nan_to_num(np.gradient(rates, t, axis=0))


class FlightModel:
    """Predictions of one flight on a grid of `GRID_HZ`; the pose replaces the IMU signals that are
    `missing`, by default those that the flight lacks.

    Attributes:
        flight: The flight as read.
        vehicle: Nominal model.
        numbers: All numbers that may change, in the order of the prediction's.
        aligned: The flight on the grid, with the nominal model.
        factors: Sensors of the flight with their predictions.
    """

    def __init__(
        self,
        flight: Flight,
        vehicle: Vehicle,
        physics: Physics,
        effects: Sequence[str],
        numbers: Sequence[Number],
        missing: Collection[str] | None = None,
    ) -> None:
        self.flight, self.vehicle, self.numbers = flight, vehicle, list(numbers)
        self._physics = physics
        self._trajectory = Trajectory(flight, vehicle, physics, effects, numbers)
        self.aligned = self._trajectory.aligned
        self._now = values_of(numbers, {})
        attitude = self.aligned.motion.attitude
        self._q = [] if attitude is None else list(attitude.at(self.aligned.inputs.t_s).T)
        context = FlightContext(flight, vehicle, self.aligned, effects, self.numbers)
        self._turning = measured_turning(flight, self.aligned)
        force = physics.value(self._now, self.aligned.states, self.aligned.inputs.u)[:, :3]
        self.factors = imu_factors(context) + pose_factors(context, force) + other_factors(context)
        self.factors += motion_factors(
            context, missing_imu_signals([flight]) if missing is None else missing
        )
        self._resting: dict[int, list[ChannelData]] = {}
        self._predicted: dict[tuple[int, bool], Array] = {}
        self._rates: dict[int, GridSpline] = {}
        self._shown: dict[tuple[int, bytes], tuple[Array, Array]] = {}
        self._sensed: dict[int, dict[int, tuple[bytes, Array]]] = {}
        self._values: dict[tuple[Hashable, ...], tuple[Array, tuple[Array, ...]]] = {}

    def channels(
        self, columns: Sequence[int], change: Mapping[str, float] | None = None
    ) -> list[ChannelData]:
        """Channels with some numbers changed, with slopes.

        Args:
            columns: Indices of the numbers by which to differentiate.
            change: Changed numbers, "effect.number" -> value.
        """
        change = dict(change or {})
        touched = {self.numbers[i].effect for i in columns}
        touched |= {name.partition(".")[0] for name in change}
        body: dict[bool, tuple[Array, Array]] = {}
        found: list[ChannelData] = []
        for k, factor in enumerate(self.factors):
            if not touched & factor.effects:
                found += self._untouched(k, len(columns))
                continue
            bare = factor.as_logged is not None
            if factor.batch is None and bare not in body:
                body[bare] = self._body_answers(columns, change, bare)
            predicted, slopes = self._answers(k, columns, change, body.get(bare), body.get(False))
            found += factor.readings.channels(predicted, slopes)
        return found

    def _untouched(self, k: int, width: int) -> list[ChannelData]:
        """Channels of a factor that none of these numbers affects; slopes are zero."""
        if k not in self._resting:
            factor = self.factors[k]
            bare = factor.as_logged is not None
            body = self._body_answers([], {}, bare) if factor.batch is None else None
            self._resting[k] = factor.readings.channels(*self._answers(k, [], {}, body))
        return [replace(c, slopes=np.zeros((len(c.t_s), width))) for c in self._resting[k]]

    def _answers(
        self,
        k: int,
        columns: Sequence[int],
        change: Mapping[str, float],
        body: tuple[Array, Array] | None,
        at_imu: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array]:
        """Prediction of a factor on the grid, and its slopes.

        Args:
            k: Index of the factor.
            columns: Indices of the numbers by which to differentiate.
            change: Changed numbers, "effect.number" -> value.
            body: Prediction and slopes of airframe and IMU, or of the airframe alone, if the factor
                is predicted by them.
            at_imu: Prediction and slopes of airframe and IMU, where these numbers affect them.
        """
        factor, theta = self.factors[k], values_of(self.numbers, change)
        if factor.batch is None:
            assert body is not None
            at, slopes = (a[:, factor.outputs] for a in body)
            predicted = at
            if factor.rate:
                predicted, slopes = mean_over_step(predicted), mean_over_step(slopes)
            if factor.as_logged is not None:
                shown = self._logged(factor.as_logged, columns, theta, predicted, slopes)
                return shown[0][:, factor.axes], shown[1][:, factor.axes]
        else:
            made, most = partial(self._sensed_values, k, theta), RECENT * len(self.factors)
            predicted, at = remembered(self._shown, (k, theta.tobytes()), made, most)
            slopes = self._sensed_slopes(k, columns, theta)
            if factor.turning is not None and at_imu is not None:
                at = at_imu[0][:, factor.outputs]
        return self._in_time(k, columns, theta, predicted, slopes, at)

    def _sensed_values(self, k: int, theta: Array) -> tuple[Array, Array]:
        """Prediction of a factor from the pose, and the prediction at the inputs where slopes are
        taken.

        Numbers act on the clean part only: a scale below one would also reduce the noise of the
        pose.
        """
        factor = self.factors[k]
        assert factor.batch is not None
        at = factor.batch.value(theta, factor.at)[:, factor.outputs]
        more = at - self._standing(k, factor.at)[:, factor.outputs]
        more = factor.seen(more[:, :, None])[:, :, 0]
        if factor.carried is not None:
            more = more + factor.carried
        return self._clean(k, theta)[:, factor.outputs] + more, at

    def _sensed_slopes(self, k: int, columns: Sequence[int], theta: Array) -> Array:
        """Slopes of a factor predicted from the pose, at its readings; a slope is recomputed only
        if a number on which it depends has changed."""
        factor, retained = self.factors[k], self._sensed.setdefault(k, {})
        assert factor.batch is not None
        depends = {i: factor.batch.bending(i, theta) for i in columns if factor.batch.answers(i)}
        stale = [i for i in depends if i not in retained or retained[i][0] != depends[i]]
        slopes = factor.batch.slopes(stale, theta, factor.at)[:, factor.outputs]
        some = [j for j in range(len(stale)) if np.any(slopes[:, :, j])]
        for first in range(0, len(some), SLOPES_AT_ONCE):  # in groups, to limit memory
            few = some[first : first + SLOPES_AT_ONCE]
            slopes[:, :, few] = factor.seen(slopes[:, :, few])
        retained |= {i: (depends[i], slopes[:, :, j]) for j, i in enumerate(stale)}
        found = np.zeros((len(columns), slopes.shape[1], len(slopes))).T  # zeros take no memory
        for column, i in enumerate(columns):
            if i in depends:
                found[:, :, column] = retained[i][1]
        return found

    def _body_answers(
        self, columns: Sequence[int], change: Mapping[str, float], bare: bool
    ) -> tuple[Array, Array]:
        """Prediction of airframe and IMU, or of the `bare` airframe, and its slopes."""
        theta = values_of(self.numbers, change)
        key = bare, *sorted(change.items())
        made = partial(self._valued, bare, theta, change)
        value, rows = remembered(self._values, key, made, RECENT)
        slopes = self._body(bare).slopes(columns, theta, *rows)
        for k, i in enumerate(columns):
            step = self._difference_step(i, change)
            if step is not None:
                more, ahead = {**change, self.numbers[i].full: theta[i] + step}, theta.copy()
                ahead[i] += step
                slopes[:, :, k] = (self._valued(bare, ahead, more)[0] - value) / step
        return value, slopes

    def _valued(
        self, bare: bool, theta: Array, change: Mapping[str, float]
    ) -> tuple[Array, tuple[Array, ...]]:
        """Prediction of airframe and IMU, or of the `bare` airframe, and the rows from which it was
        computed."""
        rows: tuple[Array, ...] = self._trajectory.at(change)
        body = self._body(bare)
        if body is self._physics.as_measured and self._turning is not None:
            rows = (*rows, self._turning)
        return body.value(theta, *rows), rows

    def _body(self, bare: bool) -> Physics | Batch:
        """Function that predicts airframe and IMU, or the `bare` airframe."""
        if bare:
            return self._physics.bare
        measured = None if self._turning is None else self._physics.as_measured
        return self._physics if measured is None else measured

    def _difference_step(self, i: int, change: Mapping[str, float]) -> float | None:
        """Step of numerical differentiation for a number whose effect is not a derivative of the
        equations at given states; None: the symbolic derivative is exact."""
        n = self.numbers[i]
        if set(n.moves) & {*PLACE, *TURN, *DRIVES}:
            return AGE_STEP_S
        if self._trajectory.is_followed(i, change):
            return n.step * SMALL
        as_it_is = {**change, n.full: n.now}
        if i in self._physics.of_sensor or self._trajectory.is_integrated(n.full, as_it_is):
            return min(n.step, AGE_STEP_S) if n.about.unit == "s" else n.step
        return None

    # -- answers that are no derivatives of equations ----------------------------------------

    def _logged(
        self,
        shown: Callable[[Array, Array], Array],
        columns: Sequence[int],
        theta: Array,
        predicted: Array,
        slopes: Array,
    ) -> tuple[Array, Array]:
        """Prediction and slopes, distorted by the age and heading error of the pose like the logged
        motion."""
        value = shown(predicted, theta)
        answer = np.zeros_like(slopes)
        for column, i in enumerate(columns):
            n = self.numbers[i]
            answer[:, :, column] = shown(slopes[:, :, column], theta)
            if n.turns_pose or (set(n.moves) & {*PLACE, *TURN} and not n.acts):
                ahead = theta.copy()
                ahead[i] += AGE_STEP_S
                answer[:, :, column] += (shown(predicted, ahead) - value) / AGE_STEP_S
        return value, answer

    def _in_time(
        self,
        k: int,
        columns: Sequence[int],
        theta: Array,
        predicted: Array,
        answer: Array,
        at: Array,
    ) -> tuple[Array, Array]:
        """Prediction and slopes with pose ages (time shift), time-averaging of the pose (curvature)
        and heading error (rotation)."""
        factor = self.factors[k]
        rate = cache(partial(np.gradient, at, 1 / GRID_HZ, axis=0))
        turned = cache(partial(self._turned, at))
        by_average = cache(lambda i: self._by_average(k, i, float(theta[i]), at))
        for i in np.flatnonzero(theta).tolist():
            n = self.numbers[i]
            if set(n.averages) & factor.averaged:
                predicted = predicted + by_average(i)[0]
            if n.full in factor.late:
                predicted = shifted(predicted, factor.late[n.full] * theta[i])
            if n.turns_pose and factor.turning is not None:
                predicted = predicted + theta[i] * turned()
        for column, i in enumerate(columns):
            n = self.numbers[i]
            if set(n.averages) & factor.averaged:
                answer[:, :, column] = by_average(i)[1]
            elif n.full in factor.late:
                answer[:, :, column] = -factor.late[n.full] * rate()
            elif factor.turning is not None and n.turns_pose:
                answer[:, :, column] = turned()
            elif factor.older is not None and set(n.moves) & {*PLACE, *TURN}:
                answer[:, :, column] = self._by_age(k, i, theta, rate(), at)
        return predicted, answer

    def _by_age(self, k: int, i: int, theta: Array, rate: Array, at: Array) -> Array:
        """Slope by the age of position or attitude, where both enter the prediction."""
        factor, moves = self.factors[k], set(self.numbers[i].moves)
        if factor.turning is None:
            ahead = theta.copy()
            ahead[i] += AGE_STEP_S
            change = self._clean(k, ahead) - self._clean(k, theta)
            return np.asarray(change[:, factor.outputs] / AGE_STEP_S)
        swept = np.cross(factor.turning, at)
        answer = np.zeros_like(at)
        if moves & {*PLACE}:
            answer = rate + swept
        if moves & {*TURN}:
            answer = answer - swept
        return answer

    def _by_average(self, k: int, i: int, variance_s2: float, at: Array) -> tuple[Array, Array]:
        """Change by a time average in the pose with this variance, and its slope: what the average
        took from the signal; for rotations minus half the variance times the second derivative.

        Computed from the gyroscope: the twice differentiated noise of the attitude would dominate.
        """
        turning, signals = self.factors[k].turning, set(self.numbers[i].averages)
        if turning is None:
            slope = -0.5 * _bend(at)
            return variance_s2 * slope, slope
        change, slope = np.zeros_like(at), np.zeros_like(at)
        if signals & {*PLACE}:
            force_n = np.stack(to_ned(self._q, list(at.T)), axis=-1)
            left = averaged(force_n, variance_s2)
            change = np.stack(to_body(self._q, list((force_n - left).T)), axis=-1)
            slope = -0.5 * np.stack(to_body(self._q, list(_bend(left).T)), axis=-1)
        if signals & {*TURN}:
            spline = remembered(self._rates, k, lambda: GridSpline(turning))
            ahead, back = spline.later(-BEND_S), spline.later(BEND_S)
            turned = 0.5 * np.cross((ahead - back) / (2 * BEND_S), at)
            change, slope = change + variance_s2 * turned, slope + turned
        return change, slope

    def _clean(self, k: int, theta: Array) -> Array:
        """Prediction of the nominal model, corrected for the ages of the pose."""
        factor = self.factors[k]
        ages = age_of(self.numbers, theta, PLACE), age_of(self.numbers, theta, TURN)
        if factor.older is None or not any(ages):
            return self._standing(k, factor.rows)
        assert factor.batch is not None
        return factor.batch.value(self._now, factor.older(*ages))

    def _standing(self, k: int, rows: Array) -> Array:
        """Prediction of the nominal model from one of the two kinds of rows of a factor."""
        batch = self.factors[k].batch
        assert batch is not None
        key = k, rows is self.factors[k].at
        if key not in self._predicted:
            self._predicted[key] = batch.value(self._now, rows)
        return self._predicted[key]

    def _turned(self, force_b: Array) -> Array:
        """Derivative of a force in body axes by the error of the measured heading."""
        north, east, _ = to_ned(self._q, list(force_b.T))
        return np.stack(to_body(self._q, [-east, north, 0 * north]), axis=-1)


def _bend(values: Array) -> Array:
    """Second time derivative of values on the grid, by differences over `BEND_S`."""
    spline = GridSpline(values)
    return np.asarray((spline.later(-BEND_S) - 2 * values + spline.later(BEND_S)) / BEND_S**2)


# -- flights of one vehicle ----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Model(ShortRepr):
    """Predictions of all flights of one vehicle.

    Attributes:
        vehicle: Nominal model.
        effects: Effects that are observable in all flights.
        numbers: All numbers of these effects.
        flights: Predictions of each flight.
        unobservable: Effects that do not exist in the airframe of some flight: where measured rotor
            speeds drive it, those between command and rotor.
        days: Deviations of numbers in each flight from the shared values, "effect.number" ->
            difference; empty where all flights share all numbers.
    """

    vehicle: Vehicle
    effects: tuple[str, ...]
    numbers: tuple[Number, ...]
    flights: tuple[FlightModel, ...]
    unobservable: tuple[str, ...] = ()
    days: tuple[Mapping[str, float], ...] = ()

    def channels(
        self, columns: Sequence[int], change: Mapping[str, float] | None = None
    ) -> list[list[ChannelData]]:
        """Channels of each flight; all flights have the same channels in the same order.

        Args:
            columns: Indices of the numbers by which to differentiate.
            change: Changed numbers, "effect.number" -> value.
        """
        rows = [f.channels(columns, self._of(i, change)) for i, f in enumerate(self.flights)]
        shared = [c.name for c in rows[0] if all(c.name in {d.name for d in r} for r in rows)]
        return [[next(c for c in r if c.name == name) for name in shared] for r in rows]

    def _of(self, flight: int, change: Mapping[str, float] | None) -> Mapping[str, float] | None:
        """Numbers of one flight, with its day-to-day deviations."""
        day = self.days[flight] if self.days else {}
        now = {n.full: n.now for n in self.numbers if n.full in day} | dict(change or {})
        return now | {name: now[name] + more for name, more in day.items()} if day else change


def candidates(flights: Sequence[Flight], since: bool = False) -> list[Effect]:
    """Effects with a mean whose signals all flights have.

    Args:
        flights: Flights that are compared.
        since: Whether changes since a calibration are searched; otherwise effects that no model
            lacks from the start, such as an added load, are omitted.
    """
    every = [e for e in EFFECTS.values() if has_mean(e) and visible(e, flights)]
    return [e for e in every if since or e.prior is not None or e.change is None]


def has_mean(effect: Effect) -> bool:
    """Whether an effect changes the mean of a reading."""
    return isinstance(effect.observable_as, Equation | Shift | Average | Displacement)


def model_of(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    effects: Sequence[Effect],
    progress: Callable[[float], None] = lambda _: None,
    payloads: Payloads | None = None,
) -> Model:
    """Resample flights to their grids and differentiate the model.

    Raises:
        LogError: A flight cannot be compared with this vehicle, or no flight is long enough.
    """
    masses = [(payloads or {}).get(f.name, 0.0) for f in flights]
    flown = {m: carrying(vehicle, m) for m in masses}
    kinds = [(choose_drive(f, flown[m]), m) for f, m in zip(flights, masses, strict=True)]
    standing = [e.name for e in effects if isinstance(e.observable_as, Equation)]
    bodies = {k: airframe(flown[k[1]], k[0], standing) for k in kinds}
    wanted = {e.name: e for e in (*effects, *acting_late())}.values()
    unobservable = [e.name for e in wanted if not all(_has_place(b, e) for b in bodies.values())]
    if unobservable:
        effects = [e for e in effects if e.name not in unobservable]
        standing = [name for name in standing if name not in unobservable]
        bodies = {k: airframe(flown[k[1]], k[0], standing) for k in kinds}
    own = (at_voltage(n, flights, vehicle) for n in numbers_of(effects, vehicle))
    of_logs = numbers_of_logs(effects, vehicle)
    numbers = (*(n for n in of_logs if _is_identifiable(n, flights, bodies.values())), *own)
    predicted = {k: Physics(b, flown[k[1]], standing, numbers) for k, b in bodies.items()}
    made, missing = [], missing_imu_signals(flights)
    for i, (flight, kind) in enumerate(zip(flights, kinds, strict=True)):
        made.append(
            FlightModel(flight, flown[kind[1]], predicted[kind], standing, numbers, missing)
        )
        progress((i + 1) / len(flights))
    names = tuple(e.name for e in effects)
    model = Model(vehicle, names, numbers, tuple(made), tuple(unobservable))
    if not model.channels([])[0]:
        raise LogError(
            f"{', '.join(f.name for f in flights)}: no reading that all have is known for long "
            f"enough in the air; the search needs accelerometer, gyroscope or a pose with "
            f"attitude, with motor commands, for some seconds of flight."
        )
    return model


def _is_identifiable(
    number: Number, flights: Sequence[Flight], bodies: Iterable[Component]
) -> bool:
    """Whether some flight has a signal that a number shifts or averages; true for other numbers."""
    signals = (*number.moves, *number.averages)
    drives = tuple(f"{s}_" for s in signals if s in DRIVES)
    if drives:
        return any(name.startswith(drives) for b in bodies for name in b.input_names)
    return not signals or any(has_signal(f, s) for f in flights for s in signals)


def _has_place(body: Component, effect: Effect) -> bool:
    """Whether an airframe contains the equation on which the effect acts; true for an effect of a
    sensor."""
    observable_as = effect.observable_as
    if isinstance(observable_as, Shift) and observable_as.acts:
        moved = [f"{s}_" for signals in observable_as.moves.values() for s in signals]
        return any(name.startswith(tuple(moved)) for name in body.input_names)
    if effect.component != body.name or not isinstance(observable_as, Equation):
        return True
    return any(v.name == f"{effect.name}.enabled" for v in body.parameters)
