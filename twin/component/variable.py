"""Rows of a component's interface table: names, kinds and ranges, and values held against them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Literal

import numpy as np

from ..errors import ModelError

Causality = Literal["parameter", "input", "output", "local"]


@dataclass(frozen=True, slots=True)
class Enumeration:
    """Values that have names.

    Attributes:
        name: Of the type.
        items: Name of each value; the values are 0, 1, ...
    """

    name: str
    items: tuple[str, ...]

    @property
    def legend(self) -> str:
        """Codes and what they mean, as text."""
        return ", ".join(f"{code} {item}" for code, item in enumerate(self.items))


Kind = Literal["real", "integer", "boolean"] | Enumeration
"""What the values of a variable are; all are calculated with as numbers."""
LARGEST_INTEGER = 2**31 - 1
"""Of what FMI tools hold in 32 bits."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One row of a component's interface table: a scalar that an FMI tool sees.

    Attributes:
        name: FMI name, dots for structure (`rotor_1.x`).
        causality: Who sets it; local: of an FMU alone, for solvers.
        unit: SI unit; "1" for a pure number.
        description: One line.
        start: Value before anybody sets it; an output has none.
        minimum: Smallest allowed value, itself allowed.
        maximum: Largest allowed value, itself allowed.
        fixed: A parameter that counts only until initialisation ends.
        kind: What its values are; a truth value is held as 0 or 1, an enumeration by its code.
    """

    name: str
    causality: Causality
    unit: str
    description: str
    start: float = 0.0
    minimum: float | None = None
    maximum: float | None = None
    fixed: bool = False
    kind: Kind = "real"

    @property
    def boolean(self) -> bool:
        """Whether it is a truth value."""
        return self.kind == "boolean"

    @property
    def real(self) -> bool:
        """Whether it may have any value within its range."""
        return self.kind == "real"

    @property
    def kind_name(self) -> str:
        """The kind as a word."""
        return "enumeration" if isinstance(self.kind, Enumeration) else self.kind

    @property
    def meaning(self) -> str:
        """The description, of an enumeration with its codes."""
        if isinstance(self.kind, Enumeration):
            return f"{self.description}: {self.kind.legend}"
        return self.description

    @property
    def start_text(self) -> str:
        """Its start value as people write it."""
        if isinstance(self.kind, Enumeration):
            return self.kind.items[int(self.start)]
        if self.boolean:
            return "true" if self.start else "false"
        return f"{self.start:g}"

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> "Variable":
        """One that `dataclasses.asdict` took apart, perhaps by way of JSON."""
        kind = row["kind"]
        if isinstance(kind, Mapping):
            kind = Enumeration(kind["name"], tuple(kind["items"]))
        return cls(**{**row, "kind": kind})


def unknown_name(owner: str, kind: str, name: str, known: Iterable[str]) -> str:
    """Text of the error for a misspelt name, with the nearest known one."""
    known = sorted(known)
    near = get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f"Did you mean {near[0]!r}?" if near else f"Known: {', '.join(known)}."
    return f"{owner}: there is no {kind} {name!r}. {hint}"


def check_range(owner: str, variable: Variable, value: float) -> None:
    """Raise `ModelError` if the value is not finite, outside the range or not of the kind."""
    low, high = variable.minimum, variable.maximum
    if not np.isfinite(value):
        raise ModelError(f"{owner}: {variable.name} = {value} must be a finite number.")
    if not variable.real and value != int(value):
        raise ModelError(f"{owner}: {variable.name} = {value:g} must be a whole number.")
    if isinstance(variable.kind, Enumeration) and not 0 <= value < len(variable.kind.items):
        raise ModelError(
            f"{owner}: {variable.name} = {value:g} is none of its values: {variable.kind.legend}."
        )
    if (low is not None and value < low) or (high is not None and value > high):
        span = f"[{'-inf' if low is None else low:}, {'inf' if high is None else high}]"
        raise ModelError(
            f"{owner}: {variable.name} = {value:g} {variable.unit} is outside its range {span}."
        )
