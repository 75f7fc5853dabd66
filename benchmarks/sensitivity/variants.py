"""Settings halved and doubled, one at a time."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from twin.explain.setting_group import Setting, Value, numbers
from twin.explain.settings import DEFAULT


@dataclass(frozen=True)
class Variant:
    """All settings at their default but one.

    Attributes:
        setting: At its default.
        way: "halved" or "doubled".
        value: Of this setting instead.
    """

    setting: Setting
    way: str
    value: Value

    @property
    def name(self) -> str:
        """Of the folder of its answers."""
        return f"{self.setting.name}.{self.way}"


def variants(only: Iterable[str] = ()) -> Iterator[Variant]:
    """Every setting halved and doubled, or those whose names begin with one of some texts."""
    begins = tuple(only)
    for setting in DEFAULT.every():
        if begins and not setting.name.startswith(begins):
            continue
        for way, factor in (("halved", 0.5), ("doubled", 2.0)):
            value = times(setting, factor)
            if value != setting.value:
                yield Variant(setting, way, value)


def times(setting: Setting, factor: float) -> Value:
    """A value times a factor; all numbers of a band by the same one.

    Whole numbers stay whole, and at least 1. A value that would reach its bound goes halfway there
    instead: a probability of 0.8 is doubled to 0.9.
    """
    top, below = max(numbers(setting.value)), setting.below
    if top * factor >= below:
        factor = (top + below) / 2 / top
    return _times(setting.value, factor)


def _times(value: Value, factor: float) -> Value:
    if isinstance(value, tuple):
        return tuple(_times(v, factor) for v in value)
    if isinstance(value, int):
        return max(1, math.floor(value * factor + 0.5))
    return value * factor
