"""Vehicle files: TOML to `Vehicle`, every key checked, every refusal naming file, key and value.

`docs/vehicle.md` describes the format for people; `FIELDS` is its one definition.
"""

import reprlib
import tomllib
from collections.abc import Iterator
from difflib import get_close_matches
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pint

from .errors import ModelError
from .vehicle import GRAVITY_M_S2, Array, Battery, Rotors, Vehicle
from .vehicle_fields import FIELDS

_HUGE = 1e60  # larger numbers overflow once multiplied with each other
_REQUIRED_BATTERY = ("full_voltage", "empty_voltage", "capacity", "resistance", "hover_current")


def builtin_vehicles() -> tuple[str, ...]:
    """Names of the vehicle files that ship with the program."""
    folder = resources.files(__package__) / "vehicles"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir()))


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Read a vehicle file, or a built-in vehicle by its name.

    Raises:
        ModelError: No such vehicle, or the file is wrong; the text names file, key and value.
    """
    text_name = str(name_or_path)
    if text_name in builtin_vehicles():
        text = (resources.files(__package__) / "vehicles" / f"{text_name}.toml").read_text("utf-8")
        return parse_vehicle(text, f"{text_name}.toml")
    path = Path(name_or_path)
    if not path.is_file():
        near = get_close_matches(text_name, builtin_vehicles(), n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ModelError(
            f"{text_name}: neither a vehicle file nor a built-in vehicle.{hint} "
            f"Built in: {', '.join(builtin_vehicles())}; the format is in docs/vehicle.md."
        )
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path.name}: cannot be read as text: {error}.") from error
    return parse_vehicle(text, path.name)


def parse_vehicle(text: str, file: str) -> Vehicle:
    """Build a vehicle from the text of a vehicle file; `file` names it in errors."""
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ModelError(f"{file}: not valid TOML: {error}.") from error
    return _Reader(file, tree).vehicle()


class _Reader:
    """Reads one parsed vehicle file, checking every key against `FIELDS`."""

    def __init__(self, file: str, tree: dict[str, Any]) -> None:
        self.file, self.tree = file, tree
        self.sources: dict[str, str] = {}
        self.doubts: list[str] = []

    def vehicle(self) -> Vehicle:
        """The vehicle of the file, everything checked."""
        self._check_keys()
        mass = float(self._number("body.mass"))
        drag = self._vector("body.drag_linear", 3, mass_kg=mass)
        rotors = self._rotors()
        arm = float(np.linalg.norm(rotors.position_m[:, :2], axis=1).max())
        leg = self._optional("body.leg_height", f"half the largest rotor arm, {arm / 2:g} m")
        vehicle = Vehicle(
            name=self._text("name", Path(self.file).stem),
            description=self._text("description", ""),
            mass_kg=mass,
            inertia_kg_m2=self._inertia(),
            drag_linear_n_s_m=drag,
            drag_quadratic_n_s2_m2=self._vector("body.drag_quadratic", 3),
            leg_height_m=arm / 2 if leg is None else leg,
            rotors=rotors,
            imu_position_m=self._vector("imu.position", 3),
            accel_cutoff_hz=self._optional("imu.accel_cutoff", "no low-pass"),
            gyro_cutoff_hz=self._optional("imu.gyro_cutoff", "no low-pass"),
            battery=self._battery(),
            sources=self.sources,
            doubts=tuple(self.doubts),
        )
        self._check_hover(vehicle)
        return vehicle

    # -- keys ------------------------------------------------------------------------------

    def _check_keys(self) -> None:
        sections = {key.split(".")[0] for key in FIELDS}
        for name, value in self.tree.items():
            if name in ("name", "description"):
                continue
            if name not in sections:
                raise self._unknown("section", name, sections | {"name", "description"})
            if not isinstance(value, dict):
                raise ModelError(f"{self.file}: [{name}] must be a table of keys.")
            for key in value:
                if f"{name}.{key}" not in FIELDS:
                    known = {k.split(".")[1] for k in FIELDS if k.startswith(f"{name}.")}
                    raise self._unknown(f"key in [{name}]", key, known)
        for key, field in FIELDS.items():
            if field.required and self._entry(key) is None:
                raise ModelError(f"{self.file}: {key} is missing: {field.meaning}")

    def _unknown(self, kind: str, name: str, known: set[str]) -> ModelError:
        near = get_close_matches(name, sorted(known), n=1, cutoff=0.5)
        hint = f"Did you mean {near[0]!r}?" if near else f"Known: {', '.join(sorted(known))}."
        return ModelError(f"{self.file}: unknown {kind}: {name!r}. {hint}")

    def _entry(self, key: str) -> dict[str, Any] | None:
        section, name = key.split(".")
        entry = self.tree.get(section, {}).get(name)
        if entry is None:
            return None
        if not isinstance(entry, dict) or not ({"value", "coefficients"} & set(entry)):
            unit = FIELDS[key].unit.removeprefix("poly:")
            raise ModelError(
                f"{self.file}: {key} = {entry!r} needs unit and source, as in "
                f'{name} = {{ value = ..., unit = "{unit or "1"}", source = "..." }}.'
            )
        allowed = {"value", "coefficients", "unit", "source", "of"}
        for part in entry:
            if part not in allowed:
                raise self._unknown(f"part of {key}", part, allowed)
        if not isinstance(entry.get("source"), str) or not entry["source"].strip():
            raise ModelError(
                f"{self.file}: {key} has no source. Say where the number comes from; "
                f'"made up" is an honest source.'
            )
        self.sources[key] = entry["source"]
        return entry

    # -- values ----------------------------------------------------------------------------

    def _text(self, key: str, default: str) -> str:
        value = self.tree.get(key, default)
        if not isinstance(value, str):
            raise ModelError(f"{self.file}: {key} = {value!r} must be text.")
        return value

    def _array(self, key: str, raw: Any) -> Array:
        if raw is None:
            raise ModelError(f"{self.file}: {key} has no value. Write value = ... in its braces.")
        try:
            if any(isinstance(n, bool) or not isinstance(n, int | float) for n in _leaves(raw)):
                raise TypeError
            values = np.asarray(raw, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ModelError(f"{self.file}: {key} = {_short(raw)} must be numbers.") from None
        if not np.all(np.abs(values) < _HUGE):
            raise ModelError(f"{self.file}: {key} = {_short(raw)} must be finite, below {_HUGE:g}.")
        return values

    def _si(
        self, key: str, entry: dict[str, Any], unit: str, mass_kg: float | None = None
    ) -> Array:
        values = self._array(key, entry.get("value"))
        given = entry.get("unit")
        if not isinstance(given, str):
            raise ModelError(f'{self.file}: {key} has no unit. Add unit = "{unit}" or another one.')
        factor, dimension_ok = self._factor(key, given, unit)
        if not dimension_ok and mass_kg is not None:
            per_mass, dimension_ok = self._factor(key, given, f"({unit})/kg")
            factor = per_mass * mass_kg
        if not dimension_ok:
            raise ModelError(
                f'{self.file}: {key} has unit "{given}", which is not a unit of the kind "{unit}".'
            )
        return values * factor

    def _factor(self, key: str, given: str, wanted: str) -> tuple[float, bool]:
        """Factor from one unit to another, and whether they are of one kind."""
        try:
            return float(_registry().Quantity(1.0, given).to(wanted).magnitude), True
        except (pint.DimensionalityError, pint.OffsetUnitCalculusError):
            return 1.0, False
        except Exception as error:  # pint raises tokenizer and attribute errors for bad text
            bad = wanted if given == "rad/s" else given
            raise ModelError(
                f"{self.file}: {key} has unit {_short(bad)}, which is not a unit: "
                f"{_short(str(error))}."
            ) from error

    def _check_sign(self, key: str, values: Array, positive: bool | None) -> None:
        if positive is None:
            return
        if np.any(values <= 0) if positive else np.any(values < 0):
            bound = "positive" if positive else "zero or positive"
            raise ModelError(f"{self.file}: {key} = {values.tolist()} must be {bound}.")

    def _number(self, key: str) -> float:
        entry = self._entry(key)
        assert entry is not None
        values = self._si(key, entry, FIELDS[key].unit)
        if values.shape != ():
            raise ModelError(f"{self.file}: {key} = {entry.get('value')!r} must be one number.")
        self._check_sign(key, values, FIELDS[key].positive)
        return float(values)

    def _optional(self, key: str, default: str) -> float | None:
        if self._entry(key) is None:
            self.sources[key] = f"default: {default}"
            return None
        return self._number(key)

    def _vector(self, key: str, size: int, mass_kg: float | None = None) -> Array:
        entry = self._entry(key)
        if entry is None:
            self.sources[key] = "default: zero"
            return np.zeros(size)
        values = self._si(key, entry, FIELDS[key].unit, mass_kg)
        if values.shape != (size,):
            raise ModelError(
                f"{self.file}: {key} = {entry['value']!r} must be a list of {size} numbers."
            )
        self._check_sign(key, values, FIELDS[key].positive)
        return values

    def _inertia(self) -> Array:
        key = "body.inertia"
        entry = self._entry(key)
        assert entry is not None
        values = self._si(key, entry, FIELDS[key].unit)
        if values.shape not in ((3,), (6,)):
            raise ModelError(
                f"{self.file}: {key} = {entry['value']!r} must be [Ixx, Iyy, Izz] or "
                f"[Ixx, Iyy, Izz, Ixy, Ixz, Iyz]."
            )
        xx, yy, zz, xy, xz, yz = [*values, 0.0, 0.0, 0.0][:6]
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        principal = np.linalg.eigvalsh(matrix)
        if principal[0] <= 0:
            raise ModelError(
                f"{self.file}: {key} = {entry['value']!r} is not positive definite "
                f"(smallest principal moment {principal[0]:g} kg*m^2)."
            )
        if principal[0] + principal[1] < principal[2]:
            self.doubts.append(
                f"{key}: the two smaller principal moments add up to less than the largest; "
                f"no real body has that."
            )
        return matrix

    def _polynomial(self, key: str) -> tuple[float, ...] | None:
        """Ascending coefficients in SI: of the speed in rad/s, or of the command 0..1."""
        entry = self._entry(key)
        if entry is None:
            return None
        unit = FIELDS[key].unit.removeprefix("poly:")
        of_speed = key.endswith("from_speed")
        if "value" in entry and "coefficients" in entry:
            raise ModelError(f"{self.file}: {key} has value and coefficients; give one of them.")
        if "value" in entry:
            if not of_speed:
                raise ModelError(
                    f"{self.file}: {key} needs coefficients = [c0, c1, ...] in ascending powers "
                    f"of the command."
                )
            square = self._si(key, entry, f"{unit}*s^2/rad^2")
            if square.shape != ():
                raise ModelError(
                    f"{self.file}: {key}: a single value k means k * speed^2; for a polynomial "
                    f"write coefficients = [c0, c1, c2]."
                )
            self._check_sign(key, square, True)
            return (0.0, 0.0, float(square))
        c = self._si(key, {**entry, "value": entry["coefficients"]}, unit)
        if c.ndim != 1 or not 1 <= len(c) <= 8:
            raise ModelError(f"{self.file}: {key}: coefficients must be a list of 1 to 8 numbers.")
        if of_speed:
            of = entry.get("of")
            if not isinstance(of, str):
                raise ModelError(
                    f'{self.file}: {key} needs of = "rad/s" (or "rpm"): the unit of the speed.'
                )
            per_rad_s, ok = self._factor(key, "rad/s", of)
            if not ok:
                raise ModelError(f'{self.file}: {key}: of = "{of}" is not a rotor speed.')
            return tuple(float(ck * per_rad_s**k) for k, ck in enumerate(c))
        if "of" in entry:
            raise ModelError(
                f"{self.file}: {key} is a polynomial of the command; its raw range is "
                f"rotors.command_range, so 'of' has no place here."
            )
        low, high = self._command_range()
        shifted = np.polynomial.Polynomial(c)(np.polynomial.Polynomial([low, high - low]))
        coefficients = np.zeros(len(c))
        coefficients[: len(shifted.coef)] = shifted.coef
        return tuple(float(ck) for ck in coefficients)

    def _command_range(self) -> tuple[float, float]:
        entry = self._entry("rotors.command_range")
        if entry is None:
            self.sources["rotors.command_range"] = "default: commands are 0..1"
            return 0.0, 1.0
        values = self._array("rotors.command_range", entry.get("value"))
        if values.shape != (2,) or values[0] == values[1]:
            raise ModelError(
                f"{self.file}: rotors.command_range = {entry.get('value')!r} must be two "
                f"different numbers: raw command at cmd = 0 and at cmd = 1."
            )
        return float(values[0]), float(values[1])

    # -- groups ----------------------------------------------------------------------------

    def _one_of(self, what: str, *keys: str) -> str:
        given = [k for k in keys if self._entry(k) is not None]
        if len(given) != 1:
            state = "none is given" if not given else f"{' and '.join(given)} are given"
            raise ModelError(
                f"{self.file}: {what} needs exactly one of {', '.join(keys)}; {state}."
            )
        return given[0]

    def _rotors(self) -> Rotors:
        position_entry = self._entry("rotors.position")
        assert position_entry is not None
        position = self._si("rotors.position", position_entry, "m")
        if position.ndim != 2 or position.shape[1] != 3 or not 3 <= len(position) <= 12:
            raise ModelError(
                f"{self.file}: rotors.position must be 3 to 12 rows of [x, y, z]; it has shape "
                f"{position.shape}."
            )
        thrust_key = self._one_of(
            "thrust", "rotors.thrust_from_speed", "rotors.thrust_from_command"
        )
        from_speed = thrust_key.endswith("speed")
        thrust, torque = self._polynomial(thrust_key), self._torque(from_speed, thrust_key)
        assert thrust is not None
        speed = self._polynomial("rotors.speed_from_command")
        if speed is not None and not from_speed:
            raise ModelError(
                f"{self.file}: rotors.speed_from_command is of no use with thrust_from_command. "
                f"Give thrust_from_speed, or leave the speed out."
            )
        spin = self._optional("rotors.spin_inertia", "0, no gyroscopic torque")
        if spin and not from_speed:
            raise ModelError(
                f"{self.file}: rotors.spin_inertia needs the rotor speed: give thrust_from_speed "
                f"(and speed_from_command for a vehicle driven by commands)."
            )
        reference = self._optional("rotors.reference_voltage", "voltage is ignored")
        exponent = self._optional("rotors.voltage_exponent", "1")
        if exponent is not None and reference is None:
            self.doubts.append("rotors.voltage_exponent counts only with rotors.reference_voltage.")
        if from_speed and speed is None and self._entry("rotors.command_range") is not None:
            self.doubts.append("rotors.command_range counts only with a polynomial of the command.")
        up, down = self._lag()
        return Rotors(
            position_m=position,
            direction=self._direction(len(position)),
            from_speed=from_speed,
            thrust_n=thrust,
            torque_n_m=torque,
            speed_rad_s=speed,
            lag_up_s=up,
            lag_down_s=down,
            spin_inertia_kg_m2=spin or 0.0,
            reference_voltage_v=reference,
            voltage_exponent=1.0 if exponent is None else exponent,
        )

    def _torque(self, from_speed: bool, thrust_key: str) -> tuple[float, ...]:
        own = "rotors.torque_from_speed" if from_speed else "rotors.torque_from_command"
        key = self._one_of("reaction torque", "rotors.torque_per_thrust", own)
        if key == own:
            torque = self._polynomial(own)
            assert torque is not None
            return torque
        ratio = self._number(key)
        thrust = self._polynomial(thrust_key)
        assert thrust is not None
        return tuple(ratio * c for c in thrust)

    def _direction(self, count: int) -> Array:
        entry = self._entry("rotors.direction")
        assert entry is not None
        words = entry.get("value")
        if not isinstance(words, list) or any(w not in ("cw", "ccw") for w in words):
            raise ModelError(
                f'{self.file}: rotors.direction = {words!r} must be a list of "cw" and "ccw", '
                f"seen from above."
            )
        if len(words) != count:
            raise ModelError(
                f"{self.file}: rotors.direction has {len(words)} entries, rotors.position {count}."
            )
        return np.array([1.0 if w == "cw" else -1.0 for w in words])

    def _lag(self) -> tuple[float, float]:
        entry = self._entry("rotors.lag")
        if entry is None:
            self.sources["rotors.lag"] = "default: no lag"
            return 0.0, 0.0
        values = np.atleast_1d(self._si("rotors.lag", entry, "s"))
        self._check_sign("rotors.lag", values, True)
        if values.shape not in ((1,), (2,)) or np.any(values < 1e-3):
            raise ModelError(
                f"{self.file}: rotors.lag = {entry['value']!r} must be one time constant or "
                f"[up, down], at least 1 ms; leave it out for none."
            )
        return float(values[0]), float(values[-1])

    def _battery(self) -> Battery | None:
        if "battery" not in self.tree:
            return None
        for name in _REQUIRED_BATTERY:
            if self._entry(f"battery.{name}") is None:
                raise ModelError(f"{self.file}: [battery] is given without {name}.")
        full, empty, capacity, resistance, current = (
            self._number(f"battery.{name}") for name in _REQUIRED_BATTERY
        )
        if empty >= full:
            raise ModelError(
                f"{self.file}: battery.empty_voltage = {empty:g} V must be below "
                f"battery.full_voltage = {full:g} V."
            )
        return Battery(full, empty, capacity, resistance, current)

    def _check_hover(self, vehicle: Vehicle) -> None:
        rotors = vehicle.rotors
        if vehicle.drive == "rotor_speed":
            return
        command = np.linspace(0.0, 1.0, 201)
        argument = (
            np.polynomial.polynomial.polyval(command, rotors.speed_rad_s)
            if rotors.speed_rad_s
            else command
        )
        most = float(np.max(np.polynomial.polynomial.polyval(argument, rotors.thrust_n)))
        if most < vehicle.hover_thrust_n:
            raise ModelError(
                f"{self.file}: cannot hover: {rotors.count} rotors give at most "
                f"{most * rotors.count:.4g} N, the weight is "
                f"{vehicle.mass_kg * GRAVITY_M_S2:.4g} N. Check the thrust map, its unit and "
                f"rotors.command_range."
            )


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[Any]:
    return pint.UnitRegistry()


def _leaves(raw: Any) -> Iterator[Any]:
    """What nested lists hold at their ends."""
    if isinstance(raw, list):
        for part in raw:
            yield from _leaves(part)
    else:
        yield raw


def _short(value: object) -> str:
    """A value as printed in an error, not longer than a line."""
    text = reprlib.repr(value) if isinstance(value, int) else repr(value)
    return text if len(text) <= 120 else text[:117] + "..."
