"""Errors of the numbers that a program gives with a name, and how far it closed the gap."""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

CLEAR = 1.1
"""A gap counts when it is larger than its noise floor by this factor."""


@dataclass(frozen=True)
class ParameterError:
    """One number.

    Attributes:
        relative: Error over the size of the hidden vector, measured from where nothing is hidden.
        covered: Whether the 95 % interval holds the truth; None without an interval.
        exact: Whether plant and library share the law, so that the same number is meant.
    """

    relative: float
    covered: bool | None
    exact: bool


def parameter_errors(
    truth: dict[str, Any], said: dict[str, Any], named: Collection[str]
) -> Iterator[ParameterError]:
    """Errors of every number whose effect was rightly named and whose name and unit match."""
    given = {e["name"]: e["parameters"] for e in said["effects"] if e["name"] in named}
    for effect in truth["effects"]:
        for name, number in effect["parameters"].items():
            found = given.get(effect["name"], {}).get(name)
            if found is None or _plain(found["unit"]) != _plain(number["unit"]):
                continue
            size = _size(effect["parameters"], number["unit"])
            if size > 0:
                yield ParameterError(
                    abs(found["value"] - number["value"]) / size,
                    _covers(found.get("ci95"), number["value"]),
                    number["exact"],
                )


def closed_gaps(said: dict[str, Any]) -> Iterator[float]:
    """Share of what stood above the noise floor that is gone, for every channel with a gap."""
    for channel in said.get("gap", {}).values():
        before, after, floor = (channel.get(k) for k in ("before", "after", "noise_floor"))
        if before and after is not None and floor is not None and before > CLEAR * floor:
            yield (before - after) / (before - floor)


def over_floor(said: dict[str, Any]) -> Iterator[float]:
    """Gap afterwards over the noise floor, for every channel that had a gap."""
    for channel in said.get("gap", {}).values():
        before, after, floor = (channel.get(k) for k in ("before", "after", "noise_floor"))
        if before and after is not None and floor and before > CLEAR * floor:
            yield after / floor


def _size(parameters: dict[str, Any], unit: str) -> float:
    """Length of the vector of all numbers of one unit, from their neutral values."""
    same = [p["value"] - p["neutral"] for p in parameters.values() if p["unit"] == unit]
    return math.sqrt(sum(v * v for v in same))


def _covers(interval: Any, value: float) -> bool | None:
    if interval is None or any(v is None for v in interval):
        return None
    low, high = interval
    return bool(low <= value <= high)


def _plain(unit: str) -> str:
    """One spelling: `kg.m2`, `kg*m^2` and `kg·m²` are the same."""
    for old, new in (("²", "2"), ("³", "3"), ("^", ""), ("*", "."), ("·", ".")):
        unit = unit.replace(old, new)
    return unit
