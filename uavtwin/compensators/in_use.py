"""Evaluation of a driven twin as it is used: its FMU alternately follows a flight and runs open
loop.

Every `CYCLE_S` the exported FMU runs open loop for `ALONE_S`, then follows the measured motion
again. Three passes with shifted start together cover the whole flight in open loop. Its readings in
these passes are the training data of a compensator of `free`; its readings and corrections, at
every reading of the flight, give the error reduction by a compensator.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.slave import Slave
from fmus.compensator import NetworkFile
from learning.data.channels import CHANNELS
from learning.data.flights import PUT, Pass, ResidualFlight, residuals_in_use
from learning.data.sequences import OF_THE_DAY
from learning.force.windows import clear, true_motion
from twin.errors import LogError
from twin.formatting import number, percent
from twin.logs import Flight
from twin.physics.airframe import REPORTED
from twin.physics.rotors import Drive
from twin.physics.sensors.table import SENSORS
from twin.representation import ShortRepr
from twin.residuals.aligned import align_flight
from twin.residuals.teacher_forced import GRID_S
from twin.vehicle import Vehicle as TwinVehicle

from ..display import TextTable
from ..exports.parts import OBSERVER, LearnedForce, twin
from ..exports.write import temporary_fmu
from ..force.open_loop import PREFIX, driving_inputs, taken_by
from ..record import Record
from ..vehicles import Vehicle

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
ALONE_S, CYCLE_S = 0.5, 1.5
"""Duration of each open-loop run, and period of its repetition, s; 0.5 s is the horizon of the
gap."""
KNOWN_S = 0.5
"""Time for which the motion must have been known before a reading counts, s."""
SETTLED_S = 0.2
"""Time for which a twin must have followed again before a reading counts, s."""
BETTER = 0.01
"""Least relative reduction of the rms of readings by a correction; equal to that of the learned
force."""
WORST = 1.05
"""Largest allowed error ratio in any flight left out: a mean over flights could hide one with a
larger error. Made up; it allows for folds with fewer training flights than the model."""
TINY = 1e-9
"""Lower bound of a ratio, so that its logarithm is finite."""
FOLLOWING, ALONE = "following", "alone"
"""Modes."""
_COMPONENTS = {s.signal: s.component for s in SENSORS}
_COMPENSATOR = "compensator."  # prefix in the fused FMU
SOURCES = tuple(
    f"{_COMPONENTS[stem]}.{c}" if (stem := c.rpartition("_")[0]) in _COMPONENTS else PREFIX + c
    for c in CHANNELS
)
"""Outputs of the fused FMU that correspond to `CHANNELS`."""


class ChannelInUse(Record, frozen=True, kw_only=True):
    """Errors of one channel over flights, rms of measured minus predicted, unit of the channel.

    Attributes:
        channel: Column of the flight table.
        mode: `following` the measured motion, or `alone` for up to 0.5 s.
        n: Number of readings.
        uncorrected: Rms error of the twin with its untrained disturbance observer.
        corrected: Rms error of the same twin with the correction.
        last_reading: Rms error of predicting the previous reading; for `alone`, the last reading
            before the open-loop run.
        mean_reading: Rms error of predicting the mean of the flight.
    """

    channel: str
    mode: str
    n: int
    uncorrected: float
    corrected: float
    last_reading: float
    mean_reading: float

    @property
    def ratio(self) -> float:
        """Corrected over uncorrected rms."""
        return self.corrected / self.uncorrected if self.uncorrected > 0 else 1.0


class InUseRecord(Record, frozen=True, kw_only=True):
    """Error reduction by a compensator in the exported FMU.

    Attributes:
        flights: Names of the flights.
        taught: Relation to the training: `left out`, cross-validated, each flight corrected by a
            model of the others; `other`, no training flights; or `same`, the training flights.
        shut: Channels whose correction is disabled.
        inside: Share of the time inside the training envelope.
        channels: Errors of each channel and mode.
    """

    flights: tuple[str, ...]
    taught: str
    shut: tuple[str, ...]
    inside: float
    channels: tuple[ChannelInUse, ...]

    @property
    def claim(self) -> str:
        """Error reduction by the enabled corrections, in one sentence."""
        flights = {
            "left out": "flights left out",
            "other": "other flights",
            "same": "its own flights, for want of others",
        }[self.taught]
        said = [self._mode(mode) for mode in (FOLLOWING, ALONE)]
        off = f"; off, as they do not help: {', '.join(self.shut)}" if self.shut else ""
        return (
            f"in the exported FMU, on {flights}: {'; '.join(s for s in said if s)}; "
            f"{percent(self.inside)} of the time inside the envelope{off}"
        )

    def _mode(self, mode: str) -> str:
        rows = [c for c in self.channels if c.mode == mode and c.channel not in self.shut]
        if not rows:
            return f"{mode}, no channel is corrected"
        ratios = [c.ratio for c in rows]
        beaten = sum(c.corrected > min(c.last_reading, c.mean_reading) for c in rows)
        last = f", {beaten} of them worse than the last or the mean reading" if beaten else ""
        return (
            f"{mode}, {sum(r < 1 for r in ratios)} of {len(rows)} corrected channels closer, "
            f"{float(np.median(ratios)):.2f} of the uncorrected rms at the median, "
            f"{max(ratios):.2f} at most{last}"
        )

    def table(self) -> TextTable:
        """Table with one row per mode and channel."""
        header = ("in use", "channel", "n", "twin", "corrected", "over", "last reading", "mean")
        rows = [
            (
                *(c.mode, c.channel, str(c.n), number(c.uncorrected)),
                *(
                    ("off", "")
                    if c.channel in self.shut
                    else (number(c.corrected), f"{c.ratio:.2f}")
                ),
                *(number(c.last_reading), number(c.mean_reading)),
            )
            for c in self.channels
        ]
        return TextTable(header, tuple(rows))


class UsedFlight:
    """A flight along which driven twins are evaluated."""

    def __init__(self, flight: Flight, vehicle: TwinVehicle) -> None:
        """Resample the flight to the grid of its twin."""
        self.flight, self._vehicle = flight, vehicle
        self.aligned = align_flight(flight, vehicle)
        known = clear(self.aligned) & np.isfinite(true_motion(vehicle, self.aligned)).all(axis=1)
        unknown = np.where(known, 0, np.arange(1, len(known) + 1))
        since = np.arange(len(known)) + 1 - np.maximum.accumulate(unknown)
        self._known, self._counts = known, since > round(KNOWN_S / GRID_S)

    def through(self, fmu: Path, names: Sequence[str], compensated: bool = False) -> list[Pass]:
        """Run a driven twin along the flight, `CYCLE_S` over `ALONE_S` times.

        Args:
            fmu: FMU of a twin with the inputs of `driving_inputs`.
            names: Outputs that are recorded.
            compensated: Whether the twin has a compensator.
        """
        rows, passes = np.arange(len(self._known)), []
        with closing(Slave("used", fmu)) as slave:
            for first_s in np.arange(0.0, CYCLE_S, ALONE_S):
                phase = (rows * GRID_S + first_s + 1e-9) % CYCLE_S
                follows = self._known & (phase >= ALONE_S)
                shown = self._once(slave, names, follows, compensated)
                since = np.maximum.accumulate(np.where(follows, rows, -1))
                lone = np.maximum.accumulate(np.where(follows, 0, rows))
                settled = rows - lone > round(SETTLED_S / GRID_S)
                flown = self._counts & (since >= 0) & (rows - since <= round(ALONE_S / GRID_S))
                passes.append(Pass(shown, flown, flown & (settled | ~follows), ~follows))
        return passes

    def _once(
        self, slave: Slave, names: Sequence[str], follows: BoolArray, compensated: bool
    ) -> Array:
        given = driving_inputs(
            self.flight, self._vehicle, self.aligned, np.flatnonzero(follows), compensated
        )
        inputs, values = taken_by(slave, given)
        found = np.full((len(values), len(names)), np.nan)
        slave.begin(inputs, names, {OBSERVER: 1.0})
        for k in range(len(values) - 1):
            found[k + 1] = slave.advance(values[k], k * GRID_S, GRID_S)
        return found

    def residuals(self, fmu: Path, rate_hz: float) -> ResidualFlight:
        """Residuals of the readings against an uncorrected twin.

        Args:
            fmu: FMU, as of `through`.
            rate_hz: Rate of the residuals, 1000 Hz over an integer.
        """
        names = [n for n in self.aligned.airframe.input_names if n.startswith(("cmd_", "rotor_"))]
        drives = [f"{PREFIX}{REPORTED}{n}" for n in names]
        passes = self.through(fmu, [*SOURCES, *drives])
        return residuals_in_use(self.flight, self.aligned, passes, rate_hz)

    def corrections(self, fmu: Path) -> "Corrections":
        """Errors of a corrected twin at each reading of the flight."""
        corrected = [f"{_COMPENSATOR}corrected.{c}" for c in CHANNELS]
        passes = self.through(fmu, [*SOURCES, *corrected, f"{_COMPENSATOR}inside"], True)
        rows: dict[tuple[str, str], Array] = {}
        for c, channel in enumerate(CHANNELS):
            if not self.flight.has(channel):
                continue
            t_s, values = self.flight.signal([channel])
            k = np.floor((t_s - self.aligned.inputs.t_s[0]) / GRID_S + 1e-6).astype(int)
            sampled = (k > 0) & (k < len(self._known))
            k, y = k[sampled], values[sampled, 0]
            for mode in (FOLLOWING, ALONE):
                if mode == FOLLOWING and channel.startswith(PUT):
                    continue
                parts = []
                for one in passes:
                    last = _before(k, y, one.alone if mode == ALONE else None)
                    here = one.counts[k] & (one.alone[k] == (mode == ALONE)) & np.isfinite(last)
                    both = one.shown[k][:, [c, len(CHANNELS) + c]]
                    parts.append(np.column_stack([both, last, y])[here])
                rows[channel, mode] = np.vstack(parts) - np.vstack(parts)[:, -1:] * [1, 1, 1, 0]
        inside = np.concatenate([one.shown[one.counts, -1] for one in passes])
        if not len(inside):
            raise LogError(
                f"{self.flight.name}: nowhere in the air {KNOWN_S:g} s of position, velocity, "
                f"attitude and body rates without a gap, along which the exported twin could be "
                f"used. Give a longer flight."
            )
        return Corrections(self.flight.name, rows, inside)


def _before(k: NDArray[np.intp], y: Array, alone: BoolArray | None) -> Array:
    """The previous reading of each; where the twin runs open loop, the last one before that, shape
    (n,)."""
    row = np.arange(len(k)) - 1
    if alone is not None:
        follows = np.where(~alone, np.arange(len(alone)), -1)
        row = np.searchsorted(k, np.maximum.accumulate(follows)[k], "right") - 1
    return np.asarray(np.where(row >= 0, y[np.maximum(row, 0)], np.nan))


@dataclass(frozen=True, slots=True)
class Corrections(ShortRepr):
    """Errors of one flight.

    Attributes:
        flight: Name of the flight.
        rows: Errors by channel and mode: twin, corrected twin and last reading minus the reading,
            and the reading itself, shape (n, 4).
        inside: Whether the twin was inside the envelope, shape (m,).
    """

    flight: str
    rows: dict[tuple[str, str], Array]
    inside: Array

    def beyond_offsets(self) -> "Corrections":
        """The same without the mean error of each sensor of `OF_THE_DAY`: where such an offset is
        large, its sign, which changes between days, would decide whether a correction helps."""
        rows = {}
        for (channel, mode), found in self.rows.items():
            away = found[:, :1].mean(axis=0) if OF_THE_DAY[CHANNELS.index(channel)] else 0.0
            rows[channel, mode] = found - away * np.array([1, 1, 1, 0])
        return replace(self, rows=rows)


def record_of(flights: Sequence[Corrections], taught: str, shut: Sequence[str] = ()) -> InUseRecord:
    """Record of several flights together; `taught` and `shut` as of the record."""
    channels = []
    keys = dict.fromkeys(key for f in flights for key in f.rows)
    for channel, mode in keys:
        parts = [f.rows[channel, mode] for f in flights if len(f.rows.get((channel, mode), ()))]
        if not parts:
            continue
        off = np.vstack([p[:, :3] for p in parts])
        about = np.concatenate([p[:, 3] - p[:, 3].mean() for p in parts])
        own, better, last = np.sqrt(np.mean(off**2, axis=0))
        channels.append(
            ChannelInUse(
                channel=channel,
                mode=mode,
                n=len(off),
                uncorrected=float(own),
                corrected=float(better),
                last_reading=float(last),
                mean_reading=float(np.sqrt(np.mean(about**2))),
            )
        )
    inside = float(np.mean(np.concatenate([f.inside for f in flights]) > 0))
    return InUseRecord(
        flights=tuple(f.flight for f in flights),
        taught=taught,
        shut=tuple(shut),
        inside=inside,
        channels=tuple(channels),
    )


def harmful(flights: Sequence[InUseRecord]) -> tuple[str, ...]:
    """Channels of `CHANNELS` in which a correction does not reduce the error by `BETTER`, following
    and alone, in the geometric mean over flights, or increases it in one of them (`WORST`).

    Args:
        flights: Flights, none of which was used to train the compensator that corrected it.
    """
    found = []
    for channel in CHANNELS:
        for mode in (FOLLOWING, ALONE):
            rows = [c for f in flights for c in f.channels]
            ratios = [c.ratio for c in rows if (c.channel, c.mode) == (channel, mode)]
            mean = np.exp(np.mean(np.log(np.maximum(ratios, TINY)))) if ratios else 0.0
            if mean > 1 - BETTER or max(ratios, default=0.0) > WORST:
                found.append(channel)
                break
    return tuple(found)


def driven_fmu(
    vehicle: Vehicle,
    drive: Drive,
    network: NetworkFile | None = None,
    law: LearnedForce | None = None,
) -> AbstractContextManager[Path]:
    """The FMU of a driven twin, as a context manager.

    Args:
        vehicle: Vehicle of the twin.
        drive: Drive, as of `twin.residuals.teacher_forced.choose_drive`.
        network: Network of its compensator; None: without.
        law: Learned force law; None: without.
    """
    return temporary_fmu(twin(vehicle, drive=drive, compensator=network, force=law))
