"""Residuals of a live flight: the numbers of `flight_gap`, a second later.

They are computed by the same functions over the last seconds of a stream, because

- the start of a channel's causal low-pass has no effect after `stream.BEFORE_S`,
- decimation counts rows from the start of a piece of flight, at any distance in time.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..component.along import BUILDING
from ..effects import ages
from ..logs import Flight
from .aligned import AlignedFlight
from .channels import EVERY, GRID_HZ, SHORTEST_S, imu_channels
from .flight_gap import DEFAULT_HORIZON_S, end_channels
from .gap import Channel
from .short_horizon import window_ends
from .stream import BEFORE_S, NONE, Equations, RunningGrid, Stream
from .teacher_forced import GRID_S

_AFTER = 24
"""Grid points after a sample that a shift by a delay may need."""


@dataclass(frozen=True, slots=True)
class ResidualBlock:
    """New residuals of a flight.

    Attributes:
        start_s: Time from which it is new, s.
        end_s: Time up to which it is complete, s.
        channels: Teacher-forced channels, as from `imu_channels`: samples after `start_s` up to
            `end_s`.
        short: Channels at the ends of short windows, as from `end_channels`.
        aligned: New rows of the grid of `GRID_HZ`, `airborne` only where the whole state is known;
            None: there are none.
        flight: Last seconds of the flight table, including the new rows.
        fine: New rows on the grid of `GRID_S`, as far as they are final.
    """

    start_s: float
    end_s: float
    channels: tuple[Channel, ...]
    short: tuple[Channel, ...]
    aligned: AlignedFlight | None
    flight: Flight
    fine: AlignedFlight


class StreamResiduals:
    """Residuals of one live flight against one vehicle."""

    def __init__(self, stream: Stream, horizon_s: float = DEFAULT_HORIZON_S) -> None:
        """Set up without residuals.

        Args:
            stream: Rows of the flight.
            horizon_s: Short horizon, a multiple of 1 ms.
        """
        self.stream = stream
        stream.needed_s = -np.inf
        self._horizon_s, self._steps = horizon_s, round(horizon_s / GRID_S)
        self._equations: Equations | None = None
        self._reported_s, self._reported_row = np.nan, 0
        self._window_next = 0
        late_s = ages(stream.vehicle).values()
        self._age_rows = int(np.ceil(max([0.0, *map(abs, late_s)]) * GRID_HZ))

    def update(self, final: bool = False) -> ResidualBlock | None:
        """New residuals since the last call; None: none.

        Args:
            final: Whether there will be no more rows.
        """
        stream = self.stream
        if not stream.advance(final):
            return None
        if self._equations is None:
            self._start()
        assert stream.window is not None and stream.grid is not None
        if stream.grid.rows is None:
            return None
        fine = self._fine.new_rows(stream.window, stream.motion, stream.until_s)
        if fine is None:
            return None
        self._fine.append(fine, stream.resting_m, max(2 * self._steps, 4000) + len(fine.t_s))
        start_s, reported = self._reported_s, self._reported_row
        end = self._decided(stream.grid, final)
        channels = self._channels(stream.grid, reported, end)
        short = self._short_horizon()
        block = None
        if end > reported + 1:
            block = stream.grid.piece(reported + 1, end, stream.motion)
            self._reported_row, self._reported_s = end - 1, (end - 1) / GRID_HZ
        stream.needed_s = self._reported_s
        rows = self._fine.rows
        assert rows is not None
        fine_piece = self._fine.piece(rows.first, rows.end, stream.motion)
        return ResidualBlock(
            start_s, self._reported_s, channels, short, block, stream.window, fine_piece
        )

    def _start(self) -> None:
        """Set up the equations of the short horizon."""
        stream = self.stream
        assert stream.equations is not None
        with BUILDING:
            self._equations = stream.equations
            self._fine = RunningGrid(stream.vehicle, self._equations, GRID_S)
            self._windows, self._predictor = self._equations.windows, self._equations.imu_predictor
        self._reported_s = stream.starts_s
        self._reported_row = round(stream.starts_s * GRID_HZ) - 1

    def _decided(self, grid: RunningGrid, final: bool) -> int:
        """Row up to which all samples are known: behind it a piece may be too short for use."""
        assert grid.rows is not None
        if final:
            return grid.rows.end
        last_piece = int(grid.piece_of[-1])
        end = grid.rows.end - _AFTER - self._age_rows
        if last_piece != NONE and grid.rows.end - last_piece < SHORTEST_S * GRID_HZ:
            end = min(end, last_piece)
        return max(end, self._reported_row + 1)

    def _channels(self, grid: RunningGrid, reported: int, end: int) -> tuple[Channel, ...]:
        """Teacher-forced samples after a row and before another."""
        rows, stream = grid.rows, self.stream
        assert rows is not None and stream.window is not None
        first = max(reported + 1 - round(BEFORE_S * GRID_HZ), rows.first)
        piece = grid.piece_at(first)
        if piece != NONE:
            first += (piece - first) % EVERY
        if end <= reported + 1 or rows.end - first < SHORTEST_S * GRID_HZ:
            return ()
        aligned = grid.piece(first, rows.end)
        if not aligned.airborne.any():
            return ()
        after_s, until_s = (reported + 0.5) / GRID_HZ, (end - 0.5) / GRID_HZ
        found = imu_channels(stream.window, stream.vehicle, aligned, self._predictor)
        return tuple(_between(c, after_s, until_s) for c in found)

    def _short_horizon(self) -> tuple[Channel, ...]:
        """Channels at the ends of the windows that are complete now."""
        motion = self.stream.motion
        if not motion.restarts:
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
        aligned = fine.piece(first, rows.end, motion)
        here = np.array(starts, dtype=np.intp) - first
        predicted = window_ends(aligned, here, steps, tail=0, windows=self._windows)[:, 0]
        return tuple(end_channels(aligned, here + steps, predicted, self._horizon_s))


def _begins(piece_of: NDArray[np.int64]) -> list[int]:
    """First rows of the pieces that contain some rows, in order."""
    return [int(p) for p in dict.fromkeys(piece_of.tolist()) if p != NONE]


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
