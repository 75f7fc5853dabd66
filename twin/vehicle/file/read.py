"""Vehicle files: TOML to `Vehicle`; a refusal names the file and every key and value at fault.

`docs/guide/vehicle.md` describes the format for people; `FIELDS` is its one definition.
"""

import re
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ModelError
from .. import GRAVITY_M_S2, Battery, Vehicle
from .calibration import SECTION, read_calibration
from .effects import read_effects
from .entries import Entries, read_entries
from .fields import FIELDS
from .rotors import read_rotors, rotor_contradictions, rotor_doubts, rotors_too_weak
from .sensors import read_sensors, sensor_contradictions

_ROUNDING = 1e-9
"""Share by which the moments of a flat plate may miss their sum."""
_MOST_BYTES = 2**20
_MOST_PARTS = 32
_STRING = re.compile(r"\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'")
_BETWEEN = re.compile(r"[\s=,#\[\]{}]")
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
        ModelError: It is none, or is nested too deeply or has a number too long to be read.
    """
    if (parts := _longest_key(text)) > _MOST_PARTS:
        raise ModelError(f"{file}: a key has {parts} parts, at most {_MOST_PARTS} are read.")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError
        raise ModelError(f"{file}: not valid TOML: {error}.") from error


def _longest_key(text: str) -> int:
    """Parts of the longest dotted key: `tomllib` takes memory as their square."""
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
    """Raise one error that holds all mistakes, if there are any."""
    if len(mistakes) == 1:
        raise ModelError(f"{file}: {mistakes[0]}")
    if mistakes:
        raise ModelError(f"{file}: {len(mistakes)} mistakes:\n  " + "\n  ".join(mistakes))


# -- entries against each other ---------------------------------------------------------------


def _contradictions(entries: Entries) -> Iterator[str]:
    """Mistakes that no entry makes by itself."""
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
    """What looks odd but is not refused."""
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
    """The vehicle of entries without mistakes."""
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
