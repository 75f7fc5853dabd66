"""Flights as windows for open-loop prediction from the measured motion.

The disturbance observer of `twin.physics.observer` has followed the flight before each window. Its
initial estimate is linear in the weights of a force law: a low-pass of the residual force, minus
the same low-pass of the law's output.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from twin.errors import LogError
from twin.frames import AXES, rotation_vector, to_body
from twin.logs import Flight
from twin.physics.observer import LAG_S
from twin.representation import ShortRepr
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.channels import imu_predictor, in_step, on_grid
from twin.residuals.measured import Signal, signal_of
from twin.residuals.teacher_forced import GRID_S, RIGID
from twin.vehicle import Vehicle

from .equations import STEPS, Equations

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
CLEAR_S = 0.5
"""Time in the air before the twin follows, s. Not chosen on flights."""
WARM_S = 1.0
"""Time for which the twin follows before open-loop prediction, s."""
HORIZONS_S = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Horizons at which a law is fitted, s of open-loop prediction."""
EVERY_S = 0.5
"""Time between two windows of the fit, s."""
ACCELEROMETER = tuple(f"acc_{a}" for a in AXES)
"""Columns of a flight."""
_OMEGA, _Q = (
    [RIGID.index(f"{s}_{a}") for a in names] for s, names in (("omega", AXES), ("q", "wxyz"))
)
_POS, _VEL = ([RIGID.index(f"{s}_{a}") for a in AXES] for s in ("pos", "vel"))


def true_motion(vehicle: Vehicle, aligned: AlignedFlight) -> Array:
    """Motion `RIGID` of a flight in the twin's convention, corrected for known ages; NaN where
    unknown, shape (n, 13)."""
    names = [s.name for s in aligned.airframe.states]
    return in_step(aligned, vehicle)[:, [names.index(s) for s in RIGID]]


def clear(aligned: AlignedFlight) -> BoolArray:
    """Whether an aircraft has been in the air for `CLEAR_S`, shape (n,)."""
    grounded = np.where(aligned.airborne, 0, np.arange(1, len(aligned.airborne) + 1))
    since = np.arange(len(grounded)) - np.maximum.accumulate(grounded)
    return np.asarray(aligned.airborne & (since >= round(CLEAR_S / GRID_S)))


def left_alone(known: BoolArray, steps: int, every_s: float) -> IntArray:
    """Rows at which open-loop prediction starts: the twin has followed before, and can be compared
    after.

    Args:
        known: Whether the motion is known, shape (n,).
        steps: Number of grid steps of open-loop prediction.
        every_s: Time between two starts, s.
    """
    warm = round(WARM_S / GRID_S)
    missing = np.concatenate([[0], np.cumsum(~known)])
    rows = np.arange(warm, len(known) - steps, round(every_s / GRID_S))
    return np.asarray(rows[missing[rows + steps + 1] == missing[rows - warm]], dtype=np.intp)


def apart(twin: Array, aircraft: Array) -> Array:
    """Twin minus aircraft, shapes (..., 13) to (..., 4, 3): position, velocity, attitude, rates."""
    pos, vel, omega = (twin[..., i] - aircraft[..., i] for i in (_POS, _VEL, _OMEGA))
    flat = (np.reshape(values[..., _Q], (-1, 4)) for values in (twin, aircraft))
    turned = np.reshape(rotation_vector(*flat), pos.shape)
    return np.stack([pos, vel, turned, omega], axis=-2)


def turn_slopes(motion: Array) -> Array:
    """Derivative of a small rotation by the quaternion of a motion, shapes (w, 13) to (w, 3, 4)."""
    w, x, y, z = motion[:, _Q].T
    rows = [(-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w)]
    return np.asarray(2 * np.stack([np.stack(row, axis=-1) for row in rows], axis=1))


@dataclass(frozen=True, slots=True)
class FlightWindows(ShortRepr):
    """Windows of one flight; w windows of n steps of `STEPS` grid steps each.

    Attributes:
        name: Name of the flight.
        start: Airframe states at the starts, shape (w, n_x).
        inputs: Airframe inputs, mean over each step, shape (w, n, n_u).
        volts: Battery voltage, mean over each step, V, shape (w, n, 1).
        truth: Motion `RIGID` at `HORIZONS_S`, shape (w, h, 13).
        lacks: Observer estimates at the starts without a law: specific force, m/s2, and angular
            acceleration, rad/s2; shape (w, 6).
        knows: The features, filtered by the same low-pass, shape (w, k).
        features: Features at all times in the air, shape (m, k).
        places: Inputs of the law at the same times, shape (m, i).
        left: Residual of the equations at the same times, as `lacks`, shape (m, 6).
        sensed: Statistics of the lateral residual force, filtered like in the observer: mean
            product with the accelerometer's reading minus its prediction, and mean square,
            (m/s2)^2; zeros without an accelerometer.
    """

    name: str
    start: Array
    inputs: Array
    volts: Array
    truth: Array
    lacks: Array
    knows: Array
    features: Array
    places: Array
    left: Array
    sensed: tuple[float, float]

    @classmethod
    def of(cls, flight: Flight, vehicle: Vehicle, equations: "Equations") -> "FlightWindows":
        """Windows of a flight.

        Raises:
            LogError: The flight is nowhere long enough in the air with known motion.
        """
        aligned = align_flight(flight, vehicle)
        motion = true_motion(vehicle, aligned)
        states = aligned.states.copy()
        states[:, equations.rigid] = motion
        known = clear(aligned) & np.isfinite(states).all(axis=1)
        begins = left_alone(known, round(HORIZONS_S[-1] / GRID_S), EVERY_S)
        if not len(begins):
            raise LogError(
                f"{flight.name}: nowhere {WARM_S + HORIZONS_S[-1]:g} s in the air without a gap, "
                f"position, velocity, attitude and body rates known, which it takes to learn a "
                f"force. Give a longer flight."
            )
        u, volts = aligned.inputs.u, voltage(flight, vehicle, aligned.inputs.t_s)
        states = np.where(known[:, None], states, states[begins[0]])
        follows = known & np.append(known[1:], False)
        features = equations.features(states, u, volts)
        lacks = _lacks(states, motion, equations.after(states, u))
        lacks = np.where(follows[:, None], lacks, 0.0)
        rows = begins[:, None] + STEPS * np.arange(round(HORIZONS_S[-1] / GRID_S) // STEPS)
        before = begins - 1
        return cls(
            name=flight.name,
            start=states[begins],
            inputs=_means(u, rows),
            volts=_means(volts, rows),
            truth=np.stack([motion[begins + round(h / GRID_S)] for h in HORIZONS_S], axis=1),
            lacks=_followed(lacks)[before],
            knows=_followed(np.where(follows[:, None], features, 0.0))[before],
            features=features[follows],
            places=equations.places(states, u, volts)[follows],
            left=lacks[follows],
            sensed=_sensed(flight, vehicle, aligned, states, lacks, follows),
        )


def voltage(flight: Flight, vehicle: Vehicle, t_s: Array) -> Array:
    """Battery voltage on the grid, V, or the nominal one where the flight has none, shape (n,
    1)."""
    if not flight.has("vbat_v"):
        return np.full((len(t_s), 1), vehicle.voltage_v)
    return Signal(*flight.signal(["vbat_v"])).held(t_s)


def _lacks(states: Array, motion: Array, after: Array) -> Array:
    """Specific force and angular acceleration missing in a grid step, shape (n, 6).

    Args:
        states: Airframe states, shape (n, n_x).
        motion: Measured motion, as `RIGID`, shape (n, 13).
        after: Predicted motion one grid step after `states`, shape (n, 13).
    """
    away = (np.vstack([motion[1:], motion[-1:]]) - after) / GRID_S
    q = [motion[:, i] for i in _Q]
    force = np.stack(to_body(q, [away[:, i] for i in _VEL]), axis=-1)
    return np.asarray(np.nan_to_num(np.hstack([force, away[:, _OMEGA]])))


def _sensed(
    flight: Flight,
    vehicle: Vehicle,
    aligned: AlignedFlight,
    states: Array,
    lacks: Array,
    follows: BoolArray,
) -> tuple[float, float]:
    """`FlightWindows.sensed`."""
    if not flight.has(*ACCELEROMETER):
        return 0.0, 0.0
    reads = on_grid(signal_of(flight, ACCELEROMETER), aligned.inputs.t_s)[:, :2]
    over = reads - imu_predictor(aligned.airframe, vehicle)(states, aligned.inputs.u)[:, :2]
    known = follows & np.isfinite(over).all(axis=1)
    over, across = (_followed(np.where(known[:, None], v[:, :2], 0.0)) for v in (over, lacks))
    return float(np.mean(over * across)), float(np.mean(across**2))


def accelerometer_confirms(flights: Sequence[FlightWindows]) -> bool:
    """Whether the accelerometer confirms most of the lateral residual force of flights.

    Then it is a real force. Otherwise the attitude of the flight is tilted, as in motion capture,
    and a law fitted to it would not hold for other flights.
    """
    both, square = np.sum([f.sensed for f in flights], axis=0)
    return bool(both > 0.5 * square)


def _followed(values: Array) -> Array:
    """Values filtered like in the disturbance observer."""
    share = GRID_S / LAG_S
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, axis=0))


def _means(values: Array, rows: IntArray) -> Array:
    """Mean over `STEPS` grid steps from each row on, shape (*rows.shape, k)."""
    sums = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), values]), axis=0)
    return np.asarray((sums[rows + STEPS] - sums[rows]) / STEPS)


def sizes(flights: Sequence[FlightWindows]) -> Array:
    """Standard deviation of each feature over flights, 1 for a constant one, shape (k,)."""
    spread = np.std(np.vstack([f.features for f in flights]), axis=0)
    return np.asarray(np.where(spread > _TRIFLE, spread, 1.0))


_TRIFLE = 1e-6
"""Standard deviation of a feature, in its unit, below which it is constant."""
