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

from ...effects import Effect
from ...frames import to_body, to_ned
from ...logs import Flight
from ...logs.columns import ACC
from ...residuals.aligned import AlignedFlight, align_flight
from ...residuals.measured import Signal
from ...residuals.teacher_forced import airframe_inputs, measured_states
from ...vehicle import Vehicle
from .channels import GRID_HZ, ChannelData, on_grid, shifted
from .numbers import Number, with_effects
from .prediction import Batch
from .sensors import ATTITUDE_AGE, POSITION_AGE, Part, Seen, imu_parts, other_parts, pose_parts
from .slung_load_observer import hang_load, observe_swing

Array = NDArray[np.float64]
TURN = "heading_offset.pose_rad"
COMMAND_AGE = "command_delay.delay_s"
LOAD, ROPE = "slung_load.mass_kg", "slung_load.length_m"
_STEPS = dict.fromkeys((COMMAND_AGE, "motor_lag.tau_s", POSITION_AGE, ATTITUDE_AGE), 0.01)
"""Numbers whose answers are differences of two predictions, and their steps, s."""
_INTEGRATED = ("motor_lag.tau_s",)
"""Numbers that change states which nobody measures; of the load on its rope see `load`."""


def in_equations(effect: Effect) -> bool:
    """Whether the effect stands in the equations of a component, and not in time."""
    return not effect.name.endswith("_delay")


class FlightModel:
    """One flight on a grid of `GRID_HZ`."""

    def __init__(
        self,
        flight: Flight,
        vehicle: Vehicle,
        body: Batch,
        effects: Sequence[str],
        numbers: Sequence[Number],
    ) -> None:
        """Put the flight on the grid and filter its readings.

        Args:
            flight: As read.
            vehicle: The model as it stands.
            body: Of `prediction.physics`, made with the same effects and numbers.
            effects: Effects in the equations, all switched on.
            numbers: Every number, in the order of the prediction's.
        """
        self.flight, self.vehicle, self.numbers = flight, vehicle, list(numbers)
        self._body, self._effects = body, list(effects)
        moving = sorted({name.partition(".")[0] for name in _INTEGRATED} & set(effects))
        self.aligned = align_flight(flight, with_effects(vehicle, moving, {}), 1 / GRID_HZ, effects)
        self._now = np.array([n.now for n in numbers])
        self._arrived_s = next((n.now for n in numbers if n.full == COMMAND_AGE), 0.0)
        self._force_n = self._forces() if "slung_load" in effects else None
        self._swings: dict[float, tuple[Array, Array]] = {}
        self.aligned = replace(self.aligned, states=self._with_load(self.aligned.states, {}))
        seen = Seen(flight, vehicle, self.aligned, self._effects, [n.full for n in numbers])
        force = body.value(self._now, self.aligned.states, self.aligned.inputs.u)[:, :3]
        self._parts = imu_parts(seen) + pose_parts(seen, force) + other_parts(seen)
        self._states: dict[tuple[tuple[str, float], ...], AlignedFlight] = {}
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
        theta = np.array([change.get(n.full, n.now) for n in self.numbers])
        touched = {self.numbers[i].effect for i in columns}
        touched |= {name.partition(".")[0] for name in change}
        body: tuple[Array, Array] | None = None
        found: list[ChannelData] = []
        for k, part in enumerate(self._parts):
            if not touched & part.effects:
                found += self._untouched(k, len(columns))
                continue
            if part.batch is None:
                body = body or self._body_answers(columns, theta, change)
                at, answer = (a[:, part.outputs] for a in body)
                predicted = at
                if part.readings.names[0].startswith("gyro_rate"):
                    predicted, answer = _step_mean(predicted), _step_mean(answer)
            else:
                # Numbers change what is clean: a scale below one would damp the noise of the pose.
                at = part.batch.value(theta, part.at)
                predicted = self._clean(k, part, change) + (at - self._standing(k, part.at))
                predicted, at = predicted[:, part.outputs], at[:, part.outputs]
                answer = part.batch.slopes(columns, theta, part.at)[:, part.outputs]
            predicted, answer = self._in_time(part, columns, theta, predicted, answer, at)
            found += part.readings.channels(predicted, answer)
        return found

    def _untouched(self, k: int, width: int) -> list[ChannelData]:
        """Channels of a part that no number in question reaches."""
        if k not in self._resting:
            part = self._parts[k]
            if part.batch is None:
                value = self._body.value(self._now, self.aligned.states, self.aligned.inputs.u)
            else:
                value = self._standing(k, part.rows)
            predicted = value[:, part.outputs]
            if part.readings.names[0].startswith("gyro_rate"):
                predicted = _step_mean(predicted)
            nothing = np.zeros((*predicted.shape, 0))
            self._resting[k] = part.readings.channels(predicted, nothing)
        return [replace(c, slopes=np.zeros((len(c.t_s), width))) for c in self._resting[k]]

    def _body_answers(
        self, columns: Sequence[int], theta: Array, change: Mapping[str, float]
    ) -> tuple[Array, Array]:
        """Prediction of airframe and IMU, and its slopes."""
        states, inputs = self._moved(change)
        value = self._body.value(theta, states, inputs)
        slopes = self._body.slopes(columns, theta, states, inputs)
        for k, i in enumerate(columns):
            step = _STEPS.get(self.numbers[i].full)
            if step is not None:
                more, ahead = {**change, self.numbers[i].full: theta[i] + step}, theta.copy()
                ahead[i] += step
                slopes[:, :, k] = (self._body.value(ahead, *self._moved(more)) - value) / step
        return value, slopes

    # -- answers that are no derivatives of equations ----------------------------------------

    def _in_time(
        self,
        part: Part,
        columns: Sequence[int],
        theta: Array,
        predicted: Array,
        answer: Array,
        at: Array,
    ) -> tuple[Array, Array]:
        """Delays and a turned heading, which shift or turn what is predicted."""
        rate = np.gradient(at, 1 / GRID_HZ, axis=0)
        slopes = {name: -sign * rate for name, sign in part.late.items()}
        if part.turning is not None:
            swept = np.cross(part.turning, at)
            turned = self._turned(at)
            slopes |= {POSITION_AGE: rate + swept, ATTITUDE_AGE: -swept, TURN: turned}
        for i, n in enumerate(self.numbers):
            if n.full in part.late and theta[i]:
                predicted = shifted(predicted, part.late[n.full] * theta[i])
            if n.full == TURN and theta[i] and part.turning is not None:
                predicted = predicted + theta[i] * turned
        for k, i in enumerate(columns):
            if self.numbers[i].full in slopes:
                answer[:, :, k] = slopes[self.numbers[i].full]
        return predicted, answer

    def _clean(self, k: int, part: Part, change: Mapping[str, float]) -> Array:
        """Prediction of the model as it stands, the delays of the pose taken out."""
        ages = change.get(POSITION_AGE, 0.0), change.get(ATTITUDE_AGE, 0.0)
        if part.older is None or not any(ages):
            return self._standing(k, part.rows)
        assert part.batch is not None
        return part.batch.value(self._now, part.older(*ages))

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

    def _moved(self, change: Mapping[str, float]) -> tuple[Array, Array]:
        """States and inputs with the effects that have a memory as `change` has them."""
        own = {k: v for k, v in change.items() if k in _INTEGRATED}
        aligned = self.aligned
        if own:
            key = tuple(sorted(own.items()))
            if key not in self._states:
                self._states[key] = self._prepared(own)
            aligned = self._states[key]
        states, inputs = self._in_step(aligned.states, change), aligned.inputs.u
        states = self._with_load(states, change)
        later = change[COMMAND_AGE] - self._arrived_s if COMMAND_AGE in change else 0.0
        return self._late_commands(states, inputs, later) if later else (states, inputs)

    def _in_step(self, states: Array, change: Mapping[str, float]) -> Array:
        """States with the delays of the pose taken out."""
        for name, stems in ((POSITION_AGE, ("pos_", "vel_")), (ATTITUDE_AGE, ("q_",))):
            if age := change.get(name, 0.0):
                own = [
                    i
                    for i, s in enumerate(self.aligned.airframe.states)
                    if s.name.startswith(stems)
                ]
                states = states.copy()
                states[:, own] = shifted(states[:, own], -age)
        return states

    def _prepared(self, values: Mapping[str, float]) -> AlignedFlight:
        """The flight on its grid, unmeasured states integrated with effects that move them."""
        moving = {name.partition(".")[0] for name in _INTEGRATED} & set(self._effects)
        starts = {n.full: n.now for n in self.numbers if n.effect in moving} | dict(values)
        body = self.aligned.airframe.with_starts(starts)
        inputs = airframe_inputs(self.flight, self.vehicle, body, self.aligned.inputs.t_s)
        states = measured_states(body, self.aligned.motion, inputs)
        return replace(self.aligned, airframe=body, inputs=inputs, states=states)

    def _forces(self) -> tuple[Array, Array]:
        """Specific force without a load on a rope, and what is felt beyond it, NED, (n, 3) each.

        Where the former is unknown, or on the ground, the vehicle counts as held.
        """
        aligned = self.aligned
        bare = np.where([n.full == LOAD for n in self.numbers], 0.0, self._now)
        force = self._body.value(bare, aligned.states, aligned.inputs.u)[:, :3]
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

    def _with_load(self, states: Array, change: Mapping[str, float]) -> Array:
        """States with the load on its rope where it swings."""
        if self._force_n is None:
            return states
        now = {n.full: n.now for n in self.numbers} | dict(change)
        length = now[ROPE]
        if length not in self._swings:
            self._swings[length] = observe_swing(*self._force_n, length, 1 / GRID_HZ)
        names = [s.name for s in self.aligned.airframe.states]
        share = now[LOAD] / self.vehicle.mass_kg
        return hang_load(states, names, self._swings[length], self._force_n[0], length, share)

    def _late_commands(self, states: Array, inputs: Array, delay_s: float) -> tuple[Array, Array]:
        """Commands, and the rotors that follow them, later by a while."""
        aligned = self.aligned
        rotors = [
            i
            for i, s in enumerate(aligned.airframe.states)
            if s.name.startswith(("rotor_", "effort_", "command_delay."))
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


def _step_mean(values: Array) -> Array:
    """Mean over the step of the grid that ends at each row."""
    mean = np.array(values)
    mean[1:] = (values[1:] + values[:-1]) / 2
    return mean
