"""Vehicle files: TOML to `Vehicle`; a refusal names the file and every key and value at fault.

`docs/guide/vehicle.md` describes the format for people; `FIELDS` is its one definition.
"""

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from difflib import get_close_matches
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.polynomial import polyval

from ...errors import ModelError
from .. import GRAVITY_M_S2, Battery, Rotors, Vehicle
from .effects import read_effects
from .entries import Entries, read_entries
from .fields import FIELDS
from .sensors import read_sensors, sensor_contradictions

_THRUST = ("rotors.thrust_from_speed", "rotors.thrust_from_command")
_BATTERY = tuple(key for key in FIELDS if key.startswith("battery."))


def builtin_vehicles() -> tuple[str, ...]:
    """Names of the vehicle files that ship with the program."""
    folder = resources.files("twin.vehicle") / "built_in"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir()))


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Read a vehicle file, or a built-in vehicle by its name.

    Raises:
        ModelError: No such vehicle, or the file is wrong; the text names file, key and value.
    """
    return parse_vehicle(*vehicle_text(name_or_path))


def vehicle_text(name_or_path: str | Path) -> tuple[str, str]:
    """Text of a vehicle file, or of a built-in vehicle by its name, and the name of the file.

    Raises:
        ModelError: No such vehicle, or it cannot be read.
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
        return path.read_text("utf-8"), path.name
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path.name}: cannot be read as text: {error}.") from error


def parse_vehicle(text: str, file: str) -> Vehicle:
    """Build a vehicle from the text of a vehicle file; `file` names it in errors."""
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ModelError(f"{file}: not valid TOML: {error}.") from error
    effects = tree.pop("effects", {})
    entries = read_entries(tree)
    _refuse(file, [*entries.mistakes, *_contradictions(entries)])
    vehicle = _vehicle(entries, default_name=Path(file).stem)
    _refuse(file, list(_cannot_hover(vehicle)))
    switched_on = read_effects(effects, vehicle)
    _refuse(file, switched_on.mistakes)
    return replace(
        vehicle,
        effects=switched_on.values,
        sources={**vehicle.sources, **switched_on.sources},
    )


def _refuse(file: str, mistakes: list[str]) -> None:
    """Raise one error that holds all mistakes, if there are any."""
    if len(mistakes) == 1:
        raise ModelError(f"{file}: {mistakes[0]}")
    if mistakes:
        raise ModelError(f"{file}: {len(mistakes)} mistakes:\n  " + "\n  ".join(mistakes))


# -- entries against each other ---------------------------------------------------------------


def _contradictions(entries: Entries) -> Iterator[str]:
    """Mistakes that no entry makes by itself."""
    given, values = entries.given, entries.values
    yield from _one_of("thrust", *_THRUST, given)
    if len(given & set(_THRUST)) == 1:
        yield from _against_thrust(entries)
    direction, position = values.get("rotors.direction"), values.get("rotors.position")
    if direction is not None and position is not None and len(direction) != len(position):
        yield (f"rotors.direction has {len(direction)} entries, rotors.position {len(position)}.")
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


def _against_thrust(entries: Entries) -> Iterator[str]:
    """What does not go with the argument of the one thrust map."""
    of_speed = "rotors.thrust_from_speed" in entries.given
    by, other = ("speed", "command") if of_speed else ("command", "speed")
    yield from _one_of(
        "reaction torque", "rotors.torque_per_thrust", f"rotors.torque_from_{by}", entries.given
    )
    useless = {f"rotors.torque_from_{other}"}
    if not of_speed:
        useless.add("rotors.speed_from_command")
        if entries.values.get("rotors.spin_inertia", 0.0) > 0:
            yield (
                "rotors.spin_inertia needs the rotor speed: give thrust_from_speed "
                "(and speed_from_command for a vehicle driven by commands)."
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


def _doubts(entries: Entries) -> Iterator[str]:
    """What looks odd but is not refused."""
    given = entries.given
    principal = np.linalg.eigvalsh(entries.values["body.inertia"])
    if principal[0] + principal[1] < principal[2]:
        yield (
            "body.inertia: the two smaller principal moments add up to less than the largest; "
            "no real body has that."
        )
    if "rotors.voltage_exponent" in given and "rotors.reference_voltage" not in given:
        yield "rotors.voltage_exponent counts only with rotors.reference_voltage."
    of_command = {"rotors.thrust_from_command", "rotors.speed_from_command"}
    if "rotors.command_range" in given and not of_command & given:
        yield "rotors.command_range counts only with a polynomial of the command."


def _cannot_hover(vehicle: Vehicle) -> Iterator[str]:
    rotors = vehicle.rotors
    if vehicle.drive == "rotor_speed":
        return
    command = np.linspace(0.0, 1.0, 201)
    level = polyval(command, rotors.speed_rad_s) if rotors.speed_rad_s else command
    most = float(np.max(polyval(level, rotors.thrust_n)))
    if most < vehicle.hover_thrust_n:
        yield (
            f"cannot hover: {rotors.count} rotors give at most {most * rotors.count:.4g} N, "
            f"the weight is {vehicle.mass_kg * GRAVITY_M_S2:.4g} N. Check the thrust map, its "
            f"unit and rotors.command_range."
        )


# -- vehicle ----------------------------------------------------------------------------------


def _vehicle(entries: Entries, default_name: str) -> Vehicle:
    """The vehicle of entries without mistakes."""
    rotors = _rotors(entries)
    arm_m = float(np.linalg.norm(rotors.position_m[:, :2], axis=1).max())
    leg_m = entries.optional("body.leg_height", f"half the largest rotor arm, {arm_m / 2:g} m")
    zero = (0.0, 0.0, 0.0)
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
        sources=entries.sources,
        doubts=tuple(_doubts(entries)),
    )


def _rotors(entries: Entries) -> Rotors:
    from_speed = "rotors.thrust_from_speed" in entries.given
    thrust = _map(entries, f"rotors.thrust_from_{'speed' if from_speed else 'command'}")
    if "rotors.torque_per_thrust" in entries.given:
        ratio = entries.number("rotors.torque_per_thrust")
        torque = tuple(ratio * c for c in thrust)
    else:
        torque = _map(entries, f"rotors.torque_from_{'speed' if from_speed else 'command'}")
    by_command = "rotors.speed_from_command" in entries.given
    spin = entries.optional("rotors.spin_inertia", "0, no gyroscopic torque")
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
    )


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


def _battery(entries: Entries) -> Battery | None:
    if _BATTERY[0] not in entries.given:
        return None
    full, empty, capacity, resistance, current = (entries.number(key) for key in _BATTERY)
    return Battery(full, empty, capacity, resistance, current)
