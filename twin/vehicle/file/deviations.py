"""The `sd` of an entry of a vehicle file: numbers in the entry's unit, or a share in percent."""

import math
import re
from collections.abc import Callable, Sequence
from decimal import Decimal

import numpy as np

from ...errors import ModelError
from .. import Array, Deviation

PLACES = ("rotors.position", "imu.position", "position.antenna")
"""Keys whose share is of the arm: their numbers may be zero and yet be in doubt."""
MAPS = ("polynomial", "rates", "table")
"""Shapes whose numbers are not known one by one."""
_EXACT = ("list", "pair")
"""Shapes of what is agreed upon, not measured."""
_PERCENT = re.compile(r"\s*(\d*\.?\d+(?:e[+-]?\d{1,3})?)\s*%\s*", re.ASCII | re.IGNORECASE)


def read_deviation(
    key: str,
    sd: object,
    shape: str,
    value: Array,
    numbers: Callable[[object], Array],
    written: Sequence[int] = (),
    arm_m: float = math.nan,
) -> Deviation:
    """Read the `sd` of an entry.

    Args:
        key: Names the entry in errors.
        sd: As it stands in the file.
        shape: Of the value, as `Field` has it.
        value: In SI units.
        numbers: Converts numbers as they stand in the file to SI units.
        written: Shape of the value as it stands in the file.
        arm_m: Of the vehicle; a share of a place is of it.

    Raises:
        ModelError: It is no standard deviation of this value.
    """
    if shape in _EXACT:
        raise ModelError(f"{key} takes no sd: it is agreed upon, not measured. Leave sd out.")
    if isinstance(sd, str):
        return Deviation(_share(key, sd))
    if shape in MAPS:
        raise ModelError(
            f"{key}: sd = {sd!r} must be a share of the whole map, as in "
            f'sd = "5 %": its numbers are not known one by one.'
        )
    each = numbers(sd)
    if each.shape not in {(), tuple(written), (3,) if shape == "inertia" else ()}:
        raise ModelError(
            f"{key}: sd = {sd!r} must be one number, for all of the value, or one for each."
        )
    if np.any(each <= 0):
        raise ModelError(f"{key}: sd = {sd!r} must be positive; leave it out where it is unknown.")
    flat = each.ravel().tolist()
    if shape == "inertia":
        share = Deviation.of(flat[:3], np.diagonal(value).tolist()).share
        return Deviation(share, tuple(flat))
    return Deviation.of(flat, [arm_m] if key in PLACES else value.ravel().tolist())


def written_sd(deviation: Deviation, shape: Sequence[int] = ()) -> str | float | list[float]:
    """What stands in a file behind `sd =`, in SI units, and is read back as the same.

    Args:
        deviation: To write.
        shape: Of the value as it stands in the file.
    """
    if deviation.numbers is None:
        return f"{(Decimal(repr(deviation.share)) * 100).normalize():f} %"
    if len(deviation.numbers) == 1:
        return deviation.numbers[0]
    each = np.array(deviation.numbers)
    rows: list[float] = (each.reshape(shape) if each.size == np.prod(shape) else each).tolist()
    return rows


def _share(key: str, text: str) -> float:
    found = _PERCENT.fullmatch(text)
    share = float(Decimal(found[1]) / 100) if found else math.nan
    if not 0 < share < math.inf:
        raise ModelError(
            f"{key}: sd = {text!r} must be a positive number without quotes, in the unit of the "
            f'entry, or a share of the value as in sd = "5 %".'
        )
    return share
