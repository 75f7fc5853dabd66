"""A driven twin as it is used: its FMU follows a flight for a while and flies alone for a while.

Every `CYCLE_S` the exported FMU is left alone for `ALONE_S`, then follows the measured motion
again. Three passes, each begun later, leave it alone everywhere once. What it reads over the passes
is what a compensator of `free` is trained on; what it reads and what it corrects, at every reading
of the flight, is what a compensator is worth.
"""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.slave import Slave
from fmus.compensator import NetworkFile
from learning.data.channels import CHANNELS
from learning.data.flights import ResidualFlight, residuals_in_use
from learning.data.sequences import OF_THE_DAY
from learning.force.windows import clear, true_motion
from twin.errors import LogError
from twin.formatting import number, percent
from twin.logs import Flight
from twin.physics.airframe import REPORTED
from twin.physics.rotors import Drive
from twin.physics.sensors.table import SENSORS
from twin.representation import short_repr
from twin.residuals.aligned import align_flight
from twin.residuals.teacher_forced import GRID_S
from twin.vehicle import Vehicle as TwinVehicle

from ..display import TextTable
from ..exports.parts import OBSERVER, LearnedForce, twin
from ..exports.write import export
from ..force.open_loop import PREFIX, driving_inputs, taken_by
from ..record import Record
from ..vehicles import Vehicle

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
ALONE_S, CYCLE_S = 0.5, 1.5
"""For how long a twin flies alone, and how often; 0.5 s is the horizon of the gap."""
KNOWN_S = 0.5
"""So long the motion has been known before a reading counts."""
SETTLED_S = 0.2
"""So long a twin has followed again before a reading counts."""
BETTER = 0.01
"""Share by which a correction must lower the rms of readings; as of the learned force."""
WORST = 1.05
"""No flight left out may have a larger ratio: a mean over flights hides one that is harmed. Made
up; it allows for folds that were taught by fewer flights than the model."""
TINY = 1e-9
"""Ratio below which there is none, so that its logarithm is finite."""
FOLLOWING, ALONE = "following", "alone"
"""Modes."""
_COMPONENTS = {s.signal: s.component for s in SENSORS}
_COMPENSATOR = "compensator."  # in front of a name of the fused FMU
SOURCES = tuple(
    f"{_COMPONENTS[stem]}.{c}" if (stem := c.rpartition("_")[0]) in _COMPONENTS else PREFIX + c
    for c in CHANNELS
)
"""Outputs of the fused FMU that are `CHANNELS`."""


class ChannelInUse(Record, frozen=True, kw_only=True):
    """Readings of one channel over flights, rms of measured minus shown, unit of the channel.

    Attributes:
        channel: Column of the flight table.
        mode: `following` the measured motion, or `alone` for up to 0.5 s.
        n: Readings.
        uncorrected: The twin, its untrained disturbance observer on.
        corrected: The same with its correction.
        last_reading: The reading before; alone: the last one before the twin was left alone.
        mean_reading: Mean of the flight.
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
        """Corrected over uncorrected."""
        return self.corrected / self.uncorrected if self.uncorrected > 0 else 1.0


class InUseRecord(Record, frozen=True, kw_only=True):
    """What a compensator does in the exported FMU.

    Attributes:
        flights: Names.
        taught: How they were taken part in: `left out`, each corrected by what the others taught;
            `other`, none of the training; or `same`, those of the training.
        shut: Channels whose correction is off.
        inside: Share of the time inside the envelope of the training.
        channels: Of each mode.
    """

    flights: tuple[str, ...]
    taught: str
    shut: tuple[str, ...]
    inside: float
    channels: tuple[ChannelInUse, ...]

    @property
    def claim(self) -> str:
        """What the correction brings, where it is on; one sentence."""
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
        """A row per mode and channel."""
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


@dataclass(frozen=True, slots=True)
class Passes:
    """What was read over a flight, a pass after the other.

    Attributes:
        shown: Of each name that was asked for, shape (n_grid, k) each.
        flown: Where the motion is known and the twin is used so, shape (n_grid,) each.
        counts: Where a reading counts, shape (n_grid,) each.
        alone: Where the twin flew by itself, shape (n_grid,) each.
    """

    shown: tuple[Array, ...]
    flown: tuple[BoolArray, ...]
    counts: tuple[BoolArray, ...]
    alone: tuple[BoolArray, ...]

    __repr__ = short_repr

    def each(self) -> Iterator[tuple[Array, BoolArray, BoolArray]]:
        """Of each pass what was shown, where it counts, and where the twin was alone."""
        yield from zip(self.shown, self.counts, self.alone, strict=True)


class UsedFlight:
    """A flight that driven twins are used along."""

    def __init__(self, flight: Flight, vehicle: TwinVehicle) -> None:
        """Put it on the grid of its twin."""
        self.flight, self._vehicle = flight, vehicle
        self.aligned = align_flight(flight, vehicle)
        known = clear(self.aligned) & np.isfinite(true_motion(vehicle, self.aligned)).all(axis=1)
        unknown = np.where(known, 0, np.arange(1, len(known) + 1))
        since = np.arange(len(known)) + 1 - np.maximum.accumulate(unknown)
        self._known, self._counts = known, since > round(KNOWN_S / GRID_S)

    def through(self, fmu: Path, names: Sequence[str], compensated: bool = False) -> Passes:
        """Use a driven twin along it.

        Args:
            fmu: Of a twin that is driven as `driving_inputs` says.
            names: Outputs that are read.
            compensated: Whether it has a compensator.
        """
        shown, flown, counts, alone = [], [], [], []
        slave = Slave("used", fmu)
        try:
            for first_s in np.arange(0.0, CYCLE_S, ALONE_S):
                phase = (np.arange(len(self._known)) * GRID_S + first_s + 1e-9) % CYCLE_S
                follows = self._known & (phase >= ALONE_S)
                shown.append(self._once(slave, names, follows, compensated))
                since = np.maximum.accumulate(np.where(follows, np.arange(len(follows)), -1))
                left = np.arange(len(follows)) - since
                lone = np.maximum.accumulate(np.where(follows, 0, np.arange(len(follows))))
                settled = np.arange(len(follows)) - lone > round(SETTLED_S / GRID_S)
                whole = self._counts & (since >= 0) & (left <= round(ALONE_S / GRID_S))
                flown.append(whole)
                counts.append(whole & (settled | ~follows))
                alone.append(~follows)
        finally:
            slave.close()
        return Passes(tuple(shown), tuple(flown), tuple(counts), tuple(alone))

    def _once(
        self, slave: Slave, names: Sequence[str], follows: BoolArray, compensated: bool
    ) -> Array:
        given = driving_inputs(
            self.flight, self._vehicle, self.aligned, np.flatnonzero(follows), compensated
        )
        inputs, values = taken_by(slave, given)
        found = np.full((len(values), len(names)), np.nan)
        slave.reset()
        slave.bind(inputs, names, np.zeros(len(inputs)), np.zeros(len(names)))
        slave.initialize(0.0, {OBSERVER: 1.0})
        slave.finish_initialization()
        for k in range(len(values) - 1):
            slave.inputs[:] = values[k]
            slave.write_inputs()
            slave.step(k * GRID_S, GRID_S)
            slave.read_outputs()
            found[k + 1] = slave.outputs
        return found

    def residuals(self, fmu: Path, rate_hz: float) -> ResidualFlight:
        """What an uncorrected twin leaves of the readings.

        Args:
            fmu: As of `through`.
            rate_hz: 1000 Hz over a whole number.
        """
        names = [n for n in self.aligned.airframe.input_names if n.startswith(("cmd_", "rotor_"))]
        drives = [f"{PREFIX}{REPORTED}{n}" for n in names]
        passes = self.through(fmu, [*SOURCES, *drives])
        n = len(CHANNELS)
        return residuals_in_use(
            self.flight,
            self.aligned,
            [s[:, :n] for s in passes.shown],
            [s[:, n:] for s in passes.shown],
            passes.flown,
            passes.counts,
            passes.alone,
            rate_hz,
        )

    def corrections(self, fmu: Path) -> "Corrections":
        """Every reading against what a corrected twin shows at its time."""
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
                if mode == FOLLOWING and channel.startswith(("pos", "vel")):
                    continue  # it is put there
                parts = []
                for seen, use, alone in passes.each():
                    here = use[k] & (alone[k] == (mode == ALONE))
                    last = _before(k, y, alone if mode == ALONE else None)
                    own, better = seen[k, c], seen[k, len(CHANNELS) + c]
                    seen_so = np.column_stack([own, better, last, y])
                    parts.append(seen_so[here & np.isfinite(last)])
                rows[channel, mode] = np.vstack(parts) - np.vstack(parts)[:, -1:] * [1, 1, 1, 0]
        inside = np.concatenate([s[u, -1] for s, u, _ in passes.each()])
        if not len(inside):
            raise LogError(
                f"{self.flight.name}: nowhere in the air {KNOWN_S:g} s of position, velocity, "
                f"attitude and body rates without a gap, along which the exported twin could be "
                f"used. Give a longer flight."
            )
        return Corrections(self.flight.name, rows, inside)


def _before(k: NDArray[np.intp], y: Array, alone: BoolArray | None) -> Array:
    """The reading before each; where the twin is alone, the last before that, shape (n,)."""
    row = np.arange(len(k)) - 1
    if alone is not None:
        follows = np.where(~alone, np.arange(len(alone)), -1)
        row = np.searchsorted(k, np.maximum.accumulate(follows)[k], "right") - 1
    return np.asarray(np.where(row >= 0, y[np.maximum(row, 0)], np.nan))


@dataclass(frozen=True, slots=True)
class Corrections:
    """Of one flight.

    Attributes:
        flight: Its name.
        rows: By channel and mode: twin, corrected twin and last reading less the reading, and the
            reading itself, shape (n, 4).
        inside: Whether the twin was inside the envelope, shape (m,).
    """

    flight: str
    rows: dict[tuple[str, str], Array]
    inside: Array

    __repr__ = short_repr

    def beyond_offsets(self) -> "Corrections":
        """The same without the mean error of each sensor of `OF_THE_DAY`: where that is large,
        whether a correction seems to help is decided by its sign, which is that of the day."""
        rows = {}
        for (channel, mode), found in self.rows.items():
            away = found[:, :1].mean(axis=0) if OF_THE_DAY[CHANNELS.index(channel)] else 0.0
            rows[channel, mode] = found - away * np.array([1, 1, 1, 0])
        return replace(self, rows=rows)


def record_of(flights: Sequence[Corrections], taught: str, shut: Sequence[str] = ()) -> InUseRecord:
    """Several flights together; `taught` and `shut` as of the record."""
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
    """Which of `CHANNELS` a correction does not bring closer by `BETTER`, following and alone, in
    the geometric mean over flights, or harms in one of them (`WORST`).

    Args:
        flights: None of which taught the compensator that corrected it.
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


@contextmanager
def driven_fmu(
    vehicle: Vehicle,
    drive: Drive,
    network: NetworkFile | None = None,
    law: LearnedForce | None = None,
) -> Iterator[Path]:
    """The FMU of a driven twin, for as long as it is needed.

    Args:
        vehicle: Whose twin.
        drive: As of `twin.residuals.teacher_forced.choose_drive`.
        network: Its compensator; None: without.
        law: Of what its equations lack; None: without.
    """
    with tempfile.TemporaryDirectory() as place:
        path = Path(place, "twin.fmu")
        export(twin(vehicle, drive=drive, compensator=network, force=law), path)
        yield path
