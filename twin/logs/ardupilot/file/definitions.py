"""What the messages of a DataFlash log are made of: FMT, and FMTU, UNIT and MULT for the units.

Source: ArduPilot, libraries/AP_Logger/README.md and LogStructure.h, for what they mean.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

HEADER = 3
"""Bytes before the content of a message: two that mark it, and its type."""
FMT_NUMBER = 0x80

_TYPES: dict[str, tuple[str, float]] = {
    **{k: (v, 1.0) for k, v in {"b": "i1", "B": "u1", "M": "u1", "h": "<i2", "H": "<u2"}.items()},
    **{k: (v, 1.0) for k, v in {"i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8"}.items()},
    **{k: (v, 1.0) for k, v in {"g": "<f2", "f": "<f4", "d": "<f8"}.items()},
    **{k: (v, 1.0) for k, v in {"n": "S4", "N": "S16", "Z": "S64", "a": "S64"}.items()},
    **{"c": ("<i2", 1e2), "C": ("<u2", 1e2), "e": ("<i4", 1e2), "E": ("<u4", 1e2)},
    "L": ("<i4", 1e7),
}
"""Of each letter of a format: the type in the file, and what a number is divided by."""
_MOST_COLUMNS = 64


@dataclass(frozen=True, slots=True)
class Definition:
    """One kind of message.

    Attributes:
        number: By which its messages are marked.
        name: Of up to four letters.
        letters: A letter per column, the format.
        columns: Names of the columns.
    """

    number: int
    name: str
    letters: str
    columns: tuple[str, ...]

    @property
    def dtype(self) -> "np.dtype[np.void]":
        """A message behind its header, column by column."""
        return np.dtype(
            [(c, _TYPES[k][0]) for c, k in zip(self.columns, self.letters, strict=True)]
        )

    @property
    def size(self) -> int:
        """Bytes of a message with its header."""
        return HEADER + self.dtype.itemsize

    def divisor(self, column: str) -> float:
        """What the number in the file is divided by; 1 for most formats."""
        return _TYPES[self.letters[self.columns.index(column)]][1]

    def is_text(self, column: str) -> bool:
        """Whether a column holds text."""
        return _TYPES[self.letters[self.columns.index(column)]][0].startswith("S")


FMT = Definition(FMT_NUMBER, "FMT", "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


def define(number: int, length: int | None, name: str, letters: str, columns: str) -> Definition:
    """A definition as FMT gives it.

    Args:
        number: Type, 0 to 255.
        length: Bytes of a message with its header; None: not checked, as in a text log.
        name: Of the message.
        letters: Format.
        columns: Names, with commas between.

    Raises:
        ValueError: It makes no sense; the text says why.
    """
    names = tuple(c.strip() for c in columns.split(",")) if columns else ()
    if not name.isalnum():
        raise ValueError("its name is none")
    if unknown := set(letters) - set(_TYPES):
        raise ValueError(f"it has a format letter {min(unknown)!r}")
    if not names or len(names) != len(letters) or len(names) > _MOST_COLUMNS:
        raise ValueError(f"it has {len(names)} names for {len(letters)} columns")
    if len(set(names)) < len(names) or not all(names):
        raise ValueError("two of its columns have one name, or one has none")
    made = Definition(number, name, letters, names)
    if length is not None and made.size != length:
        raise ValueError(f"its columns take {made.size} bytes, not {length}")
    return made


@dataclass(frozen=True, slots=True)
class Units:
    """Units of the columns of one kind of message, as FMTU, UNIT and MULT say.

    Attributes:
        labels: By column: ArduPilot's name of the unit, such as `deg/s`.
        multipliers: By column: times which a number in the file is in that unit.
        instance: The column that tells instances apart, "" where none does.
    """

    labels: Mapping[str, str] = field(default_factory=dict)
    multipliers: Mapping[str, float] = field(default_factory=dict)
    instance: str = ""


def units_of(
    definition: Definition,
    unit_ids: str,
    multiplier_ids: str,
    units: Mapping[str, str],
    multipliers: Mapping[str, float],
) -> Units:
    """Units of one kind of message.

    Args:
        definition: Of the message.
        unit_ids: UnitIds of its FMTU, a letter per column.
        multiplier_ids: MultIds of it.
        units: Labels by letter, from UNIT.
        multipliers: Numbers by letter, from MULT.
    """
    labels = {
        c: units[k]
        for c, k in zip(definition.columns, unit_ids, strict=False)
        if k not in "#?-" and k in units
    }
    factors = {
        c: multipliers[k]
        for c, k in zip(definition.columns, multiplier_ids, strict=False)
        if k in multipliers and multipliers[k] > 0.0 and definition.divisor(c) == 1.0
    }
    marked = unit_ids.find("#")
    instance = definition.columns[marked] if 0 <= marked < len(definition.columns) else ""
    return Units(labels, factors, instance)


_INSTANCE = ("I", "C", "Instance", "Inst")


def instance_column(definition: Definition, units: Units) -> str:
    """The column that tells instances apart, also in logs older than FMTU; "" where none does."""
    usual = [c for c in _INSTANCE if c in definition.columns and not definition.is_text(c)]
    found = units.instance or (usual[0] if usual else "")
    return found if found and not definition.is_text(found) else ""


def text(raw: bytes | str) -> str:
    """Text up to its end mark, whatever bytes there are."""
    told = raw.decode("utf-8", "replace") if isinstance(raw, bytes) else raw
    return told.partition("\0")[0]


_RAD = np.pi / 180.0
SI: dict[str, tuple[str, float]] = {
    **{k: ("angle", _RAD) for k in ("deg", "degheading", "deglatitude", "deglongitude")},
    "rad": ("angle", 1.0),
    "deg/s": ("rate", _RAD),
    "rad/s": ("rate", 1.0),
    "rpm": ("rate", 2.0 * np.pi / 60.0),
    "m": ("length", 1.0),
    "m/s": ("velocity", 1.0),
    "m/s/s": ("acceleration", 1.0),
    "Gauss": ("flux density", 1e-4),
    "Pa": ("pressure", 1.0),
    "V": ("voltage", 1.0),
    "A": ("current", 1.0),
    "s": ("time", 1.0),
    "us": ("pulse width", 1.0),
    "PWM": ("pulse width", 1.0),
    "1": ("number", 1.0),
}
"""ArduPilot's units: of what they are, and times which they are SI (pulse widths: us)."""


def in_si(label: str, assumed: str) -> tuple[float, bool]:
    """What takes a column to SI, and whether its unit contradicts what it should be.

    Args:
        label: Unit that the log gives, "" or an unknown one where it gives none.
        assumed: Unit by ArduPilot's documentation.
    """
    kind, factor = SI[assumed]
    if label not in SI:
        return factor, False
    told, told_factor = SI[label]
    return (told_factor, False) if told == kind else (factor, True)
