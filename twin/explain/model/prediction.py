"""Readings predicted by the components along measured motion, and their derivatives by the effects'
numbers.

An effect changes equations: its regressors are the exact derivatives of the prediction with respect
to its numbers, from the CasADi expressions of the components, all in one batch. The components are
built once with every effect enabled; an effect at its neutral value equals a disabled one. Where
unmeasured states depend on a number (found from the sparsity of the component, for any effect),
they are integrated again with the number increased, and the difference quotient of two predictions
replaces the derivative.

States and inputs along a flight are measured; in addition an effect may have

| states | treatment |
|---|---|
| of its own, or unmeasured ones that depend on it | integrated again along the flight |
| that an observer can estimate from the accelerometer | estimated by the observer |
| that are delayed, such as commands | shifted in time, as is the pose by its age |
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...component.along import BUILDING
from ...component.rows import OverRows
from ...effects import EFFECTS, acting_late
from ...frames import to_ned
from ...logs import Flight
from ...logs.columns import ACC
from ...residuals.aligned import align_flight
from ...residuals.channels import (
    GRID_HZ,
    Array,
    GridSpline,
    gyro_rate,
    on_grid,
    prompt_imu,
    sensed,
    sensor_lag,
    shifted,
)
from ...residuals.measured import Signal
from ...residuals.teacher_forced import (
    RIGID,
    SPIN_RATE,
    RotorStates,
    hidden_states,
    integrate_states,
    rotor_states_of,
)
from ...vehicle import Vehicle
from .numbers import (
    ACCELEROMETER,
    DRIVES,
    PLACE,
    TURN,
    Number,
    age_of,
    lateness_of,
    values_of,
    with_effects,
)

Mask = NDArray[np.bool_]
Values = tuple[tuple[str, float], ...]
"""Values of numbers, as pairs ("effect.number", value)."""
Key = TypeVar("Key")
Made = TypeVar("Made")
FUNCTIONS = 64
"""Number of compiled functions cached per batch; a search requests the same sets of effects
repeatedly."""


def states_reached(component: Component, index: Sequence[int]) -> dict[str, frozenset[int]]:
    """For each parameter, those of the given states that depend on it, directly or through other
    states."""
    index = list(index)
    if not index:
        return {}
    by_p = _depends(component.derivatives, 2) | _depends(component.initial, 1)
    by_x = _depends(component.derivatives, 0)
    if component.sampling is not None:
        s = component.sampling
        late = _depends(s.update, 4)
        by_p |= _depends(s.update, 2) | _both(late, _depends(s.signals, 2))
        by_p |= _both(late, _depends(s.delays, 0))
        by_x |= _depends(s.update, 0) | _both(late, _depends(s.signals, 0))
    by_p, by_x = by_p[index], by_x[np.ix_(index, index)]
    for _ in index:
        by_p = by_p | _both(by_x, by_p)
    return {
        v.name: frozenset(index[k] for k in np.flatnonzero(column))
        for v, column in zip(component.parameters, by_p.T, strict=True)
        if column.any()
    }


def _depends(function: ca.Function, argument: int) -> Mask:
    """Sparsity: whether each result depends on each entry of an argument."""
    shape = function.numel_out(0), function.numel_in(argument)
    if 0 in shape:
        return np.zeros(shape, dtype=np.bool_)
    sparsity = ca.DM(function.jac_sparsity(0, argument), 1)
    return np.asarray(np.asarray(sparsity, dtype=np.float64) != 0)


def _both(a: Mask, b: Mask) -> Mask:
    """Composition of two sparsity patterns."""
    return np.asarray(a.astype(np.intp) @ b.astype(np.intp) > 0)


class EffectStates:
    """States that effects add to a sensor, integrated over its inputs: their positions, and those
    of the numbers on which they depend."""

    def __init__(
        self, sensor: Component, effects: Sequence[str], numbers: Sequence[Number]
    ) -> None:
        self.sensor, self._effects, self._numbers = sensor, list(effects), list(numbers)
        owners = [s.name.partition(".")[0] for s in sensor.states]
        self.index = [i for i, owner in enumerate(owners) if owner in effects]
        reached = states_reached(sensor, self.index)
        self.numbers = frozenset(i for i, n in enumerate(numbers) if n.full in reached)

    def along(self, inputs: Array, theta: Array) -> tuple[Array, ...]:
        """States over all rows of a flight, shape (n, k); empty tuple where there are none."""
        if not self.index:
            return ()
        known = {v.name for v in self.sensor.parameters}
        values = {f"{e}.enabled": 1.0 for e in self._effects}
        values |= {n.full: float(v) for n, v in zip(self._numbers, theta, strict=True)}
        p = self.sensor.parameter_values({k: v for k, v in values.items() if k in known})
        x = np.zeros((len(inputs), len(self.sensor.states)))
        with BUILDING:  # rebuilt for this call
            return (integrate_states(self.sensor, self.index, x, inputs, p, 1 / GRID_HZ),)

    def filled(self, x: ca.SX, z: ca.SX) -> ca.SX:
        """States of the sensor with these inserted."""
        full = ca.SX(x)
        if self.index:
            full[self.index] = z
        return full


class Batch:
    """Vectorised function of measured rows and of numbers, with its derivatives by the numbers.

    Numbers at their neutral value are inserted as constants: two thirds of the instructions vanish.
    """

    def __init__(
        self, rows: Sequence[ca.SX], theta: ca.SX, readings: ca.SX, numbers: Sequence[Number]
    ) -> None:
        self._rows, self._theta, self._readings = list(rows), theta, readings
        self._rest = values_of(numbers, {})
        self._answering: Mask = np.asarray(self._reached(readings).any(axis=0))
        self._made: dict[tuple[tuple[int, ...] | None, bytes], OverRows] = {}

    def value(self, theta: Array, *rows: Array) -> Array:
        """Predicted readings, shape (n, c), of rows of shape (n, ...)."""
        return self._function(None, theta)(*rows, theta)

    def slopes(self, columns: Sequence[int], theta: Array, *rows: Array) -> Array:
        """Derivatives of the readings by some numbers, shape (n, c, len(columns))."""
        shape = (len(columns), int(self._readings.shape[0]))
        if not columns:
            return np.zeros((len(rows[0]), shape[1], 0))
        flat = self._function(tuple(columns), theta)(*rows, theta)
        return flat.T.reshape(*shape, len(flat)).transpose(2, 1, 0)

    def answers(self, i: int) -> bool:
        """Whether any reading depends on number `i`."""
        return bool(self._answering[i])

    @cached_property
    def bent_by(self) -> Mask:
        """Whether the derivatives by one number depend on another, shape (k, k)."""
        k = self._theta.numel()
        with BUILDING:
            by_number = self._reached(ca.vec(ca.jacobian(self._readings, self._theta)))
        return np.asarray(by_number.reshape(k, -1, k).any(axis=1))

    def _reached(self, results: ca.SX) -> Mask:
        """Sparsity of the equations: whether each result depends on each number, shape (c, k)."""
        function = ca.Function("reach", [*self._rows, self._theta], [ca.densify(results)])
        return _depends(function, len(self._rows))

    def _function(self, columns: tuple[int, ...] | None, theta: Array) -> OverRows:
        """The readings, or their derivatives by some columns, with numbers at neutral values
        inserted as constants."""
        moved = self._answering & (theta != self._rest)
        return remembered(
            self._made, (columns, moved.tobytes()), partial(self._make, columns, moved), FUNCTIONS
        )

    def _make(self, columns: tuple[int, ...] | None, moved: Mask) -> OverRows:
        with BUILDING:
            made = self._readings
            if columns is not None:
                made = ca.vec(ca.jacobian(made, self._theta)[:, list(columns)])
            theta = ca.SX(self._rest)
            for i in np.flatnonzero(moved).tolist():
                theta[i] = self._theta[i]
            made = ca.cse(ca.densify(ca.substitute(made, self._theta, theta)))
            function = ca.Function("made", [*self._rows, self._theta], [made])
            return OverRows(function, len(self._rows))


class Physics:
    """Airframe and IMU: `(states, inputs, numbers) -> acc_x..z, rate of gyro_x..z`.

    Low-pass and delay of the IMU are omitted: they are applied in time to prediction and slopes
    alike.

    Attributes:
        airframe: Airframe component of which the rows are states and inputs.
        reached: For each number, the unmeasured states of the airframe that depend on it.
        of_sensor: Indices of the numbers on which states of effects in the IMU depend.
    """

    def __init__(
        self, body: Component, vehicle: Vehicle, effects: Sequence[str], numbers: Sequence[Number]
    ) -> None:
        self.airframe, self._numbers = body, list(numbers)
        given = {e.name for e in acting_late()}  # delayed inputs are shifted already
        hidden = [
            i
            for i, s in enumerate(body.states)
            if s.name not in RIGID and s.name.partition(".")[0] not in given
        ]
        self.reached = states_reached(body, hidden)
        sensor = prompt_imu(vehicle, effects)
        self._states = EffectStates(sensor, effects, numbers)
        self.of_sensor = self._states.numbers
        names = [n.full for n in numbers]
        theta = ca.SX.sym("theta", len(names))
        x, u = ca.SX.sym("x", len(body.states)), ca.SX.sym("u", len(body.inputs))
        y = body.outputs(x, u, _parameters(body, effects, names, theta, {"ground.enabled": 0.0}))
        outputs = {name: y[i] for i, name in enumerate(body.output_names)}
        imu_inputs = ca.vertcat(*[outputs[n] for n in sensor.input_names])
        sensed = ca.SX.sym("sensed", len(sensor.inputs))
        z = ca.SX.sym("z", len(self._states.index))
        p = _parameters(sensor, effects, names, theta, {})
        shown = _shown(self._states, sensed, z, p)
        rate = gyro_rate(sensor, sensed, shown)
        self._imu_inputs: Batch | None = None
        if self._states.index:
            self._imu_inputs = Batch([x, u], theta, imu_inputs, numbers)
            place = ca.SX(sensor.initial(sensed, p))
            flow = sensor.derivatives(self._states.filled(place, z), sensed, p)[self._states.index]
            rate += ca.jtimes(shown[3:], z, flow)
        readings = ca.vertcat(shown[:3], rate)
        moved = [f"{s}_{a}" for s in ("specific_force", "angular_acceleration") for a in "xyz"]
        bare, turning = ca.vertcat(*[outputs[n] for n in moved]), ca.SX.sym("turning", 3)
        self._moved = [x, u], theta, bare
        moments = u[[body.input_names.index(f"moment_{a}") for a in "xyz"]]
        by_moment = ca.jacobian(bare, moments)
        force = bare[:3] + by_moment[:3, :] @ ca.inv(by_moment[3:, :]) @ (turning - bare[3:])
        as_shown = outputs | dict(zip(moved, ca.vertsplit(ca.vertcat(force, turning)), strict=True))
        measured = ca.vertcat(*[as_shown[n] for n in sensor.input_names])
        sensed_force = ca.substitute(shown[:3], sensed, measured)
        readings = ca.substitute(readings, sensed, imu_inputs)
        self._as_measured = [x, u, turning], theta, ca.vertcat(sensed_force, readings[3:])
        rows = [x, u, z] if self._states.index else [x, u]
        self._batch = Batch(rows, theta, readings, numbers)
        per_newton = ca.jacobian(bare[0], u[body.input_names.index("force_x")])
        self._driving_rows = rows, theta, ca.vertcat(readings[:3], bare[:3], per_newton)

    @cached_property
    def _driving(self) -> Batch:
        return Batch(*self._driving_rows, self._numbers)

    def drives_observer(self, i: int) -> bool:
        """Whether a force of `driving` depends on number `i`."""
        return self._driving.answers(i)

    def driving(self, theta: Array, states: Array, inputs: Array) -> tuple[Array, Array, float]:
        """Accelerometer readings, and specific force at the centre of mass of the vehicle file,
        shape (n, 3) each; and the mass, kg."""
        along = self._along(theta, states, inputs)
        values = self._driving.value(theta, states, inputs, *along)
        return values[:, :3], values[:, 3:6], float(1 / np.nanmean(values[:, 6]))

    @cached_property
    def bare(self) -> Batch:
        """Airframe alone: `(states, inputs, numbers) -> specific force at the centre of mass of the
        vehicle file, angular acceleration`."""
        return Batch(*self._moved, self._numbers)

    @cached_property
    def as_measured(self) -> Batch | None:
        """Readings with the measured angular acceleration at the accelerometer: `(states, inputs,
        angular acceleration, numbers) -> acc_x..z, rate of gyro_x..z`. None where effects have
        states in the IMU.

        Away from the centre of mass an accelerometer measures angular acceleration: a predicted
        one would bias inertia and centre of mass in closed loop, and hide a wind.
        """
        return None if self._states.index else Batch(*self._as_measured, self._numbers)

    def value(self, theta: Array, states: Array, inputs: Array) -> Array:
        """Predicted readings, shape (n, 6), of all rows of a flight."""
        return self._batch.value(theta, states, inputs, *self._along(theta, states, inputs))

    def slopes(self, columns: Sequence[int], theta: Array, states: Array, inputs: Array) -> Array:
        """Derivatives of the equations by some numbers, states given, (n, 6, len(columns))."""
        along = self._along(theta, states, inputs)
        return self._batch.slopes(columns, theta, states, inputs, *along)

    def _along(self, theta: Array, states: Array, inputs: Array) -> tuple[Array, ...]:
        """States that effects add to the IMU, along all rows."""
        if self._imu_inputs is None:
            return ()
        return self._states.along(self._imu_inputs.value(theta, states, inputs), theta)


class SensorBatch:
    """One sensor alone, without noise, moved by the pose: `(inputs, numbers) -> outputs`."""

    def __init__(
        self, sensor: Component, effects: Sequence[str], numbers: Sequence[Number]
    ) -> None:
        self._states, self._numbers = EffectStates(sensor, effects, numbers), list(numbers)
        names = [n.full for n in numbers]
        theta = ca.SX.sym("theta", len(names))
        sensed = ca.SX.sym("sensed", len(sensor.inputs))
        z = ca.SX.sym("z", len(self._states.index))
        relative = ca.SX(theta)
        for n in (n for n in numbers if n.less in names):
            relative[names.index(n.less)] -= theta[names.index(n.full)]
        shown = _shown(self._states, sensed, z, _parameters(sensor, effects, names, relative, {}))
        rows = [sensed, z] if self._states.index else [sensed]
        self._batch = Batch(rows, theta, shown, numbers)

    def value(self, theta: Array, rows: Array) -> Array:
        """Predicted readings, shape (n, c), of all rows of a flight, shape (n, n_u)."""
        return self._batch.value(theta, rows, *self._states.along(rows, theta))

    def answers(self, i: int) -> bool:
        """Whether any reading depends on number `i`."""
        return i in self._states.numbers or self._batch.answers(i)

    def bending(self, i: int, theta: Array) -> bytes:
        """Bytes of those numbers of `theta` on which the derivatives by number `i` depend, as a
        cache key."""
        return theta.tobytes() if self._states.index else theta[self._batch.bent_by[i]].tobytes()

    def slopes(self, columns: Sequence[int], theta: Array, rows: Array) -> Array:
        """Derivatives of the readings by some numbers, shape (n, c, len(columns))."""
        slopes = self._batch.slopes(columns, theta, rows, *self._states.along(rows, theta))
        for k, i in enumerate(columns):
            if i in self._states.numbers:
                ahead, step = np.array(theta), self._numbers[i].step
                ahead[i] += step
                slopes[:, :, k] = (self.value(ahead, rows) - self.value(theta, rows)) / step
        return slopes


def _shown(states: EffectStates, sensed: ca.SX, z: ca.SX, p: ca.SX) -> ca.SX:
    """Noise-free readings: states have their start values, except for those of effects."""
    sensor = states.sensor
    return sensor.outputs(states.filled(sensor.initial(sensed, p), z), sensed, p)


def _parameters(
    component: Component,
    effects: Sequence[str],
    names: Sequence[str],
    theta: ca.SX,
    values: dict[str, float],
) -> ca.SX:
    """Parameters of a component: its start values, effects enabled, and the numbers as symbols."""
    known = {v.name: i for i, v in enumerate(component.parameters)}
    on = {f"{e}.enabled": 1.0 for e in effects if f"{e}.enabled" in known}
    p = ca.SX(component.parameter_values(on | values))
    for i, name in enumerate(names):
        if name in known:
            p[known[name]] = theta[i]
    return p


# -- along a flight --------------------------------------------------------------------------


REMEMBERED, DRIVEN = 16, 3
"""Number of cached trajectories: of unmeasured states, by the numbers; and with delayed inputs."""


class ObserverInput(NamedTuple):
    """Forces that drive an observer.

    Attributes:
        free_n: Predicted specific force without its effect, NED, m/s^2, shape (n, 3).
        excess_n: Measured minus predicted accelerometer reading, NED, m/s^2, shape (n, 3).
        lag_s: Lag of the latter, s.
        vehicle: Vehicle with the mass of the prediction.
    """

    free_n: Array
    excess_n: Array
    lag_s: float
    vehicle: Vehicle


class Trajectory:
    """States and inputs of the airframe along one flight.

    Attributes:
        aligned: The flight on its grid, with the nominal model.
    """

    def __init__(
        self,
        flight: Flight,
        vehicle: Vehicle,
        physics: Physics,
        effects: Sequence[str],
        numbers: Sequence[Number],
    ) -> None:
        self._flight, self._vehicle, self._physics = flight, vehicle, physics
        self._effects, self._numbers = list(effects), list(numbers)
        self._observers = {name: o for name in effects if (o := EFFECTS[name].observer) is not None}
        self._stateful = sorted(
            {n.effect for n in numbers if self._reached(n.full)} - self._observers.keys()
        )
        on = with_effects(vehicle, self._stateful, {})
        self.aligned = align_flight(flight, on, 1 / GRID_HZ, effects)
        self._now = values_of(numbers, {})
        self._rotors: dict[tuple[str, ...], RotorStates] = {}
        self._splines: dict[tuple[str, ...], GridSpline] = {}
        self._forces: dict[tuple[str, bytes], ObserverInput] = {}
        self._courses: dict[tuple[str, bytes, tuple[float, ...]], Any] = {}
        self._integrated: dict[Values, Array] = {}
        self._driven: dict[tuple[Values, Values], tuple[Array, Array]] = {}
        states = self._observed(self.aligned.states, self.aligned.inputs.u, self._now)
        inputs = replace(self.aligned.inputs, u=np.asfortranarray(self.aligned.inputs.u))
        states = np.asfortranarray(states)  # column order: shifted and read by columns
        self.aligned = replace(self.aligned, states=states, inputs=inputs)

    def at(self, change: Mapping[str, float]) -> tuple[Array, Array]:
        """States, shape (n, n_x), and inputs, shape (n, n_u), with some numbers changed.

        Args:
            change: Changed numbers, "effect.number" -> value.
        """
        theta = values_of(self._numbers, change)
        own = {k: v for k, v in change.items() if self.is_integrated(k, change)}
        late = {s: later for s in DRIVES if (later := lateness_of(self._numbers, theta, s))}
        key = tuple(sorted(own.items())), tuple(late.items())
        states, inputs = remembered(self._driven, key, lambda: self._driven_by(own, late), DRIVEN)
        return self._observed(self._in_step(states, theta), inputs, theta), inputs

    def _driven_by(
        self, own: Mapping[str, float], late: Mapping[str, float]
    ) -> tuple[Array, Array]:
        """States integrated with some numbers, and inputs, each delayed like the signal that drives
        it."""
        states, inputs = self.aligned.states, self.aligned.inputs.u
        if own:
            key = tuple(sorted(own.items()))
            states = remembered(self._integrated, key, lambda: self._integrated_with(own))
        for signal, later in late.items():
            states, inputs = self._late_drive(states, inputs, signal, later)
        return states, inputs

    def is_integrated(self, number: str, change: Mapping[str, float]) -> bool:
        """Whether a state that depends on a number must be integrated: its effect is not neutral,
        and no observer estimates the state."""
        own = number.partition(".")[0]
        if own in self._observers:
            return False
        acting = {own, *self._vehicle.effects, *(name.partition(".")[0] for name in change)}
        resting = set(self._effects) - acting | self._observers.keys()
        names = (self.aligned.airframe.states[i].name for i in self._reached(number))
        return any(name.partition(".")[0] not in resting for name in names)

    def is_followed(self, i: int, change: Mapping[str, float]) -> bool:
        """Whether the slope by number `i` includes the observer's estimate: that of a number of
        its own, or of a changed one that moves the forces from which it estimates an effect that is
        there."""
        if self._numbers[i].effect in self._observers:
            return True
        there = {name.partition(".")[0] for name in change} & self._observers.keys()
        return bool(there) and self._numbers[i].full in change and self._physics.drives_observer(i)

    def _reached(self, number: str) -> frozenset[int]:
        """Unmeasured states of the airframe that depend on a number."""
        return self._physics.reached.get(number, frozenset())

    def _in_step(self, states: Array, theta: Array) -> Array:
        """States corrected for the ages of the pose."""
        for signals in (PLACE, TURN):
            if age := age_of(self._numbers, theta, signals):
                stems = tuple(f"{s}_" for s in signals)
                if signals == TURN and not self.aligned.motion.rates_measured:
                    stems += ("omega_",)  # derived from the attitude
                names = [s.name for s in self.aligned.airframe.states]
                own = [i for i, name in enumerate(names) if name.startswith(stems)]
                states = states.copy(order="K")
                states[:, own] = self._spline(stems, self.aligned.states, own).later(-age)
        return states

    def _spline(self, stems: tuple[str, ...], rows: Array, own: Sequence[int]) -> GridSpline:
        """Spline of some columns of measured states or inputs that no number changes."""
        if stems not in self._splines:
            self._splines[stems] = GridSpline(rows[:, own])
        return self._splines[stems]

    def _integrated_with(self, values: Mapping[str, float]) -> Array:
        """States on the grid; unmeasured ones are integrated with the effects that move them."""
        effects = {name.partition(".")[0] for name in values}
        known = {v.name for v in self.aligned.airframe.parameters}
        on = {f"{e}.enabled": 1.0 for e in effects}
        moving = effects | {*self._stateful}
        starts = on | {n.full: n.now for n in self._numbers if n.effect in moving} | dict(values)
        body = self.aligned.airframe.with_starts({k: v for k, v in starts.items() if k in known})
        reached: set[int] = set().union(*(self._reached(name) for name in values))
        inputs, states = self.aligned.inputs, self.aligned.states.copy(order="K")
        rotors = rotor_states_of(body)
        if reached & {*rotors}:
            own = [name for name in values if self._reached(name) & {*rotors}]
            if (key := tuple(own)) not in self._rotors:
                self._rotors[key] = RotorStates(body, inputs.step_s, own)
            states[:, rotors] = self._rotors[key].settled(inputs.u, values)
            inputs = replace(inputs, rotor_states=states[:, rotors])
        owners = [s.name.partition(".")[0] for s in body.states]
        followed = {i for i, owner in enumerate(owners) if owner in self._observers}
        if hidden := sorted(reached - {*rotors} - followed):
            states[:, hidden] = hidden_states(body, hidden, states, inputs)
        return states

    def _observer_input(self, theta: Array, states: Array, inputs: Array) -> "ObserverInput":
        """Forces that drive an observer.

        On the ground, or where it is unknown, the free force is that at rest; the excess is then
        zero.
        """
        aligned, vehicle = self.aligned, self._vehicle
        reading, force, mass = self._physics.driving(theta, states, inputs)
        excess, lag = np.zeros_like(force), age_of(self._numbers, theta, (ACCELEROMETER,))
        if self._flight.has(*ACC):
            cutoff = vehicle.accel_cutoff_hz
            early = self._flight.filter_delays_s.get(ACCELEROMETER, 0.0) if cutoff else 0.0
            shown = np.nan_to_num(shifted(reading, lag) if lag else reading)
            shown, lag = sensed(shown, cutoff, early), lag + sensor_lag(cutoff) - early
            excess = on_grid(Signal(*self._flight.signal(ACC)), aligned.inputs.t_s) - shown
        assert aligned.motion.attitude is not None
        q = list(aligned.motion.attitude.at(aligned.inputs.t_s).T)
        force_n, excess_n = (np.stack(to_ned(q, list(v.T)), axis=-1) for v in (force, excess))
        known = aligned.airborne & np.all(np.isfinite(force_n + reading), axis=1)
        there = known & np.all(np.isfinite(excess_n), axis=1)
        return ObserverInput(
            np.where(known[:, None], force_n, [0.0, 0.0, -vehicle.gravity_m_s2]),
            np.where(there[:, None], excess_n, 0.0),
            lag,
            replace(vehicle, mass_kg=mass),
        )

    def _height(self, states: Array) -> Array:
        """Height above the take-off place, m, shape (n,); infinite where unknown."""
        aligned, names = self.aligned, [s.name for s in self.aligned.airframe.states]
        down = states[:, names.index("pos_z")]
        stood = ~aligned.airborne & np.isfinite(down)
        if aligned.motion.position is None or not stood.any():
            return np.full(len(down), np.inf)
        return np.asarray(np.median(down[stood]) - down)

    def _observed(self, states: Array, inputs: Array, theta: Array) -> Array:
        """States with observer estimates for the effects that have an observer: from the measured
        force minus all other predicted forces; for a neutral effect, minus those of the nominal
        model."""
        if not self._observers:
            return states
        names, height = [s.name for s in self.aligned.airframe.states], self._height(states)
        for effect, observer in self._observers.items():
            own = [i for i, n in enumerate(self._numbers) if n.effect == effect]
            sizes = [i for i in own if not self._numbers[i].shape]
            neutral = [float(self._numbers[i].about.neutral or 0.0) for i in sizes]
            without = self._now.copy() if np.array_equal(theta[sizes], neutral) else theta.copy()
            without[own] = self._now[own]
            without[sizes] = neutral
            at = effect, without.tobytes()
            given = remembered(
                self._forces, at, partial(self._observer_input, without, states, inputs)
            )
            numbers = {self._numbers[i].name: float(theta[i]) for i in own}
            course = remembered(
                self._courses,
                (*at, tuple(float(theta[i]) for i in own if i not in sizes)),
                partial(observer.follow, *given[:3], height, numbers, 1 / GRID_HZ, given.vehicle),
            )
            states = observer.place(states, names, course, given.free_n, numbers, given.vehicle)
        return states

    def _late_drive(
        self, states: Array, inputs: Array, signal: str, delay_s: float
    ) -> tuple[Array, Array]:
        """States and inputs with the drive, and the rotors that follow it, delayed by a time."""
        body = self.aligned.airframe
        own = (f"{signal}_", SPIN_RATE) if signal == "rotor" else (f"{signal}_",)
        drives = [i for i, n in enumerate(body.input_names) if n.startswith(own)]
        if not drives:
            return states, inputs
        arrived = tuple(f"{n.effect}." for n in self._numbers if n.acts)
        rotors = [
            i
            for i, s in enumerate(body.states)
            if s.name.startswith(("rotor_", "effort_", *arrived))
        ]
        states, inputs = states.copy(order="K"), inputs.copy(order="K")
        states[:, rotors] = shifted(states[:, rotors], delay_s)
        inputs[:, drives] = self._spline(own, self.aligned.inputs.u, drives).later(delay_s)
        return states, inputs


def remembered(
    retained: dict[Key, Made], key: Key, make: Callable[[], Made], most: int = REMEMBERED
) -> Made:
    """Cached value of a key, or a new one; the oldest entry is dropped beyond `most`."""
    if key not in retained:
        while len(retained) >= most:
            del retained[next(iter(retained))]
        retained[key] = make()
    return retained[key]
