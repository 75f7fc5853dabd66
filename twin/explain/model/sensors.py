"""Sensors of a flight: what each read, and what predicts it from rows on the grid."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...effects import EFFECTS, ComponentName
from ...frames import to_body
from ...logs import Flight
from ...logs.columns import ACC, GYRO
from ...physics.sensors.barometer import barometer
from ...physics.sensors.imu import imu
from ...physics.sensors.magnetometer import magnetometer
from ...residuals.aligned import AlignedFlight
from ...residuals.measured import Signal, rates_of
from ...vehicle import Vehicle
from .channels import BAND_HZ, GRID_HZ, POSE_BAND_HZ, Measured, measured, on_grid, shifted
from .prediction import Batch, sensing

Array = NDArray[np.float64]
MAG = ("mag_x", "mag_y", "mag_z")
IMU_AGE = "imu_delay.delay_s"
POSITION_AGE, ATTITUDE_AGE = "position_delay.delay_s", "position_delay.attitude_s"


@dataclass(frozen=True, slots=True)
class Seen:
    """A flight and its twin.

    Attributes:
        flight: As read.
        vehicle: The model as it stands.
        twin: On the grid.
        effects: Effects in the equations, all switched on.
        names: Of every number, "effect.number", in the order of the prediction's.
    """

    flight: Flight
    vehicle: Vehicle
    aligned: AlignedFlight
    effects: Sequence[str]
    names: Sequence[str]


@dataclass(frozen=True, slots=True)
class Part:
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


def imu_parts(seen: Seen) -> list[Part]:
    """Accelerometer, and rate of change of the gyroscope."""
    parts: list[tuple[tuple[str, ...], str, Array, Signal, float | None, slice]] = []
    t, flight, v = seen.aligned.inputs.t_s, seen.flight, seen.vehicle
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
    known = seen.aligned.airborne & np.all(np.isfinite(seen.aligned.states), axis=1)
    for names, unit, values, signal, cutoff, outputs in parts:
        band = min(BAND_HZ, 0.35 * signal.rate_hz)
        readings = measured(names, unit, t, values, known, band, cutoff)
        if readings is not None:
            nothing = np.zeros((0, 0))
            reach = _reaching("airframe", "imu") | {"position_delay"}
            late = {IMU_AGE: 1.0}
            found.append(Part(readings, None, nothing, nothing, outputs, late, reach))
    return found


def pose_parts(seen: Seen, force: Array) -> list[Part]:
    """What the IMU reads against what the pose implies: no physics of the vehicle in between.

    The slopes are taken at the force that the airframe predicts and at the gyroscope: noise in
    a regressor would shrink what is found with it, or feign it where the residual has it too.
    """
    t, motion, flight = seen.aligned.inputs.t_s, seen.aligned.motion, seen.flight
    if motion.attitude is None or not flight.has(*GYRO):
        return []
    v = seen.vehicle
    gyro = on_grid(Signal(*flight.signal(GYRO)), t)
    sensor = imu(replace(v, accel_cutoff_hz=None, gyro_cutoff_hz=None), seen.effects)
    batch = sensing(sensor, seen.effects, seen.names)
    implied = _named("omega", rates_of(motion.attitude).at(t))
    read = _named("omega", gyro)
    band = min(POSE_BAND_HZ, 0.2 * motion.attitude.rate_hz)
    groups = []
    pull = None
    if motion.velocity is not None and flight.has(*ACC):
        acc = on_grid(Signal(*flight.signal(ACC)), t)
        pull = np.gradient(motion.velocity.at(t), t, axis=0)
        pull[:, 2] -= v.gravity_m_s2
        alpha = _named("angular_acceleration", np.gradient(gyro, t, axis=0))
        implied |= alpha | _named("specific_force", _pulled(motion.attitude.at(t), pull))
        read |= alpha | _named("specific_force", force)
        groups.append((ACC, "m/s²", acc, v.accel_cutoff_hz, slice(0, 3)))
    groups.append((GYRO, "rad/s", gyro, v.gyro_cutoff_hz, slice(3, 6)))

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
    for columns, unit, values, cutoff, outputs in groups:
        names = tuple(f"pose_{c}" for c in columns)
        readings = measured(names, unit, t, values, known, band, cutoff)
        if readings is None:
            continue
        reach = _reaching("imu") | {"position_delay", "heading_offset"}
        if columns == ACC:
            late = {IMU_AGE: 1.0}
            part = Part(readings, batch, rows, at, outputs, late, reach, gyro, older)
        else:
            late = {IMU_AGE: 1.0, ATTITUDE_AGE: -1.0}
            part = Part(readings, batch, rows, at, outputs, late, reach)
        found.append(part)
    return found


def other_parts(seen: Seen) -> list[Part]:
    """Magnetometer and barometer."""
    t, motion, flight = seen.aligned.inputs.t_s, seen.aligned.motion, seen.flight
    sensors: list[tuple[Component, tuple[str, ...], str, dict[str, Array]]] = []
    if motion.attitude is not None and flight.has(*MAG):
        q = motion.attitude.at(t)
        inputs = {f"q_{a}": q[:, i] for i, a in enumerate("wxyz")}
        if flight.has("ibat_a"):
            inputs["ibat_a"] = Signal(*flight.signal(["ibat_a"])).held(t)[:, 0]
        sensors.append((magnetometer(seen.vehicle, seen.effects), MAG, "T", inputs))
    if motion.position is not None and flight.has("baro_pa"):
        inputs = {"pos_z": motion.position.at(t)[:, 2]}
        if motion.velocity is not None:
            inputs |= _named("vel", motion.velocity.at(t))
        sensors.append((barometer(seen.vehicle, seen.effects), ("baro_pa",), "Pa", inputs))
    found = []
    for sensor, names, unit, inputs in sensors:
        rows = _rows(sensor, inputs, len(t))
        signal = Signal(*flight.signal(list(names)))
        known = seen.aligned.airborne & np.all(np.isfinite(rows), axis=1)
        band = min(POSE_BAND_HZ, 0.35 * signal.rate_hz)
        readings = measured(names, unit, t, signal.at(t), known, band, None)
        if readings is not None:
            batch = sensing(sensor, seen.effects, seen.names)
            reach = _reaching(cast(ComponentName, sensor.name)) | {"position_delay"}
            late = {POSITION_AGE if names == ("baro_pa",) else ATTITUDE_AGE: -1.0}
            found.append(Part(readings, batch, rows, rows, slice(None), late, reach))
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
