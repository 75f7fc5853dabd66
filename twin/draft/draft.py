"""Draft of a vehicle file from flights of an aircraft and the knowledge of its owner.

Three kinds of numbers: given by the owner, taken from the logs, and usual ones of aircraft and
propellers of that size. The file states each with its source, and with its standard deviation where
`calibrate` and `explain` need it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from ..formatting import percent
from ..logs import Flight
from ..logs.airframe import Place
from ..logs.columns import MAX_MOTORS, MIN_MOTORS
from ..logs.stored import phases_at
from ..physics.sensors.table import SENSORS
from ..representation import ShortRepr
from ..vehicle import GRAVITY_M_S2
from ..vehicle.earth import GAS_CONSTANT_J_KG_K, LAPSE_K_M, normal_gravity_m_s2, world_field
from ..vehicle.layouts import FRAMES, Layout, frame, frames_of
from ..vehicle.vehicle import SEA_LEVEL_TEMPERATURE_K
from ..vehicle_file import parse_vehicle
from ..vehicle_file.write import Draft, with_effect_sections
from .facts import BODIES, DraftState, Fact, OwnerFacts, rounded, usual_inertia
from .hover import (
    CLEAR,
    LEAST_S,
    Hover,
    best_frame,
    common_samples,
    drives,
    hover_of,
    same_shape,
    turning,
)
from .rotors import draft_rotors, rotor_effects

Array = NDArray[np.float64]
Choice = Callable[[Flight, Array], NDArray[np.bool_]]

_LEAST = 20
"""Smallest number of samples for an estimate of noise."""
_IDLE = 0.02
"""Largest command, over its range, of stopped motors."""
_APART = 2.5
"""Time step over its median from which two samples are not neighbours."""


@dataclass(frozen=True, slots=True)
class Noise:
    """White noise of a reading.

    Attributes:
        sd: Standard deviation, in the unit of the signal.
        samples: Number of samples.
        where: Part of the flights that was used, in words.
    """

    sd: float
    samples: int
    where: str


def noise_of(flights: Sequence[Flight], hovers: Sequence[Hover], columns: Sequence[str]) -> Noise:
    """White noise of a sensor: at rest with the motors idle, else in hover with its vibration.

    From second differences of neighbouring samples: sqrt(6) times white noise, and almost nothing
    of slow signals. Median over the samples, mean over the axes.

    Returns:
        `samples` is 0 where no flight has enough of them.
    """
    rest = [_second(f, columns, _resting) for f in flights]
    air = [_second(f, columns, _within(h)) for f, h in zip(flights, hovers, strict=True)]
    for found, where in ((rest, "at rest"), (air, "in hover, vibration included")):
        values = np.concatenate(found)
        if len(values) >= _LEAST:
            sd = np.median(np.abs(values), axis=0) / 0.6745 / np.sqrt(6.0)
            if not np.all(sd > 0):  # more than half of the steps are zero
                sd = values.std(axis=0) / np.sqrt(6.0)
            return Noise(float(sd.mean()), len(values), where)
    return Noise(0.0, 0, "")


def _second(flight: Flight, columns: Sequence[str], chosen: Choice) -> Array:
    found = common_samples(flight, columns)
    if found is None or len(found[0]) < 3:
        return np.zeros((0, len(columns)))
    t_s, values = found
    step = np.diff(t_s)
    near = step < _APART * np.median(step)
    good = chosen(flight, t_s)[1:-1] & near[1:] & near[:-1]
    return np.diff(values, 2, axis=0)[good]


def _resting(flight: Flight, t_s: Array) -> NDArray[np.bool_]:
    """Whether the aircraft is on the ground, or no motor has turned yet and commands are idle."""
    ground = np.isin(phases_at(flight, t_s), ("ground", ""))
    columns = drives(flight)
    if not columns:
        return ground
    t, drive = flight.signal(columns)
    scale = 1.0 if columns[0].startswith("cmd") else float(drive.max())
    row = np.clip(np.searchsorted(t, t_s, side="right") - 1, 0, len(t) - 1)
    return np.asarray(ground & (drive.max(axis=1)[row] <= _IDLE * scale) & (t_s >= t[0]))


def _within(hover: Hover) -> Choice:
    def chosen(_: Flight, t_s: Array) -> NDArray[np.bool_]:
        row = np.clip(np.searchsorted(hover.t_s, t_s), 0, len(hover.t_s) - 1)
        return np.asarray(np.abs(hover.t_s[row] - t_s) < 0.1)

    return chosen


_BARO_SD_PA = 150.0
"""Standard deviation of a barometer's offset; by judgement."""
_FIX_SD_DEG, _HEIGHT_SD_M = 1e-4, 30.0
"""Standard deviation of a position fix, some meters; of its height, ellipsoid or sea level."""
_GRAVITY_SD_M_S2 = 5e-4
"""Standard deviation of gravity by anomalies of the real field: 50 mGal."""
_YEAR_SD = 0.01
"""Standard deviation of the date of a log in years, four days; the field of the Earth hardly
changes in that time."""
_NOISE_SD, _PARAMETER_SD, _PLACE_SD_M = 0.1, 0.01, 0.005
"""Relative standard deviation of measured noise and of set parameters; standard deviation of ruler
measurements; by judgement."""
_START_S = 2.0
"""Part at the start of a flight from which the initial pressure is taken, s."""


def draft_site(m: DraftState) -> float:
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
    """Static pressure at pos_z = 0, Pa, and its derivation in words.

    Median of the first 2 s of the barometer with a known height, each reading reduced to pos_z = 0
    by the barometer's own equation (`physics.sensors.barometer`) at 288.15 K there: over 15 m of
    height, 20 K less give 13 Pa more. Without a height the readings are not reduced.
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


def _year(m: DraftState, place: Place, source: str) -> str:
    """Add the date, where a model of the magnetic field covers it; returns it in words."""
    if place.year is None:
        return ""
    try:
        world_field(place.latitude_rad, place.longitude_rad, place.height_m, place.year)
    except ModelError as error:
        m.warnings.append(f"the date of the log is left out: {error}")
        return ""
    m.file.number("site.year", place.year, "1", source, _YEAR_SD)
    return f", year {place.year:.1f}"


def draft_sensors(m: DraftState) -> None:
    """Add noise, cut-offs and the position of the accelerometer."""
    said = []
    for sensor in SENSORS:
        unit, noise = sensor.plain_unit, noise_of(m.flights, m.hovers, sensor.columns)
        if noise.samples and noise.sd > 0:
            value = rounded(noise.sd)
            source = f"readings {noise.where}, {noise.samples} samples"
            m.file.number(sensor.noise_key, value, unit, source, percent(_NOISE_SD))
            said.append(f"{sensor.signal} {value:.3g} {unit} {noise.where}")
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


def draft_battery(m: DraftState) -> None:
    """Add the battery section where all of its keys are known, since they belong together."""
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
    )  # relative standard deviations, by judgement
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


_MASS_SD = 0.01
"""Relative standard deviation of a weighed mass, as in `twin.vehicle.vehicle.WORDS`."""
_ARM_SD = 0.03
"""Relative standard deviation of a size measured with a ruler, as in `WORDS`."""
_SIZES_APART = 0.1
"""Relative difference of the arms of log and owner from which it is reported; by judgement."""


def draft_body(m: DraftState) -> Layout:
    """Add mass, inertia, positions and directions of the rotors; returns the rotors.

    Raises:
        ModelError: Arrangement or size of the rotors is unknown.
    """
    mass = m.known.mass_kg
    m.file.number("body.mass", mass, "kg", "given, as weighed", percent(_MASS_SD))
    m.say("mass", f"{mass:.4g} kg, sd {percent(_MASS_SD)}", "given, as weighed")
    layout = _sized(m, _layout(m))
    sd = float(np.hypot(layout.sd, _ARM_SD))
    position = np.round(layout.position, 5)
    m.file.number("rotors.position", position, "m", layout.source, percent(sd))
    turns = ["cw" if d > 0 else "ccw" for d in layout.direction]
    m.file.words("rotors.direction", list(turns), layout.source)
    m.say("rotors", f"{layout.count}: {' '.join(turns)}; arm {layout.arm:.4g} m", layout.source)
    inertia, sd = usual_inertia(mass, layout.arm)
    source = (
        "estimate: mass and arm times the usual radii of gyration, geometric mean of "
        f"{len(BODIES)} published quadrotors"
    )
    values = np.array([rounded(x) for x in inertia])
    m.file.number("body.inertia", values, "kg*m^2", source, percent(sd))
    each = ", ".join(f"{x:.3g}" for x in values)
    value = f"{each} kg m2, sd {percent(sd)}"
    m.say("inertia", value, "estimate: radii of gyration as of published quadrotors")
    return layout


def _layout(m: DraftState) -> Layout:
    """Order and direction of the rotors: as given, by the log, else by how the flights turned.

    A given frame is a shape only; where every flight turned like one other frame of that shape, the
    motor numbers of that frame are used and a warning reports it.
    """
    motors, by_log = m.hovers[0].motors, m.airframe.layout
    if m.known.frame is not None:
        name = _frame_name(m.known.frame, motors)
        layout = frame(name, f"given, frame {name}")
        if (turned_like := same_shape(m.flights, name)) is not None:
            m.warnings.append(
                f"{m.flights[0].name}: its commands turn it otherwise than rotors numbered as "
                f"those of frame {name!r} would ({turning(m.flights[0], layout)}); it turns like "
                f"frame {turned_like!r} of the same shape, whose numbering is taken"
            )
            return frame(
                turned_like, f"given, frame {name}; the flights turned like {turned_like!r}"
            )
    elif by_log is not None and by_log.count == motors:
        layout = by_log
    else:
        return _as_it_turned(m, motors)
    for flight in m.flights:
        turned = turning(flight, layout)
        if turned is not None and min(turned.worst, turned.yaw) < -CLEAR:
            better = best_frame(flight, motors)
            hint = f" It turns like frame {better[0]!r} ({better[1]})." if better else ""
            m.warnings.append(
                f"{flight.name}: its commands turn it otherwise than these rotors would "
                f"({layout.source}): moment and angular acceleration correlate by {turned}.{hint}"
            )
    return layout


def _as_it_turned(m: DraftState, motors: int) -> Layout:
    """The frame by which the commands of a flight explain best how it turned."""
    found = best_frame(m.flights[0], motors)
    if found is None:
        raise ModelError(
            f"{m.flights[0].name}: the log does not say where its {motors} rotors are and how they "
            f"turn. Give the frame (--frame), one of: {', '.join(frames_of(motors)) or 'none'}."
        )
    name, turned = found
    return frame(
        name, f"frame {name}: of those with {motors} rotors it turns like this one ({turned})"
    )


def _frame_name(given: str, motors: int) -> str:
    """Full name of a frame: `x` with six rotors is `hex x`."""
    name = " ".join(given.lower().replace("-", " ").replace("_", " ").split())
    for full in (name, name.removeprefix("quad "), f"hex {name}", f"octo {name}"):
        if full in FRAMES and len(FRAMES[full][0]) == motors:
            return full
    known = ", ".join(frames_of(motors)) or "none; the log must tell it (CA_ROTOR* of PX4)"
    raise ModelError(f"frame {given!r} is none with {motors} rotors. Those are: {known}.")


def _sized(m: DraftState, layout: Layout) -> Layout:
    """The layout scaled to metres."""
    arm = m.known.arm_m
    if arm is None and not layout.metric:
        raise ModelError(
            f"{m.flights[0].name}: how its rotors are arranged is known ({layout.source}), how far "
            "apart they are is not. Give the wheelbase, the distance of two motors across "
            "(--wheelbase 480mm), or from the centre to a motor (--arm 240mm)."
        )
    if arm is None:
        return layout
    if layout.metric and abs(layout.arm / arm - 1.0) > _SIZES_APART:
        m.warnings.append(
            f"arm {arm:g} m given, {layout.arm:.3g} m by {layout.source}: that given is taken"
        )
    return layout.sized(arm, f"arm {arm:.4g} m given")


_LEVELS_APART = 1.25
"""Largest ratio of hover commands of one aircraft: battery sag changes it by a tenth."""


@dataclass(frozen=True, slots=True)
class Drafted(ShortRepr):
    """A vehicle file in draft.

    Attributes:
        text: Text of the file.
        hovers: Hover of each flight.
        level: Hover command, mean over the flights; speed, rad/s, where they have no commands.
        facts: Numbers of the file in words.
        warnings: Contradictions that were found.
    """

    text: str
    hovers: tuple[Hover, ...]
    level: float
    facts: tuple[Fact, ...]
    warnings: tuple[str, ...]


def draft(flights: Sequence[Flight], known: OwnerFacts) -> Drafted:
    """Draft of a vehicle file for the aircraft of some flights.

    Args:
        flights: Flights of one aircraft.
        known: Numbers given by its owner.

    Raises:
        ModelError: It is no multirotor, the flights are of different aircraft, one is not in the
            air for 2 s, or size or order of the rotors is unknown; the text says what to give.
    """
    _check(flights)
    file = Draft(known.name, f"Drafted from {', '.join(f.name for f in flights)}", "")
    m = DraftState(known, flights, [_hover(f) for f in flights], file)
    _notes(m)
    gravity_m_s2 = draft_site(m)
    layout = draft_body(m)
    supply = draft_rotors(m, layout, gravity_m_s2)
    draft_sensors(m)
    draft_battery(m)
    vehicle = parse_vehicle(file.text(), f"{known.name}.toml")
    text = with_effect_sections(file.text(), vehicle, rotor_effects(m, vehicle, supply))
    return Drafted(text, tuple(m.hovers), m.level, tuple(m.facts), tuple(m.warnings))


def _check(flights: Sequence[Flight]) -> None:
    """Refuse flights of vehicles that are no multirotor, or of several aircraft."""
    for flight in flights:
        if flight.airframe is not None and flight.airframe.no_multirotor:
            raise ModelError(
                f"{flight.name}: this is no multirotor: {flight.airframe.no_multirotor}. A vehicle "
                f"file describes {MIN_MOTORS} to {MAX_MOTORS} rotors that do not tilt."
            )
        if not drives(flight):
            raise ModelError(
                f"{flight.name}: has neither commands nor speeds of {MIN_MOTORS} or more rotors, "
                "so their thrust is not told. Log actuator_outputs or actuator_motors."
            )
    counts = {f.name: len(drives(f)) for f in flights}
    if len(set(counts.values())) > 1:
        reported = ", ".join(f"{name} {n}" for name, n in counts.items())
        raise ModelError(f"these are different aircraft, by their rotors: {reported}. Draft each.")


def _hover(flight: Flight) -> Hover:
    found = hover_of(flight)
    if found is None:
        raise ModelError(
            f"{flight.name}: it is in the air for less than {LEAST_S:g} s, so the thrust that "
            "carries its weight is not told. Give the log of a flight."
        )
    return found


def _notes(m: DraftState) -> None:
    """Head of the file, and doubts about flights that may not be of one aircraft."""
    m.file.notes.append(
        "A draft: what flights and owner tell, and what is usual for an aircraft of this size. "
        "`uavtwin calibrate` and `explain` believe each number as far as its sd goes."
    )
    reported = m.airframe
    if reported.pulse_us is not None:
        low, high = reported.pulse_us.value
        m.file.notes.append(
            f"Commands 0 and 1 are pulses of {low:.0f} and {high:.0f} us: "
            f"{reported.pulse_us.source}."
        )
    if reported.filters:
        m.file.notes.append(
            f"Filters on board that the logged samples have not gone through: {reported.filters}."
        )
    m.file.notes.append("No drag: `explain` finds it in a flight that goes forward.")
    levels = {h.flight: h.level for h in m.hovers}
    if max(levels.values()) > _LEVELS_APART * min(levels.values()):
        each = ", ".join(f"{name} {level:.3g}" for name, level in levels.items())
        m.warnings.append(f"the flights hover at different commands: {each}. One aircraft?")
