"""Residuals of a flight that still goes on.

They are those of `flight_gap`, by the same functions, over a window that moves along: its interior
has the numbers of the whole flight, because

- the low-pass of the body rates, forward and backward, has forgotten its ends after `FORGOTTEN_S`,
- the causal low-passes of a channel have forgotten where they began after `BEFORE_S`,
- states that are integrated, rotors and loads, go on from window to window,
- rows are thinned out from where a piece of flight began, however long ago that was,
- what depends on the whole flight is settled when the twin starts, and is noted in the recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...component.building import BUILDING
from ...effects import ages, late_actions
from ...errors import LogError
from ...logs import Flight
from ...logs.columns import ACC, GYRO, POS, QUAT, VEL
from ...logs.flight import Settled
from ...vehicle import Vehicle
from ..airborne import resting_height
from ..aligned import AlignedFlight
from ..channels import EVERY, GRID_HZ, SHORTEST_S
from ..flight_gap import DEFAULT_HORIZON_S, end_channels
from ..gap import Channel
from ..imu import imu_channels
from ..measured import (
    LONGEST_GAP_INTERVALS,
    LONGEST_GAP_S,
    MeasuredMotion,
    measured_motion,
)
from ..short_horizon import window_ends
from ..teacher_forced import GRID_S, choose_drive
from .equations import Equations
from .grid import NONE, GridRows, RunningGrid, with_motion
from .table import LastRows, Rows

Array = NDArray[np.float64]
FORGOTTEN_S = 0.35
"""The low-pass of the body rates forgets by exp(-133/s): 5e-21 after so long, in samples."""
BEFORE_S = 2.0
"""A channel's low-pass forgets by exp(-80/s) at 18 Hz, by exp(-13/s) at the 3 Hz that an IMU of
8 Hz allows: 3e-12 after so long. The shortest piece of flight that counts is shorter."""
_AFTER = 24
"""Grid points behind a sample that a shift by an age may need."""
_DIFFERENCES = 10
"""Samples on either side that a derivative of position or attitude may need."""
SETTLE_S = 2.0
"""From the begin of a flight until the twin starts: so long streams may take to appear."""
LONGEST_WAIT_S = 10.0
"""Of rows that wait for a stream that the twin needs."""
NEEDED = ("cmd_1", "rotor_1", "q_w", "vel_x", "pos_x", "gyro_x", "acc_x", "vbat_v")
"""Columns of whose signals the equations depend: one that appears later begins a new flight."""


@dataclass(frozen=True, slots=True)
class ResidualBlock:
    """What is new of the residuals of a flight.

    Attributes:
        start_s: From where on it is new, s.
        end_s: Up to where it is told.
        channels: Teacher-forced, as of `imu_channels`: samples after `start_s` up to `end_s`.
        short: At the ends of short windows, as of `end_channels`.
        aligned: The new rows of the grid of `GRID_HZ`, `airborne` where all of the state is known
            as well; None: there are none.
        flight: The last seconds of the flight table, the new rows among them.
    """

    start_s: float
    end_s: float
    channels: tuple[Channel, ...]
    short: tuple[Channel, ...]
    aligned: AlignedFlight | None
    flight: Flight


@dataclass(slots=True)
class RunningResiduals:
    """Residuals of one flight against one vehicle, while it is flown.

    Attributes:
        vehicle: The twin.
        name: Of the flight.
        horizon_s: Of the short horizon, a multiple of 1 ms.
        equations: Of the vehicle, where they are at hand.
        waits_for: What is missing for the twin to start, in words; "": nothing.
    """

    vehicle: Vehicle
    name: str = "live"
    horizon_s: float = DEFAULT_HORIZON_S
    equations: Equations | None = None
    waits_for: str = "the first seconds of flight"
    _last: LastRows = field(init=False)
    _twin: "_Twin | None" = None
    _begins_s: float | None = None

    def __post_init__(self) -> None:
        self._last = LastRows(self.name)

    @property
    def settled(self) -> Settled | None:
        """What a recording has to note; None: the twin has not started."""
        return self._last.settled

    def append(self, rows: Rows) -> None:
        """Take new rows of the flight table, later than all so far."""
        self._last.append(rows)
        if self._begins_s is None:
            self._begins_s = self._last.first_s

    def lacks(self, columns: Sequence[str]) -> list[str]:
        """Of columns that come anew those with which the twin would be another."""
        if self._twin is None:
            return []
        return [c for c in columns if c in NEEDED and c not in self._twin.columns]

    def update(self, final: bool = False) -> ResidualBlock | None:
        """What can be told since the last time; None: nothing.

        Args:
            final: There will be no more rows.
        """
        if not len(self._last):
            return None
        if self._twin is None and not self._started(final):
            self._last.forget(self._last.last_s - LONGEST_WAIT_S, {})
            return None
        assert self._twin is not None
        return self._twin.update(self._last, final)

    def _started(self, final: bool) -> bool:
        """Start the twin, where all that it needs is there."""
        assert self._begins_s is not None
        if self._last.last_s - self._begins_s < SETTLE_S and not final:
            return False
        self._last.settled = Settled(self._last.rates_hz())
        try:
            with BUILDING:
                flight = self._last.flight()
                self._twin = _Twin(flight, self.vehicle, self.horizon_s, self.equations)
        except LogError as error:
            self._last.settled = None
            self.waits_for = str(error).partition(": ")[2]
            return False
        self.waits_for = ""
        return True


class _Twin:
    """Twin and flight from when all is there that the twin needs."""

    def __init__(
        self, flight: Flight, vehicle: Vehicle, horizon_s: float, equations: Equations | None
    ) -> None:
        self.columns = frozenset(c for c in flight.columns if flight.has(c))
        self._vehicle, self._steps = vehicle, round(horizon_s / GRID_S)
        self._horizon_s = horizon_s
        drive = choose_drive(flight, vehicle)
        if equations is None or equations.drive != drive:
            equations = Equations.of(vehicle, drive)
        measured_motion(flight)  # says where there is none
        self._imu_predictor, self._windows = equations.imu_predictor, equations.windows
        self._coarse = RunningGrid(vehicle, equations, 1 / GRID_HZ)
        self._fine = RunningGrid(vehicle, equations, GRID_S)
        self._heights_m: list[Array] = []
        self._resting_known = False
        self._reported_s = float(flight.time_s[0])
        self._reported_row = round(self._reported_s * GRID_HZ) - 1
        self._window_next = 0
        late_s = max([0.0, *late_actions(vehicle).values()])
        self._before_s = BEFORE_S + 1.0 + late_s
        self._age_rows = int(np.ceil(max([0.0, *map(abs, ages(vehicle).values())]) * GRID_HZ))
        rates = flight.settled.rates_hz if flight.settled else {}
        self._after_s = max([FORGOTTEN_S, *(_longest_gap_s(r) for r in rates.values())])
        self._needed = {
            columns[0]: (columns, _DIFFERENCES)
            for columns, instead in ((POS, VEL), (QUAT, GYRO))
            if columns[0] in rates and instead[0] not in self.columns  # then it is derived
        } | {
            columns[0]: (columns, max(_DIFFERENCES, int(np.ceil(FORGOTTEN_S * rates[columns[0]]))))
            for columns in (ACC, GYRO)
            if columns[0] in rates
        }

    def update(self, last: LastRows, final: bool) -> ResidualBlock | None:
        """See `RunningResiduals.update`."""
        until_s = last.last_s if final else self._until_s(last)
        window = last.flight()
        motion = measured_motion(window, doubts=False)
        coarse = self._coarse.new_rows(window, motion, until_s)
        fine = self._fine.new_rows(window, motion, until_s)
        if coarse is None or fine is None:
            return None
        resting_m = self._resting_m(coarse, motion, last)
        keep = round((self._before_s + LONGEST_WAIT_S) * GRID_HZ)
        self._coarse.append(coarse, resting_m, keep)
        self._fine.append(fine, resting_m, max(2 * self._steps, 4000) + len(fine.t_s))
        start_s, reported = self._reported_s, self._reported_row
        end = self._decided(final)
        channels = self._channels(window, reported, end)
        short = self._short_horizon(motion)
        block = None
        if end > reported + 1:
            aligned = self._coarse.piece(reported + 1, end)
            block = with_motion(aligned, motion)
            self._reported_row, self._reported_s = end - 1, (end - 1) / GRID_HZ
        samples = {name: count + 1 for name, (_, count) in self._needed.items()}
        last.forget(min(self._reported_s, until_s) - self._before_s - FORGOTTEN_S, samples)
        return ResidualBlock(start_s, self._reported_s, channels, short, block, window)

    def _until_s(self, last: LastRows) -> float:
        """Up to where what is there will not change any more.

        Filters and differences go by samples: before a pause of a signal they wait for its end, for
        `LONGEST_WAIT_S` at most.
        """
        newest_s = last.last_s
        known = [last.time_before_newest(c, n) for c, n in self._needed.values()]
        known = [t for t in known if t > newest_s - LONGEST_WAIT_S]
        return min([newest_s - self._after_s, *known])

    def _resting_m(self, new: GridRows, motion: MeasuredMotion, last: LastRows) -> float | None:
        """Height of the resting place, settled when the rotors carry for the first time."""
        assert last.settled is not None
        down_m = last.settled.resting_down_m
        if self._resting_known:
            return None if down_m is None else -down_m
        height_m = self._coarse.height_m(new)
        if not new.carried.any():
            self._heights_m.append(height_m[np.isfinite(height_m)])
            return None  # nothing carries: nothing is in the air
        self._heights_m.append(height_m[: int(np.argmax(new.carried))])
        before = np.concatenate(self._heights_m)
        found = None
        if motion.position is not None:
            found = resting_height(before, np.zeros(len(before), dtype=np.bool_))
        self._resting_known, self._heights_m = True, []
        last.settled = replace(last.settled, resting_down_m=None if found is None else -found)
        return found

    def _decided(self, final: bool) -> int:
        """Row up to which all samples are told: behind it a piece may be too short to count."""
        rows = self._coarse.rows
        assert rows is not None
        if final:
            return rows.end
        last_piece = int(self._coarse.piece_of[-1])
        end = rows.end - _AFTER - self._age_rows
        if last_piece != NONE and rows.end - last_piece < SHORTEST_S * GRID_HZ:
            end = min(end, last_piece)
        return max(end, self._reported_row + 1)

    def _channels(self, window: Flight, reported: int, end: int) -> tuple[Channel, ...]:
        """Teacher-forced samples behind a row and before another."""
        rows = self._coarse.rows
        assert rows is not None
        first = max(reported + 1 - round(BEFORE_S * GRID_HZ), rows.first)
        piece = self._coarse.piece_at(first)
        if piece != NONE:
            first += (piece - first) % EVERY
        if end <= reported + 1 or rows.end - first < SHORTEST_S * GRID_HZ:
            return ()
        aligned = self._coarse.piece(first, rows.end)
        if not aligned.airborne.any():
            return ()
        after_s, until_s = (reported + 0.5) / GRID_HZ, (end - 0.5) / GRID_HZ
        found = imu_channels(window, self._vehicle, aligned, self._imu_predictor)
        return tuple(_between(c, after_s, until_s) for c in found)

    def _short_horizon(self, motion: MeasuredMotion) -> tuple[Channel, ...]:
        """Ends of the windows of which all is known now."""
        if motion.attitude is None or motion.velocity is None or motion.rates is None:
            return ()
        fine = self._fine
        rows = fine.rows
        assert rows is not None
        starts, steps = [], self._steps
        for start in _begins(fine.piece_of):
            at = max(start, self._window_next)
            piece = int(fine.piece_of[max(at - rows.first, 0)]) if at < rows.end else NONE
            if piece == NONE or piece != start:
                continue
            at = max(at, start)
            while at + steps < rows.end and fine.piece_at(at + steps) == piece:
                starts.append(at)
                at += steps
            self._window_next = at
        if not starts:
            return ()
        first = min(starts)
        aligned = with_motion(fine.piece(first, rows.end), motion)
        here = np.array(starts, dtype=np.intp) - first
        predicted = window_ends(aligned, here, steps, tail=0, windows=self._windows)[:, 0]
        return tuple(end_channels(aligned, here + steps, predicted, self._horizon_s))


def _begins(piece_of: NDArray[np.int64]) -> list[int]:
    """First rows of the pieces that rows are in, in order."""
    return [int(p) for p in dict.fromkeys(piece_of.tolist()) if p != NONE]


def _longest_gap_s(rate_hz: float) -> float:
    """So long after a sample it is told whether a gap follows it."""
    return min(LONGEST_GAP_INTERVALS / rate_hz, max(LONGEST_GAP_S, 1.5 / rate_hz)) + 0.01


def _between(channel: Channel, after_s: float, until_s: float) -> Channel:
    """Samples of a channel within a span of time."""
    part = (channel.t_s > after_s) & (channel.t_s < until_s)
    return replace(
        channel,
        t_s=channel.t_s[part],
        measured=channel.measured[part],
        simulated=channel.simulated[part],
        phase=channel.phase[part],
        unfiltered=None
        if channel.unfiltered is None
        else _between(channel.unfiltered, after_s, until_s),
    )
