"""Satellite fixes of a Blackbox log: place, velocity, time of day."""

import re

import numpy as np

from ..airframe import Place, Told
from ..ardupilot.motion import local_ned
from ..assemble import Rows
from ..columns import POS, VEL
from ..flight import Array, Site
from .log import BlackboxLog
from .signals import add, three

_DEGREES = 1e-7
_FEWEST_SATELLITES = 4
_DECIMETRES_SINCE = (4, 0)
_COORDINATES = ("GPS_coord[0]", "GPS_coord[1]")
_DATE = re.compile(r"(20\d\d)-(\d\d)-(\d\d)T")
"""0000-01-01 where the firmware does not know the time."""


def add_satellites(log: BlackboxLog, rows: Rows) -> Told[Place] | None:
    """Positions and velocities of the fixes into the table; where they are counted from."""
    gps = log.recording.gps
    if not gps.has(*_COORDINATES, "GPS_numSat", "GPS_altitude"):
        return None
    degrees = gps.columns(_COORDINATES) * _DEGREES
    up_m = gps.columns(("GPS_altitude",))[:, 0]
    if log.version >= _DECIMETRES_SINCE:
        up_m = 0.1 * up_m
    enough = gps.columns(("GPS_numSat",))[:, 0] >= _FEWEST_SATELLITES
    somewhere = (np.abs(degrees) <= (90.0, 180.0)).all(axis=1) & degrees.any(axis=1)
    good = enough & somewhere
    if not good.all():
        message = f"fixes left out, of fewer than {_FEWEST_SATELLITES} satellites or nowhere"
        log.note("warning", "pos", message, int(np.count_nonzero(~good)))
    if not good.any():
        return None
    t_us = gps.t_us[good]
    add(log, rows, "pos", POS, t_us, local_ned(degrees[good, 0], degrees[good, 1], up_m[good]))
    if gps.has(*three("GPS_velned")):
        add(log, rows, "vel", VEL, t_us, 0.01 * gps.columns(three("GPS_velned"))[good])
    else:
        log.note("info", "vel", "Betaflight before 4.6 does not log the velocity north, east, down")
    log.note("info", "pos", "fixes of the satellites as they came, no estimate of the autopilot")
    return Told(_place(log, degrees[good][0], float(up_m[good][0])), "GPS of the log")


def _place(log: BlackboxLog, degrees: Array, height_m: float) -> Place:
    north, east = np.radians(degrees).tolist()
    return Place(north, east, height_m, _year(log))


def _year(log: BlackboxLog) -> float | None:
    """Decimal year by the clock of the flight controller, None where it has none."""
    found = _DATE.match(log.header.settings.get("Log start datetime", ""))
    if found is None:
        return None
    year, month, day = (int(part) for part in found.groups())
    if not 1 <= month <= 12 or not 1 <= day <= 31:
        return None
    return year + (month - 1) / 12.0 + (day - 1) / 365.25


def site_of(origin: Told[Place] | None) -> Site | None:
    """Outdoors where there were fixes; else not known."""
    return None if origin is None else Site(False, "GPS has a fix")
