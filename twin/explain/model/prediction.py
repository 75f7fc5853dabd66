"""What components predict for measured motion, and how the prediction answers to effects.

An effect without a memory of its own changes equations: its regressors are the exact derivatives
of the prediction with respect to its numbers, from the CasADi expressions of the components, all
in one batch. The components are built once, with every effect switched on; an effect at its
neutral value is as good as off.
"""

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...component.rows import OverRows
from ...physics.airframe import airframe
from ...physics.rotors import Drive
from ...physics.sensors.imu import imu
from ...vehicle import Vehicle

Array = NDArray[np.float64]


class Batch:
    """A function of measured rows and of numbers, with its derivatives by the numbers."""

    def __init__(self, rows: Sequence[ca.SX], theta: ca.SX, readings: ca.SX) -> None:
        """Take the expressions."""
        self._rows, self._theta, self._readings = list(rows), theta, readings
        value = ca.Function("value", [*rows, theta], [ca.cse(ca.densify(readings))])
        self._value = OverRows(value, len(rows))
        self._slopes: dict[tuple[int, ...], OverRows] = {}

    def value(self, theta: Array, *rows: Array) -> Array:
        """Predicted readings, shape (n, c), of rows of shape (n, ...)."""
        return self._value(*rows, theta)

    def slopes(self, columns: Sequence[int], theta: Array, *rows: Array) -> Array:
        """Derivatives of the readings by some numbers, shape (n, c, len(columns))."""
        shape = (len(columns), int(self._readings.shape[0]))
        if not columns:
            return np.zeros((len(rows[0]), shape[1], 0))
        key = tuple(columns)
        if key not in self._slopes:
            slopes = ca.jacobian(self._readings, self._theta)[:, list(columns)]
            expression = ca.cse(ca.vec(ca.densify(slopes)))
            function = ca.Function("slopes", [*self._rows, self._theta], [expression])
            self._slopes[key] = OverRows(function, len(self._rows))
        flat = self._slopes[key](*rows, theta)
        return flat.T.reshape(*shape, len(flat)).transpose(2, 1, 0)


def physics(
    vehicle: Vehicle, drive: Drive, effects: Sequence[str], names: Sequence[str]
) -> tuple[Component, Batch]:
    """Airframe and IMU: `(states, inputs, numbers) -> acc_x..z, rate of gyro_x..z`.

    The low-pass of the IMU is left out: it is linear, and goes over prediction and slopes alike.

    Args:
        vehicle: The model as it stands.
        drive: What drives its rotors.
        effects: Effects to switch on, each without a memory.
        names: Of the numbers, "effect.number"; those of other components are not felt.

    Returns:
        The airframe, whose states and inputs the rows are, and the function.
    """
    body = airframe(vehicle, drive, effects)
    sensor = imu(replace(vehicle, accel_cutoff_hz=None, gyro_cutoff_hz=None), effects)
    theta = ca.SX.sym("theta", len(names))
    x, u = ca.SX.sym("x", len(body.states)), ca.SX.sym("u", len(body.inputs))
    y = body.outputs(x, u, _parameters(body, effects, names, theta, {"ground.enabled": 0.0}))
    outputs = {name: y[i] for i, name in enumerate(body.output_names)}
    felt = ca.vertcat(*[outputs[n] for n in sensor.input_names])
    sensed = ca.SX.sym("sensed", len(sensor.inputs))
    shown = _shown(sensor, sensed, _parameters(sensor, effects, names, theta, {}))
    # The reading of the gyroscope follows the body rate, which changes by the acceleration.
    change = ca.SX.zeros(sensed.shape)
    for a in "xyz":
        alpha = sensed[sensor.input_names.index(f"angular_acceleration_{a}")]
        change[sensor.input_names.index(f"omega_{a}")] = alpha
    readings = ca.vertcat(shown[:3], ca.jtimes(shown[3:], sensed, change))
    return body, Batch([x, u], theta, ca.substitute(readings, sensed, felt))


def sensing(sensor: Component, effects: Sequence[str], names: Sequence[str]) -> Batch:
    """A sensor alone, noise left out: `(inputs, numbers) -> outputs`.

    Args:
        sensor: Built with the effects.
        effects: Effects to switch on, each without a memory.
        names: Of the numbers, "effect.number"; those of other components are not felt.
    """
    theta = ca.SX.sym("theta", len(names))
    sensed = ca.SX.sym("sensed", len(sensor.inputs))
    shown = _shown(sensor, sensed, _parameters(sensor, effects, names, theta, {}))
    return Batch([sensed], theta, shown)


def _shown(sensor: Component, sensed: ca.SX, p: ca.SX) -> ca.SX:
    """Readings without noise: its memory is at its start."""
    return sensor.outputs(sensor.initial(sensed, p), sensed, p)


def _parameters(
    part: Component,
    effects: Sequence[str],
    names: Sequence[str],
    theta: ca.SX,
    values: dict[str, float],
) -> ca.SX:
    """Parameters of a part: its start values, the effects on, the numbers as symbols."""
    known = {v.name: i for i, v in enumerate(part.parameters)}
    on = {f"{e}.enabled": 1.0 for e in effects if f"{e}.enabled" in known}
    p = ca.SX(part.parameter_values(on | values))
    for i, name in enumerate(names):
        if name in known:
            p[known[name]] = theta[i]
    return p
