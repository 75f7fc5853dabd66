"""How each effect is hidden: what changes in the plant, how much, and what the truth file says.

Sizes are small, medium and large; medium is what matters in practice. The caller has already
varied the size at random; signs and directions are drawn here.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..plants.aircraft import Aircraft
from ..plants.own.parameters import Array, Parameters

AXES = "xyz"


@dataclass(frozen=True)
class Number:
    """A number of the truth.

    Attributes:
        value: In `unit`.
        unit: SI.
        exact: Whether the plant has just this parameter; else its own law behaves like a
            law with this parameter about hover.
        neutral: Value at which the effect vanishes.
    """

    value: float
    unit: str
    exact: bool = True
    neutral: float = 0.0


Truth = dict[str, Number]
Change = tuple[Parameters, Truth]
Hide = Callable[[Parameters, Aircraft, float, np.random.Generator], Change]


@dataclass(frozen=True)
class Hidden:
    """An effect that can be hidden.

    Attributes:
        name: Identifier of design.md, or one of our own for effects outside the library.
        sizes: Small, medium, large.
        hide: Changes a plant by an effect of a size.
        outside: Whether no identifier of the library describes it.
    """

    name: str
    sizes: tuple[float, float, float]
    hide: Hide
    outside: bool = False


def sign(rng: np.random.Generator) -> float:
    """Plus or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def direction(rng: np.random.Generator, size: float, axes: int = 3) -> Array:
    """A vector of this length: all axes, or forward and right alone."""
    v = np.zeros(3)
    v[:axes] = rng.standard_normal(axes)
    return np.asarray(size * v / np.sqrt(v @ v))


def uneven(rng: np.random.Generator, size: float) -> Array:
    """Three numbers of either sign, each 0.5 to 1.2 times the size."""
    return np.asarray(size * rng.uniform(0.5, 1.2, 3) * rng.choice([-1.0, 1.0], 3))


def factor(value: float, exact: bool = True) -> Number:
    """A number that changes nothing at one."""
    return Number(value, "1", exact, neutral=1.0)


def vector(pattern: str, values: Array, unit: str, exact: bool = True) -> Truth:
    """Numbers of a vector: `pattern` holds `{}` for the axis."""
    return {
        pattern.format(a): Number(float(v), unit, exact) for a, v in zip(AXES, values, strict=False)
    }


def factors(pattern: str, values: Array) -> Truth:
    """Numbers of a vector that changes nothing at ones."""
    return {pattern.format(a): factor(float(v)) for a, v in zip(AXES, values, strict=True)}


def changed(p: Parameters, truth: Truth, **numbers: Any) -> Change:
    """The plant with some numbers changed."""
    return replace(p, **numbers), truth
