"""Site, sensors and battery, for a draft."""

import numpy as np

from ..errors import ModelError
from ..logs import Flight
from ..logs.airframe import Place
from ..physics.atmosphere import GAS_CONSTANT_J_KG_K, LAPSE_K_M
from ..vehicle import GRAVITY_M_S2
from ..vehicle.geomagnetism import world_field
from ..vehicle.gravity import normal_gravity_m_s2
from ..vehicle.sensors import SEA_LEVEL_TEMPERATURE_K
from .making import Making, percent, rounded
from .noise import SENSORS, noise_of

_BARO_SD_PA = 150.0
"""Offset of a barometer; by judgement."""
_FIX_SD_DEG, _HEIGHT_SD_M = 1e-4, 30.0
"""Of a fix: meters; of its height, ellipsoid or sea."""
_GRAVITY_SD_M_S2 = 5e-4
"""Anomalies of the real field: 50 mGal."""
_YEAR_SD = 0.01
_NOISE_SD, _PARAMETER_SD, _PLACE_SD_M = 0.1, 0.01, 0.005
"""Of what readings, set parameters and rulers say; by judgement."""
_START_S = 2.0


def draft_site(m: Making) -> float:
    """Add place, date, gravity and pressure; returns the gravity, m/s2."""
    gravity, found = GRAVITY_M_S2, m.airframe.place
    if found is not None:
        place, source = found
        latitude, longitude = np.degrees([place.latitude_rad, place.longitude_rad])
        gravity = round(normal_gravity_m_s2(place.latitude_rad, place.height_m), 5)
        m.file.number("site.latitude", round(float(latitude), 5), "deg", source, _FIX_SD_DEG)
        m.file.number("site.longitude", round(float(longitude), 5), "deg", source, _FIX_SD_DEG)
        m.file.number("site.height", round(place.height_m, 1), "m", source, _HEIGHT_SD_M)
        normal = f"WGS 84 normal gravity at {source}"
        m.file.number("site.gravity", gravity, "m/s^2", normal, _GRAVITY_SD_M_S2)
        when = _year(m, place, source)
        value = f"{latitude:.4f}, {longitude:.4f} deg, {place.height_m:.0f} m{when}"
        m.say("site", f"{value}; gravity {gravity:.4f} m/s2", source)
    with_baro = [f for f in m.flights if f.has("baro_pa")]
    with_baro.sort(key=lambda f: not f.has("pos_z"))
    if with_baro:
        value_pa, where = pressure_at_origin(with_baro[0])
        source = f"barometer of {with_baro[0].name}, {where}"
        m.file.number("site.pressure", round(value_pa, 1), "Pa", source, _BARO_SD_PA)
        m.say("pressure", f"{value_pa:.0f} Pa at pos_z = 0", source)
    return gravity


def pressure_at_origin(flight: Flight) -> tuple[float, str]:
    """Static pressure at pos_z = 0, Pa, and how it was found.

    Median of the first 2 s of the barometer in which the height is known, each reading reduced to
    pos_z = 0 by the barometer's own equation (`physics.sensors.barometer`) at 288.15 K there: over
    15 m of height, 20 K less are 13 Pa more. Without a height the readings are taken as they are.
    """
    t_s, pressure = flight.signal(("baro_pa",))
    read = pressure[:, 0]
    if flight.has("pos_z"):
        t_pos, down = flight.signal(("pos_z",))
        known = (t_s >= t_pos[0]) & (t_s <= t_pos[-1])
        if known.any():
            first = known & (t_s < t_s[known][0] + _START_S)
            height_m = 0.0 - np.interp(t_s[first], t_pos, down[:, 0])
            ratio = 1.0 - LAPSE_K_M * height_m / SEA_LEVEL_TEMPERATURE_K
            power = GRAVITY_M_S2 / (GAS_CONSTANT_J_KG_K * LAPSE_K_M)
            reduced = float(np.median(read[first] / ratio**power))
            return reduced, (
                f"first {_START_S:g} s, {float(np.median(height_m)):.1f} m above pos_z = 0, "
                "reduced to it"
            )
    start = read[t_s < t_s[0] + _START_S]
    return float(np.median(start)), f"first {_START_S:g} s, whose height is not known"


def _year(m: Making, place: Place, source: str) -> str:
    """Add the date, where a model of the magnetic field covers it; in words."""
    if place.year is None:
        return ""
    try:
        world_field(place.latitude_rad, place.longitude_rad, place.height_m, place.year)
    except ModelError as error:
        m.warnings.append(f"the date of the log is left out: {error}")
        return ""
    m.file.number("site.year", place.year, "1", source, _YEAR_SD)
    return f", year {place.year:.1f}"


def draft_sensors(m: Making) -> None:
    """Add noise, cutoffs and the place of the accelerometer."""
    said = []
    for key, (columns, unit) in SENSORS.items():
        noise = noise_of(m.flights, m.hovers, columns)
        if noise.samples and noise.sd > 0:
            value = rounded(noise.sd)
            source = f"readings {noise.where}, {noise.samples} samples"
            m.file.number(key, value, unit, source, percent(_NOISE_SD))
            said.append(f"{columns[0].partition('_')[0]} {value:.3g} {unit} {noise.where}")
    if said:
        m.say("noise", "; ".join(said), "readings of the flights")
    reported = m.airframe
    for key, cutoff in (
        ("imu.accel_cutoff", reported.accel_cutoff_hz),
        ("imu.gyro_cutoff", reported.gyro_cutoff_hz),
    ):
        if cutoff is not None:
            m.file.number(key, cutoff.value, "Hz", cutoff.source, percent(_PARAMETER_SD))
            m.say(key.replace("imu.", "").replace("_", " "), f"{cutoff.value:g} Hz", cutoff.source)
    if reported.imu_position_m is not None:
        place, source = reported.imu_position_m
        m.file.number("imu.position", np.array(place), "m", source, _PLACE_SD_M)
        m.say("accelerometer", f"at {', '.join(f'{x:g}' for x in place)} m", source)


def draft_battery(m: Making) -> None:
    """Add the section where all of it is known, since its keys belong together."""
    if m.airframe.cells is None:
        return
    cells, source = m.airframe.cells
    full, empty = cells.count * cells.full_v, cells.count * cells.empty_v
    value = f"{cells.count} cells, {empty:.1f} to {full:.1f} V"
    currents = [float(np.median(f.signal(("ibat_a",))[1])) for f in m.flights if f.has("ibat_a")]
    entries = (
        ("full_voltage", full, "V", 0.03),
        ("empty_voltage", empty, "V", 0.05),
        ("capacity", cells.capacity_a_s, "A*s", 0.1),
        ("resistance", cells.resistance_ohm, "ohm", 0.3),
        ("hover_current", currents[0] if currents else None, "A", 0.1),
    )  # standard deviations over the values, by judgement
    lacking = [key.replace("_", " ") for key, number, _, _ in entries if not number]
    if lacking:
        m.say(
            "battery",
            f"{value}; no [battery] section: the log does not tell {', '.join(lacking)}",
            source,
        )
        m.file.notes.append(f"No [battery]: {value}, but {', '.join(lacking)} are not in the log.")
        return
    for key, number, unit, sd in entries:
        assert number is not None
        m.file.number(f"battery.{key}", rounded(number), unit, source, percent(sd))
    m.say("battery", value, source)
