"""Sensors of a flight: what each read, and what predicts it from rows on the grid."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...effects import EFFECTS
from ...frames import to_body
from ...logs import Flight
from ...physics.sensors.table import BODY, SENSORS, Sensor
from ...representation import short_repr
from ...residuals.aligned import AlignedFlight
from ...residuals.channels import (
    POSE_BAND_HZ,
    Measured,
    measured,
    on_grid,
    shifted,
)
from ...residuals.imu import OF_IMU, imu_readings, prompt_imu
from ...residuals.measured import Signal, rates_of
from ...vehicle import Vehicle
from .numbers import Number
from .prediction import SensorBatch

Array = NDArray[np.float64]
PLACE, TURN = ("pos", "vel"), ("q",)
"""Signals of the pose, which may come from two clocks."""
OF_POSE = tuple(s for s in SENSORS if s.group != BODY)


@dataclass(frozen=True, slots=True)
class Seen:
    """A flight and its twin.

    Attributes:
        flight: As read.
        vehicle: The model as it stands.
        aligned: On the grid.
        effects: Effects in the equations, all switched on.
        numbers: Every number, in the order of the prediction's.
    """

    flight: Flight
    vehicle: Vehicle
    aligned: AlignedFlight
    effects: Sequence[str]
    numbers: Sequence[Number]

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Part:
    """One sensor of a flight: readings, and what predicts them from rows on the grid.

    Attributes:
        readings: Measured.
        batch: Prediction; None: that of airframe and IMU.
        rows: Its inputs, shape (n, n_u).
        at: Inputs at which its slopes are taken, shape (n, n_u).
        outputs: Which of its outputs.
        late: Sign with which ages, "effect.number", shift the prediction.
        effects: Effects that reach the prediction.
        rate: Whether the readings are rates of change, of what the sensor reads.
        turning: Body rates, shape (n, 3), where position and attitude both make the prediction.
        older: Rows with position and attitude from so many seconds later, where they do.
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

    __repr__ = short_repr


def imu_parts(seen: Seen) -> list[Part]:
    """Accelerometer, and rate of change of the gyroscope."""
    flight, nothing = seen.flight, np.zeros((0, 0))
    found = []
    for k, sensor in enumerate(OF_IMU):
        if not flight.has(*sensor.columns):
            continue
        readings = imu_readings(sensor, flight, seen.vehicle, seen.aligned)
        if readings is not None:
            late = _late(seen, (sensor.signal,), ())
            reach = _reaching("airframe", sensor.component) | _moving(seen, (*PLACE, *TURN, "cmd"))
            outputs, rate = slice(3 * k, 3 * k + 3), bool(sensor.rate_unit)
            reach |= {name.partition(".")[0] for name in late}
            found.append(Part(readings, None, nothing, nothing, outputs, late, reach, rate))
    return found


def pose_parts(seen: Seen, force: Array) -> list[Part]:
    """What the IMU reads against what the pose implies: no physics of the vehicle in between.

    The slopes are taken at the force that the airframe predicts and at the gyroscope: noise in
    a regressor would shrink what is found with it, or feign it where the residual has it too.
    """
    t, motion, flight = seen.aligned.inputs.t_s, seen.aligned.motion, seen.flight
    accelerometer, gyroscope = OF_IMU
    if motion.attitude is None or not flight.has(*gyroscope.columns):
        return []
    v = seen.vehicle
    gyro = on_grid(Signal(*flight.signal(gyroscope.columns)), t)
    sensor = prompt_imu(v, seen.effects)
    batch = SensorBatch(sensor, seen.effects, seen.numbers)
    implied = _named("omega", rates_of(motion.attitude).at(t))
    read = _named("omega", gyro)
    band = min(POSE_BAND_HZ, 0.2 * motion.attitude.rate_hz)
    groups: list[tuple[Sensor, Array, slice]] = []
    pull = None
    if motion.velocity is not None and flight.has(*accelerometer.columns):
        acc = on_grid(Signal(*flight.signal(accelerometer.columns)), t)
        pull = np.gradient(motion.velocity.at(t), t, axis=0)
        pull[:, 2] -= v.gravity_m_s2
        alpha = _named("angular_acceleration", np.gradient(gyro, t, axis=0))
        implied |= alpha | _named("specific_force", _pulled(motion.attitude.at(t), pull))
        read |= alpha | _named("specific_force", force)
        groups.append((accelerometer, acc, slice(0, 3)))
    groups.append((gyroscope, gyro, slice(3, 6)))

    def older(position_s: float, attitude_s: float) -> Array:
        """Rows with position and attitude from so many seconds later."""
        assert motion.attitude is not None and pull is not None
        q = shifted(motion.attitude.at(t), -attitude_s)
        pulled = _pulled(q, shifted(pull, -position_s))
        return _rows(sensor, implied | _named("specific_force", pulled), len(t))

    rows, at = _rows(sensor, implied, len(t)), _rows(sensor, read, len(t))
    known = seen.aligned.airborne & np.all(np.isfinite(rows), axis=1)
    known &= np.all(np.isfinite(at), axis=1)
    found = []
    for kind, values, outputs in groups:
        names, cutoff = tuple(f"pose_{c}" for c in kind.columns), kind.cutoff_hz(v)
        readings = measured(names, kind.unit, t, values, known, band, cutoff)
        if readings is None:
            continue
        reach = _reaching(kind.component) | _moving(seen, (*PLACE, *TURN, kind.signal))
        reach |= {n.effect for n in seen.numbers if n.turns_pose}
        if kind is accelerometer:
            late = _late(seen, (kind.signal,), ())
            part = Part(readings, batch, rows, at, outputs, late, reach, turning=gyro, older=older)
        else:
            late = _late(seen, (kind.signal,), TURN)
            part = Part(readings, batch, rows, at, outputs, late, reach)
        found.append(part)
    return found


def other_parts(seen: Seen) -> list[Part]:
    """Sensors that the pose alone tells."""
    t, flight = seen.aligned.inputs.t_s, seen.flight
    pose = _pose(seen.aligned)
    found = []
    for kind in OF_POSE:
        if not flight.has(*kind.columns) or not set(kind.needs) <= pose.keys():
            continue
        sensor = kind.make(seen.vehicle, seen.effects)
        inputs = {k: v for signal in pose.values() for k, v in signal.items()}
        for name in sensor.input_names:
            if name not in inputs and flight.has(name):
                inputs[name] = Signal(*flight.signal([name])).held(t)[:, 0]
        rows = _rows(sensor, inputs, len(t))
        signal = Signal(*flight.signal(kind.columns))
        known = seen.aligned.airborne & np.all(np.isfinite(rows), axis=1)
        band = min(POSE_BAND_HZ, 0.35 * signal.rate_hz)
        cutoff = kind.cutoff_hz(seen.vehicle)
        readings = measured(kind.channels, kind.unit, t, signal.at(t), known, band, cutoff)
        if readings is None:
            continue
        felt = [s for s, values in pose.items() if values.keys() & set(sensor.input_names)]
        two_clocks = bool(set(felt) & set(PLACE)) and bool(set(felt) & set(TURN))
        first = sensor.output_names.index(kind.columns[0])
        found.append(
            Part(
                readings,
                SensorBatch(sensor, seen.effects, seen.numbers),
                rows,
                rows,
                slice(first, first + len(kind.columns)),
                _late(seen, (kind.signal,), () if two_clocks else felt),
                _reaching(kind.component) | _moving(seen, (kind.signal, *felt)),
                older=partial(_older, sensor, rows) if two_clocks else None,
            )
        )
    return found


def _pose(aligned: AlignedFlight) -> dict[str, dict[str, Array]]:
    """Measured motion by signal, as inputs of sensors on the grid."""
    t, motion = aligned.inputs.t_s, aligned.motion
    found = {}
    if motion.position is not None:
        found["pos"] = _named("pos", motion.position.at(t))
    if motion.velocity is not None:
        found["vel"] = _named("vel", motion.velocity.at(t))
    if motion.attitude is not None:
        found["q"] = _named("q", motion.attitude.at(t), "wxyz")
    return found


def _late(seen: Seen, shown: Collection[str], told_from: Collection[str]) -> dict[str, float]:
    """Sign with which each age shifts a prediction: later where what is shown is old, earlier where
    what it is told from is."""
    late = {}
    for n in seen.numbers:
        if set(n.moves) & set(shown):
            late[n.full] = 1.0
        elif set(n.moves) & set(told_from):
            late[n.full] = -1.0
    return late


def _moving(seen: Seen, signals: Collection[str]) -> frozenset[str]:
    """Effects that shift some signals."""
    return frozenset(n.effect for n in seen.numbers if set(n.moves) & set(signals))


def _reaching(*components: str) -> frozenset[str]:
    """Effects that act on some components."""
    return frozenset(e.name for e in EFFECTS.values() if e.component in components)


def _named(stem: str, values: Array, axes: str = "xyz") -> dict[str, Array]:
    return {f"{stem}_{a}": values[:, i] for i, a in enumerate(axes)}


def _rows(sensor: Component, inputs: Mapping[str, Array], n: int) -> Array:
    """Inputs of a sensor in its order; what is not given stays at its start."""
    rows = np.tile(sensor.input_values(), (n, 1))
    for i, name in enumerate(sensor.input_names):
        if name in inputs:
            rows[:, i] = inputs[name]
    return rows


def _older(sensor: Component, rows: Array, position_s: float, attitude_s: float) -> Array:
    """Inputs of a sensor with position and attitude from so many seconds later."""
    rows = rows.copy()
    for signals, age_s in ((PLACE, position_s), (TURN, attitude_s)):
        stems = tuple(f"{s}_" for s in signals)
        own = [i for i, n in enumerate(sensor.input_names) if n.startswith(stems)]
        if age_s and own:
            rows[:, own] = shifted(rows[:, own], -age_s)
    return rows


def _pulled(q_nb: Array, pull_n: Array) -> Array:
    """A force in NED, in body axes of unit quaternions; shape (n, 3)."""
    q = q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True)
    return np.stack(to_body(list(q.T), list(pull_n.T)), axis=-1)
