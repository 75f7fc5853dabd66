"""What a varied number or choice may be: from a share of its probability, 0..1, to its value."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, truncnorm

from twin.errors import TwinError

Array = NDArray[np.float64]
Value = float | bool | str
"""Of a factor in one run."""
_FORMS = (
    "{ low = 1.2, high = 1.6 }, with scale = 'log' or steps = 5 where wanted; "
    "{ mean = 1.4, sd = 0.1 }, with low and high where it ends; a list of values; or one value"
)


class Distribution(Protocol):
    """How a factor is drawn."""

    @property
    def levels(self) -> tuple[Value, ...]:
        """All of its values, where they can be counted; else none."""

    def at(self, share: Array) -> list[Value]:
        """Values at shares of probability, shape (n,), each within 0..1."""


_LARGEST, _SHOWN = 1e100, 60


@dataclass(frozen=True, slots=True)
class Uniform:
    """Between two numbers, all alike; or their logarithms.

    Attributes:
        low: Smallest.
        high: Largest.
        log: Whether all magnitudes are alike.
    """

    low: float
    high: float
    log: bool = False

    @property
    def levels(self) -> tuple[Value, ...]:
        """None that can be counted."""
        return ()

    def at(self, share: Array) -> list[Value]:
        """Values at shares of probability."""
        if self.log:
            ratio = math.log(self.high / self.low)
            return list((self.low * np.exp(share * ratio)).tolist())
        return list((self.low + share * (self.high - self.low)).tolist())


@dataclass(frozen=True, slots=True)
class Normal:
    """Around a mean, cut off where it ends.

    Attributes:
        mean: Of the whole distribution.
        sd: Of the whole distribution.
        low: Nothing is below.
        high: Nothing is above.
    """

    mean: float
    sd: float
    low: float = -math.inf
    high: float = math.inf

    @property
    def levels(self) -> tuple[Value, ...]:
        """None that can be counted."""
        return ()

    def at(self, share: Array) -> list[Value]:
        """Values at shares of probability."""
        inside = np.clip(share, 2.0**-53, 1 - 2.0**-53)  # the ends of a whole one are infinite
        if math.isinf(self.low) and math.isinf(self.high):
            drawn = norm.ppf(inside, self.mean, self.sd)
        else:
            ends = (np.array([self.low, self.high]) - self.mean) / self.sd
            drawn = truncnorm.ppf(inside, *ends, loc=self.mean, scale=self.sd)
        return list(np.asarray(drawn, dtype=np.float64).tolist())


@dataclass(frozen=True, slots=True)
class Choice:
    """One of some values, all alike.

    Attributes:
        levels: The values, of one kind.
    """

    levels: tuple[Value, ...]

    def at(self, share: Array) -> list[Value]:
        """Values at shares of probability."""
        count = len(self.levels)
        picked = np.minimum((share * count).astype(np.intp), count - 1)
        return [self.levels[i] for i in picked.tolist()]


def distribution_of(name: str, given: Any, file: str) -> Distribution:
    """A distribution as a design says it.

    Args:
        name: Of the factor, for messages.
        given: A table, a list, or a value.
        file: Where it stands, for messages.

    Raises:
        TwinError: It is none, or not a possible one.
    """
    where = f"{file}: {name}"
    if isinstance(given, Mapping):
        return _of_table(where, given)
    values = given if isinstance(given, Sequence) and not isinstance(given, str) else [given]
    if not values:
        raise TwinError(f"{where}: an empty list. Write {_FORMS}.")
    for value in values:
        wrong = not isinstance(value, bool | int | float | str)
        if wrong or (isinstance(value, int | float) and not _is_finite(value)):
            raise TwinError(f"{where}: {_said(value)} is no value. Write {_FORMS}.")
    alike = tuple(float(v) if type(v) is int else v for v in values)
    if len({type(v) for v in alike}) > 1:
        raise TwinError(f"{where}: {list(values)} are of several kinds: mix none.")
    return Choice(alike)


def _of_table(where: str, given: Mapping[str, Any]) -> Distribution:
    """`{ low, high }` or `{ mean, sd }`."""
    ends = {"low", "high"} <= given.keys()
    known = {"mean", "sd", "low", "high"} if "mean" in given else {"low", "high", "scale", "steps"}
    if given.keys() - known or not (ends or {"mean", "sd"} <= given.keys()):
        raise TwinError(f"{where}: {', '.join(given)} is no distribution. Write {_FORMS}.")
    numbers = {k: _number(where, k, v) for k, v in given.items() if k not in ("scale", "steps")}
    if ends and not numbers["low"] < numbers["high"]:
        raise TwinError(
            f"{where}: low = {numbers['low']:g}, high = {numbers['high']:g}: low has to be below."
        )
    if "mean" in given:
        if not numbers["sd"] > 0:
            raise TwinError(f"{where}: sd = {numbers['sd']:g}: needs a positive number.")
        return Normal(**numbers)
    if given.get("scale", "linear") not in ("linear", "log"):
        raise TwinError(f"{where}: scale = {given['scale']!r}: linear or log.")
    uniform = Uniform(**numbers, log=given.get("scale") == "log")
    if uniform.log and uniform.low <= 0:
        raise TwinError(f"{where}: low = {uniform.low:g}: a log scale needs positive numbers.")
    if "steps" not in given:
        return uniform
    steps = given["steps"]
    if type(steps) is not int or not 2 <= steps <= 10_000:
        raise TwinError(f"{where}: steps = {steps!r}: needs an integer of 2 to 10000.")
    return Choice(tuple(uniform.at(np.linspace(0.0, 1.0, steps))))


def _number(where: str, key: str, value: Any) -> float:
    """A finite number.

    Raises:
        TwinError: It is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not _is_finite(value):
        raise TwinError(f"{where}: {key} = {_said(value)}: needs a finite number below 1e100.")
    return float(value)


def _is_finite(value: float) -> bool:
    """Whether a number, however long it is written, leaves sums finite."""
    return -_LARGEST < value < _LARGEST


def _said(value: Any) -> str:
    """A value for a message, cut short."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
