"""Flights as instants: what the equations leave of force and moment, and the motion it came with.

Teacher-forced: the airframe is evaluated at the measured state, and what the IMU reads beyond is
put down to a force and a moment. Readings and whatever is to explain them pass the same causal
low-pass, as in `twin.residuals.channels`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from twin.component.rows import OverRows
from twin.effects import ages
from twin.errors import LogError
from twin.frames import AXES, to_body
from twin.logs import Flight
from twin.physics.residual_force import INPUTS, OUTPUTS, features, motion_inputs
from twin.representation import short_repr
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.channels import (
    CHANNEL_HZ,
    GRID_HZ,
    OF_IMU,
    Measured,
    gyro_rate,
    imu_readings,
    in_step,
    predicted_imu,
    prompt_imu,
    shifted,
)
from twin.residuals.measured import Signal
from twin.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Instants:
    """One flight.

    Attributes:
        name: Of the flight.
        t_s: Shape (n,).
        piece: Number of the uninterrupted piece of flight of each instant, shape (n,).
        left: Specific force, m/s2, and angular acceleration, rad/s2, that the equations lack,
            low-passed, shape (n, 6).
        motion: `INPUTS` at all grid points of the flight, shape (n_grid, len(INPUTS)), NaN where
            unknown.
        airborne: Which of these are in the air, shape (n_grid,).
        passed: Two functions `(values on the grid, (n_grid, k)) -> (n, k)`, of force and of moment:
            low-passed and as late as these columns of `left` are.
    """

    name: str
    t_s: Array
    piece: NDArray[np.intp]
    left: Array
    motion: Array
    airborne: NDArray[np.bool_]
    passed: tuple[Callable[[Array], Array], Callable[[Array], Array]]

    __repr__ = short_repr

    def filtered_features(self, law: ca.Function) -> tuple[Array, Array]:
        """A function of the motion at the instants, as force and as moment show it; (n, k) each.

        Args:
            law: `(len(INPUTS),) -> (k,)`.
        """
        values = OverRows(law, 1)(self.motion)
        force, moment = self.passed
        return force(values), moment(values)


def linear_features() -> ca.Function:
    """`INPUTS` to `FEATURES`."""
    x = ca.SX.sym("x", len(INPUTS))
    return ca.Function("features", [x], [ca.densify(features(x))])


def instants(flight: Flight, vehicle: Vehicle) -> Instants:
    """What a vehicle's equations leave of a flight.

    Raises:
        LogError: The flight lacks the IMU or the motion, or has no piece in the air that is long
            enough.
    """
    for sensor in OF_IMU:
        if not flight.has(*sensor.columns):
            raise LogError(
                f"{flight.name}: no {', '.join(sensor.columns)}: forces and moments are learned "
                f"from accelerometer and gyroscope. Give flights that have both."
            )
    aligned = align_flight(flight, vehicle, 1 / GRID_HZ)
    found = [imu_readings(s, flight, vehicle, aligned, together=True) for s in OF_IMU]
    if any(r is None for r in found):
        raise LogError(f"{flight.name}: no piece in the air is long enough to learn from.")
    acc, gyro = (r for r in found if r is not None)
    t_s, of_acc, of_gyro = np.intersect1d(acc.t_s, gyro.t_s, return_indices=True)
    if not len(t_s):
        raise LogError(
            f"{flight.name}: accelerometer and gyroscope are nowhere in the air known at the same "
            f"time. Give a flight in which both were logged throughout."
        )
    fine = align_flight(flight, vehicle)
    steps = _Steps(fine.inputs.t_s, aligned.inputs.t_s)
    predicted, late = predicted_imu(fine, vehicle), ages(vehicle)
    left = []
    for k, (sensor, readings, rows) in enumerate(
        zip(OF_IMU, (acc, gyro), (of_acc, of_gyro), strict=True)
    ):
        said = predicted[:, 3 * k : 3 * k + 3]
        said = steps.means(said) if sensor.rate else steps.ends(said)
        if age_s := late.get(sensor.signal, 0.0):
            said = shifted(said, age_s)
        left.append((readings.values - readings.filtered(said, readings.filters_hz))[rows])
    acceleration, read = responses(fine, vehicle)
    return Instants(
        name=flight.name,
        t_s=t_s,
        piece=_pieces(t_s, acc.piece[of_acc], gyro.piece[of_gyro]),
        left=np.hstack(left) @ np.linalg.solve(read.T, acceleration.T),
        motion=_motion(fine, vehicle, _voltage(flight, vehicle, fine.inputs.t_s)),
        airborne=fine.airborne,
        passed=(
            partial(_passed, acc, of_acc, steps.ends, late.get(OF_IMU[0].signal, 0.0)),
            partial(_passed, gyro, of_gyro, steps.means, late.get(OF_IMU[1].signal, 0.0)),
        ),
    )


def _pieces(t_s: Array, *numbers: NDArray[np.intp]) -> NDArray[np.intp]:
    """Number of the uninterrupted piece of each instant: of neither sensor a new one begins."""
    begins = np.diff(t_s) > 1.5 / CHANNEL_HZ
    for number in numbers:
        begins |= np.diff(number) != 0
    return np.concatenate([[0], np.cumsum(begins)]).astype(np.intp)


class _Steps:
    """From the grid of the twin to that of the readings: commands change within a step of it."""

    def __init__(self, fine_s: Array, coarse_s: Array) -> None:
        self._every = round((coarse_s[1] - coarse_s[0]) / (fine_s[1] - fine_s[0]))
        rows = np.round((coarse_s - fine_s[0]) / (fine_s[1] - fine_s[0])).astype(int)
        self._rows = np.clip(rows, 0, len(fine_s) - 1)

    def ends(self, values: Array) -> Array:
        """Values at the ends of the steps."""
        return np.asarray(values[self._rows])

    def means(self, values: Array) -> Array:
        """Means over the steps, by trapezia."""
        middle = np.vstack([values[:1], (values[1:] + values[:-1]) / 2])
        steps = [middle[np.maximum(self._rows - k, 0)] for k in range(self._every)]
        return np.asarray(np.mean(steps, axis=0))


def _passed(
    readings: Measured,
    rows: NDArray[np.intp],
    sampled: Callable[[Array], Array],
    age_s: float,
    values: Array,
) -> Array:
    """Values on the grid of the twin as a sensor shows them."""
    shown = sampled(np.nan_to_num(values))
    late = shifted(shown, age_s) if age_s else shown
    return readings.filtered(late, readings.filters_hz)[rows]


def responses(aligned: AlignedFlight, vehicle: Vehicle) -> tuple[Array, Array]:
    """What a force and a moment from outside do to a vehicle, `OUTPUTS` in columns.

    Returns:
        To specific force and angular acceleration, (6, 6); to accelerometer and rate of the
        gyroscope, (6, 6).
    """
    body, sensor = aligned.airframe, prompt_imu(vehicle)
    p, u0 = body.parameter_values({"ground.enabled": 0.0}), body.input_values()
    u = ca.SX.sym("u", len(u0))
    y = body.outputs(body.initial(u0, p), u, p)
    outputs = {name: y[i] for i, name in enumerate(body.output_names)}
    stems = ("specific_force", "angular_acceleration")
    acceleration = ca.vertcat(*[outputs[f"{stem}_{a}"] for stem in stems for a in AXES])
    given = ca.vertcat(*[outputs[n] for n in sensor.input_names])
    sensed, q = ca.SX.sym("sensed", len(sensor.inputs)), sensor.parameter_values()
    shown = sensor.outputs(sensor.initial(sensed, q), sensed, q)
    both = ca.vertcat(shown[:3], gyro_rate(sensor, sensed, shown))
    read = ca.substitute(both, sensed, given)
    columns = [body.input_names.index(f"{kind}_{a}") for kind, a in OUTPUTS]
    slopes = ca.Function(
        "slopes", [u], [ca.jacobian(v, u)[:, columns] for v in (acceleration, read)]
    )
    a, b = (np.asarray(v, dtype=np.float64) for v in slopes(u0))
    return a, b


def _voltage(flight: Flight, vehicle: Vehicle, t_s: Array) -> Array:
    """Battery voltage at the grid, the nominal one where the flight has none; shape (n, 1)."""
    if not flight.has("vbat_v"):
        return np.full((len(t_s), 1), vehicle.voltage_v)
    return Signal(*flight.signal(["vbat_v"])).held(t_s)


def _motion(aligned: AlignedFlight, vehicle: Vehicle, voltage_v: Array) -> Array:
    """`INPUTS` at the measured states, shape (n_grid, len(INPUTS))."""
    body = aligned.airframe
    x, u = ca.SX.sym("x", len(body.states)), ca.SX.sym("u", len(body.inputs))
    volts = ca.SX.sym("volts")
    y = body.outputs(x, u, body.parameter_values({"ground.enabled": 0.0}))
    state = {s.name: x[i] for i, s in enumerate(body.states)}
    given = {n: u[i] for i, n in enumerate(body.input_names)}
    spin = [y[body.output_names.index(f"spin_{i}")] for i in range(1, vehicle.rotors.count + 1)]
    q_nb = [state[f"q_{a}"] for a in "wxyz"]
    through = [state[f"vel_{a}"] - given[f"wind_{a}"] for a in AXES]
    motion = motion_inputs(
        vehicle,
        to_body(q_nb, through),
        [state[f"omega_{a}"] for a in AXES],
        spin,
        volts,
        -state["pos_z"],
    )
    rows = OverRows(ca.Function("motion", [x, u, volts], [ca.densify(motion)]), 3)
    return rows(in_step(aligned, vehicle), aligned.inputs.u, voltage_v)


def inputs_of(flight: Instants) -> Array:
    """`INPUTS` of a flight in the air, where they are known, shape (n, len(INPUTS))."""
    motion = flight.motion[flight.airborne]
    return np.asarray(motion[np.isfinite(motion).all(axis=1)])
