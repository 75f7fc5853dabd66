"""Declaration of a setting: value, unit, meaning and origin."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

from ..errors import ModelError

Value = int | float | tuple[Any, ...]
T = TypeVar("T", bound=Value)
G = TypeVar("G", bound="Group")


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting of a group.

    Attributes:
        name: Name with dots between groups, "inference.selection.sure".
        value: One number, or several in non-decreasing order, all above zero.
        unit: Unit; "1" for a dimensionless number.
        meaning: Meaning in one sentence.
        origin: Begins with "physics: ", "paper: ", "data sheet: ", "measured: ", "chosen on: "
            (which cases), "sensitivity: " or "made up".
        below: Upper bound that every number of it must stay below.
    """

    name: str
    value: Value
    unit: str
    meaning: str
    origin: str
    below: float


def setting(value: T, unit: str, meaning: str, origin: str, below: float = math.inf) -> T:
    """Field of a group; its default is `value`."""
    made: T = field(default=value, metadata={"about": (unit, meaning, origin, below)})
    return made


@dataclass(frozen=True, slots=True)
class Group:
    """Settings of one package, and groups of its subpackages.

    Raises:
        ModelError: A value has the wrong type, is not above zero, not below its bound, or
            decreases.
    """

    def __post_init__(self) -> None:
        for name, now in {s.name: s for s in self.every() if "." not in s.name}.items():
            problem = _problem(now, type(self).__dataclass_fields__[name].default)
            if problem:
                raise ModelError(f"{type(self).__name__}.{name} = {now.value}: {problem}.")

    def every(self, before: str = "") -> Iterator[Setting]:
        """All settings, in the order of their declaration."""
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Group):
                yield from value.every(f"{before}{f.name}.")
            else:
                yield Setting(before + f.name, value, *f.metadata["about"])

    def with_values(self: G, values: Mapping[str, Value]) -> G:
        """A copy with some settings changed.

        Raises:
            ModelError: There is no such setting, or it cannot have this value.
        """
        known = {s.name for s in self.every()}
        for name in values:
            if name not in known:
                near = [n for n in sorted(known) if n.endswith(f".{name.rpartition('.')[2]}")]
                hint = (
                    f"; is {' or '.join(near)} meant?"
                    if near
                    else ": see docs/reference/settings.md."
                )
                raise ModelError(f"there is no setting {name!r}{hint}")
        return self._with(values)

    def _with(self: G, values: Mapping[str, Value]) -> G:
        changed: dict[str, Any] = {}
        for name, value in values.items():
            first, _, rest = name.partition(".")
            if rest:
                changed.setdefault(first, {})[rest] = value
            else:
                changed[first] = value
        for first, value in changed.items():
            if isinstance(value, dict):
                changed[first] = getattr(self, first)._with(value)
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
        return f"give finite numbers above 0{limit}, in {now.unit}"
    return "" if found == sorted(found) else "give numbers that do not fall"


def _shape(value: object) -> object:
    return tuple(map(_shape, value)) if isinstance(value, tuple) else None
