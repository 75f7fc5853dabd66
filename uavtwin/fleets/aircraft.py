"""Of which aircraft a log is, by what it says itself."""

import re

from twin.logs import AnyFlight
from twin.logs.airframe import Told

from ..flights import aircraft_told


def aircraft_name(flight: AnyFlight) -> str:
    """Name of the aircraft: the identifier of its autopilot and its airframe, as two flights of one
    call are held to be of one aircraft; "" where the log holds no identifier.
    """
    aircraft, airframe, hardware = aircraft_told(flight)
    own = aircraft or hardware
    return ", ".join(t for t in (own.removeprefix("autopilot "), airframe) if t) if own else ""


def file_stem(aircraft: str) -> str:
    """Of the file of an aircraft: letters, digits, `_`, `-` and `.` alone, no `.` in front."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", aircraft).strip("._") or "aircraft"


def date_of(flight: AnyFlight) -> float | None:
    """Decimal year of a flight; None: its log has no date."""
    place = None if flight.airframe is None else flight.airframe.place
    return place.value.year if isinstance(place, Told) else None
