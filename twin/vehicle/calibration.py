"""Numbers of one aircraft as determined from all its flights together."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..representation import short_repr

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibration:
    """How well numbers are known together, and how much the days of an aircraft differ.

    Attributes:
        flights: Names of those used.
        numbers: "effect.number" of each, in the unit of the effect.
        covariance: Of these, shape (n, n).
        days: Standard deviation between flights by "effect.number".
        constants: Standard deviation between flights of what nothing explains, by channel of
            `twin.explain`, in its unit.
        records: Numbers that no vehicle holds, because they are of its records, "effect.number" ->
            value: clocks, the frame of a pose.
    """

    flights: tuple[str, ...]
    numbers: tuple[str, ...]
    covariance: Array
    days: Mapping[str, float]
    constants: Mapping[str, float]
    records: Mapping[str, float] = field(default_factory=dict)

    __repr__ = short_repr
