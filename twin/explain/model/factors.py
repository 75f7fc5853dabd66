"""What is compared of a flight: readings, and what predicts them, whatever measured them."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...effects import EFFECTS
from ...frames import to_body, to_ned
from ...logs import Flight
from ...logs.columns import ACC_NED
from ...representation import short_repr
from ...residuals.aligned import AlignedFlight
from ...residuals.at_samples import smooth_at
from ...residuals.channels import Measured
from ...residuals.measured import AnySignal, Signal
from ...vehicle import Vehicle
from .numbers import Number
from .prediction import SensorBatch

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FlightContext:
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
class SensorFactor:
    """One sensor of a flight: readings, and what predicts them from rows on the grid.

    Attributes:
        readings: Measured.
        batch: Prediction; None: that of airframe and IMU, or of the airframe alone.
        rows: Its inputs, shape (n, n_u).
        at: Inputs at which its slopes are taken, shape (n, n_u).
        outputs: Which of its outputs.
        late: Sign with which ages, "effect.number", shift the prediction.
        effects: Effects that reach the prediction.
        rate: Whether the readings are rates of change, of what the sensor reads.
        turning: Body rates, shape (n, 3), where position and attitude both make the prediction.
        older: Rows with position and attitude from so many seconds later, where they do.
        as_logged: Where the pose is what is compared with the airframe alone, no IMU in between:
            `(values on the grid, numbers) -> values` as a pose of that age and heading shows them.
        axes: Which of these are the readings.
        averaged: Signals of the pose in whose place the motion itself would be predicted from.
        sampled: `values on the grid, shape (n, k, m) -> values` as they are seen at the samples of
            the pose alone, where the readings are; None: the readings are as they were read.
        carried: What that changes of the prediction by the model as it stands, shape (n, k), where
            the motion adds to what the pose implies.
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
    as_logged: Callable[[Array, Array], Array] | None = None
    axes: slice = field(default_factory=lambda: slice(0, 3))
    averaged: frozenset[str] = frozenset()
    sampled: Callable[[Array], Array] | None = None
    carried: Array | None = None

    __repr__ = short_repr


def driven_apart(
    context: FlightContext, rate: bool
) -> list[tuple[slice, NDArray[np.bool_] | None]]:
    """Axes of a specific force, or of an angular acceleration, with the grid points to leave out.

    While a motor is at a limit its command does not tell thrust and torque; what acts across the
    thrust does not depend on it.

    Args:
        context: A flight and its twin.
        rate: Whether of the angular acceleration.
    """
    saturated = context.aligned.saturated
    if not (saturated & context.aligned.airborne).any():
        return [(slice(0, 3), None)]
    if rate:
        return [(slice(0, 3), saturated)]
    return [(slice(0, 2), None), (slice(2, 3), saturated)]


def pull_signal(context: FlightContext) -> tuple[AnySignal, int] | None:
    """What shows the acceleration of the pose, and how often it is to be differentiated.

    The acceleration of the record where it has one, else the velocity; None without either.
    """
    if context.flight.has(*ACC_NED):
        return Signal(*context.flight.signal(ACC_NED)), 0
    velocity = context.aligned.motion.velocity
    return None if velocity is None else (velocity, 1)


def pull_of_pose(context: FlightContext) -> Array | None:
    """Acceleration that the pose shows less gravity, NED, on the grid, shape (n, 3)."""
    shown = pull_signal(context)
    if shown is None:
        return None
    signal, derivative = shown
    pull = smooth_at(signal, context.aligned.inputs.t_s, derivative)
    pull[:, 2] -= context.vehicle.gravity_m_s2
    return pull


def shift_signs(
    context: FlightContext, shown: Collection[str], measured_from: Collection[str]
) -> dict[str, float]:
    """Sign with which each age shifts a prediction: later where what is shown is old, earlier where
    what it is told from is."""
    late = {}
    for n in context.numbers:
        if set(n.moves) & set(shown):
            late[n.full] = 1.0
        elif set(n.moves) & set(measured_from):
            late[n.full] = -1.0
    return late


def moving(context: FlightContext, signals: Collection[str]) -> frozenset[str]:
    """Effects that shift some signals."""
    return frozenset(n.effect for n in context.numbers if set(n.moves) & set(signals))


def reaching(*components: str) -> frozenset[str]:
    """Effects that act on some components."""
    return frozenset(e.name for e in EFFECTS.values() if e.component in components)


def named(stem: str, values: Array, axes: str = "xyz") -> dict[str, Array]:
    """Columns of a signal by name, `stem_x` and so on."""
    return {f"{stem}_{a}": values[:, i] for i, a in enumerate(axes)}


def rows_of(sensor: Component, inputs: Mapping[str, Array], n: int) -> Array:
    """Inputs of a sensor in its order; what is not given stays at its start."""
    rows = np.tile(sensor.input_values(), (n, 1))
    for i, name in enumerate(sensor.input_names):
        if name in inputs:
            rows[:, i] = inputs[name]
    return rows


def in_body(q_nb: Array, pull_n: Array) -> Array:
    """A force in NED, in body axes of unit quaternions; shape (n, 3)."""
    q = q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True)
    return np.stack(to_body(list(q.T), list(pull_n.T)), axis=-1)


def in_ned(q_nb: Array, force_b: Array) -> Array:
    """A force in body axes of unit quaternions, in NED; shape (n, 3)."""
    q = q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True)
    return np.stack(to_ned(list(q.T), list(force_b.T)), axis=-1)
