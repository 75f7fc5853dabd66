"""Where and when a DataFlash log was flown, by its satellites."""

from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta

import numpy as np

from ..flight import Site
from .log import ArduPilotLog, Topic

_FIX_3D = 3
_GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
_LEAP_S = 18  # since 2017
_MOST_WEEKS = 4000


@dataclass(frozen=True, slots=True)
class Fix:
    """Where and when.

    Attributes:
        latitude_deg: North.
        longitude_deg: East.
        altitude_m: Above the sea.
        day: Date, UTC.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    day: date

    def __str__(self) -> str:
        north = f"{abs(self.latitude_deg):.4f} {'N' if self.latitude_deg >= 0.0 else 'S'}"
        east = f"{abs(self.longitude_deg):.4f} {'E' if self.longitude_deg >= 0.0 else 'W'}"
        return f"{north}, {east}, {self.altitude_m:.0f} m, {self.day.isoformat()}"


def _fixes(log: ArduPilotLog) -> tuple[Topic, "np.ndarray[tuple[int], np.dtype[np.bool_]]"] | None:
    there = log.instances("GPS")
    topic = log.topic("GPS", there[0], "Status") if there else None
    return None if topic is None else (topic, topic.raw("Status") >= _FIX_3D)


def from_ardupilot_site(log: ArduPilotLog) -> Site | None:
    """A fix by satellites for at least half of the samples: outdoors; else not known."""
    found = _fixes(log)
    if found is None or found[1].mean() < 0.5:
        return None
    return Site(False, "GPS has a fix")


def fix(log: ArduPilotLog) -> Fix | None:
    """Median of the fixes, None without any."""
    found = _fixes(log)
    if found is None or not found[1].any():
        return None
    topic, fixed = found
    date = ("GWk", "GMS") if topic.has("GWk") else ("Week", "TimeMS")  # the latter up to 3.2
    if not topic.has("Lat", "Lng", "Alt", *date):
        return None
    where = [float(np.median(topic.raw(c)[fixed])) for c in ("Lat", "Lng", "Alt")]
    week, ms = (float(np.median(topic.raw(c)[fixed])) for c in date)
    if not np.isfinite((*where, week, ms)).all() or not 0.0 < week < _MOST_WEEKS:
        return None
    if abs(where[0]) > 90.0 or abs(where[1]) > 180.0 or not 0.0 <= ms < 7 * 86_400_000:
        return None
    then = _GPS_EPOCH + timedelta(weeks=week, milliseconds=ms, seconds=-_LEAP_S)
    return Fix(where[0], where[1], where[2], then.date())
