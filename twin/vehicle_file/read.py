"""Vehicle files: TOML to `Vehicle`; an error names the file and every invalid key and value.

`docs/guide/vehicle.md` describes the format for users; `FIELDS` is its one definition.

Sections in order: body, rotors (maps, lags, aerodynamics), sensors and site, then the effects that
`[effects.NAME]` switches on.
"""

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from importlib import resources
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from ..component import unknown_name
from ..effects import EFFECTS
from ..errors import ModelError
from ..vehicle import GRAVITY_M_S2, Advance, Battery, Deviation, RotorAir, Rotors, RunUp, Vehicle
from ..vehicle.earth import world_field
from ..vehicle.vehicle import SEA_LEVEL_TEMPERATURE_K, Sensors, most_thrust_n
from .calibration import SECTION, read_calibration
from .entries import Entries, read_entries, read_number
from .fields import FIELDS

_THRUST = ("rotors.thrust_from_speed", "rotors.thrust_from_command")  # exactly one of them
_RATES = ("rotors.rate_up", "rotors.rate_down")  # both or none
_ADVANCE = ("rotors.thrust_by_advance", "rotors.torque_by_advance")  # tables over the advance ratio
_NEED_SPEED = tuple(
    f"rotors.{name}"
    for name in (
        "spin_inertia",
        "reaction_inertia",
        "drag",
        "inflow",
        "flapping_moment",
        "rolling_moment",
        "rate_up",
        "rate_down",
        "thrust_by_advance",
        "torque_by_advance",
    )
)  # keys that need the speed of the rotors


def rotor_contradictions(entries: Entries) -> Iterator[str]:
    """Mistakes about rotors that involve several entries."""
    given, values = entries.given, entries.values
    yield from _one_of("thrust", *_THRUST, given)
    if len(given & set(_THRUST)) == 1:
        yield from _against_thrust(entries)
    direction, position = values.get("rotors.direction"), values.get("rotors.position")
    if direction is not None and position is not None and len(direction) != len(position):
        yield (f"rotors.direction has {len(direction)} entries, rotors.position {len(position)}.")
    if len(given & set(_RATES)) == 1:
        yield "rotors.rate_up and rotors.rate_down belong together: give both of them."
    if given & set(_RATES) and "rotors.lag" in given:
        yield "rotors.lag and rotors.rate_up say the same thing in two ways: give one of them."
    if given & set(_ADVANCE) and "rotors.diameter" not in given:
        yield f"{min(given & set(_ADVANCE))} needs rotors.diameter, for the advance ratio."


def _against_thrust(entries: Entries) -> Iterator[str]:
    """Entries that contradict the argument of the thrust map."""
    of_speed = "rotors.thrust_from_speed" in entries.given
    by, other = ("speed", "command") if of_speed else ("command", "speed")
    yield from _one_of(
        "reaction torque", "rotors.torque_per_thrust", f"rotors.torque_from_{by}", entries.given
    )
    useless = {f"rotors.torque_from_{other}"}
    if not of_speed:
        useless.add("rotors.speed_from_command")
        for key in (k for k in _NEED_SPEED if np.any(entries.values.get(k, 0.0))):
            yield (
                f"{key} needs the rotor speed: give thrust_from_speed "
                f"(and speed_from_command for a vehicle driven by commands)."
            )
    for key in sorted(useless & entries.given):
        yield (
            f"{key} is of no use with thrust_from_{by}. Leave it out, or give "
            f"thrust_from_{other} instead."
        )


def _one_of(what: str, first: str, second: str, given: set[str]) -> Iterator[str]:
    found = [key for key in (first, second) if key in given]
    if len(found) != 1:
        state = f"{first} and {second} are given" if found else "none is given"
        yield f"{what} needs exactly one of {first}, {second}; {state}."


def rotor_doubts(entries: Entries) -> Iterator[str]:
    """Implausible rotor numbers that are not refused."""
    given = entries.given
    if "rotors.voltage_exponent" in given and "rotors.reference_voltage" not in given:
        yield "rotors.voltage_exponent counts only with rotors.reference_voltage."
    for key in (k for k in _ADVANCE if k in given):
        at_rest = float(np.interp(0.0, *entries.values[key].T))
        if abs(at_rest - 1) > 1e-6:
            yield f"{key} is {at_rest:g} at rest, where the maps hold and it should be 1."
    if "rotors.diameter" in given and not given & set(_ADVANCE):
        yield "rotors.diameter counts only with thrust_by_advance or torque_by_advance."
    by_command = "rotors.speed_from_command" in given and not given & {"rotors.lag", *_RATES}
    if "rotors.reaction_inertia" in given and by_command:
        yield (
            "rotors.reaction_inertia counts only with measured rotor speeds: by commands and "
            "without lag the rotors have no acceleration."
        )
    of_command = {"rotors.thrust_from_command", "rotors.speed_from_command"}
    if "rotors.command_range" in given and not of_command & given:
        yield "rotors.command_range counts only with a polynomial of the command."


def rotors_too_weak(vehicle: Vehicle) -> Iterator[str]:
    """Text where the rotors cannot carry the weight at full command."""
    rotors = vehicle.rotors
    if vehicle.drive == "rotor_speed":
        return
    most = most_thrust_n(vehicle)
    if most < vehicle.hover_thrust_n:
        yield (
            f"cannot hover: {rotors.count} rotors give at most {most * rotors.count:.4g} N, "
            f"the weight is {vehicle.hover_thrust_n * rotors.count:.4g} N. Check the thrust "
            f"map, its unit and rotors.command_range."
        )


def read_rotors(entries: Entries) -> Rotors:
    """The rotors of valid entries."""
    from_speed = "rotors.thrust_from_speed" in entries.given
    thrust = _map(entries, f"rotors.thrust_from_{'speed' if from_speed else 'command'}")
    if "rotors.torque_per_thrust" in entries.given:
        ratio = entries.number("rotors.torque_per_thrust")
        torque = tuple(ratio * c for c in thrust)
    else:
        torque = _map(entries, f"rotors.torque_from_{'speed' if from_speed else 'command'}")
    by_command = "rotors.speed_from_command" in entries.given
    spin = entries.optional("rotors.spin_inertia", "0, no gyroscopic torque")
    reaction = entries.optional("rotors.reaction_inertia", "0, no reaction to acceleration")
    reference = entries.optional("rotors.reference_voltage", "voltage is ignored")
    exponent = entries.optional("rotors.voltage_exponent", "1")
    lag_up, lag_down = entries.vector("rotors.lag", "no lag", (0.0, 0.0))
    return Rotors(
        position_m=entries.values["rotors.position"],
        direction=entries.values["rotors.direction"],
        from_speed=from_speed,
        thrust_n=thrust,
        torque_n_m=torque,
        speed_rad_s=_map(entries, "rotors.speed_from_command") if by_command else None,
        lag_up_s=float(lag_up),
        lag_down_s=float(lag_down),
        spin_inertia_kg_m2=spin or 0.0,
        reference_voltage_v=reference,
        voltage_exponent=1.0 if exponent is None else exponent,
        run_up=_run_up(entries),
        reaction_inertia_kg_m2=reaction or 0.0,
        air=_rotor_air(entries),
        advance=_advance(entries),
    )


def _advance(entries: Entries) -> Advance | None:
    diameter = entries.optional("rotors.diameter", "of no use")
    thrust, torque = (
        tuple((float(j), float(f)) for j, f in entries.vector(key, "as at rest", ()))
        for key in _ADVANCE
    )
    return Advance(diameter, thrust, torque) if diameter and (thrust or torque) else None


def _run_up(entries: Entries) -> tuple[RunUp, RunUp] | None:
    up, down = (entries.vector(key, "by the lag", ()) for key in _RATES)
    return (RunUp(*up.tolist()), RunUp(*down.tolist())) if len(up) else None


def _rotor_air(entries: Entries) -> RotorAir:
    names = ("drag", "inflow", "lift", "flapping_moment", "rolling_moment")
    return RotorAir(*(entries.optional(f"rotors.{name}", "0, none") or 0.0 for name in names))


def _map(entries: Entries, key: str) -> tuple[float, ...]:
    """Ascending coefficients: of the speed in rad/s as in the file, or of the command 0..1."""
    given = entries.values[key]
    coefficients = given
    if key.endswith("from_command"):
        low, high = entries.vector("rotors.command_range", "commands are 0..1", (0.0, 1.0))
        shifted = Polynomial(given)(Polynomial([low, high - low])).coef
        coefficients = np.zeros(len(given))
        coefficients[: len(shifted)] = shifted
    return tuple(float(c) for c in coefficients)


SENSOR_NUMBERS = {
    f.metadata["key"]: (f.name, f.metadata["stand_in"]) for f in fields(Sensors) if f.metadata
}
"""Attribute of `Sensors` by key, and its default in words."""
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
PLACE = ("site.latitude", "site.longitude")  # determine the magnetic field and gravity
WHEN = ("site.height", "site.year")  # refine field and gravity
_HEIGHT_M, _YEAR = 0.0, 2025.5
"""Height, m, and year for a place without them."""
_TEMPERATURES_K = (180.0, 340.0)
"""Bounds of the air temperature at the ground, K: beyond any measured (184 K, 330 K; WMO)."""


def sensor_contradictions(entries: Entries) -> Iterator[str]:
    """Mistakes about sensors and site that involve several entries."""
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
    """The sensors of valid entries."""
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


@dataclass(slots=True)
class ActiveEffects:
    """Effects of a vehicle file.

    Attributes:
        values: Every number of each effect in SI units; omitted ones at their start value.
        sources: Source by "effects.NAME.PARAMETER".
        deviations: Standard deviations by "effects.NAME.PARAMETER", where given.
        mistakes: Mistakes, one line each.
    """

    values: dict[str, dict[str, float]] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    deviations: dict[str, Deviation] = field(default_factory=dict)
    mistakes: list[str] = field(default_factory=list)


def read_effects(sections: Any, vehicle: Vehicle) -> ActiveEffects:
    """Read the sections, given as parsed TOML, of a vehicle's file."""
    on = ActiveEffects()
    if not isinstance(sections, dict):
        on.mistakes.append("[effects] must hold one table per effect, [effects.NAME].")
        return on
    for name, table in sections.items():
        if name not in EFFECTS:
            on.mistakes.append(unknown_name("[effects]", "effect", name, EFFECTS))
        elif not EFFECTS[name].of_vehicle:
            on.mistakes.append(
                f"[effects.{name}] is of a record, not of the aircraft: {EFFECTS[name].meaning}. "
                f"Take the section out; `explain` and `calibrate` find it in each flight."
            )
        elif not isinstance(table, dict):
            on.mistakes.append(f"[effects.{name}] must be a table of its numbers.")
        else:
            _read_effect(name, table, vehicle, on)
    return on


def _read_effect(name: str, table: dict[str, Any], vehicle: Vehicle, on: ActiveEffects) -> None:
    values = EFFECTS[name].starts(vehicle)
    units = {n: p.unit for p in EFFECTS[name].parameters for n in p.names(vehicle)}
    for key, entry in table.items():
        full = f"effects.{name}.{key}"
        if key not in values:
            on.mistakes.append(unknown_name(f"[effects.{name}]", "number", key, values))
            continue
        try:
            values[key], deviation = read_number(full, entry, spelled(units[key]))
            if deviation is not None:
                on.deviations[full] = deviation
            on.sources[full] = entry["source"]
        except ModelError as mistake:
            on.mistakes.append(str(mistake))
    for key in values.keys() - table.keys():
        on.sources[f"effects.{name}.{key}"] = "default: of the effect library"
    on.values[name] = values


def spelled(fmi_unit: str) -> str:
    """An FMI unit (`kg.m2`) as written in vehicle files (`kg*m^2`)."""
    return re.sub(r"(?<=[A-Za-z])(\d)", r"^\1", fmi_unit).replace(".", "*")


_ROUNDING = 1e-9
"""Relative tolerance for the moments of inertia of a flat plate."""
_MOST_BYTES = 2**20
"""Largest vehicle file that is read. Made up."""
_MOST_PARTS = 32  # of a key with dots; keys of this format have four
_STRING = re.compile(r"\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'")  # text of one line in TOML
_BETWEEN = re.compile(r"[\s=,#\[\]{}]")
_BATTERY = tuple(key for key in FIELDS if key.startswith("battery."))  # all or none


def builtin_vehicles() -> tuple[str, ...]:
    """Names of the built-in vehicle files."""
    folder = resources.files("twin.vehicle") / "built_in"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir()))


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Read a vehicle file, or a built-in vehicle by its name.

    Raises:
        ModelError: No such vehicle, or an invalid file; the text names file, key and value.
    """
    return parse_vehicle(*vehicle_text(name_or_path))


def vehicle_text(name_or_path: str | Path) -> tuple[str, str]:
    """Text and name of a vehicle file, or of a built-in vehicle by its name.

    Raises:
        ModelError: No such vehicle, or the file cannot be read.
    """
    name = str(name_or_path)
    if name in builtin_vehicles():
        file = resources.files("twin.vehicle") / "built_in" / f"{name}.toml"
        return file.read_text("utf-8"), f"{name}.toml"
    path = Path(name_or_path)
    if not path.is_file():
        near = get_close_matches(name, builtin_vehicles(), n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ModelError(
            f"{name}: neither a vehicle file nor a built-in vehicle.{hint} "
            f"Built in: {', '.join(builtin_vehicles())}; the format is in docs/guide/vehicle.md."
        )
    try:
        if (size := path.stat().st_size) > _MOST_BYTES:
            raise ModelError(
                f"{path.name}: {size} bytes, a vehicle file has at most {_MOST_BYTES}."
            )
        return path.read_text("utf-8"), path.name
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path.name}: cannot be read as text: {error}.") from error


def toml_tree(text: str, file: str) -> dict[str, Any]:
    """Tables of a TOML file; `file` names it in errors.

    Raises:
        ModelError: The text is no TOML, is nested too deeply or has a number with too many digits.
    """
    if (parts := _longest_key(text)) > _MOST_PARTS:
        raise ModelError(f"{file}: a key has {parts} parts, at most {_MOST_PARTS} are read.")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError
        raise ModelError(f"{file}: not valid TOML: {error}.") from error


def _longest_key(text: str) -> int:
    """Parts of the longest dotted key: the memory of `tomllib` grows with their square."""
    longest = run = 0
    for part in _STRING.sub("s", text).split("."):
        run = 0 if _BETWEEN.search(part.strip(" \t")) else run + 1
        longest = max(longest, run)
    return longest


def parse_vehicle(text: str, file: str) -> Vehicle:
    """Build a vehicle from the text of a vehicle file; `file` names it in errors."""
    tree = toml_tree(text, file)
    effects, calibration = tree.pop("effects", {}), tree.pop(SECTION, None)
    entries = read_entries(tree)
    _refuse(file, [*entries.mistakes, *_contradictions(entries)])
    vehicle = _vehicle(entries, default_name=Path(file).stem)
    _refuse(file, list(rotors_too_weak(vehicle)))
    switched_on = read_effects(effects, vehicle)
    known = None
    if calibration is not None:
        known = read_calibration(calibration, vehicle, switched_on.mistakes)
    _refuse(file, switched_on.mistakes)
    return replace(
        vehicle,
        calibration=known,
        effects=switched_on.values,
        sources={**vehicle.sources, **switched_on.sources},
        deviations={**vehicle.deviations, **switched_on.deviations},
        file=file,
    )


def _refuse(file: str, mistakes: list[str]) -> None:
    """Raise one error with all mistakes, if there are any."""
    if len(mistakes) == 1:
        raise ModelError(f"{file}: {mistakes[0]}")
    if mistakes:
        raise ModelError(f"{file}: {len(mistakes)} mistakes:\n  " + "\n  ".join(mistakes))


# -- entries against each other ---------------------------------------------------------------


def _contradictions(entries: Entries) -> Iterator[str]:
    """Mistakes that involve several entries."""
    given, values = entries.given, entries.values
    yield from rotor_contradictions(entries)
    missing = [key.split(".")[1] for key in _BATTERY if key not in given]
    if 0 < len(missing) < len(_BATTERY):
        yield (
            f"[battery] is given without {', '.join(missing)}. Its keys belong together: give "
            f"all of them or none."
        )
    full, empty = values.get("battery.full_voltage"), values.get("battery.empty_voltage")
    if full is not None and empty is not None and empty >= full:
        yield (
            f"battery.empty_voltage = {empty:g} V must be below battery.full_voltage = {full:g} V."
        )
    yield from sensor_contradictions(entries)


def _doubts(entries: Entries) -> Iterator[str]:
    """Implausible values that are not refused."""
    small, middle, large = np.linalg.eigvalsh(entries.values["body.inertia"])
    if small + middle < (1 - _ROUNDING) * large:
        yield (
            f"body.inertia: the principal moments {small:.4g} and {middle:.4g} kg*m^2 add up to "
            f"less than the third, {large:.4g}; no real body has that. Check the order [Ixx, Iyy, "
            f"Izz], the powers of ten, and which of them was estimated."
        )
    yield from rotor_doubts(entries)


# -- vehicle ----------------------------------------------------------------------------------


def _vehicle(entries: Entries, default_name: str) -> Vehicle:
    """The vehicle of valid entries."""
    rotors = read_rotors(entries)
    arm_m = float(np.linalg.norm(rotors.position_m[:, :2], axis=1).max())
    leg_m = entries.optional("body.leg_height", f"half the largest rotor arm, {arm_m / 2:g} m")
    zero = (0.0, 0.0, 0.0)
    gravity = entries.optional("site.gravity", f"{GRAVITY_M_S2} m/s^2, standard gravity")
    return Vehicle(
        name=entries.texts.get("name", default_name),
        description=entries.texts.get("description", ""),
        mass_kg=entries.number("body.mass"),
        inertia_kg_m2=entries.values["body.inertia"],
        drag_linear_n_s_m=entries.vector("body.drag_linear", "zero", zero),
        drag_quadratic_n_s2_m2=entries.vector("body.drag_quadratic", "zero", zero),
        leg_height_m=arm_m / 2 if leg_m is None else leg_m,
        rotors=rotors,
        imu_position_m=entries.vector("imu.position", "zero", zero),
        accel_cutoff_hz=entries.optional("imu.accel_cutoff", "no low-pass"),
        gyro_cutoff_hz=entries.optional("imu.gyro_cutoff", "no low-pass"),
        battery=_battery(entries),
        sensors=read_sensors(entries),
        drag_parasitic_n_s2_m2=entries.vector("body.drag_parasitic", "zero", zero),
        drag_angular_n_m_s2=entries.vector("body.drag_angular", "zero", zero),
        gravity_m_s2=GRAVITY_M_S2 if gravity is None else gravity,
        sources=entries.sources,
        deviations=entries.deviations,
        doubts=tuple(_doubts(entries)),
    )


def _battery(entries: Entries) -> Battery | None:
    if _BATTERY[0] not in entries.given:
        return None
    full, empty, capacity, resistance, current = (entries.number(key) for key in _BATTERY)
    return Battery(full, empty, capacity, resistance, current)
