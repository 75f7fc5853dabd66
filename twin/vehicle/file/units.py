"""Units of a vehicle file, as they are written and as they are wanted."""

import re
import reprlib
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from ...errors import ModelError

if TYPE_CHECKING:
    import pint

_LONGEST_UNIT = 64
_POWER = re.compile(r"\*\*|\^")
_PLAIN_POWER = re.compile(
    r"[^\W\d)]\)?\s*(?:\*\*|\^)\s*\(?-?\d{1,2}(?:[./]\d{1,2})?\)?(?![\d.]|\s*(?:\*\*|\^))"
)
_OF_BRACKETS = re.compile(r"\)\s*(?:\*\*|\^)")


def factor(key: str, given: str, wanted: str) -> float | None:
    """Factor from one unit to another, None if they are not of one kind.

    pint, half a second to load, is asked only where the unit is not the wanted one by its text.
    """
    if given == wanted:
        return 1.0
    if not _is_plain(given):
        raise ModelError(
            f"{key} has unit {short(given)}, which is not a unit: write names of units with *, / "
            f"and powers of one or two digits, {_LONGEST_UNIT} characters at most."
        )
    import pint

    try:
        zero, one = (_registry().Quantity(n, given).to(wanted).magnitude for n in (0.0, 1.0))
        return float(one) if zero == 0 else None  # degrees Celsius take more than a factor
    except (pint.DimensionalityError, pint.OffsetUnitCalculusError):
        return None
    except Exception as error:  # pint raises tokenizer and attribute errors for bad text
        bad = wanted if given == "rad/s" else given
        raise ModelError(
            f"{key} has unit {short(bad)}, which is not a unit: {short(str(error))}."
        ) from error


def _is_plain(unit: str) -> bool:
    """Whether a text is short and has no powers of powers: pint would work them out."""
    if len(unit) > _LONGEST_UNIT or len(_OF_BRACKETS.findall(unit)) > 1:
        return False
    return len(_POWER.findall(unit)) == len(_PLAIN_POWER.findall(unit))


@lru_cache(maxsize=1)
def _registry() -> "pint.UnitRegistry[Any]":
    import pint

    return pint.UnitRegistry()


def short(value: object) -> str:
    """A value as printed in an error, not longer than a line."""
    text = reprlib.repr(value) if isinstance(value, int) else repr(value)
    return text if len(text) <= 120 else text[:117] + "..."
