"""A flight and everything that predicts its readings, as a function of the effects' numbers.

| channels | measured | predicted by |
|---|---|---|
| acc_* | accelerometer | airframe and IMU at the measured motion |
| gyro_rate_* | rate of change of the gyroscope | the same |
| pose_acc_* | accelerometer | acceleration of the measured pose, and IMU |
| pose_gyro_* | gyroscope | turning of the measured attitude, and IMU |
| mag_* | magnetometer | measured attitude, and magnetometer |
| baro_pa | barometer | measured height and velocity, and barometer |
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...frames import to_body, to_ned
from ...logs import Flight
from ...residuals.channels import GRID_HZ, ChannelData, mean_over_step, shifted
from ...vehicle import Vehicle
from .numbers import COMMANDS, PLACE, TURN, Number, age_of, values_of
from .prediction import Physics
from .sensors import Seen, imu_parts, other_parts, pose_parts
from .trajectory import Trajectory

Array = NDArray[np.float64]
AGE_STEP_S = 0.01
"""By which the age of what a prediction is made from is moved where its answer is a difference."""


class FlightModel:
    """One flight on a grid of `GRID_HZ`.

    Attributes:
        flight: As read.
        vehicle: The model as it stands.
        numbers: Every number that may change, in the order of the prediction's.
        aligned: On the grid, with the model as it stands.
        parts: Its sensors, and what predicts each.
    """

    def __init__(
        self,
        flight: Flight,
        vehicle: Vehicle,
        physics: Physics,
        effects: Sequence[str],
        numbers: Sequence[Number],
    ) -> None:
        """Put the flight on the grid and filter its readings.

        Args:
            flight: As read.
            vehicle: The model as it stands.
            physics: Airframe and IMU, made with the same effects and numbers.
            effects: Effects in the equations, all switched on.
            numbers: Every number, in the order of the prediction's.
        """
        self.flight, self.vehicle, self.numbers = flight, vehicle, list(numbers)
        self._physics = physics
        self._trajectory = Trajectory(flight, vehicle, physics, effects, numbers)
        self.aligned = self._trajectory.aligned
        self._now = values_of(numbers, {})
        seen = Seen(flight, vehicle, self.aligned, effects, self.numbers)
        force = physics.value(self._now, self.aligned.states, self.aligned.inputs.u)[:, :3]
        self.parts = imu_parts(seen) + pose_parts(seen, force) + other_parts(seen)
        self._resting: dict[int, list[ChannelData]] = {}
        self._predicted: dict[tuple[int, bool], Array] = {}

    def channels(
        self, columns: Sequence[int], change: Mapping[str, float] | None = None
    ) -> list[ChannelData]:
        """Channels with some numbers changed.

        Args:
            columns: Numbers to differentiate by.
            change: "effect.number" -> value, for those that differ from the model as it stands.
        """
        change = dict(change or {})
        touched = {self.numbers[i].effect for i in columns}
        touched |= {name.partition(".")[0] for name in change}
        body: tuple[Array, Array] | None = None
        found: list[ChannelData] = []
        for k, part in enumerate(self.parts):
            if not touched & part.effects:
                found += self._untouched(k, len(columns))
                continue
            if part.batch is None:
                body = body or self._body_answers(columns, change)
            predicted, slopes = self._answers(k, columns, change, body)
            found += part.readings.channels(predicted, slopes)
        return found

    def _untouched(self, k: int, width: int) -> list[ChannelData]:
        """Channels of a part that no number in question reaches."""
        if k not in self._resting:
            part = self.parts[k]
            body = self._body_answers([], {}) if part.batch is None else None
            self._resting[k] = part.readings.channels(*self._answers(k, [], {}, body))
        return [replace(c, slopes=np.zeros((len(c.t_s), width))) for c in self._resting[k]]

    def _answers(
        self,
        k: int,
        columns: Sequence[int],
        change: Mapping[str, float],
        body: tuple[Array, Array] | None,
    ) -> tuple[Array, Array]:
        """Prediction of a part on the grid, and its slopes.

        Args:
            k: Which part.
            columns: Numbers to differentiate by.
            change: "effect.number" -> value.
            body: The same of airframe and IMU, where the part is theirs.
        """
        part, theta = self.parts[k], values_of(self.numbers, change)
        if part.batch is None:
            assert body is not None
            at, slopes = (a[:, part.outputs] for a in body)
            predicted = at
            if part.rate:
                predicted, slopes = mean_over_step(predicted), mean_over_step(slopes)
        else:
            # Numbers change what is clean: a scale below one would damp the noise of the pose.
            at = part.batch.value(theta, part.at)
            predicted = self._clean(k, theta) + (at - self._standing(k, part.at))
            predicted, at = predicted[:, part.outputs], at[:, part.outputs]
            slopes = part.batch.slopes(columns, theta, part.at)[:, part.outputs]
        return self._in_time(k, columns, theta, predicted, slopes, at)

    def _body_answers(
        self, columns: Sequence[int], change: Mapping[str, float]
    ) -> tuple[Array, Array]:
        """Prediction of airframe and IMU, and its slopes."""
        theta, (states, inputs) = values_of(self.numbers, change), self._trajectory.at(change)
        value = self._physics.value(theta, states, inputs)
        slopes = self._physics.slopes(columns, theta, states, inputs)
        for k, i in enumerate(columns):
            step = self._difference_step(i, change)
            if step is not None:
                more, ahead = {**change, self.numbers[i].full: theta[i] + step}, theta.copy()
                ahead[i] += step
                moved = self._physics.value(ahead, *self._trajectory.at(more))
                slopes[:, :, k] = (moved - value) / step
        return value, slopes

    def _difference_step(self, i: int, change: Mapping[str, float]) -> float | None:
        """Step of a number whose answer is no derivative of the equations at given states."""
        n = self.numbers[i]
        if set(n.moves) & {*PLACE, *TURN, *COMMANDS}:
            return AGE_STEP_S
        as_it_is = {**change, n.full: n.now}
        if i in self._physics.of_sensor or self._trajectory.is_integrated(n.full, as_it_is):
            return n.step
        return None

    # -- answers that are no derivatives of equations ----------------------------------------

    def _in_time(
        self,
        k: int,
        columns: Sequence[int],
        theta: Array,
        predicted: Array,
        answer: Array,
        at: Array,
    ) -> tuple[Array, Array]:
        """Ages and a turned heading, which shift or turn what is predicted."""
        part = self.parts[k]
        rate = np.gradient(at, 1 / GRID_HZ, axis=0)
        turned = None if part.turning is None else self._turned(at)
        for i, n in enumerate(self.numbers):
            if n.full in part.late and theta[i]:
                predicted = shifted(predicted, part.late[n.full] * theta[i])
            if n.turns_pose and theta[i] and turned is not None:
                predicted = predicted + theta[i] * turned
        for column, i in enumerate(columns):
            n = self.numbers[i]
            if n.full in part.late:
                answer[:, :, column] = -part.late[n.full] * rate
            elif part.turning is not None and n.turns_pose:
                answer[:, :, column] = turned
            elif part.older is not None and set(n.moves) & {*PLACE, *TURN}:
                answer[:, :, column] = self._by_age(k, i, theta, rate, at)
        return predicted, answer

    def _by_age(self, k: int, i: int, theta: Array, rate: Array, at: Array) -> Array:
        """Answer to the age of position or attitude, which both make the prediction."""
        part, moves = self.parts[k], set(self.numbers[i].moves)
        if part.turning is None:
            ahead = theta.copy()
            ahead[i] += AGE_STEP_S
            change = self._clean(k, ahead) - self._clean(k, theta)
            return np.asarray(change[:, part.outputs] / AGE_STEP_S)
        swept = np.cross(part.turning, at)
        answer = np.zeros_like(at)
        if moves & {*PLACE}:
            answer = rate + swept
        if moves & {*TURN}:
            answer = answer - swept
        return answer

    def _clean(self, k: int, theta: Array) -> Array:
        """Prediction of the model as it stands, the ages of the pose taken out."""
        part = self.parts[k]
        ages = age_of(self.numbers, theta, PLACE), age_of(self.numbers, theta, TURN)
        if part.older is None or not any(ages):
            return self._standing(k, part.rows)
        assert part.batch is not None
        return part.batch.value(self._now, part.older(*ages))

    def _standing(self, k: int, rows: Array) -> Array:
        """Prediction of the model as it stands, from one of the two kinds of rows of a part."""
        batch = self.parts[k].batch
        assert batch is not None
        key = k, rows is self.parts[k].at
        if key not in self._predicted:
            self._predicted[key] = batch.value(self._now, rows)
        return self._predicted[key]

    def _turned(self, force_b: Array) -> Array:
        """Change of a force in body axes per angle by which the measured heading is off."""
        assert self.aligned.motion.attitude is not None
        q = list(self.aligned.motion.attitude.at(self.aligned.inputs.t_s).T)
        north, east, _ = to_ned(q, list(force_b.T))
        return np.stack(to_body(q, [-east, north, 0 * north]), axis=-1)
