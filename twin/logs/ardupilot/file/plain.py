"""DataFlash logs as text, a message per line: `ATT, 1234, 0.1, ...`, numbers as they are meant."""

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .definitions import FMT, Definition, define
from .messages import UNIT_MESSAGES, Content, Damage, Messages, with_units

_LONGEST_LINE = 10_000
_SHOWN = 8


def read_plain(blob: bytes, wanted: Collection[str]) -> Content:
    """Messages of a text log; arguments as in `read_binary`.

    FILE holds parts of files with their line ends, so that lines behind it may be of anything.
    """
    lines = blob.decode("utf-8", "replace").split("\n")
    damage = Damage()
    if lines[-1].strip():  # the last line has no end
        damage.tail = len(lines[-1].encode())
    needed = {*wanted, *UNIT_MESSAGES}
    defined: dict[str, Definition] = {"FMT": FMT}
    rows: dict[str, list[list[str]]] = {}
    places: dict[str, list[int]] = {}
    counts: dict[str, int] = {}
    lost = within_file = False
    for place, line in enumerate(lines[:-1]):
        if not line.strip():
            continue
        name, _, rest = line.partition(",")
        definition = defined.get(name)
        fields = _fields(definition, rest) if definition and len(line) < _LONGEST_LINE else []
        if not definition and within_file:
            continue
        within_file = name == "FILE"
        if not definition or not fields:
            damage.lost += len(line) + 1
            damage.stretches += not lost
            lost = True
            continue
        lost = False
        counts[name] = counts.get(name, 0) + 1
        if name == "FMT":
            _define(fields, defined, damage)
        elif name in needed:
            rows.setdefault(name, []).append(fields)
            places.setdefault(name, []).append(place)
    found = {
        name: _columns(defined[name], each, np.array(places[name], dtype=np.int64), damage)
        for name, each in rows.items()
    }
    return Content(with_units(found, wanted), counts, damage)


def _fields(definition: Definition, rest: str) -> list[str]:
    """As many fields as there are columns, the last with its commas; [] where there are fewer."""
    n = len(definition.columns)
    fields = [f.strip() for f in rest.split(",", n - 1)]
    whole = len(fields) == n and (
        definition.is_text(definition.columns[-1]) or "," not in fields[-1]
    )
    return fields if whole else []


def _define(fields: list[str], defined: dict[str, Definition], damage: Damage) -> None:
    """Take a line of FMT in."""
    number, _, name, letters, columns = fields
    if name == "FMT":
        return  # it never changes, and old logs leave a name out
    shown = "".join(c for c in name if c.isprintable())[:_SHOWN]
    try:
        made = define(int(number), None, name, letters, columns)
    except ValueError as why:
        damage.undefined.append(f"{shown}: {why}")
        return
    before = defined.get(name)
    if before is None:
        defined[name] = made
    elif before != made:
        damage.redefined.append(shown)


def _columns(
    definition: Definition, rows: list[list[str]], places: NDArray[np.int64], damage: Damage
) -> Messages:
    """Columns of the lines of one name; lines in which a number is none are lost."""
    texts = dict(zip(definition.columns, zip(*rows, strict=True), strict=True))
    data: dict[str, NDArray[Any]] = {}
    good = np.ones(len(rows), dtype=np.bool_)
    for column, letter in zip(definition.columns, definition.letters, strict=True):
        if definition.is_text(column) or letter == "M":  # a mode may have its name there
            data[column] = np.array(texts[column], dtype=object)
            continue
        numbers, readable = _numbers(texts[column])
        data[column] = numbers
        good &= readable
    if not good.all():
        damage.lost += sum(len(", ".join(rows[k])) for k in np.flatnonzero(~good))
        damage.stretches += int(np.count_nonzero(~good))
    return Messages(definition, places[good], {c: v[good] for c, v in data.items()})


def _numbers(texts: tuple[str, ...]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Numbers, and which of the texts are some."""
    try:
        return np.array(texts, dtype=np.float64), np.ones(len(texts), dtype=np.bool_)
    except ValueError:
        values = [_number(t) for t in texts]
        readable = np.array([v is not None for v in values])
        return np.array([np.nan if v is None else v for v in values]), readable


def _number(told: str) -> float | None:
    try:
        return float(told)
    except ValueError:
        return None
