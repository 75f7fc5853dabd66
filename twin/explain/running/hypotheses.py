"""What may begin in mid-flight, and by how much the standing model may be off."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Equation
from ...effects.priors import BEGINNINGS, PRIORS, SHOWN_BY_CHANGE, Prior
from ...errors import ModelError
from ...representation import short_repr
from ...vehicle import Vehicle
from ..inference.priors import parameter_of
from ..model.numbers import Number, numbers_of
from .settings import RunningSettings

Array = NDArray[np.float64]
MONITORED_EFFECTS = tuple(BEGINNINGS)
"""What a pilot fears, and is told while it flies."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One thing that may begin.

    Attributes:
        effect: Identifier.
        part: Of which rotor, "1"; "" for a whole effect.
        columns: Positions of its numbers.
        mean: Expected change of each.
        sd: Standard deviation of that.
        odds: Log prior odds, up to a constant that all share.
        only_more: Whether it can but add.
    """

    effect: str
    part: str
    columns: tuple[int, ...]
    mean: Array
    sd: Array
    odds: float
    only_more: bool

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Library:
    """Numbers of the standing model, and hypotheses of a change of some of them.

    Attributes:
        effects: All effects with numbers, those that act by equations.
        numbers: Every number of these, shapes among them.
        columns: Positions, among the numbers, of those that may be off.
        standing: Deviation by which the standing model may be off in each of the columns.
        hypotheses: What may begin; columns count within `columns`.
        silent: Effects that change no mean, which are told by rules of their own.
    """

    effects: tuple[str, ...]
    numbers: tuple[Number, ...]
    columns: tuple[int, ...]
    standing: Array
    hypotheses: tuple[Hypothesis, ...]
    silent: tuple[str, ...]

    __repr__ = short_repr

    def name(self, column: int) -> Number:
        """Number of a column."""
        return self.numbers[self.columns[column]]


def library_of(
    vehicle: Vehicle,
    effects: Sequence[str],
    standing_effects: Sequence[str],
    settings: RunningSettings,
) -> Library:
    """Numbers and hypotheses for a vehicle.

    Args:
        vehicle: The calibrated model.
        effects: What may begin.
        standing_effects: By which the standing model may be off as well.
        settings: How far it may be off.

    Raises:
        ModelError: There is no such effect, or none that begins so.
    """
    for name in (*effects, *standing_effects):
        if name not in EFFECTS:
            raise ModelError(f"there is no effect {name!r}; see docs/reference/effects.md.")
    unforeseen = [n for n in effects if n not in BEGINNINGS]
    if unforeseen:
        raise ModelError(
            f"{', '.join(unforeseen)}: nothing is known of how it begins in flight. Give some of "
            f"{', '.join(BEGINNINGS)}."
        )
    every = [*effects, *(b for b in standing_effects if b not in effects)]
    own = tuple(e for e in every if isinstance(EFFECTS[e].observable_as, Equation))
    numbers = tuple(numbers_of((EFFECTS[e] for e in own), vehicle))
    columns = tuple(i for i, n in enumerate(numbers) if not n.shape)
    standing = np.array(
        [
            SHOWN_BY_CHANGE.get(numbers[i].effect, 1.0) * _sd(PRIORS, numbers[i], vehicle)[1]
            for i in columns
        ]
    )
    found = []
    for effect in (e for e in effects if e in own):
        mine = [k for k, i in enumerate(columns) if numbers[i].effect == effect]
        parts = {numbers[columns[k]].name: [k] for k in mine}
        several = numbers[columns[mine[0]]].about.per_rotor
        for name, chosen in parts.items() if several else [("", mine)]:
            expected = [_sd(BEGINNINGS, numbers[columns[k]], vehicle) for k in chosen]
            share = -np.log(len(mine)) if several else 0.0
            found.append(
                Hypothesis(
                    effect,
                    name.rpartition("_")[2] if several else "",
                    tuple(chosen),
                    np.array([m for m, _ in expected]),
                    np.array([s for _, s in expected]),
                    BEGINNINGS[effect].odds + float(share),
                    all(_only_adds(numbers[columns[k]]) for k in chosen),
                )
            )
    silent = tuple(e for e in effects if e not in own)
    return Library(own, numbers, columns, settings.standing * standing, tuple(found), silent)


def _sd(table: dict[str, Prior], number: Number, vehicle: Vehicle) -> tuple[float, float]:
    """Expected value and deviation of a number, for a vehicle."""
    about, stem = parameter_of(number)
    expected = table[number.effect].of(stem, indoors=False).sized(about, vehicle)
    return expected.mean, expected.sd


def _only_adds(number: Number) -> bool:
    """Whether a number has nothing below its neutral value."""
    about, _ = parameter_of(number)
    return about.bounds[0] == about.neutral
