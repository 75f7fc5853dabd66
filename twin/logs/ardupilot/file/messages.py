"""The messages of a DataFlash log, binary or text, by name; what of the file makes no sense is
counted."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .definitions import Definition, Units, text, units_of


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """All messages of one name, in the order of the file.

    Attributes:
        definition: Of what they are made.
        places: Place of each among all messages of the file, shape (n,).
        data: By column, shape (n,): numbers after the divisor of their format, or text.
        units: Of the columns.
    """

    definition: Definition
    places: NDArray[np.int64]
    data: Mapping[str, NDArray[Any]]
    units: Units = field(default_factory=Units)

    def texts(self, column: str) -> list[str]:
        """A column of texts."""
        return [text(v) for v in self.data[column].tolist()]


@dataclass(slots=True)
class Damage:
    """What of a file could not be read.

    Attributes:
        lost: Bytes between messages that make no sense (lines of a text log).
        stretches: In how many pieces they lie.
        tail: Bytes of a message that is cut off at the end.
        redefined: Kinds of message that are defined twice, and differently.
        undefined: Definitions that make no sense, and why.
    """

    lost: int = 0
    stretches: int = 0
    tail: int = 0
    redefined: list[str] = field(default_factory=list)
    undefined: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Content:
    """What a file holds.

    Attributes:
        messages: By name, those that were asked for.
        counts: Number of messages by name, of all.
        damage: What could not be read.
    """

    messages: dict[str, Messages]
    counts: dict[str, int]
    damage: Damage


UNIT_MESSAGES = ("FMTU", "UNIT", "MULT")


def with_units(found: Mapping[str, Messages], wanted: Collection[str]) -> dict[str, Messages]:
    """Messages with the units that FMTU, UNIT and MULT give them.

    Args:
        found: By name, those three among them where the log has them.
        wanted: Names to keep.
    """
    labels = _by_letter(found.get("UNIT"), "Label")
    factors = _by_letter(found.get("MULT"), "Mult")
    told: dict[int, tuple[str, str]] = {}
    if (given := found.get("FMTU")) and {"FmtType", "UnitIds", "MultIds"} <= set(given.data):
        numbers = given.data["FmtType"].tolist()
        pairs = zip(given.texts("UnitIds"), given.texts("MultIds"), strict=True)
        told = dict(zip(map(int, numbers), pairs, strict=True))
    multipliers = {k: float(f"{v:.7g}") for k, v in factors.items()}  # written as float
    names = {k: str(v) for k, v in labels.items()}
    kept = {}
    for name, each in found.items():
        if name in wanted:
            ids = told.get(each.definition.number, ("", ""))
            units = units_of(each.definition, *ids, names, multipliers)
            kept[name] = Messages(each.definition, each.places, each.data, units)
    return kept


def _by_letter(given: Messages | None, column: str) -> dict[str, str | float]:
    """UNIT or MULT: a letter and what it stands for."""
    if given is None or not {"Id", column} <= set(given.data):
        return {}
    values: list[Any] = (
        given.texts(column) if given.definition.is_text(column) else given.data[column].tolist()
    )
    letters = given.data["Id"].tolist()
    return {
        chr(int(k)): v
        for k, v in zip(letters, values, strict=True)
        if isinstance(k, int | float) and 0 < k < 128
    }
