"""Groups of settings: fields of a frozen dataclass, each with a docstring."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, TypeVar

from ..errors import ModelError
from ..representation import ShortRepr

Value = int | float | tuple[Any, ...]
G = TypeVar("G", bound="Group")
Share = Annotated[float, 1.0]
"""Share or probability: the annotation is the bound that every number of the value stays below."""


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting of a group.

    Attributes:
        name: Name with dots between groups, "inference.selection.sure".
        value: One number, or several in non-decreasing order, all above zero.
        below: Upper bound that every number of it must stay below.
    """

    name: str
    value: Value
    below: float


@dataclass(frozen=True, slots=True)
class Group(ShortRepr):
    """Settings of one package, and groups of its subpackages.

    Raises:
        ModelError: A value has the wrong type, is not above zero, not below its bound, or
            decreases.
    """

    def __post_init__(self) -> None:
        for now in (s for s in self.every() if "." not in s.name):
            problem = _problem(now, type(self).__dataclass_fields__[now.name].default)
            if problem:
                raise ModelError(f"{type(self).__name__}.{now.name} = {now.value}: {problem}.")

    def every(self, before: str = "") -> Iterator[Setting]:
        """All settings, in the order of their declaration."""
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Group):
                yield from value.every(f"{before}{f.name}.")
            else:
                (below,) = getattr(f.type, "__metadata__", (math.inf,))
                yield Setting(before + f.name, value, below)

    def with_values(self: G, values: Mapping[str, Value]) -> G:
        """A copy with some settings changed.

        Raises:
            ModelError: There is no such setting, or it cannot have this value.
        """
        known = {s.name for s in self.every()}
        for name in values:
            if name not in known:
                near = [n for n in sorted(known) if n.endswith(f".{name.rpartition('.')[2]}")]
                hint = f"; is {' or '.join(near)} meant?" if near else ""
                hint = hint or ": see docs/reference/settings.md."
                raise ModelError(f"there is no setting {name!r}{hint}")
        changed: dict[str, Any] = {}
        for name, value in values.items():
            first, _, rest = name.partition(".")
            group = changed.get(first, getattr(self, first))
            changed[first] = group.with_values({rest: value}) if rest else value
        return replace(self, **changed)


def numbers(value: Value) -> list[float]:
    """All numbers of a value, in order."""
    return [x for v in value for x in numbers(v)] if isinstance(value, tuple) else [float(value)]


def _problem(now: Setting, default: object) -> str:
    """Description of what is wrong with a value; "" for nothing."""
    found, below = numbers(now.value), now.below
    if isinstance(default, int) and not isinstance(now.value, int):
        return "give a whole number"
    if _shape(now.value) != _shape(default):
        return f"give as many numbers as {default} has"
    if not all(0 < x < below and math.isfinite(x) for x in found):
        limit = "" if math.isinf(below) else f" and below {below:g}"
        return f"give finite numbers above 0{limit}"
    return "" if found == sorted(found) else "give numbers that do not fall"


def _shape(value: object) -> object:
    return tuple(map(_shape, value)) if isinstance(value, tuple) else None
