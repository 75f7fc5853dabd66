"""Residual channels of a flight: measured and predicted, with equal filters.

Readings in the air are resampled to a grid of `GRID_HZ`; measured and predicted ones pass the same
causal low-pass and are decimated to `CHANNEL_HZ`. The filter is causal, so that no reading is
explained by later ones: with a controller in the loop, a non-causal filter would identify the
inverse of the controller. As a linear model a channel is residual = slopes @ change of numbers +
noise.

| channel of the IMU | measured | predicted by |
|---|---|---|
| acc_* | accelerometer | airframe and IMU at the measured state |
| gyro_rate_* | rate of change of the gyroscope | airframe and IMU at the measured state |

The rotor states, which no sensor measures, are integrated from the commands. The body rates of the
state are those of the gyroscope itself, so the rate of change of the gyroscope is compared.
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
from ..representation import ShortRepr
from ..vehicle import Vehicle
from .aligned import AlignedFlight
from .gap import Channel
from .measured import AnySignal, filtered_at, signal_of, smooth_at

Array = NDArray[np.float64]
GRID_HZ = 200.0
"""Rate of the grid on which components are evaluated."""
CHANNEL_HZ = 50.0
"""Rate of the channels."""
PADDED = 14
"""Grid points of extrapolation at the ends before a shift: the effect of the ends on a cubic spline
has decayed there."""
BAND_HZ = 18.0
"""Low-pass of measured and predicted readings: above the motion of the body, below rotor
vibration."""
POSE_BAND_HZ = 6.0
"""Low-pass of signals that are derived from position and attitude by differences."""
SHORTEST_S = 1.5
"""Shortest piece of flight in use."""


@dataclass(frozen=True, slots=True)
class ChannelData(ShortRepr):
    """One channel of one flight.

    Attributes:
        name: Name of the channel.
        unit: Unit of the residual.
        t_s: Times, shape (n,).
        measured: Measured values, shape (n,).
        residual: Measured minus predicted, shape (n,).
        slopes: Derivative of the prediction by each number, shape (n, k).
        piece: Number of the uninterrupted piece of flight of each sample, shape (n,).
        nyquist_hz: Half the sample rate of its sensor, or of the slowest log of the pose behind
            it, Hz; above it are images of samples.
    """

    name: str
    unit: str
    t_s: Array
    measured: Array
    residual: Array
    slopes: Array
    piece: NDArray[np.intp]
    nyquist_hz: float = math.inf


@dataclass(frozen=True, slots=True)
class Measured(ShortRepr):
    """Readings of one sensor on the grid of a flight, filtered and decimated.

    Attributes:
        names: Names of its channels.
        unit: Unit of its channels.
        sensor_hz: Low-pass of the sensor, which a prediction has not passed; None: there is none.
        early_s: Delay of that low-pass for which the readings are corrected.
        bands_hz: Low-passes of readings and prediction, in order.
        rows: Grid points of each uninterrupted piece.
        settle: Grid points at the start of a piece in which the filters settle.
        values: Readings at the retained rows of all pieces, shape (n, c).
        t_s: Times of these rows, shape (n,).
        piece: Number of the piece of each row, shape (n,).
        nyquist_hz: As of `ChannelData`.
    """

    names: tuple[str, ...]
    unit: str
    sensor_hz: float | None
    early_s: float
    bands_hz: tuple[float, ...]
    rows: tuple[NDArray[np.intp], ...]
    settle: int
    values: Array
    t_s: Array
    piece: NDArray[np.intp]
    nyquist_hz: float

    def filtered(self, values: Array) -> Array:
        """Retained rows of readings on the grid, low-passed piece by piece."""
        return self._over_pieces(values, EVERY, bands_hz=self.bands_hz)

    def predicted(self, values: Array) -> Array:
        """Retained rows of a prediction, which passes the sensor, too."""
        return self._over_pieces(values, EVERY, self.sensor_hz, self.bands_hz)

    def unfiltered(self, values: Array) -> Array:
        """All rows of values on the grid after the filters have settled, not decimated."""
        return self._over_pieces(values, 1)

    def sensed(self, predicted: Array) -> Array:
        """Rows of a prediction after the low-pass of the sensor only."""
        return self._over_pieces(predicted, 1, self.sensor_hz)

    def _over_pieces(
        self,
        values: Array,
        every: int,
        sensor_hz: float | None = None,
        bands_hz: tuple[float, ...] = (),
    ) -> Array:
        retained = []
        for rows in self.rows:
            part = sensed(values[rows[0] : rows[-1] + 1], sensor_hz, self.early_s)
            for cutoff in bands_hz:
                part = low_pass(part, cutoff)
            retained.append(part[self.settle :: every])
        return np.concatenate(retained)

    def channels(self, predicted: Array, slopes: Array) -> list[ChannelData]:
        """Channels against a prediction on the grid.

        Args:
            predicted: Prediction, shape (n_grid, c).
            slopes: Slopes of the prediction, shape (n_grid, c, k).
        """
        found = []
        for i, name in enumerate(self.names):  # one by one to save memory
            some = np.flatnonzero(np.any(slopes[:, i] != 0, axis=0))
            both = np.vstack([predicted[:, i], slopes[:, i, some].T]).T  # filters run along columns
            both = self.predicted(both)
            own, answer = self.values[:, i], np.zeros((len(both), slopes.shape[2]))
            residual, answer[:, some] = own - both[:, 0], both[:, 1:]
            about = self.t_s, own, residual, answer, self.piece, self.nyquist_hz
            found.append(ChannelData(name, self.unit, *about))
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
    nyquist_hz: float,
    together: bool = False,
    passes: int = 1,
    early_s: float = 0.0,
) -> Measured | None:
    """Filter readings on the grid; None where no piece of them is long enough.

    Args:
        names: Names of the channels.
        unit: Unit of the readings.
        t_s: Times of the grid, shape (n,).
        values: Readings, shape (n, c), NaN where unknown.
        known: Whether a grid point is used, shape (n,).
        band_hz: Low-pass of readings and prediction.
        sensor_hz: Low-pass that was applied to the readings before logging, but not to a
            prediction.
        nyquist_hz: As of `ChannelData`.
        together: Whether the retained rows are a subset of those of every other sensor with these
            filters, wherever both are known.
        passes: Number of passes of that low-pass over readings and prediction.
        early_s: As of `Measured`.
    """
    pieces = _pieces(known & np.all(np.isfinite(values), axis=1))
    if not pieces:
        return None
    settle = round(2 / band_hz * GRID_HZ)
    if together:
        pieces = [rows[-(rows[0] + settle) % EVERY :] for rows in pieces]
    pieces = [rows for rows in pieces if len(rows) > settle]
    if not pieces:
        return None
    group = Measured(
        names=tuple(names),
        unit=unit,
        sensor_hz=sensor_hz,
        early_s=early_s,
        bands_hz=(band_hz,) * passes,
        rows=tuple(pieces),
        settle=settle,
        values=values,
        t_s=t_s,
        piece=np.zeros(0, dtype=np.intp),
        nyquist_hz=nyquist_hz,
    )
    retained = [rows[settle::EVERY] for rows in pieces]
    number = [np.full(len(rows), k, dtype=np.intp) for k, rows in enumerate(retained)]
    return replace(
        group,
        values=group.filtered(values),
        t_s=t_s[np.concatenate(retained)],
        piece=np.concatenate(number),
    )


def low_pass(values: Array, cutoff_hz: float) -> Array:
    """Causal second-order Butterworth low-pass along axis 0, initialised on the first value."""
    if cutoff_hz >= 0.45 * GRID_HZ:
        return values
    return _passed(values, cutoff_hz, prewarped=True)


def sensed(values: Array, cutoff_hz: float | None, early_s: float = 0.0) -> Array:
    """What a sensor with a second-order Butterworth low-pass reads of a signal with these values,
    initialised on the first value.

    The filter of the sensor is analog, or runs at a rate far above that of the grid. The bilinear
    transform of it, whose cutoff is not prewarped, is as late for slow signals, to second order in
    frequency; a prewarped one of 60 Hz is 1.2 ms early, as if the clock of the sensor were off.

    Args:
        values: Values on the grid, shape (n, ...).
        cutoff_hz: Cutoff; None: there is no low-pass.
        early_s: Delay of the low-pass for which the time stamps of the readings are corrected; the
            last readings are held.
    """
    if cutoff_hz is None:
        return values
    passed = _passed(values, cutoff_hz, prewarped=False)
    return shifted(passed, -early_s) if early_s else passed


def sensor_lag(cutoff_hz: float | None) -> float:
    """Time by which `sensed` is late for slow signals, s: group delay at 0 Hz."""
    return 0.0 if cutoff_hz is None else math.sqrt(2) / (2 * math.pi * cutoff_hz)


def _passed(values: Array, cutoff_hz: float, prewarped: bool) -> Array:
    b, a, settled = _butterworth(cutoff_hz, prewarped)
    passed, _ = scipy.signal.lfilter(b, a, values.T, axis=-1, zi=values[:1].T * settled)
    return np.asarray(passed.T, dtype=np.float64)


@cache
def _butterworth(cutoff_hz: float, prewarped: bool) -> tuple[Array, Array, Array]:
    """Second-order filter on the grid: coefficients, and the steady state for an input of one."""
    if prewarped:
        b, a = scipy.signal.butter(2, cutoff_hz / (GRID_HZ / 2))
    else:
        analog = scipy.signal.butter(2, 2 * np.pi * cutoff_hz, analog=True)
        b, a = scipy.signal.bilinear(*analog, fs=GRID_HZ)
    return b, a, scipy.signal.lfilter_zi(b, a)


def rate_over_step(values: Array) -> Array:
    """Rate of change over the grid step that ends at each row, shape as the values."""
    return np.diff(values, axis=0, prepend=values[:1]) * GRID_HZ


def mean_over_step(values: Array) -> Array:
    """Mean over the grid step that ends at each row: the prediction of `rate_over_step` for a
    signal with these rates."""
    mean = np.array(values)
    mean[1:] = (values[1:] + values[:-1]) / 2
    return mean


def on_grid(signal: AnySignal, t_s: Array) -> Array:
    """A measured signal on the grid by cubic splines, or an anti-alias filter where it is much
    faster.

    Lines between slow samples would attenuate a signal as a smaller scale of its sensor does.
    """
    if signal.rate_hz > 1.5 * GRID_HZ:
        return filtered_at(signal, 0.4 * GRID_HZ, t_s)
    return smooth_at(signal, t_s)


class GridSpline:
    """Values on a grid as cubic splines, with unknown ones bridged, for shifts in time.

    Linear interpolation would attenuate signals at a tenth of the grid's rate by a tenth for a
    shift of half a step, and imitate that a delay between two samples fits noise better than any
    other.
    """

    def __init__(self, values: Array, rate_hz: float = GRID_HZ) -> None:
        """Set up for values on a grid.

        Args:
            values: Values, shape (N, channels); NaN where unknown.
            rate_hz: Rate of the grid.
        """
        self._bridged, self._known = _bridged(values)
        self._rate_hz = rate_hz
        self._moved: dict[float, Array] = {}

    @cached_property
    def _weights(self) -> Array:
        padded = np.pad(self._bridged, [(PADDED, PADDED), (0, 0)], mode="edge")
        return np.asarray(scipy.ndimage.spline_filter1d(padded, order=3, axis=0, mode="nearest"))

    def later(self, later_s: float) -> Array:
        """The values delayed, shape (N, channels), with constant ends; a channel without known
        values stays unknown. The last two results are cached and must not be modified: a fit needs
        derivatives by one delay after the other.

        Args:
            later_s: Delay, s; negative for earlier.
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
    """Values on a grid delayed, for a single use; as in `GridSpline`."""
    return GridSpline(values, rate_hz).later(later_s)


def averaged(values: Array, variance_s2: float, rate_hz: float = GRID_HZ) -> Array:
    """Values on a grid, averaged over time with the weights of a normal distribution; unknown ones
    bridged, as in `GridSpline`."""
    found, known = _bridged(values)
    if variance_s2 > 0:
        width = math.sqrt(variance_s2) * rate_hz
        found = scipy.ndimage.gaussian_filter1d(found, width, axis=0, mode="nearest")
    found[:, ~known] = np.nan
    return found


def _bridged(values: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Columns with straight lines over unknown values, and a mask of the columns with known
    ones."""
    finite = np.isfinite(values)
    known = np.asarray(finite.any(axis=0))
    bridged = np.where(known, values, 0.0)
    grid = np.arange(len(values))
    for i in np.flatnonzero(known & ~finite.all(axis=0)):
        inside = finite[:, i]
        bridged[:, i] = np.interp(grid, grid[inside], values[inside, i])
    return bridged, known


def _cubic(t: float) -> tuple[float, float, float, float]:
    """Weights of the four cubic B-splines around a point between two knots, by its fraction of the
    interval."""
    return (
        (1 - t) ** 3 / 6,
        (4 - 6 * t**2 + 3 * t**3) / 6,
        (1 + 3 * t + 3 * t**2 - 3 * t**3) / 6,
        t**3 / 6,
    )


def _pieces(known: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Grid points of every uninterrupted piece that is long enough, without its ends, where
    differences on the grid are unknown."""
    return [
        np.arange(first + 2, end - 2)
        for first, end in stretches_where(known)
        if end - first >= SHORTEST_S * GRID_HZ
    ]


OF_IMU = tuple(s for s in SENSORS if s.group == BODY)
"""Sensors of the IMU; each has axes x, y and z."""
OF_POSE = tuple(s for s in SENSORS if s.group != BODY)
"""Sensors that are predicted from the measured pose."""


def named(stem: str, values: Array, axes: str = "xyz") -> dict[str, Array]:
    """Components of a signal by name, `stem_x` and so on."""
    return {f"{stem}_{a}": values[:, i] for i, a in enumerate(axes)}


def rows_of(sensor: Component, inputs: Mapping[str, Array], n: int) -> Array:
    """Inputs of a sensor in its order; missing ones are at their start values."""
    rows = np.tile(sensor.input_values(), (n, 1))
    for i, name in enumerate(sensor.input_names):
        if name in inputs:
            rows[:, i] = inputs[name]
    return rows


def pose_signals(aligned: AlignedFlight) -> dict[str, dict[str, Array]]:
    """Measured motion by signal, "pos", "vel", "q" as far as available, as inputs of sensors on the
    grid of the flight."""
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
        sensor: Component of the sensor.
        flight: Flight whose columns, held between samples, are its other inputs.
        pose: Signals from `pose_signals`.
        t_s: Times of the grid, shape (n,).
    """
    inputs = {k: v for signal in pose.values() for k, v in signal.items()}
    for name in sensor.input_names:
        if name not in inputs and flight.has(name):
            inputs[name] = signal_of(flight, [name]).held(t_s)[:, 0]
    return rows_of(sensor, inputs, len(t_s))


def readings_on_grid(sensor: Sensor, flight: AnyFlight, t_s: Array) -> Array:
    """Compared quantity of a sensor, unfiltered, shape (n, 3), NaN where unknown.

    Args:
        sensor: Sensor of the IMU.
        flight: Flight with its columns.
        t_s: Grid of rate `GRID_HZ`.
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
    """Readings of a sensor of the IMU in the air, filtered and decimated.

    Args:
        sensor: Sensor of the IMU.
        flight: Flight with its columns.
        vehicle: Vehicle; the low-pass of its sensor is applied to a prediction.
        aligned: Flight on a grid of `GRID_HZ`.
        together: Whether both sensors of the IMU retain the same rows, wherever both are known.
        axes: Axes of x, y and z in use.
        left_out: Grid points that are not used, shape (n,).

    Returns:
        None where no piece of flight is long enough.
    """
    t_s = aligned.inputs.t_s
    raw = readings_on_grid(sensor, flight, t_s)
    known = _known(aligned) if left_out is None else _known(aligned) & ~left_out
    return _readings(sensor, flight, vehicle, t_s, raw, known, together, axes)


def _known(aligned: AlignedFlight) -> NDArray[np.bool_]:
    """Mask of the grid points in the air at which all states are known, shape (n,)."""
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
    """Filtered readings, as described in `imu_readings`."""
    rate_hz = signal_of(flight, sensor.columns).rate_hz
    return measured(
        sensor.channels[axes],
        sensor.channel_unit,
        t_s,
        raw[:, axes],
        known,
        min(BAND_HZ, 0.35 * rate_hz),
        sensor.cutoff_hz(vehicle),
        rate_hz / 2,
        together,
        early_s=flight.filter_delays_s.get(sensor.signal, 0.0),
    )


def prompt_imu(vehicle: Vehicle, effects: Iterable[str] = ()) -> Component:
    """The IMU without its low-pass, and with those of its effects that change a mean.

    Low-pass and delay are applied in time to a prediction and to its slopes.

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
        sensor: Component of the IMU.
        sensed: Inputs of the IMU; the derivative of the body rate is the angular acceleration.
        shown: Readings of the IMU as an expression of the inputs.
    """
    change = ca.SX.zeros(sensed.shape)
    for a in "xyz":
        alpha = sensed[sensor.input_names.index(f"angular_acceleration_{a}")]
        change[sensor.input_names.index(f"omega_{a}")] = alpha
    return ca.jtimes(shown[3:], sensed, change)


def imu_predictor(body: Component, vehicle: Vehicle) -> OverRows:
    """Function for acc_x..z and gyro_rate_x..z of the twin by states and inputs of an airframe,
    shape (n, 6).

    Without low-pass or delay; NaN where the state is unknown.

    Args:
        body: Airframe of the twin.
        vehicle: Vehicle of the twin.
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
    """Measured states, shape (n, n_x), corrected by the delays of the pose in the vehicle."""
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
        flight: Flight as read.
        vehicle: Vehicle of the twin.
        aligned: Flight on a grid of `GRID_HZ`; if there is no other reference to it, it is freed
            before the readings are loaded.
        predictor: Result of `imu_predictor` for the airframe, where it is available.
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
        simulated = readings.predicted(predicted)
        phases = [
            phase_of_row[np.searchsorted(t_s, t - 0.5 / GRID_HZ)] for t in (whole[0], readings.t_s)
        ]
        for i, (name, unit) in enumerate((c, readings.unit) for c in readings.names):
            of_all = whole[0], whole[1][:, i], whole[2][:, i], phases[0]
            of_band = readings.t_s, readings.values[:, i], simulated[:, i], phases[1]
            wide = Channel(name, unit, 0.0, *of_all)
            channels.append(Channel(name, unit, 0.0, *of_band, unfiltered=wide))
    return channels
