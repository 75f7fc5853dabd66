"""Residual channels of a flight: measured and predicted, filtered alike.

Readings are put on a grid of `GRID_HZ`, in the air; measured and predicted pass the same causal
low-pass and are thinned out to `CHANNEL_HZ`. Causal, so that no reading is explained by what came
after it: with a controller in the loop, a filter that looks ahead would read the controller
backwards. As a linear model a channel is residual = slopes @ change of numbers + noise.

| channel of the IMU | measured | predicted by |
|---|---|---|
| acc_* | accelerometer | airframe and IMU at the measured state |
| gyro_rate_* | rate of change of the gyroscope | the same |

The rotor states, which no sensor measures, are integrated from the commands. The body rates of the
state are themselves those of the gyroscope: it is compared by its rate of change.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import casadi as ca
import numpy as np
import scipy
from numpy.typing import NDArray

from ..component import Component
from ..component.rows import OverRows
from ..effects import EFFECTS, Equation, ages
from ..logs import AnyFlight
from ..logs.samples import stretches_where
from ..physics.sensors.imu import imu
from ..physics.sensors.table import BODY, SENSORS, Sensor
from ..representation import short_repr
from ..vehicle import Vehicle
from .aligned import AlignedFlight
from .gap import Channel
from .measured import AnySignal, filtered_at, signal_of

Array = NDArray[np.float64]
GRID_HZ = 200.0
"""Rate of the grid on which components are evaluated."""
CHANNEL_HZ = 50.0
"""Rate of the channels."""
PADDED = 14
"""Grid points by which ends are carried on in a shift: cubic splines have forgotten them there."""
BAND_HZ = 18.0
"""Low-pass of measured and predicted: the body moves below it, rotors vibrate above it."""
POSE_BAND_HZ = 6.0
"""Low-pass of what is derived from position and attitude by differences."""
SHORTEST_S = 1.5
"""Shorter pieces of flight are left out."""


@dataclass(frozen=True, slots=True)
class ChannelData:
    """One channel of one flight.

    Attributes:
        name: Of the channel.
        unit: Of the residual.
        t_s: Shape (n,).
        measured: Shape (n,).
        residual: Measured minus predicted, shape (n,).
        slopes: Derivative of the prediction by each number, shape (n, k).
        piece: Number of the uninterrupted piece of flight each sample belongs to, shape (n,).
    """

    name: str
    unit: str
    t_s: Array
    measured: Array
    residual: Array
    slopes: Array
    piece: NDArray[np.intp]

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Measured:
    """Readings of one sensor on the grid of a flight, filtered and thinned out.

    Attributes:
        names: Of its channels.
        unit: Of all of them.
        filters_hz: Low-passes that a prediction has to pass, one after the other.
        rows: Per uninterrupted piece, the grid points it covers.
        settle: Grid points at the start of a piece that the filters take.
        values: At the retained rows, all pieces together, shape (n, c).
        t_s: Times of these rows, shape (n,).
        piece: Number of the piece, shape (n,).
    """

    names: tuple[str, ...]
    unit: str
    filters_hz: tuple[float, ...]
    rows: tuple[NDArray[np.intp], ...]
    settle: int
    values: Array
    t_s: Array
    piece: NDArray[np.intp]

    __repr__ = short_repr

    def filtered(self, values: Array, filters_hz: Sequence[float]) -> Array:
        """Retained rows of values on the grid, low-passed piece by piece."""
        return self._over_pieces(values, filters_hz, EVERY)

    def unfiltered(self, values: Array) -> Array:
        """All rows of values on the grid from where the filters have settled, not thinned out."""
        return self._over_pieces(values, (), 1)

    def sensed(self, predicted: Array) -> Array:
        """The same of a prediction, which passes the low-pass of the sensor alone."""
        return self._over_pieces(predicted, self.filters_hz[:-1], 1)

    def _over_pieces(self, values: Array, filters_hz: Sequence[float], every: int) -> Array:
        retained = []
        for rows in self.rows:
            part = values[rows[0] : rows[-1] + 1]
            for cutoff in filters_hz:
                part = low_pass(part, cutoff)
            retained.append(part[self.settle :: every])
        return np.concatenate(retained)

    def channels(self, predicted: Array, slopes: Array) -> list[ChannelData]:
        """Channels against a prediction on the grid.

        Args:
            predicted: Shape (n_grid, c).
            slopes: Shape (n_grid, c, k).
        """
        found = []
        for i, name in enumerate(self.names):  # one by one: slopes of all fill the memory
            some = np.flatnonzero(np.any(slopes[:, i] != 0, axis=0))
            both = np.vstack([predicted[:, i], slopes[:, i, some].T]).T  # filters run along columns
            both = self.filtered(both, self.filters_hz)
            own, answer = self.values[:, i], np.zeros((len(both), slopes.shape[2]))
            residual, answer[:, some] = own - both[:, 0], both[:, 1:]
            found.append(ChannelData(name, self.unit, self.t_s, own, residual, answer, self.piece))
        return found


EVERY = round(GRID_HZ / CHANNEL_HZ)  # grid points per sample of a channel


def measured(
    names: Sequence[str],
    unit: str,
    t_s: Array,
    values: Array,
    known: NDArray[np.bool_],
    band_hz: float,
    sensor_hz: float | None,
    together: bool = False,
    passes: int = 1,
) -> Measured | None:
    """Filter readings on the grid; None where no piece of them is long enough.

    Args:
        names: Of the channels.
        unit: Of the readings.
        t_s: Grid, shape (n,).
        values: Shape (n, c), NaN where unknown.
        known: Grid points that count, shape (n,).
        band_hz: Low-pass of readings and prediction.
        sensor_hz: Low-pass that the readings have behind them and a prediction has not.
        together: Whether the retained rows are among those of every other sensor that is so
            filtered, wherever both are known.
        passes: How often readings and prediction pass that low-pass.
    """
    pieces = _pieces(known & np.all(np.isfinite(values), axis=1))
    if not pieces:
        return None
    settle = round(2 / band_hz * GRID_HZ)
    if together:
        pieces = [rows[-(rows[0] + settle) % EVERY :] for rows in pieces]
    bands = (band_hz,) * passes
    filters = bands if sensor_hz is None else (sensor_hz, *bands)
    group = Measured(
        names=tuple(names),
        unit=unit,
        filters_hz=filters,
        rows=tuple(pieces),
        settle=settle,
        values=values,
        t_s=t_s,
        piece=np.zeros(0, dtype=np.intp),
    )
    retained = [rows[settle::EVERY] for rows in pieces]
    number = [np.full(len(rows), k, dtype=np.intp) for k, rows in enumerate(retained)]
    return replace(
        group,
        values=group.filtered(values, bands),
        t_s=t_s[np.concatenate(retained)],
        piece=np.concatenate(number),
    )


class LowPass:
    """Causal second-order Butterworth low-pass along axis 0, settled on the first value, of rows
    that come block by block."""

    def __init__(self, cutoff_hz: float) -> None:
        self._cutoff_hz = cutoff_hz
        self._state: Array | None = None

    def next(self, values: Array) -> Array:
        """The next rows, low-passed."""
        if self._cutoff_hz >= 0.45 * GRID_HZ:
            return values
        b, a, settled = _butterworth(self._cutoff_hz)
        if self._state is None:
            self._state = values[:1].T * settled
        passed, self._state = scipy.signal.lfilter(b, a, values.T, axis=-1, zi=self._state)
        return np.asarray(passed.T, dtype=np.float64)


def low_pass(values: Array, cutoff_hz: float) -> Array:
    """All rows through a `LowPass`."""
    return LowPass(cutoff_hz).next(values)


@cache
def _butterworth(cutoff_hz: float) -> tuple[Array, Array, Array]:
    """Second order on the grid: coefficients, and the state that is settled on one."""
    b, a = scipy.signal.butter(2, cutoff_hz / (GRID_HZ / 2))
    return b, a, scipy.signal.lfilter_zi(b, a)


def rate_over_step(values: Array) -> Array:
    """Rate of change over the step of the grid that ends at each row, shape as the values."""
    return np.diff(values, axis=0, prepend=values[:1]) * GRID_HZ


def mean_over_step(values: Array) -> Array:
    """Mean over the same step: what `rate_over_step` is of a signal with these rates."""
    mean = np.array(values)
    mean[1:] = (values[1:] + values[:-1]) / 2
    return mean


def on_grid(signal: AnySignal, t_s: Array) -> Array:
    """A measured signal at the grid, with an anti-alias filter where it is much faster."""
    if signal.rate_hz > 1.5 * GRID_HZ:
        return filtered_at(signal, 0.4 * GRID_HZ, t_s)
    return signal.at(t_s)


class GridSpline:
    """Values on a grid as cubic splines, unknown ones bridged, to be had later or earlier.

    Straight lines between grid points would take a tenth of what moves at a tenth of the grid's
    rate, where they are shifted by half a step, and feign that an age between two samples fits
    noise better than any other.
    """

    def __init__(self, values: Array, rate_hz: float = GRID_HZ) -> None:
        """Take values.

        Args:
            values: (N, channels); what is not a number is unknown.
            rate_hz: Of the grid.
        """
        self._bridged, self._known = _bridged(values)
        self._rate_hz = rate_hz
        self._moved: dict[float, Array] = {}

    @cached_property
    def _weights(self) -> Array:
        padded = np.pad(self._bridged, [(PADDED, PADDED), (0, 0)], mode="edge")
        return np.asarray(scipy.ndimage.spline_filter1d(padded, order=3, axis=0, mode="nearest"))

    def later(self, later_s: float) -> Array:
        """The values later by a while, (N, channels), the ends held; a channel of which nothing is
        known stays unknown. The last two are kept, and not to be written to: a fit asks for
        derivatives by one age after the other.

        Args:
            later_s: How much later, s; negative for earlier.
        """
        if later_s not in self._moved:
            self._moved = {**dict([*self._moved.items()][-1:]), later_s: self._at(later_s)}
        return self._moved[later_s]

    def _at(self, later_s: float) -> Array:
        steps = -later_s * self._rate_hz
        whole = math.floor(steps)
        rows = np.arange(len(self._bridged)) + whole
        if steps == whole:
            moved = self._bridged.take(rows, axis=0, mode="clip")
        else:
            moved = np.zeros_like(self._bridged)
            for k, share in enumerate(_cubic(steps - whole), PADDED - 1):
                moved += share * self._weights.take(rows + k, axis=0, mode="clip")
        moved[:, ~self._known] = np.nan
        return moved


def shifted(values: Array, later_s: float, rate_hz: float = GRID_HZ) -> Array:
    """Values on a grid later by a while, for a single use; as of `GridSpline`."""
    return GridSpline(values, rate_hz).later(later_s)


def _bridged(values: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Columns with straight lines over what is unknown, and which of them are known anywhere."""
    finite = np.isfinite(values)
    known = np.asarray(finite.any(axis=0))
    bridged = np.where(known, values, 0.0)
    grid = np.arange(len(values))
    for i in np.flatnonzero(known & ~finite.all(axis=0)):
        inside = finite[:, i]
        bridged[:, i] = np.interp(grid, grid[inside], values[inside, i])
    return bridged, known


def _cubic(t: float) -> tuple[float, float, float, float]:
    """Weights of the four cubic B-splines around a point between two knots, at a share of the way
    from one to the next."""
    return (
        (1 - t) ** 3 / 6,
        (4 - 6 * t**2 + 3 * t**3) / 6,
        (1 + 3 * t + 3 * t**2 - 3 * t**3) / 6,
        t**3 / 6,
    )


def _pieces(known: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Grid points of every uninterrupted piece that is long enough, without its ends: what is
    differentiated on the grid is not known there."""
    return [
        np.arange(first + 2, end - 2)
        for first, end in stretches_where(known)
        if end - first >= SHORTEST_S * GRID_HZ
    ]


OF_IMU = tuple(s for s in SENSORS if s.group == BODY)
"""Sensors of the IMU; each reads along x, y and z."""
OF_POSE = tuple(s for s in SENSORS if s.group != BODY)
"""Sensors that are predicted from the measured pose."""


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


def pose_signals(aligned: AlignedFlight) -> dict[str, dict[str, Array]]:
    """Measured motion by signal, "pos", "vel", "q" as far as there is any, as inputs of sensors on
    the grid of the flight."""
    t, motion = aligned.inputs.t_s, aligned.motion
    found = {}
    if motion.position is not None:
        found["pos"] = named("pos", motion.position.at(t))
    if motion.velocity is not None:
        found["vel"] = named("vel", motion.velocity.at(t))
    if motion.attitude is not None:
        found["q"] = named("q", motion.attitude.at(t), "wxyz")
    return found


def rows_along_pose(
    sensor: Component, flight: AnyFlight, pose: Mapping[str, Mapping[str, Array]], t_s: Array
) -> Array:
    """Inputs of a sensor of `OF_POSE` on a grid, shape (n, n_u).

    Args:
        sensor: Its component.
        flight: Whose columns, held, are what else it takes.
        pose: As from `pose_signals`.
        t_s: The grid, shape (n,).
    """
    inputs = {k: v for signal in pose.values() for k, v in signal.items()}
    for name in sensor.input_names:
        if name not in inputs and flight.has(name):
            inputs[name] = signal_of(flight, [name]).held(t_s)[:, 0]
    return rows_of(sensor, inputs, len(t_s))


def readings_on_grid(sensor: Sensor, flight: AnyFlight, t_s: Array) -> Array:
    """What is compared of a sensor, nothing filtered out, shape (n, 3), NaN where unknown.

    Args:
        sensor: Of the IMU.
        flight: Has its columns.
        t_s: Grid of `GRID_HZ`.
    """
    values = on_grid(signal_of(flight, sensor.columns), t_s)
    return rate_over_step(values) if sensor.rate else values


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


def imu_predictor(body: Component, vehicle: Vehicle) -> OverRows:
    """acc_x..z and gyro_rate_x..z of the twin by states and inputs of an airframe, shape (n, 6).

    Neither low-passed nor late; NaN where the state is unknown.

    Args:
        body: Of the twin.
        vehicle: The twin.
    """
    sensor = prompt_imu(vehicle)
    x, u = ca.SX.sym("x", len(body.states)), ca.SX.sym("u", len(body.inputs))
    y = body.outputs(x, u, body.parameter_values({"ground.enabled": 0.0}))
    outputs = {name: y[i] for i, name in enumerate(body.output_names)}
    true_motion = ca.vertcat(*[outputs[n] for n in sensor.input_names])
    sensed, p = ca.SX.sym("sensed", len(sensor.inputs)), sensor.parameter_values()
    shown = sensor.outputs(sensor.initial(sensed, p), sensed, p)
    both = ca.vertcat(shown[:3], gyro_rate(sensor, sensed, shown))
    readings = ca.cse(ca.densify(ca.substitute(both, sensed, true_motion)))
    return OverRows(ca.Function("imu", [x, u], [readings]), 2)


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
        aligned: The flight on a grid of `GRID_HZ`; if it has no other holder, it is freed before
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
        if sensor.rate:
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
