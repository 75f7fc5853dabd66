"""The entries of a vehicle file, each read separately: keys, units, shapes, signs.

`FIELDS` defines the content of a key; `_SHAPES` defines the reader of each shape. Mistakes are
collected, so that one run reports every mistake of a file.

The `sd` of an entry consists of numbers in the entry's unit, or of a share in percent.
"""

import math
import re
import reprlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from difflib import get_close_matches
from functools import lru_cache
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ModelError
from ..vehicle import Array, Deviation
from .fields import FIELDS, Field

PLACES = ("rotors.position", "imu.position", "position.antenna")
"""Keys whose share is relative to the arm: their numbers may be zero but uncertain."""
MAPS = ("polynomial", "rates", "table")
"""Shapes whose numbers have no separate standard deviations."""
_EXACT = ("list", "pair")
"""Shapes of conventions, not measurements."""
_PERCENT = re.compile(r"\s*(\d*\.?\d+(?:e[+-]?\d{1,3})?)\s*%\s*", re.ASCII | re.IGNORECASE)
"""Pattern of a number in percent."""


def read_deviation(
    key: str,
    sd: object,
    shape: str,
    value: Array,
    numbers: Callable[[object], Array],
    written: Sequence[int] = (),
    arm_m: float = math.nan,
) -> Deviation:
    """Read the `sd` of an entry.

    Args:
        key: Key of the entry, for errors.
        sd: Content of `sd` in the file.
        shape: Shape of the value, as in `Field`.
        value: Value in SI units.
        numbers: Converts numbers of the file to SI units.
        written: Array shape of the value in the file.
        arm_m: Arm of the vehicle, to which a share of a position refers.

    Raises:
        ModelError: It is no standard deviation of this value.
    """
    if shape in _EXACT:
        raise ModelError(f"{key} takes no sd: it is agreed upon, not measured. Leave sd out.")
    if isinstance(sd, str):
        return Deviation(_share(key, sd))
    if shape in MAPS:
        raise ModelError(
            f"{key}: sd = {sd!r} must be a share of the whole map, as in "
            f'sd = "5 %": its numbers are not known one by one.'
        )
    each = numbers(sd)
    if each.shape not in {(), tuple(written), (3,) if shape == "inertia" else ()}:
        raise ModelError(
            f"{key}: sd = {sd!r} must be one number, for all of the value, or one for each."
        )
    if np.any(each <= 0):
        raise ModelError(f"{key}: sd = {sd!r} must be positive; leave it out where it is unknown.")
    flat = each.ravel().tolist()
    if shape == "inertia":
        share = Deviation.of(flat[:3], np.diagonal(value).tolist()).share
        return Deviation(share, tuple(flat))
    return Deviation.of(flat, [arm_m] if key in PLACES else value.ravel().tolist())


def written_sd(deviation: Deviation, shape: Sequence[int] = ()) -> str | float | list[float]:
    """Content of a file after `sd =`, in SI units, that is read back as the same deviation.

    Args:
        deviation: Standard deviation to write.
        shape: Array shape of the value in the file.
    """
    if deviation.numbers is None:
        return f"{(Decimal(repr(deviation.share)) * 100).normalize():f} %"
    if len(deviation.numbers) == 1:
        return deviation.numbers[0]
    each = np.array(deviation.numbers)
    rows: list[float] = (each.reshape(shape) if each.size == np.prod(shape) else each).tolist()
    return rows


def _share(key: str, text: str) -> float:
    found = _PERCENT.fullmatch(text)
    share = float(Decimal(found[1]) / 100) if found else math.nan
    if not 0 < share < math.inf:
        raise ModelError(
            f"{key}: sd = {text!r} must be a positive number without quotes, in the unit of the "
            f'entry, or a share of the value as in sd = "5 %".'
        )
    return share


_HUGE = 1e60  # larger numbers overflow once multiplied with each other
_TEXTS = ("name", "description")  # keys without a number
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")  # all except tab and line feed
_PARTS = {"value", "coefficients", "unit", "source", "of", "sd"}  # keys of an entry
_MOST_UNKNOWN = 50
"""Largest number of unknown keys in an error."""
_PER_MASS = {"body.drag_linear": "1/s"}
"""Keys that may be given per kilogram of the vehicle, and their SI unit in that case."""
_Entry = dict[str, Any]


@dataclass(slots=True)
class Entries:
    """Content of a vehicle file.

    Attributes:
        given: Keys of the file, including unreadable ones.
        texts: Name and description, where given.
        values: Values by key, in SI units; polynomials as ascending coefficients, of the speed in
            rad/s or of the raw command; directions as +1 (cw) and -1 (ccw).
        sources: Source by key; "default: ..." for a key that the file omits.
        deviations: Standard deviations by key, where given.
        mistakes: Mistakes, one line each, with key and value.
    """

    given: set[str] = field(default_factory=set)
    texts: dict[str, str] = field(default_factory=dict)
    values: dict[str, Array] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    deviations: dict[str, Deviation] = field(default_factory=dict)
    mistakes: list[str] = field(default_factory=list)

    def number(self, key: str) -> float:
        """The number of a key that must be given."""
        return float(self.values[key])

    def optional(self, key: str, default: str) -> float | None:
        """The number of a key, or None; `default` describes the replacement in words."""
        if key in self.values:
            return self.number(key)
        self.sources[key] = f"default: {default}"
        return None

    def vector(self, key: str, default: str, stand_in: tuple[float, ...]) -> Array:
        """The numbers of a key, or a default; `stand_in` describes the default in words."""
        if key in self.values:
            return self.values[key]
        self.sources[key] = f"default: {default}"
        return np.array(stand_in)


def read_entries(tree: dict[str, Any]) -> Entries:
    """Read every entry of a parsed vehicle file."""
    entries = Entries(mistakes=list(_unknown_names(tree)))
    for name in (n for n in _TEXTS if n in tree):
        text = tree[name]
        if isinstance(text, str) and not _CONTROL.search(text):
            entries.texts[name] = text
        else:
            entries.mistakes.append(
                f"{name} = {short(text)} must be text without control characters."
            )
    for key, what in FIELDS.items():
        section, name = key.split(".")
        table = tree.get(section)
        entry = table.get(name) if isinstance(table, dict) else None
        if entry is None:
            if what.required:
                entries.mistakes.append(f"{key} is missing: {what.meaning}")
            continue
        entries.given.add(key)
        try:
            _check_form(key, entry, what.unit.removeprefix("poly:"))
            entries.sources[key] = entry["source"]
            value = _SHAPES[what.shape](key, entry)
            if _is_per_mass(key, entry):
                value = value * entries.values.get("body.mass", 1.0)
            _check_sign(key, value, what.positive)
            entries.values[key] = value
            if "sd" in entry:
                entries.deviations[key] = _deviation(key, entry, what, entries)
        except ModelError as mistake:
            entries.mistakes.append(str(mistake))
    return entries


# -- keys -----------------------------------------------------------------------------------


def _unknown_names(tree: dict[str, Any]) -> Iterator[str]:
    """The first unknown names, and the number of further ones."""
    unknown = _all_unknown(tree)
    for kind, name, known in islice(unknown, _MOST_UNKNOWN):
        yield _unknown(kind, name, known)
    if more := sum(1 for _ in unknown):
        yield f"and {more} more names that are not known."
    for section in {key.split(".")[0]: None for key in FIELDS}:
        if not isinstance(tree.get(section, {}), dict):
            yield f"[{section}] must be a table of keys."


def _all_unknown(tree: dict[str, Any]) -> Iterator[tuple[str, str, set[str]]]:
    """Kind of an unknown name, the name, and the known names."""
    known: dict[str, set[str]] = {}
    for key in FIELDS:
        section, name = key.split(".")
        known.setdefault(section, set()).add(name)
    for section, table in tree.items():
        if section in _TEXTS:
            continue
        if section not in known:
            yield "section", section, known.keys() | set(_TEXTS)
        elif isinstance(table, dict):
            for name in (n for n in table if n not in known[section]):
                yield f"key in [{section}]", name, known[section]


def _unknown(kind: str, name: str, known: set[str]) -> str:
    near = get_close_matches(name[:99], sorted(known), n=1, cutoff=0.5)
    hint = f"Did you mean {near[0]!r}?" if near else f"Known: {', '.join(sorted(known))}."
    return f"unknown {kind}: {short(name)}. {hint}"


def read_number(key: str, entry: Any, unit: str) -> tuple[float, Deviation | None]:
    """One number in braces, in `unit`, and its `sd`; for entries that are not in `FIELDS`.

    Raises:
        ModelError: It has no value, unit or source, a unit of another quantity, or an invalid sd.
    """
    _check_form(key, entry, unit)
    value = _si(key, entry.get("value"), entry, unit)
    if value.shape != ():
        raise ModelError(f"{key} = {short(entry.get('value'))} must be one number.")
    if "sd" not in entry:
        return float(value), None
    given = _numbers_of_sd(key, _to_si(key, entry, unit))
    return float(value), read_deviation(key, entry["sd"], "scalar", value, given)


def _check_form(key: str, entry: Any, unit: str) -> None:
    """Check that an entry is in braces with a value and a source."""
    if not isinstance(entry, dict) or not ({"value", "coefficients"} & set(entry)):
        raise ModelError(
            f"{key} = {short(entry)} needs unit and source, as in "
            f'{key.split(".")[1]} = {{ value = ..., unit = "{unit or "1"}", source = "..." }}.'
        )
    for part in sorted(entry.keys() - _PARTS):
        raise ModelError(_unknown(f"part of {key}", part, _PARTS))
    if not isinstance(entry.get("source"), str) or not entry["source"].strip():
        raise ModelError(
            f'{key} has no source. Say where the number comes from; "made up" is an honest source.'
        )


# -- numbers and units ----------------------------------------------------------------------


def _numbers(key: str, raw: Any) -> Array:
    if raw is None:
        raise ModelError(f"{key} has no value. Write value = ... in its braces.")
    try:
        if any(isinstance(n, bool) or not isinstance(n, int | float) for n in _leaves(raw)):
            raise TypeError
        values = np.asarray(raw, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ModelError(f"{key} = {short(raw)} must be numbers.") from None
    if not np.all(np.abs(values) < _HUGE):
        raise ModelError(f"{key} = {short(raw)} must be finite, below {_HUGE:g}.")
    return values


def _si(key: str, raw: Any, entry: _Entry, unit: str) -> Array:
    """Numbers converted to `unit`; those of `_PER_MASS` may remain per kilogram."""
    return _numbers(key, raw) * _to_si(key, entry, unit)


def _to_si(key: str, entry: _Entry, unit: str) -> float:
    """Factor from the unit of an entry to `unit`."""
    given = entry.get("unit")
    if not isinstance(given, str):
        raise ModelError(f'{key} has no unit. Add unit = "{unit}" or another one.')
    factor = unit_factor(key, given, _PER_MASS[key] if _is_per_mass(key, entry) else unit)
    if factor is None:
        raise ModelError(f'{key} has unit "{given}", which is not a unit of the kind "{unit}".')
    return factor


def _deviation(key: str, entry: _Entry, what: Field, entries: Entries) -> Deviation:
    """The `sd` of an entry whose value has been read."""
    value, shape, unit = entries.values[key], what.shape, what.unit.removeprefix("poly:")
    if shape == "polynomial" and "value" in entry:  # k of k * speed^2
        shape, value, unit = "scalar", value[2], f"{unit}*s^2/rad^2"
    factor = _to_si(key, entry, unit) if unit else 1.0
    if _is_per_mass(key, entry):
        factor *= float(entries.values.get("body.mass", 1.0))
    hubs = entries.values.get("rotors.position", np.ones((1, 3)))
    found = read_deviation(
        key,
        entry["sd"],
        shape,
        value,
        _numbers_of_sd(key, factor),
        np.shape(entry.get("value", ())),
        arm_m=float(np.linalg.norm(hubs[:, :2], axis=1).max()),
    )
    return Deviation(found.share) if shape != what.shape else found


def _numbers_of_sd(key: str, factor: float) -> Callable[[object], Array]:
    return lambda raw: _numbers(f"{key}: sd", raw) * factor


def _is_per_mass(key: str, entry: _Entry) -> bool:
    """Whether the unit is that of the value over a mass. Raises ModelError where the unit is
    invalid."""
    if key not in _PER_MASS or entry["unit"] == FIELDS[key].unit:
        return False
    return unit_factor(key, entry["unit"], _PER_MASS[key]) is not None


def _check_sign(key: str, values: Array, positive: bool | None) -> None:
    if positive is None:
        return
    if np.any(values <= 0) if positive else np.any(values < 0):
        bound = "positive" if positive else "zero or positive"
        raise ModelError(f"{key} = {values.tolist()} must be {bound}.")


# -- shapes ---------------------------------------------------------------------------------


def _scalar(key: str, entry: _Entry) -> Array:
    values = _si(key, entry.get("value"), entry, FIELDS[key].unit)
    if values.shape != ():
        raise ModelError(f"{key} = {short(entry['value'])} must be one number.")
    return values


def _vector(key: str, entry: _Entry) -> Array:
    values = _si(key, entry.get("value"), entry, FIELDS[key].unit)
    if values.shape != (3,):
        raise ModelError(f"{key} = {short(entry['value'])} must be a list of 3 numbers.")
    return values


def _inertia(key: str, entry: _Entry) -> Array:
    """The inertia matrix, shape (3, 3)."""
    values = _si(key, entry.get("value"), entry, FIELDS[key].unit)
    if values.shape not in ((3,), (6,)):
        raise ModelError(
            f"{key} = {short(entry['value'])} must be [Ixx, Iyy, Izz] or "
            f"[Ixx, Iyy, Izz, Ixy, Ixz, Iyz]."
        )
    xx, yy, zz, xy, xz, yz = [*values, 0.0, 0.0, 0.0][:6]
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    smallest = np.linalg.eigvalsh(matrix)[0]
    if smallest <= 0:
        raise ModelError(
            f"{key} = {short(entry['value'])} is not positive definite "
            f"(smallest principal moment {smallest:g} kg*m^2)."
        )
    return matrix


def _rows(key: str, entry: _Entry) -> Array:
    values = _si(key, entry.get("value"), entry, FIELDS[key].unit)
    if values.ndim != 2 or values.shape[1] != 3 or not 3 <= len(values) <= 12:
        raise ModelError(f"{key} must be 3 to 12 rows of [x, y, z]; it has shape {values.shape}.")
    return values


def _directions(key: str, entry: _Entry) -> Array:
    words = entry.get("value")
    if not isinstance(words, list) or any(w not in ("cw", "ccw") for w in words):
        raise ModelError(
            f'{key} = {short(words)} must be a list of "cw" and "ccw", seen from above.'
        )
    return np.array([1.0 if w == "cw" else -1.0 for w in words])


def _pair(key: str, entry: _Entry) -> Array:
    values = _numbers(key, entry.get("value"))
    if values.shape != (2,) or values[0] == values[1]:
        raise ModelError(
            f"{key} = {short(entry.get('value'))} must be two different numbers: "
            f"raw command at cmd = 0 and at cmd = 1."
        )
    return values


def _lag(key: str, entry: _Entry) -> Array:
    """Lags up and down, shape (2,)."""
    values = np.atleast_1d(_si(key, entry.get("value"), entry, FIELDS[key].unit))
    if values.shape not in ((1,), (2,)) or np.any(values < 1e-3):
        raise ModelError(
            f"{key} = {short(entry['value'])} must be one time constant or [up, down], "
            f"at least 1 ms; leave it out for none."
        )
    return values[[0, -1]]


def _table(key: str, entry: _Entry) -> Array:
    """Rows of argument and value with ascending argument, shape (n, 2)."""
    values = _si(key, entry.get("value"), entry, FIELDS[key].unit)
    if values.ndim != 2 or values.shape[1] != 2 or not 2 <= len(values) <= 100:
        raise ModelError(
            f"{key} must be 2 to 100 rows of [J, factor]; it has shape {values.shape}."
        )
    if np.any(np.diff(values[:, 0]) <= 0):
        raise ModelError(f"{key}: J must rise from row to row.")
    return values


def _rates(key: str, entry: _Entry) -> Array:
    """Linear coefficient in 1/s and quadratic one in 1/rad, shape (2,)."""
    if "coefficients" not in entry:
        raise ModelError(
            f"{key} needs coefficients = [a, b] of the missing speed and of the missing square."
        )
    c = _si(key, entry["coefficients"], entry, FIELDS[key].unit)
    if c.shape != (2,) or not np.any(c):
        raise ModelError(
            f"{key} = {short(entry['coefficients'])} must be two numbers [a, b], one above zero."
        )
    return c * _per_rad_s(key, entry) ** np.arange(2)


def _per_rad_s(key: str, entry: _Entry) -> float:
    """Rotor speed of 1 rad/s in the unit `of`."""
    of = entry.get("of")
    if not isinstance(of, str):
        raise ModelError(f'{key} needs of = "rad/s" (or "rpm"): the unit of the speed.')
    per_rad_s = unit_factor(key, "rad/s", of)
    if per_rad_s is None:
        raise ModelError(f'{key}: of = "{of}" is not a rotor speed.')
    return per_rad_s


def _polynomial(key: str, entry: _Entry) -> Array:
    """Ascending coefficients: of the speed in rad/s, or of the raw command."""
    unit = FIELDS[key].unit.removeprefix("poly:")
    of_speed = key.endswith("from_speed")
    if "value" in entry and "coefficients" in entry:
        raise ModelError(f"{key} has value and coefficients; give one of them.")
    if "value" in entry:
        if not of_speed:
            raise ModelError(
                f"{key} needs coefficients = [c0, c1, ...] in ascending powers of the command."
            )
        square = _si(key, entry["value"], entry, f"{unit}*s^2/rad^2")
        if square.shape != ():
            raise ModelError(
                f"{key}: a single value k means k * speed^2; for a polynomial write "
                f"coefficients = [c0, c1, c2]."
            )
        _check_sign(key, square, True)
        return np.array([0.0, 0.0, float(square)])
    c = _si(key, entry["coefficients"], entry, unit)
    if c.ndim != 1 or not 1 <= len(c) <= 8:
        raise ModelError(f"{key}: coefficients must be a list of 1 to 8 numbers.")
    of = entry.get("of")
    if not of_speed:
        if of is not None:
            raise ModelError(
                f"{key} is a polynomial of the command; its raw range is rotors.command_range, "
                f"so 'of' has no place here."
            )
        return c
    return c * _per_rad_s(key, entry) ** np.arange(len(c))


_SHAPES: dict[str, Callable[[str, _Entry], Array]] = {
    "scalar": _scalar,
    "vector": _vector,
    "inertia": _inertia,
    "n x 3": _rows,
    "list": _directions,
    "pair": _pair,
    "lag": _lag,
    "rates": _rates,
    "table": _table,
    "polynomial": _polynomial,
}  # reader of each shape of `fields`


def _leaves(raw: Any) -> Iterator[Any]:
    """Elements of nested lists."""
    if isinstance(raw, list):
        for part in raw:
            yield from _leaves(part)
    else:
        yield raw


if TYPE_CHECKING:
    import pint

_LONGEST_UNIT = 64  # characters: longer than any unit of a vehicle, short enough for pint
_POWER = re.compile(r"\*\*|\^")  # every power
_PLAIN_POWER = re.compile(
    r"[^\W\d)]\)?\s*(?:\*\*|\^)\s*\(?-?\d{1,2}(?:[./]\d{1,2})?\)?(?![\d.]|\s*(?:\*\*|\^))"
)  # powers of one or two digits, of a name or of brackets
_OF_BRACKETS = re.compile(r"\)\s*(?:\*\*|\^)")  # powers of brackets


def unit_factor(key: str, given: str, wanted: str) -> float | None:
    """Factor from one unit to another, None if they are of different quantities.

    pint, which takes half a second to import, is used only where the texts of the units differ.
    """
    if given == wanted:
        return 1.0
    if not _is_plain(given):
        raise ModelError(
            f"{key} has unit {short(given)}, which is not a unit: write names of units with *, / "
            f"and powers of one or two digits, {_LONGEST_UNIT} characters at most."
        )
    import pint

    try:
        zero, one = (_registry().Quantity(n, given).to(wanted).magnitude for n in (0.0, 1.0))
        return float(one) if zero == 0 else None  # degrees Celsius need an offset as well
    except (pint.DimensionalityError, pint.OffsetUnitCalculusError):
        return None
    except Exception as error:  # pint raises tokenizer and attribute errors for invalid text
        bad = wanted if given == "rad/s" else given
        raise ModelError(
            f"{key} has unit {short(bad)}, which is not a unit: {short(str(error))}."
        ) from error


def _is_plain(unit: str) -> bool:
    """Whether a text is short and has no nested powers, which pint would evaluate."""
    if len(unit) > _LONGEST_UNIT or len(_OF_BRACKETS.findall(unit)) > 1:
        return False
    return len(_POWER.findall(unit)) == len(_PLAIN_POWER.findall(unit))


@lru_cache(maxsize=1)
def _registry() -> "pint.UnitRegistry[Any]":
    import pint

    return pint.UnitRegistry()


def short(value: object) -> str:
    """A value as printed in an error, at most one line."""
    text = reprlib.repr(value) if isinstance(value, int) else repr(value)
    return text if len(text) <= 120 else text[:117] + "..."
