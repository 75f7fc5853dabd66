"""A flight as residuals on a uniform grid: virtual readings of the twin, and measured minus
virtual.

The twin is driven by the flight's own commands, on the log's clock.

| channels | virtual reading |
|---|---|
| gyro, pos, vel | `restart_before_s` after the twin was set to the measured state |
| other learned sensors | at the measured state |

With a restart time of zero the twin follows the flight: residuals of its sensors then contain no
motion error. Position and velocity are set to the measured ones, and have no residual. An instant
then has the residual of the interval that begins with it, over which its correction is held, so
that the correction never sees its target.

The gyroscope is compared at its own samples; the gap, by contrast, filters it forward and backward,
which uses future samples. Virtual readings use the flight: its state some time before, and for acc
and mag the measured state itself, interpolated linearly to its next sample. Only actual samples are
compared.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from twin.errors import LogError, ModelError
from twin.logs import Flight
from twin.logs.columns import motor_number
from twin.logs.samples import stretches_where
from twin.logs.stored import opened
from twin.representation import ShortRepr
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.channels import OF_IMU, OF_POSE, pose_signals, rows_along_pose
from twin.residuals.measured import Signal
from twin.residuals.short_horizon import READ, window_ends
from twin.residuals.teacher_forced import GRID_S, predicted_readings, sensor_readings
from twin.vehicle import Vehicle

from ..preset import Protocol
from .channels import CHANNELS, GROUPS, check_channels, phase_codes

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
DEFAULT_RATE_HZ = 100.0
"""Default sample rate, Hz, that of fast position loops, and of most residuals here. Made up."""
DEFAULT_HORIZON_S = 0.5
"""Default restart time of `reconstruct`, s, that of the gap."""
SHORTEST_SPAN = 2
"""Least number of samples of a span."""
RESTARTED = ("gyro", "pos", "vel")
"""Groups that are read after a restart; the others are read at the measured state."""
_ENDS = {g: [READ.index(c) for c in CHANNELS[GROUPS[g]]] for g in RESTARTED}  # in `READ`
PUT = ("pos", "vel")
"""Groups that a twin that follows the flight is set to."""


@dataclass(frozen=True, slots=True)
class ResidualFlight(ShortRepr):
    """Residuals of one flight on a uniform grid.

    Attributes:
        name: Name of the flight.
        rate_hz: Sample rate of the grid, Hz.
        t_s: Times, s, shape (n,).
        virtual: Readings of the twin's sensors, units as `channels.UNITS`, shape (n, 15); NaN where
            the initial state was not measured.
        residual: Measured minus virtual at the time of each sample, held until the next; NaN before
            the first, shape (n, 15).
        fresh: Whether a sample lies in the interval that ends at the instant, or for a twin that
            follows, begins with it, shape (n, 15).
        commands: Drive of the rotors, held at the instant: commands 0..1 or measured speeds, rad/s;
            shape (n, m).
        phase: Code of the phase, `channels.PHASE_CODES`, shape (n,).
        spans: Rows [a, b) in the air without gaps, in order; outside them nothing is fresh.
        notes: Texts on missing data and assumptions.
        log_sha256: Hash of the log, `Flight.fingerprint`, "" where unknown.
        alone: Whether the twin ran open loop, shape (n,); None: nowhere.
    """

    name: str
    rate_hz: float
    t_s: Array
    virtual: Array
    residual: Array
    fresh: BoolArray
    commands: Array
    phase: IntArray
    spans: tuple[tuple[int, int], ...]
    notes: tuple[str, ...] = ()
    log_sha256: str = ""
    alone: BoolArray | None = None

    @property
    def alone_rows(self) -> BoolArray:
        """`alone` as an array."""
        return np.zeros(len(self.t_s), dtype=np.bool_) if self.alone is None else self.alone


def residual_flight(
    flight: Flight,
    vehicle: Vehicle,
    rate_hz: float = DEFAULT_RATE_HZ,
    restart_s: float = DEFAULT_HORIZON_S,
    progress: Callable[[float], None] | None = None,
    aligned: AlignedFlight | None = None,
) -> ResidualFlight:
    """Residuals of a flight against a vehicle's twin.

    Args:
        flight: Flight, as of `twin.logs.read_flight`.
        vehicle: Vehicle, as of `twin.vehicle_file.load_vehicle`, including its effects.
        rate_hz: Sample rate of the grid, 1000 Hz over an integer.
        restart_s: Time from restart to reading, s; a multiple of 1 ms, at least one interval, or 0:
            the twin follows.
        progress: Called with the share done, 0..1.
        aligned: The flight, or its used part, on the grid of the twin; None: it is resampled here.

    Raises:
        ModelError: Rate or restart time is not allowed.
        LogError: The flight cannot be compared with this vehicle, or has no sample to compare.
    """
    every, steps = _steps(rate_hz, restart_s)
    aligned = aligned or align_flight(flight, vehicle)
    t = aligned.inputs.t_s
    first = -round(float(t[0]) / GRID_S) % every
    grid = np.arange(first, len(t), every)
    valid = _whole(aligned, grid, steps)
    at_state = _at_measured_state(flight, vehicle, aligned)
    ends = None
    if steps:
        ends = _restarts(aligned, grid, valid, steps, every, progress or (lambda _: None))

    virtual = np.full((len(grid), len(CHANNELS)), np.nan)
    residual, fresh = virtual.copy(), np.zeros(virtual.shape, dtype=np.bool_)
    missing = []
    for group, columns in GROUPS.items():
        if ends is not None and group in RESTARTED:
            near = ends[:, :, _ENDS[group]]
        else:
            near = at_state[group][np.maximum(grid[:, None] + np.arange(-every, 1), 0)]
        near[~valid] = np.nan
        virtual[:, columns] = near[:, -1]
        if not flight.has(*CHANNELS[columns]):
            missing.append(group)
            continue
        if ends is None and group in PUT:
            continue
        samples = Signal(*flight.signal(CHANNELS[columns]))
        rows, values = _against(samples, near, t[grid], every)
        rows = rows if ends is not None else rows - 1  # it begins where the previous one ended
        residual[rows[rows >= 0], columns] = values[rows >= 0]
        fresh[rows[rows >= 0], columns] = True
    if not fresh.any():
        raise LogError(
            f"{flight.name}: no sample to compare in the air: it needs gyro_*, acc_*, mag_*, pos_* "
            f"or vel_* besides motor commands, and {restart_s:g} s of attitude, velocity and body "
            f"rates. The flight has: {', '.join(c for c in flight.table if flight.has(c))}."
        )
    drives = [i for i, n in enumerate(aligned.airframe.input_names) if motor_number(n) is not None]
    notes = [f"no samples of {g}_*: these channels have no residual" for g in missing]
    return ResidualFlight(
        name=flight.name,
        rate_hz=rate_hz,
        t_s=t[grid],
        virtual=virtual,
        residual=held(residual),
        fresh=fresh,
        commands=aligned.inputs.u[grid][:, drives],
        phase=phase_codes(aligned.phases[grid]),
        spans=_spans(valid),
        notes=(*aligned.notes, *notes),
        log_sha256=flight.fingerprint,
    )


def residuals_of(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    rate_hz: float,
    restart_s: float,
    progress: Callable[[float], None],
) -> tuple[ResidualFlight, ...]:
    """`residual_flight` of several flights."""
    found = []
    for i, flight in enumerate(flights):

        def share(done: float, i: int = i) -> None:
            progress((i + done) / len(flights))

        found.append(residual_flight(flight, vehicle, rate_hz, restart_s, share))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Pass(ShortRepr):
    """One pass of a twin along a flight, at every grid point.

    Attributes:
        shown: Readings `CHANNELS`, then the drive of the rotors as input of the compensator, or
            other outputs; shape (n_grid, 15 + m).
        flown: Where the motion is known and the twin is in use, shape (n_grid,).
        counts: Where readings are compared, shape (n_grid,).
        alone: Where the twin ran open loop, shape (n_grid,).
    """

    shown: Array
    flown: BoolArray
    counts: BoolArray
    alone: BoolArray


def residuals_in_use(
    flight: Flight, aligned: AlignedFlight, passes: Sequence[Pass], rate_hz: float
) -> ResidualFlight:
    """Residuals of a twin that was run along a flight in one or more passes.

    An instant has the residual of the interval that begins with it, over which its correction is
    held, so that the correction never sees its target. Position and velocity of a twin that follows
    are inputs, and have no residual.

    Args:
        flight: Flight with the sensor readings.
        aligned: Flight on the grid of the twin.
        passes: One or more passes, which are concatenated.
        rate_hz: Sample rate, 1000 Hz over an integer.

    Raises:
        ModelError: The rate is not allowed.
        LogError: There is no sample to compare.
    """
    every, _ = _steps(rate_hz, 0.0)
    t, n = aligned.inputs.t_s, len(CHANNELS)
    grid = np.arange(-round(float(t[0]) / GRID_S) % every, len(t) - every, every)
    residual = np.full((len(passes), len(grid), n), np.nan)
    fresh, spans = np.zeros(residual.shape, dtype=np.bool_), list[tuple[int, int]]()
    for k, one in enumerate(passes):
        for group, columns in GROUPS.items():
            if not flight.has(*CHANNELS[columns]):
                continue
            near = one.shown[:, columns][grid[:, None] + np.arange(every + 1)]
            samples = Signal(*flight.signal(CHANNELS[columns]))
            rows, values = _against(samples, near, t[grid + every], every)
            if group in PUT:
                lone = one.alone[grid[rows] + every]
                rows, values = rows[lone], values[lone]
            residual[k, rows, columns], fresh[k, rows, columns] = values, True
        whole, use = (v[grid] & v[grid + every] for v in (one.flown, one.counts))
        spans += [(a + len(grid) * k, b + len(grid) * k) for a, b in _spans(whole)]
        fresh[k] &= (whole & use)[:, None]
    if not fresh.any():
        raise LogError(
            f"{flight.name}: no sample to compare in the air: it needs readings of a sensor "
            f"besides motor commands, and a second of position, velocity, attitude and body rates "
            f"without a gap."
        )
    whole_s = float(t[grid[-1]] - t[grid[0]]) + 1 / rate_hz
    return ResidualFlight(
        name=flight.name,
        rate_hz=rate_hz,
        t_s=np.concatenate([t[grid] + k * whole_s for k in range(len(passes))]),
        virtual=np.vstack([one.shown[grid, :n] for one in passes]),
        residual=held(residual.reshape(-1, n)),
        fresh=fresh.reshape(-1, n),
        commands=np.vstack([one.shown[grid, n:] for one in passes]),
        phase=np.tile(phase_codes(aligned.phases[grid]), len(passes)),
        spans=tuple(spans),
        notes=aligned.notes,
        log_sha256=flight.fingerprint,
        alone=np.concatenate([one.alone[grid + every] for one in passes]),
    )


def held(values: Array, fresh: BoolArray | None = None, before: Array | float = np.nan) -> Array:
    """Zero-order hold of fresh values, shape (n, k).

    Args:
        values: Values, shape (n, k).
        fresh: Which of them are fresh, shape (n, k); None: those that are finite.
        before: Value before the first fresh one, shape (k,) or a number.
    """
    fresh = np.isfinite(values) if fresh is None else fresh
    row = np.where(fresh, np.arange(1, len(values) + 1)[:, None], 0)
    last = np.maximum.accumulate(row, axis=0)
    padded = np.vstack([np.broadcast_to(before, values.shape[1:]), values])
    return np.take_along_axis(padded, last, axis=0)


def restart_before_s(protocol: Protocol, horizon: int, rate_hz: float) -> float:
    """Time from the restart at the measured state to a reading, under a protocol, s.

    In `track` it is the age of the newest residual: measurements up to then are known. In `free`
    the twin follows the motion: errors of its motion are due to forces (`learning.force`).
    """
    return {"track": horizon / rate_hz, "reconstruct": DEFAULT_HORIZON_S, "free": 0.0}[protocol]


def _steps(rate_hz: float, restart_s: float) -> tuple[int, int]:
    """Grid steps of the twin per interval, and from restart to reading."""
    every = round(1 / (rate_hz * GRID_S)) if 0 < rate_hz < np.inf else 0
    if every < 1 or abs(every * rate_hz * GRID_S - 1) > 1e-9:
        raise ModelError(
            f"rate {rate_hz:g} Hz: needs 1000 Hz over a whole number, such as 50, 100 or 200 Hz."
        )
    steps = round(restart_s / GRID_S) if 0 <= restart_s < np.inf else -1
    if not (steps == 0 or steps >= every) or abs(steps * GRID_S - restart_s) > 1e-9:
        raise ModelError(
            f"restart {restart_s:g} s before: needs a multiple of 1 ms of at least one interval, "
            f"{every * GRID_S:g} s, or 0."
        )
    return every, steps


def _whole(aligned: AlignedFlight, grid: IntArray, steps: int) -> BoolArray:
    """Instants in the air at which the state is known, and since the restart where there is one."""
    known = aligned.airborne & np.all(np.isfinite(aligned.states), axis=1)
    if not aligned.motion.restarts:
        return np.asarray(known[grid], dtype=np.bool_)
    unknown_before = np.concatenate([[0], np.cumsum(~known)])
    begin = np.maximum(grid - steps, 0)
    return np.asarray(
        (grid >= steps) & (unknown_before[grid + 1] == unknown_before[begin]), dtype=np.bool_
    )


def _restarts(
    aligned: AlignedFlight,
    grid: IntArray,
    valid: BoolArray,
    steps: int,
    every: int,
    progress: Callable[[float], None],
) -> Array:
    """States `READ` over the last interval of every window, shape (n, every + 1, 13)."""
    ends = np.full((len(grid), every + 1, len(READ)), np.nan)
    if aligned.motion.restarts and valid.any():
        ends[valid] = window_ends(aligned, grid[valid] - steps, steps, every, progress)
    if aligned.motion.position is None:
        ends[:, :, _ENDS["pos"]] = np.nan
    return ends


def _at_measured_state(
    flight: Flight, vehicle: Vehicle, aligned: AlignedFlight
) -> dict[str, Array]:
    """Virtual readings by group at every point of the twin's grid, shape (n_grid, 3) each."""
    readings, _ = predicted_readings(
        aligned.airframe, aligned.imu, aligned.states, aligned.inputs.u
    )
    outputs = aligned.imu.output_names
    states = [s.name for s in aligned.airframe.states]
    found = {group: np.full((len(readings), 3), np.nan) for group in GROUPS}
    for kind in OF_IMU:
        found[kind.signal] = readings[:, [outputs.index(n) for n in kind.columns]]
    for group in PUT:
        found[group] = aligned.states[:, [states.index(n) for n in CHANNELS[GROUPS[group]]]]
    pose = pose_signals(aligned)
    for kind in OF_POSE:
        if kind.learned and set(kind.needs) <= pose.keys():
            sensor = kind.make(vehicle)
            rows = rows_along_pose(sensor, flight, pose, aligned.inputs.t_s)
            columns = [sensor.output_names.index(n) for n in kind.columns]
            found[kind.signal] = sensor_readings(sensor, rows)[:, columns]
    return found


def _against(samples: Signal, near: Array, t_s: Array, every: int) -> tuple[IntArray, Array]:
    """The last sample in each interval minus the twin's reading at its time.

    Args:
        samples: Measured samples.
        near: Twin's readings over each interval, shape (n, every + 1, 3).
        t_s: Ends of the intervals, s, shape (n,).
        every: Number of points per interval.

    Returns:
        Rows with a sample, shape (k,), and their residuals, shape (k, 3).
    """
    row = np.searchsorted(t_s + 1e-9, samples.t_s)
    back = (t_s[np.minimum(row, len(t_s) - 1)] - samples.t_s) / GRID_S  # in grid steps
    inside = (row < len(t_s)) & (back < every - 1e-6)
    last = inside & (np.append(row[1:], -1) != row)
    row, place = row[last], np.clip(every - back[last], 0.0, every)
    before = np.minimum(place.astype(np.intp), every - 1)
    share = (place - before)[:, None]
    virtual = near[row, before] * (1 - share) + near[row, before + 1] * share
    residual = samples.values[last] - virtual  # noqa: PD011 - not of pandas
    known = np.all(np.isfinite(residual), axis=1)
    return row[known], residual[known]


def _spans(valid: BoolArray) -> tuple[tuple[int, int], ...]:
    return tuple((a, b) for a, b in stretches_where(valid) if b - a >= SHORTEST_SPAN)


_BLOCKS = ("virtual", "residual", "fresh")
"""Column groups per channel in a stored file."""
_RATE = b"rate_hz"
"""Metadata key of the rate in a stored file."""


def write_residuals(flights: Sequence[ResidualFlight], path: Path) -> None:
    """Write flights of one rate and number of commands; the same flights give the same bytes.

    Columns: `flight`, `t_s`, `phase` (code), `span` (number of the span, -1 outside), `cmd_1..m`,
    and `virtual.C`, `residual.C`, `fresh.C` per channel C. Floating-point numbers have 64 bits.
    """
    table = pa.Table.from_pandas(
        pd.concat([_frame(f) for f in flights], ignore_index=True), preserve_index=False
    )
    rate = {_RATE: repr(flights[0].rate_hz).encode()}
    pq.write_table(table.replace_schema_metadata(rate), path, compression="zstd")


def read_residuals(path: Path) -> list[ResidualFlight]:
    """Read the flights of `write_residuals`, without their notes.

    Raises:
        ModelError: The file is missing or has another format.
    """
    try:
        with opened(path, path.name) as file:
            table = file.read()
        rate_hz = float(table.schema.metadata[_RATE])
        frame = table.to_pandas()
        parts = [_flight(str(k), f, rate_hz) for k, f in frame.groupby("flight", sort=False)]
    except (LogError, OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise ModelError(
            f"{path}: the residuals a model was trained on cannot be read ({error}); "
            "train the model again."
        ) from error
    return parts


def _frame(flight: ResidualFlight) -> pd.DataFrame:
    span = np.full(len(flight.t_s), -1)
    for k, (a, b) in enumerate(flight.spans):
        span[a:b] = k
    columns = {"flight": flight.name, "t_s": flight.t_s, "phase": flight.phase, "span": span}
    columns |= {f"cmd_{i + 1}": c for i, c in enumerate(flight.commands.T)}
    for block in _BLOCKS:
        values = getattr(flight, block)
        columns |= {f"{block}.{c}": values[:, i] for i, c in enumerate(CHANNELS)}
    return pd.DataFrame(columns)


def _flight(name: str, frame: pd.DataFrame, rate_hz: float) -> ResidualFlight:
    stem = f"{_BLOCKS[0]}."
    names = [c.removeprefix(stem) for c in frame if c.startswith(stem)]
    check_channels(names)
    virtual, residual, fresh = (
        frame[[f"{block}.{c}" for c in CHANNELS]].to_numpy() for block in _BLOCKS
    )
    commands = [c for c in frame if c.startswith("cmd_")]
    rows = frame.groupby("span").indices
    spans = [(int(rows[k][0]), int(rows[k][-1]) + 1) for k in sorted(rows) if k >= 0]
    return ResidualFlight(
        name=name,
        rate_hz=rate_hz,
        t_s=frame["t_s"].to_numpy(),
        virtual=virtual,
        residual=residual,
        fresh=fresh,
        commands=frame[commands].to_numpy().reshape(len(frame), len(commands)),
        phase=frame["phase"].to_numpy(dtype=np.intp),
        spans=tuple(spans),
    )
