"""How well the numbers of a vehicle are known: what its file states, or a word of a source says."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, NamedTuple, Self

if TYPE_CHECKING:
    from .vehicle import Vehicle

DEFAULT = "default: "
"""How the pedigree begins of a number about which a file is silent."""
BEFORE = "; before: "
"""What a source says behind this is of an older number."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """Standard deviation of the numbers of one key, as a vehicle file states it.

    Attributes:
        share: Of the value: root mean square of all numbers over that of their values, of an
            inertia by its three moments; of a place over the arm. Infinite where the value is 0.
        numbers: In SI units, one for all numbers of the key or one for each in their order; None
            where the file states a share.
    """

    share: float
    numbers: tuple[float, ...] | None = None

    @classmethod
    def of(cls, numbers: Sequence[float], size: Sequence[float]) -> Self:
        """Of standard deviations and what they are a share of, in the same unit."""
        own, whole = (math.sqrt(sum(x * x for x in of) / len(of)) for of in (numbers, size))
        return cls(own / whole if whole > 0 else math.inf, tuple(numbers))


class Known(NamedTuple):
    """How well something is known.

    Attributes:
        sd: Standard deviation over the value; of places over the arm.
        stated: Whether the file gives it as `sd`; else a word of the source stands for it.
    """

    sd: float
    stated: bool


@dataclass(frozen=True, slots=True)
class Word:
    """What words of a source say of the number before them.

    Attributes:
        share: Standard deviation over the value; of places over the arm.
        words: Any of them, as whole words in any case, unless "not" or the like stands before.
        reason: Why so much.
    """

    share: float
    words: tuple[str, ...]
    reason: str


WORDS = (
    Word(0.30, ("made up",), "numbers out of the air are off by a third, more often than not less"),
    Word(
        0.20,
        ("estimate", "estimated", "guess", "guessed"),
        "scaled from a sister frame or from formulas: right to a fifth",
    ),
    Word(0.10, ("CAD",), "cables, glue and battery are not in the drawing: inertia 5 to 10 % off"),
    Word(0.05, ("identified",), "fits to flights of another day differ by this much"),
    Word(0.03, ("measured",), "rulers, pendulums and test stands repeat to a few percent"),
    Word(0.01, ("weighed",), "the scale is better, what is aboard is not always the same"),
)
"""In the order of doubt: the first that a source holds counts. Sizes by judgement; those of maps
and inertia as the priors of `twin.effects` have them."""

GROUPS = {
    "rotors.thrust": ("rotors.thrust_from_speed", "rotors.thrust_from_command"),
    "rotors.torque": (
        "rotors.torque_from_speed",
        "rotors.torque_from_command",
        "rotors.torque_per_thrust",
    ),
    "rotors.lag": ("rotors.lag", "rotors.rate_up"),
}
"""Keys that say the same in several ways, of which a file has one."""


def share_by_word(source: str) -> float | None:
    """Standard deviation over the value that the words of a source stand for; None: they say none.

    What the source says of the number that was there before counts for nothing.
    """
    text = source.split(BEFORE)[0]
    for row in WORDS:
        word, negated = _patterns(row)
        if word.search(negated.sub("", text)):
            return row.share
    return None


@cache
def _patterns(row: Word) -> tuple[re.Pattern[str], re.Pattern[str]]:
    """The words of a row, and the same behind a "not"."""
    any_of = "|".join(word.replace(" ", r"[\s-]+") for word in row.words)
    word = rf"(?<!un-)(?<!non-)\b(?:{any_of})\b"
    negated = rf"\b(?:not|never|no|nor|without)\s+(?:\w+\s+)?{word}"
    return re.compile(word, re.IGNORECASE), re.compile(negated, re.IGNORECASE)


def relative_deviation(vehicle: "Vehicle", key: str) -> Known | None:
    """How well a vehicle knows the numbers of a key.

    Args:
        vehicle: Whose numbers.
        key: Of the vehicle file, "body.mass" or "effects.NAME.NUMBER"; or of `GROUPS`, for what a
            file may say in several ways: "rotors.thrust", "rotors.torque", "rotors.lag".

    Returns:
        Standard deviation over the value, of "rotors.position" and other places over the arm, and
        whether the file states it; None where nothing is known, as of every default.
    """
    for name in GROUPS.get(key, (key,)):
        source = vehicle.sources.get(name, DEFAULT)
        if source.startswith(DEFAULT):
            continue
        if name in vehicle.deviations:
            return Known(vehicle.deviations[name].share, True)
        share = share_by_word(source)
        return None if share is None else Known(share, False)
    return None
