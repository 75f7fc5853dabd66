"""What the IMU reads and what airframe and IMU predict for it at the measured motion.

| channel | measured | predicted by |
|---|---|---|
| acc_* | accelerometer | airframe and IMU at the measured state |
| gyro_rate_* | rate of change of the gyroscope | the same |

The rotor states, which nobody measures, are integrated from the commands. The body rates that make
the state are themselves those of the gyroscope: it is compared by its rate of change. Here are all
choices that make a residual of it, for whoever compares: the grid, the low-passes, the band.
"""

from collections.abc import Iterable
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component
from ..component.rows import OverRows
from ..effects import EFFECTS, Equation, ages
from ..logs import AnyFlight
from ..physics.sensors.imu import imu
from ..physics.sensors.table import BODY, SENSORS, Sensor
from ..vehicle import Vehicle
from .aligned import AlignedFlight
from .channels import (
    BAND_HZ,
    GRID_HZ,
    Measured,
    mean_over_step,
    measured,
    on_grid,
    rate_over_step,
    shifted,
)
from .gap import Channel
from .measured import signal_of

Array = NDArray[np.float64]
OF_IMU = tuple(s for s in SENSORS if s.group == BODY)
"""Sensors of the IMU; each reads along x, y and z."""


def readings_on_grid(sensor: Sensor, flight: AnyFlight, t_s: Array) -> Array:
    """What is compared of a sensor, nothing filtered out, shape (n, 3), NaN where unknown.

    Args:
        sensor: Of the IMU.
        flight: Has its columns.
        t_s: Grid of `GRID_HZ`.
    """
    values = on_grid(signal_of(flight, sensor.columns), t_s)
    return rate_over_step(values) if sensor.rate_unit else values


def imu_readings(
    sensor: Sensor,
    flight: AnyFlight,
    vehicle: Vehicle,
    aligned: AlignedFlight,
    together: bool = False,
    axes: slice = slice(0, 3),
    left_out: NDArray[np.bool_] | None = None,
) -> Measured | None:
    """Readings of a sensor of the IMU in the air, filtered and thinned out.

    Args:
        sensor: Of the IMU.
        flight: Has its columns.
        vehicle: Its low-pass of the sensor is one that a prediction has to pass.
        aligned: The flight on a grid of `GRID_HZ`.
        together: Whether both sensors of the IMU keep the same rows, wherever both are known.
        axes: Which of x, y and z.
        left_out: Grid points that do not count, shape (n,).

    Returns:
        None where no piece of flight is long enough.
    """
    t_s = aligned.inputs.t_s
    raw = readings_on_grid(sensor, flight, t_s)
    known = _known(aligned) if left_out is None else _known(aligned) & ~left_out
    return _readings(sensor, flight, vehicle, t_s, raw, known, together, axes)


def _known(aligned: AlignedFlight) -> NDArray[np.bool_]:
    """Grid points in the air at which all states are known, shape (n,)."""
    return np.asarray(aligned.airborne & np.all(np.isfinite(aligned.states), axis=1))


def _readings(
    sensor: Sensor,
    flight: AnyFlight,
    vehicle: Vehicle,
    t_s: Array,
    raw: Array,
    known: NDArray[np.bool_],
    together: bool = False,
    axes: slice = slice(0, 3),
) -> Measured | None:
    """See `imu_readings`."""
    return measured(
        sensor.channels[axes],
        sensor.channel_unit,
        t_s,
        raw[:, axes],
        known,
        min(BAND_HZ, 0.35 * signal_of(flight, sensor.columns).rate_hz),
        sensor.cutoff_hz(vehicle),
        together,
    )


def prompt_imu(vehicle: Vehicle, effects: Iterable[str] = ()) -> Component:
    """The IMU without its low-pass, and of its own effects with those alone that change a mean.

    Low-pass and delay go over a prediction, as over its slopes, in time.

    Args:
        vehicle: Numbers of the aircraft, and the effects that are switched on.
        effects: Effects to build in, switched off.
    """
    prompt = {
        name: numbers
        for name, numbers in vehicle.effects.items()
        if isinstance(EFFECTS[name].observable_as, Equation)
    }
    still = replace(vehicle, accel_cutoff_hz=None, gyro_cutoff_hz=None)
    return imu(still.with_effects(prompt), effects)


def gyro_rate(sensor: Component, sensed: ca.SX, shown: ca.SX) -> ca.SX:
    """Rate of change of the gyroscope, whose reading follows the body rate, shape (3,).

    Args:
        sensor: IMU.
        sensed: Its inputs; the body rate changes by the angular acceleration.
        shown: Its readings as an expression of them.
    """
    change = ca.SX.zeros(sensed.shape)
    for a in "xyz":
        alpha = sensed[sensor.input_names.index(f"angular_acceleration_{a}")]
        change[sensor.input_names.index(f"omega_{a}")] = alpha
    return ca.jtimes(shown[3:], sensed, change)


def predicted_imu(aligned: AlignedFlight, vehicle: Vehicle) -> Array:
    """acc_x..z and gyro_rate_x..z of the twin at the measured states, shape (n, 6).

    Neither low-passed nor late; NaN where the state is unknown.

    Args:
        aligned: The flight on the grid of its twin.
        vehicle: The twin.
    """
    predictor = imu_predictor(aligned.airframe, vehicle)
    return predictor(in_step(aligned, vehicle), aligned.inputs.u)


def imu_predictor(body: Component, vehicle: Vehicle) -> OverRows:
    """The same of states and inputs of an airframe, for whoever asks for it more than once."""
    sensor = prompt_imu(vehicle)
    x, u = ca.SX.sym("x", len(body.states)), ca.SX.sym("u", len(body.inputs))
    y = body.outputs(x, u, body.parameter_values({"ground.enabled": 0.0}))
    outputs = {name: y[i] for i, name in enumerate(body.output_names)}
    true_motion = ca.vertcat(*[outputs[n] for n in sensor.input_names])
    sensed, p = ca.SX.sym("sensed", len(sensor.inputs)), sensor.parameter_values()
    shown = sensor.outputs(sensor.initial(sensed, p), sensed, p)
    both = ca.vertcat(shown[:3], gyro_rate(sensor, sensed, shown))
    readings = ca.cse(ca.densify(ca.substitute(both, sensed, true_motion)))
    return OverRows(ca.Function("felt", [x, u], [readings]), 2)


def in_step(aligned: AlignedFlight, vehicle: Vehicle) -> Array:
    """Measured states, shape (n, n_x), the ages of the pose taken out that the vehicle has."""
    states, late = aligned.states, ages(vehicle)
    for i, state in enumerate(aligned.airframe.states):
        age_s = late.get(state.name.rpartition("_")[0], 0.0)
        if age_s:
            states = states.copy() if states is aligned.states else states
            states[:, [i]] = shifted(states[:, [i]], -age_s, 1 / aligned.inputs.step_s)
    return states


def imu_channels(
    flight: AnyFlight, vehicle: Vehicle, aligned: AlignedFlight, predictor: OverRows | None = None
) -> list[Channel]:
    """Channels of horizon 0: accelerometer, and rate of change of the gyroscope.

    Args:
        flight: As read.
        vehicle: The twin.
        aligned: The flight on a grid of `GRID_HZ`; where nobody else holds it, it is gone before
            the readings are there.
        predictor: `imu_predictor` of the airframe, where it is at hand.
    """
    predictor = predictor or imu_predictor(aligned.airframe, vehicle)
    predictions = predictor(in_step(aligned, vehicle), aligned.inputs.u)
    t_s, late = aligned.inputs.t_s, ages(vehicle)
    known, phase_of_row = _known(aligned), aligned.phases
    del aligned
    channels: list[Channel] = []
    for k, sensor in enumerate(OF_IMU):
        if not flight.has(*sensor.columns):
            continue
        raw = readings_on_grid(sensor, flight, t_s)
        readings = _readings(sensor, flight, vehicle, t_s, raw, known)
        if readings is None:
            continue
        predicted = predictions[:, 3 * k : 3 * k + 3]
        if sensor.rate_unit:
            predicted = mean_over_step(predicted)
        if age_s := late.get(sensor.signal, 0.0):
            predicted = shifted(predicted, age_s)
        whole = [readings.unfiltered(v) for v in (t_s, raw)] + [readings.sensed(predicted)]
        simulated = readings.filtered(predicted, readings.filters_hz)
        phases = [
            phase_of_row[np.searchsorted(t_s, t - 0.5 / GRID_HZ)] for t in (whole[0], readings.t_s)
        ]
        for i, (name, unit) in enumerate((c, readings.unit) for c in readings.names):
            of_all = whole[0], whole[1][:, i], whole[2][:, i], phases[0]
            of_band = readings.t_s, readings.values[:, i], simulated[:, i], phases[1]
            wide = Channel(name, unit, 0.0, *of_all)
            channels.append(Channel(name, unit, 0.0, *of_band, unfiltered=wide))
    return channels
