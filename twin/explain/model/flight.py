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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Equation, Observer
from ...frames import to_body, to_ned
from ...logs import Flight
from ...logs.columns import ACC
from ...residuals.aligned import AlignedFlight, align_flight
from ...residuals.channels import GRID_HZ, ChannelData, mean_over_step, on_grid, shifted
from ...residuals.measured import Signal
from ...residuals.teacher_forced import airframe_inputs, measured_states
from ...vehicle import Vehicle
from .numbers import Number, with_effects
from .prediction import Physics
from .sensors import PLACE, TURN, Seen, imu_parts, other_parts, pose_parts

Array = NDArray[np.float64]
AGE_STEP_S = 0.01
"""By which the age of what a prediction is made from is moved where its answer is a difference."""
COMMANDS = ("cmd",)


class FlightModel:
    """One flight on a grid of `GRID_HZ`."""

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
        self._physics, self._effects = physics, list(effects)
        self._observers = {name: o for name in effects if (o := _observer(name)) is not None}
        self._stateful = sorted(
            {n.effect for n in numbers if self._reached(n.full)} - self._observers.keys()
        )
        on = with_effects(vehicle, self._stateful, {})
        self.aligned = align_flight(flight, on, 1 / GRID_HZ, effects)
        self._now = np.array([n.now for n in numbers])
        self._forces = {name: self._felt_beyond(name) for name in self._observers}
        self._courses: dict[tuple[str, tuple[float, ...]], Any] = {}
        self.aligned = replace(self.aligned, states=self._observed(self.aligned.states, self._now))
        seen = Seen(flight, vehicle, self.aligned, self._effects, self.numbers)
        force = physics.value(self._now, self.aligned.states, self.aligned.inputs.u)[:, :3]
        self._parts = imu_parts(seen) + pose_parts(seen, force) + other_parts(seen)
        self._integrated: dict[tuple[tuple[str, float], ...], AlignedFlight] = {}
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
        for k, part in enumerate(self._parts):
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
            part = self._parts[k]
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
        part, theta = self._parts[k], self._theta(change)
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
        theta, (states, inputs) = self._theta(change), self._moved(change)
        value = self._physics.value(theta, states, inputs)
        slopes = self._physics.slopes(columns, theta, states, inputs)
        for k, i in enumerate(columns):
            step = self._difference_step(i, change)
            if step is not None:
                more, ahead = {**change, self.numbers[i].full: theta[i] + step}, theta.copy()
                ahead[i] += step
                slopes[:, :, k] = (self._physics.value(ahead, *self._moved(more)) - value) / step
        return value, slopes

    def _theta(self, change: Mapping[str, float]) -> Array:
        """Every number, changed or as it is."""
        return np.array([change.get(n.full, n.now) for n in self.numbers])

    def _difference_step(self, i: int, change: Mapping[str, float]) -> float | None:
        """Step of a number whose answer is no derivative of the equations at given states."""
        n = self.numbers[i]
        if set(n.moves) & {*PLACE, *TURN, *COMMANDS}:
            return AGE_STEP_S
        if i in self._physics.of_sensor or self._is_integrated(n.full, {**change, n.full: n.now}):
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
        part = self._parts[k]
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
        part, moves = self._parts[k], set(self.numbers[i].moves)
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
        part = self._parts[k]
        ages = self._age(theta, PLACE), self._age(theta, TURN)
        if part.older is None or not any(ages):
            return self._standing(k, part.rows)
        assert part.batch is not None
        return part.batch.value(self._now, part.older(*ages))

    def _age(self, theta: Array, signals: Sequence[str]) -> float:
        """By how much some signals of the pose are older than the record says, s."""
        own = (set(n.moves) & set(signals) and not n.acts for n in self.numbers)
        return float(sum(v for v, mine in zip(theta, own, strict=True) if mine))

    def _standing(self, k: int, rows: Array) -> Array:
        """Prediction of the model as it stands, from one of the two kinds of rows of a part."""
        batch = self._parts[k].batch
        assert batch is not None
        key = k, rows is self._parts[k].at
        if key not in self._predicted:
            self._predicted[key] = batch.value(self._now, rows)
        return self._predicted[key]

    def _turned(self, force_b: Array) -> Array:
        """Change of a force in body axes per angle by which the measured heading is off."""
        assert self.aligned.motion.attitude is not None
        q = list(self.aligned.motion.attitude.at(self.aligned.inputs.t_s).T)
        north, east, _ = to_ned(q, list(force_b.T))
        return np.stack(to_body(q, [-east, north, 0 * north]), axis=-1)

    # -- states and inputs of the airframe ----------------------------------------------------

    def _reached(self, number: str) -> frozenset[int]:
        """States of the airframe that nobody measures and that answer to a number."""
        return self._physics.reached.get(number, frozenset())

    def _is_integrated(self, number: str, change: Mapping[str, float]) -> bool:
        """Whether a state that answers to a number matters: not of an effect that is at rest, and
        not followed by an observer."""
        own = number.partition(".")[0]
        if own in self._observers:
            return False
        acting = {own, *self.vehicle.effects, *(name.partition(".")[0] for name in change)}
        resting = set(self._effects) - acting | self._observers.keys()
        names = (self.aligned.airframe.states[i].name for i in self._reached(number))
        return any(name.partition(".")[0] not in resting for name in names)

    def _moved(self, change: Mapping[str, float]) -> tuple[Array, Array]:
        """States and inputs as `change` has them."""
        theta = self._theta(change)
        own = {k: v for k, v in change.items() if self._is_integrated(k, change)}
        aligned = self.aligned
        if own:
            key = tuple(sorted(own.items()))
            if key not in self._integrated:
                self._integrated[key] = self._prepared(own)
            aligned = self._integrated[key]
        states, inputs = self._in_step(aligned.states, theta), aligned.inputs.u
        states = self._observed(states, theta)
        later = sum(
            theta[i] - n.now
            for i, n in enumerate(self.numbers)
            if n.acts and set(n.moves) & {*COMMANDS}
        )
        return self._late_commands(states, inputs, later) if later else (states, inputs)

    def _in_step(self, states: Array, theta: Array) -> Array:
        """States with the ages of the pose taken out."""
        for signals in (PLACE, TURN):
            if age := self._age(theta, signals):
                stems = tuple(f"{s}_" for s in signals)
                names = [s.name for s in self.aligned.airframe.states]
                own = [i for i, name in enumerate(names) if name.startswith(stems)]
                states = states.copy()
                states[:, own] = shifted(states[:, own], -age)
        return states

    def _prepared(self, values: Mapping[str, float]) -> AlignedFlight:
        """The flight on its grid, unmeasured states integrated with effects that move them."""
        effects = {name.partition(".")[0] for name in values}
        known = {v.name for v in self.aligned.airframe.parameters}
        on = {f"{e}.enabled": 1.0 for e in effects}
        moving = effects | {*self._stateful}
        starts = on | {n.full: n.now for n in self.numbers if n.effect in moving} | dict(values)
        body = self.aligned.airframe.with_starts({k: v for k, v in starts.items() if k in known})
        inputs = airframe_inputs(self.flight, self.vehicle, body, self.aligned.inputs.t_s)
        states = measured_states(body, self.aligned.motion, inputs)
        return replace(self.aligned, airframe=body, inputs=inputs, states=states)

    def _felt_beyond(self, effect: str) -> tuple[Array, Array]:
        """Specific force without an effect, and what is felt beyond it, NED, (n, 3) each.

        Where the former is unknown, or on the ground, the vehicle counts as held.
        """
        aligned = self.aligned
        bare = self._now.copy()
        for i, n in enumerate(self.numbers):
            if n.effect == effect and n.about.neutral is not None:
                bare[i] = n.about.neutral
        force = self._physics.value(bare, aligned.states, aligned.inputs.u)[:, :3]
        felt = np.zeros_like(force)
        if self.flight.has(*ACC):
            felt = on_grid(Signal(*self.flight.signal(ACC)), aligned.inputs.t_s) - force
        assert aligned.motion.attitude is not None
        q = list(aligned.motion.attitude.at(aligned.inputs.t_s).T)
        force_n, felt_n = (np.stack(to_ned(q, list(v.T)), axis=-1) for v in (force, felt))
        known = aligned.airborne & np.all(np.isfinite(force_n), axis=1)
        there = known & np.all(np.isfinite(felt_n), axis=1)
        return (
            np.where(known[:, None], force_n, [0.0, 0.0, -self.vehicle.gravity_m_s2]),
            np.where(there[:, None], felt_n, 0.0),
        )

    def _observed(self, states: Array, theta: Array) -> Array:
        """States with those of effects in place that an observer follows."""
        names = [s.name for s in self.aligned.airframe.states]
        for effect, observer in self._observers.items():
            free, felt = self._forces[effect]
            own = [(n, float(v)) for n, v in zip(self.numbers, theta, strict=True)]
            numbers = {n.name: v for n, v in own if n.effect == effect}
            key = effect, tuple(v for n, v in own if n.effect == effect and n.shape)
            if key not in self._courses:
                self._courses[key] = observer.follow(free, felt, numbers, 1 / GRID_HZ)
            course = self._courses[key]
            states = observer.place(states, names, course, free, numbers, self.vehicle)
        return states

    def _late_commands(self, states: Array, inputs: Array, delay_s: float) -> tuple[Array, Array]:
        """Commands, and the rotors that follow them, later by a while."""
        aligned = self.aligned
        arrived = tuple(f"{n.effect}." for n in self.numbers if n.acts)
        rotors = [
            i
            for i, s in enumerate(aligned.airframe.states)
            if s.name.startswith(("rotor_", "effort_", *arrived))
        ]
        drives = [
            i
            for i, n in enumerate(aligned.airframe.input_names)
            if n.startswith(("cmd_", "rotor_"))
        ]
        states, inputs = states.copy(), inputs.copy()
        states[:, rotors] = shifted(states[:, rotors], delay_s)
        inputs[:, drives] = shifted(inputs[:, drives], delay_s)
        return states, inputs


def _observer(effect: str) -> Observer | None:
    """What follows the states of an effect, if something does."""
    seen_as = EFFECTS[effect].seen_as
    return seen_as.observer if isinstance(seen_as, Equation) else None
