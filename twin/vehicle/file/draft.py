"""A vehicle file in the making: entries with unit and source, and what could not be said."""

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import tomlkit

from .. import Array
from .fields import FIELDS

_WIDTH = 98


@dataclass(slots=True)
class Draft:
    """Entries of a vehicle file, collected one by one.

    Attributes:
        name: Of the vehicle.
        description: One line.
        file: Name of the file that the numbers come from, for their sources; "": they say it.
        notes: What the other file does not hold, or holds and this format has no place for; they
            stand at the head of the vehicle file.
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
        """A number, a vector or rows of numbers; `sd` as it stands in a file."""
        self._add(key, {"value": _plain(value), "unit": unit}, source, sd)

    def words(self, key: str, value: list[Any], source: str) -> None:
        """What has no unit."""
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
        """Ascending coefficients; `of` is the unit of a rotor speed that they multiply."""
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
