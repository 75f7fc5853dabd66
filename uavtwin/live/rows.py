"""Samples as they come -> rows of a flight table in order of time."""

import heapq
import math
from collections import Counter, defaultdict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.logs.columns import in_order, motor_columns
from twin.logs.mavlink.decoder import GROUPS, LANDED, Sample, best_source
from twin.logs.mavlink.frames import dialect

HOLD_S = 0.15
"""So long rows wait for messages that were overtaken."""
PROBE_US = 1_000_000
"""From the first sample on, in which it is seen what comes of several sources."""
_SILENT_US = 5_000_000
"""After so long another source of a signal takes its place."""
_MOST_WAITING = 100_000
"""Samples that may wait: of a clock that stands still none would ever be released."""
_CRUISE_M_S = 1.0
_PHASES = {
    dialect.MAV_LANDED_STATE_ON_GROUND: "ground",
    dialect.MAV_LANDED_STATE_TAKEOFF: "takeoff",
    dialect.MAV_LANDED_STATE_LANDING: "land",
}
Columns = dict[str, NDArray[np.float64] | NDArray[np.object_]]


@dataclass(slots=True)
class RowBuffer:
    """The jitter buffer of one flight section.

    Attributes:
        hold_us: So long rows wait, us of the aircraft's clock.
        zero_us: Time on the aircraft's clock that is time 0 of the flight; None: none came yet.
        sources: Which message each signal is taken from.
        late: Samples that came after their row was gone, by signal.
        doubled: Samples of a time that was there already.
    """

    hold_us: int = round(1e6 * HOLD_S)
    zero_us: int | None = None
    sources: dict[str, str] = field(default_factory=dict)
    late: Counter[str] = field(default_factory=Counter)
    doubled: int = 0
    _heap: list[tuple[int, int, Sample]] = field(default_factory=list)
    _count: int = 0
    _first_us: int | None = None
    _newest_us: int = -(2**62)
    _released_us: int = -(2**62)
    _heard: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    _last_us: dict[str, int] = field(default_factory=dict)
    _landed: int = 0
    _speed_m_s: float = 0.0

    @property
    def waiting(self) -> int:
        """Number of samples that were not handed over yet."""
        return len(self._heap)

    def add(self, sample: Sample) -> None:
        """Take a sample."""
        if self._first_us is None:
            self._first_us = sample.t_us
        if sample.t_us <= self._released_us:
            if self.sources.get(sample.group, sample.source) == sample.source:
                self.late[sample.group] += 1
            return
        self._heard[sample.group][sample.source] += 1
        self._newest_us = max(self._newest_us, sample.t_us)
        self._count += 1
        heapq.heappush(self._heap, (sample.t_us, self._count, sample))

    def take(self, everything: bool = False) -> Columns | None:
        """Rows for which all has come that will; None: none.

        Args:
            everything: Nothing more will come.
        """
        if self._first_us is None or not self._heap:
            return None
        everything = everything or len(self._heap) > _MOST_WAITING
        if not everything and self._newest_us - self._first_us < PROBE_US:
            return None
        until = self._newest_us if everything else self._newest_us - self.hold_us
        if self._heap[0][0] > until:
            return None
        for group, counts in self._heard.items():
            if group not in self.sources:
                self.sources[group] = best_source(counts)
        portion = _Portion()
        while self._heap and self._heap[0][0] <= until:
            sample = heapq.heappop(self._heap)[2]
            if not self._counts(sample):
                continue
            if sample.group == LANDED:
                self._landed = int(sample.values[0])
                continue
            if not portion.add(sample):
                self.doubled += 1
                continue
            if sample.group == "vel":
                self._speed_m_s = math.hypot(*sample.values[:2])
            portion.phases[-1] = self._phase()
        self._released_us = max(self._released_us, until)
        if not portion.t_us:
            return None
        if self.zero_us is None:  # a whole second, so that a grid is that of the aircraft's clock
            self.zero_us = portion.t_us[0] // 1_000_000 * 1_000_000
        return portion.columns(self.zero_us)

    def _counts(self, sample: Sample) -> bool:
        """Whether a sample is of the source that its signal is taken from."""
        chosen, last = self.sources[sample.group], self._last_us.get(sample.group)
        if sample.source != chosen:
            if last is None or sample.t_us - last < _SILENT_US:
                return False
            self.sources[sample.group] = sample.source
        self._last_us[sample.group] = sample.t_us
        return True

    def _phase(self) -> str:
        """Phase of flight: of the land detector, in the air by speed."""
        if not self._landed:
            return ""
        cruising = "forward" if self._speed_m_s > _CRUISE_M_S else "hover"
        return _PHASES.get(self._landed, cruising)


class _Portion:
    """Rows that are handed over together, in order of time.

    Attributes:
        t_us: Their times, us.
        phases: Their phases of flight.
    """

    def __init__(self) -> None:
        self.t_us: list[int] = []
        self.phases: list[str] = []
        self._signals: dict[tuple[str, int], tuple[list[int], list[tuple[float, ...]]]] = {}

    def add(self, sample: Sample) -> bool:
        """Take a sample, not older than those before; returns whether its place was free."""
        if not self.t_us or self.t_us[-1] != sample.t_us:
            self.t_us.append(sample.t_us)
            self.phases.append("")
        row, key = len(self.t_us) - 1, (sample.group, len(sample.values))
        rows, values = self._signals.setdefault(key, ([], []))
        if rows and rows[-1] == row:
            return False
        rows.append(row)
        values.append(sample.values)
        return True

    def columns(self, zero_us: int) -> Columns:
        """Rows by column, NaN where there is no sample."""
        found: Columns = {}
        for (group, width), (rows, values) in self._signals.items():
            signal = np.array(values, dtype=np.float64)
            for k, name in enumerate(GROUPS.get(group) or motor_columns(group, width)):
                column = found.setdefault(name, np.full(len(self.t_us), np.nan))
                column[rows] = signal[:, k]
        since_us = np.array(self.t_us, dtype=np.int64) - zero_us
        found["time"] = np.asarray(since_us * 1e-6, dtype=np.float64)
        found["phase"] = np.array(self.phases, dtype=object)
        return {name: found[name] for name in in_order(found)}
