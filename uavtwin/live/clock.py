"""The aircraft's clock on ours: offset and drift, of when messages came and what they say.

A message that says t left at t and came later: our time less t is the offset and the delay. The
lowest of many, a line beneath all of them, is the offset and the shortest delay. Where TIMESYNC is
answered, our time of asking less t bounds the offset from below: the middle of both lines is the
offset, as far as the shortest delays there and back are alike.
"""

import math
from dataclasses import dataclass, field

Point = tuple[float, float]
MEMORY_S = 60.0
"""Older points are forgotten: clocks drift with temperature."""
_BIN_S = 0.5
"""Of so long the lowest point is kept."""
_LONG_ENOUGH_S = 5.0
"""A shorter time says nothing of the drift."""


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """What is known of the aircraft's clock.

    Attributes:
        aircraft_s: Newest time of the aircraft, at which the offset holds, s.
        offset_s: Our time less the aircraft's, s.
        drift_ppm: By how much the aircraft's clock is faster; NaN: not known yet.
        source: `TIMESYNC`, or `arrivals`: the offset holds the shortest delay of the link as well.
        width_s: Between the bounds from above and below; infinite without TIMESYNC.
    """

    aircraft_s: float
    offset_s: float
    drift_ppm: float
    source: str
    width_s: float


@dataclass(slots=True)
class ClockWatch:
    """Takes times in and tells what the clock is."""

    _above: dict[int, Point] = field(default_factory=dict)
    _below: dict[int, Point] = field(default_factory=dict)
    _now_s: float = -math.inf

    def came(self, aircraft_s: float, at_s: float) -> None:
        """A message that says a time of the aircraft came at a time of ours, s."""
        self._now_s = max(self._now_s, aircraft_s)
        _keep_lowest(self._above, aircraft_s, at_s - aircraft_s)

    def answered(self, request_s: float, aircraft_s: float, at_s: float) -> None:
        """TIMESYNC: asked and answered at times of ours, what the aircraft's clock was between."""
        self.came(aircraft_s, at_s)
        _keep_lowest(self._below, aircraft_s, -(request_s - aircraft_s))

    def estimate(self) -> ClockEstimate | None:
        """What is known now; None: no message has come."""
        self._forget()
        above = _line(list(self._above.values()))
        if above is None:
            return None
        now, slope = self._now_s, above[1]
        high = _at(above, now)
        if not self._below:
            return ClockEstimate(now, high, _ppm(slope), "arrivals", math.inf)
        # Answers are few: their line has the slope of the other one.
        level = 0.0 if math.isnan(slope) else slope
        least = max(-y + level * (now - x) for x, y in self._below.values())
        return ClockEstimate(
            now, (high + least) / 2, _ppm(slope), "TIMESYNC", max(high - least, 0.0)
        )

    def _forget(self) -> None:
        oldest = math.floor((self._now_s - MEMORY_S) / _BIN_S) if math.isfinite(self._now_s) else 0
        for points in (self._above, self._below):
            for key in [k for k in points if k < oldest]:
                del points[key]


def _keep_lowest(points: dict[int, Point], x: float, y: float) -> None:
    key = math.floor(x / _BIN_S)
    if key not in points or y < points[key][1]:
        points[key] = (x, y)


def _at(line: tuple[float, float], x: float) -> float:
    return line[0] + (0.0 if math.isnan(line[1]) else line[1] * x)


def _ppm(slope: float) -> float:
    """The offset falls by as much as the aircraft's clock is faster."""
    return -1e6 * slope / (1.0 + slope)


def _line(points: list[Point]) -> tuple[float, float] | None:
    """The line beneath all points that is nearest to them: value at 0, and slope.

    It is the edge of their lower convex hull over their middle. Over a short time it is level.
    """
    if not points:
        return None
    points = sorted(points)
    if points[-1][0] - points[0][0] < _LONG_ENOUGH_S:
        return min(y for _, y in points), math.nan
    hull: list[Point] = []
    for p in points:
        while len(hull) > 1 and _turns_right(hull[-2], hull[-1], p):
            hull.pop()
        hull.append(p)
    middle = sum(x for x, _ in points) / len(points)
    k = next(i for i in range(1, len(hull)) if hull[i][0] >= middle)
    (x0, y0), (x1, y1) = hull[k - 1], hull[k]
    slope = (y1 - y0) / (x1 - x0)
    return y0 - slope * x0, slope


def _turns_right(a: Point, b: Point, c: Point) -> bool:
    """Whether b lies on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
