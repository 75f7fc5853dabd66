"""Errors of the numbers that a program gives with a name, and how far it closed the gap."""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

from .outcomes import Outcome

CLEAR = 1.1
"""A gap counts when it is larger than its noise floor by this factor."""


@dataclass(frozen=True)
class ParameterError:
    """One number.

    Attributes:
        name: "effect.number".
        relative: Error over the size of the hidden vector, measured from where nothing is hidden.
        covered: Whether the 95 % interval holds the truth.
        exact: Whether plant and library share the law, so that the same number is meant.
    """

    name: str
    relative: float
    covered: bool
    exact: bool


def parameter_errors(
    truth: dict[str, Any], said: dict[str, Any], named: Collection[str]
) -> Iterator[ParameterError]:
    """Errors of the numbers of effects rightly named: same name, same unit, with an interval.

    Numbers without an interval are shapes, such as a reference or a height: no magnitude.
    """
    given = {e["name"]: e["parameters"] for e in said["effects"] if e["name"] in named}
    for effect in truth["effects"]:
        for name, number in effect["parameters"].items():
            found = given.get(effect["name"], {}).get(name)
            if found is None or _plain(found["unit"]) != _plain(number["unit"]):
                continue
            interval, size = found.get("ci95"), _size(effect["parameters"], number["unit"])
            if size > 0 and interval is not None and None not in interval:
                yield ParameterError(
                    f"{effect['name']}.{name}",
                    abs(found["value"] - number["value"]) / size,
                    bool(interval[0] <= number["value"] <= interval[1]),
                    number["exact"],
                )


def share_closed(o: Outcome) -> float:
    """Share of what stood above the noise floor that is gone: mean of the channels with a gap."""
    shares = [(c["before"] - c["after"]) / (c["before"] - c["noise_floor"]) for c in _gaps(o)]
    return sum(shares) / len(shares) if shares else math.nan


def after_over_floor(o: Outcome, after: str = "after") -> float:
    """Gap afterwards over the noise floor: root mean square of the channels that had a gap.

    Args:
        o: One case.
        after: "after", or "on_its_day" for the constants of the day set apart.
    """
    return _root_mean_square([c[after] / c["noise_floor"] for c in _gaps(o)])


def after_over_fit_mean(o: Outcome) -> float:
    """Gap afterwards over what the mean of the fit flights' residual leaves, over the channels that
    had a gap."""
    return _root_mean_square([c["after"] / c["fit_mean"] for c in _gaps(o) if c["fit_mean"]])


def _root_mean_square(ratios: Collection[float]) -> float:
    return math.sqrt(sum(r * r for r in ratios) / len(ratios)) if ratios else math.nan


def _gaps(o: Outcome) -> Iterator[dict[str, Any]]:
    """Every channel that stood above its noise floor."""
    for channel in o.said.get("gap", {}).values():
        if channel["before"] > CLEAR * channel["noise_floor"] > 0:
            yield channel


def _size(parameters: dict[str, Any], unit: str) -> float:
    """Length of the vector of all numbers of one unit, from their neutral values."""
    same = [p["value"] - p["neutral"] for p in parameters.values() if p["unit"] == unit]
    return math.sqrt(sum(v * v for v in same))


def _plain(unit: str) -> str:
    """One spelling: `kg.m2`, `kg*m^2` and `kg·m²` are the same."""
    for old, new in (("²", "2"), ("³", "3"), ("^", ""), ("*", "."), ("·", ".")):
        unit = unit.replace(old, new)
    return unit
