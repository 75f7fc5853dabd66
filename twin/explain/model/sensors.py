"""Sensors of a flight: what each read, and what predicts it from rows on the grid."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...physics.sensors.table import BODY, SENSORS
from ...residuals.aligned import AlignedFlight
from ...residuals.channels import POSE_BAND_HZ, measured, shifted
from ...residuals.imu import OF_IMU, imu_readings
from ...residuals.measured import Signal
from .factors import (
    FlightContext,
    SensorFactor,
    driven_apart,
    moving,
    named,
    reaching,
    rows_of,
    shift_signs,
)
from .numbers import DRIVES, PLACE, TURN
from .prediction import SensorBatch

Array = NDArray[np.float64]
OF_POSE = tuple(s for s in SENSORS if s.group != BODY)


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
        rate = bool(sensor.rate_unit)
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
    pose = _pose(context.aligned)
    found = []
    for kind in OF_POSE:
        if not flight.has(*kind.columns) or not set(kind.needs) <= pose.keys():
            continue
        sensor = kind.make(context.vehicle, context.effects)
        inputs = {k: v for signal in pose.values() for k, v in signal.items()}
        for name in sensor.input_names:
            if name not in inputs and flight.has(name):
                inputs[name] = Signal(*flight.signal([name])).held(t)[:, 0]
        rows = rows_of(sensor, inputs, len(t))
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


def _pose(aligned: AlignedFlight) -> dict[str, dict[str, Array]]:
    """Measured motion by signal, as inputs of sensors on the grid."""
    t, motion = aligned.inputs.t_s, aligned.motion
    found = {}
    if motion.position is not None:
        found["pos"] = named("pos", motion.position.at(t))
    if motion.velocity is not None:
        found["vel"] = named("vel", motion.velocity.at(t))
    if motion.attitude is not None:
        found["q"] = named("q", motion.attitude.at(t), "wxyz")
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
