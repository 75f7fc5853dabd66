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
from .numbers import DRIVES, PLACE, TURN
from .parts import Part, Seen, driven_apart, late_by, moving, named, reaching, rows_of
from .prediction import SensorBatch

Array = NDArray[np.float64]
OF_POSE = tuple(s for s in SENSORS if s.group != BODY)


def imu_parts(seen: Seen) -> list[Part]:
    """Accelerometer, and rate of change of the gyroscope."""
    flight, nothing = seen.flight, np.zeros((0, 0))
    found = []
    for k, sensor in enumerate(OF_IMU):
        if not flight.has(*sensor.columns):
            continue
        late = late_by(seen, (sensor.signal,), ())
        reach = reaching("airframe", sensor.component) | moving(seen, (*PLACE, *TURN, *DRIVES))
        reach |= {name.partition(".")[0] for name in late}
        rate = bool(sensor.rate_unit)
        for axes, left_out in driven_apart(seen, rate):
            readings = imu_readings(
                sensor, flight, seen.vehicle, seen.aligned, axes=axes, left_out=left_out
            )
            if readings is not None:
                outputs = slice(3 * k + axes.start, 3 * k + axes.stop)
                found.append(Part(readings, None, nothing, nothing, outputs, late, reach, rate))
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
        rows = rows_of(sensor, inputs, len(t))
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
                late_by(seen, (kind.signal,), () if two_clocks else felt),
                reaching(kind.component) | moving(seen, (kind.signal, *felt)),
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
