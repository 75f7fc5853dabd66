"""Writer of vehicle files: from a draft, from a vehicle, or by updating an existing text.

A draft contains entries with unit and source, and notes on facts that the format has no key for.

In an existing text, numbers that differ are replaced, effects are added or removed; comments, order
and all other text remain. The result is read back before it is returned: a vehicle that the format
cannot represent is refused, never written in part.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, cast

import numpy as np
import tomlkit
from tomlkit import TOMLDocument
from tomlkit.items import InlineTable, Table

from ..effects import EFFECTS
from ..errors import ModelError
from ..vehicle import Array, Deviation, Rotors, Vehicle
from ..vehicle.vehicle import BEFORE, DEFAULT
from .calibration import same_calibration, with_calibration
from .entries import written_sd
from .fields import FIELDS
from .read import PLACE, POSITION, SENSOR_NUMBERS, WHEN, parse_vehicle, spelled


@dataclass(frozen=True, slots=True)
class Written:
    """A number for a vehicle file.

    Attributes:
        value: Value in the unit of the effect.
        source: Source of the value.
        deviation: Standard deviation; None: none is written.
    """

    value: float
    source: str
    deviation: Deviation | None = None


def with_effect_sections(
    text: str, vehicle: Vehicle, effects: Mapping[str, Mapping[str, Written]]
) -> str:
    """Text of a vehicle file with `[effects.NAME]` sections added, or replaced.

    Args:
        text: Text of the original file.
        vehicle: Vehicle of that file.
        effects: Numbers by effect and name.
    """
    document = tomlkit.parse(text)
    sections = _sections(document)
    for name, numbers in effects.items():
        sections[name] = _section(name, vehicle, numbers)
    return document.as_string()


def without_effect_sections(text: str, names: Iterable[str]) -> str:
    """Text of a vehicle file without these effects, which it must contain."""
    document = tomlkit.parse(text)
    sections = cast(Table, document["effects"])
    for name in names:
        sections.remove(name)
    if not sections:
        document.remove("effects")
    return document.as_string()


def _sections(document: TOMLDocument) -> Table:
    """The table of all effects, moved behind everything else as separate sections."""
    if re.search(r"^\s*\[\s*effects\b", document.as_string(), re.MULTILINE):
        return cast(Table, document["effects"])
    old = document.pop("effects", {})
    if not document.as_string().endswith("\n"):
        document.add(tomlkit.nl())
    sections = tomlkit.table(is_super_table=True)
    for name, numbers in old.items():
        section = tomlkit.table()
        section.update(numbers)
        sections[name] = section
    document.add("effects", sections)
    return sections


def _section(effect: str, vehicle: Vehicle, numbers: Mapping[str, Written]) -> Table:
    units = {n: p.unit for p in EFFECTS[effect].parameters for n in p.names(vehicle)}
    section = tomlkit.table()
    section.comment(EFFECTS[effect].meaning)
    for name, number in numbers.items():
        section[name] = _entry(number, spelled(units[name]))
    return section


def _entry(number: Written, unit: str) -> InlineTable:
    entry = tomlkit.inline_table()
    entry.update({"value": number.value, "unit": unit})
    if number.deviation is not None:
        entry["sd"] = written_sd(number.deviation)
    entry["source"] = number.source
    return entry


_WIDTH = 98  # characters of a comment's line


@dataclass(slots=True)
class Draft:
    """Entries of a new vehicle file.

    Attributes:
        name: Name of the vehicle.
        description: Description in one line.
        file: Name of the file from which the numbers come, for their sources; "": the sources are
            complete.
        notes: Notes on facts that the other file lacks, or that have no key here; written at the
            head of the file.
    """

    name: str
    description: str
    file: str
    notes: list[str] = field(default_factory=list)
    _entries: dict[str, dict[str, Any]] = field(default_factory=dict)

    def number(
        self,
        key: str,
        value: float | Array,
        unit: str,
        source: str,
        sd: str | float | None = None,
    ) -> None:
        """Add a number, a vector or rows of numbers; `sd` in the form of the file."""
        self._add(key, {"value": _plain(value), "unit": unit}, source, sd)

    def words(self, key: str, value: list[Any], source: str) -> None:
        """Add a value without unit."""
        self._add(key, {"value": value}, source)

    def polynomial(
        self,
        key: str,
        coefficients: Array,
        unit: str,
        source: str,
        of: str | None = None,
        sd: str | None = None,
    ) -> None:
        """Add ascending coefficients; `of` is the unit of the rotor speed that they multiply."""
        entry: dict[str, Any] = {"coefficients": _plain(coefficients), "unit": unit}
        self._add(key, entry | ({"of": of} if of else {}), source, sd)

    def text(self) -> str:
        """The vehicle file: notes, then the sections in the order of the documentation."""
        document = tomlkit.document()
        for note in self.notes:
            for line in _lines(note):
                document.add(tomlkit.comment(line))
        document.add("name", tomlkit.string(_one_line(self.name)))
        document.add("description", tomlkit.string(_one_line(self.description)))
        for section in dict.fromkeys(key.split(".")[0] for key in FIELDS):
            keys = [k for k in FIELDS if k in self._entries and k.startswith(f"{section}.")]
            if not keys:
                continue
            table = tomlkit.table()
            for key in keys:
                entry = tomlkit.inline_table()
                entry.update(self._entries[key])
                table.add(key.split(".")[1], entry)
            document.add(tomlkit.nl())
            document.add(section, table)
        return document.as_string()

    def _add(
        self, key: str, parts: dict[str, Any], source: str, sd: str | float | None = None
    ) -> None:
        assert key in FIELDS, key
        known = {} if sd is None else {"sd": sd}
        source = f"{self.file}: {source}" if self.file else source
        self._entries[key] = {**parts, **known, "source": _one_line(source)}


def _plain(value: float | Array) -> Any:
    return np.asarray(value, dtype=np.float64).tolist()


def _one_line(text: str) -> str:
    """Text of another file without line ends and control characters."""
    return re.sub(r"[\s\x00-\x1f\x7f]+", " ", text).strip()


def _lines(note: str) -> list[str]:
    """A note as lines of a comment."""
    lines = [""]
    for word in _one_line(note).split(" "):
        if lines[-1] and len(lines[-1]) + len(word) >= _WIDTH:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".lstrip()
    return lines


_NOT_COMPARED = ("sources", "deviations", "doubts", "effects", "calibration", "text", "file")
"""Attributes of a vehicle that are not numbers of its body, rotors and sensors."""
_MAPS = tuple(
    f"rotors.{what}_from_{of}"
    for what in ("thrust", "torque", "speed")
    for of in ("speed", "command")
)  # maps of the rotors
TIED = {
    **dict.fromkeys(_MAPS, (*_MAPS, "rotors.command_range", "rotors.torque_per_thrust")),
    "magnetometer.field": (*PLACE, *WHEN),
}
"""Alternative keys for the same quantity, which must be removed when a key is written."""
_BY_HAND = "set in Python"  # source of a number without one
_PASSES = 3
"""Number of updates: numbers of a file may be relative to others, drag per kilogram, torque per
thrust."""


def update_text(vehicle: Vehicle, text: str = "", file: str = "vehicle.toml") -> str:
    """Text of a vehicle file for this vehicle.

    Args:
        vehicle: Vehicle to write.
        text: Text of a file to start from, that of the vehicle before it was changed; "": none.
        file: Name of the file in errors.

    Returns:
        The original text where nothing differs.

    Raises:
        ModelError: The format cannot represent the vehicle, or the text is no vehicle file.
    """
    if text:
        vehicle = _with_new_sources(vehicle, parse_vehicle(text, file))
    for _ in range(_PASSES):
        there = parse_vehicle(text, file) if text else None
        changed = set(_changed(vehicle, there))
        if not changed:
            break
        text = _with_numbers(vehicle, text, changed)
    text = _with_effects(vehicle, there := parse_vehicle(text, file), text)
    if not same_calibration(vehicle.calibration, there.calibration):
        text = with_calibration(text, vehicle.calibration)
    left = [*_differing(vehicle, again := parse_vehicle(text, file))]
    left += ["effects"] if _as_dicts(vehicle.effects) != _as_dicts(again.effects) else []
    left += [] if same_calibration(vehicle.calibration, again.calibration) else ["calibration"]
    if left:
        raise ModelError(
            f"{vehicle.name}: a vehicle file cannot hold its {', '.join(left)}. Write the file by "
            f"hand; the format is in docs/guide/vehicle.md."
        )
    return text


# -- what differs ---------------------------------------------------------------------------


def _changed(vehicle: Vehicle, there: Vehicle | None) -> Iterator[str]:
    """Keys whose values or deviations differ from those of the text; without a text, all except
    defaults."""
    wanted, found = values_by_key(vehicle), {} if there is None else values_by_key(there)
    for key in wanted.keys() | found.keys():
        if there is None and vehicle.sources.get(key, "").startswith(DEFAULT):
            continue
        redetermined = there is not None and _deviation(vehicle, key) != _deviation(there, key)
        if redetermined or not _same(wanted.get(key), found.get(key)):
            yield key


def _differing(a: Any, b: Any, within: str = "") -> Iterator[str]:
    """Attributes in which two vehicles differ, without those of `_NOT_COMPARED`."""
    for own in (f.name for f in fields(b) if f.name not in _NOT_COMPARED):
        x, y, name = getattr(a, own), getattr(b, own), f"{within}{own}"
        if is_dataclass(x) and is_dataclass(y):
            yield from _differing(x, y, f"{name}.")
        elif not _same(x, y):
            yield name


def _same(x: Any, y: Any) -> bool:
    if x is None or y is None:
        return x is y
    if isinstance(x, Mapping | str):
        return bool(x == y)
    return bool(np.array_equal(x, y))


def values_by_key(vehicle: Vehicle) -> dict[str, Any]:
    """Values in SI units by key, as in a file; polynomials of the command 0..1."""
    sensors, battery = vehicle.sensors, vehicle.battery
    values = {
        "name": vehicle.name,
        "description": vehicle.description,
        "body.mass": vehicle.mass_kg,
        "body.inertia": vehicle.inertia_kg_m2[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)],
        "body.drag_linear": vehicle.drag_linear_n_s_m,
        "body.drag_quadratic": vehicle.drag_quadratic_n_s2_m2,
        "body.drag_parasitic": vehicle.drag_parasitic_n_s2_m2,
        "body.drag_angular": vehicle.drag_angular_n_m_s2,
        "body.leg_height": vehicle.leg_height_m,
        **_rotor_values(vehicle.rotors),
        "imu.position": vehicle.imu_position_m,
        "imu.accel_cutoff": vehicle.accel_cutoff_hz,
        "imu.gyro_cutoff": vehicle.gyro_cutoff_hz,
        "magnetometer.field": sensors.field_n_t,
        "site.gravity": vehicle.gravity_m_s2,
    }
    values |= {key: getattr(sensors, name) for key, (name, _) in SENSOR_NUMBERS.items()}
    values |= {key: sensors.position.get(name) for key, name in POSITION.items()}
    if battery is not None:
        values |= {
            "battery.full_voltage": battery.full_voltage_v,
            "battery.empty_voltage": battery.empty_voltage_v,
            "battery.capacity": battery.capacity_a_s,
            "battery.resistance": battery.resistance_ohm,
            "battery.hover_current": battery.hover_current_a,
        }
    return {k: v for k, v in values.items() if v is not None}


def _rotor_values(rotors: Rotors) -> dict[str, Any]:
    """Values of the rotors' keys; None for those that do not apply."""
    of = "speed" if rotors.from_speed else "command"
    up, down = rotors.run_up or (None, None)
    air, advance = rotors.air, rotors.advance
    return {
        "rotors.position": rotors.position_m,
        "rotors.direction": rotors.direction,
        f"rotors.thrust_from_{of}": rotors.thrust_n,
        f"rotors.torque_from_{of}": rotors.torque_n_m,
        "rotors.speed_from_command": rotors.speed_rad_s,
        "rotors.lag": (rotors.lag_up_s, rotors.lag_down_s) if rotors.lag_up_s else None,
        "rotors.rate_up": None if up is None else (up.linear_1_s, up.quadratic_1_rad),
        "rotors.rate_down": None if down is None else (down.linear_1_s, down.quadratic_1_rad),
        "rotors.spin_inertia": rotors.spin_inertia_kg_m2 or None,
        "rotors.reaction_inertia": rotors.reaction_inertia_kg_m2 or None,
        "rotors.reference_voltage": rotors.reference_voltage_v,
        "rotors.voltage_exponent": (
            None if rotors.voltage_exponent == 1 else rotors.voltage_exponent
        ),
        "rotors.drag": air.drag_kg_rad or None,
        "rotors.inflow": air.inflow_kg_rad or None,
        "rotors.lift": air.lift_kg_m or None,
        "rotors.flapping_moment": air.flapping_kg_m_rad or None,
        "rotors.rolling_moment": air.rolling_kg_m_rad or None,
        "rotors.diameter": None if advance is None else advance.diameter_m,
        "rotors.thrust_by_advance": (advance.thrust or None) if advance else None,
        "rotors.torque_by_advance": (advance.torque or None) if advance else None,
    }


# -- text -----------------------------------------------------------------------------------


def _with_numbers(vehicle: Vehicle, text: str, changed: set[str]) -> str:
    """The text with these keys replaced, each with a source."""
    document, wanted = tomlkit.parse(text), values_by_key(vehicle)
    for name in (n for n in ("name", "description") if n in changed):
        document[name] = wanted[name]
    keys = changed.union(*(TIED.get(key, ()) for key in changed))
    for key in (k for k in FIELDS if k in keys):
        if key in wanted:
            _set(
                document,
                key,
                wanted[key],
                _pedigree(vehicle, key) or _BY_HAND,
                _deviation(vehicle, key),
            )
        else:
            _remove(document, key)
    return document.as_string()


def _with_new_sources(vehicle: Vehicle, there: Vehicle) -> Vehicle:
    """The vehicle without sources and deviations of numbers that have changed."""
    sources, deviations = dict(vehicle.sources), dict(vehicle.deviations)
    wanted, found = values_by_key(vehicle), values_by_key(there)
    for key in (k for k in FIELDS if k in wanted and not _same(wanted[k], found.get(k))):
        before = _pedigree(there, key)
        if before and _pedigree(vehicle, key) in ("", before):
            sources[key] = f"{_BY_HAND}{BEFORE}{before}"
            if _deviation(vehicle, key) == _deviation(there, key):
                deviations.pop(key, None)
                deviations.pop(_ratio(key), None)
    return replace(vehicle, sources=sources, deviations=deviations)


def _pedigree(vehicle: Vehicle, key: str) -> str:
    """Source of a number, "" where none is known; a torque may be given by its ratio."""
    source = vehicle.sources.get(key) or vehicle.sources.get(_ratio(key), "")
    return "" if source.startswith(DEFAULT) else source


def _deviation(vehicle: Vehicle, key: str) -> Deviation | None:
    """Stated deviation of a number; of a torque given by its ratio, as a share."""
    ratio = vehicle.deviations.get(_ratio(key))
    return vehicle.deviations.get(key) or (None if ratio is None else Deviation(ratio.share))


def _ratio(key: str) -> str:
    """The key of the ratio that may replace a torque."""
    return "rotors.torque_per_thrust" if key.startswith("rotors.torque_from") else ""


def _set(
    document: TOMLDocument, key: str, value: Any, source: str, deviation: Deviation | None
) -> None:
    """Write one entry, in place of the old one and with its comment where there is one."""
    section, name = key.split(".")
    if section not in document:
        document[section] = tomlkit.table()
    table, what, entry = cast(Table, document[section]), FIELDS[key], tomlkit.inline_table()
    if what.shape in ("polynomial", "rates"):
        entry["coefficients"] = [float(c) for c in value]
    elif what.shape == "list":
        entry["value"] = ["cw" if d > 0 else "ccw" for d in value]
    else:
        entry["value"] = np.asarray(value, dtype=np.float64).tolist()
    if what.unit:
        entry["unit"] = what.unit.removeprefix("poly:")
    if key.endswith("_from_speed") or what.shape == "rates":
        entry["of"] = "rad/s"
    if deviation is not None:
        entry["sd"] = written_sd(deviation, np.shape(value))
    entry["source"] = source
    if name in table:
        entry.trivia.comment_ws = table[name].trivia.comment_ws
        entry.trivia.comment = table[name].trivia.comment
    table[name] = entry


def _remove(document: TOMLDocument, key: str) -> None:
    section, name = key.split(".")
    table = document.get(section, {})
    table.pop(name, None)
    if section in document and not table:
        del document[section]


def _with_effects(vehicle: Vehicle, there: Vehicle, text: str) -> str:
    """The text with exactly the vehicle's effects; existing ones remain in place."""
    gone = [name for name in there.effects if name not in vehicle.effects]
    if gone:
        text = without_effect_sections(text, gone)
    written = {
        name: {
            number: Written(
                value,
                vehicle.sources.get(key := f"effects.{name}.{number}", _BY_HAND),
                vehicle.deviations.get(key),
            )
            for number, value in numbers.items()
        }
        for name, numbers in vehicle.effects.items()
        if not _holds(there, vehicle, name)
    }
    return with_effect_sections(text, vehicle, written) if written else text


def _holds(there: Vehicle, vehicle: Vehicle, effect: str) -> bool:
    """Whether the text has an effect with the same numbers and the same sources."""
    prefix = f"effects.{effect}."
    same = dict(there.effects.get(effect, {})) == dict(vehicle.effects[effect])
    return same and all(
        there.sources.get(prefix + n) == vehicle.sources.get(prefix + n)
        and there.deviations.get(prefix + n) == vehicle.deviations.get(prefix + n)
        for n in vehicle.effects[effect]
    )


def _as_dicts(effects: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    return {name: dict(numbers) for name, numbers in effects.items()}
