"""Recorded flights of aircraft that were calibrated on other flights of theirs."""

from collections.abc import Iterator
from pathlib import Path

from twin.logs import Flight, read_flight
from twin.vehicle import Vehicle
from twin.vehicle.file import load_vehicle

FLIGHTS = {
    "real_1": ("rflysimdt/real_1.ulg", "x150_without_1"),
    "real_2": ("rflysimdt/real_2.ulg", "x150_without_2"),
    "real_3": ("rflysimdt/real_3.ulg", "x150_without_3"),
    "pt1_83": ("quiver_pt1/pt1_00000083.BIN", "pt1_without_83"),
    "pt1_87": ("quiver_pt1/pt1_00000087.BIN", "pt1_without_87"),
}
"""File below the folder of the data, and vehicle file that was calibrated without it."""


def real_flights(data: Path, vehicles: Path) -> Iterator[tuple[str, Flight, Vehicle]]:
    """Those of which flight and vehicle file are there.

    Args:
        data: Folder of the data.
        vehicles: Folder of what `uavtwin calibrate` wrote.
    """
    for name, (file, vehicle) in FLIGHTS.items():
        path = vehicles / f"{vehicle}.toml"
        if path.is_file() and (data / file).is_file():
            yield name, read_flight(data / file), load_vehicle(str(path))
