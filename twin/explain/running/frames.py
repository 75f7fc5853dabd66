"""Residuals and their slopes by frames of half a second.

The channels of `twin.explain.model.flight`: readings of accelerometer and gyroscope against
airframe and IMU, and against the pose; magnetometer and barometer against the pose. Slopes are
derivatives of the CasADi expressions at the measured state; of the rotor states, which no sensor
measures, are integrated along the flight. All is computed frame by frame on the grid of a stream,
so that the portions in which a flight arrives do not matter. Readings that repeat and power above
the band of motion have no equation: they are counted here.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from ...component import Component
from ...component.along import Along, EachRow
from ...effects.sensors import IMU_CHANNELS
from ...logs.columns import ACC, GYRO
from ...representation import short_repr
from ...residuals.channels import (
    BAND_HZ,
    EVERY,
    GRID_HZ,
    OF_IMU,
    OF_POSE,
    POSE_BAND_HZ,
    LowPass,
    named,
    on_grid,
    prompt_imu,
    rows_of,
)
from ...residuals.measured import rates_of, signal_of
from ...residuals.stream import Stream
from ...residuals.teacher_forced import rotor_states_of
from ...vehicle import Vehicle
from ..model.factors import in_body
from ..model.numbers import values_of
from ..model.prediction import Physics, SensorBatch
from .hypotheses import Library

Array = NDArray[np.float64]
SUB_BANDS_HZ = (25.0, 45.0, 65.0, 85.0, 100.0)
"""Edges: above the band of motion, below the limit of the grid."""


def high_power(readings: Array) -> Array:
    """Power of readings by sub-band, in their unit squared, shape (k, s).

    Args:
        readings: A frame on the grid, shape (n, k).
    """
    n = len(readings)
    window = np.hanning(n)[:, None]
    slope = np.linspace(-1, 1, n)[:, None]
    still = readings - readings.mean(axis=0)
    still = still - slope * (slope * still).sum(axis=0) / (slope * slope).sum()
    power = np.abs(np.fft.rfft(window * still, axis=0)) ** 2
    power *= 2 / (GRID_HZ * (window**2).sum()) * (GRID_HZ / n)
    hz = np.fft.rfftfreq(n, 1 / GRID_HZ)
    edges = np.searchsorted(hz, SUB_BANDS_HZ)
    return np.stack([power[a:b].sum(axis=0) for a, b in pairwise(edges)], axis=1)


def longest_repeats(samples: Mapping[str, tuple[Array, Array]]) -> dict[str, int]:
    """Most samples in a row that are all the same, by column of the IMU."""
    found = {}
    for name, (_, values) in samples.items():
        columns = [c for c in IMU_CHANNELS if c.startswith(name)]
        for column, x in zip(columns, values.T, strict=True):
            if len(x):
                edges = np.flatnonzero(np.concatenate([[True], np.diff(x) != 0, [True]]))
                found[column] = int(np.max(np.diff(edges)))
    return found


class LagSlopes:
    """Derivative of the states of the rotors by numbers that move them.

    With the step r' = F(r, u, theta) of the rotors, z' = F_r z + F_theta, exact derivatives of the
    step that the twin itself takes.

    Attributes:
        columns: Positions of these numbers within `Library.columns`.
    """

    def __init__(self, body: Component, library: Library, physics: Physics) -> None:
        """Differentiate the step.

        Args:
            body: Airframe, built with the effects of the library.
            library: Numbers.
            physics: Of that airframe.
        """
        self._index = rotor_states_of(body)
        reached = {
            k: library.name(k)
            for k in range(len(library.columns))
            if physics.reached.get(library.name(k).full, frozenset()) & {*self._index}
        }
        self.columns = tuple(reached)
        self._width, n = len(body.states), len(self._index)
        names = [v.name for v in body.parameters]
        effects = {number.effect for number in reached.values()}
        p = ca.SX(body.parameter_values({f"{e}.enabled": 1.0 for e in effects}))
        theta = ca.SX.sym("theta", len(reached))
        for k, number in enumerate(reached.values()):
            p[names.index(number.full)] = theta[k]
        self._now = np.array([number.now for number in reached.values()])
        z = ca.SX.sym("z", n * len(reached))
        v, u = ca.SX.sym("v", n), ca.SX.sym("u", len(body.inputs))
        x = ca.SX(body.initial(body.input_values(), body.parameter_values()))
        x[self._index] = v
        after = body.step(x, u, p, 1 / GRID_HZ)[self._index]
        moved = ca.jacobian(after, v) @ ca.reshape(z, n, len(reached)) + ca.jacobian(after, theta)
        moved = ca.substitute(ca.vec(moved), theta, self._now)
        self._along = Along(ca.Function("carried", [z, v, u], [ca.cse(ca.densify(moved))]))
        self._state = np.zeros(n * len(reached))

    def along(self, states: Array, inputs: Array) -> list[tuple[int, Array]]:
        """The next rows: of each column, the change of all states, shape (n, n_x).

        Args:
            states: Of the airframe, shape (n, n_x).
            inputs: Of the airframe, shape (n, n_u).
        """
        if not self.columns:
            return []
        rotors = states[:, self._index]
        (after,) = self._along(self._state, np.nan_to_num(rotors), inputs)
        here = np.vstack([self._state, after[:-1]])
        self._state = after[-1]
        found = []
        for k, column in enumerate(self.columns):
            change = np.zeros((len(states), self._width))
            n = len(self._index)
            change[:, self._index] = here[:, k * n : (k + 1) * n]
            found.append((column, change))
        return found


FRAME_ROWS = 100
"""Rows of the grid in a frame."""
FRAME_S = FRAME_ROWS / GRID_HZ
"""Length of a frame, s."""
FRAME_SAMPLES = FRAME_ROWS // EVERY
"""Samples of a channel in a frame."""


@dataclass(frozen=True, slots=True)
class GridBlock:
    """Rows of the grid, one after the other, with what is read there.

    Attributes:
        first: Number of the first of them; the grid begins at the time zero.
        t_s: Times, shape (n,).
        states: Of the airframe, shape (n, n_x); NaN where nothing was measured.
        inputs: Of the airframe, shape (n, n_u).
        flying: In the air, the state known, shape (n,).
        readings: By signal ("acc", "gyro", "pull" NED, "turning", "mag", "baro"), shape (n, k),
            NaN where unknown.
        samples: Readings of the IMU as they came: times, shape (m,), and values, shape (m, k).
        further: Columns of the flight that a sensor of the pose asks for, shape (n,) each.
    """

    first: int
    t_s: Array
    states: Array
    inputs: Array
    flying: NDArray[np.bool_]
    readings: Mapping[str, Array]
    samples: Mapping[str, tuple[Array, Array]]
    further: Mapping[str, Array]

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Group:
    """Channels of one sensor that are compared in one way.

    Attributes:
        names: As in `twin.explain.model.model`.
        sensor: Whose readings: "acc", "gyro", "mag", "baro".
        filters_hz: Low-passes that a prediction passes, the last of them readings as well.
        rate: Whether the rate of change is compared.
        columns: Numbers that reach any of them, positions within `Library.columns`.
    """

    names: tuple[str, ...]
    sensor: str
    filters_hz: tuple[float, ...]
    rate: bool
    columns: NDArray[np.intp]

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Frame:
    """Half a second.

    Attributes:
        number: From the start of the clock.
        flying: Whether all of it is in the air.
        rows: By number of the group and channel within it, where known and settled, the cosine
            transform (orthonormal, the mean first) of measured, residual and slopes, (25, 2 + k).
        loud: Power above the band of motion by reading of the IMU and sub-band, shape (6, s); empty
            where the IMU is not known.
        repeats: By column of the IMU, most samples in a row that are all the same.
        samples: By signal of the IMU, how many came.
    """

    number: int
    flying: bool
    rows: Mapping[tuple[int, int], Array]
    loud: Array
    repeats: Mapping[str, int]
    samples: Mapping[str, int]

    __repr__ = short_repr

    @property
    def t_s(self) -> float:
        """When it begins."""
        return self.number * FRAME_S

    @property
    def end_s(self) -> float:
        """When it ends."""
        return (self.number + 1) * FRAME_S


class FrameFilter:
    """From rows of the grid to frames.

    Attributes:
        groups: All that may be compared.
    """

    def __init__(self, vehicle: Vehicle, library: Library, body: Component) -> None:
        """Take the equations.

        Args:
            vehicle: The calibrated model.
            library: Numbers and hypotheses.
            body: Airframe, built with the effects of the library.
        """
        self._vehicle, self._library = vehicle, library
        self._attitude = [[s.name for s in body.states].index(f"q_{a}") for a in "wxyz"]
        numbers, effects = library.numbers, library.effects
        self._theta, self._columns = values_of(numbers, {}), list(library.columns)
        self._physics = Physics(body, vehicle, effects, numbers, EachRow)
        self._lag = LagSlopes(body, library, self._physics)
        self._imu = prompt_imu(vehicle, effects)
        self._imu_batch = SensorBatch(self._imu, effects, numbers, EachRow)
        self._made = [kind.make(vehicle, effects) for kind in OF_POSE]
        self._batches = [SensorBatch(m, effects, numbers, EachRow) for m in self._made]
        self.groups = tuple(self._list_groups())
        self._passed: dict[int, list[LowPass]] = {}  # by group, its filters
        self._last: dict[int, Array] = {}  # by group, the last row before this frame
        self._next: int | None = None  # number of the next frame

    def frames(self, stream: Stream) -> list[Frame]:
        """The frames that are complete since the last time.

        Args:
            stream: Rows of a flight on the grid, the airframe built with the effects.
        """
        rows = None if stream.grid is None else stream.grid.rows
        if rows is None:
            return []
        first, end = -(-rows.first // FRAME_ROWS), rows.end // FRAME_ROWS
        if self._next is not None and first <= self._next:
            first = self._next
        else:  # the first frame, or the one after frames that were not taken
            self._passed, self._last = {}, {}
        if end <= first:
            return []
        block = self._block(stream, first * FRAME_ROWS, end * FRAME_ROWS)
        self._next = end
        return [
            self._frame(number, _cut(block, (number - first) * FRAME_ROWS))
            for number in range(first, end)
        ]

    def _block(self, stream: Stream, first: int, end: int) -> GridBlock:
        """Rows of the grid, and what sensors read there."""
        assert stream.grid is not None and stream.grid.rows is not None
        flight, motion, rows = stream.window, stream.motion, stream.grid.rows.between(first, end)
        flying = stream.grid.known_in_air(first, end)
        assert flight is not None
        t, read = rows.t_s, dict[str, Array]()
        for name, columns in (("acc", ACC), ("gyro", GYRO)):
            if flight.has(*columns):
                read[name] = on_grid(signal_of(flight, columns), t)
        if motion.attitude is not None and len(motion.attitude.t_s) > 2:
            read["turning"] = rates_of(motion.attitude).at(t)
        if motion.velocity is not None:
            velocity = motion.velocity.at(np.arange(first - 1, end + 1) / GRID_HZ)
            pull = (velocity[2:] - velocity[:-2]) * (GRID_HZ / 2)
            read["pull"] = pull - [0.0, 0.0, self._vehicle.gravity_m_s2]
        for sensor in OF_POSE:
            if flight.has(*sensor.columns):
                read[sensor.signal] = signal_of(flight, sensor.columns).at(t)
        further = {
            c: signal_of(flight, [c]).held(t)[:, 0] for c in ("ibat_a", "vbat_v") if flight.has(c)
        }
        samples = {
            name: flight.signal(columns)
            for name, columns in (("acc", ACC), ("gyro", GYRO))
            if flight.has(*columns)
        }
        return GridBlock(first, t, rows.states, rows.u, flying, read, samples, further)

    # -- what there is -------------------------------------------------------------------------

    def _list_groups(self) -> list[Group]:
        body = self._physics.answering()[:, self._columns]
        body[:, list(self._lag.columns)] = True
        imu = self._imu_batch.answering()[:, self._columns]
        found = []
        for k, s in enumerate(OF_IMU):
            own = slice(3 * k, 3 * k + 3)
            cutoff = s.cutoff_hz(self._vehicle)
            through = () if cutoff is None else (cutoff,)
            columns = np.flatnonzero(body[own].any(axis=0))
            pose = np.flatnonzero(imu[own].any(axis=0))
            names = tuple(f"pose_{c}" for c in s.columns)
            rate = s.rate is not None
            found.append(Group(s.channels, s.signal, (*through, BAND_HZ), rate, columns))
            found.append(Group(names, s.signal, (*through, POSE_BAND_HZ), False, pose))
        for kind, batch in zip(OF_POSE, self._batches, strict=True):
            columns = np.flatnonzero(batch.answering()[:, self._columns].any(axis=0))
            found.append(Group(kind.channels, kind.signal, (POSE_BAND_HZ,), False, columns))
        return found

    # -- one frame -----------------------------------------------------------------------------

    def _frame(self, number: int, block: GridBlock) -> Frame:
        states, inputs = block.states, block.inputs
        predicted = self._physics.value(self._theta, states, inputs)
        along = self._lag.along(states, inputs)
        flying = bool(np.all(block.flying))
        rows: dict[tuple[int, int], Array] = {}
        if flying:
            slopes = self._physics.slopes(self._columns, self._theta, states, inputs)
            for column, change in along:
                slopes[:, :, column] += self._physics.tangent(self._theta, change, states, inputs)
            compared = self._compared(block, predicted, slopes)
            for g, group in enumerate(self.groups):
                rows |= self._transformed(g, group, compared.get(g))
        else:
            self._passed, self._last = {}, {}
        readings = [block.readings[s.signal] for s in OF_IMU if s.signal in block.readings]
        loud = np.zeros((0, 0))
        if flying and len(readings) == len(OF_IMU) and np.all(np.isfinite(np.hstack(readings))):
            loud = high_power(np.hstack(readings))
        counted = {name: len(t) for name, (t, _) in block.samples.items()}
        return Frame(number, flying, rows, loud, longest_repeats(block.samples), counted)

    def _compared(self, block: GridBlock, predicted: Array, slopes: Array) -> dict[int, Array]:
        """By group, measured, predicted and slopes, shape (n, c, 2 + k)."""
        read, found = block.readings, {}
        for k, s in enumerate(OF_IMU):
            if s.signal in read:
                own = slice(3 * k, 3 * k + 3)
                moved = slopes[:, own][:, :, self.groups[2 * k].columns]
                found[2 * k] = _stacked(read[s.signal], predicted[:, own], moved)
        found |= self._of_pose(block, predicted)
        pose = self._pose(block)
        for j, kind in enumerate(OF_POSE):
            if kind.signal not in read:
                continue
            rows = rows_of(self._made[j], pose | dict(block.further), len(block.t_s))
            group = self.groups[4 + j]
            wanted = [self._columns[c] for c in group.columns]
            first = self._made[j].output_names.index(kind.columns[0])
            outputs = slice(first, first + len(kind.columns))
            value = self._batches[j].value(self._theta, rows)[:, outputs]
            slope = self._batches[j].slopes(wanted, self._theta, rows)[:, outputs]
            found[4 + j] = _stacked(read[kind.signal], value, slope)
        return found

    def _of_pose(self, block: GridBlock, predicted: Array) -> dict[int, Array]:
        """What the IMU reads against what the pose implies; see `twin.explain.model.factors`."""
        read, n = block.readings, len(block.t_s)
        if not {"gyro", "turning"} <= read.keys():
            return {}
        implied, experienced = named("omega", read["turning"]), named("omega", read["gyro"])
        there = {"acc", "pull"} <= read.keys()
        if there:
            alpha = named("angular_acceleration", np.gradient(read["gyro"], 1 / GRID_HZ, axis=0))
            q = block.states[:, self._attitude]
            implied |= alpha | named("specific_force", in_body(q, read["pull"]))
            experienced |= alpha | named("specific_force", predicted[:, :3])
        value = self._imu_batch.value(self._theta, rows_of(self._imu, implied, n))
        at, found = rows_of(self._imu, experienced, n), {}
        for k, s in enumerate(OF_IMU):
            if s.signal == "acc" and not there:
                continue
            own, columns = slice(3 * k, 3 * k + 3), self.groups[2 * k + 1].columns
            wanted = [self._columns[c] for c in columns]
            slope = self._imu_batch.slopes(wanted, self._theta, at)[:, own]
            found[2 * k + 1] = _stacked(read[s.signal], value[:, own], slope)
        return found

    def _pose(self, block: GridBlock) -> dict[str, Array]:
        """Measured motion by the names of sensors' inputs."""
        names = [s.name for s in self._physics.airframe.states]
        wanted = ("pos_", "vel_", "q_")
        return {n: block.states[:, i] for i, n in enumerate(names) if n.startswith(wanted)}

    def _transformed(
        self, g: int, group: Group, values: Array | None
    ) -> dict[tuple[int, int], Array]:
        """Filtered, thinned out and transformed; nothing where unknown or not settled yet."""
        if values is None or not np.all(np.isfinite(values)):
            self._passed.pop(g, None)
            self._last.pop(g, None)
            return {}
        if group.rate:
            before = self._last.get(g, values[0])
            self._last[g] = values[-1]
            whole = np.concatenate([before[None], values])
            measured = np.diff(whole[:, :, :1], axis=0) * GRID_HZ
            values = np.concatenate([measured, (whole[1:, :, 1:] + whole[:-1, :, 1:]) / 2], axis=2)
        settled = g in self._passed
        *of_sensor, band = self._passed.setdefault(g, [LowPass(hz) for hz in group.filters_hz])
        for low_pass in of_sensor:  # readings have it behind them
            values = np.concatenate([values[:, :, :1], low_pass.next(values)[:, :, 1:]], axis=2)
        values = band.next(values)
        if not settled:
            return {}
        transformed = dct(values[EVERY - 1 :: EVERY], axis=0, norm="ortho")
        transformed[:, :, 1] = transformed[:, :, 0] - transformed[:, :, 1]
        return {(g, c): transformed[:, c] for c in range(len(group.names))}


def _stacked(measured: Array, predicted: Array, slopes: Array) -> Array:
    return np.concatenate([measured[:, :, None], predicted[:, :, None], slopes], axis=2)


def _cut(block: GridBlock, low: int) -> GridBlock:
    """One frame of a block."""
    own = slice(low, low + FRAME_ROWS)
    start_s, end_s = ((block.first + k) / GRID_HZ - 1e-9 for k in (own.start, own.stop))
    samples = {}
    for s, (t, values) in block.samples.items():
        a, b = np.searchsorted(t, [start_s, end_s])
        samples[s] = t[a:b], values[a:b]
    return GridBlock(
        block.first + low,
        block.t_s[own],
        block.states[own],
        block.inputs[own],
        block.flying[own],
        {k: v[own] for k, v in block.readings.items()},
        samples,
        {k: v[own] for k, v in block.further.items()},
    )
