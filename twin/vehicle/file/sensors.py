"""Sensors and site of a vehicle file."""

from collections.abc import Iterator
from dataclasses import fields
from math import pi
from typing import Any

from ...errors import ModelError
from ..geomagnetism import world_field
from ..sensors import SEA_LEVEL_TEMPERATURE_K, Sensors
from .entries import Entries

SENSOR_NUMBERS = {
    f.metadata["key"]: (f.name, f.metadata["stand_in"]) for f in fields(Sensors) if f.metadata
}
"""Attribute of `Sensors` by key, and what stands in for it, in words."""
POSITION = {
    "position.period": "period_s",
    "position.delay": "delay_s",
    "position.antenna": "antenna_m",
    "position.noise": "noise_m",
    "position.walk": "walk_m",
    "position.velocity_noise": "velocity_noise_m_s",
    "position.attitude_noise": "attitude_noise_rad",
}
"""Attribute of `position.PositionErrors` by key."""
PLACE = ("site.latitude", "site.longitude")
WHEN = ("site.height", "site.year")
_HEIGHT_M, _YEAR = 0.0, 2025.5
_TEMPERATURES_K = (180.0, 340.0)


def sensor_contradictions(entries: Entries) -> Iterator[str]:
    """Mistakes about sensors and site that no entry makes by itself."""
    given, values = entries.given, entries.values
    missing = [key for key in PLACE if key not in given]
    if len(missing) == 1:
        yield f"[site] is given without {missing[0].split('.')[1]}; give both or neither."
    if "magnetometer.field" in given:
        for key in sorted(given & {*PLACE, *WHEN}):
            yield f"{key} is of no use with magnetometer.field. Leave one of them out."
    latitude = float(values.get("site.latitude", 0.0))
    if abs(latitude) > pi / 2:
        yield f"site.latitude = {latitude:g} rad is beyond a pole."
    temperature = float(values.get("site.temperature", SEA_LEVEL_TEMPERATURE_K))
    low, high = _TEMPERATURES_K
    if not low <= temperature <= high:
        yield f"site.temperature = {temperature:g} K must be from {low:g} to {high:g} K."
    if not set(PLACE) - values.keys():
        try:
            _site_field(entries)
        except ModelError as mistake:
            yield f"site.year: {mistake}"


def read_sensors(entries: Entries) -> Sensors:
    """The sensors of entries without mistakes."""
    numbers: dict[str, Any] = {}
    for key, (name, stand_in) in SENSOR_NUMBERS.items():
        value = entries.optional(key, stand_in)
        if value is not None:
            numbers[name] = value
    position: dict[str, float | tuple[float, ...]] = {}
    for key, name in POSITION.items():
        if key in entries.values:
            given = entries.values[key]
            position[name] = float(given) if given.shape == () else tuple(given.tolist())
        else:
            entries.sources[key] = "default: that of the kind of position sensor"
    if "magnetometer.field" in entries.values:
        numbers["field_n_t"] = tuple(entries.values["magnetometer.field"].tolist())
    elif PLACE[0] in entries.values:
        numbers["field_n_t"] = _site_field(entries)
        entries.sources["magnetometer.field"] = "World Magnetic Model at the site"
    else:
        entries.sources["magnetometer.field"] = "default: that of southern Germany"
        entries.sources |= dict.fromkeys(PLACE + WHEN, "default: unknown")
    return Sensors(**numbers, position=position)


def _site_field(entries: Entries) -> tuple[float, ...]:
    height_m = entries.optional("site.height", f"{_HEIGHT_M:g} m")
    year = entries.optional("site.year", f"{_YEAR:g}")
    return world_field(
        entries.number("site.latitude"),
        entries.number("site.longitude"),
        _HEIGHT_M if height_m is None else height_m,
        _YEAR if year is None else year,
    )
