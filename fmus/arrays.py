"""Variables that belong together as one array, in FMI 3: `pos` for `pos_x`, `pos_y`, `pos_z`.

An array holds scalars that follow each other in the table of their part and differ in an axis or a
number alone, so that in C it is a place in the same memory and nothing is computed otherwise.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile

from twin.component import Variable

_MEMBER = re.compile(r"(?P<before>.+)_(?P<index>[wxyz]|[1-9][0-9]*)(?P<after>\)?)")
_AXES = (("x", "y", "z"), ("w", "x", "y", "z"))


@dataclass(frozen=True, slots=True)
class Entry:
    """One variable as an importer sees it.

    Attributes:
        name: Its own, or that of the scalar that it is.
        members: Scalars in their order.
    """

    name: str
    members: tuple[Variable, ...]

    @property
    def is_array(self) -> bool:
        """Whether it is one, be it of one element."""
        return self.name != self.members[0].name

    @property
    def first(self) -> Variable:
        """What all members have in common can be read from it."""
        return self.members[0]

    @property
    def description(self) -> str:
        """What the members mean: "Position, NED north | east | down"."""
        words = [re.split(r"\b", v.description) for v in self.members]
        if len(words) == 1:
            return self.first.description
        head = _common(words)
        tail = _common([w[head:][::-1] for w in words])
        differ = ["".join(w[head : len(w) - tail]).strip() for w in words]
        before, after = words[0][:head], words[0][len(words[0]) - tail :]
        return "".join(before) + " | ".join(differ) + "".join(after)


def scalars(variables: Iterable[Variable]) -> tuple[Entry, ...]:
    """Every variable on its own."""
    return tuple(Entry(v.name, (v,)) for v in variables)


def arrays(variables: Sequence[Variable], alike: Callable[[Variable], object]) -> tuple[Entry, ...]:
    """The same variables, those that belong together as arrays; their order stays.

    Args:
        variables: Of an FMU, in their order.
        alike: What else has to be the same of the members of an array.
    """
    taken = {v.name for v in variables}
    entries: list[Entry] = []
    left = list(variables)
    while left:
        name, size = _begins(left, alike)
        if size == 0 or name in taken:
            name, size = left[0].name, 1
        entries.append(Entry(name, tuple(left[:size])))
        del left[:size]
    return tuple(entries)


def _begins(variables: Sequence[Variable], alike: Callable[[Variable], object]) -> tuple[str, int]:
    """Name and size of the array that begins here; size 0: none does."""
    first = variables[0]
    stem = _stem(first)

    def belongs(v: Variable) -> bool:
        return _stem(v) == stem and _facts(v) == _facts(first) and alike(v) == alike(first)

    run = list(takewhile(belongs, variables)) if first.real and stem is not None else []
    indices = tuple(m["index"] for v in run if (m := _MEMBER.fullmatch(v.name)))
    counted = tuple(str(i) for i in range(1, len(run) + 1))
    whole = len(run) > 1 and indices in (*_AXES, counted)
    return stem or "", len(run) if whole else 0


def _stem(v: Variable) -> str | None:
    """Name without axis or number."""
    m = _MEMBER.fullmatch(v.name)
    return None if m is None else m["before"] + m["after"]


def _facts(v: Variable) -> tuple[object, ...]:
    return v.causality, v.unit, v.kind, v.fixed, v.minimum, v.maximum


def _common(rows: Sequence[Sequence[str]]) -> int:
    """How many entries all rows have the same at their beginning."""
    return len(list(takewhile(lambda column: len(set(column)) == 1, zip(*rows, strict=False))))
