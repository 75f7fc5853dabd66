"""What `twin.explain` says about one flight of an aircraft that was calibrated on normal ones.

This module alone knows how a calibration is asked for:

    calibrate(flights, vehicle).vehicle                      the aircraft with numbers and sd
    explain([flight], [], vehicle, since=True)               what differs from it

What comes back has the content of `explain.json`. Nothing here knows where the truth is.
"""

from pathlib import Path
from typing import Any

from .files import VEHICLE, found_in

NORMAL, SINCE = "normal_*.parquet", "since_1.parquet"


def is_calibrated(folder: Path) -> bool:
    """Whether a case has normal flights and one after them."""
    return (folder / SINCE).is_file()


def ask_calibrated(folder: Path) -> dict[str, Any]:
    """Content of `explain.json` for the flight after the normal ones."""
    from twin.explain.calibration import calibrate
    from twin.explain.explanation import explain
    from twin.logs import read_flight
    from twin.vehicle.file import load_vehicle
    from uavtwin.explain_record import explain_record

    normal = [read_flight(f) for f in found_in(folder, NORMAL)]
    known = calibrate(normal, load_vehicle(str(folder / VEHICLE))).vehicle
    flight = read_flight(folder / SINCE)
    found = explain([flight], [], known, missions=(), since=True, suggest=False)
    return explain_record(found).json()
