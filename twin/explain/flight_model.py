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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..barometer import barometer
from ..component import Component
from ..effects import EFFECTS, ComponentName, Effect
from ..flightlog import Flight
from ..flightlog.columns import ACC, GYRO
from ..frames import to_body, to_ned
from ..imu import imu
from ..magnetometer import magnetometer
from ..measured import Signal, rates_of
from ..prepared import Twin, prepare
from ..teacher_forced import airframe_inputs, measured_states
from ..vehicle import GRAVITY_M_S2, Vehicle
from .channels import BAND_HZ, GRID_HZ, POSE_BAND_HZ, ChannelData, Measured, measured, on_grid
from .load import hung, swing
from .numbers import Number, with_effects
from .prediction import Batch, sensing

Array = NDArray[np.float64]
MAG = ("mag_x", "mag_y", "mag_z")


TURN = "heading_offset.pose_rad"
POSITION_AGE, ATTITUDE_AGE = "position_delay.delay_s", "position_delay.attitude_s"
IMU_AGE, COMMAND_AGE = "imu_delay.delay_s", "command_delay.delay_s"
LOAD, ROPE = "slung_load.mass_kg", "slung_load.length_m"
_STEPS = dict.fromkeys((COMMAND_AGE, "motor_lag.tau_s", POSITION_AGE, ATTITUDE_AGE), 0.01)
"""Numbers whose answers are differences of two predictions, and their steps, s."""
_INTEGRATED = ("motor_lag.tau_s",)
"""Numbers that change states which nobody measures; of the load on its rope see `load`."""


def in_equations(effect: Effect) -> bool:
    """Whether the effect stands in the equations of a component, and not in time."""
    return not effect.name.endswith("_delay")


@dataclass(frozen=True, slots=True)
class _Part:
    """One sensor of a flight: readings, and what predicts them from rows on the grid.

    Attributes:
        readings: Measured.
        batch: Prediction; None: that of airframe and IMU.
        rows: Its inputs, shape (n, n_u).
        at: Inputs at which its slopes are taken, shape (n, n_u).
        outputs: Which of its outputs.
        late: Sign with which delays, "effect.number", shift the prediction.
        effects: Effects that reach the prediction.
        turning: Body rates, shape (n, 3), where position and attitude both make the prediction.
        older: Rows with position and attitude from so many seconds later, where they do.
    """

    readings: Measured
    batch: Batch | None
    rows: Array
    at: Array
    outputs: slice
    late: Mapping[str, float]
    effects: frozenset[str]
    turning: Array | None = None
    older: Callable[[float, float], Array] | None = None


class FlightModel:
    """One flight on a grid of `GRID_HZ`."""

    def __init__(
        self, flight: Flight, vehicle: Vehicle, body: Batch, effects: Sequence[str],
        numbers: Sequence[Number],
    ) -> None:  # fmt: skip
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
        self.twin = prepare(flight, with_effects(vehicle, moving, {}), 1 / GRID_HZ, effects)
        self._now = np.array([n.now for n in numbers])
        self._arrived_s = next((n.now for n in numbers if n.full == COMMAND_AGE), 0.0)
        self._force_n = self._forces() if "slung_load" in effects else None
        self._swings: dict[float, tuple[Array, Array]] = {}
        self.twin = replace(self.twin, states=self._with_load(self.twin.states, {}))
        self._parts = self._imu_parts() + self._pose_parts() + self._other_parts()
        self._states: dict[tuple[tuple[str, float], ...], Twin] = {}
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
                value = self._body.value(self._now, self.twin.states, self.twin.inputs.u)
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
        self, part: _Part, columns: Sequence[int], theta: Array, predicted: Array, answer: Array,
        at: Array,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Delays and a turned heading, which shift or turn what is predicted."""
        rate = np.gradient(at, 1 / GRID_HZ, axis=0)
        slopes = {name: -sign * rate for name, sign in part.late.items()}
        if part.turning is not None:
            swept = np.cross(part.turning, at)
            turned = self._turned(at)
            slopes |= {POSITION_AGE: rate + swept, ATTITUDE_AGE: -swept, TURN: turned}
        for i, n in enumerate(self.numbers):
            if n.full in part.late and theta[i]:
                predicted = _shifted(predicted, part.late[n.full] * theta[i])
            if n.full == TURN and theta[i] and part.turning is not None:
                predicted = predicted + theta[i] * turned
        for k, i in enumerate(columns):
            if self.numbers[i].full in slopes:
                answer[:, :, k] = slopes[self.numbers[i].full]
        return predicted, answer

    def _clean(self, k: int, part: _Part, change: Mapping[str, float]) -> Array:
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
        assert self.twin.motion.attitude is not None
        q = list(self.twin.motion.attitude.at(self.twin.inputs.t_s).T)
        north, east, _ = to_ned(q, list(force_b.T))
        return np.stack(to_body(q, [-east, north, 0 * north]), axis=-1)

    def _moved(self, change: Mapping[str, float]) -> tuple[Array, Array]:
        """States and inputs with the effects that have a memory as `change` has them."""
        own = {k: v for k, v in change.items() if k in _INTEGRATED}
        twin = self.twin
        if own:
            key = tuple(sorted(own.items()))
            if key not in self._states:
                self._states[key] = self._prepared(own)
            twin = self._states[key]
        states, inputs = self._in_step(twin.states, change), twin.inputs.u
        states = self._with_load(states, change)
        later = change[COMMAND_AGE] - self._arrived_s if COMMAND_AGE in change else 0.0
        return self._late_commands(states, inputs, later) if later else (states, inputs)

    def _in_step(self, states: Array, change: Mapping[str, float]) -> Array:
        """States with the delays of the pose taken out."""
        for name, stems in ((POSITION_AGE, ("pos_", "vel_")), (ATTITUDE_AGE, ("q_",))):
            if age := change.get(name, 0.0):
                own = [i for i, s in enumerate(self.twin.airframe.states)
                       if s.name.startswith(stems)]  # fmt: skip
                states = states.copy()
                states[:, own] = _shifted(states[:, own], -age)
        return states

    def _prepared(self, values: Mapping[str, float]) -> Twin:
        """The flight on its grid, unmeasured states integrated with effects that move them."""
        moving = {name.partition(".")[0] for name in _INTEGRATED} & set(self._effects)
        starts = {n.full: n.now for n in self.numbers if n.effect in moving} | dict(values)
        body = self.twin.airframe.with_starts(starts)
        inputs = airframe_inputs(self.flight, self.vehicle, body, self.twin.inputs.t_s)
        states = measured_states(body, self.twin.motion, inputs)
        return replace(self.twin, airframe=body, inputs=inputs, states=states)

    def _forces(self) -> tuple[Array, Array]:
        """Specific force without a load on a rope, and what is felt beyond it, NED, (n, 3) each.

        Where the former is unknown, or on the ground, the vehicle counts as held.
        """
        twin = self.twin
        bare = np.where([n.full == LOAD for n in self.numbers], 0.0, self._now)
        force = self._body.value(bare, twin.states, twin.inputs.u)[:, :3]
        felt = np.zeros_like(force)
        if self.flight.has(*ACC):
            felt = on_grid(Signal(*self.flight.signal(ACC)), twin.inputs.t_s) - force
        assert twin.motion.attitude is not None
        q = list(twin.motion.attitude.at(twin.inputs.t_s).T)
        force_n, felt_n = (np.stack(to_ned(q, list(v.T)), axis=-1) for v in (force, felt))
        known = twin.airborne & np.all(np.isfinite(force_n), axis=1)
        there = known & np.all(np.isfinite(felt_n), axis=1)
        return (
            np.where(known[:, None], force_n, [0.0, 0.0, -GRAVITY_M_S2]),
            np.where(there[:, None], felt_n, 0.0),
        )

    def _with_load(self, states: Array, change: Mapping[str, float]) -> Array:
        """States with the load on its rope where it swings."""
        if self._force_n is None:
            return states
        now = {n.full: n.now for n in self.numbers} | dict(change)
        length = now[ROPE]
        if length not in self._swings:
            self._swings[length] = swing(*self._force_n, length, 1 / GRID_HZ)
        names = [s.name for s in self.twin.airframe.states]
        share = now[LOAD] / self.vehicle.mass_kg
        return hung(states, names, self._swings[length], self._force_n[0], length, share)

    def _late_commands(self, states: Array, inputs: Array, delay_s: float) -> tuple[Array, Array]:
        """Commands, and the rotors that follow them, later by a while."""
        twin = self.twin
        rotors = [i for i, s in enumerate(twin.airframe.states)
                  if s.name.startswith(("rotor_", "effort_", "command_delay."))]  # fmt: skip
        drives = [i for i, n in enumerate(twin.airframe.input_names)
                  if n.startswith(("cmd_", "rotor_"))]  # fmt: skip
        states, inputs = states.copy(), inputs.copy()
        states[:, rotors] = _shifted(states[:, rotors], delay_s)
        inputs[:, drives] = _shifted(inputs[:, drives], delay_s)
        return states, inputs

    # -- parts ------------------------------------------------------------------------------

    def _imu_parts(self) -> list[_Part]:
        parts: list[tuple[tuple[str, ...], str, Array, Signal, float | None, slice]] = []
        t, flight, v = self.twin.inputs.t_s, self.flight, self.vehicle
        if flight.has(*ACC):
            signal = Signal(*flight.signal(ACC))
            parts.append((ACC, "m/s²", on_grid(signal, t), signal, v.accel_cutoff_hz, slice(0, 3)))
        if flight.has(*GYRO):
            signal = Signal(*flight.signal(GYRO))
            gyro = on_grid(signal, t)
            rate = np.diff(gyro, axis=0, prepend=gyro[:1]) * GRID_HZ
            names = tuple(f"gyro_rate_{a}" for a in "xyz")
            parts.append((names, "rad/s²", rate, signal, v.gyro_cutoff_hz, slice(3, 6)))
        found = []
        known = self.twin.airborne & np.all(np.isfinite(self.twin.states), axis=1)
        for names, unit, values, signal, cutoff, outputs in parts:
            band = min(BAND_HZ, 0.35 * signal.rate_hz)
            readings = measured(names, unit, t, values, known, band, cutoff)
            if readings is not None:
                nothing = np.zeros((0, 0))
                reach = _reaching("airframe", "imu") | {"position_delay"}
                late = {IMU_AGE: 1.0}
                found.append(_Part(readings, None, nothing, nothing, outputs, late, reach))
        return found

    def _pose_parts(self) -> list[_Part]:
        """What the IMU reads against what the pose implies: no physics of the vehicle in between.

        The slopes are taken at the force that the airframe predicts and at the gyroscope: noise in
        a regressor would shrink what is found with it, or feign it where the residual has it too.
        """
        t, motion, flight = self.twin.inputs.t_s, self.twin.motion, self.flight
        if motion.attitude is None or not flight.has(*GYRO):
            return []
        v = self.vehicle
        gyro = on_grid(Signal(*flight.signal(GYRO)), t)
        sensor = imu(replace(v, accel_cutoff_hz=None, gyro_cutoff_hz=None), self._effects)
        batch = sensing(sensor, self._effects, [n.full for n in self.numbers])
        implied = _named("omega", rates_of(motion.attitude).at(t))
        read = _named("omega", gyro)
        band = min(POSE_BAND_HZ, 0.2 * motion.attitude.rate_hz)
        groups = []
        pull = None
        if motion.velocity is not None and flight.has(*ACC):
            acc = on_grid(Signal(*flight.signal(ACC)), t)
            pull = np.gradient(motion.velocity.at(t), t, axis=0)
            pull[:, 2] -= GRAVITY_M_S2
            force = self._body.value(self._now, self.twin.states, self.twin.inputs.u)[:, :3]
            alpha = _named("angular_acceleration", np.gradient(gyro, t, axis=0))
            implied |= alpha | _named("specific_force", _pulled(motion.attitude.at(t), pull))
            read |= alpha | _named("specific_force", force)
            groups.append((ACC, "m/s²", acc, v.accel_cutoff_hz, slice(0, 3)))
        groups.append((GYRO, "rad/s", gyro, v.gyro_cutoff_hz, slice(3, 6)))

        def older(position_s: float, attitude_s: float) -> Array:
            """Rows with position and attitude from so many seconds later."""
            assert motion.attitude is not None and pull is not None
            q = _shifted(motion.attitude.at(t), -attitude_s)
            pulled = _pulled(q, _shifted(pull, -position_s))
            return _rows(sensor, implied | _named("specific_force", pulled), len(t))

        rows, at = _rows(sensor, implied, len(t)), _rows(sensor, read, len(t))
        known = self.twin.airborne & np.all(np.isfinite(rows), axis=1)
        known &= np.all(np.isfinite(at), axis=1)
        found = []
        for columns, unit, values, cutoff, outputs in groups:
            names = tuple(f"pose_{c}" for c in columns)
            readings = measured(names, unit, t, values, known, band, cutoff)
            if readings is None:
                continue
            reach = _reaching("imu") | {"position_delay", "heading_offset"}
            if columns == ACC:
                late = {IMU_AGE: 1.0}
                part = _Part(readings, batch, rows, at, outputs, late, reach, gyro, older)
            else:
                late = {IMU_AGE: 1.0, ATTITUDE_AGE: -1.0}
                part = _Part(readings, batch, rows, at, outputs, late, reach)
            found.append(part)
        return found

    def _other_parts(self) -> list[_Part]:
        """Magnetometer and barometer."""
        t, motion, flight = self.twin.inputs.t_s, self.twin.motion, self.flight
        sensors: list[tuple[Component, tuple[str, ...], str, dict[str, Array]]] = []
        if motion.attitude is not None and flight.has(*MAG):
            q = motion.attitude.at(t)
            inputs = {f"q_{a}": q[:, i] for i, a in enumerate("wxyz")}
            if flight.has("ibat_a"):
                inputs["ibat_a"] = Signal(*flight.signal(["ibat_a"])).held(t)[:, 0]
            sensors.append((magnetometer(self.vehicle, self._effects), MAG, "T", inputs))
        if motion.position is not None and flight.has("baro_pa"):
            inputs = {"pos_z": motion.position.at(t)[:, 2]}
            if motion.velocity is not None:
                inputs |= _named("vel", motion.velocity.at(t))
            sensors.append((barometer(self.vehicle, self._effects), ("baro_pa",), "Pa", inputs))
        found = []
        for sensor, names, unit, inputs in sensors:
            rows = _rows(sensor, inputs, len(t))
            signal = Signal(*flight.signal(list(names)))
            known = self.twin.airborne & np.all(np.isfinite(rows), axis=1)
            band = min(POSE_BAND_HZ, 0.35 * signal.rate_hz)
            readings = measured(names, unit, t, signal.at(t), known, band, None)
            if readings is not None:
                batch = sensing(sensor, self._effects, [n.full for n in self.numbers])
                reach = _reaching(cast(ComponentName, sensor.name)) | {"position_delay"}
                late = {POSITION_AGE if names == ("baro_pa",) else ATTITUDE_AGE: -1.0}
                found.append(_Part(readings, batch, rows, rows, slice(None), late, reach))
        return found


def _reaching(*components: ComponentName) -> frozenset[str]:
    """Effects that act on some components."""
    return frozenset(e.name for e in EFFECTS.values() if e.component in components)


def _named(stem: str, values: Array) -> dict[str, Array]:
    return {f"{stem}_{a}": values[:, i] for i, a in enumerate("xyz")}


def _rows(sensor: Component, inputs: Mapping[str, Array], n: int) -> Array:
    """Inputs of a sensor in its order; what is not given stays at its start."""
    rows = np.tile(sensor.input_values(), (n, 1))
    for i, name in enumerate(sensor.input_names):
        if name in inputs:
            rows[:, i] = inputs[name]
    return rows


def _pulled(q_nb: Array, pull_n: Array) -> Array:
    """A force in NED, in body axes of unit quaternions; shape (n, 3)."""
    q = q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True)
    return np.stack(to_body(list(q.T), list(pull_n.T)), axis=-1)


def _step_mean(values: Array) -> Array:
    """Mean over the step of the grid that ends at each row."""
    mean = np.array(values)
    mean[1:] = (values[1:] + values[:-1]) / 2
    return mean


def _shifted(values: Array, later_s: float) -> Array:
    """Values on the grid later by a while, linearly interpolated, unknown ones bridged."""
    grid, moved = np.arange(len(values)), np.array(values)
    for column, v in zip(moved.T, values.T, strict=True):
        known = np.isfinite(v)
        if known.any():
            column[:] = np.interp(grid - later_s * GRID_HZ, grid[known], v[known])
    return moved
